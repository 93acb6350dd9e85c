"""Long answers: sent a piece at a time, as the client takes them, and not too many at once.

An answer that is handed to the server in one go stays in memory until the client has taken it, and
a client may ask for the next one without taking any. So what is long is cut here, which holds for
every route: the server has at most a piece of it, and what remains is counted until it is taken.
Event streams are counted by themselves (service/sse/clients). Who takes nothing is let go by
`ConnectionLimits.review`.
"""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

from starlette.requests import Request
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from ..config.media_types import EVENT_STREAM
from .access_log import HEAD
from .problems import REQUEST_ID, Problem

PIECE_BYTES = 64 * 1024
"""An answer with more is long, and sent in pieces of so many bytes."""
STREAMED = 1024 * 1024
"""What an answer is reckoned with that does not say how long it is: its pieces are encoded when the
one before is taken (service/http/history_encoding)."""
HELD = "dyknow.answer.held"
"""In the scope of a request: bytes that such an answer needs besides until its end."""
PART = 8
"""All long answers together take at most such a part of the memory that the service may have."""
EACH = 0.75
"""The part of all places, and of all bytes, that one client may have: nobody alone takes all."""
WATCHED = "/metrics"
"""Who watches the service sees also that others take all places: only its own are counted."""
RETRY = 5
"""Seconds after which a client that found no place should ask again."""


@dataclass(slots=True)
class Taken:
    """What somebody has of the places for long answers."""

    count: int = 0
    bytes: int = 0

    def add(self, count: int, size: int) -> None:
        """So many answers more, or less."""
        self.count += count
        self.bytes += size

    def is_full(self, most: float, total: float, size: int) -> bool:
        """Whether one of ``size`` bytes is too much. Alone it never is: all can be had."""
        return self.count >= most or (self.count > 0 and self.bytes + size > total)


class LongAnswers:
    """Those under way: at most ``most``, of ``total`` bytes that their clients have not taken, or
    that are held for them.

    ``refused`` counts those for whom there was no place, by the limit.
    """

    def __init__(self, most: int, total: int) -> None:
        self.all = Taken()
        self.refused: Counter[str] = Counter({"each": 0, "total": 0})
        self._most = most
        self._total = total
        self._of_key: dict[str, Taken] = {}

    def begin(self, key: str, size: int, *, always: bool = False) -> None:
        """One of ``size`` bytes for who is counted as ``key``. Raises `Problem`: 429 where the
        client has all that it may have, 503 where nobody gets a further one, unless ``always``."""
        own = self._of_key.get(key, Taken())
        if own.is_full(max(1, EACH * self._most), EACH * self._total, size):
            self.refused["each"] += 1
            raise _no_place(429, "you do not take the long answers that you have asked for")
        if not always and self.all.is_full(self._most, self._total, size):
            self.refused["total"] += 1
            raise _no_place(503, "all places for long answers are taken")
        own.add(1, size)
        self._of_key[key] = own
        self.all.add(1, size)

    def end(self, key: str, size: int) -> None:
        """It is over."""
        own = self._of_key[key]
        own.add(-1, -size)
        if not own.count:
            del self._of_key[key]
        self.all.add(-1, -size)


class Answers:
    """The layer. ``key`` says who a request's answer is counted with."""

    def __init__(self, app: ASGIApp, long: LongAnswers, key: Callable[[Request], str]) -> None:
        self._app = app
        self._long = long
        self._key = key

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http" or scope.get(HEAD):
            await self._app(scope, receive, send)
            return
        is_long = False
        counted: tuple[str, int] | None = None

        async def cut(message: Message) -> None:
            nonlocal is_long, counted
            if message["type"] == "http.response.start":
                size = _size(message, scope.get(HELD, 0))
                is_long = size > PIECE_BYTES
                # What has changed something is answered: who hears 503 would do it again.
                if is_long and (scope["method"] == "GET" or scope["path"] == "/sparql"):
                    key = self._key(Request(scope))
                    try:
                        self._long.begin(key, size, always=scope["path"] == WATCHED)
                    except Problem as problem:
                        raise _Refused(problem) from None
                    counted = key, size
                await send(message)
            elif is_long:
                await _in_pieces(message, send)
            else:
                await send(message)

        try:
            await self._app(scope, receive, cut)
        except _Refused as refused:
            await refused.problem.response(scope.get(REQUEST_ID))(scope, receive, send)
        finally:
            if counted is not None:
                self._long.end(*counted)


class _Refused(Exception):
    """Ends what makes an answer for which there is no place; nothing of it has been sent."""

    def __init__(self, problem: Problem) -> None:
        super().__init__(problem.title)
        self.problem = problem


def _size(start: Message, held: int) -> int:
    """Bytes of the answer that begins so, or that are ``held`` for it; 0 for an event stream, which
    never ends."""
    headers = dict(start["headers"])
    length = headers.get(b"content-length")
    if length is not None:
        return int(length)
    kind = headers.get(b"content-type", b"")
    return 0 if kind.startswith(EVENT_STREAM.encode()) else STREAMED + held


async def _in_pieces(message: Message, send: Send) -> None:
    """Send a part of an answer so that the server never has much of it. It waits before it takes
    more than its buffer holds; where the client is fast it does not, and others have their turn."""
    body = memoryview(message.get("body", b""))
    more = message.get("more_body", False)
    for start in range(0, max(1, len(body)), PIECE_BYTES):
        end = start + PIECE_BYTES
        piece = {"body": bytes(body[start:end]), "more_body": more or end < len(body)}
        await send({"type": "http.response.body", **piece})
        await asyncio.sleep(0)


def _no_place(status: int, detail: str) -> Problem:
    return Problem(
        status,
        "too many long answers",
        detail,
        hint="take what you have asked for, ask for less at a time (limit, from, to), or ask again "
        "after the seconds in Retry-After",
        headers={"Retry-After": str(RETRY)},
    )
