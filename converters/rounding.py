"""Numbers of a batch that float fields change beyond the last digit (docs/reference/formats.md).

A float field holds the double nearest to the sent number (IEEE 754, ties to even), as in every
reader of decimals. This module reports two kinds of numbers that lose more: integers from 2^53 on
that no double equals, such as 9007199254740993, and numbers so close to 0 that doubles have fewer
digits there, or none, such as 1e-400. Such a number counts as *rounded* if the shortest decimal of
its double is another number.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from decimal import Decimal
from functools import cache
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from ..streams.sample import FieldType, SampleBatch
from .ndjson_lines import sample_lines
from .wire import Rounded

EXACT: Final = 2.0**53
"""Doubles represent every integer below."""
_LEAST: Final = 2.0**-1022
"""Doubles closer to 0 have fewer digits."""
_LONG: Final = 300
"""A number closer to 0 has an exponent, or more characters."""
_ZEROS: Final = b"0" * _LONG
_MINUS, _EXPONENT, _LOWER = ord("-"), ord("e"), 0x20
_SHORT: Final = 4096
"""Characters of a text up to which plain Python is faster than numpy."""
_FEW: Final = 16
"""Values up to which plain Python is faster than numpy."""


class Spelled(float):
    """A number of a JSON text whose double may be another: with its spelling."""

    spelling: str

    @classmethod
    def read(cls, spelling: str) -> float:
        """The number; a plain float where its double is as near as doubles are."""
        value = float(spelling)
        if _LEAST <= abs(value) < EXACT or (value == 0 and not _may_be_small(spelling)):
            return value
        found = cls(value)
        found.spelling = spelling
        return found


@dataclass(slots=True)
class Tally:
    """Which numbers of a table were rounded, found while it is read: again and again, perhaps."""

    rounded: Rounded | None = None

    def count(
        self,
        before: Rounded | None,
        columns: Mapping[str, Sequence[object]],
        lines: Sequence[int],
        batch: SampleBatch,
    ) -> Rounded | None:
        """What was rounded in this reading: ``before``, and in ``batch``, made of ``columns``, the
        cells or JSON values (with `Spelled`) of these ``lines``."""
        found = [
            (row, name)
            for name, rows in _suspects(batch, lambda: True).items()
            for row in rows
            if _is_rounded(batch.columns[name].values[row], columns[name][row])
        ]
        if not found:
            return before
        row, field = min(found)
        count = len(found) + (0 if before is None else before.count)
        first = (
            Rounded(count, lines[row], field) if before is None else replace(before, count=count)
        )
        if self.rounded is None or count > self.rounded.count:
            self.rounded = first
        return first


def _is_rounded(value: float, told: object) -> bool:
    match told:
        case Spelled():
            return _is_other(value, Decimal(told.spelling))
        case int():
            return _is_other(value, Decimal(told))
        case str():
            return (abs(value) >= EXACT or _may_be_small(told)) and _is_other(value, Decimal(told))
    return False


def _may_be_small(spelling: str) -> bool:
    return "e-" in spelling or "E-" in spelling or len(spelling) > _LONG


def has_small(data: bytes) -> bool:
    """Whether a JSON text may have a number closer to 0 than doubles have digits."""
    if _ZEROS in data:
        return True
    if len(data) < _SHORT:
        return b"e-" in data or b"E-" in data
    # numpy finds the few minus signs five times as fast as Python finds two characters.
    texts = np.frombuffer(data, np.uint8)
    before = texts[np.flatnonzero(texts[1:] == _MINUS)]
    return bool(((before | _LOWER) == _EXPONENT).any())


def rounded_lines(data: bytes, batch: SampleBatch) -> Rounded | None:
    """The rounded numbers of an NDJSON body; ``batch`` are its samples.

    Cost: one pass over each float column. Lines with large or tiny values are parsed again.
    """
    suspects = _suspects(batch, lambda: has_small(data))
    if not suspects:
        return None
    rows = set().union(*suspects.values())
    found: list[tuple[int, str]] = []
    for row, (line, text) in enumerate(sample_lines(data)):
        if row in rows:
            sent = json.loads(text, parse_float=Decimal, parse_int=Decimal)
            found += [
                (line, name)
                for name, places in suspects.items()
                if row in places and _is_other(batch.columns[name].values[row], sent[name])
            ]
    return Rounded(len(found), *found[0]) if found else None


def rounded_rows(columns: Mapping[str, Any], batch: SampleBatch) -> Rounded | None:
    """The rounded integers of Arrow's ``columns``, whose samples are ``batch``; lines are rows."""
    found = [
        (row + 1, name)
        for name, rows in _suspects(batch, lambda: False).items()
        if str(columns[name].type).startswith(("int", "uint"))
        for row in rows
        if _is_other(batch.columns[name].values[row], Decimal(columns[name][row].as_py()))
    ]
    return Rounded(len(found), *min(found)) if found else None


def _suspects(batch: SampleBatch, may_be_small: Callable[[], bool]) -> dict[str, set[int]]:
    """The rows of each float column with large values and, if there ``may_be_small`` ones, with
    values next to 0."""
    found = {}
    may_be_small = cache(may_be_small)
    for name, column in batch.columns.items():
        if column.type is not FieldType.FLOAT or _is_plain(column.values, may_be_small):
            continue
        size = np.abs(column.values)
        rows = size >= EXACT
        if bool((size < _LEAST).any()) and may_be_small():
            rows |= size < _LEAST
        if column.null is not None:
            rows &= ~column.null
        if bool(rows.any()):
            found[name] = set(np.flatnonzero(rows).tolist())
    return found


def _is_plain(values: NDArray[np.float64], may_be_small: Callable[[], bool]) -> bool:
    """Whether a few values are neither large nor small: cheaper here than by columns."""
    return len(values) <= _FEW and all(
        _LEAST <= abs(value) < EXACT or (value == 0 and not may_be_small())
        for value in values.tolist()
    )


def _is_other(value: float, sent: Decimal) -> bool:
    """Whether the shortest decimal of ``value`` differs from the sent number."""
    return Decimal(repr(float(value))) != sent
