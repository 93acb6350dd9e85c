"""Aggregates over all matches, by sums along the rows before each one that ends some."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..evaluation.part_rows import InParts
from ..evaluation.store import SMALLEST
from ..plans.limits import DEFAULT_LIMITS, Limits
from ..plans.plan import PatternPlan
from .trend_loop import ROOM_NEEDED, run
from .trends import Trends

Integers = NDArray[np.int64]


class TrendSums(Trends):
    """Trends whose neighbours may be compared.

    Cost: O(1) a row; of one that ends matches O(n) for n rows of its keys that may stand in them,
    where a condition on neighbours is tested O(n²). Memory: `Store`, and two cells for each of n.
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
        self._needs = np.zeros(1, np.int64)
        self._make_cells(capacity)

    def _make_cells(self, rows: int) -> None:
        """Make cells for two elements with this many rows, and three more."""
        size = 2 * rows + 3
        self._cells = np.zeros((size, self._integers), np.int64)
        self._cell_floats = np.zeros((size, self._floats), np.float64)
        self._places = np.zeros(size, np.int64)

    def _way(self) -> str:
        return "evaluated by sums along the rows before each row that ends matches"

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
            packed.steps,
            packed.accumulators,
            packed.buffers,
            conditions.conditions,
            conditions.factors,
            conditions.code,
            conditions.constants,
            store.table,
            store.table.view(np.float64),
            store.ends,
            store.rows,
            store.vectors,
            store.heads,
            store.marks,
            store.times,
            self._cells,
            self._cell_floats,
            self._places,
            self._needs,
            self._out,
            self._out.view(np.float64),
            *self._scratch,
        )

    def _compact_store(self, made: Integers) -> None:
        needed = int(self._needs[ROOM_NEEDED])
        if 2 * needed + 3 > len(self._cells):
            self._make_cells(2 * needed)
        self._store.compact(made[:, :1])


class PartTrendSums(InParts, TrendSums):
    """The same of each part; see `InParts`."""
