"""Many requests of one template in a running engine: a step with a query shared and one each.

Run by ``make bench`` (``python bench/requests.py``). One process, one core, medians. The paper's
HighSpeedEvent over 1,000 UAVs with a sample a second each, window [RANGE 5s STEP 1s]; requests
differ in their threshold (3 % of the samples are above it), or each selects a UAV of its own. A
step publishes a second of samples, closes a window and makes the samples of all events.
"""

from __future__ import annotations

import argparse
import statistics
import time
from pathlib import Path

import numpy as np

from dyknow.converters.wire import Incoming
from dyknow.engine.engine import Engine
from dyknow.engine.planning import request_sharing
from dyknow.streams.sample import Column, FieldType, SampleBatch
from dyknow.streams.string_pool import StringPool

SECOND = 10**9
UAVS, STEPS, WARM = 1_000, 9, 6
TEMPLATE = Path(__file__).parent.parent / "templates" / "library" / "high_speed.rq"


class Speeds:
    """A second of samples of all UAVs: steady speeds, so that averages keep their spread."""

    def __init__(self) -> None:
        random = np.random.default_rng(5)
        self.pool = StringPool()
        names = [f"uav{i}" for i in range(UAVS)]
        self.ids = np.array([self.pool.code(name) for name in names], np.int32)
        self.speed = random.uniform(0, 100, UAVS)

    def of(self, second: int) -> SampleBatch:
        times = second * SECOND + np.arange(1, UAVS + 1, dtype=np.int64)
        columns = {
            "id": Column(FieldType.STRING, self.ids, None, self.pool),
            "v": Column(FieldType.FLOAT, self.speed),
        }
        return SampleBatch(times, times, columns)


def measured(requests: int, own_objects: bool, shared: bool) -> tuple[float, float, int]:
    """Milliseconds to register a request and for a step, and the events of a step."""
    limits = request_sharing.SAME_STREAMS, request_sharing.OWN_OBJECTS
    if not shared:
        request_sharing.SAME_STREAMS = request_sharing.OWN_OBJECTS = requests + 1
    try:
        engine = Engine()
        engine.annotate("stream speeds contains speed(UAV) = v for every UAV = id")
        engine.register_template(TEMPLATE.read_text())
        begin = time.perf_counter()
        for i in range(requests):
            who = f"dyknow:uav{i % UAVS}" if own_objects else "?o"
            limit = 97 + 2e-3 * (i // UAVS if own_objects else i) / requests
            text = f"dyknow:HighSpeedEvent({who}, dyknow:UAV, {limit:.9f})"
            engine.request_event(engine.parse_request(text))
        registering = (time.perf_counter() - begin) / requests * 1e3
        return registering, *_steps(engine)
    finally:
        request_sharing.SAME_STREAMS, request_sharing.OWN_OBJECTS = limits


def _steps(engine: Engine) -> tuple[float, int]:
    speeds, taken = Speeds(), []
    answers = [engine.generator(view.stream) for view in engine.events()]
    for second in range(WARM + STEPS):
        before = sum(answer.counters.used for answer in answers)
        batch = speeds.of(second)
        begin = time.perf_counter()
        engine.publish("speeds", Incoming(batch, False), 0)
        taken.append((time.perf_counter() - begin) * 1e3)
    events = sum(answer.counters.used for answer in answers) - before
    return statistics.median(taken[WARM:]), events


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="few requests")
    sizes = (10, 100) if parser.parse_args().quick else (10, 100, 1_000)
    print(f"requests of one template, {UAVS:,} UAVs, a sample a second each; medians, ms")
    print(
        f"{'requests differ in':<18}{'requests':>9}{'events':>8}{'a step':>9}{'each':>9}"
        f"{'ratio':>7}{'to register':>13}{'each':>7}"
    )
    for own_objects in (False, True):
        for requests in sizes:
            registering, step, events = measured(requests, own_objects, True)
            registering_alone, alone, same = measured(requests, own_objects, False)
            assert events == same, (events, same)
            print(
                f"{'their object' if own_objects else 'their threshold':<18}{requests:>9,}"
                f"{events:>8,}{step:>9.1f}{alone:>9.1f}{alone / step:>7.1f}"
                f"{registering:>13.1f}{registering_alone:>7.1f}"
            )


if __name__ == "__main__":
    main()
