"""Limits of long answers: the server sends them in pieces as the client takes them, and only so
many at a time.

An answer that the application hands to uvicorn as a whole stays in memory until the client has
taken it, and a client may ask for more without taking any. So this layer cuts long answers of every
route: uvicorn has at most one piece, and the rest counts until the client has taken it. Event
streams have limits of their own (service/sse/clients). `ConnectionLimits.review` closes the
connections of clients that take nothing.
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
"""A longer answer is long; the size of its pieces."""
STREAMED = 1024 * 1024
"""Bytes that count for an answer of unknown length: its pieces are encoded one by one
(service/http/encodings/history_encoding)."""
HELD = "dyknow.answer.held"
"""In the scope of a request: further bytes that such an answer needs until its end."""
PART = 8
"""All long answers together take at most this part of the memory limit: an eighth."""
EACH = 0.75
"""The part of all places, and of all bytes, that one client may have."""
WATCHED = "/metrics"
"""Only its own client's part refuses it: monitoring has to see that others take all places."""
RETRY = 5
"""Seconds after which a refused client should ask again."""


@dataclass(slots=True)
class Usage:
    """The long answers of a client, or of all clients."""

    count: int = 0
    bytes: int = 0

    def add(self, count: int, size: int) -> None:
        """Count ``count`` more answers, of ``size`` bytes."""
        self.count += count
        self.bytes += size

    def is_full(self, most: float, total: float, size: int) -> bool:
        """Whether ``size`` more bytes exceed a limit. The first answer may have any size."""
        return self.count >= most or (self.count > 0 and self.bytes + size > total)


class LongAnswers:
    """Counts the long answers under way: at most ``most``, and ``total`` bytes that their clients
    have not taken or that the service holds for them.

    ``refused`` counts refusals by the limit.
    """

    def __init__(self, most: int, total: int) -> None:
        self.all = Usage()
        self.refused: Counter[str] = Counter({"each": 0, "total": 0})
        self._most = most
        self._total = total
        self._of_key: dict[str, Usage] = {}

    def begin(self, key: str, size: int, *, always: bool = False) -> None:
        """Count an answer of ``size`` bytes to the client ``key``. Raises `Problem`: 429 if the
        client has its part, 503 if all places are taken and not ``always``."""
        own = self._of_key.get(key, Usage())
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
        """Forget an answer that has ended."""
        own = self._of_key[key]
        own.add(-1, -size)
        if not own.count:
            del self._of_key[key]
        self.all.add(-1, -size)


class ResponseLimit:
    """The ASGI layer. ``key`` returns the client that a request's answer counts for."""

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
                # A request that has changed something gets its answer: after a 503 the client
                # would send it again.
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
    """Ends the application's work on an answer without a place. The service has sent nothing of it,
    but Starlette's error handler believes that it has, so the layer answers itself."""

    def __init__(self, problem: Problem) -> None:
        super().__init__(problem.title)
        self.problem = problem


def _size(start: Message, held: int) -> int:
    """The bytes that count for an answer with this start and ``held`` bytes beside; 0 for an event
    stream, which has no end."""
    headers = dict(start["headers"])
    length = headers.get(b"content-length")
    if length is not None:
        return int(length)
    kind = headers.get(b"content-type", b"")
    return 0 if kind.startswith(EVENT_STREAM.encode()) else STREAMED + held


async def _in_pieces(message: Message, send: Send) -> None:
    """Send a part of an answer in pieces. uvicorn waits between two while its buffer is full; with
    a fast client it does not, so the event loop gets a turn here."""
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
