"""Checks of the headers that describe a body, before the service reads any of it.

Every route reads bodies uncompressed and in UTF-8; Starlette and uvicorn check neither, so a body
with another coding or charset would be misread. Called by service/http/body_limit for every route.
"""

from __future__ import annotations

import re
from collections.abc import Iterable

from .problems import Problem

# A parameter of a media type (RFC 9110, section 5.6.6); a quoted value may contain a semicolon.
_PARAMETER = re.compile(rb';\s*([^\s;=]+)\s*=\s*("(?:[^"\\]|\\.)*"|[^\s;]*)')
_UTF_8 = (b"utf-8", b"utf8")


def checked_length(headers: Iterable[tuple[bytes, bytes]]) -> int | None:
    """Return the Content-Length of a request; None without one.

    Raises a 415 `Problem` for a body that is compressed or in another charset, and a 400 one for
    two Content-Types or Idempotency-Keys. A request without a body may have any of these headers.
    """
    length: int | None = None
    chunked = False
    kinds: list[bytes] = []
    keys = 0
    codings: list[bytes] = []
    for name, value in headers:
        if name == b"content-length":
            length = int(value) if value.isdigit() else None
        elif name == b"transfer-encoding":
            chunked = True
            codings.extend(_beside_chunked(value))
        elif name == b"content-type":
            kinds.append(value)
        elif name == b"idempotency-key":
            keys += 1
        elif name == b"content-encoding":
            codings.append(value)
    if length or chunked:
        if codings:
            _check_codings(codings)
        if len(kinds) > 1:
            raise Problem(
                400,
                "bad Content-Type header",
                f"a body has one Content-Type, not {len(kinds)}",
                hint="send the header once",
            )
        if keys > 1:
            raise Problem(
                400,
                "bad Idempotency-Key header",
                "there are several Idempotency-Key headers",
                hint="send the header once",
            )
        if kinds and b"charset" in kinds[0].lower():
            _check_charset(kinds[0])
    return length


def _beside_chunked(value: bytes) -> list[bytes]:
    """The transfer codings that uvicorn does not decode: all except chunked."""
    return [coding for coding in value.split(b",") if coding.strip().lower() != b"chunked"]


def _check_codings(values: Iterable[bytes]) -> None:
    for coding in b",".join(values).split(b","):
        if coding.strip().lower() not in (b"", b"identity"):
            raise Problem(
                415,
                "unsupported content encoding",
                f"the service does not decode bodies in {coding.strip().decode('latin-1')!r}",
                hint="send the body without Content-Encoding; chunks are allowed",
                headers={"Accept-Encoding": "identity"},
            )


def _check_charset(kind: bytes) -> None:
    for name, value in _PARAMETER.findall(kind):
        charset = value.strip(b'"')
        if name.lower() == b"charset" and charset.lower() not in _UTF_8:
            raise Problem(
                415,
                "unsupported charset",
                f"the service does not read bodies in {charset.decode('latin-1')!r}",
                hint="send the body in UTF-8",
            )
