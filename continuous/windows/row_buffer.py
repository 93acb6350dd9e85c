"""The row buffer of an input: chunks of rows that an open window needs, stored as views."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...rdf.dictionary import TermDictionary, TermTable
from ...rdf.timed import TripleRows
from ...streams.sample import Times
from ..columns.relation import concatenate_rows

_SMALL = 4096
"""Chunks below this number of rows are merged, because each chunk costs some numpy calls."""
_MANY = 8
"""The number of small chunks that are merged at once: a merge at each window copies its rows."""

Shape = tuple[int, tuple[tuple[int, int], ...]]
"""Sort (-1: none) and (predicate, kind) of each column: common to the rows of a chunk."""


@dataclass(slots=True)
class _Chunk:
    rows: TripleRows
    first: int
    last: int
    small: bool


class RowBuffer(TermTable):
    """The rows of one input, by shape, in chunks ordered by τ.

    Law: `between` depends on the rows and their order of arrival, not on how they are cut into
    batches. (It merges two tables of one shape in one batch by τ.)

    Cost: a sort of rows pushed out of order; `between` O(chunks + copied rows). It copies only
    out-of-order chunks and those under 4,096 rows. Memory: rows not yet dropped, by chunk.
    """

    def __init__(self, dictionary: TermDictionary) -> None:
        self._dictionary = dictionary
        self._chunks: dict[Shape, list[_Chunk]] = {}
        self._names: dict[Shape, tuple[object, ...]] = {}
        dictionary.hold(self)
        dictionary.follow(self)

    def push(self, rows: TripleRows, *, ascending: bool) -> None:
        """Store these rows, at least one; ``ascending``: they are in order of τ."""
        if not ascending:
            rows = rows.take(np.argsort(rows.time, kind="stable"))
        shape = (
            -1 if rows.sort is None else rows.sort,
            tuple(sorted((p, int(column.kind)) for p, column in rows.objects.items())),
        )
        self._chunks.setdefault(shape, []).append(
            _Chunk(rows, int(rows.time[0]), int(rows.time[-1]), len(rows) < _SMALL)
        )

    def held_ids(self) -> Iterator[NDArray[Any] | Sequence[int]]:
        """See `dictionary.Holder`."""
        for chunks in self._chunks.values():
            for chunk in chunks:
                yield from chunk.rows.held_ids()

    def forget(self, freed: NDArray[np.bool_]) -> None:
        """Drop the cached names of shapes without rows: their ids may mean other terms soon."""
        self._names = {shape: name for shape, name in self._names.items() if shape in self._chunks}

    def earliest(self, after: int) -> int | None:
        """Return the least τ > ``after``, or None."""
        found: int | None = None
        for chunks in self._chunks.values():
            for chunk in chunks:
                if chunk.last <= after:
                    continue
                time = chunk.first
                if time <= after:
                    time = int(chunk.rows.time[_after(chunk.rows.time, after)])
                found = time if found is None else min(found, time)
        return found

    def between(self, low: int, high: int) -> Iterator[TripleRows]:
        """Yield the rows with ``low < τ <= high``, shape by shape, each by τ, then by arrival."""
        for shape in sorted(self._chunks, key=self._name_of):
            parts = [
                _cut(chunk, low, high)
                for chunk in self._chunks[shape]
                if chunk.first <= high and chunk.last > low
            ]
            parts = [part for part in parts if len(part)]
            yield from _in_order(parts)

    def _name_of(self, shape: Shape) -> tuple[object, ...]:
        """Return the shape by names, as a sort key. Ids would not do: windows that close in between
        allocate ids too, so their order depends on how the input is cut."""
        name = self._names.get(shape)
        if name is None:
            term, (sort, columns) = self._dictionary.term, shape
            columns_by_name = sorted((str(term(predicate)), kind) for predicate, kind in columns)
            sort_name = "" if sort < 0 else str(term(sort))
            name = self._names[shape] = sort_name, tuple(columns_by_name)
        return name

    def drop(self, until: int, settled: int) -> None:
        """Drop the rows with τ ≤ ``until``, whole chunks at a time, then `settle`."""
        for shape, chunks in list(self._chunks.items()):
            kept = [chunk for chunk in chunks if chunk.last > until]
            if kept:
                self._chunks[shape] = kept
            else:
                del self._chunks[shape]
        self.settle(settled)

    def settle(self, settled: int) -> None:
        """Merge small chunks up to τ = ``settled``, where no more rows come. Otherwise a stream of
        single rows would cost a chunk per row in every window."""
        for shape, chunks in self._chunks.items():
            self._chunks[shape] = _settle(chunks, settled)


def _settle(chunks: list[_Chunk], settled: int) -> list[_Chunk]:
    """Merge each run of small chunks in order, up to ``settled``, into one chunk."""
    if len(chunks) < _MANY or sum(chunk.small for chunk in chunks) < _MANY:
        return chunks
    merged: list[_Chunk] = []
    run: list[_Chunk] = []
    for chunk in [*chunks, None]:
        fits = chunk is not None and chunk.last <= settled and chunk.small
        # Chunks that overlap in time stay apart: `between` sorts their rows when it reads them.
        if run and not (fits and chunk is not None and run[-1].last <= chunk.first):
            rows = concatenate_rows([one.rows for one in run])
            small = len(rows) < _SMALL
            merged.append(_Chunk(rows, run[0].first, run[-1].last, small))
            run = []
        if chunk is not None:
            (run if fits else merged).append(chunk)
    return merged


def _after(times: Times, time: int) -> int:
    return int(np.searchsorted(times, time, "right"))


def _cut(chunk: _Chunk, low: int, high: int) -> TripleRows:
    if chunk.first > low and chunk.last <= high:
        return chunk.rows
    times = chunk.rows.time
    return chunk.rows.take(slice(_after(times, low), _after(times, high)))


def _in_order(parts: list[TripleRows]) -> Iterator[TripleRows]:
    overlapping = any(after.time[0] < before.time[-1] for before, after in pairwise(parts))
    if overlapping:
        rows = concatenate_rows(parts)
        yield rows.take(np.argsort(rows.time, kind="stable"))
        return
    waiting: list[TripleRows] = []
    for part in parts:
        # Large parts go on as views; a copy pays for small ones only.
        if len(part) >= _SMALL:
            if waiting:
                yield concatenate_rows(waiting)
                waiting = []
            yield part
        else:
            waiting.append(part)
    if waiting:
        yield concatenate_rows(waiting)
