"""Oxigraph for continuous queries, in workers: see `continuous.columns.oxigraph_port`.

The thread that closes the window waits for the answer. With turns that is a fiber, and other work
goes on meanwhile (`window_turns`).
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

MOST_CACHED: Final = 32
"""Sets of quads that a worker caches; it evicts the least recently used one."""
_OVERHEAD: Final = 1 << 20


class IsolatedAsking:
    """Sends queries to the workers of ``pool``, with limits for each answer: ``seconds``, ``rows``,
    and ``size`` bytes of text."""

    def __init__(self, pool: Pool, seconds: float, rows: int, size: int) -> None:
        self._pool = pool
        self.seconds = seconds
        self._slots = BoundedSemaphore(pool.count)
        self._rows = rows
        self._size = size

    def ask(self, sparql: str, kept: StoredQuads, content: Sequence[Quad]) -> SparqlResult:
        """Implement `OxigraphPort.ask`."""
        try:
            # `Pool.call` waits for no worker, and would start more of them than there may be.
            with self._slots:
                answer = self._pool.call(lambda worker: self._send(worker, sparql, kept, content))
            return _result(answer)
        except (WorkerError, BadAnswer) as error:
            raise Stopped(f"Oxigraph was stopped: {error}") from error

    def _send(
        self, worker: Worker, sparql: str, kept: StoredQuads, content: Sequence[Quad]
    ) -> Answer:
        key = str(kept.number)
        is_new = bool(kept.quads) and not worker.kept.get(key)
        forget = []
        # Reinserted at the end: the order is that of the last use.
        worker.kept.pop(key, None)
        if kept.quads:
            worker.kept[key] = len(kept.quads)
        while len(worker.kept) > MOST_CACHED:
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
            # The worker may have cached a part of them: send them again with the next query.
            worker.kept[key] = 0
        return answer


def _result(answer: Answer) -> SparqlResult:
    match answer:
        case Truth(yes):
            return yes
        case Cells([], rows):
            return list(triples_of(rows))
        case Cells(names, rows):
            if any(len(row) != len(names) for row in rows):
                raise Died("a worker sent an invalid answer")
            return Table(
                tuple(names),
                [[None if cell is None else term_of(cell) for cell in row] for row in rows],
            )
        case TooMuch(what, limit):
            raise BudgetExceeded(f"a result of more than {limit} {what}")
        case Failed(message):
            raise ValueError(message)
    raise Died("a worker sent an invalid answer")
