"""Registered queries that differ in constants: a step with what they share, and each by itself.

Run by ``make bench`` (``python bench/queries/queries.py``). One process, one core, medians; two
engines that take steps in turns. 1,000 UAVs with a sample a second each, window [RANGE 5s STEP 1s].
Queries differ in a threshold on an average (3 %, 0.3 % or none of the UAVs are above it), or on
each sample, or each is about a UAV of its own. A step publishes a second of samples, closes a
window, makes the samples of all queries and keeps their results.
"""

from __future__ import annotations

import argparse
import gc
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass

from requests import STEPS, UAVS, WARM, Speeds

from dyknow.converters.wire import Incoming
from dyknow.engine.engine import Engine
from dyknow.engine.planning import query_sharing

STREAM = "FROM STREAM <http://www.ida.liu.se/dyknow/speeds.trdf> [RANGE 5s STEP 1s]"


def average(least: float) -> Callable[[float], str]:
    return lambda part: (
        f"SELECT ?o (AVG(?v) AS ?mean) {STREAM} WHERE {{ ?o a dyknow:UAV ; dyknow:speed ?v }} "
        f"GROUP BY ?o HAVING (?mean > {least + 2e-3 * part:.9f})"
    )


def sample(part: float) -> str:
    limit = 99.7 + 2e-3 * part
    return f"SELECT ?o ?v {STREAM} WHERE {{ ?o dyknow:speed ?v FILTER (?v > {limit:.9f}) }}"


def one_object(part: float) -> str:
    name = f"dyknow:uav{round(part * UAVS)}"
    return f"SELECT ?v {STREAM} WHERE {{ {name} dyknow:speed ?v FILTER (?v > 97) }}"


KINDS = {
    "limit of an average, 3 %": average(97),
    "limit of an average, 0.3 %": average(99.7),
    "limit of an average, none": average(100),
    "limit of samples, 0.3 %": sample,
    "object": one_object,
}


@dataclass
class Side:
    """An engine with its queries, and what its steps have taken (ms)."""

    engine: Engine
    registering: float
    taken: list[float]

    @classmethod
    def of(cls, texts: list[str], least: int) -> Side:
        usual, query_sharing.MIN_SHARED = query_sharing.MIN_SHARED, least
        try:
            engine = Engine()
            engine.annotate("stream speeds contains speed(UAV) = v for every UAV = id")
            begin = time.perf_counter()
            for i, text in enumerate(texts):
                # Nothing is remembered of a text that was read for the other engine.
                engine.queries.register(f"REGISTER QUERY q{i} AS {text} # {least}")
            return cls(engine, (time.perf_counter() - begin) / len(texts) * 1e3, [])
        finally:
            query_sharing.MIN_SHARED = usual

    def step(self, incoming: Incoming) -> None:
        begin = time.perf_counter()
        self.engine.publish("speeds", incoming, 0)
        self.taken.append((time.perf_counter() - begin) * 1e3)

    def rows(self) -> int:
        """How many solutions the last window has, of all queries."""
        names = (view.name for view in self.engine.queries.views())
        return sum(self.engine.queries.latest(name).size for name in names)


def measured(kind: str, queries: int) -> tuple[Side, Side]:
    texts = [KINDS[kind](i / queries) for i in range(queries)]
    sides = Side.of(texts, query_sharing.MIN_SHARED), Side.of(texts, queries + 1)
    speeds = Speeds()
    for second in range(WARM + STEPS):
        incoming = Incoming(speeds.of(second), False)
        for side in sides[:: 1 if second % 2 else -1]:
            side.step(incoming)
    return sides


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="few queries")
    sizes = (4, 10, 100) if parser.parse_args().quick else (4, 10, 100, 1_000)
    print(f"queries that differ in constants, {UAVS:,} UAVs, a sample a second each; medians, ms")
    print(
        f"{'queries differ in':<28}{'queries':>8}{'rows':>8}{'a step':>9}{'each':>9}"
        f"{'ratio':>7}{'to register':>13}{'each':>7}"
    )
    for kind in KINDS:
        for queries in sizes:
            shared, alone = measured(kind, queries)
            rows = shared.rows()
            assert rows == alone.rows()
            step, each = (statistics.median(side.taken[WARM:]) for side in (shared, alone))
            print(
                f"{kind:<28}{queries:>8,}{rows:>8,}{step:>9.1f}{each:>9.1f}{each / step:>7.1f}"
                f"{shared.registering:>13.1f}{alone.registering:>7.1f}",
                flush=True,
            )
            del shared, alone
            gc.collect()


if __name__ == "__main__":
    main()
