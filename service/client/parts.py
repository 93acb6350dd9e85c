"""Splits long texts into parts that each fit a request, and sends them in order
(config/text_bounds has the bounds, docs/explanation/isolation.md their reasons)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import chain
from typing import Any, Final, TypeVar

from ..config.text_bounds import MOST_CONTENTS, MOST_DECLARATIONS
from .errors import ServiceError
from .flows import Flow, T

S = TypeVar("S")
SHORT: Final = 1024
"""Characters of a text that is within all bounds: a declaration takes more than eight, a unit in
XML fourteen. Shorter texts need no import of the parsers."""


def ssl_parts(text: str) -> list[str]:
    """Split an SSL text."""
    if len(text) <= SHORT:
        return [text]
    from . import text_parts

    return text_parts.ssl_parts(text)


def kpl_parts(text: str) -> list[str]:
    """Split a KPL text."""
    if len(text) <= SHORT:
        return [text]
    from . import text_parts

    return text_parts.kpl_parts(text)


def specification_parts(text: str | bytes) -> Sequence[str | bytes]:
    """Split a specification in XML."""
    if len(text) <= SHORT:
        return [text]
    from . import text_parts

    return text_parts.specification_parts(text)


def description_parts(
    streams: Mapping[str, Any] | Sequence[Mapping[str, Any]],
) -> list[Mapping[str, Any] | list[Mapping[str, Any]]]:
    """Split descriptions of streams, to be sent as JSON."""
    if isinstance(streams, Mapping):
        return [streams]
    parts: list[Mapping[str, Any] | list[Mapping[str, Any]]] = []
    part: list[Mapping[str, Any]] = []
    contents = 0
    for stream in streams:
        size = len(stream.get("contents", ()))
        if part and (len(part) == MOST_DECLARATIONS or contents + size > MOST_CONTENTS):
            parts.append(part)
            part, contents = [], 0
        part.append(stream)
        contents += size
    return [*parts, part]


def send_parts(parts: Sequence[S], send: Callable[[S], Flow[T]]) -> Flow[list[T]]:
    """Send the parts in order, and return the result of each. Raises `ServiceError` with the number
    of parts that took effect before the failed one: parts are atomic, their sequence is not."""
    results: list[T] = []
    for part in parts:
        try:
            results.append((yield from send(part)))
        except ServiceError as error:
            if len(parts) > 1:
                raise _of_part(error, len(results), len(parts)) from error
            raise
    return results


def send_lists(parts: Sequence[S], send: Callable[[S], Flow[list[T]]]) -> Flow[list[T]]:
    """Do the same, and return the items of all results."""
    results = yield from send_parts(parts, send)
    return list(chain.from_iterable(results))


def _of_part(error: ServiceError, done: int, count: int) -> ServiceError:
    before = f"{done} before it took effect" if done else "nothing took effect"
    hint = f"{error.hint}; " if error.hint else ""
    problem = {
        **error.problem,
        "detail": f"part {done + 1} of {count}, {before}: {error.args[0]}",
        "hint": f"{hint}correct the text, and send all of it again: equal declarations stay",
    }
    return ServiceError(
        error.status,
        error.title,
        problem["detail"],
        hint=problem["hint"],
        line=error.line,
        column=error.column,
        excerpt=error.excerpt,
        problem=problem,
    )
