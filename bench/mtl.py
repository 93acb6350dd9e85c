"""How fast verdicts of a formula are: states of objects a second of processor time.

    python bench/mtl.py [NAME …]

The formula is always[0,10] (speed > 100 -> eventually[0,5] speed < 90), at 1 Hz unless a row says
otherwise; thresholds are included, decoding is not. Each row takes the least of three runs.
"""

from __future__ import annotations

import sys
import time

import numpy as np

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
from dyknow.reasoning.mtl.evaluator import MonitorEvaluator
from dyknow.reasoning.states.states import States, Values
from dyknow.streams.policies.policy import SynchronizationPolicy

SORT, SPEED = "urn:Car", "urn:speed"
TERM = (SPEED, (SORT,))
RUNS = 3
ROWS = {
    "1 object, one batch": (1, 100_000, 100_000, 10),
    "1 object, batches of 1,000": (1, 100_000, 1_000, 10),
    "1 object, a state a batch": (1, 2_000, 1, 10),
    "1 object, batches of 1,000, interval 1 h": (1, 100_000, 1_000, 3_600),
    "1,000 objects, batches of 100": (1_000, 1_000, 100, 10),
    "1,000 objects, a state a batch": (1_000, 200, 1, 10),
    "100,000 objects, a state a batch": (100_000, 40, 1, 10),
}
"""Objects, states, states a batch, the end of the outer interval in s."""


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
        Report.VERDICTS,
        False,
        None,
        robustness=robustness,
    )


def batches(objects: int, count: int, size: int) -> list[States]:
    """Speeds around 80, so that few starts are violations."""
    random = np.random.default_rng(1)
    speeds = random.normal(80, 15, (count, objects))
    known = np.ones((count, objects), np.bool_)
    times = np.arange(count, dtype=np.int64)
    names = {SORT: [f"urn:car{i}" for i in range(objects)]}
    found = []
    for start in range(0, count, size):
        rows = slice(start, start + size)
        values = {TERM: Values(speeds[rows], known[rows])}
        found.append(States(times[rows], times[rows], names, {SORT: known[rows]}, values))
    return found


def run(name: str, *, robustness: bool = False) -> None:
    objects, count, size, end = ROWS[name]
    states = batches(objects, count, size)
    least = float("inf")
    for _ in range(RUNS):
        evaluator = MonitorEvaluator(monitor(end, robustness=robustness))
        begun = time.process_time()
        violations = sum(int((evaluator.push(part).value == 0).sum()) for part in states)
        violations += int((evaluator.end().value == 0).sum())
        least = min(least, time.process_time() - begun)
    rate = objects * count / least / 1e6
    pushes = least / len(states) * 1e6
    name += ", robustness" if robustness else ""
    print(f"{name:54} {rate:8.2f} M states/s {pushes:12,.0f} µs a push {violations:9,} violations")


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
        least = float("inf")
        for _ in range(RUNS):
            begun = time.process_time()
            violations = work()
            least = min(least, time.process_time() - begun)
        rate = len(speeds) / least / 1e6
        print(f"{name:54} {rate:8.2f} M states/s {'':22} {violations:9,} violations")


def main() -> None:
    for name in sys.argv[1:] or ROWS:
        run(name)
    for name in ("1 object, one batch", "1,000 objects, batches of 100"):
        run(name, robustness=True)
    peers()


if __name__ == "__main__":
    main()
