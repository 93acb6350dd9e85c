"""Semantic matching over generated libraries of transformations: time and peak memory.

Run by ``python bench/matching/matching.py``. A library of m transformations gives m / 3 features in
8 layers, 3 transformations each, of 1 to 3 inputs from the layer below; one input in ten is from
any lower layer (diamonds), one in a hundred from the same or a higher one (cycles). The features of
the lowest layer stand in streams of every UAV. *Near*: inputs come from features close by, so that
much is shared. Costs are uniform in 1 … 10, qualities in 0.5 … 1. 20 libraries a row, from fixed
seeds; the first match of each, of a feature of the top layer, without explanation. Time: of the
process, once loops are compiled. Memory: the most that Python held at once for the match
(tracemalloc).
"""

from __future__ import annotations

import statistics
import time
import tracemalloc

import numpy as np

from dyknow.languages.ssl.annotation import Content, PortAnnotation, Role
from dyknow.matching.match import match_all
from dyknow.matching.space import (
    StreamDescription,
    StreamSpace,
    TransformationDescription,
)
from dyknow.matching.tree import Match
from dyknow.matching.want import Want
from dyknow.ontology.ontology import Ontology
from dyknow.rdf.namespaces import DYKNOW

SIZES = (100, 1_000, 10_000)
SEEDS = 20
ALTERNATIVES, DEPTH, NEAR = 3, 8, 5
AIMS = {"fast": (1, 3, 10), "cost": (100, 100, 100), "quality": (100, 100, 100)}
"""Milliseconds, for each size."""


def library(size: int, seed: int, *, near: bool) -> tuple[StreamSpace, Want]:
    """A stream space, and the want of a feature of its top layer."""
    random = np.random.default_rng((seed, size, near))
    features = size // ALTERNATIVES
    layers = np.sort(np.arange(features) % DEPTH)
    first = np.searchsorted(layers, np.arange(DEPTH + 1))
    names = [f"{DYKNOW}f{i}" for i in range(features)]
    units = []
    for number in range(size):
        made = min(number // ALTERNATIVES, features - 1)
        layer = int(layers[made])
        if layer == 0:
            continue
        chosen = {
            _input(random, made, layer, first, near=near) for _ in range(random.integers(1, 4))
        }
        ports = tuple(PortAnnotation(f"x{i}", names[i], ()) for i in sorted(chosen))
        units.append(
            TransformationDescription(
                f"t{number}",
                ports,
                PortAnnotation("y", names[made], ()),
                float(random.uniform(1, 10)),
                float(random.uniform(0.5, 1)),
            )
        )
    role = Role(DYKNOW + "UAV", None, "id")
    streams = [
        StreamDescription(f"s{i}", (Content(names[i], "v", (), (role,)),))
        for i in range(int(first[1]))
    ]
    want = Want(names[int(random.integers(first[DEPTH - 1], features))], DYKNOW + "UAV")
    return StreamSpace(streams, units), want


def _input(
    random: np.random.Generator, made: int, layer: int, first: np.ndarray, *, near: bool
) -> int:
    dice = random.random()
    if dice < 0.01:
        return int(random.integers(first[layer], first[DEPTH]))
    below = int(random.integers(0, layer)) if dice < 0.11 else layer - 1
    low, high = int(first[below]), int(first[below + 1])
    if near:
        middle = low + (made - int(first[layer])) % (high - low)
        low, high = max(low, middle - NEAR), min(high, middle + NEAR + 1)
    return int(random.integers(low, high))


def main() -> None:
    """Print the table."""
    vocabulary = Ontology.open(None).vocabulary
    space, want = library(100, 0, near=True)
    for strategy in AIMS:  # compile, or load what was compiled
        match_all([want], space, vocabulary, strategy, explained=False)
    print(
        f"{'transformations':>15} {'inputs':<8} {'strategy':<8} {'found':>7} {'median ms':>10} "
        f"{'worst ms':>9} {'proven':>7} {'peak MiB':>9} {'aim ms':>7}"
    )
    for place, size in enumerate(SIZES):
        for near in (False, True):
            for strategy, aims in AIMS.items():
                times, found, memory = [], [], 0.0
                for seed in range(SEEDS):
                    space, want = library(size, seed, near=near)
                    begin = time.process_time()
                    (answer,) = match_all([want], space, vocabulary, strategy, explained=False)
                    times.append((time.process_time() - begin) * 1e3)
                    found.append(answer)
                tracemalloc.start()
                match_all([want], space, vocabulary, strategy, explained=False)
                memory = tracemalloc.get_traced_memory()[1] / 2**20
                tracemalloc.stop()
                print(_row(size, near, strategy, found, times, memory, aims[place]), flush=True)


def _row(
    size: int,
    near: bool,
    strategy: str,
    found: list[Match],
    times: list[float],
    memory: float,
    aim: int,
) -> str:
    plans = sum(answer.supply is not None for answer in found)
    proven = sum(answer.proven for answer in found)
    median, worst = statistics.median(times), max(times)
    missed = " (missed)" if median > aim else ""
    return (
        f"{size:>15,} {'near' if near else 'any':<8} {strategy:<8} {plans:>4}/{SEEDS} "
        f"{median:>10.1f} {worst:>9.1f} {proven:>4}/{SEEDS} {memory:>9.1f} {aim:>7}{missed}"
    )


if __name__ == "__main__":
    main()
