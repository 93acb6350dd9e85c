"""Sliding aggregates by group: what comes is added, what expires is subtracted, both exactly.

A pane's rows are folded in order, as they come (`fold_kernels.RowFold`); a window's sum is the
exact sum of its panes' sums, rounded once (`exact_sums`). So a sum neither drifts nor depends on
what was in the window before, and a group without new or expired rows keeps its aggregates to the
last bit: only the others have to be looked at. Extremes cannot be subtracted: `sliding_extremes`.
"""

from __future__ import annotations

from collections import deque
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...rdf.timed import Kind, ObjectColumn
from ..columns.exact_sums import At, FloatTotals, IntegerTotals
from ..columns.fold_kernels import Groups, grown, mirrored
from ..columns.relation import TermValues
from ..operators.partial_aggregates import (
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
"""Groups; a slice has a stop only."""
_Pane = tuple[int, At, NDArray[Any], NDArray[np.int64] | None]
"""Its end, and as `NumberFold.take` gives it, sums and counts only."""


class Touched:
    """The groups whose aggregates may have changed since they were last looked at.

    Memory: a byte a group. Cost of `groups`: a pass over those bytes.
    """

    def __init__(self) -> None:
        self._marks: NDArray[np.bool_] = np.zeros(0, np.bool_)
        self.all = True

    def mark(self, at: NDArray[Any] | None) -> None:
        """These groups (None: all); so many rows as there are groups touch most of them."""
        if at is None or len(at) > len(self._marks):
            self.all = True
        elif not self.all:
            self._marks[at] = True

    def reserve(self, groups: int) -> None:
        """Make room for ``groups`` groups; new ones count as touched."""
        if len(self._marks) < groups:
            marks = np.ones(max(groups, 2 * len(self._marks)), np.bool_)
            marks[: len(self._marks)] = self._marks
            self._marks = marks

    def groups(self, used: int) -> NDArray[np.int64] | None:
        """Those touched, ascending; None: all."""
        return None if self.all else np.flatnonzero(self._marks[:used])

    def clear(self) -> None:
        """All have been looked at."""
        self._marks[:] = False
        self.all = False


class SlidingNumbers:
    """One argument's values of one `Key`: sums and counts, and extremes if asked for.

    Law: `numbers` is of the rows in all panes pushed and not evicted, and of those added and not
    taken away; extremes of the rows in panes and of those held. Cost: see `RowFold`; then
    O(touched) a pane, once when it comes and once when it expires. Memory: two (with extremes four)
    numbers a touched group and pane.
    """

    def __init__(self, key: Key, extremes: bool, panes: int) -> None:
        self._fold = NumberFold(key, extremes)
        self._panes: deque[_Pane] = deque()
        self._totals: IntegerTotals | FloatTotals = (
            IntegerTotals() if key[0] <= Kind.DECIMAL else FloatTotals()
        )
        self._sliding = SlidingExtremes(dtype_of(key), panes) if extremes else None
        self._held: NDArray[Any] | None = None

    def counts_of(self, rows: Rows) -> NDArray[np.int64]:
        """How many rows each of the groups ``rows`` has."""
        self._totals.reserve(_above(rows))
        return self._totals.counts[rows]

    def fold(self, part: Part, groups: Groups) -> None:
        """Rows of the pane that is being read."""
        self._fold.add(part.subjects, part.values, part.skip, groups)

    def abandon(self, used: int) -> None:
        """Forget the rows of the pane that is being read."""
        self._fold.take(used)

    def push(self, end: int, used: int, touched: Touched, *, distinct: bool) -> None:
        """The pane has been read; ``distinct``: its extremes only, the sums are added by rows."""
        at, columns, high = self._fold.take(used)
        if not columns.shape[1]:
            return
        touched.mark(at)
        if self._sliding is not None:
            self._sliding.reserve(used)
            self._sliding.push(end, at, columns[2:].T.copy())
            columns = columns[:2].copy()
        if not distinct:
            self._panes.append((end, at, columns, high))
            self._add(at, columns, high, 1)

    def evict(self, until: int, touched: Touched) -> None:
        """Forget the panes that end at or before ``until``."""
        while self._panes and self._panes[0][0] <= until:
            _, at, columns, high = self._panes.popleft()
            touched.mark(at)
            self._add(at, columns, high, -1)
        if self._sliding is not None:
            for at in self._sliding.evict(until):
                touched.mark(at)

    def add(self, at: NDArray[np.int32], values: NDArray[Any], sign: int) -> None:
        """Sums and counts of rows: added (1) or taken away (-1)."""
        self._totals.reserve(int(at.max(initial=-1)) + 1)
        self._totals.add(at, values, None, sign)

    def hold(self, at: NDArray[np.int32], values: NDArray[Any]) -> None:
        """Extremes of rows that do not expire."""
        if self._sliding is not None:
            known = 0 if self._held is None else len(self._held)
            held = self._sliding.nothing(max(known, int(at.max(initial=-1)) + 1))
            if self._held is not None:
                held[: len(self._held)] = self._held
            np.minimum.at(held[:, 0], at, values)
            np.minimum.at(held[:, 1], at, mirrored(values))
            self._held = held

    def release(self) -> None:
        """Forget what is held."""
        self._held = None

    def numbers(self, rows: NDArray[np.int64]) -> Numbers:
        """Of the groups ``rows``."""
        used = int(rows.max(initial=-1)) + 1
        self._totals.reserve(used)
        ends = None
        if self._sliding is not None:
            self._sliding.reserve(used)
            ends = self._sliding.ends(rows)
            if self._held is not None:
                known = rows < len(self._held)
                ends[known] = np.minimum(ends[known], self._held[rows[known]])
        return Numbers(self._totals.values(rows), self._totals.counts[rows], ends)

    def keep(self, kept: NDArray[np.int64], new: NDArray[np.int32]) -> None:
        """Forget all groups but ``kept`` (ascending); group g becomes ``new[g]``."""

        renamed: deque[_Pane] = deque()
        for end, at, columns, high in self._panes:
            if at is not None:
                renamed.append((end, new[at], columns, high))
                continue
            still = kept[kept < columns.shape[1]]
            renamed.append((end, None, columns[:, still], None if high is None else high[still]))
        self._panes = renamed
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
    """One argument of a query over the window: numbers by kind, and what is no number.

    ``distinct``: rows are added and taken away one by one (set semantics), and only their extremes
    are folded by pane, which do not depend on how often a row came.
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
        """Rows of the pane that is being read, but those in ``skip``."""
        if self._distinct and not self._wants_extremes:
            return
        for part in parts_of(subjects, column, skip, terms, by_value=self._distinct):
            if part.key is not None and not part.single:
                self._of(part.key).fold(part, groups)
            elif not self._distinct:
                self._odd.append((groups.groups(part.subjects), part))

    def abandon(self, used: int) -> None:
        """Forget the rows of the pane that is being read."""
        self._odd = []
        for numbers in self._kinds.values():
            numbers.abandon(used)

    def push(self, end: int, used: int, touched: Touched) -> None:
        """The pane has been read."""
        for numbers in self._kinds.values():
            numbers.push(end, used, touched, distinct=self._distinct)
        for at, part in self._odd:
            self._odd_panes.append((end, at, part))
            self._count(at, part, 1, touched)
        self._odd = []

    def evict(self, until: int, touched: Touched) -> None:
        """Forget the panes that end at or before ``until``."""
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
        touched: Touched,
    ) -> None:
        """Rows of their own: added (1) or taken away (-1)."""
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
        """Extremes of rows that do not expire, instead of those held so far."""
        for numbers in self._kinds.values():
            numbers.release()
        for part in parts_of(subjects, column, None, terms, by_value=True):
            if part.key is not None and not part.single:
                present = slice(None) if part.skip is None else ~part.skip
                at = groups.groups(part.subjects[present])
                self._of(part.key).hold(at, part.values[present])

    def rows(self, rows: Rows) -> NDArray[np.int64]:
        """How many rows each of the groups ``rows`` has, errors too. Not to be changed."""
        counts = [numbers.counts_of(rows) for numbers in self._kinds.values()]
        if self._odd_rows:
            self._reserve(_above(rows))
            counts.append(self._others[rows].sum(axis=1))
        if not counts:
            return np.zeros(rows.stop if isinstance(rows, slice) else len(rows), np.int64)
        return counts[0] if len(counts) == 1 else np.sum(counts, axis=0)

    def partial(self, rows: NDArray[np.int64]) -> Partial:
        """The aggregates of the groups ``rows``, as groups 0, 1, 2 …"""
        made = Partial({key: numbers.numbers(rows) for key, numbers in self._kinds.items()})
        made.singles = self._singles.of(rows)
        if self._odd_rows:
            self._reserve(int(rows.max(initial=-1)) + 1)
            made.others = self._others[rows]
        return made

    def keep(self, kept: NDArray[np.int64], new: NDArray[np.int32]) -> None:
        """Forget all groups but ``kept`` (ascending); group g becomes ``new[g]``."""
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

    def _count(self, at: NDArray[np.int32], part: Part, sign: int, touched: Touched) -> None:
        self._reserve(int(at.max(initial=-1)) + 1)
        np.add.at(self._others[:, part.column], at, sign)
        if part.key is not None:
            self._singles.add(at, part.key[0], part.values, sign)
        self._odd_rows += sign * len(at)
        touched.mark(at)

    def _reserve(self, groups: int) -> None:
        if len(self._others) < groups:
            self._others = grown(self._others, max(groups, 2 * len(self._others)), 0)


def _above(rows: Rows) -> int:
    return int(rows.stop if isinstance(rows, slice) else rows.max(initial=-1) + 1)
