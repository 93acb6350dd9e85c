"""The outermost layer: HEAD as a GET without its body, one log line and one count a request."""

from __future__ import annotations

import time
from typing import Protocol

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from .body import HELD, Held
from .logs import log
from .problems import problem_of

HEAD = "dyknow.head"
"""Set in the scope of a GET that came as HEAD: an endless body need not be begun."""


class RequestCount(Protocol):
    """Whoever counts requests."""

    def request(self, method: str, route: str, status: int, seconds: float | None) -> None:
        """A request has been answered."""


class Observe:
    """Logs and counts every request; answers HEAD wherever GET is, and failures with a 500."""

    def __init__(self, app: ASGIApp, metrics: RequestCount) -> None:
        self._app = app
        self._metrics = metrics

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        method: str = scope["method"]
        # A copy, so that the server still sees its own HEAD and frames the answer accordingly.
        scope = {**scope, "method": "GET", HEAD: True} if method == "HEAD" else dict(scope)
        begun = time.perf_counter()
        status = 500
        started = endless = False

        async def observed(message: Message) -> None:
            nonlocal status, started, endless
            if message["type"] == "http.response.start":
                started, status = True, message["status"]
                endless = any(
                    name == b"content-type" and value.startswith(b"text/event-stream")
                    for name, value in message["headers"]
                )
            elif method == "HEAD" and message["type"] == "http.response.body":
                message = {**message, "body": b""}
            await send(message)

        try:
            await self._app(scope, receive, observed)
        except Exception as error:
            log().exception("request failed", method=method, path=scope["path"])
            # Raised further, it would make the server break the connection that the client means
            # to use again. An answer that has begun can only be broken off.
            if started:
                raise
            await problem_of(error).response()(scope, receive, observed)
        finally:
            seconds = time.perf_counter() - begun
            route = scope.get("route")
            path = getattr(route, "path_format", "(none)")
            body: Held | None = scope.get(HELD)
            endless = endless or (body is not None and body.live)
            self._metrics.request(method, path, status, None if endless else seconds)
            log().debug(
                "request",
                method=method,
                path=scope["path"],
                status=status,
                milliseconds=round(seconds * 1000, 1),
            )
