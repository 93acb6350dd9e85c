"""Samples per second through the whole engine: publish → units → windows → results.

    python bench/service/service.py
    python bench/service/service.py http [RECORDING]

The demonstration's recording is repeated end to end; requests run while it is published. Measured
without HTTP, so that the rows can be compared; `ndjson` adds decoding the wire format.

``http``: requests for one aircraft each, through a service of its own, without and with a data
directory, and with a client for each request. Samples per second of processor time of the service,
until it does nothing more; RECORDING is a longer one of the same fields.
"""

from __future__ import annotations

import http.client
import statistics
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import numpy as np
from latency import cpu_seconds

from dyknow.converters.ndjson import decode_ndjson, encode_ndjson
from dyknow.converters.recordings.recording import open_recording
from dyknow.converters.wire import Incoming
from dyknow.engine.engine import Engine
from dyknow.engine.model.views import StreamDeclaration
from dyknow.streams.sample import SampleBatch, concatenate
from journal import Served

ROOT = Path(__file__).parents[2]
REPEATS = 6
BATCH = 5_000
RUNS = 3
SENT = 5_000
"""Samples a request over HTTP, as `dyknow replay` sends them."""
QUIET = 0.5
"""Seconds without work after which a service has done all."""


def recording(path: Path | None = None) -> tuple[StreamDeclaration, SampleBatch]:
    """The recording at ``path``, or the slice, repeated one after the other in time."""
    source = open_recording(path or ROOT / "examples" / "adsb.csv.gz")
    batch = concatenate([incoming.batch for incoming in source])
    period = int(batch.available[-1] - batch.available[0]) + 1_000_000_000
    if path is not None:
        return StreamDeclaration("adsb", source.schema.fields), batch
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


def through_http(path: Path | None) -> None:
    """Print the table of requests through a service."""
    declaration, batch = recording(path)
    bodies = [encode_ndjson(batch.take(slice(s, s + SENT))) for s in range(0, len(batch), SENT)]
    column = batch.columns["icao24"]
    assert column.pool is not None
    codes, counts = np.unique(column.values[column.present], return_counts=True)
    aircraft = [column.pool[code] for code in codes[np.argsort(-counts)].tolist()]
    fields = {field.name: str(field.type) for field in declaration.fields}
    print(f"through HTTP: {len(batch)} samples in batches of {SENT}; k samples per CPU second")
    print(f"{'requests':>8}{'nothing kept':>14}{'kept':>8}{'kept, clients':>15}{'events':>9}")
    for count in (0, 1, 10, 100):
        told = [
            f"dyknow:HighSpeedEvent(dyknow:{aircraft[i % len(aircraft)]}, dyknow:Aircraft, 5{i:02})"
            for i in range(count)
        ]
        rates = []
        for is_kept, has_clients in ((False, False), (True, False), (True, True)):
            with tempfile.TemporaryDirectory() as folder:
                served = Served(Path(folder) if is_kept else None)
                seconds, events = _served(served, fields, bodies, told, has_clients)
                served.end()
            rates.append(len(batch) / seconds / 1e3)
        none, kept, followed = rates
        print(f"{count:8}{none:14.0f}{kept:8.0f}{followed:15.0f}{events:9,}", flush=True)


def _served(
    served: Served, fields: dict[str, str], bodies: list[bytes], told: list[str], has_clients: bool
) -> tuple[float, int]:
    """Processor seconds of a service for these samples, and the events of the requests."""
    client = served.client
    client.put("/streams/adsb", json={"fields": fields}).raise_for_status()
    annotation = (ROOT / "examples" / "adsb.ssl").read_text()
    client.post("/annotations", content=annotation).raise_for_status()
    template = (ROOT / "templates" / "library" / "high_speed.rq").read_text()
    client.post("/templates", content=template).raise_for_status()
    streams = []
    for text in told:
        answer = client.post("/events", content=text, headers={"Content-Type": "text/plain"})
        streams.append(answer.raise_for_status().json()["stream"])
        if has_clients:
            follow = threading.Thread(target=_follow, args=(client.base_url.netloc, streams[-1]))
            follow.daemon = True
            follow.start()
    begun = _spent_at_rest(served)
    kind = {"Content-Type": "application/x-ndjson"}
    for body in bodies:
        while client.post("/streams/adsb/samples", content=body, headers=kind).status_code == 429:
            time.sleep(QUIET)
    spent = _spent_at_rest(served)
    views = [client.get(f"/streams/{stream}").json() for stream in streams]
    return spent - begun, sum(view["counters"]["used"] for view in views)


def _spent_at_rest(served: Served) -> float:
    """Wait until a service does nothing more; return the processor seconds it has taken."""
    before, spent = 0.0, cpu_seconds(served.process)
    while spent > before + 0.05:
        before = spent
        time.sleep(QUIET)
        spent = cpu_seconds(served.process)
    return spent


def _follow(address: bytes, stream: str) -> None:
    connection = http.client.HTTPConnection(address.decode())
    connection.request("GET", f"/streams/{stream}/events")
    answer = connection.getresponse()
    with suppress(http.client.IncompleteRead, OSError):  # the service is killed at the end
        while answer.read1(1 << 16):
            pass


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
    if sys.argv[1:2] == ["http"]:
        through_http(Path(sys.argv[2]) if sys.argv[2:] else None)
    else:
        main()
