"""All isolated work of one service: made with the application, ended with it."""

from __future__ import annotations

from ...ontology.ontology import Ontology
from ..settings import Settings
from .pool import Pool
from .sparql import IsolatedQueries


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

    @property
    def ended(self) -> int:
        """How many workers came to their end in the middle of a job."""
        return self._sparql.ended

    def warm(self) -> None:
        """Start all workers: the first who ask should not wait for them."""
        self._sparql.warm()

    def close(self) -> None:
        """End all workers."""
        self._sparql.close()
