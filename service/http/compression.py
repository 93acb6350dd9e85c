"""Answers compressed by gzip, for clients that accept it.

The layer is outside `ResponseLimit`, for two reasons: that one counts the plain bytes, which the
service holds, and it hands over pieces of 64 KiB, so that no compression holds the event loop up.

Event streams stay plain (starlette excludes their type): a compressor for each client takes some
250 KiB, and the messages are short. Compression may betray a secret in an answer that also repeats
a text of an attacker (BREACH). No answer contains a secret: docs/reference/access.md.
"""

from __future__ import annotations

from typing import Final

from starlette.datastructures import Headers, MutableHeaders
from starlette.middleware.gzip import GZipMiddleware, IdentityResponder
from starlette.types import ASGIApp, Message, Receive, Scope, Send

MINIMUM: Final = 500
"""Bytes of the smallest answer that is compressed; a smaller one fits a packet as it is."""
LEVEL: Final = 4
"""Of 1 to 9. A piece of 64 KiB takes 0.8 ms; level 6 takes 1.0 ms, and saves 4 % more."""


class Compression(GZipMiddleware):
    """Starlette's layer, which besides follows ``gzip;q=0``, and makes the ETag of a compressed
    answer weak: its bytes are others than those of the plain one (RFC 9110 §8.8.1)."""

    def __init__(self, app: ASGIApp) -> None:
        super().__init__(app, MINIMUM, LEVEL)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "http" and not _takes_gzip(Headers(scope=scope)):
            await IdentityResponder(self.app, self.minimum_size)(scope, receive, send)
            return

        async def weakened(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(raw=message["headers"])
                etag = headers.get("etag", "W/")
                if "content-encoding" in headers and not etag.startswith("W/"):
                    headers["etag"] = f"W/{etag}"
            await send(message)

        await super().__call__(scope, receive, weakened)


def _takes_gzip(headers: Headers) -> bool:
    for part in headers.get("accept-encoding", "").split(","):
        coding, _, weight = part.partition(";")
        if coding.strip() == "gzip":
            return weight.replace(" ", "").rstrip("0.") != "q="
    return False
