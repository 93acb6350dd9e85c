"""Spellings of times other than ISO-8601, in recorded tables: a pattern, or days before months.

A pattern has the directives of Python's ``strptime``, such as ``%d.%m.%Y %H:%M:%S``. Times without
a zone are UTC. `spelling_hint` says how a text that is no ISO-8601 can be read.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from typing import Final

from ..streams.time import MICROSECOND, TIME_MAX, TIME_MIN, parse_time
from .errors import WireError

DAY_FIRST: Final = "day-first"
_DAYS: Final = f"--time-format {DAY_FIRST}"
_EXAMPLE: Final = "%d.%m.%Y %H:%M:%S"
_YEARS: Final = ("%Y", "%y", "%G", "%c", "%x")
_EPOCH: Final = datetime(1970, 1, 1, tzinfo=UTC)
_CLOCK: Final = r"(?: +(\d\d?:\d\d)(:\d\d)?([.,]\d{1,9})?(\s*[AaPp][Mm])?)?"
_DAY_MONTH = re.compile(rf"(\d\d?)([./-])(\d\d?)\2(\d{{4}}){_CLOCK}(.*)", re.ASCII).fullmatch
_YEAR_MONTH = re.compile(rf"\d{{4}}([./])\d\d?\1\d\d?{_CLOCK}", re.ASCII).fullmatch


def time_parser(format: str) -> Callable[[str], int]:
    """A function from texts of this format to ns; it raises `ValueError` for others.

    ``format`` is a pattern, or `DAY_FIRST`: day, month and year with ``.``, ``/`` or ``-``, then a
    clock. Raises `WireError` for what is neither.
    """
    if format == DAY_FIRST:
        return _day_first
    known = f"write {DAY_FIRST}, or a pattern of strptime such as {_EXAMPLE!r}"
    if not any(year in format for year in _YEARS):
        raise WireError(None, f"the time format {format!r} has no year", known)
    try:
        datetime.strptime("", format)  # noqa: DTZ007  # only whether the pattern is one
    except ValueError as error:
        if "does not match" not in str(error):
            raise WireError(None, f"{format!r} is no time format: {error}", known) from None
    return lambda text: _by_pattern(text, format)


def spelling_hint(text: str) -> tuple[str, str]:
    """What is ambiguous in ``text``, which is no ISO-8601 (empty: nothing), and the option that
    reads it."""
    found = _DAY_MONTH(text.strip())
    if found is None:
        year = _YEAR_MONTH(text.strip())
        pattern = _EXAMPLE
        if year is not None:
            mark, *clock = year.groups()
            pattern = f"%Y{mark}%m{mark}%d{_clock(*clock)}"
        return "", f"a recording of other times is read with --time-format {pattern!r}"
    first, mark, second, _, *clock, rest = found.groups()
    after = _clock(*clock) + ("%z" if rest else "")
    months = f"--time-format {f'%m{mark}%d{mark}%Y{after}'!r}"
    days = f"--time-format {f'%d{mark}%m{mark}%Y{after}'!r}" if clock[3] else _DAYS
    if int(first) > 12:
        return "", f"a recording with days first is read with {days}"
    if int(second) > 12:
        return "", f"a recording with months first is read with {months}"
    return (
        f"{text.strip()!r} may begin with the day or with the month",
        f"say which: {days}, or {months}",
    )


def _day_first(text: str) -> int:
    found = _DAY_MONTH(text.strip())
    if found is None or found[8]:
        raise ValueError("it is no day, month and year")
    day, _, month, year, minute, second, fraction, _, zone = found.groups()
    clock = (minute or "00:00").zfill(5) + (second or ":00") + (fraction or "")
    return parse_time(f"{year}-{month:0>2}-{day:0>2}T{clock}{zone.strip()}")


def _by_pattern(text: str, format: str) -> int:
    moment = datetime.strptime(text.strip(), format)  # noqa: DTZ007  # the next line adds a zone
    if moment.tzinfo is None:
        moment = moment.replace(tzinfo=UTC)
    found = (moment - _EPOCH) // timedelta(microseconds=1) * MICROSECOND
    if not TIME_MIN <= found <= TIME_MAX:
        raise ValueError("it is outside signed 64-bit nanoseconds (years 1678 to 2262)")
    return found


def _clock(minute: str | None, second: str | None, fraction: str | None, half: str | None) -> str:
    """The pattern of a clock of these parts."""
    if minute is None:
        return ""
    hour = "%H" if half is None else "%I"
    parts = (f" {hour}:%M", second and ":%S", fraction and f"{fraction[0]}%f")
    return "".join(filter(None, parts)) + ("" if half is None else " %p" if " " in half else "%p")
