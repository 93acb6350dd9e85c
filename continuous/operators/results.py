"""Results of a window: solutions, triples or a boolean."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...rdf.dictionary import Term, TermDictionary
from ...rdf.timed import ObjectColumn, TimedTriples


@dataclass(frozen=True, slots=True, eq=False, weakref_slot=True)
class Solutions:
    """The solutions of a SELECT, a column per variable, of shape ``(length,)``; null = unbound.

    The object keeps its terms in the dictionary.
    """

    variables: tuple[str, ...]
    columns: Mapping[str, ObjectColumn]
    dictionary: TermDictionary
    length: int

    def __post_init__(self) -> None:
        self.dictionary.hold(self)

    def __len__(self) -> int:
        return self.length

    def held_ids(self) -> Iterator[NDArray[np.int32]]:
        """See `dictionary.Holder`."""
        for column in self.columns.values():
            yield column.held_ids

    def take(self, rows: NDArray[np.int64]) -> Solutions:
        """Return the solutions at ``rows``."""
        columns = {name: column.take(rows) for name, column in self.columns.items()}
        return Solutions(self.variables, columns, self.dictionary, len(rows))

    def rows(self) -> list[dict[str, Term]]:
        """Return each solution as ``name -> term``, without unbound variables: for edges and
        tests."""
        rows: list[dict[str, Term]] = [{} for _ in range(self.length)]
        for name in self.variables:
            column = self.columns[name]
            present = column.present
            for row in range(self.length):
                if present[row]:
                    rows[row][name] = column.term_at(row, self.dictionary)
        return rows


@dataclass(frozen=True, slots=True, eq=False)
class WindowResult:
    """The result of the window with end ``end`` (ns); ``start`` is the earliest bound of content.

    Exactly one of ``solutions`` (SELECT), ``triples`` (CONSTRUCT, DESCRIBE; τ and valid time are
    ``end``) and ``answer`` (ASK) is set. ``merged``: equal triples in the window counted once
    although the query has bag semantics (docs/explanation/semantics.md lists the cases).
    """

    start: int
    end: int
    solutions: Solutions | None = None
    triples: TimedTriples | None = None
    answer: bool | None = None
    merged: bool = False

    @property
    def size(self) -> int:
        """The number of solutions or triples; for an answer, 1 if it is true."""
        if self.solutions is not None:
            return len(self.solutions)
        return len(self.triples) if self.triples is not None else int(bool(self.answer))

    @property
    def is_empty(self) -> bool:
        """Whether it has no solution and no triple; an answer is never empty."""
        if self.triples is not None:
            return not any(map(len, self.triples.tables))
        return self.solutions is not None and not len(self.solutions)

    @property
    def ends(self) -> Sequence[int]:
        """The ends of all windows: a batch of one."""
        return (self.end,)

    def windows(self) -> Iterator[WindowResult]:
        """Yield the result of each window: this one."""
        yield self


@dataclass(frozen=True, slots=True, eq=False)
class ResultBatch:
    """The results of successive windows with these ``starts`` and ``ends`` (ns).

    ``solutions`` or ``triples`` has the rows of all windows, in order of their ends. The rows of
    window i begin at ``offsets[i]`` and end before ``offsets[i + 1]``; those of ``triples`` are the
    rows with τ = ``ends[i]``, table by table.
    """

    starts: Sequence[int]
    ends: Sequence[int]
    solutions: Solutions | None = None
    triples: TimedTriples | None = None
    offsets: Sequence[int] = ()

    @property
    def sizes(self) -> NDArray[np.int64]:
        """The number of solutions, or of rows of triples, of each window."""
        if self.triples is None:
            offsets = np.array(self.offsets, np.int64)
            return offsets[1:] - offsets[:-1]
        times = [table.time for table in self.triples.tables]
        found = np.searchsorted(self.ends, np.concatenate([np.zeros(0, np.int64), *times]))
        return np.bincount(found, minlength=len(self.ends))

    def of(self, windows: Sequence[int]) -> ResultBatch:
        """Return the results of these windows, ascending. Contract: the others are empty."""
        starts, ends = ([times[i] for i in windows] for times in (self.starts, self.ends))
        if self.triples is not None:
            return ResultBatch(starts, ends, triples=self.triples)
        offsets = [*(self.offsets[i] for i in windows), self.offsets[-1]]
        return ResultBatch(starts, ends, self.solutions, offsets=offsets)

    def window(self, i: int) -> WindowResult:
        """Return the result of window ``i``."""
        start, end = self.starts[i], self.ends[i]
        if self.solutions is not None:
            rows = np.arange(self.offsets[i], self.offsets[i + 1])
            return WindowResult(start, end, solutions=self.solutions.take(rows))
        assert self.triples is not None
        parts = []
        for table in self.triples.tables:
            first, last = np.searchsorted(table.time, (end, end + 1)).tolist()
            if first < last:
                parts.append(table.take(slice(first, last)))
        triples = TimedTriples(self.triples.dictionary, tuple(parts))
        return WindowResult(start, end, triples=triples)

    def windows(self) -> Iterator[WindowResult]:
        """Yield the result of each window."""
        return map(self.window, range(len(self.ends)))
