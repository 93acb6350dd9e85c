"""Many requests of one template whose body is a pattern or a formula, an object each.

    python bench/reasoning/reasoning_requests.py

1,000 objects have a sample each in a batch of 1,000; requests name the first of them, or differ in
a value. Printed is the processor time of a batch, without that of publishing alone: of one request
for all objects (of one request, where they differ in a value), then of 1, 10, … requests, as they
share an evaluation and with one each. One process; the median of some batches.
"""

from __future__ import annotations

import argparse
import statistics
import time

import numpy as np

from dyknow.converters.wire import Incoming
from dyknow.engine.engine import Engine
from dyknow.engine.planning import request_sharing
from dyknow.streams import jit
from dyknow.streams.sample import Column, FieldType, SampleBatch
from dyknow.streams.string_pool import StringPool

jit.PATIENCE = 0.0  # loops are compiled from the first call on

SECOND = 10**9
OBJECTS, WARM, BATCHES = 1_000, 4, 8
SSL = "stream a contains speed(UAV) = v [m.s-1], altitude(UAV) = w [m] for every UAV = id"
EVENTS = (
    "event(speed[?x]:(?, > 97 [m.s-1]), t1); event(altitude[?x]:(?, > 70 [m]), t2); "
    "t2 - t1 in [1ms, 3s];"
)
TEMPLATES = {
    "chronicle": f"REGISTER TEMPLATE dyknow:Odd(?x in UAV) AS chronicle Odd(?x) {{ {EVENTS} }}",
    "with noevent": f"REGISTER TEMPLATE dyknow:Odd(?x in UAV) AS chronicle Odd(?x) {{ {EVENTS} "
    "noevent(speed[?x]:(?, < 10 [m.s-1]), (t1, t2)); }",
    "next match": "REGISTER TEMPLATE dyknow:Odd(?x in UAV) AS PATTERN SEQ(speed a, altitude b) "
    "WHERE skip_till_next_match [id = ?x] AND a.value > 349 AND b.value > 70 WITHIN 3 seconds",
    "formula": "REGISTER TEMPLATE dyknow:Odd(?x in UAV) AS always[0s, 3s] (speed(?x) > 97 [m.s-1] "
    "-> eventually[0s, 2s] altitude(?x) > 70 [m]) with report violations",
    "on a grid": "REGISTER TEMPLATE dyknow:Odd(?x in UAV) AS always[0s, 3s] "
    "(speed(?x) > 97 [m.s-1] -> eventually[0s, 2s] altitude(?x) > 70 [m]) "
    "with report violations, sample every 1s, use most recent, max delay 0s",
    "in a value": "REGISTER TEMPLATE dyknow:Odd(?x in UAV, ?limit) AS always[0s, 3s] "
    "(speed(?x) > ?limit [m.s-1] -> eventually[0s, 2s] altitude(?x) > 70 [m]) "
    "with report violations",
}


def arguments(template: str, number: int) -> str:
    """Return the arguments of a request: an object of its own, or one with a value of its own."""
    return f"dyknow:uav0, {number / 10}" if template == "in a value" else f"dyknow:uav{number}"


class Samples:
    """A second of samples of all objects."""

    def __init__(self) -> None:
        self._random = np.random.default_rng(5)
        self._pool = StringPool()
        names = [f"uav{i}" for i in range(OBJECTS)]
        self._ids = np.array([self._pool.code(name) for name in names], np.int32)

    def of(self, second: int) -> SampleBatch:
        times = second * SECOND + np.arange(1, OBJECTS + 1, dtype=np.int64)
        values = self._random.uniform(0, 100, (2, OBJECTS))
        columns = {
            "id": Column(FieldType.STRING, self._ids, None, self._pool),
            "v": Column(FieldType.FLOAT, values[0]),
            "w": Column(FieldType.FLOAT, values[1]),
        }
        return SampleBatch(times, times, columns)


def measured(template: str, arguments: list[str], *, shares: bool = True) -> tuple[float, int]:
    """Return the milliseconds of a batch, and the number of results."""
    least = request_sharing.MIN_SHARED
    if not shares:
        request_sharing.MIN_SHARED = 1 << 62
    try:
        engine = Engine()
        engine.annotate(SSL)
        if arguments:
            engine.register_template(template)
        for each in arguments:
            engine.request_event(engine.parse_request(f"dyknow:Odd({each})"))
    finally:
        request_sharing.MIN_SHARED = least
    samples, taken = Samples(), []
    for second in range(WARM + BATCHES):
        batch = samples.of(second)
        begun = time.process_time()
        engine.publish("a", Incoming(batch, False), 0)
        taken.append((time.process_time() - begun) * 1e3)
    results = sum(engine.generator(view.stream).counters.used for view in engine.events())
    return statistics.median(taken[WARM:]), results


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="few requests")
    parser.add_argument("--only", choices=list(TEMPLATES), help="one template")
    given = parser.parse_args()
    counts = (1, 10, 100) if given.quick else (1, 10, 100, 1_000)
    print(
        f"{'template':<14}{'requests':>9}{'ms':>9}{'times all':>11}{'each, ms':>10}{'results':>9}"
    )
    publishing, _ = measured("", [])
    for name in [given.only] if given.only else TEMPLATES:
        first = arguments(name, 0) if name == "in a value" else "?x"
        whole, results = measured(TEMPLATES[name], [first])
        whole -= publishing
        print(
            f"{name:<14}{first.split(',')[0].removeprefix('dyknow:'):>9}{whole:>9.2f}{'':>21}{results:>9,}",
            flush=True,
        )
        for count in counts:
            objects = [arguments(name, i) for i in range(count)]
            alone, results = measured(TEMPLATES[name], objects, shares=False)
            spent, same = measured(TEMPLATES[name], objects)
            assert same == results, (same, results)
            spent, alone = spent - publishing, alone - publishing
            print(
                f"{name:<14}{count:>9,}{spent:>9.2f}{spent / whole:>11.1f}{alone:>10.2f}"
                f"{results:>9,}",
                flush=True,
            )


if __name__ == "__main__":
    main()
