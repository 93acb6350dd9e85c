"""What drawn cases of states have in common (test_states, test_monitoring)."""

from __future__ import annotations

from typing import Any, TypeVar

from state_definition import Sample, StateDefinition

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
    ended: list[bool]
    watermark: int
    delay: int | None
    period: int | None
    duration: Duration
    approximation: Approximation
    present_for: int | None
    wider: dict[str, tuple[str, ...]]

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
