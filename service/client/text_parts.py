"""Long texts in parts, cut where their languages allow (config/text_bounds has the bounds).

A text that fits is one part, as it is, and so is one that cannot be read or divided: the service
says what is wrong with it. Called by `parts`, for texts that may be too long only: what is here
imports the parsers.
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
