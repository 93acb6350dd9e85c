"""All isolated work of one service: made with the application, ended with it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import anyio
import anyio.to_thread

from ...continuous.columns.budget import Budget
from ...ontology.ontology import Ontology
from ..config.settings import MEBIBYTE, Settings
from ..turns.window_turns import WindowTurns
from .oxigraph_client import IsolatedAsking
from .pool import Pool
from .rdf_documents import WAITING, IsolatedReasoning
from .sparql import IsolatedQueries
from .specifications import IsolatedSpecifications

WORKERS: Final = 2
"""So many questions about windows are answered at once."""
SLOWER: Final = 10
"""So many times as long a question may take while what was answered once is done again."""
WINDOW_BYTES: Final = 8 * MEBIBYTE
"""Text that Oxigraph may answer about a window, and that GROUP_CONCAT may put together."""
_AGAIN: Final = 5.0
"""Seconds until workers that could not be started are tried again."""


class Windows:
    """The workers for continuous queries, and the time for them.

    ``budget`` and ``turns`` are for the engine, which has to have them before there is an
    application.
    """

    def __init__(self, settings: Settings) -> None:
        self.pool = Pool(WORKERS, settings.worker_memory)
        self._deadline = settings.query_deadline
        # What was done once was done in time: while it is done again the machine may be slower.
        self._asking = IsolatedAsking(
            self.pool, SLOWER * self._deadline, settings.query_results, WINDOW_BYTES
        )
        self.turns = WindowTurns(settings.query_seconds, settings.query_behind)
        self.budget = Budget(
            settings.query_rows, settings.query_results, WINDOW_BYTES, self._asking, self.turns
        )

    def begin(self) -> None:
        """What was done before is done again: from now on deadlines hold."""
        self._asking.seconds = self._deadline

    def close(self) -> None:
        """End it."""
        self.pool.close()


class Isolation:
    """The workers of a service, by what they do. ``windows`` are the engine's, where it has some:
    they are told of, and ended by whoever made them."""

    def __init__(
        self, settings: Settings, ontology: Ontology, windows: Windows | None = None
    ) -> None:
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
        self._own: Mapping[str, Pool] = {
            "sparql": self._sparql,
            "documents": self._documents,
            "specifications": self._specifications,
        }
        self.pools = {**self._own, **({} if windows is None else {"windows": windows.pool})}
        """All workers, by what they do."""

    def reasons(self) -> list[str]:
        """Why some of that cannot be done at present: nothing if all can."""
        return [
            f"workers: none for {name}: {pool.failure}"
            for name, pool in self.pools.items()
            if pool.is_down
        ]

    async def tend(self) -> None:
        """For as long as the service runs: start workers again that could not be started."""
        while True:
            await anyio.sleep(_AGAIN)
            for pool in self.pools.values():
                if pool.is_down:
                    await anyio.to_thread.run_sync(pool.mend, abandon_on_cancel=True)

    def open(self) -> None:
        """There are workers from now on: an application may start again after it has ended."""
        for pool in self._own.values():
            pool.open()

    def close(self) -> None:
        """End all workers."""
        for pool in self._own.values():
            pool.close()
