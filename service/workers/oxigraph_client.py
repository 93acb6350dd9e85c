"""Oxigraph for continuous queries, in a worker: see `continuous.columns.oxigraph_port`.

Whoever closes the window waits for the answer, on a thread of its own where others go on meanwhile
(`pausing`).
"""

from __future__ import annotations

from collections.abc import Sequence
from threading import BoundedSemaphore
from typing import Final

from pyoxigraph import Quad

from ...continuous.columns.budget import BudgetExceeded, Stopped
from ...continuous.columns.oxigraph_port import SparqlResult, StoredQuads, Table
from ...ontology.replicas import as_nquads
from .messages import (
    Answer,
    Ask,
    BadAnswer,
    Failed,
    Job,
    TooMuch,
    Truth,
    term_of,
    triples_of,
)
from .messages import Table as Cells
from .pool import Pool
from .worker import Died, Worker, WorkerError

MOST_KEPT: Final = 32
"""So many sets of quads a worker keeps; the one that was not asked about for longest goes first."""
_OVERHEAD: Final = 1 << 20


class IsolatedAsking:
    """Asks the workers of ``pool``: ``seconds`` for each answer, which has at most ``rows`` rows
    with ``size`` bytes of text."""

    def __init__(self, pool: Pool, seconds: float, rows: int, size: int) -> None:
        self._pool = pool
        self.seconds = seconds
        self._places = BoundedSemaphore(pool.count)
        self._rows = rows
        self._size = size

    def ask(self, sparql: str, kept: StoredQuads, content: Sequence[Quad]) -> SparqlResult:
        """See `OxigraphPort`."""
        try:
            with self._places:
                answer = self._pool.call(lambda worker: self._asked(worker, sparql, kept, content))
            return _found(answer)
        except (WorkerError, BadAnswer) as error:
            raise Stopped(f"Oxigraph was stopped: {error}") from error

    def _asked(
        self, worker: Worker, sparql: str, kept: StoredQuads, content: Sequence[Quad]
    ) -> Answer:
        key = str(kept.number)
        is_new = bool(kept.quads) and not worker.kept.get(key)
        forget = []
        # Known again, it is the one that was asked about last.
        worker.kept.pop(key, None)
        if kept.quads:
            worker.kept[key] = len(kept.quads)
        while len(worker.kept) > MOST_KEPT:
            oldest = next(iter(worker.kept))
            del worker.kept[oldest]
            forget.append(oldest)
        ask = Ask(
            sparql,
            key,
            as_nquads(kept.quads) if is_new else None,
            as_nquads(content),
            forget,
            self._rows,
            self._size,
        )
        answer = worker.call(Job(ask, self.seconds), 16 * self._size + _OVERHEAD)
        if is_new and isinstance(answer, Failed):
            # Nobody knows how much of them it has: they are sent again, or it is told to forget.
            worker.kept[key] = 0
        return answer


def _found(answer: Answer) -> SparqlResult:
    match answer:
        case Truth(yes):
            return yes
        case Cells([], rows):
            return list(triples_of(rows))
        case Cells(names, rows):
            if any(len(row) != len(names) for row in rows):
                raise Died("a worker answered nonsense")
            return Table(
                tuple(names),
                [[None if cell is None else term_of(cell) for cell in row] for row in rows],
            )
        case TooMuch(what, limit):
            raise BudgetExceeded(f"a result of more than {limit} {what}")
        case Failed(message):
            raise ValueError(message)
    raise Died("a worker answered nonsense")
