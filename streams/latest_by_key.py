"""The latest sample of each of many objects, in columns that are written over in place."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .key_numbering import Numbers
from .sample import Column, Mask, SampleBatch
from .string_pool import StringPool

_LEAST = 16
"""Objects for which there is room at first."""


class Latest:
    """One row for each object; objects are numbered from 0.

    What `take` gives is a copy, so it stays as it was. Cost: O(n) numpy for n rows put or taken,
    whatever the number of objects; making room is O(1) a number in the long run. Memory: a row for
    each number up to twice the greatest; nothing of the batches that were put.
    """

    def __init__(self) -> None:
        self._there: Mask = np.zeros(0, np.bool_)
        self._rows: SampleBatch | None = None

    def __len__(self) -> int:
        return int(np.count_nonzero(self._there))

    def has(self, numbers: Numbers) -> Mask:
        """Where there is a sample, shape ``(n,)``; for numbers below that of the last `reserve`."""
        return self._there[numbers]

    def take(self, numbers: Numbers) -> SampleBatch:
        """The samples of objects that have one, a row for each of ``numbers``."""
        assert self._rows is not None
        return self._rows.take(numbers)

    def reserve(self, count: int) -> None:
        """Make room for the numbers below ``count``."""
        if count <= len(self._there):
            return
        room = max(_LEAST, 2 * count)
        self._there = _extended(self._there, room)
        if self._rows is not None:
            self._rows = _with_room(self._rows, room)

    def put(self, numbers: Numbers, batch: SampleBatch) -> None:
        """The next samples; of several of one object the last one stays. Where their texts have
        another pool than those before, all have that one from now on. Cost of that: O(objects)."""
        if self._rows is None:
            self._rows = _with_room(batch.take(slice(0, 0)), len(self._there))
        rows = self._rows
        if any(column.pool is not rows.columns[n].pool for n, column in batch.columns.items()):
            rows = self._recoded(rows, batch)
        # numpy assigns in order, so that the last of equal numbers wins.
        self._there[numbers] = True
        rows.available[numbers] = batch.available
        rows.valid[numbers] = batch.valid
        columns = {}
        for name, kept in rows.columns.items():
            column, null = batch.columns[name], kept.null
            kept.values[numbers] = column.values
            if null is None and column.null is not None:
                null = np.zeros(len(kept), np.bool_)
            if null is not None:
                null[numbers] = False if column.null is None else column.null
            columns[name] = Column(kept.type, kept.values, null, kept.pool)
        self._rows = SampleBatch(rows.available, rows.valid, columns)

    def _recoded(self, rows: SampleBatch, batch: SampleBatch) -> SampleBatch:
        """``rows`` with their texts in the codes of those of ``batch``."""
        columns = {
            name: column if (pool := batch.columns[name].pool) is None else self._in(column, pool)
            for name, column in rows.columns.items()
        }
        return SampleBatch(rows.available, rows.valid, columns)

    def _in(self, column: Column, pool: StringPool) -> Column:
        lacks = ~self._there if column.null is None else ~self._there | column.null
        codes = Column(column.type, column.values, lacks, column.pool).recoded(pool).values
        return Column(column.type, codes, column.null, pool)


def _with_room(rows: SampleBatch, room: int) -> SampleBatch:
    columns = {
        name: Column(
            column.type,
            _extended(column.values, room),
            None if column.null is None else _extended(column.null, room),
            column.pool,
        )
        for name, column in rows.columns.items()
    }
    return SampleBatch(_extended(rows.available, room), _extended(rows.valid, room), columns)


def _extended(values: NDArray[Any], room: int) -> NDArray[Any]:
    more = np.zeros(room, values.dtype)
    more[: len(values)] = values
    return more
