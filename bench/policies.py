"""Streams adapted to policies: what `streams.adapting` does a second, against numpy by hand.

Run by ``make bench`` (``python bench/policies.py``). One process, one core, best of several runs.
One float a sample. Both get the same batches and pass on the same samples (checked); numpy by hand
knows its one policy, keeps only the columns it needs, and counts and tells nothing.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from dyknow.streams.adapting import adapt
from dyknow.streams.policy import (
    AnyChange,
    Approximation,
    Duration,
    Order,
    Policy,
    SampleEvery,
)
from dyknow.streams.sample import Column, FieldType, SampleBatch

MS = 10**6
SIZES = {10_000: 1_000_000, 100: 200_000, 1: 10_000}
"""Samples in all, by samples a batch."""

Columns = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Available times, valid times, values."""
ByHand = Callable[[Iterator[Columns]], Iterator[Columns]]


@dataclass(frozen=True)
class Case:
    name: str
    policy: Policy
    by_hand: ByHand
    shuffled: bool = False


def samples(count: int, shuffled: bool) -> Columns:
    """A sample a ms, 2 ms late and every other value new; or up to 20 ms late, so out of order."""
    random = np.random.default_rng(7)
    valid = np.arange(count, dtype=np.int64) * MS
    value = random.uniform(0, 100, count // 2 + 1).repeat(2)[:count]
    if not shuffled:
        return valid + 2 * MS, valid, value
    available = valid + random.integers(0, 20 * MS, count)
    order = np.argsort(available, kind="stable")
    available = np.maximum.accumulate(available[order] - np.arange(count)) + np.arange(count)
    return available, valid[order], value[order]


def unchanged(batches: Iterator[Columns]) -> Iterator[Columns]:
    yield from batches


def changed(batches: Iterator[Columns]) -> Iterator[Columns]:
    """Valid times differ here, so everything is news; the comparison is what is timed."""
    last = None
    for available, valid, value in batches:
        new = np.empty(len(value), np.bool_)
        new[0] = last is None or (valid[0], value[0]) != last
        new[1:] = (valid[1:] != valid[:-1]) | (value[1:] != value[:-1])
        last = (valid[-1], value[-1])
        yield available[new], valid[new], value[new]


def within_delay(batches: Iterator[Columns]) -> Iterator[Columns]:
    for available, valid, value in batches:
        keep = available - valid <= 10 * MS
        yield available[keep], valid[keep], value[keep]


def within_duration(batches: Iterator[Columns]) -> Iterator[Columns]:
    for available, valid, value in batches:
        keep = (valid >= 1_000 * MS) & (valid <= 900_000 * MS)
        yield available[keep], valid[keep], value[keep]


def monotone(batches: Iterator[Columns]) -> Iterator[Columns]:
    greatest = -1
    for available, valid, value in batches:
        so_far = np.maximum(np.maximum.accumulate(valid), greatest)
        keep = valid == so_far
        greatest = so_far[-1]
        yield available[keep], valid[keep], value[keep]


def every_other(batches: Iterator[Columns]) -> Iterator[Columns]:
    for available, valid, value in batches:
        keep = valid % (2 * MS) == 0
        yield available[keep], valid[keep], value[keep]


def sorted_within_delay(batches: Iterator[Columns]) -> Iterator[Columns]:
    delay, valid, value = 30 * MS, np.empty(0, np.int64), np.empty(0)
    for available, more_valid, more_value in batches:
        valid = np.concatenate((valid, more_valid))
        value = np.concatenate((value, more_value))
        order = np.argsort(valid, kind="stable")
        valid, value = valid[order], value[order]
        due = np.searchsorted(valid, available[-1] - delay, "right")
        yield valid[:due] + delay, valid[:due], value[:due]
        valid, value = valid[due:], value[due:]
    yield valid + delay, valid, value


def resampled(period: int) -> ByHand:
    """Valid times increase and every sample is there in time: one search a batch."""

    def by_hand(batches: Iterator[Columns]) -> Iterator[Columns]:
        delay, begin = 5 * MS, 0
        times, values = np.empty(0, np.int64), np.empty(0)
        for available, valid, value in batches:
            times = np.concatenate((times, valid))
            values = np.concatenate((values, value))
            points = np.arange(begin, available[-1] - delay + 1, period)
            if len(points):
                rows = np.searchsorted(times, points, "right") - 1
                yield points + delay, points, values[rows]
                begin = int(points[-1]) + period
                times, values = times[rows[-1] :], values[rows[-1] :]

    return by_hand


_RECENT = Approximation.MOST_RECENT
CASES = (
    Case("any update", Policy(), unchanged),
    Case("any change", Policy(AnyChange()), changed),
    Case("max delay 10 ms", Policy(max_delay=10 * MS), within_delay, shuffled=True),
    Case("from 1 s to 900 s", Policy(duration=Duration(1_000 * MS, 900_000 * MS)), within_duration),
    Case("monotone order", Policy(order=Order.MONOTONE), monotone, shuffled=True),
    Case("strict order", Policy(order=Order.STRICT), monotone, shuffled=True),
    Case("sample every 2 ms", Policy(SampleEvery(2 * MS)), every_other),
    Case(
        "monotone order, max delay 30 ms",
        Policy(order=Order.MONOTONE, max_delay=30 * MS),
        sorted_within_delay,
        shuffled=True,
    ),
    Case(
        "strict order, max delay 30 ms",
        Policy(order=Order.STRICT, max_delay=30 * MS),
        sorted_within_delay,
        shuffled=True,
    ),
    Case(
        "sample every 3 ms, use most recent",
        Policy(SampleEvery(3 * MS), 5 * MS, Duration(0, to_oo=True), approximation=_RECENT),
        resampled(3 * MS),
    ),
    Case(
        "sample every 0.25 ms, use most recent",
        Policy(SampleEvery(MS // 4), 5 * MS, Duration(0, to_oo=True), approximation=_RECENT),
        resampled(MS // 4),
    ),
)


def adapted(policy: Policy) -> ByHand:
    """The same interface for ours."""

    def run(batches: Iterator[Columns]) -> Iterator[Columns]:
        adaptation = adapt(policy)
        for available, valid, value in batches:
            columns = {"value": Column(FieldType.FLOAT, value)}
            for made in adaptation.push(SampleBatch(available, valid, columns)):
                yield made.available, made.valid, made.columns["value"].values
        if policy.approximation is Approximation.NONE:
            for made in adaptation.end():
                yield made.available, made.valid, made.columns["value"].values

    return run


def cut(columns: Columns, size: int) -> list[Columns]:
    available, valid, value = columns
    starts = range(0, len(available), size)
    return [(available[i : i + size], valid[i : i + size], value[i : i + size]) for i in starts]


def timed(run: ByHand, batches: list[Columns], times: int) -> tuple[float, Columns]:
    """The least seconds of several runs, and what came out."""
    least, made = float("inf"), []
    for _ in range(times):
        begin = time.perf_counter()
        made = list(run(iter(batches)))
        least = min(least, time.perf_counter() - begin)
    joined = tuple(np.concatenate([part[i] for part in made]) for i in range(3))
    return least, (joined[0], joined[1], joined[2])


def main(scale: float = 1.0, times: int = 3) -> int:
    """Print the table; 1 if somewhere the samples passed on are not those of numpy."""
    sizes = ", ".join(f"{size:,}" for size in SIZES)
    print(f"M samples/s in (and x numpy by hand) at batches of {sizes}\n")
    print(f"{'policy':<40}" + "".join(f"{size:>12,}{'x numpy':>9}" for size in SIZES))
    agree = True
    for case in CASES:
        row = f"{case.name:<40}"
        for size, count in SIZES.items():
            count = max(size, int(count * scale))
            batches = cut(samples(count, case.shuffled), size)
            ours, made = timed(adapted(case.policy), batches, times)
            hand, wanted = timed(case.by_hand, batches, times)
            same = all(np.array_equal(a, b) for a, b in zip(made, wanted, strict=True))
            agree &= same
            row += f"{count / ours / 1e6:>12.3f}{hand / ours:>9.2f}{'' if same else ' DIFFERS'}"
        print(row)
    return 0 if agree else 1


if __name__ == "__main__":
    sys.exit(main())
