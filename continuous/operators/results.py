"""What a window gives: solutions, triples or an answer."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...rdf.dictionary import Term, TermDictionary
from ...rdf.timed import ObjectColumn, TimedTriples


@dataclass(frozen=True, slots=True, eq=False, weakref_slot=True)
class Solutions:
    """A SELECT's solutions, a column a variable, of shape ``(length,)``; null = unbound.

    As long as they are kept their terms are: they hold them.
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
        """The solutions at ``rows``."""
        columns = {name: column.take(rows) for name, column in self.columns.items()}
        return Solutions(self.variables, columns, self.dictionary, len(rows))

    def rows(self) -> list[dict[str, Term]]:
        """Each solution as ``name -> term``, unbound variables left out: for edges and tests."""
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
    ``end``) and ``answer`` (ASK) is there. ``merged``: the bag was asked for, the window held equal
    triples, and they counted once (docs/explanation/semantics.md says where).
    """

    start: int
    end: int
    solutions: Solutions | None = None
    triples: TimedTriples | None = None
    answer: bool | None = None
    merged: bool = False

    @property
    def size(self) -> int:
        """How many solutions or triples; of an answer, whether it is yes."""
        if self.solutions is not None:
            return len(self.solutions)
        return len(self.triples) if self.triples is not None else int(bool(self.answer))
