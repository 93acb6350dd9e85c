"""The incremental path: aggregates of one stream pattern, updated as rows come and expire.

It computes ``Aggregate(keys, …, ?s <p> ?v joined with patterns on ?s)``. The rows of <p> are folded
by subject and pane. Panes are added to the window and subtracted from it (`sliding_aggregates`).
The result is joined with the rest, which is small, and grouped by the keys. Law: the solutions
equal those of `executor.execute` over the window's rows.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...rdf.dictionary import Ids
from ...rdf.timed import Kind, ObjectColumn, TripleRows
from ..algebra.expressions import Const, Var
from ..algebra.plan import Plan, Scan
from ..columns.budget import BudgetExceeded
from ..columns.expression_evaluation import evaluate, holds
from ..columns.fold_kernels import Groups, grow
from ..columns.relation import NeedsOxigraph, Pairs, Relation, TermValues
from ..operators.executor import Source, equals, execute
from ..operators.grouping import group_keys, grouping
from ..operators.joins import join
from ..operators.partial_aggregates import Partial
from ..operators.result_forms import END
from ..operators.sources import StaticSide, distinct_pairs
from .aggregate_shape import Shape
from .distinct_pairs import DistinctPairs
from .sliding_aggregates import ChangedGroups, Rows, SlidingPartial
from .sort_facts import GroupSorts

_ROW = "\0row"
COMPACT = 1024
"""Below this number of groups, dropping some is not worth its cost."""
FEW = 4096
"""Up to this number of rows of a pane, the calls of numpy cost more than the loops."""
SELECTIVE = 128
"""Up to this number of groups, a HAVING tests them all: to know which have changed costs more."""
DENSE = 4
"""If one group in this number has changed, evaluate all: that is simpler and as fast."""


class IncrementalAggregate:
    """The state of one incremental aggregate.

    ``panes``: the greatest number of panes in a window. ``distinct``: equal triples count once.

    Cost: a kernel call per table and pane; O(touched + expired groups) per pane; O(groups) per
    window. If there is a HAVING and the subjects are the groups, a window costs O(touched + expired
    + solutions) and a pass over two bytes per group. Memory: O(touched groups) per pane, some
    numbers per group; with ``distinct`` also the distinct pairs (`pair_index`).

    Groups are the subjects of the window. Those without rows are dropped when they are half of all
    (O(panes) per subject). If columns cannot fold a pane, it is irregular: `ready` then returns
    None for its windows.
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
        self.partials = [
            SlidingPartial(extremes, panes, distinct=distinct) for _, extremes in shape.arguments
        ]
        self.distinct = DistinctPairs(terms) if distinct else None
        self._is_direct = shape.direct
        self._is_simple = (
            shape.plain and not distinct and [a for a, _ in shape.arguments] == [shape.scan.object]
        )
        self.sorts = GroupSorts(shape.sorts, self.groups, static)
        self.irregular: deque[int] = deque()
        self._static_version: int | None = None
        self._static_pairs: Pairs | None = None
        self._static_counted: NDArray[np.bool_] = np.zeros(0, np.bool_)
        self._touched = ChangedGroups()
        # At the last evaluation: had rows in the window, were of the sorts and passed the HAVING.
        self._passing: NDArray[np.bool_] = np.zeros(0, np.bool_)
        self._compact_at = COMPACT
        terms.dictionary.hold(self)

    def held_ids(self) -> Iterator[NDArray[Any]]:
        """See `dictionary.Holder`. Groups keep their subjects until `_compact`; static pairs may
        have ids of canonical terms that `StaticSide` does not hold."""
        yield self.groups.members[: self.groups.used]
        yield from self.sorts.held_ids()
        for column in self._static_pairs or ():
            yield column.held_ids

    def fold(self, end: int, tables: Sequence[TripleRows]) -> None:
        """Fold the rows of the pane that ends at ``end``, in order."""
        self.groups.reach(len(self.terms.dictionary))
        predicate = self.terms.dictionary.find(self.shape.scan.predicate)
        found = [(t.subject, t.objects[predicate]) for t in tables if predicate in t.objects]
        if not (self._is_simple and self._fold_at_once(end, found)):
            self._fold_by_kind(end, found)
        # A group may come into the result by a fact of its sort, without a new row.
        for changed in self.sorts.fold(end, tables):
            self._touched.mark(changed)

    def _fold_at_once(self, end: int, found: Sequence[tuple[Ids, ObjectColumn]]) -> bool:
        """Fold a pane of few rows of one kind in one compiled call; return False, and do nothing,
        for another one. Law: the state afterwards is that of `_fold_by_kind`."""
        if len(found) != 1 or len(found[0][0]) > FEW:
            return False
        subjects, column = found[0]
        return self.partials[0].fold_pane(end, subjects, column, self.groups, self._touched)

    def _fold_by_kind(self, end: int, found: Sequence[tuple[Ids, ObjectColumn]]) -> None:
        try:
            for subjects, column in found:
                self._fold(end, subjects, column)
        except (NeedsOxigraph, BudgetExceeded):
            # Its windows are computed from all rows, which raises `BudgetExceeded` again if due.
            self.irregular.append(end)
            for partial in self.partials:
                partial.abandon(self.groups.used)
        self._touched.reserve(self.groups.used)
        for partial in self.partials:
            partial.push(end, self.groups.used, self._touched)

    def evict(self, until: int) -> None:
        """Evict the panes that end at or before ``until``."""
        for partial in self.partials:
            partial.evict(until, self._touched)
        if self.distinct is not None:
            # Under set semantics sums follow the distinct pairs, not the panes.
            for pairs in self.distinct.leave(until):
                self._count(pairs, -1)
        for changed in self.sorts.evict(until):
            self._touched.mark(changed)
        while self.irregular and self.irregular[0] <= until:
            self.irregular.popleft()
        if self.groups.used >= self._compact_at:
            self._compact()

    @property
    def is_regular(self) -> bool:
        """Whether all rows of the windows are in panes, and columns can fold each of these."""
        is_static = self._static_pairs is not None and len(self._static_pairs[0]) > 0
        return not (is_static or self.irregular or len(self.static.pairs(self.shape.scan)[0]))

    @property
    def has_extremes(self) -> bool:
        return any(extremes for _, extremes in self.shape.arguments)

    def has_room(self, new: int) -> bool:
        """Whether ``new`` groups more would let `evict` drop none."""
        return self.groups.used + new < self._compact_at

    def jump(self) -> None:
        """Evaluate all groups at the next window: some windows have not been evaluated here."""
        self._touched.all = True

    def ready(self, plan: Plan, source: Source) -> Relation | None:
        """Return the solutions of ``plan`` if it is the aggregate, or the HAVING on it.

        ``source`` provides the relations to join.
        """
        shape = self.shape
        having = self._is_direct and bool(shape.having) and plan is shape.having[0]
        if self.irregular or not (having or plan is shape.aggregate):
            return None
        self._with_static()
        if having:
            return self._having()
        if self._is_direct:
            return self._present(self.groups.used)[1]
        return self._joined(self._alive(slice(self.groups.used)), source)

    def solutions(self) -> Relation | None:
        """Return the solutions of the aggregate for all groups; None if a HAVING should test some
        groups only, or if they need another source."""
        is_selective = bool(self.shape.having) and self.groups.used > SELECTIVE
        if self.irregular or is_selective or not self._is_direct:
            return None
        self._touched.all = True
        self._with_static()
        return self._present(self.groups.used)[1]

    def _alive(self, rows: Rows) -> NDArray[np.int64]:
        """Return those of ``rows`` that have rows in the window and are of the sorts."""
        alive = self.partials[0].rows(rows) > 0
        if self.shape.sorts:
            alive &= self.sorts.holds(rows)
        return np.flatnonzero(alive) if isinstance(rows, slice) else rows[alive]

    def _having(self) -> Relation:
        """Return the groups that pass the HAVING. If few groups changed, only they are tested."""
        used = self.groups.used
        self._touched.reserve(used)
        self._passing = grow(self._passing, used, False)
        touched = self._touched.groups(used)
        test_all = touched is None or DENSE * len(touched) > used
        tested: Rows = slice(used) if touched is None or test_all else touched
        self._passing[tested] = False
        if isinstance(tested, slice):
            rows, relation = self._present(used)
        else:
            rows = self._alive(tested)
            relation = self._direct(rows)
        # The shape has the outermost filter first, but the innermost applies first.
        for filter in reversed(self.shape.having):
            kept = np.flatnonzero(
                holds(filter.condition, relation.columns, relation.rows, self.terms)
            )
            rows, relation = rows[kept], relation.take(kept)
        self._passing[rows] = True
        # Clear only now: after an error the same groups must be tested again.
        self._touched.clear()
        # Groups without a change keep their aggregates to the last bit, so they pass as before.
        return relation if test_all else self._direct(np.flatnonzero(self._passing[:used]))

    def _present(self, used: int) -> tuple[NDArray[np.int64], Relation]:
        """Return the groups that have rows in the window and are of the sorts, and the aggregates
        of these subjects."""
        of = self.sorts.holds(slice(used)) if self.shape.sorts else None
        found = self.partials[0].present(used, of) if len(self.partials) == 1 else None
        if found is None:
            rows = self._alive(slice(used))
            return rows, self._direct(rows)
        rows, partial = found
        return rows, self._of_subjects(rows, [partial])

    def _direct(self, rows: NDArray[np.int64]) -> Relation:
        """Return the aggregates of the subjects ``rows``."""
        return self._of_subjects(rows, [partial.partial(rows) for partial in self.partials])

    def _of_subjects(self, rows: NDArray[np.int64], partials: Sequence[Partial]) -> Relation:
        subject = self.shape.scan.subject
        assert isinstance(subject, Var)
        columns = {subject.name: ObjectColumn(Kind.TERM, self.groups.members[rows])}
        return self.finish(columns, partials, len(rows))

    def _joined(self, rows: NDArray[np.int64], source: Source) -> Relation:
        """Return the aggregates by the plan's keys, after the join with the rest."""
        partials = [partial.partial(rows) for partial in self.partials]
        columns = {}
        if isinstance(self.shape.scan.subject, Var):
            members = self.groups.members[rows]
            columns[self.shape.scan.subject.name] = ObjectColumn(Kind.TERM, members)
        rest = [execute(part, source, self.terms) for part in self.shape.rest]
        return self.grouped(Relation(columns, len(rows)), partials, rest)

    def grouped(
        self,
        subjects: Relation,
        partials: Sequence[Partial],
        rest: Sequence[Relation],
        windows: int | None = None,
    ) -> Relation:
        """Return the aggregates by the plan's keys, of ``partials`` of ``subjects`` joined with the
        ``rest``. ``windows``: the solutions are of this number of windows, and `END` is a key too.

        Law: with windows the rows of each are those of it alone, in the same order. So nothing here
        may depend on the number of rows, the order of joins above all.
        """
        shape = self.shape
        row = ObjectColumn(Kind.INTEGER, np.arange(subjects.rows))
        joined, waiting = Relation({_ROW: row, **subjects.columns}, subjects.rows), list(rest)
        while waiting:
            # A lone window has no `END`, so it must not link relations: the order would differ.
            names = joined.columns.keys() - {END}
            linked = [relation for relation in waiting if not names.isdisjoint(relation.columns)]
            chosen = (linked or waiting)[0]
            waiting = [relation for relation in waiting if relation is not chosen]
            joined = join(joined, chosen, self.terms)
        for condition in shape.later:
            joined = joined.take(holds(condition, joined.columns, joined.rows, self.terms))
        plan = shape.aggregate
        if windows is not None:
            plan = replace(plan, keys=(END, *plan.keys), implicit=False)
        if windows is not None and shape.aggregate.implicit:
            # There is a group in each window, even without rows.
            group, count = joined.columns[END].values, windows
            keys = {END: ObjectColumn(Kind.INTEGER, np.arange(windows))}
        else:
            group, first = grouping(plan, joined, self.terms)
            keys, count = group_keys(plan, joined, first), len(first)
        picked = joined.columns[_ROW].values
        merged = [partial.merged(group, picked, count) for partial in partials]
        return self.finish(keys, merged, count)

    def finish(
        self, columns: Mapping[str, ObjectColumn], partials: Sequence[Partial], rows: int
    ) -> Relation:
        """Return the aggregates of groups with these keys; they are the key of the relation."""
        plan, result = self.shape.aggregate, dict(columns)
        places = {argument: i for i, (argument, _) in enumerate(self.shape.arguments)}
        every = np.arange(rows)
        for one in plan.aggregations:
            partial = partials[places.get(one.argument, 0)]
            star = one.argument is None
            result[one.variable] = partial.finish(one.function, every, self.terms, star)
        return Relation(result, rows, frozenset(columns))

    def _fold(self, end: int, subjects: NDArray[np.int32], objects: ObjectColumn) -> None:
        """Fold rows of the scan's predicate."""
        skip = objects.null
        if skip is not None and not self.shape.plain:
            present = np.flatnonzero(~skip)
            subjects, objects, skip = subjects[present], objects.take(present), None
        pairs = ObjectColumn(Kind.TERM, subjects), ObjectColumn(objects.kind, objects.values)
        if not self.shape.plain:
            pairs = _take(pairs, self.selected(pairs))
        columns = self.arguments(pairs)
        for partial, column in zip(self.partials, columns, strict=True):
            partial.fold(pairs[0].values, column, skip, self.groups, self.terms)
        if self.distinct is not None:
            fresh = self.distinct.enter(end, pairs, skip)
            self._count((pairs[0].take(fresh), pairs[1].take(fresh)), 1)

    def selected(self, pairs: Pairs) -> NDArray[np.int64]:
        """Return the rows of pairs that the pattern matches and its filters pass."""
        scan, rows = self.shape.scan, np.arange(len(pairs[0]))
        for position, column in zip((scan.subject, scan.object), pairs, strict=True):
            if isinstance(position, Const):
                rows = rows[equals(column.take(rows), position, self.terms)]
        for condition in self.shape.filters:
            columns = _named(scan, _take(pairs, rows))
            rows = rows[holds(condition, columns, len(rows), self.terms)]
        return rows

    def arguments(self, pairs: Pairs) -> list[ObjectColumn]:
        """Return the aggregated values of these pairs, a column per argument."""
        columns, rows = _named(self.shape.scan, pairs), len(pairs[0])
        return [
            # COUNT(*) reads no value: one zero stands for all rows without memory for each.
            ObjectColumn(Kind.INTEGER, np.broadcast_to(np.int64(0), (rows,)))
            if argument is None
            else columns[argument.name]
            if isinstance(argument, Var) and argument.name in columns
            else evaluate(argument, columns, rows, self.terms)
            for argument, _ in self.shape.arguments
        ]

    def _count(self, pairs: Pairs, sign: int) -> None:
        """Add (1) or subtract (-1) pairs that do not belong to a pane."""
        if not len(pairs[0]):
            return
        for partial, column in zip(self.partials, self.arguments(pairs), strict=True):
            partial.add(pairs[0].values, column, sign, self.groups, self.terms, self._touched)

    def _with_static(self) -> None:
        """Add the static triples of the folded predicate, which never expire.

        Under set semantics those that the window contains as well do not count twice.
        """
        version = self.static.background.version
        if version != self._static_version:
            self._touched.all = True
            if self._static_pairs is not None:
                self._count(_take(self._static_pairs, self._static_counted), -1)
                self._static_pairs = None
            static = self.static.pairs(self.shape.scan)
            if self.distinct is not None:
                static = distinct_pairs(static, self.terms)
            pairs = _take(static, self.selected(static))
            self.groups.reach(len(self.terms.dictionary))
            columns = self.arguments(pairs)
            # Static rows never leave, so their extremes are held beside those of the panes.
            for partial, column in zip(self.partials, columns, strict=True):
                partial.hold(pairs[0].values, column, self.groups, self.terms)
            self._static_pairs = pairs
            self._static_counted = np.zeros(len(pairs[0]), np.bool_)
            # Set the version last: if columns cannot fold the static side, each window must raise.
            self._static_version = version
        assert self._static_pairs is not None
        count = np.ones(len(self._static_counted), np.bool_)
        if self.distinct is not None and len(count):
            count = ~self.distinct.holds(self._static_pairs)
        if len(count) and not np.array_equal(count, self._static_counted):
            self._count(_take(self._static_pairs, count & ~self._static_counted), 1)
            self._count(_take(self._static_pairs, self._static_counted & ~count), -1)
            self._static_counted = count

    def _compact(self) -> None:
        """Drop the groups without rows if they are half of all.

        This depends on the windows alone, so results do not depend on how the input is cut.
        """
        used = self.groups.used
        kept = np.flatnonzero(self.partials[0].rows(slice(used)) > 0)
        if 2 * len(kept) <= used:
            self.groups.keep(kept)
            self.sorts.forget()
            new: NDArray[np.int32] = np.full(used, -1, np.int32)
            new[kept] = np.arange(len(kept), dtype=np.int32)
            for partial in self.partials:
                partial.keep(kept, new)
            self._touched.all = True
            self._passing[:] = False
        # The next search waits until the groups have doubled, so it is O(1) for a new group.
        self._compact_at = max(COMPACT, 2 * len(kept))


def _named(scan: Scan, pairs: Pairs) -> dict[str, ObjectColumn]:
    """Return the pairs as columns of the scan's variables."""
    places = zip((scan.subject, scan.object), pairs, strict=True)
    return {place.name: column for place, column in places if isinstance(place, Var)}


def _take(pairs: Pairs, rows: NDArray[Any]) -> Pairs:
    return pairs[0].take(rows), pairs[1].take(rows)
