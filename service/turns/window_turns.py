"""Closing windows a little at a time, so that nobody waits for a query that takes long.

A task closes the windows of one unit as a fiber, in turns with the event loop's thread (`fibers`).
Where a window may be interrupted (`streams.yield_points`) it pauses when its time is over.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Final

from ...continuous.columns.budget import Stopped
from .fibers import Fiber, Fibers

FIRST: Final = 0.01
"""Seconds for what a request has brought about, before it is answered."""


class Pausing(Fibers):
    """`Turns` for an engine and `Pauses` for the windows of its units.

    ``seconds``: how much processor time one window may take; ``most``: and a unit until it has
    caught up.
    """

    def __init__(self, seconds: float, most: float) -> None:
        super().__init__("dyknow-windows")
        self.most = most
        self._seconds = seconds

    def begin(self, close_next: Callable[[], bool], telling: float = 0.0) -> _Task:
        """See `Turns`."""
        return _Task(self, close_next, telling)

    def timed(self, what: Callable[[], None]) -> float:
        """See `Turns`."""
        begun = time.thread_time()
        what()
        return time.thread_time() - begun

    def check(self, spent: float) -> None:
        """Raises `Stopped` where a window has taken too long."""
        if spent > self._seconds:
            raise Stopped(
                f"it took more than {self._seconds:g} s of processor time (DYKNOW_QUERY_SECONDS)"
            )


class _Task(Fiber):
    """See `engine.units.backlog.Task`. With ``to_end`` it goes on until the present window has
    closed, and begins no other."""

    def __init__(self, pausing: Pausing, close_next: Callable[[], bool], telling: float) -> None:
        super().__init__(pausing, self._close)
        self._pausing = pausing
        self._close_next = close_next
        self._telling = telling
        self._is_last = False
        self._begun = self._began = 0.0
        """Processor time of the thread when the first and the present window began."""
        self._waited = 0.0
        """Seconds that another process worked for it."""
        self.spent = 0.0
        """See `engine.units.backlog.Task`."""

    def end(self) -> None:
        """See `engine.units.backlog.Task`."""
        self._is_last = True

    # -- in its own thread -------------------------------------------------------------------

    def _close(self) -> None:
        """Close windows until there are no more, or what is left of the time is needed to tell what
        they gave."""
        self._begun = time.thread_time()
        to_tell = 0.0
        try:
            while True:
                self._began = time.thread_time()
                found = self._close_next()
                self._count()
                to_tell += self._telling
                is_over = self._pausing.left <= to_tell
                if not found or self._to_end or self._is_last or is_over:
                    break
        finally:
            self._count()

    def breathe(self) -> None:
        """See `Pauses`."""
        if self._is_apart:
            return
        self._pausing.check(time.thread_time() - self._began)
        self._count()
        super().breathe()

    @contextmanager
    def apart(self, waits: bool) -> Iterator[None]:
        """See `Pauses`."""
        begun = time.monotonic()
        with super().apart(waits):
            try:
                yield
            finally:
                if waits:
                    self._waited += time.monotonic() - begun

    def _count(self) -> None:
        self.spent = time.thread_time() - self._begun + self._waited
