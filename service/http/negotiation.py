"""Media types of bodies (415) and answers (406), and the reading of text and JSON bodies."""

from __future__ import annotations

import json
from codecs import BOM_UTF8
from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from typing import Any, Final

import anyio
import anyio.to_thread
import mimeparse
from fastapi import Request
from fastapi.exceptions import RequestValidationError
from pydantic import TypeAdapter, ValidationError

from ...ontology.texts.reading import TextFormat
from ..config.media_types import JSON_LD, NTRIPLES, RDF_XML, TURTLE
from .problems import Problem

ONTOLOGY_FORMATS: dict[str, TextFormat] = {
    TURTLE: "turtle",
    RDF_XML: "rdfxml",
    JSON_LD: "jsonld",
    NTRIPLES: "ntriples",
}
"""The formats of ontologies, by media type."""
LONGEST_JSON: Final = 1 << 20
"""Bytes of a JSON body. Larger bodies are samples, ontologies or texts, with other media types."""
MOST_VALUES: Final = 10_000
"""Values of a JSON body: some ten milliseconds of work to read and check them."""
_SHORT = 1 << 14
"""Bytes of JSON that the event loop reads itself, at some hundredths of a millisecond a KiB."""
_LONG = anyio.CapacityLimiter(1)


def accepted(request: Request, offered: Sequence[str]) -> str:
    """The offered media type that the Accept header prefers; the first one without a preference.

    Raises a 406 `Problem` that lists the offered ones.
    """
    header = ", ".join(request.headers.getlist("accept")).strip()
    if not header:
        return offered[0]
    # Of equally good types mimeparse returns the last one; ours is the first.
    backwards = list(reversed(offered))
    try:
        best = mimeparse.best_match(backwards, header)
    except (mimeparse.MimeTypeParseException, ValueError) as error:
        raise Problem(400, "bad Accept header", f"{header!r} is no list of media types") from error
    if not best:
        raise Problem(
            406,
            "not acceptable",
            f"this route does not offer {header}",
            hint=f"Accept one of {', '.join(offered)}",
        )
    return str(best)


def content_type(request: Request, allowed: Sequence[str], *, is_required: bool = False) -> str:
    """The media type of the request's body, one of ``allowed``; the first one without a
    Content-Type, unless it ``is_required``. Raises a 415 `Problem`.
    """
    header = request.headers.get("content-type", "")
    given = header.partition(";")[0].strip().lower()
    if not given and not is_required:
        return allowed[0]
    if given not in allowed:
        raise Problem(
            415,
            "unsupported media type",
            f"this route does not accept {given or 'a body without a Content-Type'}",
            hint=f"send Content-Type: {' or '.join(allowed)}",
            headers={"Accept-Post": ", ".join(allowed)},
        )
    return given


async def text_body(request: Request, allowed: Sequence[str]) -> str:
    """Read the request's body as text. Raises `Problem` 415, or 400 as `utf8`."""
    content_type(request, allowed)
    return utf8(await request.body())


def utf8(body: bytes) -> str:
    """Decode ``body``, without a byte order mark.

    Raises a 400 `Problem` if it is no UTF-8 or empty.
    """
    body = body.removeprefix(BOM_UTF8)
    try:
        text = body.decode()
    except UnicodeDecodeError as error:
        raise Problem(
            400, "bad encoding", f"the body is no UTF-8 at byte {error.start}", hint="send UTF-8"
        ) from error
    if not text.strip():
        raise Problem(
            400, "empty body", "this route takes a text, and none came", hint="send it as the body"
        )
    return text


async def read_json(body: bytes) -> Any:
    """Read ``body`` as JSON, a long one in a thread. Raises ``ValueError`` (as ``json.loads``), a
    400 `Problem` for an object with a member twice, of which other parsers take the first, and a
    413 for more than `LONGEST_JSON` or `MOST_VALUES`."""
    if len(body) > LONGEST_JSON:
        raise Problem(
            413,
            "body too large",
            f"a JSON body has at most {LONGEST_JSON} bytes, and this one has {len(body)}",
            hint="split it into several requests",
        )
    # Counted before the reading, which is work too.
    if body.count(b",") >= MOST_VALUES:
        raise Problem(
            413,
            "body too large",
            f"a JSON body has at most {MOST_VALUES} values, counted by its commas",
            hint="split it into several requests",
        )
    if len(body) <= _SHORT:
        return _json(body)
    return await anyio.to_thread.run_sync(_json, body, limiter=_LONG)


def _json(body: bytes) -> Any:
    return json.loads(body, object_pairs_hook=_members)


def _members(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) < len(pairs):
        names = Counter(name for name, _ in pairs)
        name = next(name for name, _ in pairs if names[name] > 1)
        raise Problem(
            400, "bad JSON", f"the member {name!r} is there twice", hint="send each member once"
        )
    return found


async def json_value(body: bytes, shape: Any) -> Any:
    """Read ``body`` as JSON of ``shape``, for routes that take JSON beside other media types.

    Raises a 400 `Problem` for a body that is no JSON or has a member twice, and
    `RequestValidationError` for values that do not fit.
    """
    with suppress(ValueError, RecursionError):  # pydantic raises it below, with its place
        await read_json(body.removeprefix(BOM_UTF8))
    try:
        return TypeAdapter(shape).validate_json(body.removeprefix(BOM_UTF8))
    except ValidationError as error:
        errors = error.errors(include_url=False, include_context=False, include_input=False)
        if errors[0]["type"] == "json_invalid":
            hint = "send JSON in UTF-8, not nested deeply"
            raise Problem(400, "bad JSON", errors[0]["msg"], hint=hint) from error
        raise RequestValidationError(
            [{**item, "loc": ("body", *item["loc"])} for item in errors]
        ) from error
