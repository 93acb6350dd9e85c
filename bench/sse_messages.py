"""What a message of server-sent events costs: whole, without RDF, with some fields, and conflated.

    python bench/sse_messages.py

20,000 samples of 200 objects, with four fields of which two are annotated. CPU time, without HTTP.
"""

from __future__ import annotations

import time

from dyknow.converters.wire import Incoming
from dyknow.engine.engine import Engine
from dyknow.engine.model.views import StreamDeclaration
from dyknow.service.sse.clients import EventClient, EventClients
from dyknow.service.sse.cursor import Start
from dyknow.service.sse.delivery import WHOLE, Delivery, Projection
from dyknow.service.sse.feeds import Feeds, cursor_of
from dyknow.streams.sample import Field, FieldType, batch_from_rows
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
