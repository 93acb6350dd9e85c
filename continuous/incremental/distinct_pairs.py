"""Distinct triples of one predicate: which pairs enter the window, and which leave it.

Pairs (subject, object) are compared as RDF terms. A number has its kind and value as key, whether a
column has it as a number or as a term; any other term has its id.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...rdf.timed import Kind, ObjectColumn
from ...streams.sample import Mask, Times
from ..columns.relation import Pairs, TermValues, bits, decode
from ..values.literals import Sort
from .pair_index import PairIndex


class DistinctPairs:
    """The distinct pairs of the window: a `PairIndex` per kind of object.

    Law: `enter` returns each pair when it enters the window, `leave` when it has left. Cost and
    memory: see `PairIndex`.
    """

    def __init__(self, terms: TermValues) -> None:
        self._terms = terms
        self._kinds: dict[Kind, PairIndex] = {}
        terms.dictionary.hold(self)

    def held_ids(self) -> Iterator[NDArray[Any]]:
        """See `dictionary.Holder`."""
        for kind, index in self._kinds.items():
            subjects, keys = index.pairs()
            yield subjects
            if kind is Kind.TERM:
                yield keys

    def last_panes(self, kind: Kind) -> tuple[Pairs, Times] | None:
        """Return the pairs of the window and the end of the last pane of each; None if some object
        is not of ``kind``."""
        others = (index for each, index in self._kinds.items() if each is not kind)
        if any(len(index.pairs()[0]) for index in others):
            return None
        index = self._kinds[kind] if kind in self._kinds else PairIndex()
        subjects, keys, ends = index.last_panes()
        return (ObjectColumn(Kind.TERM, subjects), decode(kind, keys)), ends

    def enter(self, end: int, pairs: Pairs, skip: Mask | None = None) -> NDArray[np.int64]:
        """Add the rows of the pane that ends at ``end``, except those in ``skip``; return the rows
        whose pair is new to the window."""
        fresh = []
        for kind, rows, keys in self._keys(pairs, skip):
            if kind not in self._kinds:
                self._kinds[kind] = PairIndex()
            index = self._kinds[kind]
            all_rows = isinstance(rows, slice)
            new = index.enter(end, (pairs[0].values[rows], keys), skip if all_rows else None)
            fresh.append(new if isinstance(rows, slice) else rows[new])
        if len(fresh) == 1:
            return fresh[0]
        # New subjects get their groups in the order of rows, not of kinds.
        return np.sort(np.concatenate([np.zeros(0, np.int64), *fresh]))

    def leave(self, until: int) -> Iterator[Pairs]:
        """Yield the pairs that leave with the panes that end at or before ``until``."""
        for kind, index in self._kinds.items():
            left = index.leave(until)
            if left is not None:
                subjects, keys = left
                yield ObjectColumn(Kind.TERM, subjects), decode(kind, keys)

    def holds(self, pairs: Pairs) -> NDArray[np.bool_]:
        """Return which of the pairs are in the window."""
        answer = np.zeros(len(pairs[0]), np.bool_)
        for kind, rows, keys in self._keys(pairs, None):
            if kind in self._kinds:
                answer[rows] = self._kinds[kind].holds((pairs[0].values[rows], keys))
        return answer

    def _keys(
        self, pairs: Pairs, skip: Mask | None
    ) -> Iterator[tuple[Kind, slice | NDArray[np.int64], NDArray[np.int64]]]:
        """Yield the rows by kind of object, and the objects' bits. A slice means all rows, those in
        ``skip`` included."""
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
    """Return `bits`, with equal bits for all NaNs: they are one literal."""
    # In numpy the minimum of an array with a NaN is NaN: unlike isnan, this allocates no array.
    if values.dtype == np.float64 and len(values) and np.isnan(values.min()):
        values = np.where(np.isnan(values), np.nan, values)
    return bits(values)
