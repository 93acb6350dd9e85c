"""The definitions of tuples: `join` and state synchronization ([DyKnow10 Def. 5.11, §5.4],
SPEC §1).

`prove_join` and `prove_states` hold a stream of tuples against its inputs and give the first
counterexample. They share no code with `join` and `synchronization`, which make such streams.
Plain Python on one tuple at a time; `engine.kpl.verification` calls them.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..policies.policy import Approximation, Constraint, SynchronizationPolicy
from ..policies.satisfaction import Counterexample
from ..sample import SampleBatch
from ..time import TIME_MAX, TIME_MIN

Values = tuple[Any, ...]


@dataclass(frozen=True, slots=True)
class TupleInput:
    """An input of a tuple: its samples, the names that its fields have in the tuple, the last two
    of which are those of its times if ``inner_times`` of a join are fields; for a
    synchronization whether its valid times do not decrease, and the moment at which it ended (None:
    it ended with the last input, or has not)."""

    samples: SampleBatch
    names: Sequence[str]
    is_monotone: bool = False
    ended: int | None = None
    inner_times: bool = False


def prove_join(made: SampleBatch, inputs: Sequence[TupleInput]) -> Counterexample | None:
    """Def. 5.11: at each available time of an input the latest sample of each. Cost: O(n log n)."""
    available_of = [one.samples.available.tolist() for one in inputs]
    times = sorted({time for own in available_of for time in own})
    latest = [_latest(one) for one in inputs]
    rows = zip(made.available.tolist(), made.valid.tolist(), *_parts(made, inputs), strict=True)
    for row, (available, valid, *parts) in enumerate(rows):
        if row >= len(times) or available != times[row] or valid != available:
            expected = f"the tuple at {times[row]}" if row < len(times) else "no further tuple"
            return Counterexample(None, row, f"available at {available}; expected {expected}")
        for i, (one, part) in enumerate(zip(inputs, parts, strict=True)):
            place = bisect_right(available_of[i], available) - 1
            if part != (latest[i][place] if place >= 0 else (None,) * len(one.names)):
                said = f"values of input {i + 1} at {available} are not its latest sample"
                return Counterexample(None, row, said)
    if len(made) < len(times):
        return Counterexample(None, len(made), f"there is no tuple at {times[len(made)]}")
    return None


def prove_states(
    made: SampleBatch, inputs: Sequence[TupleInput], policy: SynchronizationPolicy
) -> Counterexample | None:
    """SPEC §1 "State synchronization": each state is one that leaves then, with these values, and
    none is missing. Cost: O(n log n) Python for n samples and states, O(n²) where samples of one
    valid time are many."""
    definition = _States([_Known(one) for one in inputs], policy)
    rows = zip(made.available.tolist(), made.valid.tolist(), *_parts(made, inputs), strict=True)
    for row, (leaves, time, *parts) in enumerate(rows):
        problem = definition.problem(leaves, time, parts)
        if problem is not None:
            constraint, message = problem
            return Counterexample(constraint, row, message)
    missing = definition.missing()
    return None if missing is None else Counterexample(None, len(made), missing)


class _Known:
    """One input, by valid time and by arrival."""

    def __init__(self, one: TupleInput) -> None:
        batch = one.samples
        # A sample that decreases is dropped before anything else is decided.
        if one.is_monotone:
            batch = batch.take(batch.valid >= np.maximum.accumulate(batch.valid))
        self.is_monotone, self.ended = one.is_monotone, one.ended
        self.arrivals: list[tuple[int, int]] = list(
            zip(batch.available.tolist(), batch.valid.tolist(), strict=True)
        )
        self.nothing: Values = (None,) * len(one.names)
        values = _values(batch, list(batch.columns)) or [self.nothing] * len(batch)
        # The key has the times alone, as values of several types cannot be compared.
        named = sorted(
            zip(batch.valid.tolist(), batch.available.tolist(), values, strict=True),
            key=lambda each: each[:2],
        )
        self.by_time: list[tuple[int, int]] = [(valid, available) for valid, available, _ in named]
        self._values: list[Values] = [values for *_, values in named]

    def satisfied(self, time: int) -> int | None:
        """When it has what the state for ``time`` asks of it; None if never."""
        found = self.first(time)
        if self.ended is None:
            return found
        return self.ended if found is None else min(found, self.ended)

    def first(self, time: int) -> int | None:
        """When the first sample came that is valid at ``time``, or later if valid times do not
        decrease; None if none did."""
        place = bisect_left(self.by_time, (time, TIME_MIN))
        if place == len(self.by_time) or not (self.is_monotone or self.by_time[place][0] == time):
            return None
        return self.by_time[place][1]

    def has(self, time: int, leaves: int) -> bool:
        """Whether a sample valid at ``time`` was available by ``leaves``."""
        place = bisect_left(self.by_time, (time, TIME_MIN))
        if place == len(self.by_time):
            return False
        valid, available = self.by_time[place]
        return valid == time and available <= leaves

    def value(self, time: int, leaves: int, exact: bool) -> Values:
        """most_recent_at(f, time, leaves); with ``exact`` only if it is valid then."""
        place = bisect_right(self.by_time, (time, TIME_MAX)) - 1
        while place >= 0 and self.by_time[place][1] > leaves:
            place -= 1
        if place < 0 or (exact and self.by_time[place][0] != time):
            return self.nothing
        return self._values[place]


class _States:
    """The states that leave, one after the other."""

    def __init__(self, inputs: Sequence[_Known], policy: SynchronizationPolicy) -> None:
        self._inputs, self._policy = inputs, policy
        self._exact = policy.approximation is Approximation.NONE
        in_order = all(one.is_monotone for one in inputs) or policy.max_delay is not None
        self._in_order = in_order or policy.period is not None
        self._left: list[tuple[int, int]] = []
        """Available and valid times of the states so far."""
        self._gone: dict[int, int] = {}

    def problem(
        self, leaves: int, time: int, parts: Sequence[Values]
    ) -> tuple[Constraint | None, str] | None:
        """What is wrong with the next state, if anything."""
        policy, duration = self._policy, self._policy.duration
        if not duration.first <= time <= duration.last:
            return Constraint.DURATION, f"the state for {time} is outside the duration"
        last = self._left[-1] if self._left else None
        if time in self._gone:
            return Constraint.ORDER, f"there was a state for {time} before"
        if self._in_order and last is not None and time < last[1]:
            return Constraint.ORDER, f"the state for {time} left after the one for {last[1]}"
        if policy.period is not None:
            if time != (self._begin() if last is None else last[1] + policy.period):
                return Constraint.PERIOD, f"the state for {time} is not the next of the grid"
        elif not any(one.has(time, leaves) for one in self._inputs):
            return None, f"no sample that was available by {leaves} is valid at {time}"
        due = self.due(time)
        if due is None:
            return Constraint.DELAY, f"the state for {time} left though it was never complete"
        # Each state has an available time of its own.
        expected = due if last is None else max(due, last[0] + 1)
        if leaves != expected:
            return Constraint.AVAILABLE, f"the state for {time} left at {leaves}, not at {expected}"
        for i, (one, part) in enumerate(zip(self._inputs, parts, strict=True)):
            if part != one.value(time, leaves, self._exact):
                return None, f"the value of input {i + 1} in the state for {time} is another"
        self._left.append((leaves, time))
        self._gone[time] = leaves
        return None

    def _begin(self) -> int | None:
        """The first time of the grid: ``from``, or the next multiple of the period from the first
        arrival on whose deadline had not passed then; None without samples."""
        policy = self._policy
        assert policy.period is not None
        if policy.duration.start is not None:
            return policy.duration.start
        arrivals = [arrival for one in self._inputs for arrival in one.arrivals]
        if not arrivals:
            return None
        # Of the first instant the sample with the least valid time begins the grid.
        available, valid = min(arrivals)
        if policy.max_delay is not None:
            valid = max(valid, available - policy.max_delay)
        return -(-valid // policy.period) * policy.period

    def due(self, time: int) -> int | None:
        """When the state for ``time`` may leave: when it is complete, or at its deadline."""
        moments = [one.satisfied(time) for one in self._inputs]
        known = [moment for moment in moments if moment is not None]
        complete = max(known) if len(known) == len(moments) else None
        if self._policy.max_delay is None:
            return complete
        deadline = min(time + self._policy.max_delay, TIME_MAX)
        return deadline if complete is None else min(complete, deadline)

    def missing(self) -> str | None:
        """A state that should have left and has not, in words."""
        for time in self._wanted():
            if self.due(time) is not None and time not in self._gone:
                leaves, last = self._left[-1] if self._left else (TIME_MIN, TIME_MIN)
                # After the end of 64-bit time no state leaves.
                if leaves < TIME_MAX or (self._in_order and time < last):
                    return f"there is no state for {time}"
        return None

    def _wanted(self) -> Iterator[int]:
        """Times that a state must be for: those of timely samples, or the next of the grid."""
        policy, duration = self._policy, self._policy.duration
        if policy.period is not None:
            news = max((one.by_time[-1][0] for one in self._inputs if one.by_time), default=None)
            following = self._left[-1][1] + policy.period if self._left else self._begin()
            if following is not None and news is not None and following <= min(duration.last, news):
                yield following
            return
        leaves = [moment for moment, _ in self._left]
        for one in self._inputs:
            for available, valid in one.arrivals:
                if not duration.first <= valid <= duration.last:
                    continue
                if policy.max_delay is not None and available > valid + policy.max_delay:
                    continue
                before = bisect_left(leaves, available)
                # A state of a later time had left when it came, so the sample is late.
                if self._in_order and before and self._left[before - 1][1] >= valid:
                    continue
                yield valid


def _latest(one: TupleInput) -> list[Values]:
    """What a tuple has of each sample of an input of a join."""
    values = _values(one.samples, list(one.samples.columns)) or [()] * len(one.samples)
    if not one.inner_times:
        return values
    times = zip(one.samples.available.tolist(), one.samples.valid.tolist(), strict=True)
    return [(*own, *inner) for own, inner in zip(values, times, strict=True)]


def _parts(made: SampleBatch, inputs: Sequence[TupleInput]) -> list[list[Values]]:
    """Of each input the values that the tuples have of it."""
    return [_values(made, one.names) or [()] * len(made) for one in inputs]


def _values(batch: SampleBatch, names: Sequence[str]) -> list[Values]:
    """The values of each sample, in order of ``names``; without names nothing."""
    return list(zip(*(batch.columns[name].tolist() for name in names), strict=True))
