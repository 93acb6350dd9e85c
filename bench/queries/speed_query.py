"""The paper's speed query at full speed: this evaluator, hand-written numpy, pyoxigraph.

Run by ``make bench`` (``python bench/queries/speed_query.py``). One process, one core, median of
several runs. A pane holds one second of narrow triples, three predicates mixed; the window is
[RANGE 5s STEP 1s]. numpy has the same columns (predicate, subject, value), and keeps panes too.
Triples *offered* are all that come; those *read* are of the predicate asked for, a third.

pyoxigraph is asked twice: with a fresh store of all triples for each window, and with one store
that lives on, which is given the triples of the predicate alone: the expired ones are removed, the
new ones added, then it is queried.
"""

from __future__ import annotations

import statistics
import sys
import time
from collections.abc import Callable

import numpy as np
from pyoxigraph import Literal, NamedNode, Quad, Store

from dyknow.continuous.algebra.options import Options, Semantics
from dyknow.continuous.columns import fold_kernels
from dyknow.continuous.evaluation.evaluator import ContinuousEvaluator
from dyknow.continuous.operators.background import Background
from dyknow.languages.csparql import body_sparql, parse_query
from dyknow.rdf.dictionary import TermDictionary
from dyknow.rdf.namespaces import DYKNOW, RDF_TYPE
from dyknow.rdf.timed import Kind, ObjectColumn, TimedTriples, TripleRows

SECOND = 10**9
RANGE = 5
STREAM = DYKNOW + "s59.trdf"
QUERY = f"""REGISTER STREAM HighSpeedEvent COMPUTE EVERY 1s AS
PREFIX dyknow: <{DYKNOW}>
CONSTRUCT {{?uav dyknow:speed ?avgSpeed}}
FROM <{DYKNOW}ontology.rdf>
FROM STREAM <{STREAM}> [RANGE {RANGE}s STEP 1s]
WHERE {{ ?uav a dyknow:UAV . ?uav dyknow:speed ?spd . }}
AGGREGATE {{(?avgSpeed, AVG, {{?spd}}) FILTER (?avgSpeed > 100)}}
"""
PREDICATES = [NamedNode(DYKNOW + name) for name in ("speed", "altitude", "heading")]


class Input:
    """Panes of mixed narrow triples as columns: time, subject, predicate (0, 1, 2), value."""

    def __init__(self, objects: int, rate: int, panes: int) -> None:
        random = np.random.default_rng(7)
        self.dictionary = TermDictionary()
        self.predicates = [self.dictionary.id(p) for p in PREDICATES]
        names = [NamedNode(f"{DYKNOW}uav{i}") for i in range(objects)]
        self.first = len(self.dictionary)
        for name in names:
            self.dictionary.id(name)
        self.objects, self.rate, self.panes = objects, rate, panes
        self.store = Store()
        uav = NamedNode(DYKNOW + "UAV")
        self.store.bulk_extend(Quad(name, RDF_TYPE, uav) for name in names[1::2])
        self.is_uav = np.arange(objects) % 2 == 1
        self.columns = []
        for pane in range(panes):
            at = pane * SECOND + 1 + np.sort(random.integers(0, SECOND, rate))
            subject = random.integers(0, objects, rate).astype(np.int32)
            predicate = random.integers(0, 3, rate).astype(np.int8)
            self.columns.append((at, subject, predicate, random.uniform(50, 150, rate)))


class Dyknow:
    """One evaluator that runs over the input again and again, each time at later times.

    The first pass also does what is done once: the query is planned, the static side encoded.
    """

    def __init__(self, data: Input, semantics: Semantics = "bag") -> None:
        self.data = data
        self.evaluator = ContinuousEvaluator(
            parse_query(QUERY),
            data.dictionary,
            Background(data.store),
            [STREAM],
            Options(semantics),
        )
        self.passes = 0

    def run(self) -> tuple[float, list[int]]:
        """Seconds, and the number of triples each window gave."""
        data, counts = self.data, []
        span = (data.panes + RANGE) * SECOND
        shift = self.passes * span
        first = np.int32(data.first)
        # The rows as a converter hands them over: ids of the dictionary, times of this pass.
        columns = [(at + shift, subject + first, p, v) for at, subject, p, v in data.columns]
        self.passes += 1
        begin = time.perf_counter()
        for at, subject, predicate, value in columns:
            objects = {
                id: ObjectColumn(Kind.DOUBLE, value, predicate != k)
                for k, id in enumerate(data.predicates)
            }
            rows = TripleRows(at, at, subject, objects)
            self.evaluator.push(STREAM, TimedTriples(data.dictionary, (rows,)))
            closed = self.evaluator.advance(STREAM, int(at[-1]))
            counts += [len(result.triples) for result in closed]
        closed = self.evaluator.advance(STREAM, shift + span)
        counts += [len(result.triples) for result in closed]
        return time.perf_counter() - begin, counts


def numpy(data: Input) -> tuple[float, list[int]]:
    """The same by hand: a bincount a pane, five panes added."""
    counts = []
    begin = time.perf_counter()
    size = data.objects
    sums, numbers = np.zeros((RANGE, size)), np.zeros((RANGE, size))
    for i in range(data.panes + RANGE - 1):
        slot = i % RANGE
        if i < data.panes:
            _, subject, predicate, value = data.columns[i]
            speed = predicate == 0
            subject, value = subject[speed], value[speed]
            sums[slot] = np.bincount(subject, value, size)
            numbers[slot] = np.bincount(subject, minlength=size)
        else:
            sums[slot] = numbers[slot] = 0
        with np.errstate(all="ignore"):
            average = sums.sum(axis=0) / numbers.sum(axis=0)
        counts.append(int(np.count_nonzero(average[(average > 100) & data.is_uav])))
    return time.perf_counter() - begin, counts


def oxigraph(data: Input, budget: float = 10.0) -> tuple[float, list[int], int]:
    """A fresh store a window, as many windows as fit the time; also how many triples came in."""
    sparql = body_sparql(parse_query(QUERY))
    static = [Quad(q.subject, q.predicate, q.object) for q in data.store]
    terms = data.dictionary.terms(data.first)
    counts: list[int] = []
    spent, windows = 0.0, 0
    for end in range(1, data.panes + 1):
        begin = time.perf_counter()
        store = Store()
        store.extend(static)
        for _, subject, predicate, value in data.columns[max(0, end - RANGE) : end]:
            columns = (subject.tolist(), predicate.tolist(), value.tolist())
            store.extend(
                Quad(terms[s], PREDICATES[p], Literal(v)) for s, p, v in zip(*columns, strict=True)
            )
        counts.append(sum(1 for _ in store.query(sparql)))
        spent += time.perf_counter() - begin
        windows = end
        if spent * (end + 1) / end > budget:
            break
    return spent, counts, windows


def lasting(data: Input) -> tuple[float, list[int]]:
    """One store that follows the window, of the asked predicate alone: the sixth window.

    That is the first one with something to remove; only this step is timed.
    """
    sparql = body_sparql(parse_query(QUERY))
    terms = data.dictionary.terms(data.first)
    store = Store()
    store.extend(Quad(q.subject, q.predicate, q.object) for q in data.store)
    panes: list[list[Quad]] = []
    spent = 0.0
    for _, subject, predicate, value in data.columns[: RANGE + 1]:
        begin = time.perf_counter()
        speed = predicate == 0
        pairs = zip(subject[speed].tolist(), value[speed].tolist(), strict=True)
        new = [Quad(terms[s], PREDICATES[0], Literal(v)) for s, v in pairs]
        if len(panes) == RANGE:
            for quad in panes.pop(0):
                store.remove(quad)
        panes.append(new)
        store.extend(new)
        spent = time.perf_counter() - begin
    begin = time.perf_counter()
    count = sum(1 for _ in store.query(sparql))
    return spent + time.perf_counter() - begin, [count]


def median(run: Callable[[], tuple[float, list[int]]], times: int) -> tuple[float, list[int]]:
    runs = [run() for _ in range(times)]
    return statistics.median(seconds for seconds, _ in runs), runs[0][1]


def main(rate: int = 1_000_000, panes: int = 12, times: int = 7) -> int:
    begin = time.perf_counter()
    Dyknow(Input(10, 5_000, 2)).run()
    warm = time.perf_counter() - begin
    Dyknow(Input(10, 5_000, 2), "set").run()
    print(f"first query in the process, kernels compiled or read from their cache: {warm:.2f} s")
    print(f"compiled kernels: {fold_kernels.JIT}; {rate:,} triples a pane of 1 s, {panes} panes\n")
    print(f"{'':<36}{'M triples/s':>20}")
    head = ("offered", "read", "ms/step", "x numpy")
    print(f"{'objects':>8}  {'evaluator':<26}" + "".join(f"{title:>10}" for title in head))
    agree = True
    for objects in (1_000, 100_000):
        data = Input(objects, rate, panes)
        bag, distinct = Dyknow(data), Dyknow(data, "set")
        first, _ = bag.run()
        # In turns, so that whatever else the machine does is shared.
        runs = [(bag.run(), numpy(data)) for _ in range(times)]
        found, wanted = runs[0][0][1], runs[0][1][1]
        alike, told = median(distinct.run, times)
        slow, theirs, windows = oxigraph(data)
        following, last = lasting(data)
        same = found == wanted == told and found[:windows] == theirs and [found[RANGE]] == last
        agree &= same
        steps = panes + RANGE - 1
        ours, hand = (statistics.median(run[i][0] for run in runs) for i in (0, 1))
        table = {
            "dyknow": (rate * panes / ours, ours / steps),
            "dyknow, set semantics": (rate * panes / alike, alike / steps),
            "numpy by hand": (rate * panes / hand, hand / steps),
            f"pyoxigraph fresh ({windows} window)": (rate * windows / slow, slow / windows),
            "pyoxigraph that lasts": (rate / following, following),
        }
        read = sum(int(np.count_nonzero(column[2] == 0)) for column in data.columns)
        share = read / (rate * panes)
        for name, (speed, step) in table.items():
            ratio = f"{speed / table['numpy by hand'][0]:.2g}"
            print(
                f"{objects:>8,}  {name:<26}{speed / 1e6:>10.2f}{speed * share / 1e6:>10.2f}"
                f"{step * 1e3:>10.3f}{ratio:>10}"
            )
        speeds = [speed for speed, _ in table.values()]
        print(
            f"{'':>8}  dyknow is {speeds[0] / speeds[2]:.2f} x numpy, "
            f"{speeds[0] / speeds[3]:,.0f} x pyoxigraph fresh and "
            f"{speeds[0] / speeds[4]:,.0f} x pyoxigraph that lasts;\n"
            f"{'':>8}  under set semantics {speeds[1] / speeds[3]:,.0f} x pyoxigraph fresh; "
            f"once per query: {first - ours:.2f} s; same windows: {same}\n"
        )
    return 0 if agree else 1


if __name__ == "__main__":
    sys.exit(main())
