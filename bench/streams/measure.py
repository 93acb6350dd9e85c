"""What the tables of streams share: data in batches, two programs on it, the least of several runs.

A program takes *rounds*, each a batch of every input, and gives arrays. Both programs of a row get
the same rounds in the same process, in turns, and must give equal arrays.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from dyknow.streams.sample import Column, FieldType, SampleBatch

MS = 10**6
SIZES = {10_000: 1_000_000, 100: 100_000, 1: 5_000}
"""Samples of each input, by samples a batch."""
AIM = 1 / 3
"""Of numpy's speed, at the largest batches."""

Samples = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Available times, valid times, values of one input."""
Round = tuple[Samples, ...]
Arrays = tuple[np.ndarray, ...]
Program = Callable[[Iterable[Round]], Iterator[Arrays]]


@dataclass(frozen=True)
class Row:
    """One line of a table: our program against the same by hand."""

    name: str
    ours: Program
    by_hand: Program
    data: Callable[[int], Round]
    trivial: bool = False
    """By hand there is nothing to do, so a ratio would say nothing."""
    scale: float = 1.0
    """Of the usual number of samples: less for what is slow."""


def cut(inputs: Round, size: int) -> list[Round]:
    """Batches of ``size`` samples of each input."""
    starts = range(0, max(len(samples[0]) for samples in inputs), size)
    return [tuple(part(samples, i, i + size) for samples in inputs) for i in starts]


def part(samples: Samples, start: int, stop: int | None) -> Samples:
    available, valid, value = samples
    return available[start:stop], valid[start:stop], value[start:stop]


def batch_of(samples: Samples) -> SampleBatch:
    """The samples as the kernel takes them: one float each."""
    available, valid, value = samples
    return SampleBatch(available, valid, {"value": Column(FieldType.FLOAT, value)})


def seconds(program: Program, rounds: list[Round]) -> tuple[float, list[Arrays]]:
    begin = time.perf_counter()
    made = list(program(rounds))
    return time.perf_counter() - begin, made


def together(made: list[Arrays]) -> Arrays:
    return tuple(np.concatenate(column) for column in zip(*made, strict=True))


def compare(row: Row, inputs: Round, size: int, times: int) -> tuple[float, float, bool]:
    """Samples a second of all inputs, the same relative to numpy, whether the results agree."""
    rounds = cut(inputs, size)
    found = together(seconds(row.ours, rounds)[1])
    wanted = together(seconds(row.by_hand, rounds)[1])
    same = len(found) == len(wanted) and all(
        np.array_equal(a, b, equal_nan=b.dtype.kind == "f")
        for a, b in zip(found, wanted, strict=True)
    )
    ours = hand = float("inf")
    for _ in range(times):
        ours = min(ours, seconds(row.ours, rounds)[0])
        hand = min(hand, seconds(row.by_hand, rounds)[0])
    count = sum(len(samples[0]) for samples in inputs)
    return count / ours, hand / ours, same


def print_table(title: str, rows: Iterable[Row], times: int) -> bool:
    """Print the table; whether everywhere what was made is what numpy made."""
    print(f"{'':<50}" + "".join(f"{'batches of ' + format(size, ','):>20}" for size in SIZES))
    print(f"{title:<50}" + f"{'M/s':>11}{'x numpy':>9}" * len(SIZES))
    agree = True
    for row in rows:
        line = f"{row.name:<50}"
        for size, count in SIZES.items():
            inputs = row.data(max(size, int(count * row.scale)))
            speed, ratio, same = compare(row, inputs, size, times)
            agree &= same
            missed = not row.trivial and size == max(SIZES) and (ratio < AIM or speed < 1e6)
            line += f"{speed / 1e6:>11.3f}{'-' if row.trivial else format(ratio, '.2f'):>9}"
            line += ("" if same else " DIFFERS") + (" (aim missed)" if missed else "")
        print(line, flush=True)
    print()
    return agree
