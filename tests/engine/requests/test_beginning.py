"""Requests that begin at a moment of the past: what they share, and what is there after a restart
(the law is in tests/laws/engine/test_beginning.py)."""

import pytest
from feeding import feed, flight

import dyknow.engine.durability.durable_engine as recorded_module
from dyknow.engine.durability.commands import (
    Annotate,
    DeclareStream,
    Publish,
    RegisterQuery,
    RegisterTemplate,
    RequestEvent,
    Subscribe,
    SubscribeToFeature,
)
from dyknow.engine.durability.durable_engine import RecordedEngine
from dyknow.engine.model.errors import BadArguments
from dyknow.engine.model.views import StreamDeclaration
from dyknow.journal.durability import Durability
from dyknow.streams.history import Retention
from dyknow.streams.past_queries import Forgotten
from dyknow.streams.sample import Field, FieldType
from dyknow.streams.time import SECOND

COORDINATES = "stream c contains latitude(UAV) = lat, longitude(UAV) = lon for every UAV = id"
POSITIONS = tuple(
    Field(name, FieldType.STRING if name == "id" else FieldType.FLOAT)
    for name in ("id", "lat", "lon")
)
EVENT = "dyknow:HighSpeedEvent(?o, dyknow:UAV, 1)"
SPEED = (Field("id", FieldType.STRING), Field("v", FieldType.FLOAT))
QUERY = """SELECT ?o ?v ?a WHERE { ?o dyknow:speed ?v ; dyknow:altitude ?a }
WINDOW [RANGE 100s STEP 1s]"""


def fly(engine, first, count):
    rows = flight(0, first + count, 400)[first:]
    feed(engine, "c", [(t, {"id": "uav1", "lat": lat, "lon": lon}) for t, lat, lon in rows])


def request(engine, since):
    return engine.request_event(engine.parse_request(EVENT), since=since)


@pytest.fixture
def flying(engine, high_speed):
    engine.declare(StreamDeclaration("c", POSITIONS, retention=Retention(10)))
    engine.annotate(COORDINATES)
    engine.register_template(high_speed)
    return engine


@pytest.mark.parametrize("since", ["6000000000", "now"])
def test_a_stream_that_began_later_is_made_anew(flying, since):
    fly(flying, 0, 10)
    first, second = request(flying, since), request(flying, "5000000000")
    assert second.stream != first.stream
    speeds = flying.stream(second.plan.units[-1].inputs[0])
    assert speeds.first_available == 6 * SECOND, "there is no speed of one position"


def test_a_stream_from_the_start_is_not_taken_for_more_than_was_kept(flying):
    """Its speeds are of the positions from 10 s on: earlier ones were forgotten when it began."""
    for second in range(20):
        fly(flying, second, 1)
    request(flying, "start")
    with pytest.raises(Forgotten):
        request(flying, "5000000000")
    request(flying, "10000000000")


def test_a_stream_that_began_before_is_shared(flying):
    fly(flying, 0, 10)
    first = request(flying, "2000000000")
    second = request(flying, "4000000000")
    assert first.stream != second.stream
    assert {unit.output for unit in first.plan.units} & {unit.output for unit in second.plan.units}


def test_a_stream_that_is_still_to_begin_is_not_shared_by_a_request_of_now(flying):
    fly(flying, 0, 3)
    later = request(flying, "10000000000")
    now = request(flying, "now")
    fly(flying, 3, 30)
    flying.end("c")
    first = [flying.stream(view.plan.units[-1].inputs[0]).first_available for view in (later, now)]
    assert first == [11 * SECOND, 4 * SECOND], "a speed is of two positions"


def test_of_several_streams_the_newest_sample_counts(engine):
    for name, meaning in (("s", "speed"), ("t", "altitude")):
        engine.declare(StreamDeclaration(name, SPEED))
        engine.annotate(f"stream {name} contains {meaning}(UAV) = v for every UAV = id")
    for stream, last in (("s", 8), ("t", 20)):
        for second in range(last):
            feed(engine, stream, [(second + 1, {"id": "uav1", "v": float(second + 1)})])
    asked = engine.queries.register(f"REGISTER QUERY both AS {QUERY}", since="13s")
    for name in "st":
        engine.end(name)
    rows = [values for _, _, values in engine.generator(asked.stream).stream.all().rows()]
    assert {row["v"] for row in rows} == {7.0, 8.0}
    assert min(row["a"] for row in rows) == 7.0


@pytest.mark.parametrize("text", ["", "soon", "-3s", "NOW", "e1-7", "1e9"])
def test_another_text_is_refused(flying, text):
    for ask in (
        lambda: request(flying, text),
        lambda: flying.subscribe("c", since=text),
        lambda: flying.subscribe_to_feature("speed", sort="UAV", since=text),
        lambda: flying.queries.register(QUERY, since=text),
    ):
        with pytest.raises(BadArguments, match="neither now, start, a time nor a duration"):
            ask()


def opened(path):
    return RecordedEngine(path, now=0, durability=Durability.WRITE)


def close(recorded):
    recorded.log.commit()
    recorded._directory.close()


def say(recorded, first, last):
    for second in range(first, last):
        row = b'{"valid": %d, "available": %d, "id": "uav1", "v": %d.0}' % (
            second * SECOND,
            second * SECOND,
            second,
        )
        recorded.do(Publish("s", "ndjson", row, 0))


def answers(recorded, streams):
    engine = recorded.engine
    return [list(engine.generator(stream).stream.all().rows()) for stream in streams]


@pytest.fixture
def asked(tmp_path):
    """A directory in which all kinds of requests began at a time and a duration, and then more
    samples came than are kept; with what they gave."""
    first = opened(tmp_path)
    first.do(DeclareStream(StreamDeclaration("s", SPEED, retention=Retention(8))))
    first.do(Annotate("stream s contains speed(UAV) = v for every UAV = id"))
    first.do(
        RegisterTemplate(
            "REGISTER TEMPLATE dyknow:Fast(?o, ?l) COMPUTE EVERY 1s AS SELECT ?o ?v "
            "WHERE { ?o dyknow:speed ?v FILTER (?v > ?l) } WINDOW [RANGE 2s STEP 1s]"
        )
    )
    say(first, 1, 7)
    query = "SELECT ?v WHERE { ?o dyknow:speed ?v } WINDOW [RANGE 2s STEP 1s]"
    streams = [
        first.do(command).stream
        for since in ("3000000000", "2s")
        for command in (
            RequestEvent("dyknow:Fast(?o, 0)", since=since),
            Subscribe("s", "any change", since=since),
            SubscribeToFeature("dyknow:speed", sort="dyknow:UAV", since=since),
            RegisterQuery(query, since=since),
        )
    ]
    say(first, 7, 20)
    return first, streams, tmp_path


@pytest.mark.parametrize("checkpoint", [False, True])
def test_it_is_the_same_after_a_restart(asked, checkpoint):
    first, streams, path = asked
    given = answers(first, streams)
    assert all(given)
    begun = [
        min(next(v for v in row.values() if isinstance(v, float)) for _, _, row in each)
        for each in given
    ]
    # The stream of a policy keeps as many samples as its source.
    assert begun == [3, 12, 3, 3, 4, 12, 4, 4]
    if checkpoint:
        first.checkpoint().write()
    close(first)
    again = opened(path)
    assert again.recovery.is_continued
    assert answers(again, streams) == given
    say(again, 20, 22)
    assert all(map(len, answers(again, streams)))
    close(again)


def test_another_program_begins_with_what_is_kept(asked, monkeypatch):
    """What was accepted must not be refused by an upgrade, as its time is forgotten by now."""
    first, _, path = asked
    first.checkpoint().write()
    close(first)
    monkeypatch.setattr(recorded_module, "program", lambda *_: "a later version")
    later = opened(path)
    engine = later.engine
    assert not later.recovery.is_continued
    assert len(engine.events()) == 2
    assert len(engine.subscriptions()) == 4
    assert [view.state for view in engine.queries.views()] == ["running"] * 2
    later_streams = [view.stream for view in engine.events()]
    say(later, 20, 22)
    oldest = [rows[0][2]["v"] for rows in answers(later, later_streams)]
    assert oldest == [12.0, 17.0], "that of the duration begins 2 s before the newest sample"
    close(later)
