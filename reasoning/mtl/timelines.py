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

    ``begin`` and ``end`` have shape ``(n,)``: the first row, and the row after the last one.
    ``first`` and ``is_whole`` have one entry a timeline: its first row, and whether no state before
    this was dropped.
    """

    first: NDArray[np.int64]
    begin: NDArray[np.int64]
    end: NDArray[np.int64]
    is_whole: Mask

    @classmethod
    def one(cls, rows: int) -> Timelines:
        """All rows are of one timeline, from its first state on."""
        return cls.of(np.zeros(rows, np.int64), np.array([rows]))

    @classmethod
    def of(cls, part: NDArray[np.int64], states_of: NDArray[np.int64]) -> Timelines:
        """``part``: the number of each row's timeline, in order; ``states_of``: how many states
        each timeline has had."""
        count = len(part)
        if count and part[0] == part[-1]:
            # One timeline needs no search.
            begin = np.zeros(count, np.int64)
            return cls(begin[:1], begin, np.full(count, count), states_of[part[:1]] == count)
        first = np.flatnonzero(np.diff(part, prepend=-1))
        size = np.diff(first, append=count)
        begin = np.repeat(first, size)
        return cls(first, begin, begin + np.repeat(size, size), states_of[part[first]] == size)

    def places(self, times: Times, limits: Times, *, after: bool) -> NDArray[np.int64]:
        """Return the first row of each state's timeline whose time is not before the state's limit,
        or with ``after`` is after it; that after the last one if there is none. Times and limits
        are in order in a timeline. Cost: O(n)."""
        return windows.places(times, limits, self.begin, self.end, after=after)
