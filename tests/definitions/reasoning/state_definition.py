"""The definition of the states of a formula (SPEC §1, §8), in plain lists of samples.

Slow on purpose; shares nothing with the product.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import TypeAlias

LEAST, GREATEST = -(2**63), 2**63 - 1
Moment: TypeAlias = tuple[int, int]
"""An available time, and 1 after the samples of that instant, 0 before them (by the clock)."""


@dataclass(frozen=True)
class Sample:
    """``term``: a feature, and for each argument a sort, or an object in angle brackets.
    ``objects``: one for each argument."""

    source: int
    term: tuple[str, tuple[str, ...]]
    available: int
    valid: int
    objects: tuple[str, ...]
    value: object


@dataclass(frozen=True)
class State:
    """``present``: (sort, object). ``values``: those that are known, by term and objects."""

    valid: int
    left: int
    present: set[tuple[str, str]]
    values: dict[tuple[tuple[str, tuple[str, ...]], tuple[str, ...]], object]
    moment: Moment | None = field(default=None, compare=False)
    """That of ``left``."""


@dataclass
class StateDefinition:
    """``samples``: those of one source in order of arrival. ``ended``: when each source ended, with
    its last sample or later; None: it has not. ``watermark``: every sample available before it has
    come."""

    samples: list[Sample]
    ended: list[int | None]
    watermark: int
    delay: int | None
    period: int | None
    start: int | None
    end: int | None
    uses_most_recent: bool
    present_for: int | None
    wider: Mapping[str, tuple[str, ...]]
    """The sorts that include a sort."""

    def moments(self) -> list[Moment]:
        """When states may leave: with a sample."""
        return sorted({(s.available, 1) for s in self.before_watermark()})

    def reached(self, moment: Moment) -> int:
        """The time reached at a moment: states before it have left."""
        time, is_instant = moment
        if self.delay is not None:
            # The state of t leaves at t + delay, with the samples of that instant.
            return time - self.delay + is_instant
        found = GREATEST
        for source, end in enumerate(self.ended):
            own = [s for s in self.samples if s.source == source]
            if end is None or time <= end:
                before = (s.valid for s in own if (s.available, 1) <= moment)
                found = min(found, max(before, default=LEAST))
        if None not in self.ended:
            known = (s.valid for s in self.samples if (s.available, 1) <= moment)
            found = min(found, max(known, default=LEAST))
        return found

    def left(self, t: int) -> Moment | None:
        """When the state of time t leaves; None if it has not."""
        if self.delay is not None:
            found = (t + self.delay, 1)
            return found if found < (self.watermark, 0) else None
        return next((m for m in self.moments() if self.reached(m) > t), None)

    def late(self, came: list[Sample]) -> list[Sample]:
        """Those that came after the state of their valid time had left."""
        return [s for s in came if self.has_left(s.valid, (s.available, 1))]

    def has_left(self, t: int, moment: Moment) -> bool:
        """Whether the state of time t leaves before a moment."""
        left = self.left(t)
        return left is not None and left < moment

    def before_watermark(self) -> list[Sample]:
        return [s for s in self.samples if s.available < self.watermark]

    def states(self) -> list[State]:
        """The states that have left at the watermark."""
        found = []
        for t in self.times(self.before_watermark()):
            left = self.left(t)
            if left is None:
                break
            found.append(self.state(t, max(left, self.begun())))
        return found

    def last_states(self, moment: int) -> list[State]:
        """Those that leave at ``moment``, when all sources have ended and all samples have come."""
        last = max((s.valid for s in self.samples), default=LEAST)
        times = itertools.takewhile(lambda t: t <= last, self.times(self.samples))
        return [self.state(t, (moment, 1)) for t in times if self.left(t) is None]

    def begun(self) -> Moment:
        """The moment of the first sample, which begins a grid."""
        if self.period is None or self.start is not None:
            return (LEAST, 0)
        return (min(s.available for s in self.samples), 1)

    def times(self, came: list[Sample]) -> Iterator[int]:
        """The times of states, in order."""
        first = LEAST if self.start is None else self.start
        last = GREATEST if self.end is None else self.end
        if self.period is None:
            in_time = {s.valid for s in came if not self.has_left(s.valid, (s.available, 1))}
            yield from sorted(t for t in in_time if first <= t <= last)
            return
        if self.start is None:
            if not came:
                return
            instant = min(s.available for s in came)
            first = min(s.valid for s in came if s.available == instant)
        yield from itertools.takewhile(lambda t: t <= last, itertools.count(first, self.period))

    def state(self, t: int, left: Moment) -> State:
        counted = [
            (s.valid, s.available, s.source, arrival)
            for arrival, s in enumerate(self.samples)
            if (s.available, 1) <= left and s.valid <= t
        ]
        newest = {}
        # The newest comes last, and stays.
        for *_, arrival in sorted(counted):
            s = self.samples[arrival]
            newest[s.term, s.objects] = s
        values, present = {}, set()
        for key, s in newest.items():
            if self.uses_most_recent or s.valid == t:
                values[key] = s.value
            if not self.is_present(t, s):
                continue
            for argument, iri in zip(s.term[1], s.objects, strict=True):
                if not argument.startswith("<"):
                    present |= {(sort, iri) for sort in (argument, *self.wider.get(argument, ()))}
        return State(t, left[0], present, values, left)

    def is_present(self, t: int, newest: Sample) -> bool:
        """Whether an object is there at ``t`` by the newest sample of one of its features."""
        if self.present_for is not None and newest.valid >= t - self.present_for:
            return True
        if self.period is not None:
            return newest.valid > t - self.period
        end = self.ended[newest.source]
        if end is None:
            return True
        return t <= max(end, *(s.valid for s in self.samples if s.source == newest.source))
