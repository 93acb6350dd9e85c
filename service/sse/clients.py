"""Clients of server-sent events: how many there may be, how each is woken, and why each goes.

An `EventClient` is one answer that is under way (`EventStream` in event_response sends it). All
share one timer, for heartbeats and for those that take nothing, and are woken in rounds, some at a
time: a publish costs O(1) however many clients there are, and everybody else's turn comes between.
"""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Callable, Iterable
from typing import Protocol

from starlette.requests import Request
from starlette.types import Message, Send

from ..admission.tokens import Caller, Scope, Tokens
from ..http.problems import Problem

SLICE = 64
"""So many clients are woken before the loop looks at anything else."""
ClientKey = Callable[[Request], str]
"""Who a request's client is counted with: a token, an address."""
LEAVE = 2.0
"""Seconds that clients have, when the service stops, to take what they were sent."""
RETRY = 5
"""Seconds after which a client that found no place should ask again."""
REASONS = ("ended", "removed", "left", "stalled", "revoked", "shutdown", "failed")
"""Why an answer ends: its stream did, or was removed; the client went, or took nothing; its token
is not accepted any more; the service stops; what feeds the stream has failed, or an error, which is
in the log."""
OPEN = Tokens()
"""No token is asked for."""


class EventClient:
    """One answer under way: it waits for something to send, and others see how long it has been
    sending, or quiet. Moments are of the event loop's clock (s)."""

    __slots__ = (
        "_awake",
        "_beat",
        "_patience",
        "_waiting",
        "blocked_since",
        "caller",
        "key",
        "quiet_since",
        "reason",
    )

    def __init__(self, key: str, caller: Caller | None = None) -> None:
        self.key = key
        self.caller = caller
        """Whose token it came with."""
        self.blocked_since: float | None = None
        """When the send began that is under way; None between sends."""
        self.quiet_since = 0.0
        """When the last one ended."""
        self.reason: str | None = None
        """Why it was cut off; None if it was not."""
        self._patience: asyncio.Timeout | None = None
        self._waiting: asyncio.Future[None] | None = None
        self._awake = True
        self._beat = False

    def begin(self) -> asyncio.Timeout:
        """What the answer is sent within: it raises ``TimeoutError`` when the client is cut off."""
        self._patience = asyncio.timeout(None)
        self.quiet_since = asyncio.get_running_loop().time()
        return self._patience

    async def send(self, send: Send, message: Message) -> None:
        """Send a part of the answer; returns when the client has room for more."""
        loop = asyncio.get_running_loop()
        self.blocked_since = loop.time()
        await send(message)
        self.blocked_since = None
        self.quiet_since = loop.time()

    async def wait(self) -> bool:
        """Until there may be something to send: False if that is but a heartbeat.

        Look at what there is only after this: who is woken meanwhile does not wait again.
        """
        if not self._awake:
            self._waiting = asyncio.get_running_loop().create_future()
            try:
                await self._waiting
            finally:
                self._waiting = None
        beat = self._beat and not self._awake
        self._awake = self._beat = False
        return not beat

    def wake(self) -> bool:
        """There is something to send. Whether that was news."""
        if self._awake:
            return False
        self._awake = True
        self._rouse()
        return True

    def beat(self) -> None:
        """A heartbeat is due."""
        self._beat = True
        self._rouse()

    def cut(self, reason: str, after: float = 0.0) -> None:
        """End the answer wherever it is, in ``after`` seconds; the first reason counts."""
        if self.reason is None and self._patience is not None:
            self.reason = reason
            self._patience.reschedule(asyncio.get_running_loop().time() + after)

    def _rouse(self) -> None:
        if self._waiting is not None and not self._waiting.done():
            self._waiting.set_result(None)


class Listened(Protocol):
    """What clients listen to."""

    @property
    def clients(self) -> Iterable[EventClient]: ...


class Rounds:
    """Wakes the clients of what has something new: each feed in its turn, `SLICE` clients at a
    time. What comes during a round is another one; a client that is awake is not woken again.

    Who has listened longest comes first: those that leave and come back, again and again, are the
    last, and what their coming takes holds up nobody who stayed.

    Cost: `add` O(1), and a round O(clients of the feed). With few clients they are awake at once.
    """

    def __init__(self) -> None:
        self._changed: dict[Listened, None] = {}
        self._round: list[EventClient] = []
        self._going = False

    def add(self, feed: Listened) -> None:
        """The clients of ``feed`` are to look again."""
        self._changed[feed] = None
        if not self._going:
            self._go_on()

    def _go_on(self) -> None:
        woken = 0
        while woken < SLICE:
            while not self._round and self._changed:
                feed = next(iter(self._changed))
                del self._changed[feed]
                self._round = list(feed.clients)
                self._round.reverse()  # taken from the end
            if not self._round:
                self._going = False
                return
            woken += self._round.pop().wake()
        self._going = True
        asyncio.get_running_loop().call_soon(self._go_on)


class EventClients:
    """All clients of event streams.

    At most ``total`` together and ``each`` of one key (see `admit`); ``heartbeat`` s without a
    message bring a comment (0: none); who takes nothing for ``timeout`` s is cut off, and so is
    whose token is not among ``tokens`` any more.
    """

    def __init__(
        self, total: int, each: int, heartbeat: float, timeout: float, tokens: Tokens = OPEN
    ) -> None:
        self.total = total
        self.each = each
        self.ends: Counter[str] = Counter(dict.fromkeys(REASONS, 0))
        """Answers that have ended, by reason."""
        self.refused: Counter[str] = Counter({"each": 0, "total": 0})
        self.sent = 0
        """Bytes of messages."""
        self.is_closing = False
        self.rounds = Rounds()
        self._heartbeat = heartbeat
        self._timeout = timeout
        self._tokens = tokens
        self._clients: dict[EventClient, None] = {}
        self._of_key: Counter[str] = Counter()
        self._timer: asyncio.TimerHandle | None = None

    def __len__(self) -> int:
        """How many there are."""
        return len(self._clients)

    @property
    def blocked(self) -> int:
        """How many there are that have not taken what they were sent."""
        return sum(client.blocked_since is not None for client in self._clients)

    def admit(self, key: str, caller: Caller | None = None) -> EventClient:
        """A client that is counted with those of the same ``key``: a token, an address.

        Raises `Problem` 429 when it has all that it may have, 503 when nobody gets a further one.
        """
        headers = {"Retry-After": str(RETRY)}
        if self._of_key[key] >= self.each:
            self.refused["each"] += 1
            raise Problem(
                429,
                "too many event streams",
                f"you have {self.each} event streams open, and may have no more",
                hint="close some, or follow several streams on one connection (GET /follow)",
                headers=headers,
            )
        if len(self._clients) >= self.total:
            self.refused["total"] += 1
            raise Problem(
                503,
                "too many event streams",
                f"all {self.total} places for event streams are taken",
                hint="ask again after the seconds in Retry-After",
                headers=headers,
            )
        return EventClient(key, caller)

    def join(self, client: EventClient) -> None:
        """An admitted client's answer begins."""
        self._clients[client] = None
        self._of_key[client.key] += 1
        if self._timer is None:
            self._timer = asyncio.get_running_loop().call_later(self._pause, self._look)

    def leave(self, client: EventClient, reason: str) -> None:
        """Its answer has ended."""
        self.ends[reason] += 1
        del self._clients[client]
        self._of_key[client.key] -= 1
        if not self._of_key[client.key]:
            del self._of_key[client.key]

    def revoke(self) -> int:
        """Cut those off whose token is not accepted any more, or does not read; how many."""
        gone = [one for one in self._clients if not self._tokens.allows(one.caller, Scope.READ)]
        for client in gone:
            client.cut("revoked")
        return len(gone)

    def check(self, client: EventClient) -> None:
        """The same of one whose answer begins: its token may have gone since it asked."""
        if not self._tokens.allows(client.caller, Scope.READ):
            client.cut("revoked")

    def close(self) -> None:
        """Let all go: the service stops. Each gets the end of its answer, if it takes it soon."""
        self.is_closing = True
        for client in self._clients:
            client.wake()
            client.cut("shutdown", LEAVE)

    @property
    def _pause(self) -> float:
        """Seconds between two looks at all clients."""
        limits = [1.0, self._timeout / 4, *([self._heartbeat / 4] if self._heartbeat else [])]
        return min(limits)

    def _look(self) -> None:
        """Cut those off that take nothing; a heartbeat for those that have heard nothing."""
        self._timer = None
        if not self._clients:
            return
        loop = asyncio.get_running_loop()
        now = loop.time()
        for client in self._clients:
            since = client.blocked_since
            if since is not None:
                if now - since >= self._timeout:
                    client.cut("stalled")
            elif self._heartbeat and now - client.quiet_since >= self._heartbeat:
                client.beat()
        self._timer = loop.call_later(self._pause, self._look)
