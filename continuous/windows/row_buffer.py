"""What has come in and is still in some window: chunks of rows, kept as views."""

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
"""Chunks below this many rows are put together before they are worked on."""

Shape = tuple[int, tuple[tuple[int, int], ...]]
"""Sort (-1: none) and (predicate, kind) of each column: what rows of one chunk have in common."""


@dataclass(slots=True)
class _Chunk:
    rows: TripleRows
    first: int
    last: int
    small: bool


class Intake(TermTable):
    """The rows of one input, by shape, each chunk ordered by τ.

    Law: `between` depends on the rows and their order of arrival, not on how they were cut into
    batches. (Two tables of one shape in one batch are merged by τ.)

    Cost: a sort of what is pushed out of order; `between` O(chunks + rows copied), where only
    chunks under 4,096 rows and out-of-order ones are copied. Memory: rows not yet dropped, by
    chunk.
    """

    def __init__(self, dictionary: TermDictionary) -> None:
        self._dictionary = dictionary
        self._chunks: dict[Shape, list[_Chunk]] = {}
        self._names: dict[Shape, tuple[object, ...]] = {}
        dictionary.hold(self)
        dictionary.follow(self)

    def push(self, rows: TripleRows, *, ascending: bool) -> None:
        """Keep these rows, of which there are some; ``ascending``: they are in order of τ."""
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
        """Names of predicates that no row has are found anew."""
        self._names = {shape: name for shape, name in self._names.items() if shape in self._chunks}

    def earliest(self, after: int) -> int | None:
        """The least τ > ``after``, or None."""
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
        """The rows with ``low < τ <= high``: shape by shape, in each by τ, then by arrival."""
        for shape in sorted(self._chunks, key=self._named):
            parts = [
                _cut(chunk, low, high)
                for chunk in self._chunks[shape]
                if chunk.first <= high and chunk.last > low
            ]
            parts = [part for part in parts if len(part)]
            yield from _in_order(parts)

    def _named(self, shape: Shape) -> tuple[object, ...]:
        """The shape by names: which of two terms has the lesser id depends on how the input was
        cut, since windows that closed in between have given ids too."""
        found = self._names.get(shape)
        if found is None:
            term, (sort, columns) = self._dictionary.term, shape
            named = sorted((str(term(predicate)), kind) for predicate, kind in columns)
            found = self._names[shape] = "" if sort < 0 else str(term(sort)), tuple(named)
        return found

    def drop(self, until: int, settled: int) -> None:
        """Forget the rows with τ ≤ ``until``, whole chunks at a time.

        No more rows come with τ ≤ ``settled``: small chunks up to there are put together, so that
        a stream of single rows does not cost a chunk a row in every window.
        """
        for shape, chunks in list(self._chunks.items()):
            kept = [chunk for chunk in chunks if chunk.last > until]
            if kept:
                self._chunks[shape] = kept
            else:
                del self._chunks[shape]
        self.settle(settled)

    def settle(self, settled: int) -> None:
        """Put small chunks up to τ = ``settled`` together, where no more rows come."""
        for shape, chunks in self._chunks.items():
            self._chunks[shape] = _settle(chunks, settled)


def _settle(chunks: list[_Chunk], settled: int) -> list[_Chunk]:
    """Runs of small chunks in order, up to ``settled``, as one chunk each."""
    if sum(chunk.small for chunk in chunks) < 2:
        return chunks
    made: list[_Chunk] = []
    run: list[_Chunk] = []
    for chunk in [*chunks, None]:
        fits = chunk is not None and chunk.last <= settled and chunk.small
        if run and not (fits and chunk is not None and run[-1].last <= chunk.first):
            rows = concatenate_rows([one.rows for one in run])
            small = len(rows) < _SMALL
            made.append(_Chunk(rows, run[0].first, run[-1].last, small))
            run = []
        if chunk is not None:
            (run if fits else made).append(chunk)
    return made


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
        if len(part) >= _SMALL:
            if waiting:
                yield concatenate_rows(waiting)
                waiting = []
            yield part
        else:
            waiting.append(part)
    if waiting:
        yield concatenate_rows(waiting)
