"""The windows of clauses and the lengths of time in them: ``[RANGE 5s STEP 1s]``.

Read from tokens, as the engines write them: C-SPARQL's ``5s``, RSP-QL's ``PT5S``.
"""

from __future__ import annotations

from typing import Final

from .ast import TimeWindow, Window
from .cursor import Cursor
from .tokens import Kind

EXAMPLE: Final = "write `[RANGE 5s STEP 1s]`"
_UNITS: Final = {
    "ns": 1,
    "us": 1_000,
    "ms": 1_000_000,
    "s": 1_000_000_000,
    "m": 60_000_000_000,
    "h": 3_600_000_000_000,
    "d": 86_400_000_000_000,
}
_LONGEST: Final = 2**62


def read_window(at: Cursor, what: str, every: int | None) -> Window:
    """``[RANGE 5s STEP 1s]``, ``[RANGE 5s TUMBLING]``; no STEP: the COMPUTE EVERY period."""
    open_bracket = at.expect_mark("[", EXAMPLE)
    if at.is_word("TRIPLES"):
        raise at.error(
            "windows of a number of triples are not understood yet",
            at.here,
            "write a window of time: `[RANGE 5s STEP 1s]`",
        )
    if not at.is_word("RANGE"):
        raise at.due("RANGE", EXAMPLE)
    at.take()
    length = read_duration(at, f"the RANGE of {what}")
    if at.is_word("TUMBLING"):
        at.take()
        step = length
    elif at.is_word("STEP", "SLIDE"):
        at.take()
        step = read_duration(at, f"the STEP of {what}")
    elif every is not None:
        step = every
    else:
        raise at.error(
            "the window has no STEP, and the query no COMPUTE EVERY to take it from",
            open_bracket,
            EXAMPLE,
        )
    at.expect_mark("]", EXAMPLE)
    return TimeWindow(length, step)


def read_duration(at: Cursor, what: str) -> int:
    """``5s``, ``500ms``: a whole number and a unit, in ns."""
    hint = "write a whole number and a unit (ns us ms s m h d): `5s`"
    number = at.here
    if number is None or number.kind is not Kind.NUMBER or not number.text.isdigit():
        raise at.due(what, hint)
    at.take()
    unit = at.here
    # Units are lower case; the engines of C-SPARQL accept both.
    factor = None
    if unit is not None and unit.kind is Kind.WORD:
        factor = _UNITS.get(unit.text.lower())
    if factor is None:
        raise at.due(f"the unit of {what}", hint)
    at.take()
    # A longer text than any length of time is not handed to int().
    value = int(number.text) * factor if len(number.text) <= 20 else _LONGEST
    if not 0 < value < _LONGEST:
        raise at.error(f"{what} is out of range", number, "it is more than 0 and < 146 years")
    return value
