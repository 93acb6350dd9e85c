"""Many instances of one template: what a step costs beyond that of one, what adding one costs.

Run by ``make bench`` (``python bench/queries/instances.py``). One process, one core, medians. The
paper's HighSpeedEvent(?o, ?type, ?threshold) over 100,000 objects with a sample a second each,
window [RANGE 5s STEP 1s]; each instance has an object and a threshold by chance, such that a few
per cent of them give an event a step. A step takes in a second of samples, closes a window and
makes the columns of all events. numpy keeps the same panes and compares each instance with its
object.
"""

from __future__ import annotations

import statistics
import sys
import time
import tracemalloc

import numpy as np
from pyoxigraph import Literal, NamedNode, Quad, Store, Variable

from dyknow.continuous.evaluation.evaluator import ContinuousEvaluator
from dyknow.continuous.operators.background import Background
from dyknow.continuous.sharing.template_instances import TemplateEvaluator
from dyknow.languages.csparql import bind, parse_template
from dyknow.rdf.dictionary import TermDictionary
from dyknow.rdf.namespaces import DYKNOW, RDF_TYPE
from dyknow.rdf.timed import Kind, ObjectColumn, TimedTriples, TripleRows

SECOND = 10**9
OBJECTS, STEPS, RANGE = 100_000, 25, 5
AIMS = {10_000: 0.1, 100_000: 1.0, 1_000_000: 5.0}
"""Milliseconds a step beyond one instance, by instances."""
STREAM = DYKNOW + "speeds.trdf"
TEMPLATE = f"""REGISTER TEMPLATE dyknow:HighSpeedEvent(?o, ?type, ?threshold) COMPUTE EVERY 1s AS
PREFIX dyknow: <{DYKNOW}>
CONSTRUCT {{?o dyknow:speed ?avgSpeed}}
WHERE {{ ?o a ?type . ?o dyknow:speed ?spd . }}
AGGREGATE {{(?avgSpeed, AVG, {{?spd}}) FILTER (?avgSpeed > ?threshold)}}
WINDOW [RANGE {RANGE}s STEP 1s]
"""
UAV, SPEED = NamedNode(DYKNOW + "UAV"), NamedNode(DYKNOW + "speed")
WHO, TYPE, THRESHOLD = Variable("o"), Variable("type"), Variable("threshold")


class Data:
    """A sample a second of each object, and the objects and thresholds of a million instances."""

    def __init__(self) -> None:
        random = np.random.default_rng(11)
        self.dictionary = TermDictionary()
        self.names = [NamedNode(f"{DYKNOW}uav{i}") for i in range(OBJECTS)]
        self.speed = self.dictionary.id(SPEED)
        self.first = len(self.dictionary)
        for name in self.names:
            self.dictionary.id(name)
        store = Store()
        store.bulk_extend(Quad(name, RDF_TYPE, UAV) for name in self.names)
        self.background = Background(store)
        self.values = [random.uniform(50, 150, OBJECTS) for _ in range(STEPS)]
        self.subject = np.arange(self.first, self.first + OBJECTS, dtype=np.int32)
        most = max(AIMS)
        self.object = random.integers(0, OBJECTS, most)
        self.threshold = random.uniform(115, 150, most)

    def arguments(self, i: int) -> dict[Variable, NamedNode | Literal]:
        name = self.names[int(self.object[i])]
        return {WHO: name, TYPE: UAV, THRESHOLD: Literal(float(self.threshold[i]))}

    def pane(self, step: int) -> TimedTriples:
        at = np.sort(np.arange(OBJECTS) * (SECOND // OBJECTS)) + step * SECOND + 1
        column = ObjectColumn(Kind.DOUBLE, self.values[step])
        rows = TripleRows(at, at, self.subject, {self.speed: column})
        return TimedTriples(self.dictionary, (rows,))


def step_of(evaluator: TemplateEvaluator, data: Data, step: int) -> tuple[float, int]:
    """Milliseconds and events of a step."""
    pane = data.pane(step)
    begin = time.perf_counter()
    evaluator.push(STREAM, pane)
    (result,) = evaluator.advance(STREAM, (step + 1) * SECOND + 1)
    events = sum(len(numbers) for numbers, _ in result.triples())
    return (time.perf_counter() - begin) * 1e3, events


def evaluator_of(data: Data) -> TemplateEvaluator:
    query = parse_template(TEMPLATE).query
    return TemplateEvaluator(query, data.dictionary, data.background, [STREAM])


def by_hand(data: Data, instances: int) -> tuple[list[float], list[int]]:
    """The same in numpy: the averages, then a comparison an instance."""
    spent, events = [], []
    objects, thresholds = data.object[:instances], data.threshold[:instances]
    for step in range(STEPS):
        begin = time.perf_counter()
        average = np.mean(data.values[max(0, step + 1 - RANGE) : step + 1], axis=0)
        own = average[objects]
        fired = np.flatnonzero(own > thresholds)
        events.append(len(own[fired]))
        spent.append((time.perf_counter() - begin) * 1e3)
    return spent, events


def alone(data: Data) -> float:
    """Milliseconds a step of one instance as a query of its own."""
    query = bind(parse_template(TEMPLATE).query, data.arguments(0))
    evaluator = ContinuousEvaluator(query, data.dictionary, data.background, [STREAM])
    spent = []
    for step in range(STEPS):
        pane = data.pane(step)
        begin = time.perf_counter()
        evaluator.push(STREAM, pane)
        evaluator.advance(STREAM, (step + 1) * SECOND + 1)
        spent.append((time.perf_counter() - begin) * 1e3)
    return statistics.median(spent[RANGE:])


def added(evaluator: TemplateEvaluator, data: Data, instances: int) -> float:
    """Seconds to add the instances, whose terms are made before, some at a time."""
    spent = 0.0
    for start in range(0, instances, 10_000):
        some = [data.arguments(i) for i in range(start, min(instances, start + 10_000))]
        begin = time.perf_counter()
        for given in some:
            evaluator.add(given)
        spent += time.perf_counter() - begin
    return spent


def bytes_each(data: Data, instances: int) -> float:
    """What an instance more keeps."""
    evaluator = evaluator_of(data)
    evaluator.add(data.arguments(0))
    tracemalloc.start()
    for step in range(RANGE + 3):
        if step == RANGE + 1:
            before = tracemalloc.get_traced_memory()[0]
            added(evaluator, data, instances)
        evaluator.push(STREAM, data.pane(step))
        evaluator.advance(STREAM, (step + 1) * SECOND + 1)
    after = tracemalloc.get_traced_memory()[0]
    tracemalloc.stop()
    return (after - before) / instances


def main() -> int:
    data = Data()
    print(f"one instance as a query of its own: {alone(data):.2f} ms a step\n")
    heads = ("ms a step", "beyond one", "aim", "events", "numpy ms", "µs an add", "first step")
    print(f"{'instances':>9}" + "".join(f"{head:>12}" for head in (*heads, "bytes each")))
    agree = True
    for instances in (1, *AIMS):
        memory = bytes_each(data, instances) if 1 < instances < max(AIMS) else None
        one, evaluator = evaluator_of(data), evaluator_of(data)
        one.add(data.arguments(0))
        adding = added(evaluator, data, instances) / instances * 1e6
        # In turns, so that both see the same machine.
        lone, spent, events = [], [], []
        for step in range(STEPS):
            lone.append(step_of(one, data, step)[0])
            milliseconds, count = step_of(evaluator, data, step)
            spent.append(milliseconds)
            events.append(count)
        hand, wanted = by_hand(data, instances)
        same = events == wanted
        agree &= same
        beyond = statistics.median(a - b for a, b in zip(spent[RANGE:], lone[RANGE:], strict=True))
        aim = AIMS.get(instances)
        line = f"{instances:>9,}{statistics.median(spent[RANGE:]):>12.3f}{beyond:>12.3f}"
        line += f"{'-' if aim is None else format(aim, '.1f'):>12}{events[-1]:>12,}"
        line += f"{statistics.median(hand[RANGE:]):>12.3f}{adding:>12.2f}{spent[0]:>12.1f}"
        line += f"{'-' if memory is None else format(memory, '.0f'):>12}"
        missed = aim is not None and beyond > aim
        print(line + ("" if same else " DIFFERS") + (" (aim missed)" if missed else ""), flush=True)
    return 0 if agree else 1


if __name__ == "__main__":
    sys.exit(main())
