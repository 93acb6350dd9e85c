"""How fast verdicts of a formula are: states of objects a second of processor time.

    python bench/reasoning/mtl.py [NAME …]

The formula is always[0,10] (speed > 100 -> eventually[0,5] speed < 90), at 1 Hz unless a row says
otherwise, with a report of violations, of which there are less than 0.1 %; thresholds are included,
decoding is not. Each row takes the least of three runs: by tables of bits (objects that share their
states), each object by itself (states of its own), and by moments (margins, several variables).
*By hand* is numpy that does a state at a time, with the same early verdicts, and writes the
violations as rows.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from dyknow.converters.wire import Incoming
from dyknow.engine.engine import Engine
from dyknow.languages.mtl.ast import Interval, Report, Temporal
from dyknow.languages.mtl.checked import (
    Atom,
    CheckedMonitor,
    Constant,
    Kind,
    Not,
    ObjectVariable,
    Or,
    Reading,
    Within,
)
from dyknow.reasoning.mtl.bits.evaluator import SlicedEvaluator
from dyknow.reasoning.mtl.evaluator import MonitorEvaluator
from dyknow.reasoning.mtl.parts.evaluator import PartEvaluator
from dyknow.reasoning.states.states import States, Values
from dyknow.streams import jit
from dyknow.streams.policies.policy import SynchronizationPolicy
from dyknow.streams.sample import batch_from_rows
from dyknow.streams.time import SECOND

jit.PATIENCE = 0.0  # loops are compiled from the first call on

SORT, SPEED = "urn:Car", "urn:speed"
TERM = (SPEED, (SORT,))
RUNS = 3
ROWS = {
    "1 object, one batch": (1, 100_000, 100_000, 10, 15),
    "1 object, batches of 1,000": (1, 100_000, 1_000, 10, 15),
    "1 object, a state a batch": (1, 2_000, 1, 10, 15),
    "1 object, batches of 1,000, interval 1 h": (1, 100_000, 1_000, 3_600, 15),
    "1 object, batches of 1,000, calm": (1, 100_000, 1_000, 10, 10),
    "1 object, batches of 1,000, calm, interval 1 h": (1, 100_000, 1_000, 3_600, 10),
    "1 object, a state a batch, calm, interval 1 h": (1, 10_000, 1, 3_600, 10),
    "1,000 objects, batches of 100": (1_000, 1_000, 100, 10, 15),
    "1,000 objects, a state a batch": (1_000, 500, 1, 10, 15),
    "10,000 objects, a state a batch": (10_000, 200, 1, 10, 15),
    "100,000 objects, a state a batch": (100_000, 100, 1, 10, 15),
}
"""Objects, states, states a batch, the end of the outer interval in s, the deviation of speeds.
With an hour a fifth of the starts are violations with 15, none with 10."""


IN_ENGINE = (
    "monitor m(?x in UAV) = always [0s, 10s] (speed(?x) > 100 [m.s-1] -> "
    "eventually [0s, 5s] speed(?x) < 90 [m.s-1]) with sample every 1s, report violations"
)


def monitor(end: int, *, robustness: bool = False) -> CheckedMonitor:
    reading = Reading(SPEED, (ObjectVariable("x"),), Kind.NUMBER, None)
    fast = Atom(">", reading, Constant(100.0, Kind.NUMBER))
    slow = Within(
        Temporal.EVENTUALLY, Interval(0, 5), Atom("<", reading, Constant(90.0, Kind.NUMBER))
    )
    formula = Within(Temporal.ALWAYS, Interval(0, end), Or(Not(fast), slow))
    policy = SynchronizationPolicy()
    return CheckedMonitor(
        "m",
        (("x", SORT),),
        formula,
        policy,
        Report.VIOLATIONS,
        False,
        None,
        robustness=robustness,
    )


def batches(objects: int, count: int, size: int, deviation: float = 15) -> list[States]:
    """Speeds around 80, so that few starts are violations."""
    random = np.random.default_rng(1)
    speeds = random.normal(80, deviation, (count, objects))
    known = np.ones((count, objects), np.bool_)
    times = np.arange(count, dtype=np.int64)
    names = {SORT: [f"urn:car{i}" for i in range(objects)]}
    found = []
    for start in range(0, count, size):
        rows = slice(start, start + size)
        values = {TERM: Values(speeds[rows], known[rows])}
        found.append(States(times[rows], times[rows], names, {SORT: known[rows]}, values))
    return found


def run(
    name: str, kind: type[MonitorEvaluator | SlicedEvaluator], *, robustness: bool = False
) -> None:
    objects, count, size, end, deviation = ROWS[name]
    states = batches(objects, count, size, deviation)

    def work() -> int:
        evaluator = kind(monitor(end, robustness=robustness))
        violations = sum(int((evaluator.push(part).value == 0).sum()) for part in states)
        return violations + int((evaluator.end().value == 0).sum())

    way = "by moments" if kind is MonitorEvaluator else "by bits"
    told = f"{name}, {way}" + (", robustness" if robustness else "")
    show(told, objects * count, len(states), work)


def by_object(name: str, *, robustness: bool = False) -> None:
    """Each object has states of its own."""
    objects, count, size, end, deviation = ROWS[name]
    states = [_in_parts(each) for each in batches(objects, count, size, deviation)]

    def work() -> int:
        evaluator = PartEvaluator(monitor(end, robustness=robustness))
        evaluator.make_room_for(objects)
        found = [evaluator.push(each, None, part) for each, part in states]
        return sum(int((each.value == 0).sum()) for each in (*found, evaluator.end()))

    told = f"{name}, each object by itself" + (", robustness" if robustness else "")
    show(told, objects * count, len(states), work)


def _in_parts(states: States) -> tuple[States, NDArray[np.int64]]:
    """The states of each object, one object after the other, and their parts."""
    count, objects = states.values[TERM].values.shape
    valid = np.tile(states.valid, objects)
    values = Values(
        *(
            np.ascontiguousarray(each.T).reshape(-1, 1)
            for each in (states.values[TERM].values, states.values[TERM].known)
        )
    )
    found = States(valid, valid, {SORT: [""]}, {SORT: values.known}, {TERM: values})
    return found, np.repeat(np.arange(objects), count)


def by_hand(name: str) -> None:
    objects, count, size, end, deviation = ROWS[name]
    states = batches(objects, count, size, deviation)
    speeds = np.concatenate([each.values[TERM].values for each in states])

    def work() -> int:
        return sum(len(found) for found in violations_by_hand(speeds, end, 5))

    show(f"{name}, numpy by hand", objects * count, count, work)


def show(name: str, states: int, pushes: int, work: Callable[[], int]) -> None:
    least = float("inf")
    for _ in range(RUNS):
        begun = time.process_time()
        violations = work()
        least = min(least, time.process_time() - begun)
    rate, each = states / least / 1e6, least / pushes * 1e6
    print(f"{name:66} {rate:8.2f} M states/s {each:12,.0f} µs a push {violations:9,} violations")


def violations_by_hand(
    speeds: NDArray[np.float64], end: int, inner: int
) -> Iterator[NDArray[np.int64]]:
    """The violations of each state, and of the end: rows of the object and the start."""
    count, objects = speeds.shape
    waits = np.zeros((inner + 1, objects), np.bool_)
    is_open = np.zeros((end + inner + 2, objects), np.bool_)

    def failed(state: int) -> NDArray[np.int64]:
        """The operand fails at a state: so do the open starts whose interval it is in."""
        bad, rows = waits[state % len(waits)], []
        if bad.any():
            for start in range(max(0, state - end), state + 1):
                row = is_open[start % len(is_open)]
                own = np.flatnonzero(row & bad)
                row[own] = False
                rows.append(np.stack([own, np.full(len(own), start)], axis=1))
        bad[:] = False
        return np.concatenate(rows) if rows else np.empty((0, 2), np.int64)

    for state in range(count):
        is_fast, is_slow = speeds[state] > 100, speeds[state] < 90
        waits &= ~is_slow
        np.logical_and(is_fast, ~is_slow, out=waits[state % len(waits)])
        is_open[state % len(is_open)] = True
        if state >= inner:
            yield failed(state - inner)
        # Intervals that are over hold unless a state in them still waits.
        for start in range(max(0, state - end - inner), state - end + 1):
            row = is_open[start % len(is_open)]
            if row.any():
                late = range(max(start, state - inner + 1), start + end + 1)
                row &= np.logical_or.reduce(waits[[each % len(waits) for each in late]], axis=0)
    for state in range(count - inner, count):
        yield failed(state)


def through_an_engine(objects: int, count: int = 30) -> None:
    """A sample of each object a second, in an engine: what a monitor on a grid costs beyond
    publishing."""
    draw = np.random.default_rng(1)

    def seconds(text: str | None) -> float:
        engine = Engine()
        engine.annotate("stream a contains speed(UAV) = v [m.s-1] for every UAV = id")
        if text is not None:
            engine.queries.register(text)
        generator = engine.generator("a")
        pools, parts = generator.stream.pools, []
        for state in range(1, count + 1):
            speeds = draw.normal(80, 15, objects).tolist()
            rows = [
                (state * SECOND, state * SECOND, {"id": f"u{i}", "v": speed})
                for i, speed in enumerate(speeds)
            ]
            parts.append(Incoming(batch_from_rows(generator.schema, rows, pools), False))
        for part in parts[:5]:
            engine.publish("a", part, 0)
        begun = time.process_time()
        for part in parts[5:]:
            engine.publish("a", part, 0)
        return (time.process_time() - begun) / (count - 5)

    alone, beside = (min(seconds(text) for _ in range(RUNS)) for text in (None, IN_ENGINE))
    print(
        f"{objects:,} objects through an engine, sample every 1s: {(beside - alone) * 1e6:,.0f} µs "
        f"a state beyond {alone * 1e6:,.0f} of publishing"
    )


def peers() -> None:
    """The same rule by RTAMT and Reelay, where they are installed."""
    speeds = np.random.default_rng(1).normal(80, 15, 100_000).tolist()
    try:
        import reelay
        import rtamt
    except ImportError as error:
        print(f"no comparison: {error}")
        return
    rtamt_rule = "out = always[0,10]((speed>100) -> (eventually[0,5](speed<90)))"
    reelay_rule = "historically[0:10]((once[5:5]{speed > 100}) -> (once[0:5]{speed < 90}))"

    def by_rtamt() -> int:
        specification = rtamt.StlDiscreteTimeSpecification()
        for name in ("speed", "out"):
            specification.declare_var(name, "float")
        specification.spec = rtamt_rule
        specification.parse()
        told = specification.evaluate({"time": list(range(len(speeds))), "speed": speeds})
        return sum(robustness < 0 for _, robustness in told)

    def by_reelay() -> int:
        tool = reelay.discrete_timed_monitor(
            pattern=reelay_rule, semantics="boolean", condense=False
        )
        return sum(not tool.update({"speed": speed})["value"] for speed in speeds)

    for name, work in (("RTAMT, offline, 1 object", by_rtamt), ("Reelay, 1 object", by_reelay)):
        show(name, len(speeds), 1, work)


def main() -> None:
    for name in sys.argv[1:] or ROWS:
        run(name, SlicedEvaluator)
        by_object(name)
        run(name, MonitorEvaluator)
        by_hand(name)
    for name in ("1 object, one batch", "1,000 objects, batches of 100"):
        by_object(name, robustness=True)
        run(name, MonitorEvaluator, robustness=True)
    for objects in (1_000, 10_000):
        through_an_engine(objects)
    peers()


if __name__ == "__main__":
    main()
