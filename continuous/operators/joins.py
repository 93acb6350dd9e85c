"""Joins of relations whose variables may be unbound: natural, OPTIONAL, MINUS (SPARQL 1.1 §18.3).

Two solutions are compatible if they agree on the variables that both bind. So rows are grouped by
which shared variables they bind, and each two groups are matched on the variables that both bind.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence, Set
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from ...rdf.timed import ObjectColumn
from ..algebra.expressions import Expression
from ..columns.budget import Budget
from ..columns.expression_evaluation import holds
from ..columns.relation import (
    Relation,
    TermValues,
    coalesce,
    key_codes,
    take_or_null,
)

Rows: TypeAlias = NDArray[np.int64]


def join_all(relations: Sequence[Relation], terms: TermValues) -> Relation:
    """Join all: start with the smallest, then always take the smallest that shares a variable."""
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
    """Join two relations, in the order of ``left``, then of ``right``."""
    return _joined(left, right, *match_rows(left, right, terms), terms)


def left_join(
    left: Relation, right: Relation, condition: Expression | None, terms: TermValues
) -> Relation:
    """Return the join where ``condition`` holds, and the rows of ``left`` without a partner."""
    at_left, at_right = match_rows(left, right, terms)
    if condition is not None:
        joined = _joined(left, right, at_left, at_right, terms)
        keep = holds(condition, joined.columns, joined.rows, terms)
        at_left, at_right = at_left[keep], at_right[keep]
    alone = np.ones(left.rows, np.bool_)
    alone[at_left] = False
    rest = np.flatnonzero(alone)
    if len(rest):
        at_left = np.concatenate([at_left, rest])
        at_right = np.concatenate([at_right, np.full(len(rest), -1)])
        # The order is that of the left rows, with or without a partner.
        order = np.argsort(at_left, kind="stable")
        at_left, at_right = at_left[order], at_right[order]
    return _joined(left, right, at_left, at_right, terms)


def minus(left: Relation, right: Relation, terms: TermValues, beside: str = "") -> Relation:
    """Return the rows of ``left`` that share no binding with a compatible row of ``right``. The
    variable ``beside`` does not count as shared."""
    # A solution without a common variable is never removed (SPARQL 1.1 §18.3).
    if not any(name in right.columns for name in left.columns if name != beside):
        return left
    at_left, _ = match_rows(left, right, terms, besides=frozenset({beside}))
    keep = np.ones(left.rows, np.bool_)
    keep[at_left] = False
    return left.take(keep)


def has_match(left: Relation, right: Relation, terms: TermValues) -> NDArray[np.bool_]:
    """Return which rows of ``left`` have a compatible row in ``right``."""
    found = np.zeros(left.rows, np.bool_)
    if not any(name in right.columns for name in left.columns):
        # Solutions without a common variable are always compatible.
        found[:] = right.rows > 0
        return found
    found[match_rows(left, right, terms)[0]] = True
    return found


def match_rows(
    left: Relation, right: Relation, terms: TermValues, *, besides: Set[str] | None = None
) -> tuple[Rows, Rows]:
    """Return all pairs of compatible rows, by the left one, then by the right one.

    ``besides``: rows that share no variable but these do not match. Cost: a sort of the right keys
    per combination of variables bound on the two sides; one if all are bound. Raises
    `BudgetExceeded`.
    """
    shared = [name for name in left.columns if name in right.columns]
    parts = [
        _matched(left, right, bound, at_left, at_right, terms)
        for bound, at_left, at_right in _combinations(left, right, shared)
        if besides is None or not besides >= set(bound)
    ]
    if len(parts) == 1:
        return parts[0]
    if not parts:
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    at_left = np.concatenate([part[0] for part in parts])
    at_right = np.concatenate([part[1] for part in parts])
    order = np.lexsort((at_right, at_left))
    return at_left[order], at_right[order]


def _combinations(
    left: Relation, right: Relation, shared: Sequence[str]
) -> Iterator[tuple[list[str], Rows | None, Rows | None]]:
    """Yield the variables that two groups of rows both bind, and these rows (None: all)."""
    nullable = [
        name
        for name in shared
        if left.columns[name].null is not None or right.columns[name].null is not None
    ]
    if not nullable:
        yield list(shared), None, None
        return
    for left_mask, at_left in _parted(left, nullable):
        for right_mask, at_right in _parted(right, nullable):
            both = left_mask & right_mask
            unbound = {name for i, name in enumerate(nullable) if not both >> i & 1}
            yield [name for name in shared if name not in unbound], at_left, at_right


def _parted(relation: Relation, names: Sequence[str]) -> Iterator[tuple[int, Rows]]:
    masks = np.zeros(relation.rows, np.int64)
    for i, name in enumerate(names):
        masks |= relation.columns[name].present.astype(np.int64) << i
    for mask in np.unique(masks).tolist():
        yield int(mask), np.flatnonzero(masks == mask)


def parted_by_bound(
    relation: Relation, names: Sequence[str]
) -> Iterator[tuple[Rows, tuple[str, ...]]]:
    """Yield groups of rows by which of ``names`` they bind: the rows, and these names."""
    if all(relation.columns[name].null is None for name in names):
        yield np.arange(relation.rows), tuple(names)
        return
    for mask, at in _parted(relation, names):
        yield at, tuple(name for i, name in enumerate(names) if mask >> i & 1)


def _matched(
    left: Relation,
    right: Relation,
    names: Sequence[str],
    at_left: Rows | None,
    at_right: Rows | None,
    terms: TermValues,
) -> tuple[Rows, Rows]:
    """Return the pairs of these rows that agree on ``names``, which all of them bind."""
    lefts = np.arange(left.rows) if at_left is None else at_left
    rights = np.arange(right.rows) if at_right is None else at_right
    if not names:
        # The check comes first, since the product may not fit into memory.
        terms.budget.check(len(lefts) * len(rights), "a join without a common variable")
        with terms.budget.pauses.released():
            return np.repeat(lefts, len(rights)), np.tile(rights, len(lefts))
    pairs = []
    for name in names:
        a, b = left.columns[name], right.columns[name]
        # These rows bind all of the names, so the columns need no mask.
        if at_left is not None:
            a = ObjectColumn(a.kind, a.values[lefts])
        if at_right is not None:
            b = ObjectColumn(b.kind, b.values[rights])
        pairs.append([a, b])
    left_keys, right_keys = key_codes(pairs, terms.dictionary)
    found_left, found_right = match_keys(left_keys, right_keys, terms.budget)
    return lefts[found_left], rights[found_right]


def match_keys(left: Rows, right: Rows, budget: Budget) -> tuple[Rows, Rows]:
    """Return all pairs of rows with equal codes, as two index arrays."""
    with budget.pauses.released():
        order = np.argsort(right, kind="stable")
        ordered = right[order]
        low = np.searchsorted(ordered, left, "left")
        count = np.searchsorted(ordered, left, "right") - low
    budget.check(int(count.sum()), "a join")
    with budget.pauses.released():
        at_left = np.repeat(np.arange(len(left)), count)
        offset = np.arange(len(at_left)) - np.repeat(np.cumsum(count) - count, count)
        return at_left, order[np.repeat(low, count) + offset]


def _joined(
    left: Relation, right: Relation, at_left: Rows, at_right: Rows, terms: TermValues
) -> Relation:
    """Return paired rows side by side; where ``at_right`` is -1, the left row alone."""
    columns: dict[str, ObjectColumn] = {}
    pauses = terms.budget.pauses
    for name, column in left.columns.items():
        with pauses.released():
            taken = column.take(at_left)
        # A row may leave a variable unbound that its partner binds.
        if name in right.columns and taken.null is not None:
            taken = coalesce(taken, take_or_null(right.columns[name], at_right), terms.dictionary)
        columns[name] = taken
    for name, column in right.columns.items():
        if name not in columns:
            with pauses.released():
                columns[name] = take_or_null(column, at_right)
    return Relation(columns, len(at_left))
