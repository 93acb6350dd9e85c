"""Numbers of a batch that float fields change beyond the last digit (docs/reference/formats.md).

A float field holds the double nearest to the sent number (IEEE 754, ties to even), as in every
reader of decimals. This module reports two kinds of numbers that lose more: integers from 2^53 on
that no double equals, such as 9007199254740993, and numbers so close to 0 that doubles have fewer
digits there, or none, such as 1e-400. Such a number counts as *rounded* if the shortest decimal of
its double is another number.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from decimal import Decimal
from functools import cache
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from ..streams.sample import FieldType, SampleBatch
from .ndjson_lines import sample_lines
from .wire import Rounded

_EXACT: Final = 2.0**53
"""Doubles represent every integer below."""
_LEAST: Final = 2.0**-1022
"""Doubles closer to 0 have fewer digits."""
_SMALL: Final = (b"e-", b"E-", b"0" * 300)
"""The text of a number closer to 0 contains one of these."""
_FEW: Final = 16
"""Values up to which plain Python is faster than numpy."""


def rounded_lines(data: bytes, batch: SampleBatch) -> Rounded | None:
    """The rounded numbers of an NDJSON body; ``batch`` are its samples.

    Cost: one pass over each float column. Lines with large or tiny values are parsed again.
    """
    suspects = _suspects(batch, lambda: any(mark in data for mark in _SMALL))
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
        rows = size >= _EXACT
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
        _LEAST <= abs(value) < _EXACT or (value == 0 and not may_be_small())
        for value in values.tolist()
    )


def _is_other(value: float, sent: Decimal) -> bool:
    """Whether the shortest decimal of ``value`` differs from the sent number."""
    return Decimal(repr(float(value))) != sent
