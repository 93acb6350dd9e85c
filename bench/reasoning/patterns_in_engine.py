"""What a pattern or a monitor costs in an engine, beyond publishing: from samples to matches.

    python bench/reasoning/patterns_in_engine.py

100 objects; half of the samples have a speed, the others an altitude.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np

sys.path[:0] = [str(Path(__file__).parents[2] / "tests" / "support" / "worlds")]

from dyknow.converters.wire import Incoming  # noqa: E402
from dyknow.engine.engine import Engine  # noqa: E402
from dyknow.streams.sample import batch_from_rows  # noqa: E402
from dyknow.streams.time import SECOND  # noqa: E402

SSL = "stream a contains speed(UAV) = v [m.s-1], altitude(UAV) = w [m] for every UAV = id"
EVENTS = (
    "event(speed[?x]:(?, > 50 [m.s-1]), t1); event(altitude[?x]:(?, > 50 [m]), t2); "
    "t2 - t1 in [0s, 30s];"
)
from dyknow.streams import jit  # noqa: E402

jit.PATIENCE = 0.0  # loops are compiled from the first call on
PATTERNS = {
    "a chronicle of two events": f"chronicle c(?x) {{ {EVENTS} }}",
    "the same with noevent": f"chronicle c(?x) {{ {EVENTS} "
    "noevent(speed[?x]:(?, < 10 [m.s-1]), (t1, t2)); }",
    "a monitor of both features": "monitor m(?x in UAV) = always [0s, 10s] (speed(?x) > 50 -> "
    "eventually [0s, 5s] altitude(?x) > 50) with use most recent, report violations",
}
WARM = 20
"""Batches that are not measured."""


def seconds(text: str | None, samples: int, size: int) -> tuple[float, int]:
    """Return the processor time of a batch, and the number of results."""
    engine = Engine()
    engine.annotate(SSL)
    unit = engine.queries.unit(engine.queries.register(text).name) if text else None
    generator, draw = engine.generator("a"), np.random.default_rng(1)
    rows = []
    for i in range(samples):
        value = float(draw.random() * 100)
        values = {"id": f"u{draw.integers(100)}", "v": None, "w": None}
        values["v" if i % 2 else "w"] = value
        rows.append(((i + 1) * SECOND, (i + 1) * SECOND, values))
    pools = generator.stream.pools
    parts = [
        batch_from_rows(generator.schema, rows[i : i + size], pools)
        for i in range(0, samples, size)
    ]
    for part in parts[:WARM]:
        engine.publish("a", Incoming(part, False), 0)
    begun = time.process_time()
    for part in parts[WARM:]:
        engine.publish("a", Incoming(part, False), 0)
    spent = (time.process_time() - begun) / (len(parts) - WARM)
    return spent, 0 if unit is None else unit.output.counters.used


def main() -> None:
    for samples, size in ((4_000, 1), (100_000, 1_000)):
        alone, _ = min(seconds(None, samples, size) for _ in range(3))
        for name, text in PATTERNS.items():
            spent, matches = min(seconds(text, samples, size) for _ in range(3))
            beyond = spent - alone
            print(
                f"{name:26} {size:6,} a batch: {beyond * 1e6:7.0f} µs a batch beyond "
                f"{alone * 1e6:3.0f} of publishing, {size / beyond / 1e6:5.2f} M samples/s; "
                f"{matches:,} results",
                flush=True,
            )


if __name__ == "__main__":
    main()
