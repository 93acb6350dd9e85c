"""Searches in the valid times of states, for compiled loops.

Differences are unsigned: the difference of two times in order fits 64 bits so.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from ...streams.time import TIME_MAX
from .programs import NO_END


def is_later(valid: Any, row: Any, other: Any, gap: Any) -> Any:
    """Whether ``other`` is valid at least ``gap`` after ``row``, which is not later."""
    return np.uint64(valid[other] - valid[row]) >= np.uint64(gap)


def is_near(valid: Any, row: Any, other: Any, end: Any) -> Any:
    """Whether ``other`` is valid at most ``end`` after ``row``, which is not later."""
    return end == NO_END or np.uint64(valid[other] - valid[row]) <= np.uint64(end)


def ahead(valid: Any, row: Any, gap: Any, count: Any) -> Any:
    """The first row that is valid at least ``gap`` after ``row``; ``count`` if there is none."""
    if gap == 0:
        return row
    low, step = row, 1
    while low + step < count and not is_later(valid, row, low + step, gap):
        low += step
        step *= 2
    # ``low`` is not so late; ``high`` is, or it is the end.
    high = min(low + step, count)
    while high - low > 1:
        middle = (low + high) >> 1
        if is_later(valid, row, middle, gap):
            high = middle
        else:
            low = middle
    return high


def behind(valid: Any, row: Any, gap: Any) -> Any:
    """The row after the last one that is valid at least ``gap`` before ``row``; 0 if there is
    none."""
    if gap == 0:
        return row + 1
    high, step = row, 1
    while high - step >= 0 and not is_later(valid, high - step, row, gap):
        high -= step
        step *= 2
    low = max(high - step, -1)
    while high - low > 1:
        middle = (low + high) >> 1
        if is_later(valid, middle, row, gap):
            low = middle
        else:
            high = middle
    return high


def reach(valid: Any, row: Any, end: Any, count: Any) -> Any:
    """The row after the last one that is valid at most ``end`` after ``row``."""
    return count if end == NO_END else ahead(valid, row, end + 1, count)


def back(valid: Any, row: Any, end: Any) -> Any:
    """The first row that is valid at most ``end`` before ``row``."""
    return 0 if end == NO_END else behind(valid, row, end + 1)


def is_over(valid: Any, row: Any, end: Any, horizon: Any) -> Any:
    """Whether no later state is valid up to ``end`` after ``row``."""
    if horizon == TIME_MAX:
        return True
    return end != NO_END and np.uint64(horizon - valid[row]) >= np.uint64(end)


SEARCHES: Final = is_later, is_near, ahead, behind, reach, back, is_over
"""For `Kernel`, which compiles them into the loops that call them."""
