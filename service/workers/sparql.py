"""Users' queries, each in a worker with a copy of the ontology that is brought up to date first."""

from __future__ import annotations

from typing import Final

from ...ontology.ontology import Ontology
from .messages import Answer, Follow, Job, Query, Truth
from .pool import Pool
from .worker import End, NoWorker, Worker, WorkerError

OVERHEAD: Final = 1 << 16
"""Bytes of an answer beside what it tells."""
CATCHING_UP: Final = 30.0
"""Seconds that a worker has for what it lacks of the ontology, beside those of the query."""
_TOO_LARGE: Final = "a worker cannot take all that is known with its memory and in its time"


class NotUpToDate(NoWorker):
    """A worker could not take what has changed, and is gone: nothing is wrong with the query.

    ``was_new``: it had all of its memory for that.
    """

    def __init__(self, message: str, was_new: bool) -> None:
        super().__init__(message)
        self.was_new = was_new


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
        """The answer to a query, written as ``format`` (`sparql_formats`); with none its text is
        checked.

        Raises `Busy` and `WorkerError`.
        """

        def work(worker: Worker) -> Answer:
            self._bring_up_to_date(worker)
            query = Query(text, format, self._rows, self._size)
            return worker.call(Job(query, self._seconds), self._size + OVERHEAD)

        while True:
            try:
                return await self._pool.run(work, self._seconds)
            except NotUpToDate as error:
                # What earlier queries have left of its memory was not enough. Each try ends one
                # that is like that: after the last one comes a new one, which has all of it.
                if error.was_new:
                    raise

    def _bring_up_to_date(self, worker: Worker) -> None:
        lacks = self._ontology.changes_since(worker.position)
        if worker.position == lacks.position:
            return
        was_new = worker.position is None
        follow = Follow(lacks.dump, lacks.added, lacks.removed)
        try:
            answer = worker.call(Job(follow, CATCHING_UP), OVERHEAD)
        except WorkerError as error:
            if error.end in (End.MEMORY, End.DEADLINE):
                raise NotUpToDate(_TOO_LARGE, was_new) from error
            raise
        if answer != Truth(True):
            # It may have some of it: what it says of anything is not to be trusted.
            worker.kill(End.MEMORY)
            raise NotUpToDate(f"{_TOO_LARGE}: {answer}", was_new)
        worker.position = lacks.position
