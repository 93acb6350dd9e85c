"""Aggregates over all matches by products of matrices (`product_loop`)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..evaluation.part_rows import InParts
from ..evaluation.store import SMALLEST, VECTOR_KEYS, WATERMARK, WATERMARKS
from ..plans.limits import DEFAULT_LIMITS, Limits
from ..plans.plan import PatternPlan, PlanError
from .product_loop import COUNTS, FREE, LIVE, SCRATCH, WINDOWS, run, sweep
from .trends import Trends

Integers = NDArray[np.int64]


class TrendProducts(Trends):
    """Trends whose neighbours are not compared, of rows that are instants.

    Cost: O(n²) products of cells a row, for n elements; less than that, as most entries are 0. It
    does not depend on the window. Memory: 2 n + 1 cells for each time of a key that is in the
    window, and (n + 1)² a key; a cell has 16 bytes and 56 for each element and column added up.
    """

    def __init__(
        self,
        plan: PatternPlan,
        *,
        limits: Limits = DEFAULT_LIMITS,
        capacity: int = SMALLEST,
        part: str | None = None,
    ) -> None:
        super().__init__(plan, limits=limits, capacity=capacity, part=part)
        if not self._packed.is_free(plan):
            raise PlanError("neighbours in a match are compared", "sum along the rows")
        self._size = len(plan.elements) + 1
        self._counts = np.zeros(COUNTS, np.int64)
        self._counts[FREE] = -1
        self._windows, self._heads = self._empty_windows(capacity)
        self._cells, self._cell_floats = self._empty_cells(self._cells_of(capacity))
        self._items = np.zeros((capacity, 3), np.int64)
        per_item = 2 * self._size - 1
        self._item_cells, self._item_floats = self._empty_cells(capacity * per_item)

    def _empty_windows(self, size: int) -> tuple[Integers, Integers]:
        keys = int(self._packed.keys.shape[1])
        heads = np.zeros(1 << (2 * size - 1).bit_length(), np.int64)
        return np.zeros((size, VECTOR_KEYS + keys), np.int64), heads

    def _cells_of(self, windows: int) -> int:
        return (windows + 1) * self._size**2 + SCRATCH

    def _empty_cells(self, count: int) -> tuple[Integers, NDArray[np.float64]]:
        return np.zeros((count, self._integers), np.int64), np.zeros((count, self._floats))

    @property
    def kept(self) -> int:
        """The number of rows in the table, and of times of keys in windows."""
        return super().kept + int(self._counts[LIVE])

    @property
    def size(self) -> int:
        """The bytes of all arrays."""
        return self._store.size + sum(each.nbytes for each in self._arrays())

    def _arrays(self) -> tuple[NDArray[Any], ...]:
        windows = self._windows, self._heads, self._cells, self._cell_floats
        return (*windows, self._items, self._item_cells, self._item_floats, self._counts)

    def state(self) -> tuple[Any, ...]:
        """Everything that `restore` needs; it can be pickled and does not change later."""
        return (*super().state(), tuple(each.copy() for each in self._arrays()))

    def restore(self, state: tuple[Any, ...]) -> None:
        """Continue where the evaluator of the same plan was that gave this state."""
        *others, arrays = state
        super().restore(tuple(others))
        self._windows, self._heads, self._cells, self._cell_floats, *others = (
            each.copy() for each in arrays
        )
        self._items, self._item_cells, self._item_floats, self._counts = others

    def _way(self) -> str:
        return "evaluated by products of matrices, in constant time a row"

    def _take(self, batch: Integers, kind: Integers, begin: int) -> int:
        packed, store = self._packed, self._store
        conditions = packed.conditions
        return run(
            batch,
            kind,
            begin,
            self._settings,
            packed.kinds,
            packed.own,
            packed.keys,
            packed.accumulators,
            conditions.conditions,
            conditions.factors,
            conditions.code,
            conditions.constants,
            store.table,
            store.table.view(np.float64),
            store.marks,
            store.times,
            self._windows,
            self._heads,
            self._items,
            self._item_cells,
            self._item_floats,
            self._cells,
            self._cell_floats,
            self._counts,
            self._out,
            self._out.view(np.float64),
            *self._scratch,
        )

    def _compact_store(self, made: Integers) -> None:
        self._store.compact(made[:, :1])
        counts = self._counts
        room = self._store.capacity + int(counts[WINDOWS]) // 2
        windows, heads = self._empty_windows(int(counts[WINDOWS]) + room)
        cells, floats = self._empty_cells(self._cells_of(len(windows)))
        store = self._store
        watermarks = store.times[WATERMARKS] if store.part_word else store.marks[[WATERMARK]]
        keys = self._packed.keys[0].tolist()
        part_key = keys.index(store.part_word) if store.part_word else -1
        old = self._windows, self._items, self._item_cells, self._item_floats
        products = self._cells, self._cell_floats, counts
        sweep(watermarks, part_key, self._settings, *old, *products, windows, heads, cells, floats)
        self._windows, self._heads, self._cells, self._cell_floats = windows, heads, cells, floats
        if 3 * int(counts[LIVE]) > 2 * len(self._items):
            self._items, self._item_cells, self._item_floats = (
                np.concatenate([each, np.zeros_like(each)])
                for each in (self._items, self._item_cells, self._item_floats)
            )


class PartTrendProducts(InParts, TrendProducts):
    """The same of each part; see `InParts`."""
