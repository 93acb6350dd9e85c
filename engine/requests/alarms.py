"""Alarms: callbacks at times."""

from __future__ import annotations

import heapq
from collections.abc import Callable
from itertools import count


class Alarms:
    """Callbacks at times (ns); those of one time run in the order in which they were set. The
    caller passes the time to `ring`. Cost: O(log n) each."""

    def __init__(self) -> None:
        self._alarms: list[tuple[int, int, Callable[[int], None]]] = []
        """A heap."""
        self._serial = count()

    def at(self, time: int, act: Callable[[int], None]) -> None:
        """Call ``act`` with the present time once that is ``time`` or later."""
        heapq.heappush(self._alarms, (time, next(self._serial), act))

    def ring(self, now: int) -> None:
        """Run the callbacks that are due at ``now``."""
        while self._alarms and self._alarms[0][0] <= now:
            _, _, act = heapq.heappop(self._alarms)
            act(now)
