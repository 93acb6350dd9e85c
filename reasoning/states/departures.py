"""When the states of a formula, or the rows of a pattern, leave (SPEC §1, §8)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from ...streams.sample import Times
from ...streams.time import TIME_MAX, TIME_MIN
from ...streams.time_arithmetic import earlier, later

_NO_TIMES: Final = np.empty(0, np.int64)


@dataclass(frozen=True, slots=True, eq=False)
class Steps:
    """The states that leave once the samples before ``watermark`` (an available time) have come.

    States before ``reached[j]`` leave at ``moment[j]``, with the samples available up to it; shape
    ``(m,)``, both in order. With a ``delay``, each leaves that long after its time. ``before``: the
    time reached before.
    """

    watermark: int
    moment: Times
    reached: Times
    before: int
    delay: int | None = None

    @property
    def latest(self) -> int:
        """The time reached: states before it have left."""
        return int(self.reached[-1]) if len(self.reached) else self.before

    def left(self, due: Times) -> Times:
        """When the states of these times leave. Contract: they leave in these steps."""
        if self.delay is not None:
            return later(due, self.delay)
        return self.moment[self.reached.searchsorted(due, "right")]

    def reaching(self, times: Times) -> Times:
        """When these times are reached. Contract: they are, in these steps or before; those that
        were before are taken to be so at the first moment."""
        last = max(len(self.reached) - 1, 0)
        return self.moment[np.minimum(self.reached.searchsorted(times, "left"), last)]

    def reached_before(self, available: Times) -> Times:
        """The time that was reached when samples of these available times came."""
        if self.delay is not None:
            return earlier(available, self.delay)
        reached = np.empty(len(self.reached) + 1, np.int64)
        reached[0], reached[1:] = self.before, self.reached
        return np.asarray(reached[self.moment.searchsorted(available, "left")])


class Departures:
    """The time reached by ``sources`` streams, numbered from 0.

    With a ``max_delay`` D (ns), the state of time t leaves at the available time t + D. Without one
    the streams are taken to be in order of valid time, but for their ``lateness`` (ns, one a
    stream): reached is the least, of all streams, of the greatest valid time less that. A stream is
    not waited for after its end, which may be later than its last sample: that of a selection is
    the end of the whole stream. Nothing is reached before each of the others has a sample.

    Law (tests/laws/reasoning): the steps do not depend on batch cuts, nor on the order in which the
    streams deliver. Cost: a sort of the new samples.
    """

    def __init__(self, max_delay: int | None, sources: int, lateness: Sequence[int] = ()) -> None:
        self._delay = max_delay
        self._lateness = tuple(lateness) or (0,) * sources
        self._waiting: list[list[tuple[Times, Times]]] = [[] for _ in range(sources)]
        """The samples of each stream (available, valid) that are not before the watermark."""
        self._newest = [TIME_MIN] * sources
        """The greatest available time of each stream's samples before the watermark."""
        self._greatest = [TIME_MIN] * sources
        self._ended: dict[int, int] = {}
        """When each stream that has ended did so."""
        self._reached = TIME_MIN
        self.idle: frozenset[int] = frozenset()
        """Streams that have fallen silent, and are not waited for meanwhile."""

    def add(self, source: int, available: Times, valid: Times) -> None:
        """Take samples of a stream, in order of available time."""
        self._ended.pop(source, None)
        if self._delay is None:
            self._waiting[source].append((available, valid))

    def end(self, source: int, moment: int) -> None:
        """Wait for a stream no longer after the available time ``moment``, when it ended."""
        self._ended[source] = moment

    def advance(self, watermark: int, *, by_clock: bool) -> Steps:
        """Return the steps at the instants before ``watermark``; ``by_clock`` also the one there.
        Contract: every sample available before it was added."""
        if self._delay is not None:
            moment = np.array([watermark], np.int64)
            return Steps(watermark, moment, earlier(moment, self._delay), TIME_MIN, self._delay)
        due = [self._take_due(source, watermark) for source in range(len(self._waiting))]
        moments = _instants([available for available, _ in due if len(available)])
        if by_clock:
            moments = np.append(moments, watermark)
        reached = np.full(len(moments), TIME_MAX, np.int64)
        silent = self._ended.keys() | self.idle
        for source, (available, valid) in enumerate(due):
            # What the samples up to each moment, and earlier ones, have reached.
            greatest = np.empty(len(valid) + 1, np.int64)
            greatest[0], greatest[1:] = self._greatest[source], valid
            np.maximum.accumulate(greatest, out=greatest)
            known = earlier(
                greatest[available.searchsorted(moments, "right")], self._lateness[source]
            )
            if len(available):
                self._newest[source] = int(available[-1])
                self._greatest[source] = int(greatest[-1])
            if source in silent and not self._waiting[source]:
                last = self._ended.get(source, self._newest[source])
                known = np.where(moments > last, TIME_MAX, known)
            reached = np.minimum(reached, known)
        if len(silent) == len(self._waiting):
            # The last states leave at the end of all streams (`StateMaker.end`).
            reached = np.minimum(reached, max(self._greatest, default=TIME_MIN))
        # What was reached stays reached, also when a silent stream goes on behind it.
        reached = np.maximum.accumulate(np.maximum(reached, self._reached))
        steps = Steps(watermark, moments, reached, self._reached)
        self._reached = steps.latest
        return steps

    def _take_due(self, source: int, watermark: int) -> tuple[Times, Times]:
        """Remove the samples of a stream that are available before ``watermark``."""
        due, rest = [], []
        for available, valid in self._waiting[source]:
            cut = int(available.searchsorted(watermark, "left"))
            if cut:
                due.append((available[:cut], valid[:cut]))
            if cut < len(available):
                rest.append((available[cut:], valid[cut:]))
        self._waiting[source] = rest
        if len(due) < 2:
            return due[0] if due else (_NO_TIMES, _NO_TIMES)
        return np.concatenate([a for a, _ in due]), np.concatenate([v for _, v in due])


def _instants(parts: Sequence[Times]) -> Times:
    """The instants in all parts, each of which is in order; each instant once."""
    if not parts:
        return _NO_TIMES
    times = parts[0] if len(parts) == 1 else np.sort(np.concatenate(parts), kind="stable")
    if len(times) == 1:
        return times
    begins = np.ones(len(times), np.bool_)
    np.not_equal(times[1:], times[:-1], out=begins[1:])
    return times[begins]
