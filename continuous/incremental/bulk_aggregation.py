"""The aggregates of windows that are due at once, in one pass over their rows.

`aggregation` follows one window after the other, some twenty calls of numpy each. Here the panes of
all windows are one table (`pane_runs`), and each window is a run of panes. Law: the rows of a
window's end are those of `IncrementalAggregate`, in the same order, to the last bit.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ...rdf.timed import Kind, ObjectColumn, TripleRows
from ...streams.sample import Times
from ..algebra.expressions import Var
from ..columns.exact_sums import FloatTotals, IntegerTotals
from ..columns.fold_kernels import mirror
from ..columns.pane_runs import PaneRuns
from ..columns.relation import Pairs, Relation, bits, concatenate
from ..operators.partial_aggregates import (
    GREAT,
    SAFE,
    Key,
    Numbers,
    Partial,
    dtype_of,
    magnitude,
)
from ..operators.result_forms import END
from ..windows.grid import Grid
from .aggregation import IncrementalAggregate
from .distinct_pairs import DistinctPairs
from .sliding_aggregates import Pane

CELLS: Final = 2**16
"""The number of cells of a table of panes: some milliseconds, at 50 to 100 bytes each."""
PASS: Final = 4_500
WINDOW: Final = 650
ROW: Final = 0.7
"""What a pass costs, without its cells, and what a lone window and each of its rows cost, in cells
of a table (`python bench/windows.py bulk`; a cell costs some 100 ns)."""
_KINDS: Final = (Kind.INTEGER, Kind.FLOAT, Kind.DOUBLE)


@dataclass(frozen=True, slots=True, eq=False)
class _Rows:
    """Rows of the folded predicate that the aggregate selects, in order within each pane and
    subject, with a column for each of its arguments, of one kind of number each."""

    times: Times
    subjects: NDArray[np.int32]
    objects: ObjectColumn
    arguments: list[ObjectColumn]

    @classmethod
    def of(cls, tables: Sequence[TripleRows], aggregate: IncrementalAggregate) -> _Rows | None:
        """Return those in ``tables``; None if there are none to select from, or if a value is not
        a number of its column's kind."""
        predicate = aggregate.terms.dictionary.find(aggregate.shape.scan.predicate)
        times, subjects, objects = [], [], []
        for table in tables:
            column = table.objects.get(predicate)
            if column is None:
                continue
            rows = slice(None) if column.null is None else np.flatnonzero(column.present)
            times.append(table.time[rows])
            subjects.append(table.subject[rows])
            objects.append(ObjectColumn(column.kind, column.values[rows]))
        if len({column.kind for column in objects}) != 1 or not sum(map(len, times)):
            return None
        time = np.concatenate(times)
        pairs = (
            ObjectColumn(Kind.TERM, np.concatenate(subjects)),
            concatenate(objects, aggregate.terms.dictionary),
        )
        if not aggregate.shape.plain:
            selected = aggregate.selected(pairs)
            pairs = pairs[0].take(selected), pairs[1].take(selected)
            time = time[selected]
        return cls.with_arguments(time, pairs, aggregate)

    @classmethod
    def with_arguments(
        cls, times: Times, pairs: Pairs, aggregate: IncrementalAggregate
    ) -> _Rows | None:
        """Return these pairs with the arguments; None if a value is not a number of its column's
        kind, or if sums might overflow."""
        arguments = aggregate.arguments(pairs)
        if any(column.null is not None or column.kind not in _KINDS for column in arguments):
            return None
        rows = cls(times, pairs[0].values, pairs[1], arguments)
        return rows if rows.are_safe() else None

    def are_safe(self) -> bool:
        """Whether no sum of them overflows or needs more than float64."""
        return not len(self.times) or all(
            magnitude(column.values) * len(column) < SAFE
            if column.kind is Kind.INTEGER
            # This is False if there is a NaN.
            else -GREAT < column.values.min() <= column.values.max() < GREAT
            for column in self.arguments
        )


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
        self._numbers: list[_Numbers] = []

    def relation(self, rest: Sequence[Relation]) -> Relation | None:
        """Return the solutions of the aggregate for all windows, by window, then by group; None if
        the windows must be evaluated one by one. ``rest``: the relations that the aggregate joins,
        each with the column `END` if it is not the same in all windows."""
        aggregate, shape = self._aggregate, self._aggregate.shape
        rows = _Rows.of(self._tables, aggregate)
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
        column[groups] = np.arange(len(groups))
        ends = self._pane_ends(folded[0] or (), spans)
        runs = PaneRuns(
            len(ends),
            len(groups),
            np.searchsorted(ends, self._ends - self._window, "right"),
            np.searchsorted(ends, self._ends, "right"),
        )
        cells = _Cells(runs, ends, column, groups)
        at = cells.of(self._pane_of(rows.times), aggregate.groups.group_of[rows.subjects])
        numbers = []
        extremes = [wanted for _, wanted in shape.arguments]
        for values, wanted, key, panes in zip(rows.arguments, extremes, keys, folded, strict=True):
            if spans is None:
                numbers.append(_Numbers(key, cells, wanted))
                numbers[-1].add_panes(panes or ())
            else:
                known = aggregate.groups.group_of[spans.rows.subjects]
                changes = spans, known, len(numbers)
                numbers.append(_DistinctNumbers(key, cells, wanted, self._ends, *changes))
            numbers[-1].add(at, values.values)
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
        return kept if all(high is None for _, _, _, high in kept) else None

    def _spans(self, rows: _Rows, distinct: DistinctPairs) -> _Spans | None:
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
        found = _Rows.with_arguments(ends, (subject, object), aggregate)
        if found is None or [c.kind for c in found.arguments] != [c.kind for c in rows.arguments]:
            return None
        until = ends + self._window
        until[:-1][again] = np.minimum(until[:-1], ends[1:])[again]
        return _Spans(found, until)

    def _register(self, rows: _Rows) -> bool:
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

    def _groups(self, rows: _Rows, folded: Sequence[Pane]) -> NDArray[np.int64]:
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

    def _pane_ends(self, folded: Sequence[Pane], spans: _Spans | None) -> Times:
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

    def _keep_sorts(self, alive: NDArray[np.bool_], cells: _Cells) -> None:
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


@dataclass(frozen=True, slots=True, eq=False)
class _Spans:
    """Distinct pairs: ``rows`` has each once a pane, at the pane's end. It counts in the windows
    that end then or later, and before ``until``: when it leaves the window, or comes again."""

    rows: _Rows
    until: Times


@dataclass(frozen=True, slots=True, eq=False)
class _Cells:
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


class _Numbers:
    """Sums, counts and extremes of one argument, by cell."""

    def __init__(self, key: Key, cells: _Cells, extremes: bool) -> None:
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


class _DistinctNumbers(_Numbers):
    """Sums, counts and extremes of one argument, where equal pairs of a window count once.

    What counts changes from window to window: a table of windows has what comes and what goes, and
    a window has the sum of all changes up to it.
    """

    def __init__(
        self,
        key: Key,
        cells: _Cells,
        extremes: bool,
        windows: Times,
        spans: _Spans,
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
            some = np.flatnonzero((first < after) & (at < count))
            self._changes.add(at[some] * width + places[some], values[some], None, sign)

    def of_runs(self, alive: NDArray[np.bool_]) -> Numbers:
        return self._read(self._changes.of_runs(self._spans, alive), alive)
