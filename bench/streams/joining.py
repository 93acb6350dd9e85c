"""join and state synchronization: what they do a second, against numpy by hand, and for how long.

Run by ``make bench`` (``python bench/streams/joining.py``). One process, one core, best of several
runs. One float a sample; inputs of 1 kHz that come in turns, a batch each. Both give the tuples'
times and the value of each input (compared first); numpy by hand gets the batches of all inputs at
once, knows that nothing is out of order or too late, and counts and tells nothing.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Iterator

import numpy as np
from measure import MS, Arrays, Program, Round, Row, Samples, batch_of, part, print_table

from dyknow.streams.joins.join import Join
from dyknow.streams.policies.policy import (
    AnyChange,
    Approximation,
    Change,
    Duration,
    Order,
    SampleEvery,
    SynchronizationPolicy,
)
from dyknow.streams.synchronization.synchronization import Synchronization
from dyknow.streams.tuples import TupleBatch

DELAY = 20 * MS
OFFSETS = (0, 0, MS // 4, MS // 2, MS // 2)


def inputs(number: int) -> Callable[[int], Round]:
    """``number`` inputs, available 1 to 4 ms after their valid times, in steps of 0.1 ms so that
    some meet; in each second every input in its turn is silent for 50 ms, longer than the delay."""

    def make(count: int) -> Round:
        random = np.random.default_rng(7)
        seconds, steps = -(-count // 950), np.arange(count)
        made: list[Samples] = []
        for i in range(number):
            second = np.arange(1_000)
            kept = second[(second < 200 * i) | (second >= 200 * i + 50)]
            valid = (np.arange(seconds)[:, None] * 1_000 + kept).ravel()[:count] * MS + OFFSETS[i]
            late = valid + MS + random.integers(0, 30, count) * (MS // 10)
            available = np.maximum.accumulate(late - steps) + steps
            made.append((available, valid, random.uniform(0, 100, count)))
        return tuple(made)

    return make


class Held:
    """What numpy by hand keeps of one input."""

    def __init__(self) -> None:
        none = np.empty(0, np.int64)
        self.samples: Samples = none, none, np.empty(0)

    def add(self, more: Samples) -> None:
        available, valid, value = (
            np.concatenate(both) for both in zip(self.samples, more, strict=True)
        )
        self.samples = available, valid, value

    def at(self, rows: np.ndarray) -> np.ndarray:
        """The values at ``rows``, NaN for -1; what lies before the last of them is forgotten."""
        value = self.samples[2]
        found = value[np.maximum(rows, 0)] if len(value) else np.zeros(len(rows))
        self.samples = part(self.samples, max(0, int(rows[-1])), None)
        return np.where(rows < 0, np.nan, found)


def joined_by_hand(rounds: Iterable[Round]) -> Iterator[Arrays]:
    """last_avail of each input at each available time of any: a union and a search each."""
    held: list[Held] = []
    done = -1
    for samples in rounds:
        held = held or [Held() for _ in samples]
        for one, more in zip(held, samples, strict=True):
            one.add(more)
        # More samples of the last instant may come.
        known = min(int(one.samples[0][-1]) for one in held) - 1
        times = np.sort(np.concatenate([one.samples[0] for one in held]), kind="stable")
        times = times[
            np.searchsorted(times, done, "right") : np.searchsorted(times, known, "right")
        ]
        if len(times):
            times = times[np.concatenate(([True], times[1:] != times[:-1]))]
            rows = [np.searchsorted(one.samples[0], times, "right") - 1 for one in held]
            yield times, times, *(one.at(row) for one, row in zip(held, rows, strict=True))
            done = known


def states_by_hand(period: int | None, monotone: bool = True) -> Program:
    """A state at each multiple of ``period``, or at each valid time, once no input can add to it,
    at the latest 20 ms after its time; of the most recent samples by then. Inputs that might not be
    monotone could always add, as no time has a sample of each."""

    def by_hand(rounds: Iterable[Round]) -> Iterator[Arrays]:
        held: list[Held] = []
        last, left = -1, -1
        for samples in rounds:
            held = held or [Held() for _ in samples]
            for one, more in zip(held, samples, strict=True):
                one.add(more)
            known = min(int(one.samples[0][-1]) for one in held) - 1
            end = max(known - DELAY, min(int(one.samples[1][-1]) for one in held))
            if period is None:
                times = np.sort(np.concatenate([one.samples[1] for one in held]), kind="stable")
                low, high = np.searchsorted(times, (last, end), "right")
                times = times[low:high]
                times = times[np.diff(times, prepend=-1) > 0]
            else:
                times = np.arange(last // period + 1, end // period + 1) * period
            if not len(times):
                continue
            due = np.zeros(len(times), np.int64) if monotone else times + DELAY
            for one in held if monotone else ():
                available, valid, _ = one.samples
                first = np.searchsorted(valid, times, "left")
                there = available[np.minimum(first, len(available) - 1)]
                np.maximum(due, np.where(first < len(available), there, known + 1), out=due)
            np.minimum(due, times + DELAY, out=due)
            due[0] = max(due[0], left + 1)
            steps = np.arange(len(due))
            leaves = np.maximum.accumulate(due - steps) + steps
            count = int(np.searchsorted(leaves, known, "right"))
            if not count:
                continue
            leaves, times = leaves[:count], times[:count]
            last, left = int(times[-1]), int(leaves[-1])
            values = []
            for one in held:
                available, valid, _ = one.samples
                by_then = np.searchsorted(available, leaves, "right")
                values.append(
                    one.at(np.minimum(by_then, np.searchsorted(valid, times, "right")) - 1)
                )
            yield leaves, times, *values

    return by_hand


def arrays(made: TupleBatch) -> Arrays:
    """The tuples' times and values, NaN where an input has none."""
    values = []
    for i in range(len(made.inputs)):
        column = made.column(i, "value")
        values.append(
            column.values if column.null is None else np.where(column.null, np.nan, column.values)
        )
    return made.available, made.valid, *values


def joined(rounds: Iterable[Round]) -> Iterator[Arrays]:
    join: Join | None = None
    for samples in rounds:
        join = join or Join(len(samples))
        for i, one in enumerate(samples):
            made = join.push(i, batch_of(one))
            if made is not None:
                yield arrays(made)


def synchronized(change: Change, monotone: bool = True) -> Program:
    recent = Approximation.MOST_RECENT
    policy = SynchronizationPolicy(change, DELAY, Duration(0), Order.ANY, recent)

    def run(rounds: Iterable[Round]) -> Iterator[Arrays]:
        process: Synchronization | None = None
        for samples in rounds:
            process = process or Synchronization(policy, [monotone] * len(samples))
            for i, one in enumerate(samples):
                for made in process.push(i, batch_of(one)):
                    yield arrays(made)

    return run


ROWS = (
    Row("join of 3", joined, joined_by_hand, inputs(3)),
    Row(
        "states of 5, sample every 5 ms",
        synchronized(SampleEvery(5 * MS)),
        states_by_hand(5 * MS),
        inputs(5),
    ),
    Row(
        "states of 5, sample every 1 ms",
        synchronized(SampleEvery(MS)),
        states_by_hand(MS),
        inputs(5),
    ),
    Row("states of 5, any change", synchronized(AnyChange()), states_by_hand(None), inputs(5)),
    Row(
        "states of 5 not known to be monotone, any change",
        synchronized(AnyChange(), monotone=False),
        states_by_hand(None, monotone=False),
        inputs(5),
        scale=0.05,
    ),
)


if __name__ == "__main__":
    sys.exit(0 if print_table("several streams, samples in", ROWS, times=3) else 1)
