"""Samples per second through the whole engine: publish → units → windows → results.

    python bench/service.py

The demonstration's recording is repeated end to end; requests run while it is published. Measured
without HTTP, so that the rows can be compared; `ndjson` adds decoding the wire format.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from dyknow.converters.ndjson import decode_ndjson, encode_ndjson
from dyknow.converters.recordings.recording import open_recording
from dyknow.converters.wire import Incoming
from dyknow.engine.engine import Engine
from dyknow.engine.model.views import StreamDeclaration
from dyknow.streams.sample import SampleBatch, concatenate

ROOT = Path(__file__).parent.parent
REPEATS = 6
BATCH = 5_000
RUNS = 3


def recording() -> tuple[StreamDeclaration, SampleBatch]:
    """The slice, repeated one after the other in time."""
    source = open_recording(ROOT / "examples" / "adsb.csv.gz")
    batch = concatenate([incoming.batch for incoming in source])
    period = int(batch.available[-1] - batch.available[0]) + 1_000_000_000
    parts = [
        SampleBatch(batch.available + i * period, batch.valid + i * period, batch.columns)
        for i in range(REPEATS)
    ]
    return StreamDeclaration("adsb", source.schema.fields), concatenate(parts)


def engine_with(requests: list[str]) -> tuple[Engine, SampleBatch]:
    """An engine that answers ``requests``, and the samples to give it."""
    declaration, batch = recording()
    engine = Engine()
    engine.declare(declaration)
    engine.annotate((ROOT / "examples" / "adsb.ssl").read_text())
    engine.register_template((ROOT / "templates" / "library" / "high_speed.rq").read_text())
    for text in requests:
        engine.request_event(engine.parse_request(text))
    return engine, batch


def publish(requests: list[str]) -> float:
    """Seconds to publish everything in batches."""
    engine, batch = engine_with(requests)
    begin = time.perf_counter()
    for start in range(0, len(batch), BATCH):
        engine.publish("adsb", Incoming(batch.take(slice(start, start + BATCH)), False), 0)
    engine.end("adsb")
    return time.perf_counter() - begin


def decode() -> float:
    """Seconds to decode the same samples from NDJSON."""
    engine, batch = engine_with([])
    generator = engine.generator("adsb")
    lines = [encode_ndjson(batch.take(slice(s, s + BATCH))) for s in range(0, len(batch), BATCH)]
    begin = time.perf_counter()
    for data in lines:
        decode_ndjson(data, generator.schema, generator.stream.pools)
    return time.perf_counter() - begin


def main() -> None:
    """Print the table."""
    every = "dyknow:HighSpeedEvent(?o, dyknow:Aircraft, 800)"
    one = [f"dyknow:HighSpeedEvent(dyknow:3950c8, dyknow:Aircraft, {n})" for n in range(500, 510)]
    cases: list[tuple[str, Callable[[], float]]] = [
        ("NDJSON decoding alone", decode),
        ("publish, nobody asks", lambda: publish([])),
        ("publish, HighSpeedEvent for all from coordinates", lambda: publish([every])),
        ("the same, and 10 requests for one aircraft", lambda: publish([every, *one])),
    ]
    samples = len(recording()[1])
    publish([every])  # compile kernels, warm parsers
    print(f"through the engine: {samples} samples of 30 aircraft in batches of {BATCH}")
    for label, case in cases:
        seconds = statistics.median(case() for _ in range(RUNS))
        print(f"{label:<52} {samples / seconds / 1e3:>9.0f} k samples/s")


if __name__ == "__main__":
    np.seterr(all="raise", under="ignore")
    main()
