"""Deadlines for user-written processes, whose code runs on a thread of its own (see
engine/processes/supervision.py).

Python cannot end a thread, so the watchdog abandons a blocked one. It is a daemon thread, which
does not keep the service alive; its late result is discarded; the next call gets a new thread.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import Future
from queue import SimpleQueue
from typing import Any, TypeVar

from ...engine.processes.external_io import Tape
from ...engine.processes.supervision import UnitBlocked
from ...streams.time import SECOND, format_duration

T = TypeVar("T")

_LOOKS = 4
"""Checks without progress that make a deadline. After the machine slept, a single one would prove
nothing."""


class Watchdog:
    """A `Runner` with a deadline. One thread runs all processes, one call at a time, as the engine
    makes them; ``abandoned`` counts the abandoned threads.

    Contract: a process does not use the engine. It runs on another thread than the engine, on the
    same one as long as no call blocks.

    Cost: two thread switches a run (a run is a batch of calls). ``deadline`` None: no switch.
    """

    tape: Tape | None = None

    def __init__(self) -> None:
        self.abandoned = 0
        self._worker: _Worker | None = None

    def run(self, work: Callable[[], T], deadline: int | None, progress: Callable[[], int]) -> T:
        """See `Runner`. A process that another process calls has the deadline of the caller."""
        if deadline is None or isinstance(threading.current_thread(), _Worker):
            return work()
        worker = self._worker
        if worker is None:
            worker = self._worker = _Worker()
            worker.start()
        result: Future[T] = Future()
        try:
            worker.calls.put((work, result))
            if not _finished(result, deadline, progress):
                raise UnitBlocked(f"it did not come back within {format_duration(deadline)}")
        except BaseException:  # blocked, or this wait was interrupted: the call may not return
            self._worker = None
            self.abandoned += 1
            worker.calls.put(None)
            raise
        return result.result()

    def close(self) -> None:
        """End the thread that waits for work."""
        if self._worker is not None:
            self._worker.calls.put(None)
            self._worker = None


def _finished(result: Future[Any], deadline: int, progress: Callable[[], int]) -> bool:
    """Wait for ``result``; False after ``deadline`` ns without progress."""
    seen, quiet = progress(), 0
    while quiet < _LOOKS:
        try:
            # An error of the process is returned here; only the wait raises one.
            result.exception(min(deadline / SECOND / _LOOKS, threading.TIMEOUT_MAX))
            return True
        except TimeoutError:
            now = progress()
        seen, quiet = (now, 0) if now != seen else (seen, quiet + 1)
    return False


class _Worker(threading.Thread):
    """Runs ``calls`` one after the other, until it gets None."""

    def __init__(self) -> None:
        super().__init__(name="dyknow-process", daemon=True)
        self.calls: SimpleQueue[tuple[Callable[[], Any], Future[Any]] | None] = SimpleQueue()

    def run(self) -> None:
        while (call := self.calls.get()) is not None:
            work, result = call
            try:
                result.set_result(work())
            except BaseException as error:  # noqa: BLE001  `Watchdog.run` raises it
                result.set_exception(error)
            del call, work, result  # an idle thread keeps no samples
