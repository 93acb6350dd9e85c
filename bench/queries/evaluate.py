"""``dyknow.evaluate`` from Python terms, from an iterator of them, and from a table of columns.

Run by ``make bench`` (``python bench/queries/evaluate.py``). One process, one core; processor time.
The query averages the speeds of 1,000 objects over five seconds, each second, and reports few of
them. *distinct*: each number is a literal of its own; *repeated*: the literals of 1,000 numbers,
again and again.
"""

from __future__ import annotations

import random
import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from pyoxigraph import Literal, NamedNode

import dyknow

SECOND = 10**9
STREAM, SPEED = "http://bench.example/s", "http://bench.example/speed"
QUERY = f"""REGISTER QUERY fast COMPUTE EVERY 1s AS
SELECT ?o (AVG(?v) AS ?mean) FROM STREAM <{STREAM}> [RANGE 5s STEP 1s]
WHERE {{ ?o <{SPEED}> ?v }} GROUP BY ?o HAVING (?mean > 195)"""
OBJECTS = 1_000
SECONDS = 40 if "--quick" in sys.argv else 400
ROUNDS = 3


def rate(given: Callable[[], Any]) -> float:
    """Triples a second of processor time, the best of some rounds."""
    best = 0.0
    for _ in range(ROUNDS):
        stream = given()
        began = time.process_time()
        windows = sum(1 for _ in dyknow.evaluate(QUERY, streams={STREAM: stream}))
        best = max(best, OBJECTS * SECONDS / (time.process_time() - began))
        assert windows
    return best


def main() -> None:
    """Print the table."""
    chance = random.Random(1)
    speeds = [round(chance.random() * 200, 3) for _ in range(OBJECTS * SECONDS)]
    times = [t * SECOND for t in range(SECONDS) for _ in range(OBJECTS)]
    names = [NamedNode(f"http://bench.example/o{i}") for i in range(OBJECTS)] * SECONDS
    predicates = [NamedNode(SPEED)] * len(times)
    repeated = list(map(Literal, speeds[:OBJECTS])) * SECONDS
    distinct = list(zip(times, names, predicates, map(Literal, speeds), strict=True))
    again = list(zip(times, names, predicates, repeated, strict=True))
    columns = np.array(times), np.array(speeds)

    def table() -> Any:
        return dyknow.timed_triples(columns[0], names, {SPEED: columns[1]})

    began = time.process_time()
    table()
    made = len(times) / (time.process_time() - began)
    cases: dict[str, Callable[[], Any]] = {
        "terms, distinct": lambda: distinct,
        "terms, repeated": lambda: again,
        "an iterator of terms": lambda: iter(distinct),
        "a table": table,
    }
    print(f"dyknow.evaluate, {OBJECTS:,} objects, {SECONDS} s: million triples a second")
    for name, given in cases.items():
        print(f"  {name:24} {rate(given) / 1e6:6.2f}")
    print(f"  {'making the table':24} {made / 1e6:6.2f}")


if __name__ == "__main__":
    main()
