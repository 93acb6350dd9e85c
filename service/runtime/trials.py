"""Back tests (`engine.back_test`), one at a time, each in a fork of the process.

The fork reads the histories as they are, without a copy, and its memory goes with it. So does
whatever it does for too long: it is killed.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from functools import partial
from typing import Final

import anyio

from ...continuous.columns.budget import Budget
from ...engine.back_test import Trial, back_test
from ...engine.engine import Engine
from ...languages.csparql.ast import EventRequest
from ..config.address_space import limit_address_space
from ..config.settings import Settings
from ..durability.fork_snapshot import IS_SUPPORTED, SnapshotError, Snapshots
from ..http.problems import Problem
from ..workers.services import WINDOW_BYTES

SECONDS: Final = 5.0
"""The processor time of a back test; then it tells how far it came."""
_KILLED: Final = 60.0
"""Seconds by the clock after which its process is killed."""
_MOST: Final = 5
"""Back tests that wait, with the one that runs; further ones are refused."""


class Trials:
    """The back tests of a service. ``settings`` limit the rows and the memory of each."""

    def __init__(self, settings: Settings) -> None:
        self._budget = Budget(settings.query_rows, settings.query_results, WINDOW_BYTES)
        self._memory = settings.worker_memory
        self._snapshots = Snapshots(_KILLED)
        self._turn = asyncio.Semaphore(1)
        self._under_way = 0

    async def run(
        self, engine: Engine, wanted: str | EventRequest, since: str, strategy: str
    ) -> Trial:
        """Try a query or a request on what ``engine`` keeps. Raises the errors of `back_test`, and
        a 503 `Problem` if too many wait, or if the process died."""
        if self._under_way >= _MOST:
            raise Problem(
                503,
                "too many back tests",
                f"{_MOST} are under way",
                hint="try again after the seconds in Retry-After",
                headers={"Retry-After": f"{SECONDS:g}"},
            )
        self._under_way += 1
        try:
            async with self._turn:
                work = partial(
                    back_test, engine, wanted, since, strategy=strategy, budget=self._budget
                )
                return await self._in_fork(engine, lambda: _within(work))
        finally:
            self._under_way -= 1

    async def _in_fork(self, engine: Engine, work: Callable[[], Trial]) -> Trial:
        if not IS_SUPPORTED:
            return await anyio.to_thread.run_sync(work)

        def limited() -> Trial:
            limit_address_space(self._memory)
            return work()

        try:
            result = self._snapshots.take(limited, engine.ontology.lock)
            return await anyio.to_thread.run_sync(result)
        except SnapshotError as error:
            raise Problem(
                503, "no back test", str(error), hint="try a later moment, or a simpler query"
            ) from error


def _within(work: Callable[..., Trial]) -> Trial:
    """Do the work in the time of a back test; it asks ``is_over``."""
    end = time.thread_time() + SECONDS
    return work(is_over=lambda: time.thread_time() >= end)
