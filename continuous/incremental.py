"""The incremental path: aggregates of one stream pattern, kept as partials a pane and a subject.

It serves ``Aggregate(keys, …, ?s <p> ?v joined with patterns on ?s)``: per pane the rows of <p>
are folded by subject; per window the panes are merged (`sliding`), then joined with the rest,
which is small, and grouped by the keys. Law: same solutions as `relational.execute` over the
window's rows.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pyoxigraph import Literal, NamedNode

from ..rdf.namespaces import RDF_TYPE
from ..rdf.timed import Kind, ObjectColumn, TripleRows
from .columns import NeedsOxigraph, Relation, TermValues
from .evaluation import evaluate, holds
from .expressions import Call, Const, Expression, Var, variables
from .grouping import group_keys, grouping
from .joins import join_all
from .kernels import Groups, grown
from .logical import (
    DEFAULT,
    Aggregate,
    Extend,
    Filter,
    Join,
    Plan,
    Scan,
    TypeScan,
    Values,
    outputs,
    walk,
)
from .partials import Partial
from .relational import Pairs, execute, select_pairs
from .sliding import Partials, Sliding
from .sources import StaticSide, WindowSource, distinct_ids

_ROW = "\0row"
COMPACT = 1024
"""Below this many groups it is not worth while to forget any."""


@dataclass(frozen=True, slots=True)
class Shape:
    """How an Aggregate is computed incrementally.

    ``scan`` is folded, rows passing ``filters`` only; ``sorts`` are asked of its subject;
    ``rest`` is joined a window, then ``later`` filters hold. ``arguments``: what is aggregated
    (``*`` alone as None), with whether extremes are kept. ``retains``: raw rows stay as long as
    their window, since the rest or a fallback may need them.
    """

    aggregate: Aggregate
    scan: Scan
    sorts: tuple[NamedNode, ...]
    rest: tuple[Plan, ...]
    filters: tuple[Expression, ...]
    later: tuple[Expression, ...]
    arguments: tuple[tuple[Expression | None, bool], ...]
    retains: bool

    @property
    def plain(self) -> bool:
        """Whether rows can be folded as they are."""
        return (
            isinstance(self.scan.subject, Var)
            and isinstance(self.scan.object, Var)
            and not self.filters
            and all(argument in (None, self.scan.object) for argument, _ in self.arguments)
        )


def shape_of(plan: Plan, static: StaticSide) -> Shape | str:
    """How ``plan`` can be computed incrementally, or why it cannot."""
    aggregates = [node for node in walk(plan) if isinstance(node, Aggregate)]
    if len(aggregates) != 1:
        return "it has no aggregate" if not aggregates else "it has several aggregates"
    aggregate = aggregates[0]
    leaves: list[Plan] = []
    conditions: list[Expression] = []
    if not _flat(aggregate.child, leaves, conditions):
        return "there is more than patterns, FILTER and VALUES under the aggregate"
    scans = [leaf for leaf in leaves if isinstance(leaf, Scan)]
    # A pattern that the static side knows nothing of is the one the stream is for.
    scans.sort(key=lambda scan: static.background.has(scan.predicate))
    reason = "there is no pattern to fold"
    for scan in scans:
        found = _try(plan, aggregate, scan, leaves, conditions)
        if isinstance(found, Shape):
            return found
        reason = found
    return reason


def _flat(plan: Plan, leaves: list[Plan], conditions: list[Expression]) -> bool:
    match plan:
        case Scan() | TypeScan() | Values():
            leaves.append(plan)
            return True
        case Filter(condition, child):
            conditions.append(condition)
            return _flat(child, leaves, conditions)
        case Join(parts):
            flat = [_flat(part, leaves, conditions) for part in parts]
            return all(flat)
        case _:
            return False


def _try(
    plan: Plan, aggregate: Aggregate, scan: Scan, leaves: list[Plan], conditions: list[Expression]
) -> Shape | str:
    own = outputs(scan)
    subject = scan.subject.name if isinstance(scan.subject, Var) else None
    value = scan.object.name if isinstance(scan.object, Var) else None
    if subject is not None and subject == value:
        return "subject and object are one variable"
    others = [leaf for leaf in leaves if leaf is not scan]
    elsewhere = frozenset().union(*map(outputs, others))
    if value is not None and (value in elsewhere or value in aggregate.keys):
        return f"?{value} is joined or grouped by"
    wanted: dict[Expression | None, bool] = {}
    for one in aggregate.aggregations:
        if one.distinct or one.function not in ("COUNT", "SUM", "AVG", "MIN", "MAX"):
            return f"{one.function}{' DISTINCT' if one.distinct else ''} needs all values"
        if one.argument is not None and not variables(one.argument) <= own:
            return f"{one.function} is not over the folded pattern alone"
        extreme = one.function in ("MIN", "MAX")
        wanted[one.argument] = wanted.get(one.argument, False) or extreme
    if len(wanted) > 1 and None in wanted:
        del wanted[None]
    if not wanted:
        wanted[None] = False
    filters = tuple(c for c in conditions if variables(c) <= own)
    later = tuple(c for c in conditions if not variables(c) <= own)
    if value is not None and any(value in variables(c) for c in later):
        return f"a FILTER compares ?{value} with another pattern"
    sorts, rest = [], []
    for leaf in others:
        if (
            isinstance(leaf, TypeScan)
            and leaf.subject == scan.subject
            and isinstance(leaf.sort, Const)
            and isinstance(leaf.sort.term, NamedNode)
        ):
            sorts.append(leaf.sort.term)
        else:
            rest.append(leaf)
    certain = (
        not rest
        and not filters
        and not later
        and all(a in (None, scan.object) and not extreme for a, extreme in wanted.items())
        and _certain_above(plan, aggregate)
    )
    return Shape(
        aggregate,
        scan,
        tuple(sorts),
        tuple(rest),
        filters,
        later,
        tuple(wanted.items()),
        retains=not certain,
    )


def _certain_above(plan: Plan, aggregate: Aggregate) -> bool:
    """Whether what comes after the aggregate can never need Oxigraph: comparisons of numbers."""
    numbers = {one.variable for one in aggregate.aggregations}
    for node in walk(plan):
        if node is aggregate:
            return True
        if isinstance(node, Filter) and not _certain(node.condition, numbers):
            return False
        if isinstance(node, Extend) and not isinstance(node.expression, Var | Const):
            return False
        if isinstance(node, Join):
            return False
        if isinstance(node, Extend):
            expression = node.expression
            if isinstance(expression, Var) and expression.name in numbers:
                numbers.add(node.variable)
    return True


def _certain(expression: Expression, numbers: set[str]) -> bool:
    match expression:
        case Var(name):
            return name in numbers
        case Const(Literal() as literal):
            return literal.datatype.value.endswith(("#integer", "#decimal", "#double", "#boolean"))
        case Call(name, arguments):
            known = name in ("=", "!=", "<", "<=", ">", ">=", "&&", "||", "!")
            return known and all(_certain(argument, numbers) for argument in arguments)
        case _:
            return False


class SortFacts:
    """Which subjects the window's rows tell to be of a sort: counted by pane, a set to queries."""

    def __init__(self, sort: NamedNode) -> None:
        self.sort = sort
        self._counts: NDArray[np.int32] = np.zeros(0, np.int32)
        self._panes: deque[tuple[int, NDArray[np.int32]]] = deque()
        self._known: NDArray[np.int32] | None = None
        self._static: NDArray[np.bool_] = np.zeros(0, np.bool_)

    def fold(self, end: int, tables: Sequence[TripleRows], static: StaticSide) -> None:
        """The facts of the pane that ends at ``end``."""
        dictionary = static.terms.dictionary
        rdf_type, sort = dictionary.find(RDF_TYPE), dictionary.find(self.sort)
        parts = []
        for table in tables:
            if static.sort_holds(table.sort, self.sort.value):
                parts.append(table.subject)
            column = table.objects.get(rdf_type)
            if column is not None and column.kind is Kind.TERM:
                parts.append(table.subject[column.present & (column.values == sort)])
        if parts:
            ids = distinct_ids(parts, len(dictionary))
            if len(self._counts) < len(dictionary):
                self._counts = grown(self._counts, 2 * len(dictionary), 0)
            self._counts[ids] += 1
            self._panes.append((end, ids))

    def evict(self, until: int) -> None:
        """Forget the panes that end at or before ``until``."""
        while self._panes and self._panes[0][0] <= until:
            self._counts[self._panes.popleft()[1]] -= 1

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
        return np.asarray((self._counts[subjects] > 0) | self._static[subjects])


class Incremental:
    """The state of one incremental aggregate: partials by pane, facts by pane.

    Cost: a kernel call a table and pane, O(groups) a window. Memory: two numbers a group and pane.
    Groups are the subjects of the window; those that have left it are forgotten when they are half
    of all (O(panes) a subject). A pane that columns cannot fold is irregular: `relation` is then
    None for its windows.
    """

    def __init__(self, shape: Shape, static: StaticSide, terms: TermValues) -> None:
        self.shape = shape
        self.static = static
        self.terms = terms
        self.groups = Groups()
        self._sliding: Sliding[Partials] = Sliding()
        self._facts = [SortFacts(sort) for sort in shape.sorts]
        self._irregular: deque[int] = deque()
        self._static_version: int | None = None
        self._static_partials: Partials | None = None
        self._compact_at = COMPACT

    def fold(self, end: int, tables: Sequence[TripleRows]) -> None:
        """The rows of the pane that ends at ``end``, in order."""
        self.groups.reach(len(self.terms.dictionary))
        try:
            predicate = self.terms.dictionary.find(self.shape.scan.predicate)
            self._sliding.push(end, self._folded(self._pairs(tables, predicate)))
        except NeedsOxigraph:
            self._irregular.append(end)
        for facts in self._facts:
            facts.fold(end, tables, self.static)

    def evict(self, until: int) -> None:
        """Forget the panes that end at or before ``until``."""
        self._sliding.evict(until)
        for facts in self._facts:
            facts.evict(until)
        while self._irregular and self._irregular[0] <= until:
            self._irregular.popleft()
        if self.groups.used >= self._compact_at:
            self._compact()

    def _compact(self) -> None:
        """Forget the groups without rows if they are half of all.

        It depends on the windows alone, so results stay the same however the input is cut.
        """
        used = self.groups.used
        alive = np.zeros(used, np.bool_)
        for part in (self._sliding.total(), self._static_partials):
            if part is not None:
                alive |= part[0].rows(used) > 0
        kept = np.flatnonzero(alive)
        if 2 * len(kept) <= used:
            self.groups.keep(kept)
            self._sliding.change(lambda partials: partials.taken(kept))
            if self._static_partials is not None:
                self._static_partials = self._static_partials.taken(kept)
        self._compact_at = max(COMPACT, 2 * len(kept))

    def relation(self, tables: Sequence[TripleRows]) -> Relation | None:
        """The groups of the window, whose rows are ``tables`` (empty where nothing is retained)."""
        if self._irregular:
            return None
        total = self._with_static(self._sliding.total())
        used = self.groups.used
        alive = np.zeros(used, np.bool_) if total is None else total[0].rows(used) > 0
        for facts in self._facts:
            alive &= facts.holds(self.groups.members[:used], self.static)
        rows = np.flatnonzero(alive)
        partials = Partials(Partial() for _ in self.shape.arguments) if total is None else total
        return self._grouped(partials, rows, tables)

    def _grouped(
        self, partials: Partials, rows: NDArray[np.int64], tables: Sequence[TripleRows]
    ) -> Relation:
        shape, plan = self.shape, self.shape.aggregate
        subject = shape.scan.subject
        columns: dict[str, ObjectColumn] = {}
        if isinstance(subject, Var):
            columns[subject.name] = ObjectColumn(Kind.TERM, self.groups.members[rows])
        if plan.keys and plan.keys == tuple(columns) and not shape.rest and not shape.later:
            result, at = dict(columns), rows
        else:
            base = Relation({**columns, _ROW: ObjectColumn(Kind.INTEGER, rows)}, len(rows))
            source = WindowSource({DEFAULT: tables}, self.static, windows=(), distinct=False)
            rest = [execute(part, source, self.terms) for part in shape.rest]
            joined = join_all([base, *rest], self.terms)
            for condition in shape.later:
                joined = joined.take(holds(condition, joined.columns, joined.rows, self.terms))
            group, first = grouping(plan, joined, self.terms)
            result = group_keys(plan, joined, first)
            picked = joined.columns[_ROW].values
            partials = Partials(p.merged(group, picked, len(first)) for p in partials)
            at = np.arange(len(first))
        places = {argument: i for i, (argument, _) in enumerate(shape.arguments)}
        for one in plan.aggregations:
            partial = partials[places.get(one.argument, 0)]
            star = one.argument is None
            result[one.variable] = partial.finish(one.function, at, self.terms, star)
        return Relation(result, len(at), frozenset(plan.keys))

    def _with_static(self, total: Partials | None) -> Partials | None:
        """The static triples of the folded predicate are one more pane, always there."""
        version = self.static.background.version
        if version != self._static_version:
            pairs = self.static.pairs(self.shape.scan)
            self.groups.reach(len(self.terms.dictionary))
            self._static_partials = self._folded([pairs]) if len(pairs[0]) else None
            # Last: where columns cannot fold the static side, every window has to say so.
            self._static_version = version
        if self._static_partials is None:
            return total
        return self._static_partials if total is None else total + self._static_partials

    def _pairs(self, tables: Sequence[TripleRows], predicate: int) -> list[Pairs]:
        return [
            (ObjectColumn(Kind.TERM, table.subject), table.objects[predicate])
            for table in tables
            if predicate in table.objects
        ]

    def _folded(self, tables: Sequence[Pairs]) -> Partials:
        partials = Partials(Partial() for _ in self.shape.arguments)
        for subjects, objects in tables:
            if self.shape.plain:
                whole = ObjectColumn(objects.kind, objects.values)
                self._add(partials, subjects.values, [whole] * len(partials), objects.null)
                continue
            if objects.null is not None:
                present = ~objects.null
                subjects = subjects.take(present)
                objects = ObjectColumn(objects.kind, objects.values[present])
            scan = self.shape.scan
            if isinstance(scan.subject, Const):
                # Selected by its own id, so that a group stands for it although it has no column.
                mine = subjects.values == self.terms.dictionary.find(scan.subject.term)
                subjects, objects = subjects.take(mine), objects.take(mine)
            relation = select_pairs((subjects, objects), Var("\0s"), scan.object, self.terms)
            named = {**relation.columns}
            if isinstance(scan.subject, Var):
                named[scan.subject.name] = named["\0s"]
            relation = Relation(named, relation.rows)
            for condition in self.shape.filters:
                keep = holds(condition, relation.columns, relation.rows, self.terms)
                relation = relation.take(keep)
            columns = [
                ObjectColumn(Kind.INTEGER, np.zeros(relation.rows, np.int64))
                if argument is None
                else evaluate(argument, relation.columns, relation.rows, self.terms)
                for argument, _ in self.shape.arguments
            ]
            self._add(partials, relation.columns["\0s"].values, columns, None)
        return partials

    def _add(
        self,
        partials: Partials,
        subjects: NDArray[np.int32],
        columns: Sequence[ObjectColumn],
        skip: NDArray[np.bool_] | None,
    ) -> None:
        for partial, column, (argument, extremes) in zip(
            partials, columns, self.shape.arguments, strict=True
        ):
            if argument is None:
                column = ObjectColumn(Kind.INTEGER, np.zeros(len(subjects), np.int64))
            partial.add(subjects, column, skip, self.groups, self.terms, extremes)
