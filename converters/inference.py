"""Types of fields and units of time, inferred from the columns of a table.

Used for recordings; samples that are published are checked against the stream's schema instead.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from decimal import Decimal, InvalidOperation
from typing import Final

import numpy as np

from ..streams.sample import FieldType, Times
from ..streams.time import (
    MICROSECOND,
    MILLISECOND,
    NANOSECOND,
    SECOND,
    TIME_MAX,
    TIME_MIN,
)
from .errors import WireError
from .time_format import spelling_hint, time_parser
from .wire import TIME_HINT, TIME_RANGE_HINT, shown, time_of

TIME_NAMES: Final = ("valid", "timestamp", "time", "t")
TIME_UNITS: Final = {"s": SECOND, "ms": MILLISECOND, "us": MICROSECOND, "ns": NANOSECOND}

_INTEGER = re.compile(r"[+-]?(?:0|[1-9]\d{0,17})", re.ASCII).fullmatch
# A bare exponent (4841e3) is no number here: hexadecimal addresses look like that.
_FLOAT = re.compile(
    r"[+-]?(?:(?:(?:0|[1-9]\d*)\.\d*|\.\d+)(?:[eE][+-]?\d+)?|(?:0|[1-9]\d{0,17})(?:[eE][+-]\d+)?)",
    re.ASCII,
).fullmatch
_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?", re.ASCII).fullmatch
TRUTH: Final = {
    "true": True,
    "True": True,
    "TRUE": True,
    "false": False,
    "False": False,
    "FALSE": False,
}
# Years that 64 bits of ns hold whole.
_PLAIN_TIME = r"(?:1[7-9]|2[01])\d\d-\d\d-\d\dT\d\d:\d\d:\d\d(?:\.\d{1,9})?Z"
_PLAIN_TIMES = re.compile(rf"{_PLAIN_TIME}(?:\n{_PLAIN_TIME})*", re.ASCII).fullmatch
_DOUBLE_DIGITS: Final = 300
"""A number of no more digits is one of a double."""
_OBJECT_NAME = re.compile(
    r"(?:.*[_\-. ])?(?:id|uid|uuid|icao|icao24|hex|mmsi|imo|callsign|registration|squawk)"
    r"|.*[a-z]I[dD]"
).fullmatch


def names_objects(name: str) -> bool:
    """Whether a column of this name has the names of objects: ``id``, ``icao24``, ``vehicleId``."""
    return bool(_OBJECT_NAME(name.lower()) or _OBJECT_NAME(name))


class TextColumnType:
    """The narrowest type for all non-empty cells so far: integer, float, boolean, else text.

    A column with the name of an identifier is text whatever its cells are. So is a column with
    leading zeros or more digits than 64 bits hold.
    """

    def __init__(self, name: str) -> None:
        numbers = {FieldType.INTEGER, FieldType.FLOAT, FieldType.BOOLEAN}
        self._may_be = set() if names_objects(name) else numbers
        self._seen = False
        self.may_overflow = False
        """Whether a number may be too large for a double."""

    def observe(self, cells: Iterable[str]) -> None:
        """Narrow by more cells of the column."""
        if not self._may_be:
            return
        distinct = set(cells)
        distinct.discard("")
        if not distinct:
            return
        self._seen = True
        tests = (
            (FieldType.INTEGER, _INTEGER),
            (FieldType.FLOAT, _FLOAT),
            (FieldType.BOOLEAN, TRUTH.get),
        )
        for type, test in tests:
            if type in self._may_be and not all(test(cell) is not None for cell in distinct):
                self._may_be.discard(type)
        spelled = "".join(distinct)
        if "e" in spelled or "E" in spelled or max(map(len, distinct)) > _DOUBLE_DIGITS:
            self.may_overflow = True

    @property
    def type(self) -> FieldType:
        if self._seen:
            for type in (FieldType.INTEGER, FieldType.FLOAT, FieldType.BOOLEAN):
                if type in self._may_be:
                    return type
        return FieldType.STRING


def time_column(names: Sequence[str], wanted: str | None) -> str:
    """The column of the valid time: ``wanted``, else the first of `TIME_NAMES` in the table."""
    if wanted is not None:
        if wanted not in names:
            raise WireError(
                None, f"there is no column {wanted!r}", f"the columns are {', '.join(names)}"
            )
        return wanted
    lowered = {name.lower(): name for name in reversed(names)}
    for name in TIME_NAMES:
        if name in lowered:
            return lowered[name]
    raise WireError(
        None,
        f"no column is called {', '.join(TIME_NAMES[:-1])} or {TIME_NAMES[-1]}",
        f"name the time column (--time-column); the columns are {', '.join(names)}",
    )


_EARLIEST = 1e8
"""Below this greatest time (1973 in seconds) a table has abstract times, not calendar times."""


class TimeReader:
    """Reads a table's times: numbers in one unit since 1970, or ISO-8601 texts.

    With a ``format`` (`time_format`) all texts are spelled like it. `observe` every time first: the
    greatest number then decides the unit, if none is given (years 1973 to 5138 as s; larger as ms,
    us, ns). ``abstract_unit`` is the unit of smaller numbers, as in examples.
    """

    def __init__(
        self, unit: str | None, abstract_unit: str = "s", format: str | None = None
    ) -> None:
        if unit is not None and unit not in TIME_UNITS:
            raise WireError(None, f"unknown time unit {unit!r}", f"use {', '.join(TIME_UNITS)}")
        self._unit = unit
        self._abstract_unit = abstract_unit
        self._format = format
        self._parse = None if format is None else time_parser(format)
        self._greatest = 0.0

    def observe(self, times: Iterable[object]) -> None:
        times = list(times)
        whole = _whole_numbers(times)
        if whole is not None:
            self._greatest = max(self._greatest, float(np.abs(whole).max()))
            return
        for time in times:
            if isinstance(time, str):
                if not _NUMBER(time):
                    continue
            elif isinstance(time, bool) or not isinstance(time, int | float):
                continue
            self._greatest = max(self._greatest, abs(float(time)))

    @property
    def unit(self) -> str:
        """``s``, ``ms``, ``us`` or ``ns``."""
        if self._unit is not None:
            return self._unit
        if self._greatest < _EARLIEST:
            return self._abstract_unit
        for unit, limit in (("s", 1e11), ("ms", 1e14), ("us", 1e17)):
            if self._greatest < limit:
                return unit
        return "ns"

    def read(self, times: Sequence[object], lines: Sequence[int], key: str) -> Times:
        """A column of times in ns; raises `WireError` with the line of a bad one."""
        scale = TIME_UNITS[self.unit]
        if self._parse is None:
            whole = _whole_numbers(times)
            if whole is not None and int(np.abs(whole).max()) <= TIME_MAX // scale:
                return whole * scale
            spelled = _plain_times(times)
            if spelled is not None:
                return spelled
        pairs = zip(times, lines, strict=True)
        return np.array([self._one(time, scale, line, key) for time, line in pairs], np.int64)

    def _one(self, time: object, scale: int, line: int, key: str) -> int:
        if isinstance(time, str) and (self._parse is not None or not _NUMBER(time)):
            return self._spelled(time, key, line)
        if time is None or isinstance(time, bool) or not isinstance(time, str | int | float):
            raise WireError(line, f"{key!r} is a time, got {shown(time)}", TIME_HINT)
        try:
            found = int(time) * scale
        except ValueError:
            found = _decimal_time(str(time), scale, line, key)
        else:
            if isinstance(time, float):
                found = _decimal_time(repr(time), scale, line, key)
        if not TIME_MIN <= found <= TIME_MAX:
            raise WireError(
                line,
                f"{key!r}: {shown(time)} is outside signed 64-bit nanoseconds",
                TIME_RANGE_HINT,
            )
        return found

    def _spelled(self, time: str, key: str, line: int) -> int:
        """The time of a text that is no number."""
        if self._parse is None:
            try:
                return time_of(time, key, line)
            except WireError as error:
                reason, hint = spelling_hint(time)
                told = f"{key!r}: {reason}" if reason else error.message
                raise WireError(line, told, f"{hint}; {error.hint}") from None
        try:
            return self._parse(time)
        except ValueError as error:
            raise WireError(
                line,
                f"{key!r}: {shown(time)} is no time of the format {self._format!r}: {error}",
                "every time of the table has this format",
            ) from None


def _whole_numbers(times: Sequence[object]) -> Times | None:
    """Times that are all whole numbers of 64 bits, of one kind; None if some are not, or there are
    none."""
    kinds = set(map(type, times))
    if kinds == {str}:
        digits = "".join(times)  # type: ignore[arg-type]  # all are texts
        if not (digits.isascii() and digits.isdigit()) or "" in times:
            return None
    elif kinds != {int}:
        return None
    try:
        found = np.fromiter(map(int, times), np.int64, len(times))  # type: ignore[arg-type]
    except OverflowError:
        return None
    # The absolute value of the least one does not fit.
    return None if int(found.min()) == TIME_MIN else found


def _plain_times(times: Sequence[object]) -> Times | None:
    """Times of the commonest spelling, 2021-10-07T19:12:53.5Z; None if some are not, or there are
    none: they are then read one by one."""
    if set(map(type, times)) != {str}:
        return None
    lines = "\n".join(times)  # type: ignore[arg-type]  # all are texts
    if not _PLAIN_TIMES(lines):
        return None
    try:
        found = np.array(lines.replace("Z", "").split("\n"), "datetime64[ns]")
    except ValueError:
        return None
    return found.astype(np.int64) if len(found) == len(times) else None


def _decimal_time(text: str, scale: int, line: int, key: str) -> int:
    """A fraction of the unit, rounded to the nanosecond."""
    try:
        return round(Decimal(text) * scale)
    except (InvalidOperation, OverflowError, ValueError):
        raise WireError(line, f"{key!r} is a time, got {shown(text)}", TIME_HINT) from None
