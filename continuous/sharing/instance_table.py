"""The table of a template's instances: their terms in columns, and a join with solutions. A window
costs O(solutions + matches), however many instances exist.
"""

from __future__ import annotations

from array import array
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from ...rdf.dictionary import Term
from ...rdf.timed import Kind, ObjectColumn
from ..algebra.template_parameters import Joint, Search
from ..columns.relation import Relation, TermValues
from .instance_index import EXACT, InstanceIndex, Rows
from .instance_terms import GrowingArray, InstanceTerms

INSTANCE = "\0instance"
"""The column of a joined relation with the row of the table that a solution belongs to."""

RECENT = 1024
"""Recent instances have an index of their own, so that adding one does not sort all. They join the
main index when they are more than this and more than an eighth of it."""


class InstanceTable:
    """The instances of one cohort, one row each: number, joined and compared terms.

    Law: `join` returns each solution once for every live row that has its joined terms (and
    satisfies the searched condition). Memory: 9 bytes per row, 9 per term, and 16 for the index.
    """

    def __init__(self, joint: Joint, terms: TermValues) -> None:
        self.joint = joint
        self.terms = terms
        self.columns = {
            name: InstanceTerms(terms.dictionary) for name in (*joint.joined, *joint.compared)
        }
        self.live = 0
        self._numbers = array("q")
        self._settled, self._alive = GrowingArray(np.int64), GrowingArray(np.bool_)
        self._removed: set[int] = set()
        self._main: InstanceIndex | None = None
        self._recent: InstanceIndex | None = None

    def add(self, number: int, arguments: Mapping[str, Term]) -> None:
        """Add an instance; its number must be the greatest so far. Cost: an append per term."""
        self._numbers.append(number)
        for name, column in self.columns.items():
            column.append(arguments[name])
        self.live += 1

    def remove(self, number: int) -> None:
        self._removed.add(number)
        self.live -= 1

    def members(self) -> tuple[Rows, NDArray[np.bool_]]:
        """Return the numbers of all rows, ascending, and which rows are alive. Callers may keep the
        arrays: a change makes new ones. Cost: that of the new rows; of all rows after a removal."""
        if self._numbers:
            self._settled.extend(np.array(self._numbers, np.int64))
            self._alive.extend(np.ones(len(self._numbers), np.bool_))
            self._numbers = array("q")
        for column in self.columns.values():
            column.settle()
        if self._removed:
            removed = np.fromiter(self._removed, np.int64)
            self._removed = set()
            # Results of earlier windows keep the old array.
            alive = self._alive.view.copy()
            alive[np.searchsorted(self._settled.view, removed)] = False
            self._alive.replace(alive)
            if 2 * self.live < len(alive):
                self._compact()
        return self._settled.view, self._alive.view

    def _compact(self) -> None:
        """Drop the removed rows, which are more than half of all."""
        kept = np.flatnonzero(self._alive.view)
        self._settled.replace(self._settled.view[kept])
        self._alive.replace(self._alive.view[kept])
        for column in self.columns.values():
            column.keep(kept)
        self._main = self._recent = None

    def join(self, relation: Relation) -> tuple[Relation, bool]:
        """Return the solutions with their rows of the table (`INSTANCE`) and these rows' compared
        terms, and whether the searched condition is decided. Call `members` first."""
        search = self.joint.search
        values = None if search is None else self._searched(search, relation)
        decided = values is not None
        parts = [index.find(relation, values) for index in self._indexes()]
        at, rows = parts[0]
        if len(parts) > 1:
            at, rows = (np.concatenate(side) for side in zip(*parts, strict=True))
        # Removed instances stay in the index until it is built anew.
        if self.live < len(self._settled.view):
            alive = self._alive.view[rows]
            at, rows = at[alive], rows[alive]
        columns = {name: column.take(at) for name, column in relation.columns.items()}
        for name in self.joint.compared:
            # Terms that no later step reads are not copied for each solution.
            if name in self.joint.used_variables or not decided:
                columns[name] = self.columns[name].column(rows)
        columns[INSTANCE] = ObjectColumn(Kind.INTEGER, rows)
        # Joined terms are constant within an instance, so the other variables of a key suffice.
        key = None
        if relation.key is not None:
            key = relation.key - frozenset(self.joint.joined) | {INSTANCE}
        return Relation(columns, len(at), key), decided

    def _searched(self, search: Search, relation: Relation) -> ObjectColumn | None:
        """Return the column to search with, or None if floats could misorder it and the limits."""
        column = relation.column(search.value)
        if not column.kind.is_number or not all(index.is_exact for index in self._indexes()):
            return None
        if column.kind is Kind.INTEGER and len(column):
            greatest = max(abs(int(column.values.max())), abs(int(column.values.min())))
            if greatest >= EXACT:
                return None
        return column

    def _indexes(self) -> Sequence[InstanceIndex]:
        count = len(self._settled.view)
        main = self._main
        if main is None or count - main.stop > max(RECENT, main.stop // 8):
            self._main = main = InstanceIndex(self.joint, self.columns, self.terms, 0, count)
            self._recent = None
        if count == main.stop:
            return (main,)
        if self._recent is None or self._recent.stop < count:
            self._recent = InstanceIndex(self.joint, self.columns, self.terms, main.stop, count)
        return (main, self._recent)
