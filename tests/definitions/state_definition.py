"""The definition of the states of a formula (SPEC §1, §8), in plain lists of samples.

Slow on purpose; shares nothing with the product.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

LEAST, GREATEST = -(2**63), 2**63 - 1


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


@dataclass
class StateDefinition:
    """``samples``: those of one source in order of arrival. ``ended``, of each source: whether it
    ended at once after its last sample. ``watermark``: every sample available before it has come.
    """

    samples: list[Sample]
    ended: list[bool]
    watermark: int
    delay: int | None
    period: int | None
    start: int | None
    end: int | None
    uses_most_recent: bool
    present_for: int | None
    wider: Mapping[str, tuple[str, ...]]
    """The sorts that include a sort."""

    def steps(self) -> dict[int, int]:
        """Of each moment, the time reached: states before it leave."""
        instants = {s.available for s in self.samples if s.available < self.watermark}
        return {m: self.reached(m) for m in sorted(instants | {self.watermark})}

    def reached(self, moment: int) -> int:
        if self.delay is not None:
            return moment - self.delay
        found = GREATEST
        for source, has_ended in enumerate(self.ended):
            own = [s for s in self.samples if s.source == source]
            before = [s for s in own if s.available < moment]
            if not (has_ended and len(before) == len(own)):
                found = min(found, max((s.valid for s in before), default=LEAST))
        if all(self.ended):
            found = min(found, max((s.valid for s in self.samples), default=LEAST))
        return found

    def late(self, came: list[Sample]) -> list[Sample]:
        """Those that came after the state of their valid time had left."""
        return [s for s in came if self.reached(s.available) > s.valid]

    def before_watermark(self) -> list[Sample]:
        return [s for s in self.samples if s.available < self.watermark]

    def states(self) -> list[State]:
        """The states that have left at the watermark."""
        steps = self.steps()
        found = []
        for t in self.times(self.before_watermark(), steps[self.watermark] - 1):
            left = min(m for m, reached in steps.items() if reached > t)
            found.append(self.state(t, left))
        return found

    def last_states(self, moment: int) -> list[State]:
        """Those that leave at ``moment``, when all sources have ended and all samples have come."""
        last = max((s.valid for s in self.samples), default=LEAST)
        times = self.times(self.samples, last)
        return [self.state(t, moment) for t in times if self.reached(self.watermark) <= t]

    def times(self, came: list[Sample], last: int) -> list[int]:
        """The times of states up to ``last``."""
        first = LEAST if self.start is None else self.start
        last = last if self.end is None else min(last, self.end)
        if self.period is None:
            in_time = {s.valid for s in came if self.reached(s.available) <= s.valid}
            return sorted(t for t in in_time if first <= t <= last)
        if self.start is None:
            if not came:
                return []
            instant = min(s.available for s in came)
            first = min(s.valid for s in came if s.available == instant)
        return list(range(first, last + 1, self.period))

    def state(self, t: int, left: int) -> State:
        counted = [
            (s.valid, s.available, s.source, arrival)
            for arrival, s in enumerate(self.samples)
            if s.available < left and s.valid <= t
        ]
        values = {}
        last = {}
        # The newest comes last, and stays.
        for *_, arrival in sorted(counted):
            s = self.samples[arrival]
            if self.uses_most_recent or s.valid == t:
                values[s.term, s.objects] = s.value
            for argument, iri in zip(s.term[1], s.objects, strict=True):
                if not argument.startswith("<"):
                    for sort in (argument, *self.wider.get(argument, ())):
                        last[sort, iri] = s.valid
        present = {key for key, valid in last.items() if self.is_present(t, valid)}
        return State(t, left, present, values)

    def is_present(self, t: int, last: int) -> bool:
        """Whether an object is there at ``t`` whose last sample is valid at ``last``."""
        if self.period is None and self.present_for is None:
            return True
        within_period = self.period is not None and last > t - self.period
        return within_period or (self.present_for is not None and last >= t - self.present_for)
