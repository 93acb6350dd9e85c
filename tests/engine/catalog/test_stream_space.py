"""The mirror of the running system in the ontology, its status stream, its failures, its memory."""

import gc

import pytest
from feeding import feed, flight, samples

from dyknow.engine.engine import Engine
from dyknow.engine.model.errors import Conflict, Refused
from dyknow.engine.model.views import StreamDeclaration
from dyknow.languages.errors import LanguageError
from dyknow.streams.sample import Field, FieldType

SPEEDS = "stream speeds contains speed(UAV) = spd [km.h-1] for every UAV = id"
COORDINATES = (
    "stream coordinates contains latitude(UAV) = lat, longitude(UAV) = lon for every UAV = id"
)
ALL = "dyknow:HighSpeedEvent(?o, dyknow:UAV, 100)"


def ask(engine, pattern):
    variables, rows = engine.ontology.query_rows(f"SELECT * WHERE {{ {pattern} }}")
    return [
        {name: term.value.split("#")[-1] for name, term in zip(variables, row, strict=True)}
        for row in rows
    ]


def request(engine, text=ALL):
    return engine.request_event(engine.parse_request(text))


@pytest.fixture
def running(engine, high_speed):
    engine.annotate(COORDINATES)
    engine.register_template(high_speed)
    return engine


def test_mirror_answers_what_runs(running):
    view = request(running)
    found = ask(
        running,
        "?unit a dyknow-o:ComputationalUnit ; dyknow-o:instantiationOf ?t ; "
        "dyknow-o:hasInput ?in ; dyknow-o:hasOutput ?out",
    )
    assert {(row["t"], row["in"], row["out"]) for row in found} == {
        ("coordinatesToSpeed", "coordinates", "dyknow_reserved1"),
        ("cSparql", "dyknow_reserved1", view.stream),
    }


def test_mirror_entails_inverses(running):
    request(running)
    (found,) = ask(running, "dyknow-o:coordinates dyknow-o:isInput ?unit")
    assert found == {"unit": "dyknow_cu1"}
    (found,) = ask(running, "dyknow-o:coordinatesToSpeed dyknow-o:hasInstance ?unit")
    assert found == {"unit": "dyknow_cu1"}


def test_mirror_follows_when_units_stop(running):
    before = ask(running, "?s ?p ?o FILTER(STRSTARTS(STR(?s), STR(dyknow-o:)))")
    view = request(running)
    running.cancel_event(view.id)
    after = ask(running, "?s ?p ?o FILTER(STRSTARTS(STR(?s), STR(dyknow-o:)))")
    assert {tuple(row.items()) for row in after} == {tuple(row.items()) for row in before}


def test_stream_space_is_well_formed(running):
    request(running)
    report = running.ontology.validate()
    assert report.conforms, report.text


def test_annotations_of_streams_can_be_queried(running):
    found = ask(
        running,
        "dyknow-o:coordinates dyknow-o:hasAnnotation/dyknow-o:hasOutputAnnotation ?a . "
        "?a dyknow-o:describesFeature dyknow:latitude ; dyknow-o:describesSort ?sort",
    )
    assert [row["sort"].split("/")[-1] for row in found] == ["UAV"]


def test_order_of_a_transformations_inputs_is_kept(engine):
    (found,) = ask(
        engine,
        "dyknow-o:coordinatesToSpeed dyknow-o:hasAnnotation ?a . "
        "?a dyknow-o:hasInputAnnotation ?first . "
        "?first dyknow-o:describesFeature dyknow:latitude ; dyknow-o:nextSegment ?next . "
        "?next dyknow-o:hasInputAnnotation/dyknow-o:describesFeature dyknow:longitude",
    )
    assert found


def test_status_tells_every_change_in_order(running):
    view = request(running)
    running.cancel_event(view.id)
    told = [
        (values["change"], values["stream"] or values["transformation"])
        for _, values in samples(running, "status")
    ]
    assert told == [
        ("transformation annotated", "coordinatesToSpeed"),
        ("stream added", "coordinates"),
        ("stream annotated", "coordinates"),
        ("transformation annotated", "dyknow:HighSpeedEvent"),
        ("stream added", "dyknow_reserved1"),
        ("unit started", "dyknow_reserved1"),
        ("stream annotated", "dyknow_reserved1"),
        ("stream added", "dyknow_reserved2"),
        ("unit started", "dyknow_reserved2"),
        ("stream annotated", "dyknow_reserved2"),
        ("unit stopped", "dyknow_reserved2"),
        ("stream removed", "dyknow_reserved2"),
        ("unit stopped", "dyknow_reserved1"),
        ("stream removed", "dyknow_reserved1"),
    ]


def test_a_unit_that_raises_is_cut_off_and_others_go_on(running):
    view = request(running)
    other = request(running, "dyknow:HighSpeedEvent(?o, dyknow:UAV, 120)")
    unit = running._parts.configuration.units[view.stream]

    def fail(*_):
        raise RuntimeError("out of order")

    unit.evaluator.push = fail
    rows = [(t, {"id": "uav1", "lat": lat, "lon": lon}) for t, lat, lon in flight(1, 20, 150.0)]
    assert feed(running, "coordinates", rows) == 20
    running.end("coordinates")
    assert samples(running, view.stream) == []
    assert samples(running, other.stream)
    failed = [v for _, v in samples(running, "status") if v["change"] == "unit failed"]
    assert [v["specification"] for v in failed] == ["RuntimeError: out of order"]
    again = request(running)
    assert again.stream != view.stream
    running.cancel_event(view.id)
    running.cancel_event(again.id)
    running.cancel_event(other.id)
    assert {view.name for view in running.streams()} == {"status", "coordinates"}


def test_what_was_told_survives_a_restart(tmp_path, high_speed):
    engine = Engine(tmp_path)
    types = {"id": FieldType.STRING, "spd": FieldType.FLOAT, "note": FieldType.STRING}
    fields = tuple(Field(name, type) for name, type in types.items())
    engine.declare(StreamDeclaration("speeds", fields))
    engine.annotate(SPEEDS)
    engine.register_template(high_speed)
    # Oxigraph lets its folder go when nothing refers to the store any more.
    del engine
    gc.collect()
    again = Engine(tmp_path)
    assert [field.name for field in again.stream("speeds").fields] == ["id", "spd", "note"]
    assert again.stream("speeds").annotation
    view = request(again)
    feed(again, "speeds", [(i, {"id": "u", "spd": 150.0, "note": None}) for i in range(1, 4)])
    again.end("speeds")
    assert samples(again, view.stream)


def test_a_new_annotation_replaces_the_old(engine):
    engine.annotate("stream s contains speed(UAV) = a for every UAV = id")
    engine.declare(
        StreamDeclaration("t", (Field("id", FieldType.STRING), Field("b", FieldType.FLOAT)))
    )
    engine.annotate("stream t contains speed(UAV) = b for every UAV = id")
    engine.annotate("stream t contains altitude(UAV) = b for every UAV = id")
    assert "altitude" in (engine.stream("t").annotation or "")
    assert len([a for a in engine.annotations() if "stream t" in a.source]) == 1


@pytest.mark.parametrize(
    ("text", "error"),
    [
        ("stream s contains", LanguageError),
        ("stream s contains speed(UAV) = a [kg] for every UAV = id", LanguageError),
        ("stream s contains speed(UAV) = a [florps.h-1] for every UAV = id", LanguageError),
        ("stream s contains weight(UAV) = a for every UAV = id", LanguageError),
        ("stream status contains speed(UAV) = a for every UAV = id", Refused),
        ("stream dyknow_reserved7 contains speed(UAV) = a for every UAV = id", Refused),
        ("stream speeds contains speed(UAV) = nothing for every UAV = id", Conflict),
        ("stream speeds contains speed(UAV) = spd for every UAV = spd", Conflict),
    ],
)
def test_bad_annotations_change_nothing(engine, text, error):
    engine.annotate(SPEEDS)
    before = {view.name for view in engine.streams()}, engine.annotations()
    good = "stream good contains speed(UAV) = a for every UAV = id\n"
    with pytest.raises(error):
        engine.annotate(good + text)
    assert ({view.name for view in engine.streams()}, engine.annotations()) == before


def test_a_declared_stream_in_use_is_not_changed(engine):
    engine.annotate(SPEEDS)
    feed(engine, "speeds", [(1, {"id": "u", "spd": 1.0})])
    fields = (Field("id", FieldType.STRING), Field("spd", FieldType.INTEGER))
    with pytest.raises(Conflict):
        engine.declare(StreamDeclaration("speeds", fields))


def test_a_key_has_its_effect_once(engine):
    from dyknow.converters.wire import Incoming
    from dyknow.streams.sample import batch_from_rows

    engine.annotate(SPEEDS)
    generator = engine.generator("speeds")
    batch = batch_from_rows(
        generator.schema, [(1, 1, {"id": "u", "spd": 1.0})], generator.stream.pools
    )
    for _ in range(2):
        assert engine.publish("speeds", Incoming(batch, False), 0, "key") == 1
    assert engine.stream("speeds").counters.accepted == 1


def test_mirror_says_the_policy_that_a_stream_keeps(engine):
    engine.add_kpl("source float f\nstrmgen n = f\nstream s = n with any change, max delay 5s")
    policy = "dyknow-o:s dyknow-o:hasPolicy ?p . ?p a dyknow-o:Policy ; dyknow-o:hasText ?text"
    (found,) = ask(engine, policy)
    assert found["text"] == "any change, max delay 5000"  # ms, as KPL prints it
    subscription = engine.subscribe("f", "strict order")
    assert {row["text"] for row in ask(engine, policy.replace("dyknow-o:s ", "?s ", 1))} == {
        "any change, max delay 5000",
        "strict order",
    }
    engine.unsubscribe(subscription.id)
    engine.remove_kpl("s")
    assert ask(engine, "?p a dyknow-o:Policy") == []


def test_the_engine_is_the_first_computational_unit(engine):
    (found,) = ask(engine, "?unit a dyknow-o:StreamProcessingEngine ; dyknow-o:hasOutput ?out")
    assert found == {"unit": "dyknow_engine", "out": "status"}
    entailed = "?unit a dyknow-o:StreamProcessingEngine ; a dyknow-o:ComputationalUnit"
    assert ask(engine, entailed) == [{"unit": "dyknow_engine"}]
    assert engine.ontology.validate().conforms


def test_a_stream_that_ended_with_one_sample_is_constant(engine):
    engine.declare(StreamDeclaration("runway", (Field("length", FieldType.FLOAT),)))
    constant = "?s a dyknow-o:ConstantStream ; dyknow-o:hasSample ?x . ?x a dyknow-o:Sample ; "
    constant += "dyknow-o:hasValidTime ?at"

    def publish(time):
        feed(engine, "runway", [(time, {"length": 2500.0})])

    assert ask(engine, "dyknow-o:runway dyknow-o:hasSample ?x") == []
    publish(1)
    measured(engine, 2)
    assert ask(engine, "dyknow-o:runway dyknow-o:hasSample ?x") == [{"x": "runway_sample"}]
    assert ask(engine, constant) == []
    engine.end("runway")
    measured(engine, 4)
    (found,) = ask(engine, constant)
    assert found == {"s": "runway", "x": "runway_sample", "at": "1970-01-01T00:00:01Z"}
    assert engine.ontology.validate().conforms
    publish(5)
    measured(engine, 6)
    assert ask(engine, constant) == []
    engine.remove_stream("runway")
    assert ask(engine, "dyknow-o:runway dyknow-o:hasSample ?x") == []


def measured(engine, seconds):
    engine.tick(seconds * 10**9)
    engine.measure()


def test_mirror_counts_subscribers_within_a_second(engine):
    engine.add_kpl("source float f\nstrmgen n = f\nstream s = n with any change")
    counted = "dyknow-o:f dyknow-o:hasSubscriberCount ?n"
    engine.tick(10**9)
    assert ask(engine, counted) == [{"n": "1"}]
    subscription = engine.subscribe("f", "strict order")
    engine.tick(10**9 + 1)
    assert ask(engine, counted) == [{"n": "1"}]
    engine.tick(2 * 10**9)
    assert ask(engine, counted) == [{"n": "2"}]
    engine.unsubscribe(subscription.id)
    engine.remove_kpl("f", cascade=True)
    assert ask(engine, "?s dyknow-o:hasSubscriberCount 2") == []
    assert engine.ontology.validate().conforms
