"""Distinct triples of one predicate: which come into the window, and which leave it.

The pairs (subject, object) are told apart as RDF terms: a number by its kind and value, whether a
column holds it as a number or as a term; anything else by its id.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...rdf.timed import Kind, ObjectColumn
from ...streams.sample import Mask
from ..columns.relation import Pairs, TermValues, bits, decoded
from ..values.literals import Sort
from .pair_index import SeenPairs


class DistinctRows:
    """The distinct pairs of the window: a `SeenPairs` for each kind of object.

    Law: `see` gives each pair when it comes into the window, `leave` when it has left. Cost and
    memory: see `SeenPairs`.
    """

    def __init__(self, terms: TermValues) -> None:
        self._terms = terms
        self._kinds: dict[Kind, SeenPairs] = {}
        terms.dictionary.hold(self)

    def held_ids(self) -> Iterator[NDArray[Any]]:
        """See `dictionary.Holder`."""
        for kind, seen in self._kinds.items():
            subjects, keys = seen.pairs()
            yield subjects
            if kind is Kind.TERM:
                yield keys

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
                ids = ObjectColumn(Kind.TERM, column.values[rows])
                yield Kind(sort), rows, _bits(self._terms.typed(ids, Kind(sort)).values)
            else:
                yield Kind.TERM, rows, column.values[rows].astype(np.int64)


def _bits(values: NDArray[Any]) -> NDArray[np.int64]:
    """`bits`, and all NaNs the same: they are one literal."""
    # A NaN is the least of all, as numpy has it: to look for the least makes no array.
    if values.dtype == np.float64 and len(values) and np.isnan(values.min()):
        values = np.where(np.isnan(values), np.nan, values)
    return bits(values)
