"""Limits of request bodies: 413 for one that is too large, 429 while too many bytes are under way,
408 for one that comes too slowly, 415 for one that the service would misread (body_headers).

A pure ASGI layer, so the limits hold for every route, and the service reads nothing of a body that
it refuses. Neither uvicorn nor a route has these limits: Starlette limits the size of one body,
without a problem document and without the sum over all bodies; nothing limits the time.
A live body has no length of its own: what counts is the part that is not published yet, and
service/runtime/live_ingest limits the pauses between its parts.

Memory: at most ``bodies_limit`` bytes of bodies under way, plus one chunk a connection.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from .body_headers import checked_length
from .problems import REQUEST_ID, Problem

BODY = "dyknow.body"
"""In the scope of a request: its `Body`."""
LIVE = "/samples/live"
"""The end of the paths whose bodies are published while they arrive."""
GRACE = 5.0
"""Seconds before the rate of a body counts."""


class UnderWay:
    """The bodies that are under way, and their bytes that are not processed yet."""

    def __init__(self) -> None:
        self.bytes = 0
        self.bodies = 0


class Body:
    """The body of one request. A live body has any length: only its pending bytes count."""

    def __init__(self, limit: BodyLimit, live: bool) -> None:
        self.size = 0
        self.live = live
        self._limit = limit

    def add(self, count: int) -> None:
        """Count ``count`` bytes that have arrived. Raises `Problem` 413 or 429, but not for a live
        body: its bytes may be published at once (`keep`)."""
        # The end of the request subtracts ``size``, so both are counted before a refusal.
        self.size += count
        self._limit.under_way.bytes += count
        if not self.live:
            self._limit.check(self.size)

    def keep(self, count: int) -> None:
        """Set the pending bytes of a live body. Raises `Problem` 413 or 429."""
        self._limit.under_way.bytes += count - self.size
        self.size = count
        self._limit.check(count)


class BodyLimit:
    """Limits one body to ``limit`` bytes, all bodies under way to ``total`` bytes.

    A body arrives within ``timeout`` seconds, at ``rate`` bytes a second on average (0: any).
    ``refused`` counts slow bodies by the title of their problem.
    """

    def __init__(
        self,
        app: ASGIApp,
        limit: int,
        total: int,
        timeout: float = 30.0,
        rate: int = 0,
        refused: Callable[[str], None] = lambda title: None,
        under_way: UnderWay | None = None,
    ) -> None:
        self.under_way = under_way or UnderWay()
        self._app = app
        self._limit = limit
        self._total = total
        self._timeout = timeout
        self._rate = rate
        self._refused = refused

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        body = Body(self, scope["path"].endswith(LIVE))
        try:
            length = checked_length(scope["headers"])
            # A declared length lets the service refuse a body before it reads any of it.
            if length and not body.live:
                self.check(length, length)
        except Problem as problem:
            await problem.response(scope.get(REQUEST_ID))(scope, receive, send)
            return
        scope[BODY] = body
        self.under_way.bodies += 1
        try:
            await self._app(scope, self._counted(body, receive, scope["method"]), send)
        finally:
            self.under_way.bodies -= 1
            self.under_way.bytes -= body.size

    def _counted(self, body: Body, receive: Receive, method: str) -> Receive:
        """``receive`` of a request, with these limits.

        The deadline is checked when a part arrives: `ConnectionLimits.review` has uvicorn hand on
        an empty part twice a second. A timer a request would take 5 µs more.
        """
        clock = asyncio.get_running_loop().time
        begun: float | None = None

        async def counted() -> Message:
            nonlocal begun
            begun = begun or clock()
            while True:
                message = await receive()
                if message["type"] != "http.request":
                    return message
                data = message.get("body", b"")
                body.add(len(data))
                if not message.get("more_body", False):
                    return message
                if not body.live and clock() > self.deadline(begun, body.size):
                    problem = self._slow()
                    self._refused(problem.title)
                    if method == "GET":  # no route reads it, and the answer may have begun
                        return {"type": "http.disconnect"}
                    raise problem
                if data:
                    return message

        return counted

    def deadline(self, begun: float, size: int) -> float:
        """The time at which a body that began at ``begun`` is too slow, unless more than its
        ``size`` bytes arrive before; in the event loop's seconds."""
        rate_time = GRACE + size / self._rate if self._rate else self._timeout
        return begun + min(self._timeout, rate_time)

    def check(self, size: int, further: int = 0) -> None:
        """Check a body of ``size`` bytes, of which ``further`` are not counted yet. Raises
        `Problem` 413 or 429."""
        if size > self._limit:
            raise Problem(
                413,
                "body too large",
                f"a request body, or a line or record batch of a live one, has at most "
                f"{self._limit} bytes",
                hint="send samples in several batches",
            )
        if self.under_way.bytes + further > self._total:
            raise Problem(
                429,
                "queue full",
                "too many bytes of request bodies are under way",
                hint="send again after the seconds in Retry-After, with the same Idempotency-Key",
                headers={"Retry-After": "1"},
            )

    def _slow(self) -> Problem:
        rate = f", at {self._rate} bytes a second or more" if self._rate else ""
        return Problem(
            408,
            "slow body",
            f"the body did not arrive within {self._timeout:g} seconds{rate}",
            hint="send smaller bodies, or live samples to /streams/{name}/samples/live",
            # The rest of the body, which may still arrive, is not another request.
            headers={"Connection": "close"},
        )
