"""Splits long texts where their languages allow (config/text_bounds has the bounds).

A text that fits is one part. So is a malformed text, or one that cannot be split: the service then
reports the error. `parts` calls this for long texts only, since it imports the parsers.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from ...languages.errors import LanguageError, Span
from ...languages.kpl import parse_kpl
from ...languages.specification import parse_specification
from ...languages.specification.batches import Bounds, is_within, parts_of
from ...languages.ssl import parse_ssl
from ..config.text_bounds import (
    LONGEST,
    MOST_DECLARATIONS,
    MOST_ELEMENTS,
    MOST_PARTS,
    MOST_WORDS,
    count_words,
)

BOUNDS: Final = Bounds(MOST_PARTS, MOST_ELEMENTS, LONGEST)


def ssl_parts(text: str) -> list[str]:
    """Split an SSL text."""
    try:
        return _cut(text, [one.span for one in parse_ssl(text)], "")
    except LanguageError:
        return [text]


def kpl_parts(text: str) -> list[str]:
    """Split a KPL text; each part repeats the text's unit of integers."""
    try:
        specification = parse_kpl(text)
    except LanguageError:
        return [text]
    spans = [one.span for one in specification.declarations]
    unit = specification.unit
    return _cut(text, spans, "" if unit is None else f"unit {unit.text}")


def specification_parts(text: str | bytes) -> Sequence[str | bytes]:
    """Split a specification in XML."""
    try:
        specification = parse_specification(text)
    except LanguageError:
        return [text]
    if is_within(specification, text, BOUNDS):
        return [text]
    return parts_of(specification, BOUNDS) or [text]


def _cut(text: str, spans: Sequence[Span], head: str) -> list[str]:
    """Split ``text`` into parts of some declarations each, whose places are ``spans``. Each part
    begins with ``head``, and keeps the line numbers of the text for error messages."""
    # The text between two declarations belongs to the first of them.
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
