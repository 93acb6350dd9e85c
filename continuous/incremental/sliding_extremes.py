"""Sliding extremes: what cannot be subtracted is taken back from a record of what it replaced.

Two stacks, by group and in place. The *front* are the older panes: `suffix` is the least value over
all of them, and each pane keeps what `suffix` was without it and all older ones, so that its end
puts that back. The *back* are the newer panes and their least value so far. A front is made of a
back newest first; that is done ahead of time, two panes a push (the *middle*), so that no window
pays for all of them at once (as DABA does, Tangwongsan, Hirzel, Schneider 2017).
"""

from __future__ import annotations

from collections import deque
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..columns.exact_sums import At

Ends = NDArray[Any]
"""The least value and the least mirrored one by group, shape ``(n, 2)``, float64 or int64."""
_Pane = tuple[int, At, Ends]


class SlidingExtremes:
    """The least and the greatest value of each group in the window.

    ``panes`` is how many a window has at most. Law: `ends` are the extremes over all panes pushed
    and not evicted. Cost: O(touched groups) for a push, twice that for turning panes around, and
    O(expired) for an eviction; O(groups) each half window. Memory: two numbers a touched group and
    pane, eight a group.
    """

    def __init__(self, dtype: np.dtype[Any], panes: int) -> None:
        self._nothing = np.array(np.inf if dtype == np.float64 else 2**63 - 1, dtype)
        self._half = max(1, panes // 2)
        self._capacity = 0
        self._front: list[_Pane] = []
        self._middle: list[_Pane] = []
        self._turned: list[_Pane] = []
        self._back: deque[_Pane] = deque()
        self._suffix = self.nothing(self._capacity)
        self._next_suffix = self.nothing(self._capacity)
        self._middle_least = self.nothing(self._capacity)
        self._back_least = self.nothing(self._capacity)

    def push(self, end: int, at: At, ends: Ends) -> None:
        """The extremes of the next pane, for the groups ``at`` (ascending, each once)."""
        self._back.append((end, at, ends))
        _lower(self._back_least, at, ends)
        if not self._middle and not self._front:
            self._promote()
        if not self._middle and not self._turned and len(self._back) >= self._half:
            self._set_aside()
        self._turn(2)

    def evict(self, until: int) -> list[At]:
        """Forget the panes that end at or before ``until``: the groups of each."""
        forgotten: list[At] = []
        while True:
            while self._front and self._front[-1][0] <= until:
                _, at, before = self._front.pop()
                self._suffix[slice(len(before)) if at is None else at] = before
                forgotten.append(at)
            if self._front:
                return forgotten
            if not (self._middle or self._turned):
                if not self._back or self._back[0][0] > until:
                    return forgotten
                self._set_aside()
            if self._middle and self._middle[0][0] > until:
                return forgotten
            self._turn(len(self._middle))
            self._promote()

    def ends(self, rows: NDArray[np.int64]) -> Ends:
        """The extremes of the groups ``rows``."""
        found = np.minimum(self._suffix[rows], self._back_least[rows])
        if self._middle or self._turned:
            found = np.minimum(found, self._middle_least[rows])
        return found

    def reserve(self, groups: int) -> None:
        """Make room for ``groups`` groups."""
        if self._capacity < groups:
            self._capacity = max(groups, 2 * self._capacity, 64)
            for name in ("_suffix", "_next_suffix", "_middle_least", "_back_least"):
                wider = self.nothing(self._capacity)
                wider[: len(getattr(self, name))] = getattr(self, name)
                setattr(self, name, wider)

    def keep(self, kept: NDArray[np.int64], new: NDArray[np.int32]) -> None:
        """Forget all groups but ``kept`` (ascending); group g becomes ``new[g]``."""

        def renamed(pane: _Pane) -> _Pane:
            end, at, ends = pane
            return (end, None, ends[kept[kept < len(ends)]]) if at is None else (end, new[at], ends)

        self.reserve(int(kept.max(initial=-1)) + 1)
        self._front = [renamed(pane) for pane in self._front]
        self._middle = [renamed(pane) for pane in self._middle]
        self._turned = [renamed(pane) for pane in self._turned]
        self._back = deque(renamed(pane) for pane in self._back)
        self._capacity = len(kept)
        for name in ("_suffix", "_next_suffix", "_middle_least", "_back_least"):
            setattr(self, name, getattr(self, name)[kept])

    def _turn(self, panes: int) -> None:
        """Turn so many panes of the middle around, newest first."""
        for _ in range(min(panes, len(self._middle))):
            end, at, ends = self._middle.pop()
            where = slice(len(ends)) if at is None else at
            before = self._next_suffix[where].copy()
            self._next_suffix[where] = np.minimum(before, ends)
            self._turned.append((end, at, before))

    def _promote(self) -> None:
        """The middle, all turned, becomes the front."""
        if self._turned:
            self._front, self._turned = self._turned, []
            self._suffix, self._next_suffix = self._next_suffix, self._suffix
            self._next_suffix[:] = self._nothing
            self._middle_least[:] = self._nothing

    def _set_aside(self) -> None:
        """The back becomes the middle."""
        self._middle, self._back = list(self._back), deque()
        self._middle_least, self._back_least = self._back_least, self._middle_least

    def nothing(self, groups: int) -> Ends:
        """The extremes of no rows."""
        return np.full((groups, 2), self._nothing)


def _lower(least: Ends, at: At, ends: Ends) -> None:
    if at is None:
        part = least[: len(ends)]
        np.minimum(part, ends, out=part)
    else:
        least[at] = np.minimum(least[at], ends)
