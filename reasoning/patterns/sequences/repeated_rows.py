"""Every match of a plan with repetition under skip_till_any_match, up to a number a row (SPEC §8).

There are exponentially many, so the plan has to limit them. Where numbers are enough, `trends`
count them all.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..evaluation.part_rows import InParts
from ..evaluation.store import SMALLEST
from ..plans.limits import DEFAULT_LIMITS, Limits
from ..plans.plan import PatternPlan, PlanError, Selection
from .search_loop import DEPTH_NEEDED, FRAME, search
from .sequences import Sequences

Integers = NDArray[np.int64]


class RepeatedRows(Sequences):
    """Every match, in order of decision.

    Of the matches that one row completes at most ``plan.max_matches`` are made. The search for them
    also ends after a number of rows looked at (`search_loop.SEARCHED`) for each match allowed. Rows
    that are cut short are counted.

    Law (tests/laws/reasoning/patterns/test_pattern_repetition.py): the matches are those of the
    definition, each once, in the order of `Sequences`; with a limit, some of them.

    Cost: O(1) for each row looked at and its conditions. Memory: also a record for each row of one
    match.

    Raises `PlanError`.
    """

    def __init__(
        self,
        plan: PatternPlan,
        *,
        limits: Limits = DEFAULT_LIMITS,
        capacity: int = SMALLEST,
        part: str | None = None,
    ) -> None:
        if plan.selection is not Selection.ANY_MATCH:
            raise PlanError(f"{plan.selection} is evaluated by runs")
        super().__init__(plan, limits=limits, capacity=capacity, part=part)
        self._make_stack(capacity)

    def _make_stack(self, depth: int) -> None:
        self._stack = np.zeros((depth, self._width), np.int64)
        self._frames = np.zeros((depth, FRAME), np.int64)
        self._path = np.zeros((depth, 2), np.int64)
        self._path_counts = np.zeros_like(self._runs.counts)

    def _way(self) -> str:
        return "evaluated by a search from each row that completes matches"

    def _compact_store(self, made: Integers) -> None:
        needed = int(self._path_counts[DEPTH_NEEDED])
        if needed > len(self._stack):
            self._make_stack(2 * needed)
        super()._compact_store(made)

    def _take(self, batch: Integers, kind: Integers, begin: int) -> int:
        packed, store, runs = self._packed, self._store, self._runs
        conditions = packed.conditions
        return search(
            batch,
            kind,
            begin,
            self._settings,
            packed.kinds,
            packed.own,
            packed.keys,
            packed.steps,
            packed.each,
            packed.accumulators,
            packed.aggregates,
            packed.buffers,
            packed.probes,
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
            self._stack,
            self._stack.view(np.float64),
            self._frames,
            runs.heads,
            self._path,
            self._path_counts,
            runs.nodes,
            runs.counts,
            self._out,
            self._out.view(np.float64),
            self._due,
            *self._scratch,
        )


class PartRepeatedRows(InParts, RepeatedRows):
    """The same of each part; see `InParts`."""
