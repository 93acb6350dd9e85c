"""Aggregates over all matches without listing them: ``COUNT(*)``, ``SUM(b[].v)`` and so on, under
skip_till_any_match (SPEC §8; GRETA, Poppe et al. 2017).

There is a result for each row that ends matches. `TrendProducts` compute them in constant time a
row; where neighbours in a match are compared, `TrendSums` do, from the rows of the window.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..evaluation.conditions import COLUMNS, END
from ..evaluation.evaluator import Evaluator
from ..evaluation.outputs import output_columns
from ..evaluation.store import SMALLEST
from ..plans.limits import DEFAULT_LIMITS, Counters, Limits
from ..plans.plan import NO_VALUE, Function, PatternPlan, Trend
from ..plans.rows import Values
from .run_loop import COUNT, KLEENE, LASTS, MOST_CANDIDATES, MOST_RUNS, PART_WORD
from .run_packing import OF_NUMBERS, sequence_network
from .trend_loop import FLOAT_WORDS, HAS_INTERVALS, INTEGER_WORDS, scratch
from .trend_packing import accumulators, is_start, pack_trends

Integers = NDArray[np.int64]
_EXACT = 2.0**62
"""Below this the integers of cells are right; the floats may be wrong by some 2^-50 of them."""


class Trends(Evaluator):
    """Aggregates over all matches that end at a row, for each such row that has any.

    The elements follow each other in time: a row begins after the one before it ends. ``count`` of
    an element is the number of its rows in all matches, ``sum`` and ``avg`` are over all of these;
    values that are missing do not count. A number of matches or rows from 2^62 on is a float,
    as are all of the same batch; such results are counted (`Counters.rounded`). From 10^308 on it
    is infinite, and sums and averages of its matches are missing. A result's only row in `Matches`
    is the one that ends its matches.

    Law (tests/laws/reasoning/patterns/test_pattern_trends.py): the aggregates are those of all
    matches of the definition, however the rows are cut into batches.

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
        """``part``: a column of keys that numbers the part of a row; see `Store`."""
        network = sequence_network(plan)
        self._packed = packed = pack_trends(plan, network, part)
        word = 0 if part is None else COLUMNS + packed.columns.index(part)
        added = len(packed.accumulators)
        self._integers, self._floats = 1 + INTEGER_WORDS * added, 1 + FLOAT_WORDS * added
        width = 1 + self._integers + self._floats
        super().__init__(
            plan, network, packed, width, limits, capacity, rows_given=1, part_word=word
        )
        count = len(plan.elements)
        self._settings = np.zeros(HAS_INTERVALS + 1, np.int64)
        self._settings[[COUNT, LASTS, KLEENE]] = count, network.reach(count), packed.kleene
        self._settings[[MOST_CANDIDATES, MOST_RUNS]] = limits.candidates, limits.rows
        self._settings[[PART_WORD, HAS_INTERVALS]] = word, plan.has_intervals
        self._rounded = 0
        self._scratch = scratch(packed.buffers, packed.keys)

    @property
    def counters(self) -> Counters:
        """What the evaluation has done, and what it has left out."""
        return replace(super().counters, rounded=self._rounded)

    def state(self) -> tuple[Any, ...]:
        """Everything that `restore` needs; it can be pickled and does not change later."""
        return (*super().state(), self._rounded)

    def restore(self, state: tuple[Any, ...]) -> None:
        """Continue where the evaluator of the same plan was that gave this state."""
        *others, self._rounded = state
        super().restore(tuple(others))

    def _ends(self, records: Integers) -> Integers:
        return self._store.table[:, END][records[:, 0]]

    def _order(self, records: Integers) -> Integers | None:
        return None

    def _last(self, records: Integers) -> Integers:
        return records[:, 0]

    def _ask(self, records: Integers, hold: NDArray[np.bool_]) -> None:
        raise AssertionError("no match of trends waits")

    # -- results -----------------------------------------------------------------------------

    def _outputs(self, records: Integers) -> dict[str, NDArray[Any]]:
        plan = self.plan
        rows = np.repeat(records[:, :1], len(plan.elements), axis=1)
        found = output_columns(plan, self._packed.columns, self._store.table, rows)
        for output in filter(is_start, plan.outputs):
            found[output.name] = records[:, 1 + 2].copy()
        for trend in plan.trends:
            found[trend.name] = self._trend(trend, records)
        return found

    def _trend(self, trend: Trend, records: Integers) -> Values:
        integers, numbers = records[:, 1:], records.view(np.float64)[:, 1 + self._integers :]
        if trend.element is None:
            return self._count(integers[:, 0], numbers[:, 0])
        k = accumulators(self.plan).index((trend.element, trend.column))
        k += any(map(is_start, self.plan.outputs))
        i, f = INTEGER_WORDS * k + 1, FLOAT_WORDS * k + 1
        counts = numbers[:, f]
        least, greatest = numbers[:, f + 2], numbers[:, f + 3]
        has_values = least <= greatest
        match trend.function:
            case Function.COUNT:
                return self._count(integers[:, i], counts)
            case Function.SUM | Function.AVG:
                with np.errstate(invalid="ignore"):
                    divisor = counts if trend.function is Function.AVG else np.ones_like(counts)
                    is_finite = has_values & (counts < np.inf)
                    return np.where(is_finite, numbers[:, f + 1] / divisor, np.nan)
        is_least = trend.function is Function.MIN
        if self._packed.accumulators[k, OF_NUMBERS]:
            return np.where(has_values, least if is_least else greatest, np.nan)
        return np.where(has_values, integers[:, i + (1 if is_least else 2)], NO_VALUE)

    def _count(self, exact: Integers, rounded: NDArray[np.float64]) -> Values:
        is_rounded = ~(rounded < _EXACT)
        if not is_rounded.any():
            return exact.copy()
        self._rounded += int(is_rounded.sum())
        # Infinite numbers of trends without a value give NaN.
        return np.where(is_rounded, np.nan_to_num(rounded, nan=np.inf, posinf=np.inf), exact)
