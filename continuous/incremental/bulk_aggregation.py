"""The aggregates of windows that are due at once, in one pass over their rows.

`aggregation` follows one window after the other, some twenty calls of numpy each. Here the panes of
all windows are one table (`pane_runs`), and each window is a run of panes. Law: the rows of a
window's end are those of `IncrementalAggregate`, in the same order, to the last bit.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ...rdf.timed import Kind, ObjectColumn, TripleRows
from ...streams.sample import Times
from ..algebra.expressions import Var
from ..columns.pane_runs import PaneRuns
from ..columns.relation import Relation, bits, concatenate
from ..operators.partial_aggregates import Key, Partial
from ..operators.result_forms import END
from ..windows.grid import Grid
from .aggregation import IncrementalAggregate
from .bulk_rows import SelectedRows, Spans
from .distinct_pairs import DistinctPairs
from .pane_table import CellNumbers, Cells, DistinctNumbers
from .sliding_aggregates import Pane

CELLS: Final = 2**16
"""The number of cells of a table of panes: some milliseconds, at 50 to 100 bytes each."""
PASS: Final = 4_500
WINDOW: Final = 650
ROW: Final = 0.7
"""What a pass costs, without its cells, and what a lone window and each of its rows cost, in cells
of a table (`python bench/queries/windows.py bulk`; a cell costs some 100 ns)."""


def fitting(
    aggregate: IncrementalAggregate,
    ends: int,
    panes: int,
    step: int,
    tables: Sequence[TripleRows],
) -> int:
    """Return how many of ``ends`` windows with rows in ``tables`` one pass covers; less than 2 if
    it would save nothing. ``panes``: the number of panes of a window; ``step``: of a step."""
    seen = np.zeros(len(aggregate.terms.dictionary), np.bool_)
    for table in tables:
        seen[table.subject] = True
    folded = aggregate.partials[0].rows(slice(aggregate.groups.used))
    groups = max(1, int(np.count_nonzero(seen)), int(np.count_nonzero(folded)))
    most = (CELLS // groups - panes) // step
    if most < 2:
        return 0
    # Passes of equal size: the last one should not be left with windows that save nothing.
    count = math.ceil(ends / math.ceil(ends / most))
    rows = sum(map(len, tables)) * count / ends
    cells = (panes + step * count) * groups
    return count if PASS + cells <= WINDOW * count + ROW * rows else 0


class BulkAggregate:
    """Windows that end at ``ends`` over ``tables``, the rows since the panes folded so far.

    ``window``: the length of a window; ``panes``: the grid of panes; ``folded``: the end of the
    last folded one. For extremes ``tables`` has the rows of the folded panes too.
    """

    def __init__(
        self,
        aggregate: IncrementalAggregate,
        ends: Sequence[int],
        window: int,
        panes: Grid,
        folded: int,
        tables: Sequence[TripleRows],
    ) -> None:
        self._aggregate = aggregate
        self.ends = ends
        self._ends = np.array(ends, np.int64)
        self._window = window
        self._grid = panes
        self._until = folded
        self._tables = tables
        self._numbers: list[CellNumbers] = []

    def relation(self, rest: Sequence[Relation]) -> Relation | None:
        """Return the solutions of the aggregate for all windows, by window, then by group; None if
        the windows must be evaluated one by one. ``rest``: the relations that the aggregate joins,
        each with the column `END` if it is not the same in all windows."""
        aggregate, shape = self._aggregate, self._aggregate.shape
        rows = SelectedRows.of(self._tables, aggregate)
        if rows is None or not aggregate.is_regular:
            return None
        spans = None
        if aggregate.distinct is not None:
            spans = self._spans(rows, aggregate.distinct)
            if spans is None:
                return None
        keys: list[Key] = [(column.kind, 0) for column in rows.arguments]
        folded = [self._folded(i, key) for i, key in enumerate(keys)]
        if any(panes is None for panes in folded) or not self._register(rows):
            return None
        present = rows if spans is None else spans.rows
        groups = self._groups(present, folded[0] or ())
        column = np.full(aggregate.groups.used + 1, -1, np.int64)
        # The last place stays -1: it answers for group -1, a subject without a group.
        column[groups] = np.arange(len(groups))
        ends = self._pane_ends(folded[0] or (), spans)
        runs = PaneRuns(
            len(ends),
            len(groups),
            np.searchsorted(ends, self._ends - self._window, "right"),
            np.searchsorted(ends, self._ends, "right"),
        )
        cells = Cells(runs, ends, column, groups)
        at = cells.of(self._pane_of(rows.times), aggregate.groups.group_of[rows.subjects])
        numbers = []
        extremes = [wanted for _, wanted in shape.arguments]
        for values, wanted, key, panes in zip(rows.arguments, extremes, keys, folded, strict=True):
            if spans is None:
                numbers.append(CellNumbers(key, cells, wanted))
                numbers[-1].add_panes(panes or ())
            else:
                known = aggregate.groups.group_of[spans.rows.subjects]
                changes = spans, known, len(numbers)
                numbers.append(DistinctNumbers(key, cells, wanted, self._ends, *changes))
            numbers[-1].add(at, values.values)
        # Differences of prefix sums need digits, and an infinite sum has none.
        if not all(each.is_finite for each in numbers):
            return None
        self._numbers = numbers
        alive = runs.sums(numbers[0].counts) > 0
        self._keep_sorts(alive, cells)
        windows, places = np.nonzero(alive)
        partials = [Partial({each.key: each.of_runs(alive)}) for each in numbers]
        columns = {END: ObjectColumn(Kind.INTEGER, windows)}
        if isinstance(shape.scan.subject, Var):
            members = aggregate.groups.members[groups[places]]
            columns[shape.scan.subject.name] = ObjectColumn(Kind.TERM, members)
        if shape.direct:
            return aggregate.finish(columns, partials, len(windows))
        subjects = Relation(columns, len(windows))
        return aggregate.grouped(subjects, partials, rest, len(self.ends))

    def hand_over(self) -> bool:
        """Give the aggregate those panes of the last window that it has not folded; call it after
        `relation`. Return False, and do nothing, if it must fold their rows: extremes and distinct
        pairs have a state of their own. Law: the aggregate is then as if it had folded them."""
        if self._aggregate.has_extremes or self._aggregate.distinct is not None:
            return False
        # Earlier panes leave before the next window, so the aggregate never needs them.
        after = max(self._until, int(self._ends[-1]) - self._window)
        for partial, numbers in zip(self._aggregate.partials, self._numbers, strict=True):
            partial.append(numbers.key, *numbers.panes_after(after))
        for facts in self._aggregate.sorts.facts:
            stated = list(facts.stated(self._tables, self._aggregate.static))
            if stated:
                times, subjects = map(np.concatenate, zip(*stated, strict=True))
                rows = np.flatnonzero(times > after)
                facts.append(self._pane_of(times[rows]), subjects[rows])
        self._aggregate.sorts.forget()
        return True

    def _folded(self, argument: int, key: Key) -> list[Pane] | None:
        """Return the folded panes that windows contain; None if columns cannot add them."""
        panes = self._aggregate.partials[argument].panes_of(key)
        if panes is None:
            return None
        if self._aggregate.has_extremes:
            return []
        low = int(self._ends[0]) - self._window
        kept = [pane for pane in panes if pane[0] > low]
        # A sum beyond 64 bits has a second part, for which a table has no column.
        return kept if all(high is None for _, _, _, high in kept) else None

    def _spans(self, rows: SelectedRows, distinct: DistinctPairs) -> Spans | None:
        """Return the distinct pairs of ``rows`` and of the folded panes; None if columns cannot add
        them."""
        aggregate, kind = self._aggregate, rows.objects.kind
        known = None if kind is Kind.TERM else distinct.last_panes(kind)
        if known is None:
            return None
        new = np.flatnonzero(rows.times > self._until)
        new_pairs = ObjectColumn(Kind.TERM, rows.subjects[new]), rows.objects.take(new)
        pairs = [
            concatenate(both, aggregate.terms.dictionary)
            for both in zip(known[0], new_pairs, strict=True)
        ]
        ends = np.concatenate([known[1], self._pane_of(rows.times[new])])
        subjects, keys = pairs[0].values, bits(pairs[1].values)
        order = np.lexsort((ends, keys, subjects))
        subjects, keys, ends = subjects[order], keys[order], ends[order]
        again = (subjects[1:] == subjects[:-1]) & (keys[1:] == keys[:-1])
        once = np.append(True, ~(again & (ends[1:] == ends[:-1])))[: len(ends)]
        again = again[once[1:]]
        ends = ends[once]
        subject, object = (column.take(order[once]) for column in pairs)
        found = SelectedRows.with_arguments(ends, (subject, object), aggregate)
        if found is None or [c.kind for c in found.arguments] != [c.kind for c in rows.arguments]:
            return None
        until = ends + self._window
        # A pair that comes again counts from its new pane on, so its earlier span ends there.
        until[:-1][again] = np.minimum(until[:-1], ends[1:])[again]
        return Spans(found, until)

    def _register(self, rows: SelectedRows) -> bool:
        """Make groups of new subjects, in the order in which one window after the other would.
        Return False if groups would be dropped between two windows."""
        groups = self._aggregate.groups
        groups.reach(len(self._aggregate.terms.dictionary))
        new = groups.group_of[rows.subjects] < 0
        subjects = rows.subjects[new]
        if not self._aggregate.has_room(len(np.unique(subjects))):
            return False
        groups.groups(subjects[np.argsort(self._pane_of(rows.times[new]), kind="stable")])
        return True

    def _groups(self, rows: SelectedRows, folded: Sequence[Pane]) -> NDArray[np.int64]:
        """Return the groups with rows, ascending."""
        marks = np.zeros(self._aggregate.groups.used, np.bool_)
        marks[self._aggregate.groups.group_of[rows.subjects]] = True
        for _, at, columns, _ in folded:
            if at is None:
                marks[: columns.shape[1]] |= columns[1] > 0
            else:
                marks[at] = True
        return np.flatnonzero(marks)

    def _pane_of(self, times: Times) -> Times:
        """Return the end of the pane of each time."""
        return times + (self._grid.origin - times) % self._grid.step

    def _pane_ends(self, folded: Sequence[Pane], spans: Spans | None) -> Times:
        """Return the ends of the panes with rows or facts, ascending."""
        low = int(self._ends[0]) - self._window
        ends = {end for end, *_ in folded}
        if spans is not None:
            ends.update(np.unique(spans.rows.times).tolist())
        for facts in self._aggregate.sorts.facts:
            ends.update(end for end, _ in facts.panes if end > low)
        parts = [self._pane_of(table.time) for table in self._tables if len(table)]
        # Most rows are in the pane of the row before.
        parts = [each[np.append(True, each[1:] != each[:-1])] for each in parts]
        return np.unique(np.concatenate([np.array(sorted(ends), np.int64), *parts]))

    def _keep_sorts(self, alive: NDArray[np.bool_], cells: Cells) -> None:
        """Clear ``alive`` where the group is not of all sorts in the window."""
        aggregate, static = self._aggregate, self._aggregate.static
        members = aggregate.groups.members[cells.groups]
        for facts in aggregate.sorts.facts:
            always = facts.holds_always(members, static)
            if always.all():
                continue
            stated = np.zeros(cells.runs.cells, np.int64)
            for ends, subjects in self._stated(facts.stated(self._tables, static), facts.panes):
                groups = aggregate.groups.group_of[subjects]
                places = cells.column[groups]
                # A fact about a subject without rows has no cell.
                known = (groups >= 0) & (places >= 0) & (ends > cells.ends[0] - 1)
                stated[cells.of(ends[known], groups[known])] = 1
            alive &= always | (cells.runs.sums(stated) > 0)

    def _stated(
        self,
        new: Iterator[tuple[Times, NDArray[np.int32]]],
        folded: Sequence[tuple[int, NDArray[np.int32]]],
    ) -> Iterator[tuple[Times, NDArray[np.int32]]]:
        """Yield the ends of the panes of facts, and their subjects."""
        for times, subjects in new:
            yield self._pane_of(times), subjects
        if folded:
            sizes = [len(subjects) for _, subjects in folded]
            ends = np.repeat(np.array([end for end, _ in folded], np.int64), sizes)
            yield ends, np.concatenate([subjects for _, subjects in folded])
