"""What evaluations have in common whose matches are records of runs (`runs`)."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from ..evaluation.conditions import COLUMNS, END
from ..evaluation.evaluator import Evaluator
from ..evaluation.outputs import output_columns
from ..evaluation.store import BUFFER, ROWS, SMALLEST, WATERMARK, WATERMARKS
from ..plans.limits import DEFAULT_LIMITS, Counters, Limits
from ..plans.plan import PatternPlan, Selection
from ..plans.row_values import Row
from .repetition import RunRepetition
from .run_loop import ask, scratch
from .run_packing import pack_runs, sequence_network
from .runs import HEAD, LISTS, LIVE, NEXT, UNSTARTED, Runs, width_of

Integers = NDArray[np.int64]
CONTIGUOUS: Final = (Selection.PARTITION_CONTIGUITY, Selection.STRICT_CONTIGUITY)


class Sequences(Evaluator):
    """Matches of a plan whose elements follow each other in time: a row begins after the one before
    it ends. Those of one row or time are in order of their first rows, then of their last rows,
    then of all rows of each Kleene element.

    Memory: `Store`, `Runs`, `Waiting`.
    """

    def __init__(
        self,
        plan: PatternPlan,
        *,
        limits: Limits = DEFAULT_LIMITS,
        capacity: int = SMALLEST,
        part: str | None = None,
    ) -> None:
        """``part``: a column of keys that numbers the part of a row; see `Store`."""
        network = sequence_network(plan)
        self._packed = packed = pack_runs(plan, network, part)
        word = 0 if part is None else COLUMNS + packed.columns.index(part)
        width = width_of(packed)
        super().__init__(plan, network, packed, width, limits, capacity, part_word=word)
        count = len(plan.elements)
        lasts = network.reach(count)
        self._runs = Runs(packed, lasts, capacity)
        # Row 0 has the aggregates.
        self._store.marks[ROWS] = 1
        contiguous = int(plan.selection in CONTIGUOUS)
        bits = packed.kleene, packed.listed
        most = self._most_matches, limits.candidates, limits.runs
        self._settings = np.array([count, lasts, contiguous, *bits, *most, word], np.int64)
        self._part_key = packed.keys[0].tolist().index(word) if word else -1
        self._scratch = scratch(packed.buffers, packed.keys)

    @property
    def runs(self) -> int:
        """The number of runs, of which some may have ended for want of rows."""
        return int(self._runs.counts[LIVE])

    def begun(self, part: int = 0) -> list[list[tuple[Row, Row]]]:
        """The runs that lack an element: the first and the last row of each element that they have
        bound. Some may have lasted too long. With parts, those of ``part``. Cost: Python operations
        for each run."""
        runs, count = self._runs, len(self.plan.elements)
        found = []
        for each in runs.lists[: int(runs.counts[LISTS])]:
            state, run = int(each[BUFFER]), int(each[HEAD])
            while run >= 0 and state < count - 1:
                record = runs.runs[run]
                if len(self._store.of_part(record[:1], part)):
                    places = [(int(record[e]), int(record[count + e])) for e in range(state + 1)]
                    found.append([(self._row(first), self._row(last)) for first, last in places])
                run = int(record[NEXT])
        return found

    @property
    def kept(self) -> int:
        """The number of rows in the table, of which some may be of no use any more."""
        return super().kept - 1

    @property
    def size(self) -> int:
        """The bytes of rows, candidates and runs."""
        return self._store.size + self._runs.size

    @property
    def counters(self) -> Counters:
        """What the evaluation has done, and what it has left out."""
        return replace(super().counters, unstarted=int(self._runs.counts[UNSTARTED]))

    def state(self) -> tuple[Any, ...]:
        """Everything that `restore` needs; it can be pickled and does not change later."""
        return (*super().state(), self._runs.state())

    def restore(self, state: tuple[Any, ...]) -> None:
        """Continue where the evaluator of the same plan was that gave this state."""
        *others, runs = state
        super().restore(tuple(others))
        self._runs.restore(runs)

    def _compact_store(self, made: Integers) -> None:
        store = self._store
        watermarks = store.times[WATERMARKS] if store.part_word else store.marks[[WATERMARK]]
        self._runs.capacity = store.capacity
        store.compact(*self._runs.compact(watermarks, self._part_key, self._waiting.rows, made))

    def _ends(self, records: Integers) -> Integers:
        return self._store.table[:, END][self._last(records)]

    def _last(self, records: Integers) -> Integers:
        return records[:, 2 * len(self.plan.elements) - 1]

    def _ask(self, records: Integers, hold: NDArray[np.bool_]) -> None:
        packed, store = self._packed, self._store
        conditions = packed.conditions
        ask(
            records,
            records.view(np.float64),
            self._settings,
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
            hold,
            *self._scratch,
        )

    def _outputs(self, records: Integers) -> dict[str, NDArray[Any]]:
        count = len(self.plan.elements)
        repetition = RunRepetition(self._packed, records, self._runs.nodes)
        first = records[:, :count]
        return output_columns(self.plan, self._packed.columns, self._store.table, first, repetition)

    def _order(self, records: Integers) -> Integers | None:
        if self._packed.is_sorted:
            return None
        count = len(self.plan.elements)
        # Rows arrive in the order of their places in the table.
        keys = records[:, : 2 * count].T[::-1]
        order: Integers = np.lexsort([*keys, records[:, 2 * count - 1]])
        return order
