"""How long ontologies take to load that are hierarchies of classes.

    python bench/matching/hierarchies.py

Each is loaded beside the shipped ontologies, in a process of its own: processor seconds until it is
loaded (read, closed, in the store), triples that it entails, and MB that the process has then.
"""

from __future__ import annotations

import multiprocessing
import resource
import time
from collections.abc import Callable

from dyknow.ontology.graphs import ENTAILMENTS
from dyknow.ontology.ontology import Ontology

CLASS = ("a owl:Class", "rdfs:subClassOf", "Vehicle")
FEATURE = ("a :UnaryFeature, owl:DatatypeProperty", "rdfs:subPropertyOf", "speed")
SHAPES: dict[str, tuple[tuple[str, str, str], int, Callable[[int], int]]] = {
    "100 classes in a chain": (CLASS, 100, lambda number: number - 1),
    "300 classes in a chain": (CLASS, 300, lambda number: number - 1),
    "2,000 classes in a chain": (CLASS, 2_000, lambda number: number - 1),
    "300 classes in a chain, individuals that are the same": (
        CLASS,
        300,
        lambda number: number - 1,
    ),
    "2,000 classes in a binary tree": (CLASS, 2_000, lambda number: (number - 1) // 2),
    "2,000 features in a chain": (FEATURE, 2_000, lambda number: number - 1),
}
BESIDE = {
    "300 classes in a chain, individuals that are the same": (
        "dyknow:a owl:sameAs dyknow:a2 ; a dyknow:N299 . dyknow:last a owl:FunctionalProperty . "
        "dyknow:a dyknow:last dyknow:b, dyknow:c ."
    )
}
"""What is said of individuals beside a hierarchy."""


def text_of(kind: tuple[str, str, str], size: int, above: Callable[[int], int]) -> str:
    """Classes or features with labels, each under another one."""
    lines, (type, under, top) = [], kind
    for number in range(size):
        upper = f"N{above(number)}" if number else top
        lines.append(f'dyknow:N{number} {type} ; rdfs:label "N{number}" ; {under} dyknow:{upper} .')
    return "\n".join(lines)


def entailed_by(ontology: Ontology) -> int:
    return sum(1 for _ in ontology.store.quads_for_pattern(None, None, None, ENTAILMENTS))


def measure(name: str) -> tuple[float, int, float]:
    ontology = Ontology.open()
    text = f"{text_of(*SHAPES[name])}\n{BESIDE.get(name, '')}"
    entailed = -entailed_by(ontology)
    begin = time.process_time()
    ontology.load(text, name="hierarchy")
    seconds = time.process_time() - begin
    entailed += entailed_by(ontology)
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
