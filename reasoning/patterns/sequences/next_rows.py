"""Matches of the strategies that select the next row: skip_till_next_match, partition_contiguity,
strict_contiguity (SPEC §8; Agrawal et al. 2008, §3).

A run begins with each row that suits the first element. It takes rows as they come (`run_loop`).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..evaluation.part_rows import InParts
from ..evaluation.store import SMALLEST
from ..plans.limits import DEFAULT_LIMITS, Limits
from ..plans.plan import PatternPlan, PlanError, Selection
from .run_loop import run
from .sequences import Sequences

Integers = NDArray[np.int64]


class NextRows(Sequences):
    """The matches of runs, in order of decision.

    A run takes the first row that it can, and skips others under next match; under contiguity the
    next row ends a run that cannot take it: of the run's partition, or of all rows. Rows of sources
    that the plan does not read count, too, if they are pushed. A row that both continues a Kleene
    element and begins the next splits the run. If the last element is a Kleene element, each prefix
    of its rows makes a match. Probes are asked of matches, and do not change what a run takes. When
    a condition is tested, `run_packing` says.

    Law (tests/laws/reasoning/patterns/test_pattern_runs.py): the matches are those of the
    definition, each once, in the order of `Sequences`, however the rows are cut into batches.

    Cost: O(1) for each run of the row's keys in a state that the row may move; a run moves once a
    row.

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
        if plan.selection is Selection.ANY_MATCH:
            raise PlanError("any match is not evaluated by runs")
        super().__init__(plan, limits=limits, capacity=capacity, part=part)

    def _way(self) -> str:
        return "evaluated by runs, which take rows as they come"

    def _take(self, batch: Integers, kind: Integers, begin: int) -> int:
        packed, store, runs = self._packed, self._store, self._runs
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
            runs.runs,
            runs.runs.view(np.float64),
            runs.lists,
            runs.heads,
            runs.nodes,
            runs.counts,
            self._out,
            self._out.view(np.float64),
            self._due,
            *self._scratch,
        )


class PartNextRows(InParts, NextRows):
    """The same of each part; see `InParts`."""
