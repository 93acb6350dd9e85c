"""Durations in clauses: C-SPARQL's ``5s``, RSP-QL's ``PT5S`` and ``"PT5S"^^xsd:duration``."""

from __future__ import annotations

from typing import Final

from pyoxigraph import Literal

from ...rdf.datatypes import DURATIONS
from ...sparql.cursor import Cursor
from ...sparql.tokens import Kind, Token
from ...streams.time import parse_iso_duration
from ..errors import LanguageError, Span

_UNITS: Final = {
    "ns": 1,
    "us": 1_000,
    "ms": 1_000_000,
    "s": 1_000_000_000,
    "m": 60_000_000_000,
    "h": 3_600_000_000_000,
    "d": 86_400_000_000_000,
}
_SPELLED_OUT: Final = {
    "msec": "ms",
    "millisecond": "ms",
    "sec": "s",
    "second": "s",
    "min": "m",
    "minute": "m",
    "hour": "h",
    "day": "d",
}
_LONGEST: Final = 2**62
_EXAMPLE: Final = "write a whole number and a unit (ns us ms s m h d): `5s`"
_XSD_EXAMPLE: Final = (
    "write `PT5S`, `PT0.5S` or `P1DT2H`; years and months vary in length, "
    "and nothing is finer than a nanosecond"
)


def read_duration(at: Cursor, what: str, *, spelled_out: bool = False, least: int = 1) -> int:
    """Read a duration, in ns; at least ``least``, and less than 146 years. ``spelled_out``: the
    unit may be a word, as in ``5 seconds``."""
    here = at.here
    if here is not None and here.kind is Kind.STRING:
        return _literal(at, what, least)
    if here is not None and here.kind is Kind.WORD and here.text[0] in "Pp":
        return _xsd(at, what, least)
    if here is None or here.kind is not Kind.NUMBER or not here.text.isdigit():
        raise at.expected(what, _EXAMPLE)
    at.take()
    factor = _unit(at, what, here, spelled_out=spelled_out)
    # Rejects longer texts before int(), whose cost is quadratic in the digits.
    value = int(here.text) * factor if len(here.text) <= 20 else _LONGEST
    return _in_range(at, what, value, here.span, least)


def _unit(at: Cursor, what: str, number: Token, *, spelled_out: bool) -> int:
    # Units are lower case; the engines of C-SPARQL accept upper case too.
    unit = at.here
    word = unit.text.lower() if unit is not None and unit.kind is Kind.WORD else ""
    if word in _UNITS:
        at.take()
        return _UNITS[word]
    hint = _EXAMPLE
    meant = _SPELLED_OUT.get(word.removesuffix("s"))
    if meant is not None and spelled_out:
        at.take()
        return _UNITS[meant]
    if meant is not None:
        hint = f"write `{number.text}{meant}`"
    elif word in ("", "step", "slide", "tumbling"):
        hint = f"a bare number has no unit: write `{number.text}ms` or `{number.text}s`"
    raise at.expected(f"the unit of {what}", hint)


def _xsd(at: Cursor, what: str, least: int) -> int:
    """Read ``PT0.5S``, which is several adjacent tokens."""
    start = at.take().start
    while at.here is not None and at.here.start == at.last_token.end and not at.is_mark("]"):
        at.take()
    span = Span(start, at.last_token.end)
    return _parse_xsd(at, what, at.source[span.start : span.end], span, least)


def _literal(at: Cursor, what: str, least: int) -> int:
    start = 0 if at.here is None else at.here.start
    term = at.term()
    span = Span(start, at.last_token.end)
    if not isinstance(term, Literal) or term.datatype.value not in DURATIONS:
        raise LanguageError(
            f"{what} is not an xsd:duration",
            at.source,
            span,
            'write `"PT5S"^^xsd:duration` or `PT5S`',
        )
    return _parse_xsd(at, what, term.value, span, least)


def _parse_xsd(at: Cursor, what: str, text: str, span: Span, least: int) -> int:
    try:
        value = parse_iso_duration(text)
    except ValueError:
        message = f"{what} is not a duration: `{text}`"
        raise LanguageError(message, at.source, span, _XSD_EXAMPLE) from None
    return _in_range(at, what, value, span, least)


def _in_range(at: Cursor, what: str, value: int, span: Span, least: int) -> int:
    if not least <= value < _LONGEST:
        hint = f"it is {'more than 0 and ' if least else ''}< 146 years"
        raise LanguageError(f"{what} is out of range", at.source, span, hint)
    return value
