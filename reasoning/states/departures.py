"""When the states of a formula leave: the time reached after each instant (SPEC §1, §8)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from ...streams.policies.policy import SynchronizationPolicy
from ...streams.sample import Times
from ...streams.time import TIME_MAX, TIME_MIN
from ...streams.time_arithmetic import earlier

_NO_TIMES: Final = np.empty(0, np.int64)


@dataclass(frozen=True, slots=True, eq=False)
class Steps:
    """Some available times in order, shape ``(m,)``, and the time reached at each: states before
    ``reached[j]`` leave at ``moment[j]``, with the samples available before it."""

    moment: Times
    reached: Times


class Departures:
    """The time reached by ``sources`` streams, numbered from 0. A stream that ends is waited for up
    to its last sample.

    With a ``max_delay`` D, time t - D is reached at the available time t. Without one the streams
    are taken to be in order of valid time: reached is the least of the greatest valid times of the
    streams that have not ended. Nothing is reached before each of these has a sample.

    Law (tests/laws/reasoning): the steps do not depend on batch cuts, nor on the order in which the
    streams deliver. Cost: a sort of the new samples.
    """

    def __init__(self, policy: SynchronizationPolicy, sources: int) -> None:
        self._delay = policy.max_delay
        self._waiting: list[list[tuple[Times, Times]]] = [[] for _ in range(sources)]
        """The samples of each stream (available, valid) that are not before the last moment."""
        self._greatest = [TIME_MIN] * sources
        self._ended: set[int] = set()
        self.idle: frozenset[int] = frozenset()
        """Streams that have fallen silent, and are not waited for meanwhile."""

    def add(self, source: int, available: Times, valid: Times) -> None:
        """Take samples of a stream, in order of available time."""
        self._waiting[source].append((available, valid))
        self._ended.discard(source)

    def end(self, source: int) -> None:
        """Wait no longer for a stream."""
        self._ended.add(source)

    def advance(self, watermark: int) -> Steps:
        """Return the steps at the instants before ``watermark``, and the one there. Contract: every
        sample available before it was added."""
        due = [_split(parts, watermark) for parts in self._waiting]
        self._waiting = [[rest] if len(rest[0]) else [] for _, rest in due]
        instants = np.unique(np.concatenate([a for (a, _), _ in due] or [_NO_TIMES]))
        moments = np.append(instants, watermark)
        if self._delay is not None:
            return Steps(moments, earlier(moments, self._delay))
        reached = np.full(len(moments), TIME_MAX, np.int64)
        silent = self._ended | self.idle
        for source, ((available, valid), _) in enumerate(due):
            # What the samples before each moment, and earlier ones, have reached.
            greatest = np.maximum.accumulate(np.append(self._greatest[source], valid))
            self._greatest[source] = int(greatest[-1])
            place = np.searchsorted(available, moments, "left")
            known = greatest[place]
            if source in silent and not self._waiting[source]:
                known = np.where(place == len(available), TIME_MAX, known)
            reached = np.minimum(reached, known)
        if len(silent) == len(self._waiting):
            # The last states leave at the end of all streams (`StateMaker.end`).
            reached = np.minimum(reached, max(self._greatest, default=TIME_MIN))
        return Steps(moments, reached)


def _split(
    parts: list[tuple[Times, Times]], watermark: int
) -> tuple[tuple[Times, Times], tuple[Times, Times]]:
    """The samples available before ``watermark``, and the others."""
    if not parts:
        return (_NO_TIMES, _NO_TIMES), (_NO_TIMES, _NO_TIMES)
    available = np.concatenate([a for a, _ in parts])
    valid = np.concatenate([v for _, v in parts])
    cut = int(np.searchsorted(available, watermark, "left"))
    return (available[:cut], valid[:cut]), (available[cut:], valid[cut:])
