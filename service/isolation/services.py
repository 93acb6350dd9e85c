"""All isolated work of one service: made with the application, ended with it."""

from __future__ import annotations

from typing import Final

from ...continuous.budget import Budget
from ...ontology.ontology import Ontology
from ..pausing import Pausing
from ..settings import MEBIBYTE, Settings
from .asking import IsolatedAsking
from .documents import WAITING, IsolatedReasoning
from .pool import Pool
from .sparql import IsolatedQueries
from .specifications import IsolatedSpecifications

WORKERS: Final = 2
"""So many questions about windows are answered at once."""
AGAIN: Final = 10
WINDOW_BYTES: Final = 8 * MEBIBYTE
"""Text that Oxigraph may answer about a window."""


class Windows:
    """The workers for continuous queries, and the time for them.

    ``budget`` and ``turns`` are for the engine, which has to have them before there is an
    application.
    """

    def __init__(self, settings: Settings) -> None:
        self._pool = Pool(WORKERS, settings.worker_memory)
        self._deadline = settings.query_deadline
        # What was done once was done in time: while it is done again the machine may be slower.
        self._asking = IsolatedAsking(
            self._pool, AGAIN * self._deadline, settings.query_results, WINDOW_BYTES
        )
        self.turns = Pausing(settings.query_seconds, settings.query_behind)
        self.budget = Budget(settings.query_rows, settings.query_results, self._asking, self.turns)

    def begin(self) -> None:
        """What was done before is done again: from now on deadlines hold."""
        self._asking.seconds = self._deadline

    def warm(self) -> None:
        """Start the worker."""
        self._pool.warm()

    def close(self) -> None:
        """End it."""
        self._pool.close()


class Isolation:
    """The workers of a service, by what they do."""

    def __init__(self, settings: Settings, ontology: Ontology) -> None:
        self._sparql = Pool(
            settings.sparql_workers, settings.worker_memory, settings.sparql_waiting
        )
        self.queries = IsolatedQueries(
            ontology,
            self._sparql,
            settings.sparql_deadline,
            settings.sparql_rows,
            settings.sparql_bytes,
        )
        self._documents = Pool(1, settings.worker_memory)
        self.documents = IsolatedReasoning(
            self._documents, settings.ontology_deadline, settings.ontology_triples
        )
        # A pool of their own: an ontology takes its worker for many seconds.
        self._specifications = Pool(1, settings.worker_memory, WAITING)
        self.specifications = IsolatedSpecifications(self._specifications)
        self._pools = (self._sparql, self._documents, self._specifications)

    @property
    def ended(self) -> int:
        """How many workers came to their end in the middle of a job."""
        return sum(pool.ended for pool in self._pools)

    @property
    def busy(self) -> int:
        """How many workers are at work."""
        return sum(pool.busy for pool in self._pools)

    def warm(self) -> None:
        """Start all workers: the first who ask should not wait for them."""
        self._sparql.warm()

    def open(self) -> None:
        """There are workers from now on: an application may start again after it has ended."""
        for pool in self._pools:
            pool.open()

    def close(self) -> None:
        """End all workers."""
        for pool in self._pools:
            pool.close()
