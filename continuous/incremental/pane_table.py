"""Tables of panes and subjects: what a pane has of a subject, and sums over runs of panes.

`bulk_aggregation` has one for each argument of its aggregate.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...rdf.timed import Kind
from ...streams.sample import Times
from ..columns.exact_sums import FloatTotals, IntegerTotals
from ..columns.fold_kernels import mirror
from ..columns.pane_runs import PaneRuns
from ..operators.partial_aggregates import Key, Numbers, dtype_of
from .bulk_rows import Spans
from .sliding_aggregates import Pane


@dataclass(frozen=True, slots=True, eq=False)
class Cells:
    """The cells of a table of panes. ``ends``: those of its panes; ``column``: the place of each
    group, or -1; ``groups``: the group of each place."""

    runs: PaneRuns
    ends: Times
    column: NDArray[np.int64]
    groups: NDArray[np.int64]

    def of(self, pane_ends: Times, groups: NDArray[np.int32]) -> NDArray[np.int64]:
        """Return the cells of panes and groups."""
        panes = np.searchsorted(self.ends, pane_ends)
        return np.asarray(panes * self.runs.groups + self.column[groups])


class CellNumbers:
    """Sums, counts and extremes of one argument, by cell."""

    def __init__(self, key: Key, cells: Cells, extremes: bool) -> None:
        self.key = key
        self._cells = cells
        dtype = dtype_of(key)
        self._sums = np.zeros(cells.runs.cells, dtype)
        self.counts: NDArray[np.int64] = np.zeros(cells.runs.cells, np.int64)
        self._ends: NDArray[np.generic] | None = None
        if extremes:
            nothing = np.inf if dtype == np.float64 else 2**63 - 1
            self._ends = np.full((cells.runs.cells, 2), nothing, dtype)

    @property
    def is_finite(self) -> bool:
        """Whether all sums are numbers."""
        return bool(np.isfinite(self._sums).all())

    def add(self, at: NDArray[np.int64], values: NDArray[np.generic]) -> None:
        """Add rows, in order."""
        np.add.at(self._sums, at, values)
        self.counts += np.bincount(at, minlength=len(self.counts))
        if self._ends is not None:
            # This turns -0.0 into 0.0, as the fold of a single pane does.
            values = values + self._sums.dtype.type(0)
            np.minimum.at(self._ends[:, 0], at, values)
            np.minimum.at(self._ends[:, 1], at, mirror(values))

    def add_panes(self, panes: Sequence[Pane]) -> None:
        """Add folded panes. Contract: no row of them has been added."""
        if not panes:
            return
        sizes = [columns.shape[1] for _, _, columns, _ in panes]
        ends = np.repeat(np.array([end for end, *_ in panes], np.int64), sizes)
        groups = np.concatenate(
            [np.arange(columns.shape[1]) if at is None else at for _, at, columns, _ in panes]
        )
        columns = np.concatenate([columns[:2] for _, _, columns, _ in panes], axis=1)
        there = columns[1] > 0
        cells = self._cells.of(ends[there], groups[there])
        self._sums[cells] = columns[0, there]
        self.counts[cells] = columns[1, there]

    def panes_after(self, end: int) -> tuple[Times, NDArray[np.int32], NDArray[np.generic]]:
        """Return each cell with rows in a pane that ends after ``end``: the end of its pane, its
        group, and its sum and count, shape ``(2, n)``, in order of panes and groups."""
        width = self._cells.runs.groups
        first = int(np.searchsorted(self._cells.ends, end, "right"))
        cells = np.flatnonzero(self.counts[first * width :]) + first * width
        panes, places = np.divmod(cells, width)
        columns = np.stack([self._sums[cells], self.counts[cells].astype(self._sums.dtype)])
        return self._cells.ends[panes], self._cells.groups[places].astype(np.int32), columns

    def of_runs(self, alive: NDArray[np.bool_]) -> Numbers:
        """Return the values of the groups over the windows where ``alive`` is set, of shape
        ``(windows, groups)``, window by window."""
        totals = self._new_totals(self._cells.runs.cells)
        totals.add(None, self._sums, self.counts.astype(self._sums.dtype), 1)
        return self._read(totals.of_runs(self._cells.runs, alive), alive)

    def _new_totals(self, cells: int) -> IntegerTotals | FloatTotals:
        totals = IntegerTotals() if self.key[0] is Kind.INTEGER else FloatTotals()
        totals.reserve(cells)
        return totals

    def _read(self, found: IntegerTotals | FloatTotals, alive: NDArray[np.bool_]) -> Numbers:
        """Return the values of ``found`` with the extremes of the same windows and groups."""
        ends = None
        if self._ends is not None:
            ends = self._cells.runs.least(self._ends, *np.nonzero(alive))
        return Numbers(found.values(np.arange(len(found.counts))), found.counts, ends)


class DistinctNumbers(CellNumbers):
    """Sums, counts and extremes of one argument, where equal pairs of a window count once.

    What counts changes from window to window: a table of windows has what comes and what goes, and
    a window has the sum of all changes up to it.
    """

    def __init__(
        self,
        key: Key,
        cells: Cells,
        extremes: bool,
        windows: Times,
        spans: Spans,
        groups: NDArray[np.int32],
        argument: int,
    ) -> None:
        super().__init__(key, cells, extremes)
        rows, count, width = spans.rows, len(windows), cells.runs.groups
        # A pair is there from its pane on: so it counts among the rows of that pane.
        self.counts += np.bincount(cells.of(rows.times, groups), minlength=len(self.counts))
        self._spans = PaneRuns(count, width, np.zeros(count, np.int64), np.arange(1, count + 1))
        self._changes = self._new_totals(self._spans.cells)
        first, after = (np.searchsorted(windows, each) for each in (rows.times, spans.until))
        values, places = rows.arguments[argument].values, cells.column[groups]
        for at, sign in ((first, 1), (after, -1)):
            # A pair in no window of the pass changes nothing.
            some = np.flatnonzero((first < after) & (at < count))
            self._changes.add(at[some] * width + places[some], values[some], None, sign)

    def of_runs(self, alive: NDArray[np.bool_]) -> Numbers:
        return self._read(self._changes.of_runs(self._spans, alive), alive)
