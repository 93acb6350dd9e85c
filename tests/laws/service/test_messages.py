"""The messages of samples, encoded column by column, are those of the samples one by one."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from dyknow.converters.json_rows import cells, time_cells
from dyknow.converters.ndjson import encode_ndjson, sample_json
from dyknow.converters.wire import Incoming
from dyknow.engine.engine import Engine
from dyknow.engine.model.views import StreamDeclaration
from dyknow.service.sse.clients import EventClient, EventClients
from dyknow.service.sse.cursor import Cursor, Start
from dyknow.service.sse.delivery import WHOLE, Projection
from dyknow.service.sse.feeds import Feeds
from dyknow.streams.sample import Field, FieldType, SampleBatch, Schema, batch_from_rows
from dyknow.streams.time import TIME_MAX, TIME_MIN, format_time

NAME = "s5"
SCHEMA = Schema(
    (
        Field("id", FieldType.STRING),
        Field("to", FieldType.STRING),
        Field("v", FieldType.FLOAT),
        Field("100 %b", FieldType.INTEGER),
        Field("up", FieldType.BOOLEAN),
    )
)
SSL = """stream s5 contains
  speed(UAV as a) = v, xydist(UAV as a, UAV as b) = v for every a = id, b = to"""
TEXTS = st.text(st.characters(exclude_categories=["Cs"]), max_size=4) | st.sampled_from(
    ["\0", '"', "\\", "\n\n", "\r", "%b", "a\u2028b", "\U0001f681", "\x7f"]
)
VALUES = {
    "id": st.none() | st.sampled_from(["uav1", "uav%s"]),
    "to": st.none() | TEXTS,
    "v": st.none() | st.floats(allow_nan=False, allow_infinity=False),
    "100 %b": st.none() | st.integers(-(2**63), 2**63 - 1),
    "up": st.none() | st.booleans(),
}
SAMPLES = st.lists(st.tuples(st.integers(0, 2), st.fixed_dictionaries(VALUES)), max_size=8)
PROJECTIONS = st.sampled_from(
    [WHOLE, Projection(has_rdf=False), Projection(("up", "id")), Projection((), has_rdf=False)]
)


def engine_with(*texts: str) -> Engine:
    engine = Engine(epoch="e%b1")
    engine.declare(StreamDeclaration(NAME, SCHEMA.fields))
    for text in texts:
        engine.annotate(text)
    return engine


def publish(engine: Engine, rows: list[tuple[int, int, dict[str, Any]]]) -> None:
    pools = engine.accepting(NAME).stream.pools
    engine.publish(NAME, Incoming(batch_from_rows(SCHEMA, rows, pools), False), 0)


def by_definition(engine: Engine, projection: Projection) -> bytes:
    """The messages of all samples, each made by itself."""
    stream = engine.generator(NAME).stream
    found = b""
    for number in range(1, stream.last_number + 1):
        sample = stream.at(np.array([number]))
        (available, valid, values), *_ = sample.rows()
        told: dict[str, Any] = {
            "stream": NAME,
            "sequence": number,
            "available": format_time(available),
            "valid": format_time(valid),
            "values": {name: values[name] for name in projection.names(values)},
        }
        if projection.has_rdf:
            place = np.array([number - stream.number_at(available)])
            (told["rdf"],) = engine.rdf_of(NAME, sample, lambda _, place=place: place)
        data = msgspec.json.encode(told)
        found += b"id: e%%b1-%d\nevent: sample\ndata: %s\n\n" % (number, data)
    return found


@given(SAMPLES, st.data(), PROJECTIONS)
@settings(deadline=None)
def test_messages_are_those_of_the_samples_one_by_one(
    drawn: list[tuple[int, dict[str, Any]]], data: st.DataObject, projection: Projection
) -> None:
    """Wherever the samples are cut into batches, and however they are taken."""
    engine = engine_with(SSL)
    feeds = Feeds(engine, 2_000, EventClients(10, 10, 0, 30))
    feeds.all.rounds.add = lambda feed: None  # type: ignore[method-assign]  # no event loop here
    cursor = Cursor(feeds, NAME, Start(1), None, projection)
    cursor.join(EventClient("x"))
    times = np.cumsum([step for step, _ in drawn]).tolist()
    rows = [(t, 7 * t, values) for t, (_, values) in zip(times, drawn, strict=True)]
    taken, start = b"", 0
    while start < len(rows):
        count = data.draw(st.integers(1, len(rows) - start))
        publish(engine, rows[start : start + count])
        start += count
        if start == len(rows) or data.draw(st.booleans()):
            while (piece := cursor.take()) is not None:
                taken += piece
    assert taken == by_definition(engine, projection)


def test_long_texts_are_encoded_a_few_at_a_time(monkeypatch: Any) -> None:
    """The memory for messages that are made at once has a bound."""
    engine = engine_with()
    encoded: list[int] = []
    rdf_of = engine.rdf_of

    def counted(name: str, batch: SampleBatch, places: Any) -> list[str]:
        encoded.append(len(batch))
        return rdf_of(name, batch, places)

    monkeypatch.setattr(engine, "rdf_of", counted)
    rest = {"to": None, "v": 0.5, "100 %b": 1, "up": True}
    publish(engine, [(i, i, {"id": "x" * 40_000, **rest}) for i in range(1, 9)])
    feeds = Feeds(engine, 1 << 20, EventClients(10, 10, 0, 30))
    cursor = Cursor(feeds, NAME, Start(1))
    cursor.join(EventClient("x"))
    taken = b""
    while (piece := cursor.take()) is not None:
        taken += piece
    assert taken == by_definition(engine, WHOLE)
    assert max(encoded[:-8]) <= 3


@given(st.lists(st.tuples(st.integers(1, 3), st.integers(TIME_MIN, TIME_MAX)), max_size=4))
@settings(deadline=None)
def test_cells_of_times_are_the_times(runs: list[tuple[int, int]]) -> None:
    times = np.array([time for count, time in runs for _ in range(count)], np.int64)
    assert time_cells(times) == [b'"%s"' % format_time(t).encode() for t in times.tolist()]


@given(st.lists(st.none() | st.booleans() | st.floats() | TEXTS))
def test_cells_are_the_values_as_json(values: list[Any]) -> None:
    assert cells(values) == [msgspec.json.encode(value) for value in values]


@given(SAMPLES)
@settings(deadline=None)
def test_ndjson_is_that_of_the_samples_one_by_one(drawn: list[tuple[int, dict[str, Any]]]) -> None:
    batch = batch_from_rows(SCHEMA, [(step, -step, values) for step, values in drawn])
    lines = [msgspec.json.encode(sample_json(*row)) + b"\n" for row in batch.rows()]
    assert encode_ndjson(batch) == b"".join(lines)
