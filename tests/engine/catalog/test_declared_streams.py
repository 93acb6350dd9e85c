"""Streams that are declared again: what may change, and what stays (SPEC §1, API.md)."""

import pytest
from feeding import feed

from dyknow.engine.model.errors import Conflict
from dyknow.engine.model.views import Since, StreamDeclaration
from dyknow.streams.history import Retention
from dyknow.streams.sample import Field, FieldType
from dyknow.streams.time import SECOND

ID, SPD, ALT = (
    Field("id", FieldType.STRING),
    Field("spd", FieldType.FLOAT),
    Field("alt", FieldType.FLOAT),
)
SSL = "stream s contains speed(UAV) = spd [km.h-1] for every UAV = id"
EVENT = "dyknow:HighSpeedEvent(?o, dyknow:UAV, 100)"


def declared(*fields, **other):
    return StreamDeclaration("s", fields or (ID, SPD), **other)


def rows(count, *, start=0, **values):
    return [(start + i, {"id": "uav1", "spd": 150.0, **values}) for i in range(count)]


@pytest.mark.parametrize(
    "other",
    [
        declared(ID, SPD, ALT),
        declared(ALT, SPD, ID),
        declared(lateness=SECOND),
        declared(namespace="http://example.org/"),
        declared(ID, Field("spd", FieldType.INTEGER)),
    ],
    ids=["field", "order", "lateness", "namespace", "type"],
)
def test_a_stream_declared_anew_keeps_its_annotation(engine, other):
    engine.declare(declared())
    engine.annotate(SSL)
    engine.declare(other)
    assert engine.stream("s").annotation == SSL
    assert engine.match("dyknow:speed", sort="dyknow:UAV").found
    assert engine.rdf_of("s", engine.generator("s").stream.all()) == []


def test_fields_are_added_to_a_stream_in_use(engine, high_speed):
    engine.declare(declared())
    engine.annotate(SSL)
    engine.register_template(high_speed)
    stream = engine.request_event(engine.parse_request(EVENT)).stream
    policed = engine.subscribe("s", "any change", since=Since.START)
    feed(engine, "s", rows(10))
    engine.declare(declared(ID, ALT, SPD, Field("note", FieldType.STRING)))
    feed(engine, "s", rows(10, start=10, alt=1.0, note="high"))
    kept = [values for _, _, values in engine.generator("s").stream.all().rows()]
    assert [(v["alt"], v["note"]) for v in kept] == [(None, None)] * 10 + [(1.0, "high")] * 10
    assert list(kept[0]) == ["id", "alt", "spd", "note"]
    # Units that run see the fields that they know; whoever asks now gets them all.
    assert engine.generator(policed.stream).schema.names == ("id", "spd")
    assert len(engine.generator(policed.stream).stream) == 20
    again = engine.subscribe("s", "any change", since=Since.START)
    assert engine.generator(again.stream).schema.names == ("id", "alt", "spd", "note")
    assert len(engine.generator(again.stream).stream) == 20
    engine.end("s")
    # The windows that end at 0 s to 23 s have samples.
    assert len(engine.generator(stream).stream) == 24
    assert engine.request_event(engine.parse_request(EVENT)).stream == stream


def test_held_back_and_late_samples_get_the_new_fields(engine):
    engine.declare(declared(lateness=5 * SECOND))
    late = engine.generator("s_late")
    feed(engine, "s", rows(10))
    engine.declare(declared(ID, SPD, ALT, lateness=5 * SECOND))
    feed(engine, "s", [*rows(1, start=20, alt=1.0), *rows(1, start=2, alt=2.0)])
    engine.end("s")
    found = [values["alt"] for _, _, values in engine.generator("s").stream.all().rows()]
    assert found == [None] * 10 + [1.0]
    assert [values["alt"] for _, _, values in late.stream.all().rows()] == [2.0]


def test_lateness_of_a_stream_in_use(engine):
    engine.declare(declared())
    feed(engine, "s", rows(10))
    engine.declare(declared(lateness=5 * SECOND))
    # What was promised stays: nothing earlier than the watermark is taken.
    feed(engine, "s", [*rows(1, start=20), *rows(1, start=16), *rows(1, start=5)])
    engine.end("s")
    counters = engine.stream("s").counters
    assert (counters.used, counters.late) == (12, 1)


@pytest.mark.parametrize(
    ("other", "why", "hint"),
    [
        (declared(ID), "the declaration lacks its field 'spd'", "declare all of its fields"),
        (
            declared(ID, Field("spd", FieldType.INTEGER), ALT),
            "its field 'spd' is float, not integer",
            "declare 'spd' as float",
        ),
        (declared(namespace="http://example.org/"), "namespace", "declare that namespace"),
    ],
    ids=["removal", "type", "namespace"],
)
def test_what_may_not_change_of_a_stream_in_use(engine, other, why, hint):
    engine.declare(declared())
    feed(engine, "s", rows(1))
    with pytest.raises(Conflict, match=why) as refused:
        engine.declare(other)
    assert hint in refused.value.hint
    assert engine.generator("s").schema.names == ("id", "spd")


def test_retention_holds_after_a_text_field_was_added(engine):
    engine.declare(declared(ID, SPD, retention=Retention(bytes=10_000)))
    feed(engine, "s", rows(50))
    more = declared(ID, SPD, Field("n", FieldType.STRING), retention=Retention(bytes=10_000))
    engine.declare(more)
    for i in range(100):
        feed(engine, "s", rows(1, start=50 + i, n="x"))
    kept = engine.generator("s").stream
    assert int(kept.all().sizes().sum()) <= 10_000
    assert len(kept) > 20
