"""Deadlines for user-written processes, whose code runs on a thread of its own (see
engine/processes/supervision.py).

Python cannot end a thread, so the watchdog abandons a blocked one. It is a daemon thread, which
does not keep the service alive; its late result is discarded; the next call gets a new thread.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any, Generic, TypeVar

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
        task = _Task(work)
        try:
            worker.take(task)
            if not _finished(task, deadline, progress):
                raise UnitBlocked(f"it did not come back within {format_duration(deadline)}")
        except BaseException:  # blocked, or this wait was interrupted: the call may not return
            self._worker = None
            self.abandoned += 1
            worker.leave()
            raise
        return task.result()

    def close(self) -> None:
        """End the thread that waits for work."""
        if self._worker is not None:
            self._worker.leave()
            self._worker = None


def _finished(task: _Task[Any], deadline: int, progress: Callable[[], int]) -> bool:
    """Wait for ``task``; False after ``deadline`` ns without progress."""
    seen, quiet = progress(), 0
    while quiet < _LOOKS:
        if task.done.wait(min(deadline / SECOND / _LOOKS, threading.TIMEOUT_MAX)):
            return True
        now = progress()
        seen, quiet = (now, 0) if now != seen else (seen, quiet + 1)
    return False


class _Task(Generic[T]):
    def __init__(self, work: Callable[[], T]) -> None:
        self.done = threading.Event()
        self._work = work
        self._result: list[T] = []
        self._error: BaseException | None = None

    def run(self) -> None:
        try:
            self._result.append(self._work())
        except BaseException as error:  # noqa: BLE001  raised again where it is waited for
            self._error = error
        self.done.set()

    def result(self) -> T:
        if self._error is not None:
            raise self._error
        return self._result[0]


class _Worker(threading.Thread):
    def __init__(self) -> None:
        super().__init__(name="dyknow-process", daemon=True)
        self._changed = threading.Condition()
        self._task: _Task[Any] | None = None
        self._left = False

    def take(self, task: _Task[Any]) -> None:
        with self._changed:
            self._task = task
            self._changed.notify()

    def leave(self) -> None:
        """End the thread after its present task."""
        with self._changed:
            self._left = True
            self._changed.notify()

    def run(self) -> None:
        while True:
            with self._changed:
                while self._task is None and not self._left:
                    self._changed.wait()
                if self._left:
                    return
                task, self._task = self._task, None
            if task is not None:
                task.run()
                del task  # free its samples
