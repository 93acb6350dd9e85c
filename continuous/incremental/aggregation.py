"""The incremental path: aggregates of one stream pattern, kept by subject as rows come and expire.

It serves ``Aggregate(keys, …, ?s <p> ?v joined with patterns on ?s)``: the rows of <p> are folded
by subject and pane, panes are added to the window and taken from it (`sliding_aggregates`), then
joined with the rest, which is small, and grouped by the keys. Law: same solutions as
`executor.execute` over the window's rows.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...rdf.timed import Kind, ObjectColumn, TripleRows
from ..algebra.expressions import Const, Var
from ..algebra.plan import Plan
from ..columns.budget import BudgetExceeded
from ..columns.expression_evaluation import evaluate, holds
from ..columns.fold_kernels import Groups, grown
from ..columns.relation import NeedsOxigraph, Pairs, Relation, TermValues
from ..operators.executor import Source, execute, select_pairs
from ..operators.grouping import group_keys, grouping
from ..operators.joins import join_all
from ..operators.partial_aggregates import Partial
from ..operators.sources import StaticSide, distinct_pairs
from .aggregate_shape import Shape
from .distinct_pairs import DistinctRows
from .sliding_aggregates import Rows, SlidingPartial, Touched
from .sort_facts import GroupSorts

_ROW = "\0row"
_SUBJECT = "\0s"
COMPACT = 1024
"""Below this many groups it is not worth while to forget any."""
DENSE = 4
"""From one touched group in so many on, all are looked at: that is simpler and as fast."""


class Incremental:
    """The state of one incremental aggregate.

    ``panes``: how many a window has at most. ``distinct``: equal triples count once.

    Cost: a kernel call a table and pane; O(touched + expired groups) a pane; a window O(groups), or
    where a HAVING stands on the aggregate and the subjects are its groups, O(touched + expired +
    solutions) and a pass over two bytes a group. Memory: O(touched groups) a pane, some numbers a
    group; with ``distinct`` also the distinct pairs (`pair_index`). Groups are the subjects of the
    window; those that have left it are forgotten when they are half of all (O(panes) a subject). A
    pane that columns cannot fold is irregular: `ready` then has nothing for its windows.
    """

    def __init__(
        self,
        shape: Shape,
        static: StaticSide,
        terms: TermValues,
        panes: int = 1,
        *,
        distinct: bool = False,
    ) -> None:
        self.shape = shape
        self.static = static
        self.terms = terms
        self.groups = Groups()
        self._partials = [
            SlidingPartial(extremes, panes, distinct=distinct) for _, extremes in shape.arguments
        ]
        self._distinct = DistinctRows(terms) if distinct else None
        self._sorts = GroupSorts(shape.sorts, self.groups, static)
        self._irregular: deque[int] = deque()
        self._static_version: int | None = None
        self._static_pairs: Pairs | None = None
        self._static_counted: NDArray[np.bool_] = np.zeros(0, np.bool_)
        self._touched = Touched()
        # Which groups had rows, were of the sorts and passed the HAVING, when last looked at.
        self._passing: NDArray[np.bool_] = np.zeros(0, np.bool_)
        self._compact_at = COMPACT
        terms.dictionary.hold(self)

    def held_ids(self) -> Iterator[NDArray[Any]]:
        """See `dictionary.Holder`: groups keep their subjects until they are compacted, a static
        triple may have been given another spelling."""
        yield self.groups.members[: self.groups.used]
        yield from self._sorts.held_ids()
        for column in self._static_pairs or ():
            yield column.held_ids

    def fold(self, end: int, tables: Sequence[TripleRows]) -> None:
        """The rows of the pane that ends at ``end``, in order."""
        self.groups.reach(len(self.terms.dictionary))
        predicate = self.terms.dictionary.find(self.shape.scan.predicate)
        try:
            for table in tables:
                column = table.objects.get(predicate)
                if column is not None:
                    self._fold(end, table.subject, column)
        except (NeedsOxigraph, BudgetExceeded):
            # Its windows are computed anew; where the budget was too small, that says so again.
            self._irregular.append(end)
            for partial in self._partials:
                partial.abandon(self.groups.used)
        self._touched.reserve(self.groups.used)
        for partial in self._partials:
            partial.push(end, self.groups.used, self._touched)
        for changed in self._sorts.fold(end, tables):
            self._touched.mark(changed)

    def evict(self, until: int) -> None:
        """Forget the panes that end at or before ``until``."""
        for partial in self._partials:
            partial.evict(until, self._touched)
        if self._distinct is not None:
            for pairs in self._distinct.leave(until):
                self._count(pairs, -1)
        for changed in self._sorts.evict(until):
            self._touched.mark(changed)
        while self._irregular and self._irregular[0] <= until:
            self._irregular.popleft()
        if self.groups.used >= self._compact_at:
            self._compact()

    def ready(self, plan: Plan, source: Source) -> Relation | None:
        """The solutions of ``plan`` if it is the aggregate, or the HAVING on it.

        ``source`` is asked for what the aggregate has to be joined with.
        """
        shape = self.shape
        having = bool(shape.having) and plan is shape.having[0] and shape.direct
        if self._irregular or not (having or plan is shape.aggregate):
            return None
        self._with_static()
        if having:
            return self._having()
        rows = self._alive(slice(self.groups.used))
        return self._direct(rows) if shape.direct else self._joined(rows, source)

    def _alive(self, rows: Rows) -> NDArray[np.int64]:
        """Those of ``rows`` that have rows in the window and are of the sorts."""
        alive = self._partials[0].rows(rows) > 0
        if self.shape.sorts:
            alive &= self._sorts.holds(rows)
        return np.flatnonzero(alive) if isinstance(rows, slice) else rows[alive]

    def _having(self) -> Relation:
        """The groups that pass the HAVING: only the touched are looked at, if they are few."""
        used = self.groups.used
        self._touched.reserve(used)
        self._passing = grown(self._passing, used, False)
        touched = self._touched.groups(used)
        every = touched is None or DENSE * len(touched) > used
        looked: Rows = slice(used) if touched is None or every else touched
        self._passing[looked] = False
        rows = self._alive(looked)
        relation = self._direct(rows)
        for filter in reversed(self.shape.having):
            kept = np.flatnonzero(
                holds(filter.condition, relation.columns, relation.rows, self.terms)
            )
            rows, relation = rows[kept], relation.take(kept)
        self._passing[rows] = True
        # Last: had this gone wrong, they would have to be looked at again.
        self._touched.clear()
        return relation if every else self._direct(np.flatnonzero(self._passing[:used]))

    def _direct(self, rows: NDArray[np.int64]) -> Relation:
        """The aggregates of the subjects ``rows``."""
        subject = self.shape.scan.subject
        assert isinstance(subject, Var)
        columns = {subject.name: ObjectColumn(Kind.TERM, self.groups.members[rows])}
        partials = [partial.partial(rows) for partial in self._partials]
        return self._finished(columns, partials, len(rows))

    def _joined(self, rows: NDArray[np.int64], source: Source) -> Relation:
        """The aggregates by the plan's keys, after the join with the rest."""
        shape, plan = self.shape, self.shape.aggregate
        partials = [partial.partial(rows) for partial in self._partials]
        columns = {_ROW: ObjectColumn(Kind.INTEGER, np.arange(len(rows)))}
        if isinstance(shape.scan.subject, Var):
            members = self.groups.members[rows]
            columns[shape.scan.subject.name] = ObjectColumn(Kind.TERM, members)
        base = Relation(columns, len(rows))
        rest = [execute(part, source, self.terms) for part in shape.rest]
        joined = join_all([base, *rest], self.terms)
        for condition in shape.later:
            joined = joined.take(holds(condition, joined.columns, joined.rows, self.terms))
        group, first = grouping(plan, joined, self.terms)
        picked = joined.columns[_ROW].values
        merged = [partial.merged(group, picked, len(first)) for partial in partials]
        return self._finished(group_keys(plan, joined, first), merged, len(first))

    def _finished(
        self, columns: Mapping[str, ObjectColumn], partials: Sequence[Partial], rows: int
    ) -> Relation:
        plan, result = self.shape.aggregate, dict(columns)
        places = {argument: i for i, (argument, _) in enumerate(self.shape.arguments)}
        every = np.arange(rows)
        for one in plan.aggregations:
            partial = partials[places.get(one.argument, 0)]
            star = one.argument is None
            result[one.variable] = partial.finish(one.function, every, self.terms, star)
        return Relation(result, rows, frozenset(plan.keys))

    def _fold(self, end: int, subjects: NDArray[np.int32], objects: ObjectColumn) -> None:
        """Rows of the folded predicate."""
        skip = objects.null
        if skip is not None and not self.shape.plain:
            present = np.flatnonzero(~skip)
            subjects, objects, skip = subjects[present], objects.take(present), None
        pairs = ObjectColumn(Kind.TERM, subjects), ObjectColumn(objects.kind, objects.values)
        if not self.shape.plain:
            pairs = self._selected(pairs)
        columns = self._arguments(pairs)
        for partial, column in zip(self._partials, columns, strict=True):
            partial.fold(pairs[0].values, column, skip, self.groups, self.terms)
        if self._distinct is not None:
            fresh = self._distinct.see(end, pairs, skip)
            self._count((pairs[0].take(fresh), pairs[1].take(fresh)), 1)

    def _selected(self, pairs: Pairs) -> Pairs:
        """The pairs that the pattern matches and its filters let through."""
        scan = self.shape.scan
        if isinstance(scan.subject, Const):
            # Selected by its own id, so that a group stands for it although it has no column.
            mine = pairs[0].values == self.terms.dictionary.find(scan.subject.term)
            pairs = pairs[0].take(mine), pairs[1].take(mine)
        relation = select_pairs(pairs, Var(_SUBJECT), scan.object, self.terms)
        named = dict(relation.columns)
        if isinstance(scan.subject, Var):
            named[scan.subject.name] = named[_SUBJECT]
        relation = Relation(named, relation.rows)
        for condition in self.shape.filters:
            keep = holds(condition, relation.columns, relation.rows, self.terms)
            relation = relation.take(keep)
        if isinstance(scan.object, Var):
            return relation.columns[_SUBJECT], relation.columns[scan.object.name]
        # The one object that was asked for: no argument names it.
        same = ObjectColumn(Kind.INTEGER, np.zeros(relation.rows, np.int64))
        return relation.columns[_SUBJECT], same

    def _arguments(self, pairs: Pairs) -> list[ObjectColumn]:
        """What is aggregated of these pairs, a column an argument."""
        scan, rows = self.shape.scan, len(pairs[0])
        columns = {}
        for position, column in zip((scan.subject, scan.object), pairs, strict=True):
            if isinstance(position, Var):
                columns[position.name] = column
        nothing = ObjectColumn(Kind.INTEGER, np.broadcast_to(np.int64(0), (rows,)))
        return [
            nothing
            if argument is None
            else columns[argument.name]
            if isinstance(argument, Var) and argument.name in columns
            else evaluate(argument, columns, rows, self.terms)
            for argument, _ in self.shape.arguments
        ]

    def _count(self, pairs: Pairs, sign: int) -> None:
        """Pairs that count by themselves, not by their pane: added (1) or taken away (-1)."""
        if not len(pairs[0]):
            return
        for partial, column in zip(self._partials, self._arguments(pairs), strict=True):
            partial.add(pairs[0].values, column, sign, self.groups, self.terms, self._touched)

    def _with_static(self) -> None:
        """The static triples of the folded predicate are always there.

        Under set semantics those are left out that the window holds as well.
        """
        version = self.static.background.version
        if version != self._static_version:
            self._touched.all = True
            if self._static_pairs is not None:
                self._count(_those(self._static_pairs, self._static_counted), -1)
                self._static_pairs = None
            found = self.static.pairs(self.shape.scan)
            if self._distinct is not None:
                found = distinct_pairs(found, self.terms)
            pairs = self._selected(found)
            self.groups.reach(len(self.terms.dictionary))
            columns = self._arguments(pairs)
            for partial, column in zip(self._partials, columns, strict=True):
                partial.hold(pairs[0].values, column, self.groups, self.terms)
            self._static_pairs = pairs
            self._static_counted = np.zeros(len(pairs[0]), np.bool_)
            # Last: where columns cannot fold the static side, every window has to say so.
            self._static_version = version
        assert self._static_pairs is not None
        count = np.ones(len(self._static_counted), np.bool_)
        if self._distinct is not None and len(count):
            count = ~self._distinct.holds(self._static_pairs)
        if len(count) and not np.array_equal(count, self._static_counted):
            self._count(_those(self._static_pairs, count & ~self._static_counted), 1)
            self._count(_those(self._static_pairs, self._static_counted & ~count), -1)
            self._static_counted = count

    def _compact(self) -> None:
        """Forget the groups without rows if they are half of all.

        It depends on the windows alone, so results stay the same however the input is cut.
        """
        used = self.groups.used
        kept = np.flatnonzero(self._partials[0].rows(slice(used)) > 0)
        if 2 * len(kept) <= used:
            self.groups.keep(kept)
            self._sorts.forget()
            new: NDArray[np.int32] = np.full(used, -1, np.int32)
            new[kept] = np.arange(len(kept), dtype=np.int32)
            for partial in self._partials:
                partial.keep(kept, new)
            self._touched.all = True
            self._passing[:] = False
        self._compact_at = max(COMPACT, 2 * len(kept))


def _those(pairs: Pairs, rows: NDArray[Any]) -> Pairs:
    return pairs[0].take(rows), pairs[1].take(rows)
