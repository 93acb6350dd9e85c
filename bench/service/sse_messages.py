"""What a message of server-sent events costs: whole, without RDF, with some fields, and conflated.

    python bench/service/sse_messages.py

20,000 samples of 200 objects, with four fields of which two are annotated. Then the events of
100,000 objects, half of which fire in each second, for one client, with a history of the input that
is as long as a window or much shorter. CPU time, without HTTP.
"""

from __future__ import annotations

import statistics
import time
from pathlib import Path

import numpy as np

from dyknow.converters.wire import Incoming
from dyknow.engine.engine import Engine
from dyknow.engine.model.views import StreamDeclaration
from dyknow.service.sse.clients import EventClient, EventClients
from dyknow.service.sse.cursor import Start
from dyknow.service.sse.delivery import WHOLE, Delivery, Projection
from dyknow.service.sse.feeds import Feeds, cursor_of
from dyknow.streams.history import Retention
from dyknow.streams.sample import Column, Field, FieldType, SampleBatch, batch_from_rows
from dyknow.streams.time import MILLISECOND, SECOND

SSL = "stream s contains speed(UAV) = v, altitude(UAV) = alt for every UAV = id"
SAMPLES, OBJECTS, RUNS = 20_000, 200, 3
SHORT = Projection(("id", "v"), has_rdf=False)
DELIVERIES = {
    "whole": Delivery(),
    "rdf=no": Delivery(projection=Projection(has_rdf=False)),
    "rdf=no&fields=id,v": Delivery(projection=SHORT),
    "every=1s": Delivery(projection=WHOLE, every=SECOND),
    "every=1s&rdf=no&fields=id,v": Delivery(projection=SHORT, every=SECOND),
}
TEMPLATE = Path(__file__).parents[2] / "templates" / "library" / "high_speed.rq"
MANY, BATCH, WARM, STEPS = 100_000, 10_000, 7, 5


def main() -> None:
    engine = Engine()
    numbers = [Field(name, FieldType.FLOAT) for name in ("v", "alt", "heading")]
    engine.declare(StreamDeclaration("s", (Field("id", FieldType.STRING), *numbers)))
    engine.annotate(SSL)
    rows = [
        (i * MILLISECOND, i * MILLISECOND, {"id": f"uav{i % OBJECTS}", "v": i / 10, "alt": i / 5})
        for i in range(SAMPLES)
    ]
    stream = engine.generator("s")
    whole = [(a, v, {**values, "heading": 1.0}) for a, v, values in rows]
    batch = batch_from_rows(stream.schema, whole, stream.stream.pools)
    engine.publish("s", Incoming(batch, False), 0)
    print(f"{SAMPLES:,} samples of {OBJECTS} objects: CPU time of all, and for each sample")
    for name, delivery in DELIVERIES.items():
        best, size = min(_sent(engine, delivery) for _ in range(RUNS))
        each = f"{best / SAMPLES * 1e6:6.2f} µs  {size / SAMPLES:6.1f} bytes"
        print(f"{name:30} {best * 1e3:8.1f} ms  {each}")
    print(f"a second of {MANY:,} objects: CPU time, that of the messages, and events")
    for kept in (MANY * 10, 1_000):
        step, messages, events = _step_of_many(kept)
        told = f"{step * 1e3:8.1f} ms  {messages * 1e3:8.1f} ms  {events:9,}"
        print(f"{f'history of {kept:,} samples':30} {told}")


def _step_of_many(kept: int) -> tuple[float, float, int]:
    """Medians of CPU seconds for a second of samples and for the messages of its events, and the
    number of these, where the input keeps ``kept`` samples."""
    engine = Engine()
    fields = (Field("id", FieldType.STRING), Field("v", FieldType.FLOAT))
    engine.declare(StreamDeclaration("s", fields, retention=Retention(kept)))
    engine.annotate("stream s contains speed(UAV) = v for every UAV = id")
    engine.register_template(TEMPLATE.read_text())
    request = engine.parse_request("dyknow:HighSpeedEvent(?o, dyknow:UAV, 50)")
    events = engine.generator(engine.request_event(request).stream)
    feeds = Feeds(engine, 1 << 26, EventClients(1, 1, 0, 30))
    feeds.all.rounds.add = lambda feed: None  # type: ignore[method-assign]  # no event loop here
    cursor = cursor_of(feeds, events.name, Start(1), Delivery())
    cursor.join(EventClient("x"))
    names = [f"uav{i}" for i in range(MANY)]
    speeds = np.random.default_rng(1).uniform(0, 100, MANY)
    stream, steps, messages, before = engine.generator("s").stream, [], [], 0
    for second in range(WARM + STEPS):
        before = events.counters.used
        begin = time.process_time()
        for start in range(0, MANY, BATCH):
            rows = slice(start, start + BATCH)
            times = second * SECOND + 1 + np.arange(start, start + BATCH) * (SECOND // MANY)
            pool = stream.pools["id"]
            id = Column(FieldType.STRING, pool.encode(names[rows]), None, pool)
            columns = {"id": id, "v": Column(FieldType.FLOAT, speeds[rows])}
            engine.publish("s", Incoming(SampleBatch(times, times, columns), False), 0)
        made = time.process_time()
        while cursor.take() is not None:
            pass
        steps.append(time.process_time() - begin)
        messages.append(time.process_time() - made)
    count = events.counters.used - before
    return statistics.median(steps[WARM:]), statistics.median(messages[WARM:]), count


def _sent(engine: Engine, delivery: Delivery) -> tuple[float, int]:
    """CPU seconds and bytes of the messages of all samples for a first client."""
    feeds = Feeds(engine, 1 << 26, EventClients(1, 1, 0, 30))
    cursor, client = cursor_of(feeds, "s", Start(1), delivery), EventClient("x")
    cursor.join(client)
    begin, size = time.process_time(), 0
    while (data := cursor.take()) is not None:
        size += len(data)
    seconds = time.process_time() - begin
    cursor.leave(client)
    return seconds, size


if __name__ == "__main__":
    main()
