"""The physical operators on relations: scan, join, filter, group, and the execution of a plan.

All in numpy, a call a column. Solutions come in an order that depends on the rows only, not on
how they were cut into batches.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Protocol, assert_never

import numpy as np
from numpy.typing import NDArray

from ..rdf.dictionary import NO_TERM
from ..rdf.timed import Kind, ObjectColumn, TripleRows, split_term
from .columns import (
    NeedsOxigraph,
    Relation,
    TermValues,
    concatenate,
    first_rows,
    key_codes,
    term_column,
)
from .expressions import Const, Var, evaluate, holds
from .kernels import Groups
from .logical import (
    Aggregate,
    Distinct,
    Extend,
    Filter,
    Join,
    Plan,
    Position,
    Project,
    Scan,
    TypeScan,
    Values,
)
from .partials import Partial

Pairs = tuple[ObjectColumn, ObjectColumn]
"""Subjects and objects of triples of one predicate: two columns of one length, without nulls."""


class Source(Protocol):
    """Where the leaves of a plan come from."""

    def pairs(self, scan: Scan | TypeScan) -> Pairs:
        """The triples of a scan's predicate (a superset of what its constants select)."""

    def ready(self, plan: Plan) -> Relation | None:
        """The solutions of ``plan`` if they are at hand already."""


def execute(plan: Plan, source: Source, terms: TermValues) -> Relation:
    """The solutions of ``plan``. Cost: that of sorting each join and group key once."""
    ready = source.ready(plan)
    if ready is not None:
        return ready
    match plan:
        case Scan(subject, _, object) | TypeScan(subject, object):
            return select_pairs(source.pairs(plan), subject, object, terms)
        case Values(variables, rows):
            columns = {
                name: term_column([row[i] for row in rows], terms.dictionary)
                for i, name in enumerate(variables)
            }
            return Relation(columns, len(rows))
        case Join(parts):
            return join_all([execute(part, source, terms) for part in parts], terms)
        case Filter(condition, child):
            relation = execute(child, source, terms)
            return relation.take(holds(condition, relation.columns, relation.rows, terms))
        case Extend(variable, expression, child):
            relation = execute(child, source, terms)
            if variable in relation.columns:
                raise NeedsOxigraph(f"?{variable} is bound twice")
            value = evaluate(expression, relation.columns, relation.rows, terms)
            return Relation({**relation.columns, variable: value}, relation.rows, relation.key)
        case Aggregate():
            return aggregate(plan, execute(plan.child, source, terms), terms)
        case Project(variables, child):
            relation = execute(child, source, terms)
            columns = {name: _column(relation, name) for name in variables}
            key = (
                relation.key if relation.key is not None and relation.key <= set(columns) else None
            )
            return Relation(columns, relation.rows, key)
        case Distinct(child):
            relation = execute(child, source, terms)
            if relation.key is not None:
                return relation
            return distinct(relation, terms)
        case _:
            assert_never(plan)


def distinct(relation: Relation, terms: TermValues) -> Relation:
    """Each solution once, where it first stands."""
    if not relation.columns or relation.rows < 2:
        return relation.take(np.arange(min(relation.rows, 1)))
    codes = key_codes([[column] for column in relation.columns.values()], terms.dictionary)[0]
    return relation.take(first_rows(codes))


def select_pairs(pairs: Pairs, subject: Position, object: Position, terms: TermValues) -> Relation:
    """The pairs that match a pattern, as a relation over its variables."""
    keep: NDArray[np.bool_] | None = None
    for position, column in zip((subject, object), pairs, strict=True):
        if isinstance(position, Const):
            same = _equals(column, position, terms)
            keep = same if keep is None else keep & same
    if isinstance(subject, Var) and subject == object:
        left, right = key_codes([[pairs[0], pairs[1]]], terms.dictionary)
        keep = left == right
    columns = {
        position.name: column if keep is None else column.take(keep)
        for position, column in zip((subject, object), pairs, strict=True)
        if isinstance(position, Var)
    }
    rows = len(pairs[0]) if keep is None else int(np.count_nonzero(keep))
    return Relation(columns, rows)


def _equals(column: ObjectColumn, constant: Const, terms: TermValues) -> NDArray[np.bool_]:
    kind, value = split_term(constant.term, terms.dictionary)
    if column.kind is Kind.TERM:
        return np.asarray(column.values == terms.dictionary.find(constant.term))
    if column.kind is not kind:
        return np.zeros(len(column), np.bool_)
    return np.asarray(column.values == value)


def join_all(relations: Sequence[Relation], terms: TermValues) -> Relation:
    """The natural join: from the smallest on, always the smallest that shares a variable."""
    if not relations:
        return Relation({}, 1)
    waiting = sorted(relations, key=lambda relation: relation.rows)
    joined = waiting.pop(0)
    while waiting:
        linked = [r for r in waiting if not joined.columns.keys().isdisjoint(r.columns)]
        chosen = (linked or waiting)[0]
        waiting = [relation for relation in waiting if relation is not chosen]
        joined = join(joined, chosen, terms)
    return joined


def join(left: Relation, right: Relation, terms: TermValues) -> Relation:
    """The natural join of two relations, in the order of ``left``, then of ``right``."""
    shared = [name for name in left.columns if name in right.columns]
    if any(r.columns[name].null is not None for name in shared for r in (left, right)):
        raise NeedsOxigraph("a join on a variable that may be unbound")
    if shared:
        pairs = [[left.columns[name], right.columns[name]] for name in shared]
        at_left, at_right = match_keys(*key_codes(pairs, terms.dictionary))
    else:
        at_left = np.repeat(np.arange(left.rows), right.rows)
        at_right = np.tile(np.arange(right.rows), left.rows)
    columns = {name: column.take(at_left) for name, column in left.columns.items()}
    for name, column in right.columns.items():
        if name not in columns:
            columns[name] = column.take(at_right)
    return Relation(columns, len(at_left))


def match_keys(
    left: NDArray[np.int64], right: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """All pairs of rows with equal codes, as two index arrays."""
    order = np.argsort(right, kind="stable")
    ordered = right[order]
    low = np.searchsorted(ordered, left, "left")
    count = np.searchsorted(ordered, left, "right") - low
    at_left = np.repeat(np.arange(len(left)), count)
    offset = np.arange(len(at_left)) - np.repeat(np.cumsum(count) - count, count)
    return at_left, order[np.repeat(low, count) + offset]


def aggregate(plan: Aggregate, relation: Relation, terms: TermValues) -> Relation:
    """A row a group, groups in order of appearance."""
    group, first = grouping(plan, relation, terms)
    count = len(first)
    groups = Groups()
    groups.reach(count)
    # The groups are dense already: each is its own "subject".
    groups.group_of[:count] = np.arange(count)
    groups.members, groups.used = np.arange(count, dtype=np.int32), count
    result = group_keys(plan, relation, first)
    for one in plan.aggregations:
        partial = Partial()
        if one.argument is None:
            value = ObjectColumn(Kind.INTEGER, np.zeros(relation.rows, np.int64))
        else:
            value = evaluate(one.argument, relation.columns, relation.rows, terms)
        extremes = one.function in ("MIN", "MAX")
        partial.add(group.astype(np.int32), value, None, groups, terms, extremes)
        result[one.variable] = partial.finish(one.function, np.arange(count), terms)
    return Relation(result, count, frozenset(plan.keys))


def grouping(
    plan: Aggregate, relation: Relation, terms: TermValues
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The group of each row, and the first row of each group.

    Without keys all rows are one group; an implicit group is there though it has no row.
    """
    if not plan.keys:
        some = plan.implicit or relation.rows > 0
        return np.zeros(relation.rows, np.int64), np.zeros(int(some), np.int64)
    columns = [[_column(relation, key)] for key in plan.keys]
    codes = key_codes(columns, terms.dictionary)[0]
    _, first, inverse = np.unique(codes, return_index=True, return_inverse=True)
    order = np.argsort(first, kind="stable")
    rank = np.empty(len(order), np.int64)
    rank[order] = np.arange(len(order))
    return rank[inverse.reshape(-1)], first[order]


def group_keys(
    plan: Aggregate, relation: Relation, first: NDArray[np.int64]
) -> dict[str, ObjectColumn]:
    """The key columns of the groups that begin at rows ``first``."""
    return {key: _column(relation, key).take(first) for key in plan.keys}


def _column(relation: Relation, name: str) -> ObjectColumn:
    column = relation.columns.get(name)
    if column is not None:
        return column
    nothing = np.full(relation.rows, NO_TERM, np.int32)
    return ObjectColumn(Kind.TERM, nothing, np.ones(relation.rows, np.bool_))


def pairs_of(
    tables: Iterable[TripleRows], predicate: int, extra: Pairs | None, terms: TermValues
) -> Pairs:
    """The triples of ``predicate`` in ``tables``, and ``extra`` after them."""
    subjects: list[ObjectColumn] = []
    objects: list[ObjectColumn] = []
    for table in tables:
        column = table.objects.get(predicate)
        if column is None:
            continue
        subject = table.subject
        if column.null is not None:
            present = ~column.null
            subject = subject[present]
            column = ObjectColumn(column.kind, column.values[present])
        subjects.append(ObjectColumn(Kind.TERM, subject))
        objects.append(column)
    if extra is not None and len(extra[0]):
        subjects.append(extra[0])
        objects.append(extra[1])
    if not subjects:
        nothing = ObjectColumn(Kind.TERM, np.zeros(0, np.int32))
        return nothing, nothing
    return concatenate(subjects, terms.dictionary), concatenate(objects, terms.dictionary)
