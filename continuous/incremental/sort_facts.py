"""The sorts that a window's rows state of their subjects, by pane."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pyoxigraph import NamedNode

from ...rdf.dictionary import Ids
from ...rdf.namespaces import RDF_TYPE
from ...rdf.timed import Kind, TripleRows
from ...streams.jit import JIT, Kernel
from ...streams.sample import Times
from ..algebra.expressions import Const, Var
from ..algebra.plan import TypeScan
from ..columns.fold_kernels import Groups, grow, read_only
from ..columns.pane_runs import equal_runs
from ..operators.sources import StaticSide, distinct_ids


def _enter(
    subjects: Any, counts: Any, seen: Any, stamp: int, ids: Any, count: int, first: Any, some: int
) -> tuple[int, int]:
    """Append the distinct subjects that have no ``stamp`` in ``seen`` to the ``count`` entries of
    ``ids``, and those of them that had no count to the ``some`` entries of ``first``; count each.
    Return the numbers of entries."""
    entries, fresh = np.uint64(count), np.uint64(some)
    for i in range(subjects.shape[0]):
        subject = np.uint64(subjects[i])
        if seen[subject] != stamp:
            seen[subject] = stamp
            ids[entries] = subjects[i]
            entries += np.uint64(1)
            if counts[subject] == 0:
                first[fresh] = subjects[i]
                fresh += np.uint64(1)
            counts[subject] += 1
    return int(entries), int(fresh)


def _enter_signature() -> Any:
    from numba import types

    ids, int64 = types.int32[::1], types.int64
    tuple_of: Any = types.UniTuple
    subjects = read_only(types.int32)
    return tuple_of(int64, 2)(subjects, ids, ids, int64, ids, int64, ids, int64)


_enter_kernel = Kernel(_enter, _enter_signature)
_NO_IDS: Ids = np.zeros(0, np.int32)


class SortFacts:
    """The subjects of one sort according to the window's rows, counted by pane.

    Cost: O(rows of the pane); without compiled loops also a pass over a byte per id of the
    dictionary. Memory: 9 bytes per id of the dictionary, 4 per id and pane.
    """

    def __init__(self, sort: NamedNode) -> None:
        self.sort = sort
        self._counts: NDArray[np.int32] = np.zeros(0, np.int32)
        self._seen: NDArray[np.int32] = np.zeros(0, np.int32)
        """By id, the stamp of the last pane that has it."""
        self._stamp = 0
        self.panes: deque[tuple[int, NDArray[np.int32]]] = deque()
        self._static_ids: NDArray[np.int32] | None = None
        self._static: NDArray[np.bool_] = np.zeros(0, np.bool_)

    def fold(self, end: int, tables: Sequence[TripleRows], static: StaticSide) -> Ids:
        """Add the facts of the pane that ends at ``end``; return the subjects that had none."""
        dictionary = static.terms.dictionary
        parts = [subjects for _, subjects in self.stated(tables, static)]
        if not parts:
            return _NO_IDS
        if len(self._counts) < len(dictionary):
            self._counts = grow(self._counts, 2 * len(dictionary), 0)
        ids, first = self._enter(parts) if JIT else self._enter_sorted(parts, len(dictionary))
        self.panes.append((end, ids))
        return first

    def _enter(self, parts: Sequence[Ids]) -> tuple[Ids, Ids]:
        """Count the distinct ``parts``; return them, and those that had no count."""
        self._seen = grow(self._seen, len(self._counts), 0)
        # A pane has a stamp of its own until 2^31 panes have come.
        self._stamp = self._stamp % (2**31 - 1) + 1
        rows = sum(map(len, parts))
        ids, first, count, some = np.empty(rows, np.int32), np.empty(rows, np.int32), 0, 0
        for part in parts:
            count, some = _enter_kernel(
                part, self._counts, self._seen, self._stamp, ids, count, first, some
            )
        # The rows of a pane may be many more than its subjects.
        return (ids if 2 * count > rows else ids[:count].copy())[:count], first[:some]

    def _enter_sorted(self, parts: Sequence[Ids], size: int) -> tuple[Ids, Ids]:
        """`_enter` without a compiled loop, for ids below ``size``."""
        ids = distinct_ids(parts, size)
        counts = self._counts.take(ids)
        self._counts[ids] = counts + 1
        return ids, ids[counts == 0]

    def append(self, ends: Times, subjects: Ids) -> None:
        """Add facts of panes with these ends, which are later than those of the panes there are.
        Contract: `GroupSorts.forget` follows."""
        if not len(ends):
            return
        order = np.lexsort((subjects, ends))
        ends, subjects = ends[order], subjects[order]
        new = np.append(True, (ends[1:] != ends[:-1]) | (subjects[1:] != subjects[:-1]))
        ends, subjects = ends[new], subjects[new]
        self._counts = grow(self._counts, int(subjects.max()) + 1, 0)
        np.add.at(self._counts, subjects, 1)
        self.panes.extend((int(ends[rows.start]), subjects[rows]) for rows in equal_runs(ends))

    def stated(
        self, tables: Sequence[TripleRows], static: StaticSide
    ) -> Iterator[tuple[Times, Ids]]:
        """Yield τ and subject of the facts in ``tables``."""
        dictionary = static.terms.dictionary
        rdf_type, sort = dictionary.find(RDF_TYPE), dictionary.find(self.sort)
        for table in tables:
            if static.sort_holds(table.sort, self.sort.value):
                yield table.time, table.subject
            column = table.objects.get(rdf_type)
            if column is not None and column.kind is Kind.TERM:
                rows = column.present & (column.values == sort)
                yield table.time[rows], table.subject[rows]

    def held_ids(self) -> Iterator[Ids]:
        """Return the subjects of the panes' facts; `StaticSide` holds its own."""
        return (ids for _, ids in self.panes)

    def evict(self, until: int) -> list[Ids]:
        """Evict the panes that end at or before ``until``; return the subjects that have no fact
        any more, pane by pane."""
        evicted = []
        while self.panes and self.panes[0][0] <= until:
            ids = self.panes.popleft()[1]
            counts = self._counts.take(ids) - 1
            self._counts[ids] = counts
            if np.count_nonzero(counts) < len(counts):
                evicted.append(ids[counts == 0])
        return evicted

    def holds(self, subjects: NDArray[np.int32], static: StaticSide) -> NDArray[np.bool_]:
        """Return which subjects are of the sort, by the window or by the static side."""
        found = self.holds_always(subjects, static)
        return found | (self._counts[subjects] > 0) if self.panes else found

    def holds_always(self, subjects: NDArray[np.int32], static: StaticSide) -> NDArray[np.bool_]:
        """Return which subjects are of the sort by the static side."""
        static_ids = static.pairs(TypeScan(Var("s"), Const(self.sort)))[0].values
        size = len(static.terms.dictionary)
        if len(self._counts) < size:
            self._counts = grow(self._counts, 2 * size, 0)
        if static_ids is not self._static_ids or len(self._static) < size:
            self._static_ids = static_ids
            self._static = np.zeros(len(self._counts), np.bool_)
            self._static[static_ids] = True
        return self._static[subjects]


class GroupSorts:
    """The groups that are of all of some sorts, by the window or by the static side.

    Law: `holds` of a group is true if `SortFacts.holds` is true of its member for every sort. Cost:
    a look-up per sort for a new group and for one that gets its first or loses its last fact; for
    every group if the static side has changed. Memory: a byte per group, and that of `SortFacts`.
    """

    def __init__(self, sorts: Sequence[NamedNode], groups: Groups, static: StaticSide) -> None:
        self.facts = [SortFacts(sort) for sort in sorts]
        self._groups = groups
        self._static = static
        self._version: int | None = None
        self._of: NDArray[np.bool_] = np.zeros(0, np.bool_)
        self._covered = 0
        """The number of groups that `_of` covers."""

    def fold(self, end: int, tables: Sequence[TripleRows]) -> Iterator[NDArray[np.int32]]:
        """Add the facts of the pane that ends at ``end``; yield the groups that they may change."""
        for facts in self.facts:
            ids = facts.fold(end, tables, self._static)
            if len(ids):
                yield self._changed(ids)

    def evict(self, until: int) -> Iterator[NDArray[np.int32]]:
        """Evict the panes that end at or before ``until``; yield the groups that may change."""
        for facts in self.facts:
            for ids in facts.evict(until):
                yield self._changed(ids)

    def held_ids(self) -> Iterator[Ids]:
        """Yield the subjects of facts; `IncrementalAggregate` holds the groups' members."""
        for facts in self.facts:
            yield from facts.held_ids()

    def forget(self) -> None:
        """Recompute everything: the groups have been renumbered."""
        self._covered = 0

    def holds(self, rows: NDArray[Any] | slice) -> NDArray[np.bool_]:
        """Return whether each of the groups ``rows`` is of all sorts."""
        version, used = self._static.background.version, self._groups.used
        # New static facts may concern any group.
        if version != self._version:
            self._version, self._covered = version, 0
        if self._covered < used:
            self._of = grow(self._of, max(used, 2 * self._covered), False)
            self._update(slice(self._covered, used))
            self._covered = used
        return self._of[rows]

    def _changed(self, ids: Ids) -> NDArray[np.int32]:
        """Update the groups of these ids, and return them."""
        found = self._groups.group_of[ids[ids < len(self._groups.group_of)]]
        found = found[found >= 0]
        # Later groups are computed when `holds` first asks for them.
        self._update(found[found < self._covered])
        return found

    def _update(self, rows: NDArray[np.int32] | slice) -> None:
        members = self._groups.members[rows]
        of = np.ones(len(members), np.bool_)
        for facts in self.facts:
            of &= facts.holds(members, self._static)
        self._of[rows] = of
