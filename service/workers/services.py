"""The worker pools of one service."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import anyio
import anyio.to_thread

from ...continuous.columns.budget import Budget
from ...ontology.ontology import Ontology
from ..config.settings import MEBIBYTE, Settings
from ..turns.window_turns import WindowTurns
from .json_ld import IsolatedJsonLd
from .oxigraph_client import IsolatedAsking
from .pool import Pool
from .rdf_documents import WAITING, IsolatedReasoning
from .sparql import IsolatedQueries
from .specifications import IsolatedSpecifications

WORKERS: Final = 2
"""Workers for windows of continuous queries."""
REPLAY_FACTOR: Final = 10
"""The factor on the deadline during replay: the same query was in time before, but the machine may
be slower now."""
WINDOW_BYTES: Final = 8 * MEBIBYTE
"""The most text in the answer of Oxigraph for a window, and in a GROUP_CONCAT."""
_RETRY_INTERVAL: Final = 5.0
"""Seconds between tries to start workers."""


class Windows:
    """The workers and limits for windows of continuous queries.

    The engine needs ``budget`` and ``turns`` at its creation, before the application exists.
    """

    def __init__(self, settings: Settings) -> None:
        self.pool = Pool(WORKERS, settings.worker_memory)
        self._deadline = settings.query_deadline
        self._asking = IsolatedAsking(
            self.pool, REPLAY_FACTOR * self._deadline, settings.query_results, WINDOW_BYTES
        )
        self.turns = WindowTurns(settings.query_seconds, settings.query_behind)
        self.budget = Budget(
            settings.query_rows, settings.query_results, WINDOW_BYTES, self._asking, self.turns
        )

    def end_replay(self) -> None:
        """Apply the normal deadline: the replay is over."""
        self._asking.seconds = self._deadline

    def close(self) -> None:
        """Kill the workers."""
        self.pool.close()


class Isolation:
    """The worker pools of a service, by purpose. The metrics include those of ``windows``; their
    maker closes them."""

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
        # A separate pool: an ontology occupies its worker for many seconds.
        self._specifications = Pool(1, settings.worker_memory, WAITING)
        self.specifications = IsolatedSpecifications(self._specifications)
        # With these: both take a moment for a text of the usual form.
        self.json_ld = IsolatedJsonLd(self._specifications, settings.batch_limits)
        self._own: Mapping[str, Pool] = {
            "sparql": self._sparql,
            "documents": self._documents,
            "specifications": self._specifications,
        }
        self.pools = {**self._own, **({} if windows is None else {"windows": windows.pool})}
        """All pools, by purpose."""

    def reasons(self) -> list[str]:
        """Return the reasons why some pools do not work; none if all do."""
        return [
            f"workers: none for {name}: {pool.failure}"
            for name, pool in self.pools.items()
            if pool.is_down
        ]

    async def restart_workers(self) -> None:
        """Retry failed starts of workers, as long as the service runs."""
        while True:
            await anyio.sleep(_RETRY_INTERVAL)
            for pool in self.pools.values():
                if pool.is_down:
                    await anyio.to_thread.run_sync(pool.restart, abandon_on_cancel=True)

    def open(self) -> None:
        """Allow workers: an application may start again after its end."""
        for pool in self._own.values():
            pool.open()

    def close(self) -> None:
        """Kill all workers."""
        for pool in self._own.values():
            pool.close()
