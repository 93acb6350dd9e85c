"""Numbers of a batch that float fields round beyond a last digit (docs/conversion.md).

A float field holds the double nearest to the number that was sent (IEEE 754, ties to even), as
every reader of decimals does. This module reports two kinds of numbers that lose more: integers
from 2^53 on that no double is, such as 9007199254740993, and numbers so near to 0 that doubles have
fewer digits there, or none, such as 1e-400. Such a number is *rounded* if the shortest decimal of
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
from ..streams.yield_points import Pauses
from .ndjson_lines import sample_lines
from .wire import Rounded

_EXACT: Final = 2.0**53
"""Every integer below is a double."""
_LEAST: Final = 2.0**-1022
"""Doubles nearer to 0 have fewer digits."""
_SMALL: Final = (b"e-", b"E-", b"0" * 300)
"""A number nearer to 0 contains one of these."""
_FEW: Final = 16
_PART: Final = 1 << 14
"""Bytes of lines that are read again before it yields to others."""


def rounded_lines(data: bytes, batch: SampleBatch, pauses: Pauses) -> Rounded | None:
    """The numbers of an NDJSON body that were rounded in ``batch``, its samples.

    Cost: a look at each float column; the lines are read again where values are large or tiny.
    """
    suspects = _suspects(batch, lambda: any(mark in data for mark in _SMALL))
    if not suspects:
        return None
    rows = set().union(*suspects.values())
    found: list[tuple[int, str]] = []
    for row, (line, text) in enumerate(sample_lines(data, pauses, _PART)):
        if row in rows:
            sent = json.loads(text, parse_float=Decimal, parse_int=Decimal)
            found += [
                (line, name)
                for name, places in suspects.items()
                if row in places and _is_other(batch.columns[name].values[row], sent[name])
            ]
    return Rounded(len(found), *found[0]) if found else None


def rounded_rows(columns: Mapping[str, Any], batch: SampleBatch) -> Rounded | None:
    """The integers of Arrow's ``columns`` that were rounded in ``batch``; ``line`` is the row."""
    found = [
        (row + 1, name)
        for name, rows in _suspects(batch, lambda: False).items()
        if str(columns[name].type).startswith(("int", "uint"))
        for row in rows
        if _is_other(batch.columns[name].values[row], Decimal(columns[name][row].as_py()))
    ]
    return Rounded(len(found), *min(found)) if found else None


def _suspects(batch: SampleBatch, may_be_small: Callable[[], bool]) -> dict[str, set[int]]:
    """The rows of each float column that have large values, and, where there ``may_be_small`` ones,
    those next to 0."""
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
    """Whether a few values are surely neither large nor small: much cheaper than columns are."""
    return len(values) <= _FEW and all(
        _LEAST <= abs(value) < _EXACT or (value == 0 and not may_be_small())
        for value in values.tolist()
    )


def _is_other(value: float, sent: Decimal) -> bool:
    """Whether the shortest decimal of ``value`` is another number than was sent."""
    return Decimal(repr(float(value))) != sent
