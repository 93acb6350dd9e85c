"""Many requests of one template in a running engine, against one request for all objects.

Run by ``make bench`` (``python bench/queries/requests.py``). One process, one core, CPU time
without HTTP. The paper's HighSpeedEvent over 1,000 UAVs with a sample a second each, window [RANGE
5s STEP 1s]. Requests each select a UAV of their own, or differ in their threshold. Speeds are
reported, or computed from coordinates. A step publishes a second of samples, closes a window and
makes the samples of all events; no stream is followed. Every average is above the thresholds.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np

from dyknow.converters.wire import Incoming
from dyknow.engine.engine import Engine
from dyknow.engine.planning import request_sharing
from dyknow.streams.sample import Column, FieldType, SampleBatch
from dyknow.streams.string_pool import StringPool

SECOND = 10**9
UAVS, WARM, STEPS, RUNS = 1_000, 32, 64, 3
"""Results wait for up to 64 windows, so a run has as many."""
TEMPLATE = Path(__file__).parents[2] / "templates" / "library" / "high_speed.rq"
REPORTED = "stream s contains speed(UAV) = v for every UAV = id"
COORDINATES = (
    "stream s contains latitude(UAV) = lat [deg], longitude(UAV) = lon [deg] for every UAV = id"
)
DEGREE = 400_000.0
"""The speed (km/h) of a UAV that flies north by a degree a second, roughly."""


class Flight:
    """A second of samples of all UAVs, which keep their speeds."""

    def __init__(self) -> None:
        random = np.random.default_rng(5)
        self.pool = StringPool()
        names = [f"uav{i}" for i in range(UAVS)]
        self.ids = np.array([self.pool.code(name) for name in names], np.int32)
        self.speed = random.uniform(50, 100, UAVS)

    def of(self, second: int) -> SampleBatch:
        times = second * SECOND + np.arange(1, UAVS + 1, dtype=np.int64)
        columns = {
            "id": Column(FieldType.STRING, self.ids, None, self.pool),
            "v": Column(FieldType.FLOAT, self.speed),
            "lat": Column(FieldType.FLOAT, 50 + self.speed / DEGREE * second),
            "lon": Column(FieldType.FLOAT, np.full(UAVS, 13.0)),
        }
        return SampleBatch(times, times, columns)


def measured(meaning: str, texts: list[str]) -> tuple[float, float, float]:
    """Milliseconds for a step and to register a request, and the events of a step."""
    engine = Engine()
    engine.annotate(meaning)
    engine.register_template(TEMPLATE.read_text())
    begin = time.process_time()
    views = [engine.request_event(engine.parse_request(text)) for text in texts]
    registering = (time.process_time() - begin) / len(texts) * 1e3
    flight = Flight()
    fields = engine.generator("s").schema.names
    batches = [flight.of(second).select(fields) for second in range(WARM + STEPS)]
    for batch in batches[:WARM]:
        engine.publish("s", Incoming(batch, False), 0)
    answers = [engine.generator(view.stream) for view in views]
    before = sum(answer.counters.used for answer in answers)
    begin = time.process_time()
    for batch in batches[WARM:]:
        engine.publish("s", Incoming(batch, False), 0)
    events = sum(answer.counters.used for answer in answers) - before
    step = (time.process_time() - begin) / STEPS * 1e3
    return step, registering, events / STEPS


def best(meaning: str, texts: list[str], *, shared: bool = True) -> tuple[float, float, float]:
    """The run with the quickest steps."""
    least = request_sharing.MIN_SHARED
    if not shared:
        request_sharing.MIN_SHARED = len(texts) + 1
    try:
        return min(measured(meaning, texts) for _ in range(RUNS if len(texts) < UAVS else 1))
    finally:
        request_sharing.MIN_SHARED = least


def of_objects(count: int) -> list[str]:
    """Requests for an object each."""
    every = UAVS // count
    return [f"dyknow:HighSpeedEvent(dyknow:uav{i * every}, dyknow:UAV, 10)" for i in range(count)]


def of_thresholds(count: int) -> list[str]:
    """Requests for all objects, with a threshold each."""
    return [
        f"dyknow:HighSpeedEvent(?o, dyknow:UAV, {10 + i / count:.3f})" for i in range(1, count + 1)
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="few requests")
    quick = parser.parse_args().quick
    print(f"requests of one template, {UAVS:,} UAVs, a sample a second each; CPU time, ms a step")
    print(
        f"{'speeds':<13}{'requests':<20}{'events':>8}{'a step':>8}{'to one for all':>18}"
        f"{'each by itself':>16}{'to register':>13}"
    )
    for speeds, meaning in (("reported", REPORTED), ("coordinates", COORDINATES)):
        best(meaning, of_thresholds(1))
        one, _, _ = best(meaning, of_thresholds(1))
        print(f"{speeds:<13}{'one for all':<20}{UAVS:>8,}{one:>8.2f}")
        for count in (2, 10, 100) if quick else (1, 2, 10, 100, 1_000):
            step, registering, events = best(meaning, of_objects(count))
            alone = ""
            if 1 < count < UAVS:
                alone = f"{best(meaning, of_objects(count), shared=False)[0]:.2f}"
            print(
                f"{'':<13}{f'{count:,} objects':<20}{events:>8,.0f}{step:>8.2f}"
                f"{f'{step / one:.2f} ×':>18}{alone:>16}{registering:>13.1f}"
            )
        for count in (10,) if quick else (10, 100):
            step, registering, events = best(meaning, of_thresholds(count))
            beyond = (step - one) / (events - UAVS) * 1e3
            print(
                f"{'':<13}{f'{count:,} thresholds':<20}{events:>8,.0f}{step:>8.2f}"
                f"{f'{beyond:.2f} µs an event':>18}{'':>16}{registering:>13.1f}"
            )


if __name__ == "__main__":
    main()
