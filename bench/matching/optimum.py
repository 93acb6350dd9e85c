"""Plans of least weight and best quality over generated libraries: time, share proven, memory.

Run by ``python bench/matching/optimum.py``. A library of m producers has m / 3 goals in 8 layers.
The inputs of a producer come from the layer below, one in ten from any lower layer (diamonds), one
in twenty from the same or a higher one (cycles); goals of the lowest layer are had without inputs.
Weights are uniform in 0 … 10, and one producer in ten is free. *Near*: inputs come from within 5
places of the producer's own, so that much is shared. Roots are of the top layer. 20 libraries a
row, from fixed seeds. Time: of the process, once loops are compiled. Memory: the most that Python
and numpy held at once (tracemalloc) for one library more; not what compiled loops hold while they
run.
"""

from __future__ import annotations

import statistics
import time
import tracemalloc
from dataclasses import dataclass

import numpy as np

from dyknow.matching.optimum.best_quality import best_quality
from dyknow.matching.optimum.hypergraph import Choice, Hypergraph
from dyknow.matching.optimum.least_weight import least_weight

SIZES = (100, 1_000, 10_000)
SEEDS = 20
ALTERNATIVES, DEPTH, FREE, NEAR = 3, 8, 0.1, 5


@dataclass(frozen=True)
class Kind:
    name: str
    least: int
    most: int
    roots: int = 1
    near: bool = False


KINDS = (
    Kind("1 input", 1, 1),
    Kind("1–2 inputs", 1, 2),
    Kind("1–3 inputs", 1, 3),
    Kind("1–3 inputs, near", 1, 3, near=True),
    Kind("1–3 inputs, 3 roots", 1, 3, roots=3),
    Kind("1–3 inputs, 3 roots, near", 1, 3, roots=3, near=True),
    Kind("2–3 inputs, near", 2, 3, near=True),
    Kind("2–3 inputs", 2, 3),
)


def library(kind: Kind, size: int, seed: int) -> tuple[Hypergraph, list[int]]:
    random = np.random.default_rng((seed, size, kind.least, kind.most, kind.roots, kind.near))
    goals = size // ALTERNATIVES
    layers = np.sort(np.arange(goals) % DEPTH)
    first = np.searchsorted(layers, np.arange(DEPTH + 1))
    derives = np.minimum(np.arange(size) // ALTERNATIVES, goals - 1)
    inputs: list[int] = []
    starts = [0]
    for goal in derives.tolist():
        if layers[goal] > 0:
            count = int(random.integers(kind.least, kind.most + 1))
            inputs += [_input(random, kind, goal, layers[goal], first) for _ in range(count)]
        starts.append(len(inputs))
    weights = random.uniform(0, 10, size)
    weights[random.random(size) < FREE] = 0
    top = np.arange(first[DEPTH - 1], goals)
    begin = int(random.integers(0, len(top) - kind.roots + 1))
    roots = top[begin : begin + kind.roots] if kind.near else random.choice(top, kind.roots, False)
    graph = Hypergraph(
        goals,
        derives.astype(np.int32),
        np.array(starts, np.int32),
        np.array(inputs, np.int32),
        weights,
        random.random(size),
    )
    return graph, roots.tolist()


def _input(
    random: np.random.Generator, kind: Kind, goal: int, layer: int, first: np.ndarray
) -> int:
    chance, source = random.random(), layer - 1
    if chance > 0.95:
        source = int(random.integers(layer, DEPTH))
    elif chance > 0.85:
        source = int(random.integers(0, layer))
    low, high = int(first[source]), int(first[source + 1])
    if kind.near:
        width = int(first[layer + 1] - first[layer])
        middle = low + (goal - int(first[layer])) * (high - low) // width
        low, high = max(low, middle - NEAR), min(high, middle + NEAR + 1)
    return int(random.integers(low, high))


def row(kind: Kind, size: int) -> str:
    spent, plans, qualities = [], [], []
    for seed in range(SEEDS):
        graph, roots = library(kind, size, seed)
        begin = time.process_time()
        plan = least_weight(graph, roots)
        spent.append(1e3 * (time.process_time() - begin))
        begin = time.process_time()
        best_quality(graph, roots)
        qualities.append(1e3 * (time.process_time() - begin))
        if plan is not None:
            plans.append(plan)
    gaps = [gap(plan) for plan in plans if not plan.proven]
    graph, roots = library(kind, size, 0)
    tracemalloc.start()
    least_weight(graph, roots)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    cells = (
        f"{size:,}",
        kind.name,
        f"{statistics.median(len(plan.producers) for plan in plans):.0f}",
        f"{statistics.median(spent):.1f}",
        f"{max(spent):.1f}",
        f"{sum(plan.proven for plan in plans)} / {len(plans)}",
        f"{statistics.median(gaps):.1%}" if gaps else "",
        f"{peak / 2**20:.1f}",
        f"{statistics.median(qualities):.1f}",
    )
    return "| " + " | ".join(cells) + " |"


def gap(plan: Choice) -> float:
    return (plan.value - plan.bound) / plan.value


HEADINGS = (
    "producers",
    "library",
    "plan",
    "median ms",
    "worst ms",
    "proven",
    "median gap else",
    "peak MiB",
    "best quality, ms",
)


def main() -> None:
    graph, roots = library(KINDS[-1], 100, 0)
    least_weight(graph, roots)
    best_quality(graph, roots)
    print("| " + " | ".join(HEADINGS) + " |")
    print("|---:|---|" + "---:|" * (len(HEADINGS) - 2))
    for size in SIZES:
        for kind in KINDS:
            print(row(kind, size), flush=True)


if __name__ == "__main__":
    main()
