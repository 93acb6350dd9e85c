"""How long units work: each one's own time, without that of units that its output sets to work.

The engine reads no clock; whoever runs it gives it a stopwatch, or does not want to know.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

Stopwatch = Callable[[], int]
"""Nanoseconds since some moment; never less than before."""


class Busy(Protocol):
    """Whose time is measured."""

    busy: int


class BusyTime:
    """Measures the work of all units of an engine, which is nested: a unit's output calls the next.

    Law (tests/engine): the times of all units add up to the time of the outermost works. Cost: two
    looks at the stopwatch a call.
    """

    def __init__(self, stopwatch: Stopwatch) -> None:
        self._stopwatch = stopwatch
        self._within = 0
        """What the works took that the present one has set to work."""

    def run(self, unit: Busy, work: Callable[[], None]) -> None:
        """Do ``work``; what it takes, less what others take meanwhile, is the unit's ``busy``."""
        outer, self._within = self._within, 0
        begin = self._stopwatch()
        try:
            work()
        finally:
            took = self._stopwatch() - begin
            unit.busy += took - self._within
            self._within = outer + took
