"""The outermost ASGI layer: an id, a log line, a count and a place among the recent ones for each
request; HEAD as a GET without its body; a 500 for failures."""

from __future__ import annotations

import asyncio
import re
import secrets
import time
from datetime import UTC, datetime
from itertools import count
from typing import Protocol

from starlette.requests import ClientDisconnect
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from ..config.logs import REQUEST, log
from ..config.recent_requests import LONGEST, AnsweredRequest, RecentRequests
from .body_limit import BODY, Body
from .problems import PROBLEM, REQUEST_ID, problem_of, stopping

HEAD = "dyknow.head"
"""In the scope of a HEAD request that the application handles as GET: an answer without end need
not begin."""
_ID = re.compile(rb"[\w.:/+=-]{1,100}", re.ASCII)
"""The form of a request id that a client sends."""


class RequestCount(Protocol):
    """The counter of requests; service/runtime/metrics implements it."""

    def request(self, method: str, route: str, status: int, seconds: float | None) -> None:
        """Count an answered request."""


class AccessLog:
    """Logs and counts every request; answers HEAD wherever GET is, and failures with a 500.

    The id of a request is its client's ``X-Request-Id``, or a new one; the answer has it too. A
    request that takes longer than ``slow`` s is a warning in the log. Its time ends when the answer
    begins: the rest depends on the client (service/http/response_limit).
    """

    def __init__(
        self, app: ASGIApp, metrics: RequestCount, recent: RecentRequests, slow: float = 1.0
    ) -> None:
        self._app = app
        self._metrics = metrics
        self._recent = recent
        self._slow = slow
        self._life = secrets.token_hex(4)
        self._numbers = count(1)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        method: str = scope["method"]
        # A copy: uvicorn must still see HEAD in its own scope, to send no body.
        scope = {**scope, "method": "GET", HEAD: True} if method == "HEAD" else dict(scope)
        id = scope[REQUEST_ID] = self._id(scope)
        REQUEST.set(id)
        begun, begun_at = time.perf_counter(), datetime.now(UTC)
        status, size = 500, 0
        started = endless = False
        ready: float | None = None

        async def observed(message: Message) -> None:
            nonlocal status, size, started, endless, ready
            if message["type"] == "http.response.start":
                started, status, ready = True, message["status"], time.perf_counter()
                headers = [*message["headers"], (b"x-request-id", id.encode())]
                message = {**message, "headers": headers}
                endless = any(
                    name == b"content-type" and value.startswith(b"text/event-stream")
                    for name, value in message["headers"]
                )
            elif method == "HEAD" and message["type"] == "http.response.body":
                message = {**message, "body": b""}
            await send(message)
            size += len(message.get("body", b""))

        try:
            await self._app(scope, receive, observed)
        except ClientDisconnect:
            # The client reads no answer; this one is for ASGI servers that require one.
            log().info("client left", method=method, path=scope["path"], request=id)
            if not started:
                status = 400
                await observed({"type": "http.response.start", "status": status, "headers": []})
                await observed({"type": "http.response.body", "body": b""})
        except asyncio.CancelledError:
            # The service stops, and has waited for the request. Were the error raised further,
            # uvicorn would log it as a failure.
            status = 503
            log().warning("request broken off", method=method, path=scope["path"], request=id)
            if not started:
                await stopping().response(id)(scope, receive, observed)
        except Exception as error:
            log().exception("request failed", method=method, path=scope["path"], request=id)
            # Were the error raised further, uvicorn would close the connection, which the client
            # may use again. Only an answer that has begun needs that.
            if started:
                raise
            await problem_of(error).response(id)(scope, receive, observed)
        finally:
            seconds = (ready or time.perf_counter()) - begun
            route = scope.get("route")
            path = getattr(route, "path_format", "(none)")
            body: Body | None = scope.get(BODY)
            endless = endless or (body is not None and body.live)
            self._metrics.request(method, path, status, None if endless else seconds)
            self._recent.add(
                AnsweredRequest(
                    begun_at,
                    id,
                    method[:LONGEST],
                    scope["path"][:LONGEST],
                    "" if route is None else path,
                    status,
                    seconds,
                    size,
                    scope.get(PROBLEM),
                )
            )
            slow = seconds >= self._slow and not endless
            (log().warning if slow else log().debug)(
                "slow request" if slow else "request",
                method=method,
                path=scope["path"],
                status=status,
                milliseconds=round(seconds * 1000, 1),
                request=id,
            )

    def _id(self, scope: Scope) -> str:
        for name, value in scope["headers"]:
            if name == b"x-request-id" and _ID.fullmatch(value):
                return str(value, "ascii")
        return f"{self._life}-{next(self._numbers)}"
