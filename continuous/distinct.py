"""Distinct triples of one predicate: which come into the window, and which leave it.

The pairs (subject, object) are told apart as RDF terms: a number by its kind and value, whether a
column holds it as a number or as a term; anything else by its id.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..rdf.dictionary import TermTable
from ..rdf.timed import Kind, ObjectColumn
from ..streams.sample import Mask
from .columns import Pairs, Sort, TermValues, bits, decoded, make_number
from .seen import SeenPairs


class DistinctRows(TermTable):
    """The distinct pairs of the window: a `SeenPairs` for each kind of object.

    Law: `see` gives each pair when it comes into the window, `leave` when it has left. Cost and
    memory: see `SeenPairs`.
    """

    def __init__(self, terms: TermValues) -> None:
        self._terms = terms
        self._kinds: dict[Kind, SeenPairs] = {}
        self._spelled: dict[int, bool] = {}
        terms.dictionary.hold(self)
        terms.dictionary.follow(self)

    def held(self) -> Iterator[NDArray[Any]]:
        """See `dictionary.Holder`."""
        for kind, seen in self._kinds.items():
            subjects, keys = seen.pairs()
            yield subjects
            if kind is Kind.TERM:
                yield keys

    def forget(self, freed: NDArray[np.bool_]) -> None:
        """See `dictionary.TermTable`."""
        self._spelled = {id: plain for id, plain in self._spelled.items() if not freed[id]}

    def see(self, end: int, pairs: Pairs, skip: Mask | None = None) -> NDArray[np.int64]:
        """Rows of the pane that ends at ``end``, but those in ``skip``: those whose pair is new to
        the window."""
        fresh = []
        for kind, rows, keys in self._keys(pairs, skip):
            if kind not in self._kinds:
                self._kinds[kind] = SeenPairs()
            seen = self._kinds[kind]
            whole = isinstance(rows, slice)
            found = seen.see(end, (pairs[0].values[rows], keys), skip if whole else None)
            fresh.append(found if isinstance(rows, slice) else rows[found])
        if len(fresh) == 1:
            return fresh[0]
        return np.sort(np.concatenate([np.zeros(0, np.int64), *fresh]))

    def leave(self, until: int) -> Iterator[Pairs]:
        """The pairs that leave with the panes that end at or before ``until``."""
        for kind, seen in self._kinds.items():
            gone = seen.leave(until)
            if gone is not None:
                subjects, keys = gone
                yield ObjectColumn(Kind.TERM, subjects), decoded(kind, keys)

    def holds(self, pairs: Pairs) -> NDArray[np.bool_]:
        """Which of the pairs are in the window."""
        answer = np.zeros(len(pairs[0]), np.bool_)
        for kind, rows, keys in self._keys(pairs, None):
            if kind in self._kinds:
                answer[rows] = self._kinds[kind].holds((pairs[0].values[rows], keys))
        return answer

    def _keys(
        self, pairs: Pairs, skip: Mask | None
    ) -> Iterator[tuple[Kind, slice | NDArray[np.int64], NDArray[np.int64]]]:
        """The rows by kind of object, and the objects' bits. A slice is all rows, those in ``skip``
        too."""
        column = pairs[1]
        if column.kind is not Kind.TERM:
            yield column.kind, slice(None), _bits(column.values)
            return
        there = np.arange(len(column)) if skip is None else np.flatnonzero(~skip)
        sorts = self._terms.sorts(column.values[there]).astype(np.int64)
        for sort in np.unique(sorts).tolist():
            rows = there[sorts == sort]
            if Sort.INTEGER <= sort <= Sort.BOOLEAN:
                ids = column.values[rows]
                plain = np.array([self._plain(id, Kind(sort)) for id in ids.tolist()], np.bool_)
                yield Kind.TERM, rows[~plain], ids[~plain].astype(np.int64)
                typed = self._terms.typed(ObjectColumn(Kind.TERM, ids[plain]), Kind(sort))
                yield Kind(sort), rows[plain], _bits(typed.values)
            else:
                yield Kind.TERM, rows, column.values[rows].astype(np.int64)

    def _plain(self, id: int, kind: Kind) -> bool:
        """Whether the term is the one that its value spells: a decimal may be longer than that."""
        if kind is not Kind.DECIMAL:
            return True
        found = self._spelled.get(id)
        if found is None:
            column = ObjectColumn(Kind.TERM, np.array([id], np.int32))
            number = float(self._terms.typed(column, kind).values[0])
            found = self._terms.dictionary.term(id) == make_number(kind, number)
            self._spelled[id] = found
        return found


def _bits(values: NDArray[Any]) -> NDArray[np.int64]:
    """`bits`, and all NaNs the same: they are one literal."""
    # A NaN is the least of all, as numpy has it: to look for the least makes no array.
    if values.dtype == np.float64 and len(values) and np.isnan(values.min()):
        values = np.where(np.isnan(values), np.nan, values)
    return bits(values)
