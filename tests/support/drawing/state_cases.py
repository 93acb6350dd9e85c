"""What drawn cases of states have in common (test_states, test_monitoring)."""

from __future__ import annotations

from random import Random
from typing import Any, TypeVar

from state_definition import LEAST, Sample, StateDefinition

from dyknow.streams.policies.policy import (
    AnyChange,
    Approximation,
    Duration,
    SampleEvery,
    SynchronizationPolicy,
)

WIDE, NARROW = "urn:Wide", "urn:Narrow"
AnyStates = TypeVar("AnyStates", bound=StateDefinition)


class StateCase:
    """Samples of some streams, and the policy of their states; see `StateDefinition`."""

    streams: list[list[Sample]]
    ended: list[int | None]
    watermark: int
    delay: int | None
    period: int | None
    duration: Duration
    approximation: Approximation
    present_for: int | None
    wider: dict[str, tuple[str, ...]]

    def ends(self, random: Random) -> list[int | None]:
        """When each stream ended: all have, or some."""
        last = [each[-1].available if each else LEAST for each in self.streams]
        share = random.choice([1.0, 0.5])
        return [
            min(t + random.choice([0, 0, 3]), self.latest) if random.random() < share else None
            for t in last
        ]

    @property
    def latest(self) -> int:
        """The available time of the last sample."""
        return max((s.available for each in self.streams for s in each), default=0)

    @property
    def policy(self) -> SynchronizationPolicy:
        change = AnyChange() if self.period is None else SampleEvery(self.period)
        return SynchronizationPolicy(
            change, self.delay, self.duration, approximation=self.approximation
        )

    def states_by(self, definition: type[AnyStates], **more: Any) -> AnyStates:
        return definition(
            [sample for each in self.streams for sample in each],
            self.ended,
            self.watermark,
            self.delay,
            self.period,
            self.duration.start,
            self.duration.end,
            self.approximation is Approximation.MOST_RECENT,
            self.present_for,
            self.wider,
            **more,
        )
