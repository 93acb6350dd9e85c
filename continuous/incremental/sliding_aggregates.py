"""Sliding aggregates by group: rows that come are added, rows that expire are subtracted, exactly.

The rows of a pane are folded in order (`fold_kernels.RowFold`). The sum of a window is the exact
sum of its panes' sums, rounded once (`exact_sums`). So a sum neither drifts nor depends on earlier
windows. A group without new or expired rows keeps its aggregates to the last bit, so only changed
groups need evaluation. Extremes cannot be subtracted: see `sliding_extremes`.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...rdf.timed import Kind, ObjectColumn
from ..columns.exact_sums import At, FloatTotals, IntegerTotals
from ..columns.fold_kernels import Groups, grow, mirror
from ..columns.pane_runs import equal_runs
from ..columns.relation import TermValues
from ..operators.partial_aggregates import (
    GREAT,
    Key,
    NumberFold,
    Numbers,
    Part,
    Partial,
    dtype_of,
    parts_of,
)
from ..values.exact_values import Singles
from .sliding_extremes import SlidingExtremes

Rows = NDArray[np.int64] | slice
"""Groups; a slice has only a stop."""
Pane = tuple[int, At, NDArray[Any], NDArray[np.int64] | None]
"""The end of a pane, and the result of `NumberFold.take`, sums and counts only."""


class ChangedGroups:
    """The groups whose aggregates may have changed since the last evaluation.

    Memory: a byte per group. Cost of `groups`: a pass over those bytes.
    """

    def __init__(self) -> None:
        self._marks: NDArray[np.bool_] = np.zeros(0, np.bool_)
        self.all = True

    def mark(self, at: NDArray[Any] | None) -> None:
        """Mark these groups (None: all). More rows than groups count as all."""
        if at is None or len(at) > len(self._marks):
            self.all = True
        elif not self.all:
            self._marks[at] = True

    def reserve(self, groups: int) -> None:
        """Allocate space for ``groups`` groups; new ones count as changed."""
        if len(self._marks) < groups:
            marks = np.ones(max(groups, 2 * len(self._marks)), np.bool_)
            marks[: len(self._marks)] = self._marks
            self._marks = marks

    def groups(self, used: int) -> NDArray[np.int64] | None:
        """Return the changed groups, ascending; None: all."""
        return None if self.all else np.flatnonzero(self._marks[:used])

    def clear(self) -> None:
        """Unmark all groups after their evaluation."""
        self._marks[:] = False
        self.all = False


class SlidingNumbers:
    """The values of one argument and one `Key`: sums and counts, and optionally extremes.

    Law: `numbers` covers the rows of all panes pushed and not evicted, and rows added and not
    subtracted; its extremes cover the rows of panes and those given to `hold`. Cost: see `RowFold`;
    then O(touched groups) per pane, when it comes and when it expires. Memory: two numbers (four
    with extremes) per touched group and pane.
    """

    def __init__(self, key: Key, extremes: bool, panes: int) -> None:
        self._fold = NumberFold(key, extremes)
        self.panes: deque[Pane] = deque()
        self._totals: IntegerTotals | FloatTotals = (
            IntegerTotals() if key[0] <= Kind.DECIMAL else FloatTotals()
        )
        self._sliding = SlidingExtremes(dtype_of(key), panes) if extremes else None
        self._held: NDArray[Any] | None = None

    def counts_of(self, rows: Rows) -> NDArray[np.int64]:
        """Return the number of rows of each of the groups ``rows``."""
        self._totals.reserve(_above(rows))
        return self._totals.counts[rows]

    def fold(self, part: Part, groups: Groups) -> None:
        """Fold rows of the present pane."""
        self._fold.add(part.subjects, part.values, part.skip, groups)

    def fold_pane(
        self,
        end: int,
        subjects: NDArray[np.int32],
        values: NDArray[np.float64],
        groups: Groups,
        touched: ChangedGroups,
    ) -> bool:
        """Fold the rows of a whole pane and end it, which is `fold` and `push` in one compiled
        call; return False, and change nothing, if that cannot fold them."""
        totals, sliding = self._totals, self._sliding
        if not isinstance(totals, FloatTotals):
            return False
        extremes = sliding is not None
        found = totals.fold_pane(subjects, values, GREAT, groups, extremes=extremes)
        if found is None:
            return False
        at, columns = found
        touched.reserve(groups.used)
        touched.mark(at)
        if sliding is not None:
            sliding.reserve(groups.used)
            sliding.push(end, at, columns[2:].T.copy())
            # This is a copy, since a view would keep the extremes as long as the pane.
            columns = columns[:2].copy()
        self.panes.append((end, at, columns, None))
        return True

    def present(
        self, used: int, of: NDArray[np.bool_] | None
    ) -> tuple[NDArray[np.int64], Numbers] | None:
        """Return those of the first ``used`` groups that have rows, and are in ``of`` if that is
        given, with their values. None: these need several calls."""
        if not isinstance(self._totals, FloatTotals):
            return None
        rows, sums, counts = self._totals.present(used, of)
        return rows, Numbers(sums, counts, self._ends(rows, used))

    def abandon(self, used: int) -> None:
        """Drop the rows of the present pane."""
        self._fold.take(used)

    def push(self, end: int, used: int, touched: ChangedGroups, *, distinct: bool) -> None:
        """End the present pane. ``distinct``: push its extremes only; `add` adds sums by rows."""
        at, columns, high = self._fold.take(used)
        if not columns.shape[1]:
            return
        touched.mark(at)
        if self._sliding is not None:
            self._sliding.reserve(used)
            self._sliding.push(end, at, columns[2:].T.copy())
            columns = columns[:2].copy()
        if not distinct:
            self.panes.append((end, at, columns, high))
            self._add(at, columns, high, 1)

    def append(self, ends: NDArray[np.int64], at: NDArray[np.int32], columns: NDArray[Any]) -> None:
        """Add folded panes: the end of the pane of each group ``at[i]``, ascending, and its sum and
        count. Contract: there are no extremes."""
        self._totals.reserve(int(at.max(initial=-1)) + 1)
        self._totals.add(at, columns[0], columns[1], 1)
        for rows in equal_runs(ends):
            self.panes.append((int(ends[rows.start]), at[rows], columns[:, rows], None))

    def evict(self, until: int, touched: ChangedGroups) -> None:
        """Evict the panes that end at or before ``until``."""
        while self.panes and self.panes[0][0] <= until:
            _, at, columns, high = self.panes.popleft()
            touched.mark(at)
            # Sums are exact, so the rest is the sum without the pane to the last bit.
            self._add(at, columns, high, -1)
        if self._sliding is not None:
            for at in self._sliding.evict(until):
                touched.mark(at)

    def add(self, at: NDArray[np.int32], values: NDArray[Any], sign: int) -> None:
        """Add (1) or subtract (-1) rows in sums and counts."""
        self._totals.reserve(int(at.max(initial=-1)) + 1)
        self._totals.add(at, values, None, sign)

    def hold(self, at: NDArray[np.int32], values: NDArray[Any]) -> None:
        """Include rows that do not expire in the extremes."""
        if self._sliding is not None:
            size = 0 if self._held is None else len(self._held)
            held = self._sliding.nothing(max(size, int(at.max(initial=-1)) + 1))
            if self._held is not None:
                held[: len(self._held)] = self._held
            np.minimum.at(held[:, 0], at, values)
            np.minimum.at(held[:, 1], at, mirror(values))
            self._held = held

    def release(self) -> None:
        """Drop the rows given to `hold`."""
        self._held = None

    def numbers(self, rows: NDArray[np.int64]) -> Numbers:
        """Return the values of the groups ``rows``."""
        used = int(rows.max(initial=-1)) + 1
        self._totals.reserve(used)
        return Numbers(self._totals.values(rows), self._totals.counts[rows], self._ends(rows, used))

    def _ends(self, rows: NDArray[np.int64], used: int) -> NDArray[Any] | None:
        """Return the extremes of the groups ``rows``, which are below ``used``."""
        if self._sliding is None:
            return None
        self._sliding.reserve(used)
        ends = self._sliding.ends(rows)
        if self._held is not None:
            # Groups that are newer than the held rows have none of them.
            covered = rows < len(self._held)
            ends[covered] = np.minimum(ends[covered], self._held[rows[covered]])
        return ends

    def keep(self, kept: NDArray[np.int64], new: NDArray[np.int32]) -> None:
        """Drop all groups except ``kept`` (ascending); group g becomes ``new[g]``."""
        renamed: deque[Pane] = deque()
        for end, at, columns, high in self.panes:
            if at is not None:
                renamed.append((end, new[at], columns, high))
                continue
            # The pane has groups 0, 1, 2 …; as ``kept`` ascends, the remaining ones are so again.
            still = kept[kept < columns.shape[1]]
            renamed.append((end, None, columns[:, still], None if high is None else high[still]))
        self.panes = renamed
        self._totals.keep(kept)
        if self._sliding is not None:
            self._sliding.keep(kept, new)
        if self._held is not None:
            self._held = self._held[kept[kept < len(self._held)]]

    def _add(
        self, at: At, columns: NDArray[Any], high: NDArray[np.int64] | None, sign: int
    ) -> None:
        self._totals.reserve(columns.shape[1] if at is None else int(at[-1]) + 1)
        self._totals.add(at, columns[0], columns[1], sign)
        if high is not None:
            assert isinstance(self._totals, IntegerTotals)
            self._totals.add_high(at, high, sign)


class SlidingPartial:
    """The aggregates of one argument over the window: numbers by kind, and other terms.

    ``distinct``: under set semantics `add` adds and subtracts single rows. Only extremes are folded
    by pane, since they do not depend on how often a row came.
    """

    def __init__(self, extremes: bool, panes: int, *, distinct: bool) -> None:
        self._wants_extremes, self._panes, self._distinct = extremes, panes, distinct
        self._kinds: dict[Key, SlidingNumbers] = {}
        self._others: NDArray[np.int64] = np.zeros((0, 3), np.int64)
        self._singles = Singles()
        self._odd: list[tuple[NDArray[np.int32], Part]] = []
        self._odd_panes: deque[tuple[int, NDArray[np.int32], Part]] = deque()
        self._odd_rows = 0

    def fold(
        self,
        subjects: NDArray[np.int32],
        column: ObjectColumn,
        skip: NDArray[np.bool_] | None,
        groups: Groups,
        terms: TermValues,
    ) -> None:
        """Fold rows of the present pane, except those in ``skip``."""
        if self._distinct and not self._wants_extremes:
            return
        for part in parts_of(subjects, column, skip, terms, by_value=self._distinct):
            if part.key is not None and not part.single:
                self._of(part.key).fold(part, groups)
            # Under set semantics `add` counts these rows when their pair enters the window.
            elif not self._distinct:
                self._odd.append((groups.groups(part.subjects), part))

    def fold_pane(
        self,
        end: int,
        subjects: NDArray[np.int32],
        column: ObjectColumn,
        groups: Groups,
        touched: ChangedGroups,
    ) -> bool:
        """`fold` and `push` of a pane with these rows alone; return False, and change nothing, if
        that takes several calls."""
        if column.kind not in (Kind.FLOAT, Kind.DOUBLE) or column.null is not None:
            return False
        numbers = self._of((column.kind, 0))
        return numbers.fold_pane(end, subjects, column.values, groups, touched)

    def append(
        self, key: Key, ends: NDArray[np.int64], at: NDArray[np.int32], columns: NDArray[Any]
    ) -> None:
        """Add folded panes, all of one `Key`; see `SlidingNumbers.append`."""
        self._of(key).append(ends, at, columns)

    def present(
        self, used: int, of: NDArray[np.bool_] | None
    ) -> tuple[NDArray[np.int64], Partial] | None:
        """Return the groups that `SlidingNumbers.present` returns, and their aggregates. None: the
        window has several kinds of numbers, or other terms."""
        if len(self._kinds) != 1 or self._odd_rows:
            return None
        [(key, numbers)] = self._kinds.items()
        found = numbers.present(used, of)
        return None if found is None else (found[0], Partial({key: found[1]}))

    def abandon(self, used: int) -> None:
        """Drop the rows of the present pane."""
        self._odd = []
        for numbers in self._kinds.values():
            numbers.abandon(used)

    def push(self, end: int, used: int, touched: ChangedGroups) -> None:
        """End the present pane."""
        for numbers in self._kinds.values():
            numbers.push(end, used, touched, distinct=self._distinct)
        for at, part in self._odd:
            self._odd_panes.append((end, at, part))
            self._count(at, part, 1, touched)
        self._odd = []

    def evict(self, until: int, touched: ChangedGroups) -> None:
        """Evict the panes that end at or before ``until``."""
        for numbers in self._kinds.values():
            numbers.evict(until, touched)
        while self._odd_panes and self._odd_panes[0][0] <= until:
            _, at, part = self._odd_panes.popleft()
            self._count(at, part, -1, touched)

    def add(
        self,
        subjects: NDArray[np.int32],
        column: ObjectColumn,
        sign: int,
        groups: Groups,
        terms: TermValues,
        touched: ChangedGroups,
    ) -> None:
        """Add (1) or subtract (-1) rows that do not belong to a pane."""
        for part in parts_of(subjects, column, None, terms, by_value=True):
            present = slice(None) if part.skip is None else ~part.skip
            at = groups.groups(part.subjects[present])
            touched.reserve(groups.used)
            if part.key is None or part.single:
                self._count(at, part, sign, touched)
            else:
                touched.mark(at)
                self._of(part.key).add(at, part.values[present], sign)

    def hold(
        self,
        subjects: NDArray[np.int32],
        column: ObjectColumn,
        groups: Groups,
        terms: TermValues,
    ) -> None:
        """Include rows that do not expire in the extremes, instead of earlier such rows."""
        for numbers in self._kinds.values():
            numbers.release()
        for part in parts_of(subjects, column, None, terms, by_value=True):
            if part.key is not None and not part.single:
                present = slice(None) if part.skip is None else ~part.skip
                at = groups.groups(part.subjects[present])
                self._of(part.key).hold(at, part.values[present])

    def rows(self, rows: Rows) -> NDArray[np.int64]:
        """Return the number of rows of each of the groups ``rows``, errors included. Do not modify
        the array."""
        counts = [numbers.counts_of(rows) for numbers in self._kinds.values()]
        if self._odd_rows:
            self._reserve(_above(rows))
            counts.append(self._others[rows].sum(axis=1))
        if not counts:
            return np.zeros(rows.stop if isinstance(rows, slice) else len(rows), np.int64)
        return counts[0] if len(counts) == 1 else np.sum(counts, axis=0)

    def partial(self, rows: NDArray[np.int64]) -> Partial:
        """Return the aggregates of the groups ``rows``, as groups 0, 1, 2 …"""
        partial = Partial({key: numbers.numbers(rows) for key, numbers in self._kinds.items()})
        partial.singles = self._singles.of(rows)
        if self._odd_rows:
            self._reserve(int(rows.max(initial=-1)) + 1)
            partial.others = self._others[rows]
        return partial

    def panes_of(self, key: Key) -> Iterable[Pane] | None:
        """Return the panes of rows with this `Key`; None if the window has other rows."""
        if self._odd_rows or any(of.panes for each, of in self._kinds.items() if each != key):
            return None
        return self._kinds[key].panes if key in self._kinds else ()

    def keep(self, kept: NDArray[np.int64], new: NDArray[np.int32]) -> None:
        """Drop all groups except ``kept`` (ascending); group g becomes ``new[g]``."""
        for numbers in self._kinds.values():
            numbers.keep(kept, new)
        self._reserve(int(kept.max(initial=-1)) + 1)
        self._others = self._others[kept]
        self._singles.keep(new)
        self._odd_panes = deque((end, new[at], part) for end, at, part in self._odd_panes)

    def _of(self, key: Key) -> SlidingNumbers:
        found = self._kinds.get(key)
        if found is None:
            found = SlidingNumbers(key, self._wants_extremes, self._panes)
            self._kinds[key] = found
        return found

    def _count(self, at: NDArray[np.int32], part: Part, sign: int, touched: ChangedGroups) -> None:
        self._reserve(int(at.max(initial=-1)) + 1)
        np.add.at(self._others[:, part.column], at, sign)
        if part.key is not None:
            self._singles.add(at, part.key[0], part.values, sign)
        # While this is 0 no group has other terms, so reads skip them.
        self._odd_rows += sign * len(at)
        touched.mark(at)

    def _reserve(self, groups: int) -> None:
        if len(self._others) < groups:
            self._others = grow(self._others, max(groups, 2 * len(self._others)), 0)


def _above(rows: Rows) -> int:
    return int(rows.stop if isinstance(rows, slice) else rows.max(initial=-1) + 1)
