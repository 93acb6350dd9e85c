"""The states of each of many objects by itself: at its own samples, or on a grid of its own (SPEC
§1, §8)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ...streams.policies.policy import Approximation, SynchronizationPolicy
from ...streams.sample import Times
from ...streams.time import TIME_MAX, TIME_MIN
from ...streams.time_arithmetic import earlier, later
from .departures import Steps
from .part_departures import Parts
from .part_samples import PartSamples
from .state_maker import CELLS, MOST_STATES, MadeStates, TooManyDue, present_at, variables_of
from .states import States, Term, Values


class StepsOfParts(Protocol):
    """When the states of parts leave; see `part_departures.PartSteps`."""

    @property
    def latest(self) -> Any:
        """The time that each part has reached, or that all have."""

    def left(self, part: Parts, due: Times) -> Times: ...
    def reached_before(self, part: Parts, available: Times) -> Times: ...


@dataclass(frozen=True, slots=True)
class CommonSteps:
    """Steps that all parts make together."""

    steps: Steps

    @property
    def latest(self) -> int:
        return self.steps.latest

    def left(self, part: Parts, due: Times) -> Times:
        return self.steps.left(due)

    def reached_before(self, part: Parts, available: Times) -> Times:
        return self.steps.reached_before(available)


class PartStates:
    """Makes the states of ``terms`` of one object each, under a policy. An object is a part, by its
    number.

    Law (tests/laws/reasoning/mtl/test_part_monitoring.py, test_monitoring.py): the states of a part
    are those that `StateMaker` makes of its own samples. Cost and memory: see `PartSamples`; of the
    samples of a part one is kept, and those valid later than its last state.
    """

    def __init__(
        self,
        terms: Sequence[Term],
        policy: SynchronizationPolicy,
        *,
        present_for: int | None = None,
    ) -> None:
        self._policy = policy
        self._present_for = present_for
        self._terms = terms
        self._samples = PartSamples(terms, policy.duration.last)
        self._sorts = {sort for term in terms for sort in variables_of(term)}
        self._count = 0
        self._has_grid = np.empty(0, np.bool_)
        """Whether the grid of each part has begun."""
        self._next: Times = np.empty(0, np.int64)
        """The next time of each grid."""
        self._begun: Times = np.empty(0, np.int64)
        """The available time of the first instant of each part, where its grid begins with it."""
        self._greatest: Times = np.empty(0, np.int64)
        self.late_of: NDArray[np.int64] = np.empty(0, np.int64)
        """The samples of each part that came after the state of their valid time had left."""

    def make_room_for(self, parts: int) -> None:
        """Let there be so many parts; new ones have no samples."""
        self._count = max(self._count, parts)
        more = max(16, self._count) if self._count > len(self._next) else 0
        if not more:
            return
        begin = self._policy.duration.start if self._policy.period is not None else None
        none = np.full(more, TIME_MIN, np.int64)
        begins = np.full(more, begin is not None)
        nexts = none if begin is None else np.full(more, begin, np.int64)
        self._has_grid = np.concatenate([self._has_grid, begins])
        self._next = np.concatenate([self._next, nexts])
        self._begun = np.concatenate([self._begun, none])
        self._greatest = np.concatenate([self._greatest, none])
        self.late_of = np.concatenate([self.late_of, np.zeros(more, np.int64)])
        self._samples.make_room_for(len(self._next))

    def grid_of(self, part: int) -> int | None:
        """Return a time (ns) of the grid of a part, once it has begun."""
        is_known = self._policy.period is not None and bool(self._has_grid[part])
        return int(self._next[part]) if is_known else None

    @property
    def retained(self) -> int:
        """The number of samples in memory."""
        return len(self._samples)

    def add(
        self, term: Term, source: int, available: Times, valid: Times, part: Parts,
        values: NDArray[Any],
    ) -> None:  # fmt: skip
        """Take samples of a term from a stream, as `StateMaker.add` does."""
        self._samples.add(term, source, available, valid, part, values)

    def drop(self, part: int) -> None:
        """Forget the samples of a part, and make no further state of it."""
        self._samples.drop(part)
        self._has_grid[part] = False

    def advance(self, watermark: int, steps: StepsOfParts) -> Iterator[MadeStates]:
        """Make the states that leave at ``steps``, of the samples available before ``watermark``;
        each step comes once. Consume it at once."""
        self._enter(watermark, steps)
        if self._policy.period is None:
            due, part = self._samples.due(np.atleast_1d(np.asarray(steps.latest, np.int64)))
        else:
            due, part = self._grids(np.broadcast_to(steps.latest, (self._count,)))
        if not len(due):
            return iter(())
        # The first sample of a grid may be late for states of the grid that it begins.
        return self._states(due, part, np.maximum(steps.left(part, due), self._begun[part]))

    def end(self, moment: int) -> Iterator[MadeStates]:
        """Make the last states, as `StateMaker.end` does."""
        if self._policy.period is None:
            due, part = self._samples.due(None)
        else:
            due, part = self._grids(later(self._greatest[: self._count], 1))
        return self._states(due, part, np.full(len(due), moment, np.int64))

    def _enter(self, watermark: int, steps: StepsOfParts) -> None:
        """Let the samples in that are available before the watermark."""
        new = self._samples.enter(watermark)
        if new is None:
            return
        available, valid, part = new
        reached = steps.reached_before(part, available)
        in_time = reached <= valid
        if np.count_nonzero(in_time) < len(valid):
            np.add.at(self.late_of, part[~in_time], 1)
        if self._policy.period is None:
            duration = self._policy.duration
            in_time &= (valid >= duration.first) & (valid <= duration.last)
            self._samples.add_times(part[in_time], valid[in_time])
            return
        np.maximum.at(self._greatest, part, valid)
        is_first = ~self._has_grid[part]
        if is_first.any():
            part, available, valid = part[is_first], available[is_first], valid[is_first]
            self._begun[part] = TIME_MAX
            np.minimum.at(self._begun, part, available)
            is_first = available == self._begun[part]
            self._next[part] = TIME_MAX
            np.minimum.at(self._next, part[is_first], valid[is_first])
            self._has_grid[part] = True

    def _grids(self, before: Times) -> tuple[Times, Parts]:
        """The times of the grids before these times that have not left, and their parts."""
        period = self._policy.period
        assert period is not None
        last = np.minimum(earlier(before, 1), self._policy.duration.last)
        nexts = self._next[: self._count]
        parts = np.flatnonzero(
            self._has_grid[: self._count] & (before > TIME_MIN) & (nexts <= last)
        )
        # A difference of times may exceed 63 bits.
        spans = last[parts].astype(np.uint64) - nexts[parts].astype(np.uint64)
        counts = spans // np.uint64(period) + np.uint64(1)
        if len(counts) and counts.max() > MOST_STATES:
            raise TooManyDue(
                f"{counts.max():,} states are due at once, and at most {MOST_STATES:,} may be; "
                "sample less often, or begin later with `from`"
            )
        count = counts.astype(np.int64)
        part = np.repeat(parts, count)
        place = np.arange(len(part)) - np.repeat(np.cumsum(count) - count, count)
        due = nexts[part] + period * place
        nexts[parts] += period * count
        return due, part

    def _states(self, due: Times, part: Parts, left: Times) -> Iterator[MadeStates]:
        """Make the states at ``due`` some at a time."""
        for start in range(0, len(due), CELLS):
            rows = slice(start, start + CELLS)
            yield MadeStates(self._some(due[rows], part[rows], left[rows]), left[rows], part[rows])

    def _some(self, due: Times, part: Parts, left: Times) -> States:
        places, found = self._samples.at(due, left, part)
        last_valid = found.max(axis=0, initial=TIME_MIN)
        values: dict[Term, Values] = {}
        for term, valid in zip(self._terms, found, strict=True):
            known = valid != TIME_MIN
            if self._policy.approximation is Approximation.NONE:
                known &= valid == due
            values[term] = Values(self._samples.values(term, places)[:, None], known[:, None])
        period = self._policy.period
        horizon = due if period is None else later(due, period - 1)
        present = present_at(last_valid[:, None], due, period, self._present_for)
        # Each state has one object, that of its part.
        return States(
            due,
            horizon,
            dict.fromkeys(self._sorts, ("",)),
            dict.fromkeys(self._sorts, present),
            values,
        )
