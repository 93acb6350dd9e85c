"""Clients of server-sent events: limits on their number, wake-ups, heartbeats and cut-offs.

An `EventClient` is one response under way, which `response.EventStream` sends. All clients share
one timer for heartbeats and for stalled clients. `Rounds` wakes them in slices. A publish therefore
costs O(1) for any number of clients, and other tasks run between the slices.
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
"""Clients that one pass of the event loop wakes."""
ClientKey = Callable[[Request], str]
"""Returns the key under which a request's client counts: its token or address."""
LEAVE_SECONDS = 2.0
"""Seconds that clients have to read their last messages when the service stops."""
RETRY = 5
"""Seconds after which a refused client should try again (``Retry-After``)."""
REASONS = ("ended", "removed", "left", "stalled", "revoked", "shutdown", "failed")
"""Why a response ends: the stream ended or was removed; the client disconnected or stalled; its
token was revoked; the service stops; the stream's source failed, or an error that the log has."""
OPEN = Tokens()
"""No tokens: everyone may read."""


class EventClient:
    """One response under way: its wake-up, and how long it has been sending or idle.

    Moments are of the event loop's clock (s).
    """

    __slots__ = (
        "_awake",
        "_is_heartbeat_due",
        "_timeout",
        "_wake_up",
        "blocked_since",
        "caller",
        "idle_since",
        "key",
        "reason",
    )

    def __init__(self, key: str, caller: Caller | None = None) -> None:
        self.key = key
        self.caller = caller
        """The owner of the request's token."""
        self.blocked_since: float | None = None
        """When the present send began; None between sends."""
        self.idle_since = 0.0
        """When the last send ended."""
        self.reason: str | None = None
        """Why the client was cut off; None if it was not."""
        self._timeout: asyncio.Timeout | None = None
        self._wake_up: asyncio.Future[None] | None = None
        # Messages may be there before the first `wait`, which therefore returns at once.
        self._awake = True
        self._is_heartbeat_due = False

    def begin(self) -> asyncio.Timeout:
        """Return the context in which to send: it raises ``TimeoutError`` when `cut` was called."""
        self._timeout = asyncio.timeout(None)
        self.idle_since = asyncio.get_running_loop().time()
        return self._timeout

    async def send(self, send: Send, message: Message) -> None:
        """Send a part of the response; returns when the client has room for more."""
        loop = asyncio.get_running_loop()
        self.blocked_since = loop.time()
        await send(message)
        self.blocked_since = None
        self.idle_since = loop.time()

    async def wait(self, delay: float | None = None) -> bool:
        """Wait for a wake-up, or for ``delay`` seconds; returns False if only a heartbeat is due.

        Look for messages only after this returns: a wake-up in between makes the next call return
        at once, so none is lost.
        """
        if not self._awake:
            loop = asyncio.get_running_loop()
            self._wake_up = loop.create_future()
            timer = None if delay is None else loop.call_later(delay, self.wake)
            try:
                await self._wake_up
            finally:
                self._wake_up = None
                if timer is not None:
                    timer.cancel()
        is_heartbeat = self._is_heartbeat_due and not self._awake
        self._awake = self._is_heartbeat_due = False
        return not is_heartbeat

    def wake(self) -> bool:
        """Note that there may be messages; returns False if the client was awake already."""
        if self._awake:
            return False
        self._awake = True
        self._resume()
        return True

    def request_heartbeat(self) -> None:
        """Note that a heartbeat is due."""
        self._is_heartbeat_due = True
        self._resume()

    def cut(self, reason: str, after: float = 0.0) -> None:
        """Interrupt the response in ``after`` seconds; the first reason counts."""
        if self.reason is None and self._timeout is not None:
            self.reason = reason
            self._timeout.reschedule(asyncio.get_running_loop().time() + after)

    def _resume(self) -> None:
        if self._wake_up is not None and not self._wake_up.done():
            self._wake_up.set_result(None)


class HasClients(Protocol):
    """The part of a feed that `Rounds` reads."""

    @property
    def clients(self) -> Iterable[EventClient]: ...


class Rounds:
    """Wakes the clients of changed feeds, one feed after the other, `SLICE` clients at a time.

    A change during a round begins another round. Clients are woken in the order of their arrival:
    clients that reconnect again and again come last, and do not delay the others.

    Cost: `add` O(1), and a round O(clients of the feed). Up to `SLICE` clients are awake at once.
    """

    def __init__(self) -> None:
        self._changed: dict[HasClients, None] = {}
        self._round: list[EventClient] = []
        self._is_scheduled = False

    def add(self, feed: HasClients) -> None:
        """Wake the clients of ``feed``."""
        self._changed[feed] = None
        if not self._is_scheduled:
            self._wake_slice()

    def _wake_slice(self) -> None:
        woken = 0
        while woken < SLICE:
            while not self._round and self._changed:
                feed = next(iter(self._changed))
                del self._changed[feed]
                self._round = list(feed.clients)
                self._round.reverse()  # taken from the end
            if not self._round:
                self._is_scheduled = False
                return
            # Clients that are awake already cost nothing, so they do not count.
            woken += self._round.pop().wake()
        self._is_scheduled = True
        asyncio.get_running_loop().call_soon(self._wake_slice)


class EventClients:
    """All clients of event streams, and their limits.

    At most ``total`` clients are admitted, and ``each`` of one key. A client gets a comment after
    ``heartbeat`` s without a message (0: none). It is cut off when a send takes ``timeout`` s, or
    when ``tokens`` no longer has its token.
    """

    def __init__(
        self, total: int, each: int, heartbeat: float, timeout: float, tokens: Tokens = OPEN
    ) -> None:
        self.total = total
        self.each = each
        self.ends: Counter[str] = Counter(dict.fromkeys(REASONS, 0))
        """The number of ended responses, by reason."""
        self.refused: Counter[str] = Counter({"each": 0, "total": 0})
        self.sent = 0
        """Sent bytes of messages."""
        self.is_closing = False
        self.rounds = Rounds()
        self._heartbeat = heartbeat
        self._timeout = timeout
        self._tokens = tokens
        self._clients: dict[EventClient, None] = {}
        self._of_key: Counter[str] = Counter()
        self._timer: asyncio.TimerHandle | None = None

    def __len__(self) -> int:
        """The number of clients."""
        return len(self._clients)

    @property
    def blocked(self) -> int:
        """The number of clients with a send under way."""
        return sum(client.blocked_since is not None for client in self._clients)

    def admit(self, key: str, caller: Caller | None = None) -> EventClient:
        """Return a new client, which counts under ``key``: a token or an address.

        Raises `Problem` 429 if ``key`` has reached its limit, and 503 if all clients together have.
        """
        headers = {"Retry-After": str(RETRY)}
        if self._of_key[key] >= self.each:
            self.refused["each"] += 1
            raise Problem(
                429,
                "too many event streams",
                f"you have {self.each} event streams open, the most that one client may have",
                hint="close some, or follow several streams on one connection (GET /follow)",
                headers=headers,
            )
        if len(self._clients) >= self.total:
            self.refused["total"] += 1
            raise Problem(
                503,
                "too many event streams",
                f"the service has {self.total} event streams open, the most that it may have",
                hint="try again after the seconds in Retry-After",
                headers=headers,
            )
        return EventClient(key, caller)

    def join(self, client: EventClient) -> None:
        """Begin the response of an admitted client."""
        self._clients[client] = None
        self._of_key[client.key] += 1
        if self._timer is None:
            self._timer = asyncio.get_running_loop().call_later(self._interval, self._check_all)

    def leave(self, client: EventClient, reason: str) -> None:
        """Note the end of a client's response."""
        self.ends[reason] += 1
        del self._clients[client]
        self._of_key[client.key] -= 1
        if not self._of_key[client.key]:
            del self._of_key[client.key]

    def revoke(self) -> int:
        """Cut off the clients whose token was removed or may not read; return their number."""
        gone = [one for one in self._clients if not self._tokens.allows(one.caller, Scope.READ)]
        for client in gone:
            client.cut("revoked")
        return len(gone)

    def check(self, client: EventClient) -> None:
        """Do the same for one client: its token may have been removed since its request."""
        if not self._tokens.allows(client.caller, Scope.READ):
            client.cut("revoked")

    def close(self) -> None:
        """End all responses: the service stops. Clients have `LEAVE_SECONDS` to read the rest."""
        self.is_closing = True
        for client in self._clients:
            client.wake()
            client.cut("shutdown", LEAVE_SECONDS)

    @property
    def _interval(self) -> float:
        """Seconds between two checks of all clients."""
        limits = [1.0, self._timeout / 4, *([self._heartbeat / 4] if self._heartbeat else [])]
        return min(limits)

    def _check_all(self) -> None:
        """Cut off stalled clients, and send heartbeats to idle ones."""
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
            elif self._heartbeat and now - client.idle_since >= self._heartbeat:
                client.request_heartbeat()
        self._timer = loop.call_later(self._interval, self._check_all)
