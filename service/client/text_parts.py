"""Texts that are longer than one request may be, in parts: what the client sends one after the
other (service/http/text_limits has the bounds, and docs/isolation.md why there are any).

A text that fits is one part, as it is, and so is one that cannot be read or divided: the service
says what is wrong with it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import chain
from typing import Any, Final, TypeVar

from ...engine.specification.batches import Bounds, is_within, parts_of
from ...languages.errors import LanguageError, Span
from ...languages.kpl import parse_kpl
from ...languages.specification import parse_specification
from ...languages.ssl import parse_ssl
from ..http.text_limits import (
    LONGEST,
    MOST_CONTENTS,
    MOST_DECLARATIONS,
    MOST_WORDS,
    count_words,
)
from ..workers.specifications import MOST_ELEMENTS, MOST_PARTS
from .connection import ServiceError

T = TypeVar("T")
BOUNDS: Final = Bounds(MOST_PARTS, MOST_ELEMENTS, LONGEST)


def ssl_parts(text: str) -> list[str]:
    """An SSL text."""
    try:
        return _cut(text, [one.span for one in parse_ssl(text)], "")
    except LanguageError:
        return [text]


def kpl_parts(text: str) -> list[str]:
    """A KPL text; each part says what integers are, if the text does."""
    try:
        found = parse_kpl(text)
    except LanguageError:
        return [text]
    spans = [one.span for one in found.declarations]
    return _cut(text, spans, "" if found.unit is None else f"unit {found.unit.text}")


def specification_parts(text: str | bytes) -> Sequence[str | bytes]:
    """A specification in XML."""
    try:
        found = parse_specification(text)
    except LanguageError:
        return [text]
    if is_within(found, text, BOUNDS):
        return [text]
    return parts_of(found, BOUNDS) or [text]


def description_parts(
    streams: Mapping[str, Any] | Sequence[Mapping[str, Any]],
) -> list[Mapping[str, Any] | list[Mapping[str, Any]]]:
    """Descriptions of streams, to be sent as JSON."""
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


def sent(parts: Sequence[T], send: Callable[[T], Any]) -> Iterator[Any]:
    """What the service answers to each part. Raises `ServiceError`, which says what has been done
    already: each part is taken whole or refused whole, all of them are not."""
    for number, part in enumerate(parts):
        try:
            yield send(part)
        except ServiceError as error:
            if len(parts) > 1:
                raise _of_part(error, number, len(parts)) from error
            raise


def _of_part(error: ServiceError, done: int, count: int) -> ServiceError:
    before = f"{done} before it are done" if done else "nothing is done"
    hint = f"{error.hint}; " if error.hint else ""
    problem = {
        **error.problem,
        "detail": f"part {done + 1} of {count}, {before}: {error.args[0]}",
        "hint": f"{hint}send all of it again when it is right: what is there stays as it is",
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


def _cut(text: str, spans: Sequence[Span], head: str) -> list[str]:
    """``text`` in parts of some declarations each, which stand where ``spans`` say. A part has the
    ``head`` that the text had, and its lines have the numbers that they had there."""
    # What stands before a declaration belongs to it, but for the head, which every part has.
    starts = [0, *(span.start for span in spans[1:])] if spans else [0]
    ends = [*starts[1:], len(text)]
    parts: list[str] = []
    place, words, number = 0, 0, 0
    for start, end in zip(starts, ends, strict=True):
        own = count_words(text[start:end])
        if start > place and (
            number == MOST_DECLARATIONS
            or words + own > MOST_WORDS
            or len(_part(text, place, end, head).encode()) > LONGEST
        ):
            parts.append(_part(text, place, start, head))
            place, words, number = start, count_words(head), 0
        words += own
        number += 1
    return [*parts, _part(text, place, len(text), head)]


def _part(text: str, start: int, end: int, head: str) -> str:
    if start == 0:
        return text[:end]
    lines = min(text.count("\n", 0, start), LONGEST // 2)
    column = start - (text.rfind("\n", 0, start) + 1)
    before = "\n" * lines + " " * column
    return head + (before or " ") + text[start:end]


def joined(answers: Iterator[list[T]]) -> list[T]:
    """The lists that came of parts, as one."""
    return list(chain.from_iterable(answers))
