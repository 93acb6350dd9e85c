"""Groups of solutions and their aggregates for one window (SPARQL 1.1 §11, §18.5.1), and the order
of solutions (§15.1).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from pyoxigraph import Literal

from ...rdf.dictionary import NO_TERM
from ...rdf.timed import Kind, ObjectColumn
from ..algebra.expressions import Expression
from ..algebra.plan import Aggregate, Aggregation
from ..columns.expression_evaluation import evaluate
from ..columns.fold_kernels import Groups
from ..columns.ordering import sort_keys
from ..columns.relation import (
    Relation,
    TermValues,
    first_rows,
    key_codes,
    take_or_null,
)
from ..values.literals import LONG, Sort
from .partial_aggregates import Partial

Rows = NDArray[np.int64]


def aggregate(plan: Aggregate, relation: Relation, terms: TermValues) -> Relation:
    """Return a row per group, in order of appearance."""
    group, first = grouping(plan, relation, terms)
    count = len(first)
    result = group_keys(plan, relation, first)
    for one in plan.aggregations:
        value = None
        if one.argument is not None:
            value = evaluate(one.argument, relation.columns, relation.rows, terms)
        rows = None
        if one.distinct:
            rows = _distinct_rows(relation, group, value, terms)
        members = group if rows is None else group[rows]
        if value is not None and rows is not None:
            value = value.take(rows)
        result[one.variable] = _aggregated(one, members, value, count, terms)
    return Relation(result, count, frozenset(plan.keys))


def grouping(plan: Aggregate, relation: Relation, terms: TermValues) -> tuple[Rows, Rows]:
    """Return the group of each row, and the first row of each group.

    Without keys all rows are one group; an implicit group exists even without rows.
    """
    if not plan.keys:
        some = plan.implicit or relation.rows > 0
        return np.zeros(relation.rows, np.int64), np.zeros(int(some), np.int64)
    columns = [[relation.column(key)] for key in plan.keys]
    codes = key_codes(columns, terms.dictionary)[0]
    _, first, inverse = np.unique(codes, return_index=True, return_inverse=True)
    order = np.argsort(first, kind="stable")
    rank = np.empty(len(order), np.int64)
    rank[order] = np.arange(len(order))
    return rank[inverse.reshape(-1)], first[order]


def group_keys(plan: Aggregate, relation: Relation, first: Rows) -> dict[str, ObjectColumn]:
    """Return the key columns of the groups that begin at rows ``first``."""
    # An implicit group without rows has no first row, but no keys either.
    return {key: relation.column(key).take(first) for key in plan.keys}


def ordered(
    relation: Relation, keys: Sequence[tuple[Expression, bool]], terms: TermValues
) -> Relation:
    """Sort the rows by the keys, the first one first; the sort is stable."""
    arrays: list[NDArray[np.float64] | Rows] = []
    for expression, descending in keys:
        value = evaluate(expression, relation.columns, relation.rows, terms)
        arrays.extend(-key if descending else key for key in sort_keys(value, terms))
    if not arrays:
        return relation
    return relation.take(np.lexsort(arrays[::-1]))


def _distinct_rows(
    relation: Relation, group: Rows, value: ObjectColumn | None, terms: TermValues
) -> Rows:
    """Return the first row of each value in each group; for COUNT(DISTINCT *) of each solution."""
    columns = [value] if value is not None else list(relation.columns.values())
    by_group = ObjectColumn(Kind.INTEGER, group)
    return first_rows(key_codes([[c] for c in (by_group, *columns)], terms.dictionary)[0])


def _aggregated(
    one: Aggregation, group: Rows, value: ObjectColumn | None, count: int, terms: TermValues
) -> ObjectColumn:
    if value is None:
        value = ObjectColumn(Kind.INTEGER, np.zeros(len(group), np.int64))
    match one.function:
        case "SAMPLE":
            present = np.flatnonzero(value.present)
            return take_or_null(value, _first_of(present, group, count))
        case "GROUP_CONCAT":
            return _concatenated(value, group, count, one.separator, terms)
        case "MIN" | "MAX" if not _all_numbers(value, terms):
            return _extreme(one.function == "MIN", value, group, count, terms)
        case _:
            extremes = one.function in ("MIN", "MAX")
            subjects = group.astype(np.int32)
            partial = Partial.of(subjects, value, _dense(count), terms, extremes)
            return partial.finish(one.function, np.arange(count), terms)


def _dense(count: int) -> Groups:
    """Return the identity: each group is its own "subject"."""
    groups = Groups()
    groups.reach(count)
    groups.group_of[:count] = np.arange(count)
    groups.members, groups.used = np.arange(count, dtype=np.int32), count
    return groups


def _all_numbers(value: ObjectColumn, terms: TermValues) -> bool:
    if value.kind is not Kind.TERM:
        return value.kind.is_number
    sorts = terms.sorts(value.values[value.present])
    plain = (sorts >= Sort.INTEGER) & (sorts <= Sort.DOUBLE)
    return bool(np.all(plain | np.isin(sorts, LONG)))


def _first_of(rows: Rows, group: Rows, count: int) -> Rows:
    """Return for each group its first row in ``rows``, or -1."""
    found = np.full(count, -1, np.int64)
    found[group[rows[::-1]]] = rows[::-1]
    return found


def _extreme(
    least: bool, value: ObjectColumn, group: Rows, count: int, terms: TermValues
) -> ObjectColumn:
    """MIN or MAX by the order of ORDER BY; of equal numbers that of the first kind. An error among
    the values of a group makes its result an error."""
    keys = sort_keys(value, terms)
    kinds = [terms.sorts(value.values)] if value.kind is Kind.TERM else []
    order = np.lexsort([*kinds, *(key if least else -key for key in keys[::-1]), group])
    best = take_or_null(value, _first_of(order, group, count))
    failed = np.zeros(count, np.bool_)
    failed[group[~value.present]] = True
    null = failed | ~best.present
    return ObjectColumn(best.kind, best.values, null if null.any() else None)


def _concatenated(
    value: ObjectColumn, group: Rows, count: int, separator: str, terms: TermValues
) -> ObjectColumn:
    """GROUP_CONCAT: a string without a language, of strings only. Cost: Python per value."""
    dictionary = terms.dictionary
    texts: list[list[str]] = [[] for _ in range(count)]
    failed = np.zeros(count, np.bool_)
    strings = np.zeros(len(value), np.bool_)
    if value.kind is Kind.TERM:
        sorts = terms.sorts(value.values)
        strings = value.present & ((sorts == Sort.STRING) | (sorts == Sort.TEXT))
    characters = 0
    for row, at in enumerate(terms.budget.paced(group.tolist())):
        if not strings[row]:
            failed[at] = True
            continue
        term = dictionary.term(int(value.values[row]))
        assert isinstance(term, Literal)
        characters += len(term.value) + len(separator)
        terms.budget.check_text(characters, "GROUP_CONCAT")
        texts[at].append(term.value)
    ids = np.full(count, NO_TERM, np.int32)
    for at in terms.budget.paced(np.flatnonzero(~failed).tolist()):
        ids[at] = dictionary.transient_id(Literal(separator.join(texts[at])))
    return ObjectColumn(Kind.TERM, ids, failed if failed.any() else None)
