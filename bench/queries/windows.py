"""What a step of a sliding aggregate costs: by the length of the window, by what is touched.

Run by ``make bench`` (``python bench/queries/windows.py``). One process, one core. Batches of a
step each; the windows are evaluated as they close. *ratio* is to the first row of its table. The
worst step is given beside the mean: none may pay for the whole window. Times are CPU time of the
process: by the clock, the worst steps are those in which another process had the core. Once all is
imported, the garbage collector is told to leave it alone, as the service does: a full collection
takes 60 to 80 ms otherwise, in whichever step it falls.
"""

from __future__ import annotations

import gc
import resource
import statistics
import sys
import time
import tracemalloc
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np
from pyoxigraph import NamedNode, Store

from dyknow.continuous.algebra.options import Options, Semantics
from dyknow.continuous.evaluation.evaluator import ContinuousEvaluator
from dyknow.continuous.incremental import aggregation
from dyknow.continuous.operators.background import Background
from dyknow.continuous.windows import window_schedule
from dyknow.converters.wire import Incoming
from dyknow.engine.engine import Engine
from dyknow.engine.model.views import StreamDeclaration
from dyknow.languages.csparql import parse_query
from dyknow.rdf.dictionary import TermDictionary
from dyknow.rdf.namespaces import DYKNOW
from dyknow.rdf.timed import Kind, ObjectColumn, TimedTriples, TripleRows
from dyknow.streams.sample import Column, Field, FieldType, SampleBatch
from dyknow.streams.string_pool import StringPool

Shape: TypeAlias = tuple[str, dict[str, Any]]
Asked: TypeAlias = tuple[str, Semantics]
SECOND = 10**9
PLACE = "http://bench.example/"
STREAM = PLACE + "s"
SPEED = NamedNode(PLACE + "speed")


class Query:
    """One aggregate by object over seconds of samples."""

    def __init__(
        self,
        function: str,
        range: int,
        objects: int,
        having: str = "",
        semantics: Semantics = "bag",
    ) -> None:
        text = (
            f"REGISTER QUERY q AS SELECT ?o ({function}(?v) AS ?a) "
            f"FROM STREAM <{STREAM}> [RANGE {range}s STEP 1s] "
            f"WHERE {{ ?o <{SPEED.value}> ?v }} GROUP BY ?o {having}"
        )
        self.dictionary = TermDictionary()
        self.first = len(self.dictionary)
        for i in np.arange(objects).tolist():
            self.dictionary.id(NamedNode(f"{PLACE}o{i}"))
        self.speed = self.dictionary.id(SPEED)
        self.objects = objects
        self.random = np.random.default_rng(5)
        self.second = 0
        self.evaluator = ContinuousEvaluator(
            parse_query(text),
            self.dictionary,
            Background(Store()),
            [STREAM],
            Options(semantics),
        )

    def steps(self, count: int, rows: int, *, in_turn: bool = False) -> Iterator[float]:
        """Seconds of CPU time of each of the next ``count`` steps, with ``rows`` samples each.

        They are of any objects, or of all objects in turn.
        """
        for _ in range(count):
            at = self.second * SECOND + 1 + np.sort(self.random.integers(0, SECOND - 1, rows))
            some = (self.second * rows + np.arange(rows)) % self.objects
            if not in_turn:
                some = self.random.integers(0, self.objects, rows)
            subject = (some + self.first).astype(np.int32)
            # Tenths, as sensors give them: so that some are equal.
            values = np.round(self.random.uniform(50, 150, rows), 1)
            objects = {self.speed: ObjectColumn(Kind.DOUBLE, values)}
            triples = TimedTriples(self.dictionary, (TripleRows(at, at, subject, objects),))
            self.second += 1
            begin = time.process_time()
            self.evaluator.push(STREAM, triples)
            results = self.evaluator.advance(STREAM, self.second * SECOND + 1)
            spent = time.process_time() - begin
            assert [result.end for result in results] == [self.second * SECOND]
            yield spent


def lengths(objects: int, rows: int) -> None:
    """RANGE in steps of one second: 1, 10, 600."""
    print(f"{objects:,} objects, {rows:,} triples a step, SELECT of all groups; ms a step")
    print(f"{'':<18}{'RANGE':>8}{'mean':>10}{'ratio':>8}{'median':>10}{'worst':>10}")
    for function, semantics in (("AVG", "bag"), ("MIN", "bag"), ("AVG", "set")):
        queries = {r: Query(function, r, objects, semantics=semantics) for r in (1, 10, 600)}
        for range, query in queries.items():
            for _ in query.steps(range + 30, rows):
                pass
        # In turns, so that whatever else the machine does is shared.
        spent = list(zip(*(query.steps(650, rows) for query in queries.values()), strict=True))
        name = function if semantics == "bag" else f"{function}, set"
        for range, mine in zip(queries, zip(*spent, strict=True), strict=True):
            ratio = statistics.fmean(mine) / statistics.fmean(step[0] for step in spent)
            print(
                f"{name:<18}{range:>7}s{statistics.fmean(mine) * 1e3:>10.3f}{ratio:>8.2f}"
                f"{statistics.median(mine) * 1e3:>10.3f}{max(mine) * 1e3:>10.3f}",
                flush=True,
            )
    print()


def touched(objects: int) -> None:
    """All objects are in the window; some have a new sample, as many others lose one."""
    print(f"{objects:,} objects, some touched a step, as many expire; median ms a step")
    print(f"{'touched':<10}{'HAVING':<24}{'touched only':>14}{'all groups':>12}{'ratio':>8}")
    dense = aggregation.DENSE
    for few in (1_000, 10_000, 50_000):
        for having in ("HAVING (AVG(?v) > 149.9)", "HAVING (MAX(?v) < 50.1)"):
            found = []
            for share in (dense, 2**60):
                aggregation.DENSE = share
                length = 3 * objects // (2 * few)
                query = Query(having[8:11], length, objects, having)
                for _ in query.steps(2 * length, few, in_turn=True):
                    pass
                found.append(statistics.median(query.steps(100, few, in_turn=True)))
            aggregation.DENSE = dense
            print(
                f"{few:<10,}{having[7:]:<24}{found[0] * 1e3:>14.3f}{found[1] * 1e3:>12.3f}"
                f"{found[1] / found[0]:>8.2f}",
                flush=True,
            )
    print()


VALUES = "(dyknow:uav1 1) (dyknow:uav2 2) (dyknow:uav3 1)"
SPEEDS = "?o a dyknow:UAV . ?o dyknow:speed ?v"
FAST = "HAVING (AVG(?v) > 150)"
BULK_QUERIES = {
    "AVG, HAVING": (FAST, {}),
    "AVG, all": ("", {}),
    "MAX, HAVING": ("HAVING (MAX(?v) > 150)", {"function": "MAX"}),
    "AVG, RANGE 60s": (FAST, {"length": 60}),
    "AVG, all, ISTREAM": ("", {"operator": "ISTREAM "}),
    "AVG of some, FILTER": (FAST, {"body": f"{SPEEDS} FILTER(?v > 100)"}),
    "AVG of all objects": ("", {"keys": ""}),
    "AVG by VALUES": ("", {"body": f"{SPEEDS} VALUES (?o ?z) {{ {VALUES} }}", "keys": "?z"}),
    "AVG, all, set": ("", {"semantics": "set"}),
    "AVG by ?type": ("", {"body": "?o a ?t . ?o dyknow:speed ?v", "keys": "?t"}),
}
"""HAVING and what else of `query` is not its default, of queries in bulk."""


def in_bulk() -> None:
    """Print what a window costs where a batch makes several due, through the engine: 30 objects at
    1 Hz over an hour, with the output's samples. Not counted: start, and the same without query."""
    print("30 objects at 1 Hz, an hour, STEP 1s, through the engine; µs of CPU a window")
    _table(BULK_QUERIES, 30, (8, 30, 120, 600), 3_600)
    for objects in (400, 1_000, 2_000):
        print(f"{objects:,} objects at 1 Hz")
        some = {name: BULK_QUERIES[name] for name in ("AVG, HAVING", "AVG, all", "MAX, HAVING")}
        _table(some, objects, (8, 30, 120), 480)


def _table(queries: Mapping[str, Shape], objects: int, sizes: Sequence[int], seconds: int) -> None:
    heads = "".join(f"{f'{size} a batch':>16}" for size in sizes)
    print(f"{'windows due at once':<22}{heads}   (one by one → in one pass)")
    most = window_schedule.MOST
    for name, (having, shape) in queries.items():
        row, one = "", query(having, **shape)
        for size in sizes:
            spent = []
            for windows in (1, most):
                window_schedule.MOST = windows
                hour(one, size, 240, objects)
                spent.append(min(hour(one, size, seconds, objects) for _ in range(2)))
            row += f"{f'{spent[0]:.0f} → {spent[1]:.0f}':>16}"
        print(f"{name:<22}{row}", flush=True)
    window_schedule.MOST = most
    print()


def alone() -> None:
    """Print what a window costs that is due alone, and what a live sample costs a query."""
    print("30 objects at 1 Hz, STEP 1s, one window a batch, through the engine; µs of CPU")
    for name, (having, shape) in BULK_QUERIES.items():
        one = query(having, **shape)
        hour(one, 1, 300)
        spent = min(hour(one, 1, 1_500) for _ in range(4))
        print(f"{name:<22}{spent:>8.0f} a window", flush=True)
    live(1, 300)
    empty, open_, closed = (min(live(step) for _ in range(4)) for step in (None, 10**6, 1))
    closes = (closed - empty) * LIVE - (open_ - empty) * (LIVE - 1)
    print(f"{f'live, {LIVE} samples/s':<22}{open_ - empty:>8.0f} a sample that closes no window")
    print(f"{'':<22}{closes:>8.0f} a sample that closes one\n")


LIVE = 10
"""Samples a second of the live stream, of 30 objects in turn."""


def live(step: int | None, samples: int = 3_000) -> float:
    """Return µs of CPU time a sample, each published by itself; ``step``: the query's STEP in
    seconds, None: no query."""
    times = np.arange(samples) * (SECOND // LIVE) + 1
    return publish(1, times, step and query(FAST, length=max(5, step), step=step))


def hour(asked: Asked, size: int, seconds: int, objects: int = 30) -> float:
    """Return µs of CPU time a window, with batches of ``size`` seconds."""
    times = np.repeat(np.arange(seconds), objects) * SECOND + 1
    spent = [publish(objects * size, times, one, objects) for one in (None, asked)]
    return (spent[1] - spent[0]) * objects


def query(
    having: str,
    *,
    function: str = "AVG",
    length: int = 5,
    step: int = 1,
    operator: str = "",
    body: str = SPEEDS,
    keys: str = "?o",
    semantics: Semantics = "bag",
) -> Asked:
    """Return the query of an aggregate of the speeds by ``keys``, and its semantics."""
    window = f"FROM STREAM <{DYKNOW}s.trdf> [RANGE {length}s STEP {step}s]"
    group = f"GROUP BY {keys} {having}" if keys else ""
    inner = f"SELECT {keys} ({function}(?v) AS ?a) WHERE {{ {body} }} {group}"
    if keys != "?o":
        return f"REGISTER QUERY q AS SELECT {keys} ?a {window} WHERE {{ {inner} }}", semantics
    head = f"CONSTRUCT {operator}{{ ?o dyknow:speed ?a }}"
    return f"REGISTER QUERY q AS {head} {window} WHERE {{ {inner} }}", semantics


def publish(size: int, times: np.ndarray, asked: Asked | None, objects: int = 30) -> float:
    """Return µs of CPU time a sample, in batches of ``size`` of objects in turn, with a query or
    without."""
    random, pool = np.random.default_rng(5), StringPool()
    codes = np.array([pool.code(f"uav{i}") for i in range(objects)], np.int32)
    codes = np.resize(codes, len(times))
    speeds = np.round(random.uniform(50, 150, len(times)), 1)
    engine = Engine()
    fields = Field("id", FieldType.STRING), Field("v", FieldType.FLOAT)
    engine.declare(StreamDeclaration("s", fields))
    engine.annotate("stream s contains speed(UAV) = v for every UAV = id")
    if asked is not None:
        text, semantics = asked
        engine.queries.register(text, semantics=semantics)
    begin = time.process_time()
    for first in range(0, len(times), size):
        part = slice(first, first + size)
        columns = {
            "id": Column(FieldType.STRING, codes[part], None, pool),
            "v": Column(FieldType.FLOAT, speeds[part]),
        }
        engine.publish("s", Incoming(SampleBatch(times[part], times[part], columns), False), 0)
    return (time.process_time() - begin) / len(times) * 1e6


def memory() -> None:
    """What is held over an hour of virtual time."""
    print("an hour at 1,000 triples a second, 2,000 objects, RANGE 60s; MB held (tracemalloc)")
    print(f"{'':<18}{'after 2 min':>12}{'20 min':>10}{'40 min':>10}{'60 min':>10}")
    for function, semantics in (("AVG", "bag"), ("MIN", "bag"), ("AVG", "set")):
        gc.collect()
        tracemalloc.start()
        query = Query(function, 60, 2_000, semantics=semantics)
        held = []
        for minutes in (2, 18, 20, 20):
            for _ in query.steps(60 * minutes, 1_000):
                pass
            gc.collect()
            held.append(tracemalloc.get_traced_memory()[0] / 1e6)
        tracemalloc.stop()
        name = function if semantics == "bag" else f"{function}, set"
        print(f"{name:<18}{held[0]:>12.2f}" + "".join(f"{h:>10.2f}" for h in held[1:]), flush=True)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
    print(f"peak of the whole process: {peak:,.0f} MB\n")


def main() -> int:
    """Print the tables; with the argument ``bulk`` or ``alone`` only that of windows in bulk or
    that of windows that are due alone."""
    some = [table for name, table in (("bulk", in_bulk), ("alone", alone)) if name in sys.argv[1:]]
    for table in some:
        table()
    if some:
        return 0
    for _ in Query("MIN", 2, 10).steps(5, 5_000):
        pass
    gc.collect()
    gc.freeze()
    lengths(1_000, 20_000)
    lengths(5_000, 20_000)
    touched(100_000)
    in_bulk()
    alone()
    memory()
    return 0


if __name__ == "__main__":
    sys.exit(main())
