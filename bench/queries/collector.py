"""Pauses by Python's garbage collector while an engine grows and is in use, with and without the
schedule of service/runtime/gc_policy.

``python bench/queries/collector.py``. One process a row, one core, processor time in ms. An engine
gets STREAMS streams and REQUESTS event requests, then ROUNDS rounds: a request comes, the oldest of
these goes, and 1,000 objects publish a sample each. Only collections of the oldest generation are
counted. *Objects* are those that the collector knows at the end.
"""

from __future__ import annotations

import argparse
import gc
import subprocess
import sys
import time
from collections import deque
from collections.abc import Mapping
from typing import Any

from requests import TEMPLATE, UAVS, Speeds

from dyknow.converters.wire import Incoming
from dyknow.engine.engine import Engine
from dyknow.service.runtime.gc_policy import CollectionSchedule

STREAMS, REQUESTS, ROUNDS = 2_000, 1_000, 1_000


class Pauses:
    """Seconds of processor time of each full collection."""

    def __init__(self) -> None:
        self.found: list[float] = []
        self._begun = 0.0
        gc.callbacks.append(self._noted)

    def _noted(self, phase: str, info: Mapping[str, Any]) -> None:
        if info["generation"] != 2:
            return
        if phase == "start":
            self._begun = time.process_time()
        else:
            self.found.append(time.process_time() - self._begun)

    def take(self) -> str:
        """Their number, the longest and the sum."""
        found, self.found = self.found, []
        return f"{len(found):>6}{1e3 * max(found, default=0):>9.1f}{1e3 * sum(found):>9.0f}"


def measure(is_scheduled: bool) -> None:
    engine = Engine()
    engine.annotate("stream speeds contains speed(UAV) = v for every UAV = id")
    engine.register_template(TEMPLATE.read_text())
    speeds = Speeds()
    engine.publish("speeds", Incoming(speeds.of(0), False), 0)
    gc.collect()
    gc.freeze()  # as service/runtime/warm_up does
    policy = CollectionSchedule()
    if is_scheduled:
        policy.begin()
    pauses = Pauses()

    def request(number: int) -> Any:
        text = f"dyknow:HighSpeedEvent(dyknow:uav{number % UAVS}, dyknow:UAV, {97 + number * 1e-6})"
        return engine.request_event(engine.parse_request(text))

    for i in range(STREAMS):
        engine.annotate(f"stream s{i} contains altitude(UAV) = v for every UAV = id")
    for i in range(REQUESTS):
        request(i)
        policy.review()
    grown = pauses.take()
    coming: deque[Any] = deque()
    for second in range(1, ROUNDS + 1):
        coming.append(request(REQUESTS + second))
        if len(coming) > 100:
            engine.cancel_event(coming.popleft().id)
        engine.publish("speeds", Incoming(speeds.of(second), False), 0)
        policy.review()
    used = pauses.take()
    gc.unfreeze()
    label = "with" if is_scheduled else "without"
    print(f"{label:<10}{grown}{used}{len(gc.get_objects()):>12,}", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--row", choices=["with", "without"])
    row = parser.parse_args().row
    if row:
        measure(row == "with")
        return
    print(f"{'':<10}{'while it grows':^24}{'in use':^24}")
    each = f"{'times':>6}{'longest':>9}{'sum':>9}"
    print(f"{'schedule':<10}{each}{each}{'objects':>12}")
    for row in ("without", "with"):
        subprocess.run([sys.executable, __file__, "--row", row], check=True)


if __name__ == "__main__":
    main()
