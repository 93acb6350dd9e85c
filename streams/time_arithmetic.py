"""Sums of times that stop at the ends of signed 64 bits instead of wrapping around (SPEC §1)."""

from __future__ import annotations

import numpy as np

from .sample import Times
from .time import TIME_MAX, TIME_MIN


def later(times: Times, duration: int) -> Times:
    """``times + duration``, at most `TIME_MAX`; ``duration`` ≥ 0. Shape kept."""
    latest = TIME_MAX - duration
    if latest < TIME_MIN:
        return np.full_like(times, TIME_MAX)
    # A sum that fits is right even of a duration that has wrapped around.
    step = np.int64(duration if duration <= TIME_MAX else duration - 2**64)
    if not len(times) or int(np.maximum.reduce(times)) <= latest:
        return times + step
    return np.where(times > latest, TIME_MAX, times + step)


def earlier(times: Times, duration: int) -> Times:
    """``times - duration``, at least `TIME_MIN`; ``duration`` ≥ 0. Shape kept."""
    if not len(times) or int(np.minimum.reduce(times)) >= TIME_MIN + duration:
        return times - np.int64(duration)
    return np.where(times < TIME_MIN + duration, TIME_MIN, times - np.int64(duration))


def since(times: Times, start: int) -> np.ndarray[tuple[int], np.dtype[np.uint64]]:
    """``times - start`` for times ≥ ``start``, which always fits in unsigned 64 bits."""
    base = np.uint64(start % 2**64)
    return times.astype(np.uint64) - base


def leaving(due: Times, previous: int, gap: int = 1) -> Times:
    """L_k = max(due_k, L_{k-1} + gap), after one that left at ``previous``; cut where time ends.
    ``gap`` is 0 or 1."""
    count = len(due)
    if not gap:
        return np.maximum.accumulate(np.maximum(due, max(previous, TIME_MIN)))
    if not count or previous >= TIME_MAX:
        return due[:0]
    if previous >= TIME_MIN:
        due = np.maximum(due, previous + 1)
    if int(due.min()) > TIME_MIN + count and max(int(due.max()), previous) < TIME_MAX - count:
        steps = np.arange(count)
        result: Times = np.maximum.accumulate(due - steps) + steps
        return result
    exact = []
    for moment in due.tolist():
        previous = max(moment, previous + 1)
        if previous > TIME_MAX:
            break
        exact.append(previous)
    return np.array(exact, np.int64)
