"""The time that each unit works, without the time of the units that read its output.

The engine reads no clock: the service gives it a stopwatch, and without one nothing is measured.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

Stopwatch = Callable[[], int]
"""Returns nanoseconds since some moment; the value never decreases."""


class Busy(Protocol):
    """An object whose working time is measured."""

    busy: int


class BusyTime:
    """Measures the work of all units of an engine. It is nested: a unit's output calls the next
    unit.

    Law (tests/engine): the times of all units add up to the time of the outermost calls. Cost: two
    readings of the stopwatch a call.
    """

    def __init__(self, stopwatch: Stopwatch) -> None:
        self._stopwatch = stopwatch
        self._within = 0
        """The time of the nested calls within the present one."""

    def run(self, unit: Busy, work: Callable[[], None]) -> None:
        """Do ``work``, and add its time without nested calls to the unit's ``busy``."""
        outer, self._within = self._within, 0
        begin = self._stopwatch()
        try:
            work()
        finally:
            took = self._stopwatch() - begin
            unit.busy += took - self._within
            self._within = outer + took
