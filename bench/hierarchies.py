"""How long ontologies take to load that are hierarchies of classes: `python bench/hierarchies.py`.

Each is loaded beside the shipped ontologies, in a process of its own: seconds until it is loaded
(read, closed, in the store), triples that it entails, and MB that the process has then.
"""

from __future__ import annotations

import multiprocessing
import resource
import time
from collections.abc import Callable

from dyknow.ontology.ontology import Ontology

SHAPES: dict[str, tuple[int, Callable[[int], int]]] = {
    "100 classes in a chain": (100, lambda number: number - 1),
    "300 classes in a chain": (300, lambda number: number - 1),
    "2,000 classes in a chain": (2_000, lambda number: number - 1),
    "2,000 classes in a binary tree": (2_000, lambda number: (number - 1) // 2),
}


def text_of(classes: int, above: Callable[[int], int]) -> str:
    """Classes with labels, each under another one; the first under dyknow:Vehicle."""
    lines = []
    for number in range(classes):
        upper = f"C{above(number)}" if number else "Vehicle"
        lines.append(
            f'dyknow:C{number} a owl:Class ; rdfs:label "C{number}" ; '
            f"rdfs:subClassOf dyknow:{upper} ."
        )
    return "\n".join(lines)


def measure(name: str) -> tuple[float, int, float]:
    classes, above = SHAPES[name]
    ontology = Ontology.open()
    text = text_of(classes, above)
    before = len(ontology.store)
    begin = time.perf_counter()
    ontology.load(text, name="hierarchy")
    seconds = time.perf_counter() - begin
    entailed = (len(ontology.store) - before) // 2 - 3 * classes
    return seconds, entailed, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def main() -> None:
    """Prints the table."""
    print("| hierarchy | s | entailed triples | MB |\n|---|---|---|---|")
    spawning = multiprocessing.get_context("spawn")
    for name in SHAPES:
        with spawning.Pool(1) as pool:
            seconds, entailed, size = pool.apply(measure, (name,))
        print(f"| {name} | {seconds:.2f} | {entailed:,} | {size:.0f} |", flush=True)


if __name__ == "__main__":
    main()
