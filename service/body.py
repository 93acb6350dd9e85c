"""The cap on request bodies: 413 for one that is too large, 429 for too many at once.

A pure ASGI layer, so that it holds for every route and nothing is read that will be refused.
Memory: at most ``bodies_limit`` bytes of bodies under way, plus one chunk a connection.
"""

from __future__ import annotations

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from .problems import Problem


class BodyLimit:
    """Refuses bodies over ``limit`` bytes, and further ones while ``total`` bytes are under way."""

    def __init__(self, app: ASGIApp, limit: int, total: int) -> None:
        self._app = app
        self._limit = limit
        self._total = total
        self._held = 0

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        declared = _content_length(scope)
        if declared is not None and declared > self._limit:
            await self._too_large().response()(scope, receive, send)
            return
        if declared and self._held + declared > self._total:
            await self._too_many().response()(scope, receive, send)
            return
        size = 0

        async def counted() -> Message:
            nonlocal size
            message = await receive()
            if message["type"] == "http.request":
                length = len(message.get("body", b""))
                size += length
                self._held += length
                if size > self._limit:
                    raise self._too_large()
                if self._held > self._total:
                    raise self._too_many()
            return message

        try:
            await self._app(scope, counted, send)
        finally:
            self._held -= size

    def _too_large(self) -> Problem:
        return Problem(
            413,
            "body too large",
            f"a request body has at most {self._limit} bytes",
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


def _content_length(scope: Scope) -> int | None:
    for name, value in scope["headers"]:
        if name == b"content-length" and value.isdigit():
            return int(value)
    return None
