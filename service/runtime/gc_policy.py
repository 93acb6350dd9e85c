"""The garbage collector looks at what is new, and now and then at everything.

A collection that looks at a million objects lets everybody wait for half a second, and Python has
one whenever a quarter more are there. So what has outlived one that took long is left alone
(`gc.freeze`): the next looks at what has come since. What goes later is freed all the same when
nobody refers to it any more; but not where it refers to itself, as what parsers make does. For that
everything is looked at after a thousand times as long as that takes, half a minute at least, and,
as long as next to nothing is found, after twice as long each time. In a service with little in it
collections are quick, and nothing is left alone but what was there at the start (`warm_up`).
"""

from __future__ import annotations

import gc
import time
from collections.abc import Callable, Mapping
from typing import Any, Final

LEAST: Final = 30.0
"""Seconds until everything is looked at, at least."""
SHARE: Final = 1000.0
"""And so many times as long as it takes to look."""
LONGEST: Final = 24 * 3600.0
"""And at most."""
FEW: Final = 10_000
"""So many objects of garbage were not worth it: some megabytes."""


SLOW: Final = 0.02
"""Seconds that a collection may take before what it has looked at is left alone."""


class Garbage:
    """The policy of a process. ``clock`` gives seconds; ``slow`` as `SLOW`."""

    def __init__(self, clock: Callable[[], float] = time.monotonic, slow: float = SLOW) -> None:
        self._clock = clock
        self._slow = slow
        self._interval = LEAST
        self._due = float("inf")
        """When everything is looked at; never, while nothing is left alone."""
        self._begun = 0.0

    def begin(self) -> None:
        """From now on."""
        gc.callbacks.append(self._noted)

    def end(self) -> None:
        """As Python does it again."""
        gc.callbacks.remove(self._noted)
        gc.unfreeze()

    def review(self) -> None:
        """Look at everything, if it is time."""
        if self._clock() < self._due:
            return
        self._due = float("inf")
        gc.unfreeze()
        begun = self._clock()
        found = gc.collect()
        least = max(LEAST, SHARE * (self._clock() - begun))
        self._interval = least if found > FEW else max(least, min(2 * self._interval, LONGEST))
        if self._due < float("inf"):
            self._due = self._clock() + self._interval

    def _noted(self, phase: str, info: Mapping[str, Any]) -> None:
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
