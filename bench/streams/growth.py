"""Whether the cost of a batch, and the memory, hold as history grows.

Run by ``make bench`` (``python bench/streams/growth.py``). One process, one core. Batches of 10,000
samples of each input; the least time of ten batches at the start and after a million samples of
each input. Memory is what the process still holds (tracemalloc, in a run of its own) once what came
out is let go.
"""

from __future__ import annotations

import gc
import time
import tracemalloc
from collections.abc import Callable
from dataclasses import dataclass

from joining import DELAY, inputs
from measure import MS, Round, batch_of, cut
from policies import in_order, recent, shuffled

from dyknow.streams.generator import StreamGenerator
from dyknow.streams.history import Retention
from dyknow.streams.joins.join import Join
from dyknow.streams.policies.policy import (
    AnyChange,
    Approximation,
    Change,
    Duration,
    Order,
    Policy,
    SampleEvery,
    SynchronizationPolicy,
)
from dyknow.streams.policies.select_adaptation import adapt
from dyknow.streams.sample import Field, FieldType, Schema
from dyknow.streams.synchronization.synchronization import Synchronization

SIZE, HISTORY, ROUNDS = 10_000, 1_000_000, 10

Push = Callable[[Round], object]


@dataclass(frozen=True)
class Process:
    name: str
    data: Callable[[int], Round]
    start: Callable[[], Push]


def of_one(policy: Policy) -> Callable[[], Push]:
    def start() -> Push:
        adaptation = adapt(policy)
        return lambda samples: adaptation.push(batch_of(samples[0]))

    return start


def of_many(make: Callable[[], Join | Synchronization]) -> Callable[[], Push]:
    def start() -> Push:
        process = make()
        return lambda round: [process.push(i, batch_of(one)) for i, one in enumerate(round)]

    return start


def states(change: Change) -> Callable[[], Push]:
    policy = SynchronizationPolicy(
        change, DELAY, Duration(0), Order.MONOTONE, Approximation.MOST_RECENT
    )
    return of_many(lambda: Synchronization(policy, [True] * 5))


def generator() -> Push:
    schema = Schema((Field("value", FieldType.FLOAT),))
    made = StreamGenerator("history", schema, retention=Retention(samples=100_000))
    return lambda samples: made.offer(batch_of(samples[0]))


PROCESSES = (
    Process("any change", in_order, of_one(Policy(AnyChange()))),
    Process("sample every 1 ms", in_order, of_one(Policy(SampleEvery(MS)))),
    Process(
        "monotone order, max delay 30 ms",
        shuffled,
        of_one(Policy(order=Order.MONOTONE, max_delay=30 * MS)),
    ),
    Process("sample every 3 ms, use most recent", in_order, of_one(recent(3 * MS))),
    Process("join of 3", inputs(3), of_many(lambda: Join(3))),
    Process("states of 5, sample every 5 ms", inputs(5), states(SampleEvery(5 * MS))),
    Process("states of 5, any change", inputs(5), states(AnyChange())),
    Process("generator that keeps 100,000 samples", in_order, generator),
)


def rounds_of(process: Process) -> list[Round]:
    whole = process.data(HISTORY + ROUNDS * SIZE)
    return cut(whole, SIZE)


def times(process: Process) -> tuple[float, float]:
    """Seconds a round at the start (without the first, that warms up), and at the end."""
    rounds = rounds_of(process)
    push, spent = process.start(), []
    for round in rounds:
        begin = time.perf_counter()
        push(round)
        spent.append(time.perf_counter() - begin)
    return min(spent[1 : ROUNDS + 1]), min(spent[-ROUNDS:])


def held(process: Process) -> tuple[int, int]:
    """Bytes held after ten rounds, and after a million samples of each input."""
    rounds = rounds_of(process)
    tracemalloc.start()
    push = process.start()
    found = []
    for number, views in enumerate(rounds, 1):
        # Copies, as batches that have just come: a view of `rounds` would not be counted.
        push(tuple((samples[0].copy(), samples[1].copy(), samples[2].copy()) for samples in views))
        if number in (ROUNDS, HISTORY // SIZE):
            gc.collect()
            found.append(tracemalloc.get_traced_memory()[0])
    tracemalloc.stop()
    return found[0], found[1]


def main() -> None:
    """Print the table."""
    print(f"{'':<40}{'ms a batch of 10,000':>26}{'KB held':>20}")
    print(f"{'':<40}{'at the start':>13}{'after 1M':>13}{'after 0.1M':>11}{'1M':>9}")
    for process in PROCESSES:
        early, late = times(process)
        begin, end = held(process)
        print(
            f"{process.name:<40}{early * 1e3:>13.3f}{late * 1e3:>13.3f}"
            f"{begin / 1e3:>11,.1f}{end / 1e3:>9,.1f}",
            flush=True,
        )


if __name__ == "__main__":
    main()
