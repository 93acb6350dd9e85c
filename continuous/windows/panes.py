"""The panes that contain rows: enough to decide which evaluations have content."""

from __future__ import annotations

from bisect import bisect_left, bisect_right, insort

import numpy as np
from numpy.typing import NDArray

from .grid import Grid


class Panes:
    """The panes of a window that have received a row, by their ends.

    Each bound of the window is the end of a pane ``(end - step, end]``. So the panes alone tell
    whether a window has content. ``low``: rows up to here do not count. Memory: an integer per pane
    in the window. Cost: a few numpy calls per push.
    """

    def __init__(self, grid: Grid, low: int) -> None:
        self.grid = grid
        self.low = low
        self._ends: list[int] = []
        self._last: int | None = None
        """The greatest end that has been dropped."""

    def __len__(self) -> int:
        return len(self._ends)

    def push(self, times: NDArray[np.int64], least: int, greatest: int) -> None:
        """Mark the panes of rows with these times, from ``least`` to ``greatest``."""
        if least <= self.low:
            times = times[times > self.low]
            if not len(times):
                return
            least = int(times.min())
        first, last = self.grid.ceil(least), self.grid.ceil(greatest)
        if first == last:
            self._mark(first)
            return
        step, origin = self.grid.step, self.grid.origin
        for end in np.unique(times + (origin - times) % step).tolist():
            self._mark(end)

    def _mark(self, end: int) -> None:
        ends = self._ends
        if not ends or end > ends[-1]:
            ends.append(end)
        elif ends[bisect_left(ends, end)] != end:
            insort(ends, end)

    def first_after(self, bound: int) -> int | None:
        """Return the end of the first pane after ``bound`` that has a row."""
        at = bisect_right(self._ends, bound)
        return self._ends[at] if at < len(self._ends) else None

    def last_until(self, bound: int) -> int | None:
        """Return the end of the last pane up to ``bound`` that has had a row, dropped panes
        included."""
        at = bisect_right(self._ends, bound)
        return self._ends[at - 1] if at else self._last

    def between(self, low: int, high: int) -> list[int]:
        """Return the ends in ``(low, high]`` of panes that have a row, ascending."""
        ends = self._ends
        return ends[bisect_right(ends, low) : bisect_right(ends, high)]

    def drop(self, until: int) -> None:
        """Drop the panes that end at or before ``until``."""
        at = bisect_right(self._ends, until)
        if at:
            # `Contents.compare` asks for the last pane of earlier content after its rows are gone.
            self._last = self._ends[at - 1]
            del self._ends[:at]
