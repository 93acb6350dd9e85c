"""What must not be lost or doubled when something fails, comes twice, or has changed since."""

import gc
from dataclasses import replace

import pytest
from feeding import feed, flight, samples

from dyknow.converters.errors import ConversionError
from dyknow.engine.engine import Engine
from dyknow.engine.model.errors import BadArguments, Refused
from dyknow.engine.model.views import Since, StreamDeclaration
from dyknow.streams.sample import Field, FieldType

SPEEDS = "stream speeds contains speed(UAV) = spd [km.h-1] for every UAV = id"
COORDINATES = (
    "stream coordinates contains latitude(UAV) = lat, longitude(UAV) = lon for every UAV = id"
)
ALL = "dyknow:HighSpeedEvent(?o, dyknow:UAV, 100)"
PAIRS = """REGISTER TEMPLATE dyknow:PairEvent(?o) COMPUTE EVERY 1s AS
PREFIX dyknow: <http://www.ida.liu.se/dyknow/>
SELECT ?o ?p (COUNT(?t) AS ?n)
WHERE { ?o a dyknow:UAV . ?o dyknow:speed ?s . ?p dyknow:speed ?t }
GROUP BY ?o ?p
WINDOW [RANGE 1s STEP 1s]"""
FIELDS = (Field("id", FieldType.STRING), Field("spd", FieldType.FLOAT))


def request(engine, since=Since.NOW):
    return engine.request_event(engine.parse_request(ALL), since=since)


def positions(start, seconds):
    return [
        (t, {"id": "uav1", "lat": lat, "lon": lon}) for t, lat, lon in flight(start, seconds, 400)
    ]


def broken(parameters):
    def fail(*arguments):
        raise RuntimeError("broken")

    return fail


@pytest.fixture
def breakable(engine, high_speed):
    """An engine whose unit for speeds fails until `mend` is called."""
    engine.annotate(COORDINATES)
    engine.register_template(high_speed)
    own = engine._parts.known_transformations.implementation
    known = own("coordinatesToSpeed")
    engine._parts.known_transformations.implementation = lambda name: replace(known, make=broken)

    def mend():
        engine._parts.known_transformations.implementation = own

    return engine, mend


def test_a_unit_that_fails_on_the_past_is_told_and_can_be_cancelled(breakable):
    engine, _ = breakable
    feed(engine, "coordinates", positions(0, 3))
    view = request(engine, Since.START)
    assert [v["change"] for _, v in samples(engine, "status")].count("unit failed") == 1
    assert engine.stream("coordinates").subscribers == 0
    engine.cancel_event(view.id)
    assert {stream.name for stream in engine.streams()} == {"status", "coordinates"}


def test_a_request_does_not_share_a_unit_whose_inputs_have_failed(breakable):
    engine, mend = breakable
    first = request(engine)
    feed(engine, "coordinates", positions(0, 3))
    mend()
    second = request(engine)
    assert second.stream != first.stream
    feed(engine, "coordinates", positions(3, 12))
    engine.end("coordinates")
    assert samples(engine, second.stream)
    engine.cancel_event(first.id)
    engine.cancel_event(second.id)
    assert {stream.name for stream in engine.streams()} == {"status", "coordinates"}


def test_a_request_after_an_annotation_was_corrected_reads_the_new_meaning(engine, high_speed):
    engine.annotate(SPEEDS)
    engine.register_template(high_speed)
    before = request(engine)
    engine.annotate(SPEEDS.replace("km.h-1", "m.s-1"))
    after = request(engine)
    assert request(engine).stream == after.stream
    feed(engine, "speeds", [(0.5, {"id": "uav1", "spd": 50.0})])
    engine.end("speeds")
    assert samples(engine, before.stream) == []
    assert samples(engine, after.stream)[0][1]["speed"] == pytest.approx(180.0)
    for view in engine.events():
        engine.cancel_event(view.id)
    assert {stream.name for stream in engine.streams()} == {"status", "speeds"}


def test_two_patterns_over_one_stream_read_each_sample_once(engine):
    engine.annotate(SPEEDS)
    engine.register_template(PAIRS)
    view = engine.request_event(engine.parse_request("dyknow:PairEvent(?o)"))
    feed(engine, "speeds", [(0.5, {"id": "uav1", "spd": 3.0})])
    engine.end("speeds")
    ((_, values),) = samples(engine, view.stream)
    assert values["n"] in (1, "1")


def test_a_strategy_that_there_is_not_is_a_wrong_argument(engine):
    with pytest.raises(BadArguments, match="no strategy 'best'"):
        engine.match("speed", strategy="best")


def test_an_annotation_that_no_sample_could_follow_makes_no_stream(engine):
    with pytest.raises(ConversionError):
        engine.annotate("stream s contains speed(UAV) = id for every UAV = id")
    assert [stream.name for stream in engine.streams()] == ["status"]
    assert engine.ontology.registered.annotations == {}


def test_the_answer_of_a_request_is_annotated_in_the_stream_space(engine, high_speed):
    engine.annotate(SPEEDS)
    engine.register_template(high_speed)
    view = request(engine)
    _, rows = engine.ontology.query_rows(
        "SELECT ?name WHERE { ?s a dyknow-o:Stream ; dyknow-o:hasName ?name ; "
        "dyknow-o:hasAnnotation/dyknow-o:hasOutputAnnotation/dyknow-o:describesFeature "
        "dyknow:HighSpeedEvent }"
    )
    assert [row[0].value for row in rows] == [view.stream]
    assert engine.ontology.validate().conforms


@pytest.mark.parametrize("name", ["Stream", "hasInput", "coordinatesToSpeed", "dyknow_cu1"])
def test_a_stream_takes_no_name_that_the_stream_space_uses(engine, name):
    with pytest.raises(Refused, match="system's own name"):
        engine.declare(StreamDeclaration(name, FIELDS))
    with pytest.raises(Refused, match="system's own name"):
        engine.annotate(f"stream {name} contains speed(UAV) = spd for every UAV = id")


def test_an_annotation_that_holds_no_more_is_told_and_does_not_keep_the_engine_down(tmp_path):
    engine = Engine(tmp_path)
    engine.annotate(SPEEDS)
    # As if an earlier ontology had known the feature.
    engine.ontology.registered.annotations["old"] = (
        "stream old contains bygone(UAV) = b for every UAV = id"
    )
    del engine
    gc.collect()
    engine = Engine(tmp_path)
    assert {stream.name for stream in engine.streams()} == {"status", "speeds"}
    (told,) = [v for _, v in samples(engine, "status") if v["change"] == "not restored"]
    assert told["stream"] == "old"
    assert "bygone" in told["specification"]
    assert "old" in engine.ontology.registered.annotations


def test_kept_texts_that_cannot_be_read_do_not_stop_the_start(tmp_path, high_speed):
    engine = Engine(tmp_path)
    engine.register_template(high_speed)
    engine.ontology.registered.templates["http://www.ida.liu.se/dyknow/OldEvent"] = (
        "REGISTER TEMPLATE ?"
    )
    engine.ontology.registered.streams["old"] = "{}"
    del engine
    gc.collect()
    again = Engine(tmp_path)
    assert [view.local_name for view in again.templates()] == ["HighSpeedEvent"]
    told = [v["stream"] for _, v in samples(again, "status") if v["change"] == "not restored"]
    assert told == ["dyknow:OldEvent", "old"]
