"""Two stars of patterns joined with static triples over a sliding window, against Oxigraph.

    python bench/queries/two_stars.py [--quick]

The window is [RANGE 10s STEP 1s] at 10,000 triples a second: 12,500 UAVs say where they are, how
fast, how high and whereto, 12,500 stations tell the weather of their region, each once in ten
seconds. The stars meet in the region; 50,000 static triples tell of UAVs, stations and regions.
*here* is the time from the watermark that closes a window to its result in columns; *with rows*
adds pushing the triples of that second, as columns. Oxigraph is asked twice: *fresh* fills a store
with the static triples and the window's, *lasting* keeps one, from which the expired triples are
removed and to which the new ones are added. Their time is that, asking, and counting the solutions;
making the terms is not in it. The numbers of solutions are compared in every window, the solutions
term by term in the last one.
"""

from __future__ import annotations

import gc
import statistics
import sys
import time
from collections import Counter
from dataclasses import dataclass

import numpy as np
from pyoxigraph import Literal, NamedNode, Quad, Store

from dyknow.continuous.evaluation.evaluator import ContinuousEvaluator
from dyknow.continuous.operators.background import Background
from dyknow.continuous.operators.results import WindowResult
from dyknow.languages.csparql import body_sparql, parse_query
from dyknow.rdf.dictionary import TermDictionary
from dyknow.rdf.namespaces import DYKNOW
from dyknow.rdf.timed import Kind, ObjectColumn, TimedTriples, TripleRows

SECOND = 10**9
RANGE = 10
SUBJECTS = 12_500
"""UAVs, stations, and regions."""
AIM = 100
STREAM = DYKNOW + "observations.trdf"
QUERY = f"""REGISTER STREAM Flying COMPUTE EVERY 1s AS
PREFIX dyknow: <{DYKNOW}>
SELECT ?uav ?speed ?station ?wind ?sector
FROM STREAM <{STREAM}> [RANGE {RANGE}s STEP 1s]
WHERE {{
  ?uav dyknow:speed ?speed ; dyknow:altitude ?altitude ; dyknow:heading ?heading .
  ?uav dyknow:in ?region . ?station dyknow:of ?region .
  ?station dyknow:wind ?wind ; dyknow:sight ?sight ; dyknow:degrees ?degrees .
  ?uav dyknow:operator ?operator . ?station dyknow:height ?height .
  ?region dyknow:sector ?sector ; dyknow:floor ?floor .
  %s
}}
"""
FILTERS = {
    "all": "",
    "one in a hundred": "FILTER (?speed > 140 && ?wind > 140)",
}
STARS = {
    "uav": ("speed", "altitude", "heading", "in"),
    "station": ("wind", "sight", "degrees", "of"),
}
"""By kind of subject its predicates: three numbers, then the region."""


@dataclass(frozen=True)
class Second:
    """What comes in one second, as columns and as quads."""

    triples: TimedTriples
    quads: list[Quad]


def iri(name: str) -> NamedNode:
    return NamedNode(DYKNOW + name)


class Data:
    """Static triples, and seconds of observations by chance."""

    def __init__(self) -> None:
        self.random = np.random.default_rng(17)
        self.dictionary = TermDictionary()
        self.regions = self._named("region")
        self.subjects = {star: self._named(star) for star in STARS}
        self.static = [
            *self._facts("uav", "operator", 200),
            *self._facts("station", "height", 50),
            *self._facts("region", "sector", 100),
            *self._facts("region", "floor", 20),
        ]

    def _named(self, kind: str) -> tuple[int, list[NamedNode]]:
        """So many names of a kind, with consecutive ids from the first one on."""
        names = [iri(f"{kind}{i}") for i in range(SUBJECTS)]
        return min(self.dictionary.id(name) for name in names), names

    def _facts(self, kind: str, predicate: str, values: int) -> list[Quad]:
        objects = [iri(f"{predicate}{i}") for i in range(values)]
        drawn = self.random.integers(0, values, SUBJECTS).tolist()
        return [
            Quad(iri(f"{kind}{i}"), iri(predicate), objects[value]) for i, value in enumerate(drawn)
        ]

    def second(self, number: int) -> Second:
        """The observations of (number, number + 1 s]: of a tenth of all subjects."""
        count = SUBJECTS // RANGE
        tables, quads = [], []
        for star, predicates in STARS.items():
            first, names = self.subjects[star]
            some = number % RANGE * count + np.arange(count)
            at = number * SECOND + np.sort(self.random.integers(1, SECOND, count))
            objects = {}
            for predicate in predicates[:3]:
                values = np.round(self.random.uniform(40, 150, count), 2)
                objects[self.dictionary.id(iri(predicate))] = ObjectColumn(Kind.DOUBLE, values)
                quads += [
                    Quad(names[s], iri(predicate), Literal(value))
                    for s, value in zip(some.tolist(), values.tolist(), strict=True)
                ]
            where = self.random.integers(0, SUBJECTS, count)
            start, regions = self.regions
            predicate = iri(predicates[3])
            column = ObjectColumn(Kind.TERM, (where + start).astype(np.int32))
            objects[self.dictionary.id(predicate)] = column
            quads += [
                Quad(names[s], predicate, regions[r])
                for s, r in zip(some.tolist(), where.tolist(), strict=True)
            ]
            tables.append(TripleRows(at, at, (some + first).astype(np.int32), objects))
        return Second(TimedTriples(self.dictionary, tuple(tables)), quads)


class Here:
    """The evaluator, second by second."""

    def __init__(self, text: str, data: Data) -> None:
        store = Store()
        store.bulk_extend(data.static)
        self.evaluator = ContinuousEvaluator(
            parse_query(text), data.dictionary, Background(store), [STREAM]
        )

    def step(self, number: int, second: Second) -> tuple[float, float, WindowResult]:
        """Seconds of the evaluation, the same with pushing, and the window's result."""
        begin = time.perf_counter()
        self.evaluator.push(STREAM, second.triples)
        pushed = time.perf_counter()
        (result,) = self.evaluator.advance(STREAM, (number + 1) * SECOND + 1)
        end = time.perf_counter()
        return end - pushed, end - begin, result


class Lasting:
    """One store that follows the window."""

    def __init__(self, text: str, data: Data) -> None:
        self.sparql = body_sparql(parse_query(text))
        self.store = Store()
        self.store.bulk_extend(data.static)

    def step(self, expired: Second | None, second: Second) -> tuple[float, int]:
        """Seconds, and how many solutions the window has."""
        begin = time.perf_counter()
        if expired is not None:
            for quad in expired.quads:
                self.store.remove(quad)
        self.store.extend(second.quads)
        count = sum(1 for _ in self.store.query(self.sparql))
        return time.perf_counter() - begin, count


def fresh(text: str, data: Data, window: list[Second]) -> tuple[float, int]:
    """Seconds with a store of its own for the window, and how many solutions it has."""
    sparql = body_sparql(parse_query(text))
    begin = time.perf_counter()
    store = Store()
    store.bulk_extend(data.static)
    for second in window:
        store.bulk_extend(second.quads)
    count = sum(1 for _ in store.query(sparql))
    return time.perf_counter() - begin, count


def equal(result: WindowResult, lasting: Lasting) -> bool:
    """Whether the window has the same solutions here and there, each as often."""
    solutions = result.solutions
    assert solutions is not None
    names = solutions.variables
    found = Counter(tuple(row[name] for name in names) for row in solutions.rows())
    wanted = Counter(
        tuple(row[name] for name in names) for row in lasting.store.query(lasting.sparql)
    )
    return found == wanted


def row(name: str, condition: str, measured: int) -> bool:
    """Print one line of the table; whether the solutions are the same."""
    data, text = Data(), QUERY % condition
    seconds = [data.second(number) for number in range(RANGE + measured)]
    ours, theirs = Here(text, data), Lasting(text, data)
    # One after the other: each has the caches of the processor for itself.
    steps = [ours.step(number, second) for number, second in enumerate(seconds)]
    agree, slow, fills = True, [], []
    for number, second in enumerate(seconds):
        spent, count = theirs.step(seconds[number - RANGE] if number >= RANGE else None, second)
        slow.append(spent)
        agree &= count == steps[number][2].size
    agree &= equal(steps[-1][2], theirs)
    for _ in range(3):
        spent, count = fresh(text, data, seconds[-RANGE:])
        fills.append(spent)
        agree &= count == steps[-1][2].size
    evaluations, whole, results = zip(*steps, strict=True)
    # The first windows are not full.
    here, rows, lasting = (
        statistics.median(times[RANGE:]) * 1e3 for times in (evaluations, whole, slow)
    )
    filled = statistics.median(fills) * 1e3
    speed = 8 * SUBJECTS / rows / 1e3
    print(
        f"{name:<18}{results[-1].size:>8,}{here:>8.2f}{rows:>11.2f}{speed:>8.1f}"
        f"{lasting:>10.1f}{lasting / rows:>8.1f}{filled:>10.1f}{filled / rows:>8.1f}"
        f"{'' if lasting >= AIM * rows else ' (aim missed)'}",
        flush=True,
    )
    return agree


def main(quick: bool = False) -> int:
    """Print the table."""
    # The quads of a second are many objects: collecting them is nobody's evaluation (as `timeit`).
    gc.disable()
    print(f"two stars, {8 * SUBJECTS:,} triples a window, {4 * SUBJECTS:,} static;")
    print("ms an evaluation, median; million triples of the window a second")
    print(f"{'solutions':<18}{'number':>8}{'here':>8}{'with rows':>11}{'M/s':>8}", end="")
    print(f"{'lasting':>10}{'ratio':>8}{'fresh':>10}{'ratio':>8}")
    agree = True
    for name, condition in FILTERS.items():
        agree &= row(name, condition, 5 if quick else 20)
    print(f"same solutions: {agree}")
    return 0 if agree else 1


if __name__ == "__main__":
    sys.exit(main("--quick" in sys.argv[1:]))
