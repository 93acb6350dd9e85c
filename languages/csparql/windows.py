"""Reads windows: ``[RANGE 5s STEP 1s]``, ``[TRIPLES 10 STEP 2]``, ``[LANDMARK STEP 1s]``.

It accepts the words of both engines: C-SPARQL's SLIDE and TUMBLING, RSP-QL's ELEMENTS for TRIPLES.
"""

from __future__ import annotations

from typing import Final, TypeAlias

from pyoxigraph import Literal

from ...rdf.namespaces import XSD
from ...sparql.cursor import Cursor
from ...sparql.tokens import Kind, Token
from ...streams.time import parse_time
from ..errors import LanguageError, Span
from .ast import CountWindow, LandmarkWindow, TimeWindow, Window
from .durations import read_duration

EXAMPLE: Final = "write `[RANGE 5s STEP 1s]`"
_COUNT_EXAMPLE: Final = "write `[TRIPLES 10 STEP 2]`"
_LANDMARK_EXAMPLE: Final = (
    'write `[LANDMARK STEP 1s]` or `[LANDMARK "2021-10-07T19:12:53Z"^^xsd:dateTime STEP 1s]`'
)
_LARGEST: Final = 2**31 - 1
_DATE_TIME: Final = XSD + "dateTime"
_ELSEWHERE: Final = {
    "ITEM": _COUNT_EXAMPLE,
    "ITEMS": _COUNT_EXAMPLE,
    "ROW": _COUNT_EXAMPLE,
    "ROWS": _COUNT_EXAMPLE,
    "TUPLES": _COUNT_EXAMPLE,
    "ALL": _LANDMARK_EXAMPLE,
    "NOW": "write `[RANGE 1s STEP 1s]` for the newest second",
    "FROM": "write the length of `FROM NOW - 5s TO NOW`: `[RANGE 5s STEP 1s]`",
}
"""Words of CQELS, CQL and SPARQLStream, with the equivalent here."""

Every: TypeAlias = int | None
"""The COMPUTE EVERY period of the query in ns: the STEP of a time window without one."""


def read_window(at: Cursor, what: str, every: Every) -> Window:
    """Read a window in brackets; ``what`` names it in errors."""
    opened = at.expect_mark("[", EXAMPLE)
    window: Window
    if at.is_word("RANGE"):
        window = _time(at, what, every, opened)
    elif at.is_word("TRIPLES", "ELEMENTS"):
        window = _count(at, what)
    elif at.is_word("LANDMARK"):
        window = _landmark(at, what, every, opened)
    else:
        here = at.here
        word = "" if here is None or here.kind is not Kind.WORD else here.text.upper()
        raise at.expected("RANGE, TRIPLES or LANDMARK", _ELSEWHERE.get(word, EXAMPLE))
    at.expect_mark("]", _COUNT_EXAMPLE if isinstance(window, CountWindow) else EXAMPLE)
    return window


def _time(at: Cursor, what: str, every: Every, opened: Token) -> TimeWindow:
    at.take()
    length = read_duration(at, f"the RANGE of {what}")
    if at.is_word("TUMBLING"):
        at.take()
        return TimeWindow(length, length)
    return TimeWindow(length, _step(at, what, every, opened, EXAMPLE))


def _landmark(at: Cursor, what: str, every: Every, opened: Token) -> LandmarkWindow:
    at.take()
    here = at.here
    start = _instant(at) if here is not None and here.kind is Kind.STRING else None
    if at.is_word("TUMBLING"):
        hint = "write `[LANDMARK STEP 1s]`, or `[RANGE 5s TUMBLING]`"
        raise at.error("a window from a landmark grows, so it cannot tumble", at.here, hint)
    return LandmarkWindow(start, _step(at, what, every, opened, _LANDMARK_EXAMPLE))


def _step(at: Cursor, what: str, every: Every, opened: Token, example: str) -> int:
    if at.is_word("STEP", "SLIDE"):
        at.take()
        return read_duration(at, f"the STEP of {what}")
    if not at.is_mark("]"):
        raise at.expected("STEP or `]`", example)
    if every is None:
        raise at.error(
            "the window has no STEP, and the query no COMPUTE EVERY to take it from",
            opened,
            example,
        )
    return every


def _instant(at: Cursor) -> int:
    """Read ``"2021-10-07T19:12:53Z"^^xsd:dateTime`` in ns; UTC if it has no zone."""
    start = 0 if at.here is None else at.here.start
    term = at.term()
    span = Span(start, at.last_token.end)
    if not isinstance(term, Literal) or term.datatype.value != _DATE_TIME:
        raise LanguageError("a landmark is an xsd:dateTime", at.source, span, _LANDMARK_EXAMPLE)
    try:
        return parse_time(term.value)
    except ValueError as error:
        raise LanguageError(
            f"not a landmark: {error}", at.source, span, _LANDMARK_EXAMPLE
        ) from None


def _count(at: Cursor, what: str) -> CountWindow:
    """Read a count window. Without STEP it moves with each triple, like CQL's windows of rows."""
    at.take()
    size = _number(at, f"the size of {what}")
    if at.is_word("TUMBLING"):
        at.take()
        return CountWindow(size, size)
    if at.is_word("STEP", "SLIDE"):
        at.take()
        return CountWindow(size, _number(at, f"the STEP of {what}"))
    return CountWindow(size, 1)


def _number(at: Cursor, what: str) -> int:
    number = at.here
    if number is None or number.kind is not Kind.NUMBER or not number.text.isdigit():
        raise at.expected(what, f"{_COUNT_EXAMPLE}: triples are counted in whole numbers")
    at.take()
    unit = at.here
    if unit is not None and unit.kind is Kind.WORD and unit.start == number.end:
        raise at.error(
            f"{what} is a number of triples, not a duration",
            unit,
            f"write `{number.text}`, or a window of time: `[RANGE 5s STEP 1s]`",
        )
    value = int(number.text) if len(number.text) <= 20 else _LARGEST + 1
    if not 0 < value <= _LARGEST:
        raise at.error(f"{what} is out of range", number, f"it is from 1 to {_LARGEST}")
    return value
