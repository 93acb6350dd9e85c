"""Sums of times that stop at the ends of signed 64 bits instead of wrapping around (SPEC §1)."""

from __future__ import annotations

import numpy as np

from .sample import Times
from .time import TIME_MAX, TIME_MIN


def later(times: Times, duration: int) -> Times:
    """``times + duration``, at most `TIME_MAX`; ``duration`` ≥ 0. Shape kept."""
    return np.where(times > TIME_MAX - duration, TIME_MAX, times + np.int64(duration))


def earlier(times: Times, duration: int) -> Times:
    """``times - duration``, at least `TIME_MIN`; ``duration`` ≥ 0. Shape kept."""
    return np.where(times < TIME_MIN + duration, TIME_MIN, times - np.int64(duration))


def since(times: Times, start: int) -> np.ndarray[tuple[int], np.dtype[np.uint64]]:
    """``times - start`` for times ≥ ``start``, which always fits in unsigned 64 bits."""
    base = np.uint64(start % 2**64)
    return times.astype(np.uint64) - base
