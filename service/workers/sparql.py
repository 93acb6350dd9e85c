"""Users' SPARQL queries, each in a worker whose copy of the ontology is updated first."""

from __future__ import annotations

from typing import Final

from ...ontology.ontology import Ontology
from .messages import Answer, Follow, GraphNames, Job, Query, Truth
from .pool import Pool
from .worker import End, NoWorker, Worker, WorkerError

OVERHEAD: Final = 1 << 16
"""Bytes of an answer in addition to its content."""
UPDATE_SECONDS: Final = 30.0
"""Seconds for the update of a worker's copy, in addition to those of the query."""
_TOO_LARGE: Final = "the ontology exceeds the memory or the time of a worker"


class NotUpToDate(NoWorker):
    """The update of a worker's copy failed and killed the worker: the query is not the cause.

    ``was_new``: the worker was new, so that it had all its memory for the copy.
    """

    def __init__(self, message: str, was_new: bool) -> None:
        super().__init__(message)
        self.was_new = was_new


class IsolatedQueries:
    """Answers queries within ``seconds``, ``rows`` rows or triples, and ``size`` bytes."""

    def __init__(
        self, ontology: Ontology, pool: Pool, seconds: float, rows: int, size: int
    ) -> None:
        self._ontology = ontology
        self._pool = pool
        self._seconds = seconds
        self._rows = rows
        self._size = size

    async def answer(
        self,
        text: str,
        format: str,
        sender: str = "",
        *,
        dataset: GraphNames | None = None,
        base: str = "",
    ) -> Answer:
        """Answer a query of ``sender`` in ``format`` (`sparql_formats`); with an empty format only
        check it. ``dataset`` replaces the one of the query, ``base`` resolves relative IRIs.

        Raises `Busy` and `WorkerError`.
        """

        def work(worker: Worker) -> Answer:
            self._update(worker)
            query = Query(text, format, self._rows, self._size, dataset, base)
            return worker.call(Job(query, self._seconds), self._size + OVERHEAD)

        while True:
            try:
                return await self._pool.run(work, self._seconds, sender)
            except NotUpToDate as error:
                # Earlier queries left the worker too little memory. Each try kills one such worker,
                # so at last a new worker tries, with all its memory.
                if error.was_new:
                    raise

    def _update(self, worker: Worker) -> None:
        changes = self._ontology.changes_since(worker.position)
        if worker.position == changes.position:
            return
        was_new = worker.position is None
        follow = Follow(changes.dump, changes.added, changes.removed)
        try:
            answer = worker.call(Job(follow, UPDATE_SECONDS), OVERHEAD)
        except WorkerError as error:
            if error.end in (End.MEMORY, End.DEADLINE):
                raise NotUpToDate(_TOO_LARGE, was_new) from error
            raise
        if answer != Truth(True):
            # The copy may be half updated, so all answers of this worker would be wrong.
            worker.kill(End.MEMORY)
            raise NotUpToDate(f"{_TOO_LARGE}: {answer}", was_new)
        worker.position = changes.position
