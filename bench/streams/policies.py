"""Streams adapted to policies: what `streams.policies.select_adaptation` does a second, against
numpy by hand.

Run by ``make bench`` (``python bench/streams/policies.py``). One process, one core, best of several
runs. One float a sample. Both get the same batches and pass on the same samples (compared first);
numpy by hand knows its one policy and the nature of the data, and counts and tells nothing.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Iterator

import numpy as np
from measure import MS, Arrays, Program, Round, Row, batch_of, print_table

from dyknow.streams.policies.policy import (
    AnyChange,
    Approximation,
    Duration,
    Order,
    Policy,
    SampleEvery,
)
from dyknow.streams.policies.select_adaptation import adapt

DELAY = 5 * MS


def in_order(count: int) -> Round:
    """A sample a ms, 2 ms late."""
    valid = np.arange(count, dtype=np.int64) * MS
    value = np.random.default_rng(7).uniform(0, 100, count)
    return ((valid + 2 * MS, valid, value),)


def said_twice(count: int) -> Round:
    """Of two neighbours the second says what the first said."""
    ((available, valid, value),) = in_order(count)
    first = np.arange(count) // 2 * 2
    return ((available, valid[first], value[first]),)


def shuffled(count: int) -> Round:
    """A sample a ms, up to 20 ms late, so out of order."""
    ((_, valid, value),) = in_order(count)
    available = valid + np.random.default_rng(8).integers(0, 20 * MS, count)
    order = np.argsort(available, kind="stable")
    steps = np.arange(count)
    available = np.maximum.accumulate(available[order] - steps) + steps
    return ((available, valid[order], value[order]),)


def unchanged(rounds: Iterable[Round]) -> Iterator[Arrays]:
    for (samples,) in rounds:
        yield samples


def changed(rounds: Iterable[Round]) -> Iterator[Arrays]:
    last = None
    for ((available, valid, value),) in rounds:
        new = np.empty(len(value), np.bool_)
        new[0] = (valid[0], value[0]) != last
        new[1:] = (valid[1:] != valid[:-1]) | (value[1:] != value[:-1])
        last = (valid[-1], value[-1])
        yield available[new], valid[new], value[new]


def where(keep: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> Program:
    """A condition on the available and valid time of each sample."""

    def by_hand(rounds: Iterable[Round]) -> Iterator[Arrays]:
        for ((available, valid, value),) in rounds:
            kept = keep(available, valid)
            yield available[kept], valid[kept], value[kept]

    return by_hand


def monotone(rounds: Iterable[Round]) -> Iterator[Arrays]:
    greatest = -1
    for ((available, valid, value),) in rounds:
        so_far = np.maximum(np.maximum.accumulate(valid), greatest)
        keep = valid == so_far
        greatest = so_far[-1]
        yield available[keep], valid[keep], value[keep]


def sorted_within_delay(rounds: Iterable[Round]) -> Iterator[Arrays]:
    delay, valid, value = 30 * MS, np.empty(0, np.int64), np.empty(0)
    for ((available, more_valid, more_value),) in rounds:
        valid = np.concatenate((valid, more_valid))
        value = np.concatenate((value, more_value))
        order = np.argsort(valid, kind="stable")
        valid, value = valid[order], value[order]
        due = np.searchsorted(valid, available[-1] - delay, "right")
        yield valid[:due] + delay, valid[:due], value[:due]
        valid, value = valid[due:], value[due:]
    yield valid + delay, valid, value


def resampled(period: int) -> Program:
    """Valid times increase and every sample is there in time: one search a batch."""

    def by_hand(rounds: Iterable[Round]) -> Iterator[Arrays]:
        begin = 0
        times, values = np.empty(0, np.int64), np.empty(0)
        for ((available, valid, value),) in rounds:
            times = np.concatenate((times, valid))
            values = np.concatenate((values, value))
            points = np.arange(begin, available[-1] - DELAY + 1, period)
            if len(points):
                rows = np.searchsorted(times, points, "right") - 1
                yield points + DELAY, points, values[rows]
                begin = int(points[-1]) + period
                times, values = times[rows[-1] :], values[rows[-1] :]

    return by_hand


def adapted(policy: Policy) -> Program:
    """Ours, for any policy."""

    def run(rounds: Iterable[Round]) -> Iterator[Arrays]:
        adaptation = adapt(policy)
        for (samples,) in rounds:
            for made in adaptation.push(batch_of(samples)):
                yield made.available, made.valid, made.columns["value"].values
        if policy.approximation is Approximation.NONE:
            for made in adaptation.end():
                yield made.available, made.valid, made.columns["value"].values

    return run


def recent(period: int) -> Policy:
    approximation = Approximation.MOST_RECENT
    return Policy(SampleEvery(period), DELAY, Duration(0, to_oo=True), approximation=approximation)


def row(
    name: str, policy: Policy, by_hand: Program, data: Callable[[int], Round] = in_order
) -> Row:
    return Row(name, adapted(policy), by_hand, data, trivial=policy == Policy())


SECONDS = 1_000 * MS
ROWS = (
    row("any update", Policy(), unchanged),
    row("any change", Policy(AnyChange()), changed, said_twice),
    row(
        "max delay 10 ms", Policy(max_delay=10 * MS), where(lambda a, v: a - v <= 10 * MS), shuffled
    ),
    row(
        "from 1 s to 900 s",
        Policy(duration=Duration(SECONDS, 900 * SECONDS)),
        where(lambda a, v: (v >= SECONDS) & (v <= 900 * SECONDS)),
    ),
    row("monotone order", Policy(order=Order.MONOTONE), monotone, shuffled),
    row("strict order", Policy(order=Order.STRICT), monotone, shuffled),
    row("sample every 2 ms", Policy(SampleEvery(2 * MS)), where(lambda a, v: v % (2 * MS) == 0)),
    row(
        "monotone order, max delay 30 ms",
        Policy(order=Order.MONOTONE, max_delay=30 * MS),
        sorted_within_delay,
        shuffled,
    ),
    row(
        "strict order, max delay 30 ms",
        Policy(order=Order.STRICT, max_delay=30 * MS),
        sorted_within_delay,
        shuffled,
    ),
    row("sample every 3 ms, use most recent", recent(3 * MS), resampled(3 * MS)),
    row("sample every 0.25 ms, use most recent", recent(MS // 4), resampled(MS // 4)),
)


if __name__ == "__main__":
    sys.exit(0 if print_table("one stream, samples in", ROWS, times=5) else 1)
