"""Users' queries, each in a worker with a copy of the ontology that is brought up to date first."""

from __future__ import annotations

from typing import Final

from ...ontology.ontology import Ontology
from .messages import Answer, Follow, Job, Query
from .pool import Pool
from .worker import Worker

OVERHEAD: Final = 1 << 16
"""Bytes of an answer beside what it tells."""
CATCHING_UP: Final = 30.0
"""Seconds that a worker has for what it lacks of the ontology, beside those of the query."""


class IsolatedQueries:
    """Answers queries of at most ``seconds``, with ``rows`` rows or triples and ``size`` bytes."""

    def __init__(
        self, ontology: Ontology, pool: Pool, seconds: float, rows: int, size: int
    ) -> None:
        self._ontology = ontology
        self._pool = pool
        self._seconds = seconds
        self._rows = rows
        self._size = size

    async def answer(self, text: str, format: str) -> Answer:
        """The answer to a query, written as ``format`` (`formats`); with none its text is checked.

        Raises `Busy` and `WorkerError`.
        """

        def work(worker: Worker) -> Answer:
            lacks = self._ontology.changes_since(worker.position)
            if worker.position != lacks.position:
                follow = Follow(lacks.whole, lacks.added, lacks.removed)
                worker.call(Job(follow, CATCHING_UP), OVERHEAD)
                worker.position = lacks.position
            query = Query(text, format, self._rows, self._size)
            return worker.call(Job(query, self._seconds), self._size + OVERHEAD)

        return await self._pool.run(work, self._seconds)
