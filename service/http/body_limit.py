"""The cap on request bodies: 413 for one that is too large, 429 for too many at once; 415 for one
that is not what the service reads (service/http/body_headers).

A pure ASGI layer, so that it holds for every route and nothing is read that will be refused.
Memory: at most ``bodies_limit`` bytes of bodies under way, plus one chunk a connection.
A live body has no length of its own: what counts is what of it is not worked off yet.
"""

from __future__ import annotations

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from .body_headers import checked_length
from .body_timeouts import SlowBodies
from .problems import REQUEST_ID, Problem

HELD = "dyknow.held"
"""In the scope of a request: the `Held` of its body."""
LIVE = "/samples/live"
"""Paths that end so have bodies that are worked off while they come."""


class UnderWay:
    """What there is of bodies that are not worked off yet."""

    def __init__(self) -> None:
        self.bytes = 0
        self.bodies = 0


class Held:
    """What of one body is held. A live one is counted by what is kept of it, and has any length."""

    def __init__(self, limit: BodyLimit, live: bool) -> None:
        self.size = 0
        self.live = live
        self._limit = limit

    def add(self, count: int) -> None:
        """So many bytes have come. Raises `Problem` 413 or 429; of a live body `keep` does."""
        self.size += count
        self._limit.under_way.bytes += count
        if not self.live:
            self._limit.check(self.size)

    def keep(self, count: int) -> None:
        """Of a live body no more than so many bytes are still held. Raises `Problem` 413 or 429."""
        self._limit.under_way.bytes += count - self.size
        self.size = count
        self._limit.check(count)


class BodyLimit:
    """Refuses bodies over ``limit`` bytes, and further ones while ``total`` bytes are under way.

    Of a live body the limit is for what is not worked off yet: a line, a record batch. ``slow``
    lets those go that do not come in time.
    """

    def __init__(
        self,
        app: ASGIApp,
        limit: int,
        total: int,
        slow: SlowBodies | None = None,
        under_way: UnderWay | None = None,
    ) -> None:
        self.under_way = under_way or UnderWay()
        self._slow = slow
        self._app = app
        self._limit = limit
        self._total = total

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        body = Held(self, scope["path"].endswith(LIVE))
        try:
            length = checked_length(scope["headers"])
        except Problem as problem:
            await problem.response(scope.get(REQUEST_ID))(scope, receive, send)
            return
        declared = None if body.live else length
        if declared is not None and declared > self._limit:
            await self._too_large().response(scope.get(REQUEST_ID))(scope, receive, send)
            return
        if declared and self.under_way.bytes + declared > self._total:
            await self._too_many().response(scope.get(REQUEST_ID))(scope, receive, send)
            return

        next_message = receive
        if self._slow is not None and not body.live:
            next_message = self._slow.in_time(receive, scope["method"])

        async def counted() -> Message:
            message = await next_message()
            if message["type"] == "http.request":
                body.add(len(message.get("body", b"")))
            return message

        scope[HELD] = body
        self.under_way.bodies += 1
        try:
            await self._app(scope, counted, send)
        finally:
            self.under_way.bodies -= 1
            self.under_way.bytes -= body.size

    def check(self, size: int) -> None:
        """Raises a `Problem` where ``size`` bytes of one body are too many, 413, or those of all
        bodies, 429."""
        if size > self._limit:
            raise self._too_large()
        if self.under_way.bytes > self._total:
            raise self._too_many()

    def _too_large(self) -> Problem:
        return Problem(
            413,
            "body too large",
            f"a request body, of a live one each line or record batch, has at most "
            f"{self._limit} bytes",
            hint="send samples in several batches",
        )

    def _too_many(self) -> Problem:
        return Problem(
            429,
            "queue full",
            "too many request bodies are under way",
            hint="send again after the seconds in Retry-After, with the same Idempotency-Key",
            headers={"Retry-After": "1"},
        )
