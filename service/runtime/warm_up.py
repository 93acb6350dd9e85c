"""The warm-up in threads beside the start, for which the first requests would otherwise wait:
compiled loops, worker processes, grammars, tables of units, the OpenAPI schema.

The service is not ready before its end (docs/reference/metrics.md, "Readiness"). Called by
cli/serving.
"""

from __future__ import annotations

import gc
import threading
from collections.abc import Callable

from fastapi import FastAPI

from ...languages.kpl.parser import parse_kpl
from ...languages.ssl.parser import parse_ssl
from ...ontology.units import conversion, parse_unit
from ...streams.jit import compile_all
from ..config.logs import log
from ..workers.pool import Pool
from ..workers.worker import WorkerError

_PATIENCE = 30.0
"""Seconds to compile one loop, on a slow machine."""


class _Over(Exception):
    """Ends the warm-up when the service stops."""


class WarmUp:
    """Tasks in threads, each with a name for /readyz.

    Any thread may call `unfinished`, then `failed`: in this order they miss no task.
    """

    def __init__(self) -> None:
        self._doing: dict[str, str] = {}
        self._failed: dict[str, str] = {}
        self._threads: list[threading.Thread] = []
        self._is_over = False

    def unfinished(self) -> list[str]:
        """The tasks that are under way."""
        return [f"{name}: {doing}" for name, doing in tuple(self._doing.items())]

    def failed(self) -> list[str]:
        """The tasks that have failed."""
        return [f"{name}: failed: {error}" for name, error in tuple(self._failed.items())]

    def begin(self, name: str, doing: str, work: Callable[[], None]) -> threading.Thread:
        """Start ``work`` in a thread."""
        self._doing[name] = doing
        thread = threading.Thread(
            target=self._run, args=(name, work), name=f"warm-{name}", daemon=True
        )
        self._threads.append(thread)
        thread.start()
        return thread

    def _run(self, name: str, work: Callable[[], None]) -> None:
        try:
            work()
        except _Over:
            return
        except Exception as error:  # noqa: BLE001 - the log and /readyz report it
            log().exception("warm-up failed", what=name)
            self._failed[name] = str(error)
        del self._doing[name]

    def loops(self) -> None:
        """Compile the loops, or read them from the cache."""

        def tell(done: int, count: int) -> None:
            self._doing["loops"] = f"being compiled, {done} of {count} are done"
            if self._is_over:
                raise _Over

        self.begin("loops", "being compiled", lambda: compile_all(tell))

    def end(self) -> None:
        """Stop compiling, and wait for the threads. A thread within the compiler at the end of the
        interpreter would crash the process."""
        self._is_over = True
        for thread in self._threads:
            thread.join(_PATIENCE)

    def workers(self, name: str, pool: Pool) -> None:
        """Start the workers of a pool. If that fails, the pool tries again and reports it."""

        def start() -> None:
            try:
                pool.warm()
            except WorkerError as error:
                log().error("no workers", pool=name, reason=str(error))

        self.begin(f"workers for {name}", "being started", start)

    def application(self, app: FastAPI) -> None:
        """Create what routes create at their first request. After all other tasks, exclude all
        objects from garbage collections: they are permanent, and examining them takes 100 ms."""
        others = tuple(self._threads)

        def rehearse() -> None:
            app.openapi()
            parse_ssl("stream s contains altitude(self) = a [ft]")
            parse_kpl("source float s")
            conversion(parse_unit("ft"), parse_unit("m"))
            for thread in others:
                thread.join()
            gc.collect()
            gc.freeze()

        self.begin("application", "being prepared", rehearse)
