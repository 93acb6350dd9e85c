"""A formula about one object, over samples of several objects, each evaluated by itself (SPEC
§8)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...languages.mtl.checked import CheckedMonitor
from ...streams.sample import Times
from ..states.part_departures import PartDepartures, Parts
from ..states.part_states import CommonSteps, StepsOfParts
from .evaluator import Constants, Verdicts
from .monitoring import WORDS, Monitoring, Reported
from .parts.evaluator import PartEvaluator


class PartMonitoring(Monitoring):
    """The verdicts of a formula of each object by itself; an object is a part, by its number. Parts
    may differ in the values of the formula's parameters.

    Law (tests/laws/reasoning/mtl/test_part_monitoring.py): the verdicts of a part, and when they
    are available, are those of `Monitoring` over its own samples. Cost: that of one `Monitoring`
    over all samples. In `Reported` the numbers of parts stand for objects.

    Contract: the formula is of one object (`is_of_one_object`), and no monitor of a single start on
    a grid.
    """

    _evaluator: PartEvaluator

    def __init__(self, monitor: CheckedMonitor, sources: int) -> None:
        # Each part has a grid of its own, too.
        super().__init__(monitor, sources, has_own_states=True)
        self._part_departures = PartDepartures(sources)
        self._count = 0
        self.samples_of: NDArray[np.int64] = np.empty(0, np.int64)
        """The samples of each part that came."""

    @property
    def late_of(self) -> NDArray[np.int64]:
        """The samples of each part that came after the state of their valid time had left."""
        return self._own.late_of

    def add_part(self, object: str, values: Constants) -> int:
        """Return the number of a new part for an ``object`` (an IRI), whose samples may follow,
        with its ``values`` of the formula's parameters."""
        part = self._part_departures.add_part()
        self._count = part + 1
        self._begin_part(part, object, values)
        if part == len(self.samples_of):
            more = np.zeros(max(16, part), np.int64)
            self.samples_of = np.concatenate([self.samples_of, more])
        return part

    def end_part(self, part: int) -> None:
        """Drop all that is known of a part. Cost: O(samples and states)."""
        self._own.drop(part)
        self._evaluator.drop(part)
        if self._runs is not None:
            self._runs.drop((part,))

    def part(self, number: int) -> MonitoredPart:
        """Return how far the evaluation of a part is."""
        counts = self._evaluator.verdicts_of(number)
        return MonitoredPart(
            self.monitor,
            int(self._evaluator.states_of[number]),
            {word: counts[value] for value, word in WORDS.items()},
            self._evaluator.is_open_of(number),
            self._own.grid_of(number),
        )

    def came_in_parts(self, stream: int, available: Times, valid: Times, part: Parts) -> None:
        """Take the times of samples in a batch of a stream, with their parts; see `came`."""
        np.add.at(self.samples_of, part, 1)
        if self.monitor.policy.max_delay is None:
            self._part_departures.add(stream, available, valid, part)

    def resumed(self, stream: int) -> None:
        """A stream goes on after its end."""
        self._part_departures.resume(stream)

    def ended(self, source: int, moment: int) -> None:
        self._part_departures.end(source, moment)

    def set_idle(self, sources: Iterable[int]) -> None:
        self._part_departures.idle = frozenset(sources)

    def advance(self, watermark: int, *, by_clock: bool = False) -> Reported:
        steps: StepsOfParts
        if self.monitor.policy.max_delay is None:
            steps = self._part_departures.advance(watermark, by_clock=by_clock)
        else:
            # Under a maximal delay the time of all parts is that of the watermark.
            steps = CommonSteps(self._departures.advance(watermark, by_clock=by_clock))
        made = self._own.advance(watermark, steps)
        return self._report(self._decided(made, steps.latest, watermark if by_clock else None))

    def _objects_of(self, found: Verdicts) -> NDArray[Any]:
        return found.part.reshape(1, -1)

    def _place_of(self, binding: tuple[Any, ...]) -> tuple[int, ...]:
        return (int(binding[0]),)


@dataclass(frozen=True, slots=True)
class MonitoredPart:
    """How far the evaluation of one part is: its states, verdicts by their word, whether a state
    has none yet, and a time (ns) of its grid."""

    monitor: CheckedMonitor
    states: int
    verdicts: Mapping[str, int]
    has_open: bool
    grid: int | None
