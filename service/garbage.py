"""The garbage collector looks at what is new, and now and then at everything.

A collection that looks at a million objects lets everybody wait for half a second, and Python has
one whenever a quarter more are there. So what has outlived one is left alone (`gc.freeze`): the
next looks at what has come since, some 70,000 objects. What goes later is freed all the same when
nobody refers to it any more; but not where it refers to itself. For that everything is looked at
after five minutes, and, as long as next to nothing is found, after twice as long each time.
"""

from __future__ import annotations

import gc
import time
from collections.abc import Callable, Mapping
from typing import Any, Final

FIRST: Final = 300.0
"""Seconds until everything is looked at."""
LONGEST: Final = 24 * 3600.0
"""And at most."""
FEW: Final = 10_000
"""So many objects of garbage were not worth it: some megabytes."""


class Garbage:
    """The policy of a process. ``clock`` gives seconds."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._interval = FIRST
        self._due = float("inf")

    def begin(self) -> None:
        """From now on."""
        self._due = self._clock() + self._interval
        gc.callbacks.append(self._noted)

    def end(self) -> None:
        """As Python does it again."""
        gc.callbacks.remove(self._noted)
        gc.unfreeze()

    def review(self) -> None:
        """Look at everything, if it is time."""
        if self._clock() < self._due:
            return
        gc.unfreeze()
        found = gc.collect()
        self._interval = FIRST if found > FEW else min(2 * self._interval, LONGEST)
        self._due = self._clock() + self._interval

    def _noted(self, phase: str, info: Mapping[str, Any]) -> None:
        if phase == "stop" and info["generation"] == 2:
            gc.freeze()
