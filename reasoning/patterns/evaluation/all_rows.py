"""Every match of a plan without repetition: chronicles, EP-SPARQL, and any match of SASE+
(SPEC §8).

The join (`join_loop`) finds a match from its last row. A match whose probes later rows may still
change waits (`waiting`) until the watermark has passed the last of them.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..plans.limits import DEFAULT_LIMITS, Limits
from ..plans.network import minimal_network
from ..plans.plan import PatternPlan
from ..plans.row_values import Row
from .conditions import COLUMNS, END
from .evaluator import Evaluator
from .join_loop import ask, join, scratch
from .outputs import output_columns
from .packing import OF, pack
from .store import SMALLEST

Integers = NDArray[np.int64]


class AllRows(Evaluator):
    """Every match of a plan, in order of decision.

    ``is_ordered``: rows come in order of their ends, and a row behind the last one is late.
    Otherwise only a row behind the watermark that `advance` was given is late; such plans have no
    probes. ``part``: a column of keys that numbers the part of a row; see `Store`. `PartRows` sets
    their times.

    Law (tests/laws/reasoning/patterns/test_pattern_joins.py): the matches are those of the
    definition, each once, in the order of `Evaluator`, however the rows are cut into batches.

    Cost: O(log) a look-up, and O(1) for each row looked at and match; the plan decides how many.

    Raises `PlanError`.
    """

    def __init__(
        self,
        plan: PatternPlan,
        *,
        is_ordered: bool = True,
        limits: Limits = DEFAULT_LIMITS,
        capacity: int = SMALLEST,
        part: str | None = None,
    ) -> None:
        network = minimal_network(plan)
        self._packed = packed = pack(plan, network, is_ordered=is_ordered)
        count = len(plan.elements)
        word = 0 if part is None else COLUMNS + packed.columns.index(part)
        super().__init__(plan, network, packed, count, limits, capacity, part_word=word)
        self._is_ordered = is_ordered
        self._has_one_last = is_ordered and len(packed.triggers) == 1
        distinct, intervals = int(plan.is_distinct), int(plan.has_intervals)
        most = self._most_matches
        settings = [count, intervals, distinct, int(is_ordered), most, limits.candidates, word]
        self._settings = np.array(settings, np.int64)
        self._scratch = scratch(packed.buffers)

    def _way(self) -> str:
        order = "" if self._is_ordered else ", in any order of arrival"
        return "evaluated by a join from the last row" + order

    def rows(self, part: int = 0) -> list[list[Row]]:
        """The rows in memory that suit each element, then each probe; of the element that always
        comes last there are none. With parts, those of ``part``."""
        buffers = self._packed.buffers[:, OF].tolist()
        count = len(self.plan.elements) + len(self.plan.probes)
        return [
            self._rows_in(buffers.index(of), part) if of in buffers else [] for of in range(count)
        ]

    def _take(self, batch: Integers, kind: Integers, begin: int) -> int:
        packed, store = self._packed, self._store
        conditions = packed.conditions
        return join(
            batch,
            kind,
            begin,
            self._settings,
            packed.kinds,
            packed.own,
            packed.triggers,
            packed.levels,
            packed.greatest,
            packed.buffers,
            packed.probes,
            packed.hulls,
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
            self._out,
            self._due,
            *self._scratch,
        )

    def _ends(self, rows: Integers) -> Integers:
        ends = self._store.table[:, END]
        if self._has_one_last:
            return ends[self._last(rows)]
        found = ends[rows[:, 0]]
        for element in range(1, rows.shape[1]):
            np.maximum(found, ends[rows[:, element]], out=found)
        return found

    def _last(self, records: Integers) -> Integers:
        if self._has_one_last:
            return records[:, self._packed.triggers[0]]
        # Rows arrive in the order of their places in the table.
        last: Integers = records.max(axis=1)
        return last

    def _ask(self, records: Integers, hold: NDArray[np.bool_]) -> None:
        packed, store = self._packed, self._store
        conditions = packed.conditions
        ask(
            records,
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
        return output_columns(self.plan, self._packed.columns, self._store.table, records)

    def _order(self, rows: Integers) -> Integers | None:
        if self._packed.is_sorted:
            return None
        keys: list[Integers] = []
        for element in reversed(range(rows.shape[1])):
            keys.append(rows[:, element])
            if not self._is_ordered:
                keys.append(self._store.table[rows[:, element], END])
        # Rows arrive in the order of their places in the table.
        return np.lexsort([*keys, rows.max(axis=1)])
