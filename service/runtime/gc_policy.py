"""A schedule for Python's cyclic garbage collector, so that full collections are short.

A full collection of a million objects holds up the event loop for half a second, and Python starts
one whenever a quarter more objects exist. So after each slow full collection the schedule excludes
the survivors from later ones (`gc.freeze`): the next examines newer objects only. Reference counts
still free the excluded objects, but not those in cycles, as parsers make them. Therefore a complete
collection examines all objects, after 1,000 times its own duration, at least 30 s; the interval
doubles while it finds little. A small service has quick collections, and only the objects of
the start are excluded (warm_up).

bench/queries/collector.py measures an engine in use with 2,000 streams and 1,100 requests, 560,000
objects. A full collection takes up to 44 ms of processor time with the schedule, 257 ms without it;
all full collections of 1,000 rounds take 0.2 s and 1.3 s. Called by `Service.tick`.
"""

from __future__ import annotations

import gc
import time
from collections.abc import Callable, Mapping
from typing import Any, Final

LEAST: Final = 30.0
"""Seconds before a complete collection, at least."""
SHARE: Final = 1000.0
"""The same, as a multiple of the duration of the last one."""
LONGEST: Final = 24 * 3600.0
"""The same, at most."""
FEW: Final = 10_000
"""Garbage objects of a complete collection, some megabytes, that do not justify the next one
soon."""
SLOW: Final = 0.02
"""Seconds that a full collection may take before its survivors are excluded."""


class CollectionSchedule:
    """The schedule of a process. ``clock`` returns seconds; ``slow`` as `SLOW`."""

    def __init__(self, clock: Callable[[], float] = time.monotonic, slow: float = SLOW) -> None:
        self._clock = clock
        self._slow = slow
        self._interval = LEAST
        self._due = float("inf")
        """The time of the next complete collection; infinite while no objects are excluded."""
        self._begun = 0.0

    def begin(self) -> None:
        """Watch the collections of this process from now on."""
        gc.callbacks.append(self._after_collection)

    def end(self) -> None:
        """Leave the collector as Python has it."""
        gc.callbacks.remove(self._after_collection)
        gc.unfreeze()

    def review(self) -> None:
        """Do a complete collection if it is due."""
        if self._clock() < self._due:
            return
        self._due = float("inf")
        gc.unfreeze()
        begun = self._clock()
        found = gc.collect()
        least = max(LEAST, SHARE * (self._clock() - begun))
        self._interval = least if found > FEW else max(least, min(2 * self._interval, LONGEST))
        # `_after_collection` has set it if the collection was slow.
        if self._due < float("inf"):
            self._due = self._clock() + self._interval

    def _after_collection(self, phase: str, info: Mapping[str, Any]) -> None:
        """Exclude the survivors of a full collection that was slow (`gc.callbacks`)."""
        if info["generation"] != 2:
            return
        now = self._clock()
        if phase == "start":
            self._begun = now
        elif now - self._begun >= self._slow:
            gc.freeze()
            if self._due == float("inf"):
                self._interval = max(self._interval, SHARE * (now - self._begun))
                self._due = now + self._interval
