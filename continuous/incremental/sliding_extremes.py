"""Sliding extremes: a minimum cannot be subtracted, so panes keep the values that they replaced.

There are two stacks of panes, updated in place by group. The *front* has the older panes: `suffix`
is the least value over all of them. Each pane stores `suffix` without it and all older panes, so
evicting it restores that. The *back* has the newer panes and their least value so far. A new front
is built from the back, newest pane first. This happens ahead of time, two panes per push (the
*middle*), so that no single window pays for all of them (as in DABA, Tangwongsan, Hirzel, Schneider
2017).
"""

from __future__ import annotations

from collections import deque
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..columns.exact_sums import At

Ends = NDArray[Any]
"""The least value and the least mirrored value by group, shape ``(n, 2)``, float64 or int64."""
_Pane = tuple[int, At, Ends]


class SlidingExtremes:
    """The least and the greatest value of each group in the window.

    ``panes``: the greatest number of panes in a window. Law: `ends` are the extremes over all panes
    pushed and not evicted. Cost: O(touched groups) for a push, twice that to prepare a front, and
    O(expired groups) for an eviction; O(groups) each half window. Memory: two numbers per touched
    group and pane, eight per group.
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
        """Add the extremes of the next pane, for the groups ``at`` (ascending, each once)."""
        self._back.append((end, at, ends))
        _lower(self._back_least, at, ends)
        if not self._middle and not self._front:
            self._promote()
        # The next front begins half a window ahead, so that two panes a push prepare it in time.
        if not self._middle and not self._turned and len(self._back) >= self._half:
            self._set_aside()
        self._prepare_front(2)

    def evict(self, until: int) -> list[At]:
        """Evict the panes that end at or before ``until``; return the groups of each."""
        evicted: list[At] = []
        while True:
            while self._front and self._front[-1][0] <= until:
                _, at, before = self._front.pop()
                self._suffix[slice(len(before)) if at is None else at] = before
                evicted.append(at)
            if self._front:
                return evicted
            if not (self._middle or self._turned):
                if not self._back or self._back[0][0] > until:
                    return evicted
                self._set_aside()
            # The oldest pane stays, so the next front need not be ready yet.
            if self._middle and self._middle[0][0] > until:
                return evicted
            # Panes of the middle can leave through a front only, so it has to be ready now.
            self._prepare_front(len(self._middle))
            self._promote()

    def ends(self, rows: NDArray[np.int64]) -> Ends:
        """Return the extremes of the groups ``rows``."""
        found = np.minimum(self._suffix[rows], self._back_least[rows])
        if self._middle or self._turned:
            found = np.minimum(found, self._middle_least[rows])
        return found

    def reserve(self, groups: int) -> None:
        """Allocate space for ``groups`` groups."""
        if self._capacity < groups:
            self._capacity = max(groups, 2 * self._capacity, 64)
            for name in ("_suffix", "_next_suffix", "_middle_least", "_back_least"):
                wider = self.nothing(self._capacity)
                wider[: len(getattr(self, name))] = getattr(self, name)
                setattr(self, name, wider)

    def keep(self, kept: NDArray[np.int64], new: NDArray[np.int32]) -> None:
        """Drop all groups except ``kept`` (ascending); group g becomes ``new[g]``."""

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

    def _prepare_front(self, panes: int) -> None:
        """Move up to this number of panes from the middle to the next front, newest first."""
        for _ in range(min(panes, len(self._middle))):
            end, at, ends = self._middle.pop()
            where = slice(len(ends)) if at is None else at
            before = self._next_suffix[where].copy()
            self._next_suffix[where] = np.minimum(before, ends)
            self._turned.append((end, at, before))

    def _promote(self) -> None:
        """Make the middle the front, after `_prepare_front` of all its panes."""
        if self._turned:
            self._front, self._turned = self._turned, []
            self._suffix, self._next_suffix = self._next_suffix, self._suffix
            self._next_suffix[:] = self._nothing
            self._middle_least[:] = self._nothing

    def _set_aside(self) -> None:
        """Make the back the middle."""
        self._middle, self._back = list(self._back), deque()
        self._middle_least, self._back_least = self._back_least, self._middle_least

    def nothing(self, groups: int) -> Ends:
        """Return the extremes of no rows."""
        return np.full((groups, 2), self._nothing)


def _lower(least: Ends, at: At, ends: Ends) -> None:
    if at is None:
        part = least[: len(ends)]
        np.minimum(part, ends, out=part)
    else:
        least[at] = np.minimum(least[at], ends)
