"""The index of instances: those that agree on the joined terms are a group, sorted in itself
by the compared term that a condition searches for.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from ...rdf.timed import Kind, ObjectColumn
from ..algebra.template_parameters import Joint
from ..columns.relation import Relation, TermValues, as_terms, bits, decoded
from ..values.literals import LONG
from .instance_kernel import fired, least_of
from .instance_terms import Terms

Rows: TypeAlias = NDArray[np.int64]
EXACT = 2**53
"""Below, float64 tells integers apart."""


class InstanceIndex:
    """Rows ``start`` … ``stop`` of the columns of a table.

    Law: `find` gives each pair of a solution and a row that agree on the joined terms and fulfil
    the searched condition, once. Cost: a sort to make, then O(solutions + pairs) a call. Memory: 24
    bytes a row, 16 a group, 8 a term of the dictionary.
    """

    def __init__(
        self,
        joint: Joint,
        columns: Mapping[str, Terms],
        terms: TermValues,
        start: int,
        stop: int,
    ) -> None:
        self.joined = joint.joined
        self.stop = stop
        rows = np.arange(start, stop)
        self.search = joint.search
        self._keys = [_Key(columns[name], rows) for name in joint.joined]
        groups = np.zeros(len(rows), np.int64)
        count = min(1, len(rows))
        self._levels: list[Rows] = []
        """After each joined term the combinations that occur, numbered by their places: so that
        the next combination of two numbers stays small."""
        for key in self._keys:
            distinct, groups = np.unique(groups * key.count + key.codes, return_inverse=True)
            groups, count = groups.reshape(-1), len(distinct)
            self._levels.append(distinct)
        self.limits = np.zeros(len(rows), np.float64)
        self.is_exact = True
        """Whether float64 tells all limits apart from any number of a column."""
        if self.search is not None:
            limits = columns[self.search.limit]
            self.limits = _limits(limits, rows)
            at = rows[limits.tags[rows] == Kind.TERM]
            long = np.isin(terms.sorts(limits.bits[at].astype(np.int32)), LONG)
            integers = limits.bits[rows[limits.tags[rows] == Kind.INTEGER]]
            great = (integers >= EXACT) | (integers <= -EXACT)
            self.is_exact = not (long.any() or great.any())
            if not self.search.greater:
                self.limits = -self.limits
        by = np.lexsort((self.limits, groups))
        self.rows: Rows = rows[by]
        self.limits = self.limits[by]
        counts = np.bincount(groups, minlength=count)
        self.starts = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
        self._least = least_of(self.starts, self.limits)

    def find(self, relation: Relation, values: ObjectColumn | None) -> tuple[Rows, Rows]:
        """Rows of ``relation`` and of the table that belong together."""
        groups = self._groups(relation)
        if values is None or self.search is None:
            # Nothing to search for: all of a group.
            number, strict = np.zeros(relation.rows), False
            limits, least = np.zeros(len(self.limits)), np.zeros(len(self._least))
            least[0] = np.nan
        else:
            number, strict = values.values.astype(np.float64, copy=False), self.search.strict
            if not self.search.greater:
                number = -number
            limits, least = self.limits, self._least
            if values.null is not None:
                groups = np.where(values.null, -1, groups)
        at, places = fired(groups, number, self.starts, limits, least, strict)
        return at, self.rows[places]

    def _groups(self, relation: Relation) -> Rows:
        """The group of each row, -1 for none."""
        groups = np.full(relation.rows, 0 if len(self.rows) else -1)
        for i, name in enumerate(self.joined):
            key, distinct = self._keys[i], self._levels[i]
            codes = key.find(relation.column(name))
            if i == 0:
                # The codes of the first are the combinations.
                groups = codes
                continue
            wanted = groups * key.count + codes
            at = np.minimum(np.searchsorted(distinct, wanted), len(distinct) - 1)
            found = (groups >= 0) & (codes >= 0) & (distinct[at] == wanted)
            groups = np.where(found, at, -1)
        return groups


class _Key:
    """One joined term of some rows: its codes 0, 1, 2 …, and the code of a term in a column."""

    def __init__(self, terms: Terms, rows: Rows) -> None:
        self.terms = terms
        self.tags, self.bits = terms.tags[rows], terms.bits[rows]
        self.codes, self.count = self._coded()
        self._of_id: NDArray[np.int64] | None = None
        terms.dictionary.hold(self)

    def held_ids(self) -> Iterator[Rows]:
        """The terms that numbers have been given, to be found by id; the others are the table's."""
        if self._of_id is not None:
            yield np.flatnonzero(self._of_id >= 0)

    def _coded(self) -> tuple[Rows, int]:
        codes = np.zeros(len(self.tags), np.int64)
        self._first: list[tuple[int, Rows, int]] = []
        count = 0
        for tag in np.unique(self.tags).tolist():
            at = np.flatnonzero(self.tags == tag)
            distinct, inverse = np.unique(self.bits[at], return_inverse=True)
            codes[at] = count + inverse.reshape(-1)
            self._first.append((tag, distinct, count))
            count += len(distinct)
        return codes, count

    def find(self, column: ObjectColumn) -> Rows:
        """The code of each object, -1 for a term that no row has."""
        if column.kind is Kind.TERM:
            return self._by_id(column)
        found = np.full(len(column), -1)
        for tag, distinct, first in self._first:
            if tag == column.kind and len(column):
                wanted = bits(column.values)
                at = np.minimum(np.searchsorted(distinct, wanted), len(distinct) - 1)
                same = (distinct[at] == wanted) & column.present
                found[same] = first + at[same]
        return found

    def _by_id(self, column: ObjectColumn) -> Rows:
        dictionary = self.terms.dictionary
        if self._of_id is None:
            table = np.full(0, -1)
            for tag, distinct, first in self._first:
                # A column of mixed objects has its numbers as terms.
                ids = as_terms(decoded(Kind(tag), distinct), dictionary).values
                if len(ids) and ids.max() >= len(table):
                    table = np.concatenate([table, np.full(ids.max() + 1 - len(table), -1)])
                table[ids] = np.arange(first, first + len(ids))
            self._of_id = table
        # The last place is that of NO_TERM (-1) and of ids that are newer.
        padded = self._of_id
        if not len(padded) or len(padded) <= len(dictionary):
            padded = self._of_id = np.concatenate(
                [padded, np.full(2 * len(dictionary) + 1 - len(padded), -1)]
            )
        found: Rows = padded[column.values]
        return found if column.null is None else np.where(column.null, -1, found)


def _limits(column: Terms, rows: Rows) -> NDArray[np.float64]:
    """The numbers among the terms as floats; what is none, no value is greater or less than: NaN,
    which sorts behind all, on either side."""
    tags, values = column.tags[rows], column.bits[rows]
    limits = np.full(len(rows), np.nan)
    for kind in (Kind.INTEGER, Kind.DECIMAL, Kind.FLOAT, Kind.DOUBLE):
        at = tags == kind
        if at.any():
            limits[at] = decoded(kind, values[at]).values
    return limits
