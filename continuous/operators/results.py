"""Results of a window: solutions, triples or a boolean."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
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
