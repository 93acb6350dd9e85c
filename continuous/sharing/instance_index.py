"""The index of instances. Instances that agree on the joined terms form a group, sorted by the
compared term that a condition searches for.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from ...rdf.timed import Kind, ObjectColumn
from ..algebra.template_parameters import Joint
from ..columns.relation import Relation, TermValues, as_terms, bits, decode
from ..values.literals import LONG
from .instance_kernel import find_pairs, least_of
from .instance_terms import InstanceTerms

Rows: TypeAlias = NDArray[np.int64]
EXACT = 2**53
"""Below this, distinct integers have distinct float64s."""


class InstanceIndex:
    """Rows ``start`` … ``stop`` of the columns of a table.

    Law: `find` returns each pair of a solution and a row that agree on the joined terms and satisfy
    the searched condition, once. Cost: a sort to build, then O(solutions + pairs) per call. Memory:
    24 bytes per row, 16 per group, 8 per term of the dictionary.
    """

    def __init__(
        self,
        joint: Joint,
        columns: Mapping[str, InstanceTerms],
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
        """After each joined term, the combinations that occur. Their positions number them, so
        that the product with the next term's codes stays small."""
        for key in self._keys:
            distinct, groups = np.unique(groups * key.count + key.codes, return_inverse=True)
            groups, count = groups.reshape(-1), len(distinct)
            self._levels.append(distinct)
        self.limits = np.zeros(len(rows), np.float64)
        self.is_exact = True
        """Whether float64 distinguishes all limits from any number of a column."""
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
        """Return the pairs of a row of ``relation`` and a row of the table."""
        groups = self._groups(relation)
        if values is None or self.search is None:
            # Without a condition every row of a group matches.
            number, strict = np.zeros(relation.rows), False
            limits, least = np.zeros(len(self.limits)), np.zeros(len(self._least))
            # The first entry answers for group -1, and NaN matches nothing.
            least[0] = np.nan
        else:
            number, strict = values.values.astype(np.float64, copy=False), self.search.strict
            # The limits have the opposite sign, too, so one loop serves both directions.
            if not self.search.greater:
                number = -number
            limits, least = self.limits, self._least
            # An unbound value satisfies no condition.
            if values.null is not None:
                groups = np.where(values.null, -1, groups)
        at, places = find_pairs(groups, number, self.starts, limits, least, strict)
        return at, self.rows[places]

    def _groups(self, relation: Relation) -> Rows:
        """Return the group of each row, or -1."""
        groups = np.full(relation.rows, 0 if len(self.rows) else -1)
        for i, name in enumerate(self.joined):
            key, distinct = self._keys[i], self._levels[i]
            codes = key.find(relation.column(name))
            if i == 0:
                # The codes of the first term number the combinations.
                groups = codes
                continue
            wanted = groups * key.count + codes
            at = np.minimum(np.searchsorted(distinct, wanted), len(distinct) - 1)
            found = (groups >= 0) & (codes >= 0) & (distinct[at] == wanted)
            groups = np.where(found, at, -1)
        return groups


class _Key:
    """One joined term of some rows: codes 0, 1, 2 …, and the code of each term in a column."""

    def __init__(self, terms: InstanceTerms, rows: Rows) -> None:
        self.terms = terms
        self.tags, self.bits = terms.tags[rows], terms.bits[rows]
        self.codes, self.count = self._encode()
        self._of_id: NDArray[np.int64] | None = None
        terms.dictionary.hold(self)

    def held_ids(self) -> Iterator[Rows]:
        """The ids that numbers got for the look-up by id; the table holds the other terms."""
        if self._of_id is not None:
            yield np.flatnonzero(self._of_id >= 0)

    def _encode(self) -> tuple[Rows, int]:
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
        """Return the code of each object, -1 for a term that no row has."""
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
                # A column of mixed kinds has numbers as terms, so they need ids, too.
                ids = as_terms(decode(Kind(tag), distinct), dictionary).values
                if len(ids) and ids.max() >= len(table):
                    table = np.concatenate([table, np.full(ids.max() + 1 - len(table), -1)])
                table[ids] = np.arange(first, first + len(ids))
            self._of_id = table
        # The last place is for NO_TERM (index -1); the padding is for ids that are newer.
        padded = self._of_id
        if not len(padded) or len(padded) <= len(dictionary):
            padded = self._of_id = np.concatenate(
                [padded, np.full(2 * len(dictionary) + 1 - len(padded), -1)]
            )
        found: Rows = padded[column.values]
        return found if column.null is None else np.where(column.null, -1, found)


def _limits(column: InstanceTerms, rows: Rows) -> NDArray[np.float64]:
    """Return the numbers among the terms as floats. Other terms become NaN: no value is greater or
    less, and NaN sorts last in both directions."""
    tags, values = column.tags[rows], column.bits[rows]
    limits = np.full(len(rows), np.nan)
    for kind in (Kind.INTEGER, Kind.DECIMAL, Kind.FLOAT, Kind.DOUBLE):
        at = tags == kind
        if at.any():
            limits[at] = decode(kind, values[at]).values
    return limits
