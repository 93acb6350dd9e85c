"""Fewer samples for slow readers: the newest sample of each object, and the minimum, maximum and
last value of each interval.

Neither is a stream operator of the papers: they answer readers outside the system. Called by
service/sse/conflation and service/routes/samples; tests/laws/streams/test_downsampling.py compares
with the definitions.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from .key_numbering import Numbers
from .sample import Column, FieldType, SampleBatch
from .tuples import Rows

MINIMUM, MAXIMUM = "_min", "_max"
"""What follows the name of a field in the names of its extremes."""
NUMBERS: Final = (FieldType.FLOAT, FieldType.INTEGER)
"""The types of fields that have extremes."""
INTEGERS: Final = np.iinfo(np.int64)
_SPARSE: Final = 4
"""Numbers per sample above which they are numbered anew."""


def object_numbers(batch: SampleBatch, keys: Sequence[str]) -> Numbers:
    """A number from 0 for the object of each sample, shape ``(n,)``: numbers are equal if and only
    if all fields ``keys`` are. Samples without a name are of one object together.

    Cost: O(n) for one key of text, else O(n log n) for each key.
    """
    numbers = np.zeros(len(batch), np.int64)
    for i, key in enumerate(keys):
        column = batch.columns[key]
        values = column.values
        if column.pool is None:
            values = np.unique(values, return_inverse=True)[1]
        named = values.astype(np.int64) + 1
        if column.null is not None:
            named[column.null] = 0
        if i and len(named):
            # Both are less than 2**31, so that no two pairs have one product.
            pairs = numbers * (int(named.max()) + 1) + named
            named = np.unique(pairs, return_inverse=True)[1]
        numbers = named
    return numbers


def newest_of_each(numbers: Numbers) -> tuple[Rows, NDArray[np.int64]]:
    """The row of the last sample of each object, increasing, and how many samples the object has.
    Cost: O(n); O(n log n) if the ``numbers`` of objects are far apart."""
    if not len(numbers):
        return np.empty(0, np.int64), np.empty(0, np.int64)
    if int(numbers.max()) >= _SPARSE * len(numbers):
        numbers = np.unique(numbers, return_inverse=True)[1]
    counts = np.bincount(numbers)
    last = np.full(len(counts), -1)
    # numpy assigns in order, so that the last of equal numbers wins.
    last[numbers] = np.arange(len(numbers))
    rows = np.sort(last[counts > 0])
    return rows, counts[numbers[rows]]


def downsampled(
    batch: SampleBatch,
    keys: Sequence[str],
    every: int,
    *,
    most: int | None = None,
    newest: bool = False,
) -> SampleBatch:
    """One sample for each object and interval of valid time [k ``every``, (k + 1) ``every``) in ns
    that has samples: that with the greatest valid time, of several the one that became available
    last.

    Each field of numbers but the ``keys`` has two more beside it, the least and the greatest value
    of the interval (`MINIMUM`, `MAXIMUM`); no_value if the interval has no value. Samples are in
    order of intervals, those of one interval in the order in which they became available. At
    ``most`` the ``newest`` of them; or the oldest and the rest of their last interval, so that the
    next piece begins after it.

    Contract: ``batch`` is in order of available time, ``every`` > 0, and `name_clash` is None.
    Cost: O(n log n). Memory: some numbers for each sample.
    """
    intervals = batch.valid // every
    objects = object_numbers(batch, keys)
    # A stable sort: equal valid times stay in the order of available time.
    order = np.lexsort((batch.valid, objects, intervals))
    begins = np.ones(len(order), np.bool_)
    begins[1:] = (np.diff(intervals[order]) != 0) | (np.diff(objects[order]) != 0)
    starts = np.flatnonzero(begins)
    last = order[np.append(starts[1:], len(order))[: len(starts)] - 1]
    sorted_groups = np.lexsort((last, intervals[last]))
    if most is not None and len(sorted_groups) > most:
        ordered = intervals[last[sorted_groups]]
        end = len(ordered) if newest else int(ordered.searchsorted(ordered[most - 1], "right"))
        sorted_groups = sorted_groups[end - most if newest else 0 : end]
    found = batch.take(last[sorted_groups])
    columns: dict[str, Column] = {}
    for name, column in found.columns.items():
        columns[name] = column
        if name not in keys and column.type in NUMBERS:
            extremes = _extremes(batch.columns[name].take(order), starts)
            for suffix, extreme in zip((MINIMUM, MAXIMUM), extremes, strict=True):
                columns[f"{name}{suffix}"] = extreme.take(sorted_groups)
    return SampleBatch(found.available, found.valid, columns)


def name_clash(batch: SampleBatch, keys: Sequence[str]) -> str | None:
    """The name of a field that `downsampled` makes and that ``batch`` has already, or None."""
    made = (
        f"{name}{suffix}"
        for name, column in batch.columns.items()
        if name not in keys and column.type in NUMBERS
        for suffix in (MINIMUM, MAXIMUM)
    )
    return next((name for name in made if name in batch.columns), None)


def _extremes(column: Column, starts: Rows) -> tuple[Column, Column]:
    """The least and the greatest value of each group of rows; groups begin at ``starts``."""
    values, null = column.values, column.null
    least = greatest = values
    if null is not None:
        is_float = column.type is FieldType.FLOAT
        low, high = (-np.inf, np.inf) if is_float else (INTEGERS.min, INTEGERS.max)
        least, greatest = np.where(null, high, values), np.where(null, low, values)
        null = np.logical_and.reduceat(null, starts)
    return (
        Column(column.type, np.minimum.reduceat(least, starts), null),
        Column(column.type, np.maximum.reduceat(greatest, starts), null),
    )
