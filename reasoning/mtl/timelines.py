"""How the states of several timelines stand in one table."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...streams.sample import Mask, Times
from . import windows


@dataclass(frozen=True, slots=True, eq=False)
class Timelines:
    """The rows of each state's own timeline, which are one after the other, in order of time.

    Shape ``(n,)``: the first row, the row after the last one, and whether no state before the first
    was dropped.
    """

    begin: NDArray[np.int64]
    end: NDArray[np.int64]
    is_whole: Mask

    @classmethod
    def one(cls, rows: int) -> Timelines:
        """All rows are of one timeline, from its first state on."""
        return cls.of(np.zeros(rows, np.int64), np.arange(rows))

    @classmethod
    def of(cls, part: NDArray[np.int64], index: NDArray[np.int64]) -> Timelines:
        """``part``: the number of each row's timeline, in order; ``index``: the number of its state
        in it."""
        first = np.flatnonzero(np.diff(part, prepend=-1))
        size = np.diff(first, append=len(part))
        begin = np.repeat(first, size)
        return cls(begin, begin + np.repeat(size, size), index[begin] == 0)

    @property
    def first(self) -> NDArray[np.int64]:
        """The first row of each timeline."""
        return np.flatnonzero(self.begin == np.arange(len(self.begin)))

    def places(self, times: Times, limits: Times, *, after: bool) -> NDArray[np.int64]:
        """Return the first row of each state's timeline whose time is not before the state's limit,
        or with ``after`` is after it; that after the last one if there is none. Times and limits
        are in order in a timeline. Cost: O(n)."""
        return windows.places(times, limits, self.begin, self.end, after=after)
