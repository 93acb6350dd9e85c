"""The order of terms (SPARQL 1.1 §15.1), as arrays to sort by.

Unbound, blank nodes, IRIs, literals. Among literals: NaN, the other numbers by value, strings, then
literals with another order (dates, booleans). The specification leaves the order between them open;
this choice makes the same rows always give the same order.
"""

from __future__ import annotations

from collections.abc import Sequence
from decimal import Decimal
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pyoxigraph import BlankNode, Literal, NamedNode, Store

from ...languages.csparql import term_text
from ...rdf.datatypes import INTEGERS
from ...rdf.dictionary import Term
from ...rdf.namespaces import XSD
from ...rdf.timed import Kind, ObjectColumn
from ..values.decimals import of_code
from ..values.literals import LONG, Sort
from .relation import TermValues

SortKey = NDArray[np.int64] | NDArray[np.float64]
_BLANK, _IRI, _NAN, _NUMBER, _STRING, _OTHER = 1, 2, 3, 4, 5, 6
_EXACT = 2.0**53
"""From here on float64 does not distinguish all integers and decimals."""


def sort_keys(column: ObjectColumn, terms: TermValues) -> list[SortKey]:
    """Return arrays of numbers that order the column's terms; the first one decides first.

    Equal numbers of two kinds are equal here, so that a second key can decide. Cost: numpy per row
    for numbers; Python per distinct other term.
    """
    rank = np.where(column.present, np.int64(_NUMBER), np.int64(0))
    if column.kind is not Kind.TERM:
        values = np.where(column.present, column.values, column.kind.dtype.type(0))
        if column.kind is Kind.BOOLEAN:
            return [np.where(column.present, np.int64(_OTHER), np.int64(0)), values.astype(int)]
        return [*_without_nan(rank, values)]
    sorts = terms.sorts(column.values)
    is_number = (sorts >= Sort.INTEGER) & (sorts <= Sort.DOUBLE) | np.isin(sorts, LONG)
    is_number &= column.present
    number = np.where(is_number, terms.approximate(column), 0.0)
    rank, number = _without_nan(rank, number)
    place = np.zeros(len(column), np.int64)
    long = is_number & np.isin(sorts, LONG)
    great = np.flatnonzero(is_number if long.any() else np.abs(number) >= _EXACT)
    if len(great):
        place[great] = _exact_places(column.values[great], terms)
    others = np.flatnonzero(column.present & ~is_number)
    if len(others):
        ids, inverse = np.unique(column.values[others], return_inverse=True)
        distinct = [terms.dictionary.term(int(id)) for id in ids]
        classes, ranks = _ranked(distinct)
        rank[others] = classes[inverse.reshape(-1)]
        place[others] = ranks[inverse.reshape(-1)]
    return [rank, number, place]


def _without_nan(rank: NDArray[np.int64], values: NDArray[Any]) -> tuple[Any, Any]:
    """Return the ranks and the numbers; NaN gets a rank of its own."""
    if values.dtype != np.float64 or not (nan := np.isnan(values)).any():
        return rank, values
    return np.where(nan, np.int64(_NAN), rank), np.where(nan, 0.0, values)


def _exact_places(ids: NDArray[np.int32], terms: TermValues) -> NDArray[np.int64]:
    """Rank numbers by their exact values. Other keys have separated NaN and infinities already."""
    distinct, inverse = np.unique(ids, return_inverse=True)
    literals = [terms.dictionary.term(id) for id in distinct.tolist()]
    values = [_exact_value(literal) for literal in literals]
    places = {value: place for place, value in enumerate(sorted(set(values)))}
    return np.array([places[value] for value in values], np.int64)[inverse.reshape(-1)]


def _exact_value(term: Term) -> Decimal:
    assert isinstance(term, Literal)
    if term.datatype.value in INTEGERS or term.datatype.value == XSD + "decimal":
        return Decimal(term.value)
    value = float(term.value)
    return of_code(value) if np.isfinite(value) else Decimal(0)


def _ranked(found: Sequence[Term]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the class of each term, and its place within that class."""
    classes = np.array([_class(term) for term in found], np.int64)
    ranks = np.zeros(len(found), np.int64)
    for kind in np.unique(classes).tolist():
        at = np.flatnonzero(classes == kind)
        members = [found[i] for i in at.tolist()]
        order = _others(members) if kind == _OTHER else sorted(members, key=_text)
        places = {term: place for place, term in enumerate(order)}
        ranks[at] = [places[term] for term in members]
    return classes, ranks


def _class(term: Term) -> int:
    if isinstance(term, BlankNode):
        return _BLANK
    if isinstance(term, NamedNode):
        return _IRI
    is_text = term.language is not None or term.datatype.value.endswith("#string")
    return _STRING if is_text else _OTHER


def _text(term: Term) -> tuple[str, str]:
    # Strings without a language first, unlike Oxigraph: SPARQL leaves it open.
    return term.value, (term.language or "") if isinstance(term, Literal) else ""


def _others(members: Sequence[Term]) -> list[Term]:
    """Sort dates, booleans, durations … as Oxigraph does. Its sort is stable, so sort equal ones by
    text first."""
    rows = " ".join(term_text(term) for term in sorted(members, key=str))
    found = Store().query(f"SELECT ?v WHERE {{ VALUES ?v {{ {rows} }} }} ORDER BY ?v")
    return [solution["v"] for solution in found]  # type: ignore[union-attr]
