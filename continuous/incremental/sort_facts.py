"""What the rows of a window tell of the sorts of their subjects, kept by pane."""

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
from ..algebra.expressions import Const, Var
from ..algebra.plan import TypeScan
from ..columns.fold_kernels import Groups, grown
from ..operators.sources import StaticSide, distinct_ids


class SortFacts:
    """Which subjects the window's rows tell to be of a sort: counted by pane, a set to queries.

    Cost: O(ids of the pane), or a pass over a byte an id of the dictionary where they are many.
    Memory: 5 bytes an id of the dictionary, 4 an id and pane.
    """

    def __init__(self, sort: NamedNode) -> None:
        self.sort = sort
        self._counts: NDArray[np.int32] = np.zeros(0, np.int32)
        self._panes: deque[tuple[int, NDArray[np.int32]]] = deque()
        self._known: NDArray[np.int32] | None = None
        self._static: NDArray[np.bool_] = np.zeros(0, np.bool_)

    def fold(self, end: int, tables: Sequence[TripleRows], static: StaticSide) -> Ids:
        """The facts of the pane that ends at ``end``: the ids they are about."""
        dictionary = static.terms.dictionary
        rdf_type, sort = dictionary.find(RDF_TYPE), dictionary.find(self.sort)
        parts = []
        for table in tables:
            if static.sort_holds(table.sort, self.sort.value):
                parts.append(table.subject)
            column = table.objects.get(rdf_type)
            if column is not None and column.kind is Kind.TERM:
                parts.append(table.subject[column.present & (column.values == sort)])
        if not parts:
            return np.zeros(0, np.int32)
        if 16 * sum(map(len, parts)) < len(dictionary):
            ids = np.unique(np.concatenate(parts))
        else:
            ids = distinct_ids(parts, len(dictionary))
        if len(self._counts) < len(dictionary):
            self._counts = grown(self._counts, 2 * len(dictionary), 0)
        self._counts[ids] += 1
        self._panes.append((end, ids))
        return ids

    def held_ids(self) -> Iterator[Ids]:
        """The ids that the panes are about; `StaticSide` holds its own."""
        return (ids for _, ids in self._panes)

    def evict(self, until: int) -> list[Ids]:
        """Forget the panes that end at or before ``until``: the ids each was about."""
        forgotten = []
        while self._panes and self._panes[0][0] <= until:
            ids = self._panes.popleft()[1]
            self._counts[ids] -= 1
            forgotten.append(ids)
        return forgotten

    def holds(self, subjects: NDArray[np.int32], static: StaticSide) -> NDArray[np.bool_]:
        """Which subjects are of the sort, by the window or by the static side."""
        known = static.pairs(TypeScan(Var("s"), Const(self.sort)))[0].values
        size = len(static.terms.dictionary)
        if len(self._counts) < size:
            self._counts = grown(self._counts, 2 * size, 0)
        if known is not self._known or len(self._static) < size:
            self._known = known
            self._static = np.zeros(len(self._counts), np.bool_)
            self._static[known] = True
        told = self._static[subjects]
        return told | (self._counts[subjects] > 0) if self._panes else told


class GroupSorts:
    """Which groups are of all of some sorts, by the window or by the static side.

    Law: `holds` says of each group what `SortFacts.holds` says of its member for every sort. Cost:
    a look-up a sort for a new group and for one of which facts came or went; for every group when
    the static side has changed. Memory: a byte a group, and that of `SortFacts`.
    """

    def __init__(self, sorts: Sequence[NamedNode], groups: Groups, static: StaticSide) -> None:
        self._facts = [SortFacts(sort) for sort in sorts]
        self._groups = groups
        self._static = static
        self._version: int | None = None
        self._of: NDArray[np.bool_] = np.zeros(0, np.bool_)
        self._known = 0
        """Of so many groups `_of` says it."""

    def fold(self, end: int, tables: Sequence[TripleRows]) -> Iterator[NDArray[np.int32]]:
        """The facts of the pane that ends at ``end``: the groups of which they may change it."""
        for facts in self._facts:
            yield self._changed(facts.fold(end, tables, self._static))

    def evict(self, until: int) -> Iterator[NDArray[np.int32]]:
        """Forget the panes that end at or before ``until``: the groups of which they told."""
        for facts in self._facts:
            for ids in facts.evict(until):
                yield self._changed(ids)

    def held_ids(self) -> Iterator[Ids]:
        """The ids that somebody has told something of; groups hold their members."""
        for facts in self._facts:
            yield from facts.held_ids()

    def forget(self) -> None:
        """The groups are others now."""
        self._known = 0

    def holds(self, rows: NDArray[Any] | slice) -> NDArray[np.bool_]:
        """Of each of the groups ``rows``."""
        version, used = self._static.background.version, self._groups.used
        if version != self._version:
            self._version, self._known = version, 0
        if self._known < used:
            self._of = grown(self._of, max(used, 2 * self._known), False)
            self._look(slice(self._known, used))
            self._known = used
        return self._of[rows]

    def _changed(self, ids: Ids) -> NDArray[np.int32]:
        """The groups of these ids."""
        found = self._groups.group_of[ids[ids < len(self._groups.group_of)]]
        found = found[found >= 0]
        self._look(found[found < self._known])
        return found

    def _look(self, rows: NDArray[np.int32] | slice) -> None:
        members = self._groups.members[rows]
        of = np.ones(len(members), np.bool_)
        for facts in self._facts:
            of &= facts.holds(members, self._static)
        self._of[rows] = of
