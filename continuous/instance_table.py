"""The table of a template's instances: their terms in columns, and which of them a solution is for.

Instances that agree on the joined terms are a group; in a group they are sorted by the compared
term that a condition searches for. So a window costs O(solutions + what it gives), whatever the number
of instances.
"""

from __future__ import annotations

from array import array
from collections.abc import Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
from pyoxigraph import Literal, NamedNode

from ..rdf.dictionary import NO_TERM, Term, TermDictionary
from ..rdf.timed import DATATYPES, Kind, ObjectColumn, make_term, split_term
from .columns import Relation, TermValues, bits, canonical
from .instance_kernel import fired, least_of
from .parameters import Joint, Search
from .patterns import decoded

Rows: TypeAlias = NDArray[np.int64]

INSTANCE = "\0instance"
"""The column of a joined relation that says which row of the table a solution is for."""

RECENT = 1024
"""Instances are looked up in two indexes: recent ones become part of the main one when they are
this many and an eighth of it, so that adding one does not sort all."""
_EXACT = 2.0**53
_READ: Mapping[str, tuple[Kind, Any]] = {
    DATATYPES[Kind.DOUBLE].value: (Kind.DOUBLE, float),
    DATATYPES[Kind.INTEGER].value: (Kind.INTEGER, int),
}


class Terms:
    """A growing column of terms: a tag (`Kind`) and 64 bits each, as `TermValues.encoded` has them.

    Numbers never enter the dictionary: a million thresholds are 9 bytes each.
    """

    def __init__(self, dictionary: TermDictionary) -> None:
        self.dictionary = dictionary
        self.tags: NDArray[np.int8] = np.zeros(0, np.int8)
        self.bits: NDArray[np.int64] = np.zeros(0, np.int64)
        self._waiting: list[Term] = []

    def append(self, term: Term) -> None:
        self._waiting.append(term)

    def settle(self) -> None:
        """Encode what was appended. Cost: a microsecond a number or known IRI."""
        dictionary = self.dictionary
        pairs = [_split(term, dictionary) for term in self._waiting]
        self._waiting = []
        kinds, values = zip(*pairs, strict=True)
        if len(set(kinds)) == 1:
            tags = np.full(len(kinds), kinds[0], np.int8)
            new = bits(np.array(values, kinds[0].dtype))
        else:
            tags = np.array(kinds, np.int8)
            new = np.zeros(len(kinds), np.int64)
            for kind in set(kinds):
                at = np.flatnonzero(tags == kind)
                new[at] = bits(np.array([values[i] for i in at.tolist()], kind.dtype))
        self.tags = np.concatenate([self.tags, tags])
        self.bits = np.concatenate([self.bits, new])

    def keep(self, rows: Rows) -> None:
        self.tags, self.bits = self.tags[rows], self.bits[rows]

    def column(self, rows: Rows) -> ObjectColumn:
        """The terms of these rows."""
        tags, values = self.tags[rows], self.bits[rows]
        if not len(tags):
            return ObjectColumn(Kind.TERM, np.zeros(0, np.int32))
        if (tags == tags[0]).all():
            return decoded(Kind(int(tags[0])), values)
        ids = np.full(len(tags), NO_TERM, np.int32)
        for tag in np.unique(tags).tolist():
            at = np.flatnonzero(tags == tag)
            part = decoded(Kind(tag), values[at]).values
            if tag == Kind.TERM:
                ids[at] = part
                continue
            distinct, inverse = np.unique(values[at], return_inverse=True)
            numbers = decoded(Kind(tag), distinct).values
            made = self.dictionary.ids(make_term(Kind(tag), n, self.dictionary) for n in numbers)
            ids[at] = made[inverse.reshape(-1)]
        return ObjectColumn(Kind.TERM, ids)

    def term(self, row: int) -> Term:
        return self.column(np.array([row])).term_at(0, self.dictionary)


def _split(term: Term, dictionary: TermDictionary) -> tuple[Kind, Any]:
    """`split_term` of the canonical spelling; doubles and integers without spelling them first."""
    if isinstance(term, NamedNode):
        return Kind.TERM, dictionary.id(term)
    if isinstance(term, Literal):
        known, text = _READ.get(term.datatype.value), term.value
        if known is not None and text.isascii() and "_" not in text and text == text.strip():
            kind, read = known
            try:
                value = read(text)
            except ValueError:
                value = None
            if value is not None and (
                -(2**63) <= value < 2**63 if kind is Kind.INTEGER else abs(value) < np.inf
            ):
                return kind, value
    return split_term(canonical(term), dictionary)


class InstanceTable:
    """The instances of one cohort, a row each: number, joined and compared terms.

    Law: `join` gives each solution once for every live row that has its joined terms (and fulfils
    the searched condition). Memory: 9 bytes a row, 9 a term, and 16 for the index.
    """

    def __init__(self, joint: Joint, terms: TermValues) -> None:
        self.joint = joint
        self.terms = terms
        self.columns = {name: Terms(terms.dictionary) for name in (*joint.joined, *joint.compared)}
        self.live = 0
        self._numbers = array("q")
        self._settled: Rows = np.zeros(0, np.int64)
        self._alive: NDArray[np.bool_] = np.zeros(0, np.bool_)
        self._removed: set[int] = set()
        self._main: _Index | None = None
        self._recent: _Index | None = None

    def add(self, number: int, arguments: Mapping[str, Term]) -> None:
        """Add an instance, its number greater than all before. Cost: a list a term."""
        self._numbers.append(number)
        for name, column in self.columns.items():
            column.append(arguments[name])
        self.live += 1

    def remove(self, number: int) -> None:
        self._removed.add(number)
        self.live -= 1

    def members(self) -> tuple[Rows, NDArray[np.bool_]]:
        """The numbers of all rows, ascending, and which of them are alive. They never change: a
        change makes new ones. Cost: of what came and went since, and of the arrays if it did."""
        if self._numbers:
            self._settled = np.concatenate([self._settled, np.array(self._numbers, np.int64)])
            self._alive = np.concatenate([self._alive, np.ones(len(self._numbers), np.bool_)])
            self._numbers = array("q")
            for column in self.columns.values():
                column.settle()
        if self._removed:
            gone = np.fromiter(self._removed, np.int64)
            self._removed = set()
            self._alive = self._alive.copy()
            self._alive[np.searchsorted(self._settled, gone)] = False
            if 2 * self.live < len(self._settled):
                self._compact()
        return self._settled, self._alive

    def _compact(self) -> None:
        kept = np.flatnonzero(self._alive)
        self._settled, self._alive = self._settled[kept], self._alive[kept]
        for column in self.columns.values():
            column.keep(kept)
        self._main = self._recent = None

    def join(self, relation: Relation) -> tuple[Relation, bool]:
        """The solutions with the rows they are for (`INSTANCE`) and the compared terms of these;
        and whether the searched condition was decided. Call `members` first."""
        search = self.joint.search
        values = None if search is None else self._searched(search, relation)
        decided = values is not None
        parts = [index.find(relation, values) for index in self._indexes()]
        at, rows = parts[0]
        if len(parts) > 1:
            at, rows = (np.concatenate(side) for side in zip(*parts, strict=True))
        if self.live < len(self._settled):
            alive = self._alive[rows]
            at, rows = at[alive], rows[alive]
        columns = {name: column.take(at) for name, column in relation.columns.items()}
        for name in self.joint.compared:
            if name in self.joint.asked or not decided:
                columns[name] = self.columns[name].column(rows)
        columns[INSTANCE] = ObjectColumn(Kind.INTEGER, rows)
        # Within an instance the joined terms are the same, so the rest of a key is one.
        key = None
        if relation.key is not None:
            key = relation.key - frozenset(self.joint.joined) | {INSTANCE}
        return Relation(columns, len(at), key), decided

    def _searched(self, search: Search, relation: Relation) -> ObjectColumn | None:
        """The column to search with, if floats say its order against the limits exactly."""
        column = relation.column(search.value)
        if not column.kind.is_number:
            return None
        if column.kind is Kind.INTEGER and len(column):
            greatest = max(abs(int(column.values.max())), abs(int(column.values.min())))
            if greatest >= _EXACT:
                return None
        return column

    def _indexes(self) -> Sequence[_Index]:
        count = len(self._settled)
        main = self._main
        if main is None or count - main.stop > max(RECENT, main.stop // 8):
            self._main = main = _Index(self, 0, count)
            self._recent = None
        if count == main.stop:
            return (main,)
        if self._recent is None or self._recent.stop < count:
            self._recent = _Index(self, main.stop, count)
        return (main, self._recent)


class _Index:
    """Rows ``start`` … ``stop`` of a table by group, in a group by the searched term."""

    def __init__(self, table: InstanceTable, start: int, stop: int) -> None:
        self.table = table
        self.stop = stop
        rows = np.arange(start, stop)
        joint = table.joint
        self.search = joint.search
        self._keys = [_Key(table.columns[name], rows) for name in joint.joined]
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
        if self.search is not None:
            self.limits = _limits(table.columns[self.search.limit], rows)
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
        for i, name in enumerate(self.table.joint.joined):
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
                if tag == Kind.TERM:
                    ids = distinct
                else:
                    # A column of mixed objects has its numbers as terms.
                    values = decoded(Kind(tag), distinct).values
                    made = (make_term(Kind(tag), v, dictionary) for v in values)
                    ids = dictionary.ids(made).astype(np.int64)
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
