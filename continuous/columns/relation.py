"""Relations in columns, the values of their terms, and keys to join and group by."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
from pyoxigraph import Literal

from ...rdf.dictionary import NO_TERM, Term, TermDictionary, TermTable
from ...rdf.timed import (
    Intern,
    Kind,
    ObjectColumn,
    TripleRows,
    make_literal,
    split_term,
)
from ...streams.sample import Mask
from ..values import decimals
from ..values.literals import Sort, canonical, exact_literal, value_of
from .budget import UNLIMITED, Budget


class NeedsOxigraph(Exception):
    """Columns cannot compute this exactly for these values: Oxigraph evaluates the window."""


@dataclass(frozen=True, slots=True, eq=False)
class Relation:
    """Solutions in columns by variable name, all of length ``rows``; null = unbound.

    ``key``: variables that no two rows agree on, if any are known.
    """

    columns: Mapping[str, ObjectColumn]
    rows: int
    key: frozenset[str] | None = None

    def column(self, name: str) -> ObjectColumn:
        """Return the column of a variable; nulls if it is never bound."""
        found = self.columns.get(name)
        if found is not None:
            return found
        return unbound(self.rows)

    def take(self, rows: NDArray[Any]) -> Relation:
        """Return the rows at ``rows`` (a mask, or indices without repetition)."""
        count = int(np.count_nonzero(rows)) if rows.dtype == np.bool_ else len(rows)
        columns = {name: column.take(rows) for name, column in self.columns.items()}
        return Relation(columns, count, self.key)


Pairs: TypeAlias = tuple[ObjectColumn, ObjectColumn]
"""Subjects and objects of one predicate's triples: two columns of equal length, without nulls."""


class TermValues(TermTable):
    """The values of a dictionary's terms, in arrays by id that grow with the dictionary.

    For each term: its `Sort`, its float64 and int64 value, its effective boolean value, and the id
    of its `canonical` term, which stays in the dictionary as long as the term. Cost: Python once
    per distinct term, and again for a term that returns after a sweep.
    """

    def __init__(self, dictionary: TermDictionary, budget: Budget = UNLIMITED) -> None:
        self.dictionary = dictionary
        self.budget = budget
        """The budget of operators on these terms."""
        self._sort: NDArray[np.int8] = np.zeros(0, np.int8)
        self._number: NDArray[np.float64] = np.zeros(0, np.float64)
        self._integer: NDArray[np.int64] = np.zeros(0, np.int64)
        self._true: NDArray[np.bool_] = np.zeros(0, np.bool_)
        self._long: dict[int, Decimal] = {}
        self._canonical: NDArray[np.int32] = np.zeros(0, np.int32)
        self._tag: NDArray[np.int8] = np.zeros(0, np.int8)
        self._bits: NDArray[np.int64] = np.zeros(0, np.int64)
        self._size = 0
        self._place = 0
        """The number of reused ids in ``dictionary.reused`` that have been read."""
        self._waiting: list[int] = []
        """The reused ids that had not been read at the last sweep."""
        dictionary.follow(self)

    def sorts(self, ids: NDArray[np.int32]) -> NDArray[np.int8]:
        """Return the `Sort` of each id; an absent term (`NO_TERM`) is OTHER."""
        self._follow()
        # The last entry is that of `NO_TERM`, -1: `_follow` leaves at least one without a term.
        found: NDArray[np.int8] = self._sort.take(ids)
        return found

    def canonical(self, column: ObjectColumn) -> ObjectColumn:
        """Replace every TERM by its canonical spelling, so that equal values have equal ids."""
        if column.kind is not Kind.TERM:
            return column
        self._follow()
        ids = column.values
        same = np.where(ids < 0, ids, self._canonical[ids])
        return column if np.array_equal(same, ids) else ObjectColumn(Kind.TERM, same, column.null)

    def typed(self, column: ObjectColumn, kind: Kind) -> ObjectColumn:
        """Convert a TERM column whose terms are all of ``kind`` to that kind."""
        values: NDArray[Any]
        if kind is Kind.INTEGER:
            values = self._integer[column.values]
        elif kind is Kind.BOOLEAN:
            values = self._integer[column.values] != 0
        else:
            values = self._number[column.values]
        return ObjectColumn(kind, values, column.null)

    def encode(self, column: ObjectColumn) -> tuple[NDArray[np.int8], NDArray[np.int64]]:
        """Return each object as a tag (its `Kind`) and 64 bits. They are equal exactly if the terms
        are, in any kind of column and any spelling. No object may be null."""
        if column.kind is not Kind.TERM:
            return np.full(len(column), column.kind, np.int8), bits(column.values)
        self._follow()
        return self._tag[column.values], self._bits[column.values]

    @property
    def encodings(self) -> tuple[NDArray[np.int8], NDArray[np.int64]]:
        """The results of `encode` for terms, by id."""
        self._follow()
        return self._tag, self._bits

    @property
    def sorts_by_id(self) -> NDArray[np.int8]:
        """The `Sort` of every id of the dictionary."""
        self._follow()
        return self._sort

    def true(self, ids: NDArray[np.int32]) -> NDArray[np.bool_]:
        """Return the effective boolean value of terms that have one (SPARQL 1.1 §17.2.2)."""
        self._follow()
        answer: NDArray[np.bool_] = self._true[ids]
        return answer

    def approximate(self, column: ObjectColumn) -> NDArray[np.float64]:
        """Return the nearest float64 of each number, in a column of numbers or of `LONG` ones."""
        if column.kind is not Kind.TERM:
            return column.values.astype(np.float64, copy=False)
        self._follow()
        nearest: NDArray[np.float64] = self._number[column.values]
        return nearest

    def exact(self, column: ObjectColumn, rows: Iterable[int]) -> list[Decimal]:
        """Return the integers or decimals at ``rows``, in a column of them or of `LONG` ones."""
        self._follow()
        values = [column.values[row].item() for row in rows]
        match column.kind:
            case Kind.INTEGER:
                return [Decimal(value) for value in values]
            case Kind.DECIMAL:
                return [decimals.of_code(value) for value in values]
        return [self._long[id] for id in values]

    def implied(self, marked: NDArray[np.bool_]) -> NDArray[np.int32]:
        """See `dictionary.TermTable`."""
        return self._canonical[np.flatnonzero(marked[: self._size])]

    def forget(self, freed: NDArray[np.bool_]) -> None:
        """See `dictionary.TermTable`."""
        self._long = {id: value for id, value in self._long.items() if not freed[id]}
        waiting = [*self._waiting, *self.dictionary.reused[self._place :]]
        self._waiting = [id for id in waiting if not freed[id]]
        self._place = 0

    def _follow(self) -> None:
        dictionary = self.dictionary
        # A canonical term may itself be new to the dictionary: so repeat until there are none.
        while (
            self._size < len(dictionary)
            or self._place < len(dictionary.reused)
            or self._waiting
            or not len(self._sort)
        ):
            size = len(dictionary)
            if len(self._sort) <= size:
                capacity = max(2 * size, 64)
                self._sort = _enlarged(self._sort, capacity)
                self._number = _enlarged(self._number, capacity)
                self._integer = _enlarged(self._integer, capacity)
                self._true = _enlarged(self._true, capacity)
                self._canonical = _enlarged(self._canonical, capacity)
                self._tag = _enlarged(self._tag, capacity)
                self._bits = _enlarged(self._bits, capacity)
            # IRIs and blank nodes are canonical; only literals need a closer look.
            new = slice(self._size, size)
            self._sort[new] = Sort.NODE
            self._canonical[new] = self._bits[new] = np.arange(self._size, size)
            terms: list[tuple[int, Term | None]] = list(
                enumerate(dictionary.terms(self._size), self._size)
            )
            if self._waiting or self._place < len(dictionary.reused):
                terms += self._reset_reused()
            self._size = size
            for id, term in terms:
                if isinstance(term, Literal):
                    self._note(id, term)

    def _reset_reused(self) -> list[tuple[int, Term | None]]:
        """Clear the entries of ids that have new terms now; return these."""
        ids = [*self._waiting, *self.dictionary.reused[self._place :]]
        self._waiting, self._place = [], len(self.dictionary.reused)
        at = np.array(ids, np.int64)
        self._sort[at], self._number[at], self._integer[at] = Sort.NODE, 0.0, 0
        self._true[at] = False
        self._canonical[at] = self._bits[at] = at
        self._tag[at] = Kind.TERM
        return [(id, self.dictionary.term(id)) for id in ids]

    def _note(self, id: int, literal: Literal) -> None:
        value = value_of(literal)
        self._sort[id], self._number[id], self._integer[id] = (
            value.sort,
            value.number,
            value.integer,
        )
        self._true[id] = value.true
        if value.long is not None:
            self._long[id] = value.long
        spelled = canonical(literal)
        intern = self.dictionary.transient_id
        self._canonical[id] = id if spelled == literal else intern(spelled)
        # A number that fits no column (a long decimal) is encoded as a term.
        kind, number = split_term(spelled, intern)
        self._tag[id] = kind
        self._bits[id] = bits(np.array([number], kind.dtype))[0]


def _enlarged(array: NDArray[Any], capacity: int) -> NDArray[Any]:
    larger = np.zeros(capacity, array.dtype)
    larger[: len(array)] = array
    return larger


def either(left: Mask | None, right: Mask | None) -> Mask | None:
    """Combine null masks by or."""
    if left is None:
        return right
    return left if right is None else left | right


def term_column(terms: Sequence[Term | None], intern: Intern) -> ObjectColumn:
    """Return a column of ``terms`` (None = null), canonical; as numbers if all have one kind."""
    terms = [None if term is None else canonical(term) for term in terms]
    pairs = [(Kind.TERM, NO_TERM) if t is None else split_term(t, intern) for t in terms]
    null = np.array([t is None for t in terms], np.bool_)
    kinds = {kind for (kind, _), term in zip(pairs, terms, strict=True) if term is not None}
    mask = null if null.any() else None
    if len(kinds) == 1 and (kind := next(iter(kinds))) is not Kind.TERM:
        values = [
            0 if term is None else value for (_, value), term in zip(pairs, terms, strict=True)
        ]
        return ObjectColumn(kind, np.array(values, kind.dtype), mask)
    ids = [NO_TERM if term is None else intern(term) for term in terms]
    return ObjectColumn(Kind.TERM, np.array(ids, np.int32), mask)


def exact_column(kind: Kind, values: Sequence[Decimal | None], intern: Intern) -> ObjectColumn:
    """Return INTEGERs or DECIMALs of any size as a column (None = null). It has terms if one does
    not fit a column of numbers."""
    literals = [None if value is None else exact_literal(kind, value) for value in values]
    return term_column(literals, intern)


def as_terms(column: ObjectColumn, dictionary: TermDictionary) -> ObjectColumn:
    """Return the column with every object as an id. Cost: Python per distinct value."""
    if column.kind is Kind.TERM:
        return column
    distinct, inverse = np.unique(bits(column.values), return_inverse=True)
    values = decode(column.kind, distinct).values.tolist()
    ids = dictionary.transient_ids(make_literal(column.kind, value) for value in values)
    return ObjectColumn(Kind.TERM, ids[inverse.reshape(-1)], column.null)


def bits(values: NDArray[Any]) -> NDArray[np.int64]:
    """Return an int64 per value, equal only for equal terms: float64 by its bits."""
    if values.dtype == np.float64:
        return np.ascontiguousarray(values).view(np.int64)
    return values.astype(np.int64)


def decode(kind: Kind, bits: NDArray[np.int64]) -> ObjectColumn:
    """Return a column of this kind from its `bits`."""
    if kind.dtype == np.float64:
        return ObjectColumn(kind, bits.view(np.float64))
    return ObjectColumn(kind, bits.astype(kind.dtype, copy=False))


def decode_terms(
    tags: NDArray[np.int8], bits: NDArray[np.int64], dictionary: TermDictionary
) -> ObjectColumn:
    """Return objects of several kinds (`TermValues.encode`) as terms. Cost: Python per distinct
    number."""
    ids = np.full(len(tags), NO_TERM, np.int32)
    for tag in np.unique(tags).tolist():
        at = np.flatnonzero(tags == tag)
        ids[at] = as_terms(decode(Kind(tag), bits[at]), dictionary).values
    return ObjectColumn(Kind.TERM, ids)


def unbound(rows: int, kind: Kind = Kind.TERM) -> ObjectColumn:
    """Return a column of nulls."""
    values = np.full(rows, NO_TERM if kind is Kind.TERM else 0, kind.dtype)
    return ObjectColumn(kind, values, np.ones(rows, np.bool_))


def take_or_null(column: ObjectColumn, rows: NDArray[np.int64]) -> ObjectColumn:
    """Return the column at ``rows``, null where that is -1."""
    absent = rows < 0
    if not absent.any():
        return column.take(rows)
    if not len(column):
        return unbound(len(rows), column.kind)
    taken = column.take(np.where(absent, 0, rows))
    return ObjectColumn(taken.kind, taken.values, absent | ~taken.present)


def scatter(
    places: Sequence[NDArray[np.int64]], parts: Sequence[ObjectColumn], dictionary: TermDictionary
) -> ObjectColumn:
    """Return one column of the parts, each at its places; together these are all rows."""
    at = np.concatenate(places)
    back = np.empty(len(at), np.int64)
    back[at] = np.arange(len(at))
    return concatenate(parts, dictionary).take(back)


def coalesce(first: ObjectColumn, second: ObjectColumn, dictionary: TermDictionary) -> ObjectColumn:
    """Return the first column where it is bound, else the second."""
    if first.null is None:
        return first
    if first.kind is not second.kind:
        first, second = (as_terms(column, dictionary) for column in (first, second))
    assert first.null is not None
    null = first.null & ~second.present
    values = np.where(first.null, second.values, first.values).astype(first.kind.dtype)
    return ObjectColumn(first.kind, values, null if null.any() else None)


def concatenate(columns: Sequence[ObjectColumn], dictionary: TermDictionary) -> ObjectColumn:
    """Concatenate the columns; as terms if their kinds differ."""
    if len(columns) == 1:
        return columns[0]
    if len({column.kind for column in columns}) > 1:
        columns = [as_terms(column, dictionary) for column in columns]
    null = None
    if any(column.null is not None for column in columns):
        null = np.concatenate([~column.present for column in columns])
    return ObjectColumn(columns[0].kind, np.concatenate([c.values for c in columns]), null)


def concatenate_rows(parts: Sequence[TripleRows]) -> TripleRows:
    """Concatenate tables of one shape (same predicates, kinds and sort)."""
    first = parts[0]
    if len(parts) == 1:
        return first
    objects = {}
    for predicate, column in first.objects.items():
        columns = [part.objects[predicate] for part in parts]
        null = None
        if any(part.null is not None for part in columns):
            null = np.concatenate([~part.present for part in columns])
        values = np.concatenate([part.values for part in columns])
        objects[predicate] = ObjectColumn(column.kind, values, null)
    return TripleRows(
        np.concatenate([part.time for part in parts]),
        np.concatenate([part.valid for part in parts]),
        np.concatenate([part.subject for part in parts]),
        objects,
        first.sort,
    )


def key_codes(
    columns: Iterable[Sequence[ObjectColumn]], dictionary: TermDictionary
) -> list[NDArray[np.int64]]:
    """Return codes for the rows of several tables, equal if all their key columns agree.

    ``columns`` has for each key column its parts, one per table; the result has one array per
    table. A null agrees with a null only.
    """
    lengths: list[int] = []
    combined: NDArray[np.int64] | None = None
    for parts in columns:
        lengths = [len(part) for part in parts]
        if len({part.kind for part in parts}) > 1:
            parts = [as_terms(part, dictionary) for part in parts]
        code = np.concatenate([bits(part.values) for part in parts])
        if any(part.null is not None for part in parts):
            null = np.concatenate([~part.present for part in parts])
            code = np.unique(np.where(null, 0, code), return_inverse=True)[1].reshape(-1) + 1
            code = np.where(null, 0, code)
        if combined is None:
            combined = code
        else:
            left = np.unique(combined, return_inverse=True)[1].reshape(-1)
            right = np.unique(code, return_inverse=True)[1].reshape(-1)
            combined = left * (int(right.max(initial=0)) + 1) + right
    assert combined is not None
    return np.split(combined, np.cumsum(lengths)[:-1])


def first_rows(codes: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the first row of each distinct code, in order of appearance."""
    return np.sort(np.unique(codes, return_index=True)[1]).astype(np.int64)
