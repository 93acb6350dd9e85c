"""The scenario of [Events14 §V.C]: events of uav1 out of coordinates of all UAVs, on demand."""

import pytest
from feeding import feed, flight, samples

from dyknow.converters.wire import Incoming
from dyknow.engine.engine import Engine
from dyknow.engine.model.errors import (
    AlreadyExists,
    BadArguments,
    Conflict,
    DyknowError,
    NoPlan,
    Refused,
    UnknownEvent,
    UnknownRequest,
    UnknownStream,
)
from dyknow.engine.model.views import Since

COORDINATES = (
    "stream coordinates contains latitude(UAV) = lat [deg], longitude(UAV) = lon [deg] "
    "for every UAV = id"
)
REQUEST = 'dyknow:HighSpeedEvent(dyknow:uav1, dyknow:UAV, "100"^^xsd:integer)'


def rows(name, flown):
    return [(t, {"id": name, "lat": lat, "lon": lon}) for t, lat, lon in flown]


def merged(*flights):
    """Flights of several objects as one recording: available times are unique."""
    together = sorted((row for flown in flights for row in flown), key=lambda row: row[0])
    return [(t + i * 1e-6, values) for i, (t, values) in enumerate(together)]


@pytest.fixture
def scenario(high_speed):
    """The paper's numbers: the next reserved stream is 34."""
    engine = Engine(epoch="test", first_reserved=34)
    engine.annotate(COORDINATES)
    engine.register_template(high_speed)
    return engine


def test_scenario_with_the_names_of_the_paper(scenario):
    view = scenario.request_event(scenario.parse_request(REQUEST))
    selection, speed, query = view.plan.units
    assert (selection.transformation, selection.inputs) == ("selectObject", ("coordinates",))
    assert selection.output == "dyknow_reserved34"
    assert (speed.transformation, speed.inputs) == ("coordinatesToSpeed", ("dyknow_reserved34",))
    assert speed.output == "dyknow_reserved35"
    assert (query.transformation, query.inputs) == ("cSparql", ("dyknow_reserved35",))
    assert view.stream == query.output == "dyknow_reserved36"
    assert "REGISTER STREAM dyknow_reserved36" in view.plan.query
    assert "FROM STREAM <http://www.ida.liu.se/dyknow/dyknow_reserved35.trdf>" in view.plan.query


def test_a_request_that_runs_is_explained_with_its_costs(scenario):
    view = scenario.request_event(scenario.parse_request(REQUEST))
    text = scenario.explain_running(view.id)
    assert text.startswith(view.plan.text.rstrip())
    assert "dyknow_reserved35: 1,000 samples a second of 100 subjects (assumed)" in text
    feed(scenario, "coordinates", rows("uav1", flight(1, 20, 150.0)))
    text = scenario.explain_running(view.id)
    assert "dyknow_reserved35: 1 sample a second of 100 subjects (the subjects are" in text
    with pytest.raises(UnknownRequest):
        scenario.explain_running("nobody")


def test_scenario_sends_an_event_for_uav1_alone(scenario):
    view = scenario.request_event(scenario.parse_request(REQUEST))
    fast, other = flight(1, 20, 150.0), flight(1, 20, 300.0, longitude=16.0)
    feed(scenario, "coordinates", merged(rows("uav1", fast), rows("uav2", other)))
    scenario.end("coordinates")
    events = samples(scenario, view.stream)
    assert events
    assert {values["id"] for _, values in events} == {"uav1"}
    assert all(values["speed"] == pytest.approx(150.0, rel=1e-4) for _, values in events)


def test_slow_flight_is_no_event(scenario):
    view = scenario.request_event(scenario.parse_request(REQUEST))
    feed(scenario, "coordinates", rows("uav1", flight(1, 20, 99.0)))
    scenario.end("coordinates")
    assert samples(scenario, view.stream) == []


def test_all_objects_when_the_argument_stays_a_variable(scenario):
    request = scenario.parse_request("dyknow:HighSpeedEvent(?o, dyknow:Thing, 100)")
    view = scenario.request_event(request)
    flights = [rows(f"uav{i}", flight(1, 20, 60.0 * i, longitude=10.0 + i)) for i in (1, 2, 3)]
    feed(scenario, "coordinates", merged(*flights))
    scenario.end("coordinates")
    speeds = {values["id"]: values["speed"] for _, values in samples(scenario, view.stream)}
    assert speeds == {
        "uav2": pytest.approx(120.0, rel=1e-4),
        "uav3": pytest.approx(180.0, rel=1e-4),
    }


def test_units_are_converted_on_the_edge(engine, high_speed):
    """120 mi/h are 193.12128 km/h, the unit of dyknow:speed."""
    engine.annotate("stream s3 contains speed(UAV) = spd [mi.h-1] for every UAV = id")
    engine.register_template(high_speed)
    view = engine.request_event(engine.parse_request("dyknow:HighSpeedEvent(?o, dyknow:UAV, 193)"))
    assert view.plan.streams == ("s3",)
    assert [unit.transformation for unit in view.plan.units] == ["cSparql"]
    feed(engine, "s3", [(i, {"id": "uav1", "spd": 120.0}) for i in range(1, 8)])
    engine.end("s3")
    events = samples(engine, view.stream)
    assert events
    assert {round(values["speed"], 5) for _, values in events} == {193.12128}


def test_windows_close_as_the_stream_goes_on(engine, high_speed):
    engine.annotate("stream s3 contains speed(UAV) = spd [km.h-1] for every UAV = id")
    engine.register_template(high_speed)
    view = engine.request_event(engine.parse_request("dyknow:HighSpeedEvent(?o, dyknow:UAV, 100)"))
    feed(engine, "s3", [(1.5, {"id": "uav1", "spd": 150.0})])
    assert samples(engine, view.stream) == []
    feed(engine, "s3", [(2.0, {"id": "uav1", "spd": 50.0})])
    assert samples(engine, view.stream) == []  # the window (-3, 2] may still get a sample at 2
    feed(engine, "s3", [(2.1, {"id": "uav1", "spd": 250.0})])
    assert samples(engine, view.stream) == []  # its average is 100: not above it
    feed(engine, "s3", [(3.5, {"id": "uav1", "spd": 0.0})])
    assert samples(engine, view.stream) == [(3.0, {"id": "uav1", "speed": 150.0})]
    assert engine.rdf_of(view.stream, engine.generator(view.stream).stream.all()) == [
        "<http://www.ida.liu.se/dyknow/uav1> <http://www.ida.liu.se/dyknow/speed> "
        '"150"^^<http://www.w3.org/2001/XMLSchema#double> .'
    ]


def test_a_stamped_stream_is_advanced_by_the_clock(engine, high_speed):
    second = 1_000_000_000
    engine.annotate("stream live contains speed(UAV) = spd for every UAV = id")
    engine.register_template(high_speed)
    view = engine.request_event(engine.parse_request("dyknow:HighSpeedEvent(?o, dyknow:UAV, 100)"))
    feed(engine, "live", [(0, {"id": "uav1", "spd": 150.0})], now=10 * second + 1)
    engine.tick(11 * second)
    assert samples(engine, view.stream) == []
    engine.tick(11 * second + 1)
    assert [end for end, _ in samples(engine, view.stream)] == [11.0]


def test_the_same_request_shares_a_stream_and_the_last_user_stops_it(scenario):
    first = scenario.request_event(scenario.parse_request(REQUEST))
    second = scenario.request_event(scenario.parse_request(REQUEST))
    assert first.id != second.id
    assert first.stream == second.stream
    scenario.cancel_event(first.id)
    assert scenario.stream(first.stream).name == first.stream
    scenario.cancel_event(second.id)
    names = {view.name for view in scenario.streams()}
    assert names == {"status", "coordinates"}
    assert scenario.generator("coordinates").subscribers == 0
    with pytest.raises(UnknownRequest):
        scenario.cancel_event(second.id)


def test_an_event_needs_no_prefix(scenario):
    """As [Events14 §V.C] writes it."""
    text = 'HighSpeedEvent(dyknow:uav1, dyknow:UAV, "100"^^xsd:integer)'
    view = scenario.request_event(scenario.parse_request(text))
    other = scenario.request_event(scenario.parse_request(f"dyknow:{text}"))
    assert view.stream == other.stream


def test_a_match_gives_the_specification_that_makes_its_plan(scenario):
    matched = scenario.match("dyknow:speed", objects=["dyknow:uav1"])
    text = matched.specification
    assert text is not None
    assert text.count("<spec:cu") == 2
    assert '<spec:stream name="coordinates"' in text
    names = {view.name for view in scenario.streams()}
    assert names == {"status", "coordinates"}  # nothing was started
    applied = scenario.apply_specification(text)
    kinds = {unit.transformation for unit in applied.started}
    assert kinds == {"coordinatesToSpeed", "selectObject"}
    again = scenario.match("dyknow:speed", objects=["dyknow:uav1"], strategy="cost")
    assert again.cost == 0
    assert scenario.apply_specification(again.specification).started == ()


def test_a_plan_with_the_query_of_an_event_is_no_specification(scenario):
    matched = scenario.match("dyknow:HighSpeedEvent", objects=["dyknow:uav1"])
    assert matched.specification is None


def test_requests_share_the_units_that_they_have_in_common(scenario):
    first = scenario.request_event(scenario.parse_request(REQUEST))
    other = REQUEST.replace("100", "200")
    second = scenario.request_event(scenario.parse_request(other))
    assert first.stream != second.stream
    assert first.plan.units[:2] != ()
    assert [unit.name for unit in first.plan.units[:2]] == [
        unit.name for unit in second.plan.units[:2]
    ]
    scenario.cancel_event(first.id)
    feed(scenario, "coordinates", rows("uav1", flight(1, 20, 250.0)))
    scenario.end("coordinates")
    assert samples(scenario, second.stream)


def test_no_plan_says_what_is_missing_and_starts_nothing(engine, high_speed):
    engine.register_template(high_speed)
    before = {view.name for view in engine.streams()}
    with pytest.raises(NoPlan) as caught:
        engine.request_event(engine.parse_request(REQUEST))
    assert caught.value.missing
    for cause in caught.value.missing:
        assert cause not in caught.value.detail
        assert str(caught.value).count(cause) == 1
    assert {view.name for view in engine.streams()} == before


@pytest.mark.parametrize(
    ("text", "error"),
    [
        ("dyknow:NoSuchEvent(?o)", UnknownEvent),
        ("dyknow:HighSpeedEvent(?o, dyknow:UAV)", BadArguments),
        ("dyknow:HighSpeedEvent(?o, dyknow:UAV, 100, 5)", BadArguments),
        ('dyknow:HighSpeedEvent(?o, dyknow:UAV, "fast")', BadArguments),
        ("dyknow:HighSpeedEvent(?o, dyknow:Balloon, 100)", BadArguments),
        ("dyknow:HighSpeedEvent(?o, 5, 100)", BadArguments),
        ('dyknow:HighSpeedEvent("uav1", dyknow:UAV, 100)', BadArguments),
        ('dyknow:HighSpeedEvent(?o, dyknow:UAV, "NaN"^^xsd:double)', BadArguments),
    ],
)
def test_bad_requests_are_refused(scenario, text, error):
    with pytest.raises(error):
        scenario.request_event(scenario.parse_request(text))
    assert scenario.events() == ()
    assert {view.name for view in scenario.streams()} == {"status", "coordinates"}


def test_templates_are_kept_by_name(scenario, high_speed):
    with pytest.raises(AlreadyExists):
        scenario.register_template(high_speed)
    scenario.register_template(high_speed.replace("RANGE 5s", "RANGE 7s"), replace=True)
    assert "RANGE 7s" in scenario.template("HighSpeedEvent").source
    view = scenario.request_event(scenario.parse_request(REQUEST))
    with pytest.raises(Conflict):
        scenario.remove_template("HighSpeedEvent")
    scenario.cancel_event(view.id)
    scenario.remove_template("HighSpeedEvent")
    assert scenario.templates() == ()


def test_streams_of_the_system_take_no_samples(scenario):
    view = scenario.request_event(scenario.parse_request(REQUEST))
    for name in ("status", view.stream):
        with pytest.raises(Refused):
            scenario.end(name)
    with pytest.raises(UnknownStream):
        feed(scenario, "nothing", [])


def test_every_refusal_says_what_to_do(scenario):
    with pytest.raises(DyknowError) as caught:
        scenario.stream("nothing")
    assert caught.value.hint


def test_a_query_sees_what_the_ontology_learns(engine, high_speed):
    """A stream of everything; only what the ontology says is a UAV counts, from then on."""
    engine.annotate("stream all contains speed(Thing) = spd for every Thing = id")
    engine.register_template(high_speed)
    request = engine.parse_request("dyknow:HighSpeedEvent(?o, dyknow:UAV, 100)")
    view = engine.request_event(request)
    feed(engine, "all", [(i, {"id": "uav1", "spd": 150.0}) for i in range(1, 4)])
    assert samples(engine, view.stream) == []
    engine.ontology.load(
        "@prefix dyknow: <http://www.ida.liu.se/dyknow/> . dyknow:uav1 a dyknow:RMAX .",
        name="http://example.org/fleet",
    )
    feed(engine, "all", [(i, {"id": "uav1", "spd": 150.0}) for i in range(4, 8)])
    assert {values["id"] for _, values in samples(engine, view.stream)} == {"uav1"}


@pytest.mark.parametrize("text", [REQUEST, "dyknow:HighSpeedEvent(?o, dyknow:UAV, 100)"])
@pytest.mark.parametrize("is_ended", [False, True])
def test_an_answer_may_begin_in_the_past(scenario, text, is_ended):
    """The same samples, asked before and after they came."""
    fast, other = flight(1, 20, 150.0), flight(3, 20, 300.0, longitude=16.0)
    recording = merged(rows("uav1", fast), rows("uav2", other))
    before = scenario.request_event(scenario.parse_request(text))
    feed(scenario, "coordinates", recording[:15])
    feed(scenario, "coordinates", recording[15:])
    if is_ended:
        scenario.end("coordinates")
    late = scenario.request_event(scenario.parse_request(text))
    after = scenario.request_event(scenario.parse_request(text), since=Since.START)
    assert late.stream == before.stream != after.stream
    assert samples(scenario, after.stream) == samples(scenario, before.stream) != []
    assert scenario.stream(after.stream).ended is is_ended
    if not is_ended:
        feed(scenario, "coordinates", rows("uav1", [(40, 58.5, 15.0), (41, 58.6, 15.0)]))
        assert samples(scenario, after.stream) == samples(scenario, before.stream)


TWO = """REGISTER TEMPLATE dyknow:FastHigh(?o, ?t, ?u) COMPUTE EVERY 1s AS
CONSTRUCT {?o dyknow:speed ?s}
WHERE {?o a dyknow:UAV . ?o dyknow:altitude ?x . ?o dyknow:speed ?y . FILTER (?x > ?t)}
AGGREGATE {(?s, AVG, {?y}) FILTER (?s > ?u)} WINDOW [RANGE 2s STEP 1s]"""


def two_streams(engine):
    engine.annotate("stream alt contains altitude(UAV) = h [ft] for every UAV = id")
    engine.annotate("stream sp contains speed(UAV) = v [km.h-1] for every UAV = id")
    engine.register_template(TWO)
    return engine.request_event(engine.parse_request("dyknow:FastHigh(?o, 305, 100)"))


@pytest.mark.parametrize("order", ["alt first", "sp first", "mixed"])
def test_streams_of_a_query_wait_for_each_other(engine, order):
    view = two_streams(engine)
    assert view.waits_for == ("alt", "sp")
    heights = [(i + 0.1, {"id": "uav1", "h": 300.0 + i}) for i in range(20)]
    speeds = [(i + 0.2, {"id": "uav1", "v": 90.0 + i}) for i in range(20)]
    parts = {"alt first": 20, "sp first": 20, "mixed": 3}[order]
    names = [("alt", heights), ("sp", speeds)]
    for start in range(0, 20, parts):
        for name, given in names if order != "sp first" else reversed(names):
            feed(engine, name, given[start : start + parts])
    engine.end("alt")
    engine.end("sp")
    found = {end: values["speed"] for end, values in samples(engine, view.stream)}
    expected = {}
    for end in range(1, 23):
        seen = [i for i in range(20) if end - 2 < i + 0.2 <= end]
        high = [i for i in range(20) if end - 2 < i + 0.1 <= end and 300 + i > 305]
        if seen and high and sum(90 + i for i in seen) / len(seen) > 100:
            expected[float(end)] = sum(90.0 + i for i in seen) / len(seen)
    assert found == expected


def test_a_silent_stream_is_advanced_by_the_clock_where_others_are_stamped(engine, high_speed):
    second = 1_000_000_000
    for name in ("one", "two"):
        engine.annotate(
            f"stream {name} contains speed({'RMAX' if name == 'one' else 'Car'}) = v "
            f"for every {'RMAX' if name == 'one' else 'Car'} = id"
        )
    engine.register_template(high_speed)
    view = engine.request_event(
        engine.parse_request("dyknow:HighSpeedEvent(?o, dyknow:Thing, 100)")
    )
    assert set(view.plan.streams) == {"one", "two"}
    feed(engine, "one", [(0, {"id": "uav1", "v": 150.0})], now=10 * second + 1)
    engine.tick(12 * second)
    assert [end for end, _ in samples(engine, view.stream)] == [11.0]
    assert engine.event(view.id).waits_for == ()


def test_a_request_after_the_end_is_at_its_end(scenario):
    feed(scenario, "coordinates", rows("uav1", flight(1, 20, 150.0)))
    scenario.end("coordinates")
    view = scenario.request_event(scenario.parse_request(REQUEST))
    assert scenario.stream(view.stream).ended
    assert samples(scenario, view.stream) == []
    feed(scenario, "coordinates", rows("uav1", flight(30, 20, 150.0)))
    assert not scenario.stream(view.stream).ended
    assert samples(scenario, view.stream)


def test_a_table_keeps_its_types(engine):
    engine.annotate("stream sp contains speed(UAV) = v, callsign(UAV) = c for every UAV = id")
    engine.register_template(
        "REGISTER TEMPLATE dyknow:Table(?o) COMPUTE EVERY 1s AS "
        "SELECT ?o (AVG(?v) AS ?mean) (COUNT(?v) AS ?n) (MAX(?v) AS ?top) (MIN(?c) AS ?call) "
        "WHERE { ?o dyknow:speed ?v . ?o dyknow:callsign ?c } GROUP BY ?o "
        "WINDOW [RANGE 2s STEP 1s]"
    )
    view = engine.request_event(engine.parse_request("dyknow:Table(?x)"))
    feed(engine, "sp", [(0.5, {"id": "uav1", "v": 150.0, "c": "AFR1"})])
    engine.end("sp")
    _, values = samples(engine, view.stream)[0]
    assert values == {"o": "uav1", "mean": 150.0, "n": 1, "top": 150.0, "call": "AFR1"}


def test_triples_of_a_stream_are_in_the_units_of_their_features(engine):
    engine.annotate("stream s3 contains speed(UAV) = spd [m.s-1] for every UAV = id")
    feed(engine, "s3", [(1, {"id": "uav1", "spd": 100.0})])
    (text,) = engine.rdf_of("s3", engine.generator("s3").stream.all())
    assert '"360"^^<http://www.w3.org/2001/XMLSchema#double>' in text


def test_a_key_for_other_samples_is_a_conflict(engine):
    engine.annotate("stream s3 contains speed(UAV) = spd for every UAV = id")
    nothing = Incoming(engine.generator("s3").stream.all(), False)
    assert engine.publish("s3", nothing, 0, "key", b"a") == 0
    assert engine.publish("s3", nothing, 0, "key", b"a") == 0
    with pytest.raises(Conflict):
        engine.publish("s3", nothing, 0, "key", b"b")


def test_a_stream_is_stamped_or_brings_its_times(engine):
    engine.annotate("stream s3 contains speed(UAV) = spd for every UAV = id")
    feed(engine, "s3", [(1, {"id": "uav1", "spd": 100.0})])
    with pytest.raises(Conflict):
        feed(engine, "s3", [(2, {"id": "uav1", "spd": 100.0})], now=10**18)
    assert engine.stream("s3").counters.accepted == 1


def test_a_stream_is_removed_when_nothing_reads_it(scenario):
    view = scenario.request_event(scenario.parse_request(REQUEST))
    with pytest.raises(Conflict):
        scenario.remove_stream("coordinates")
    scenario.cancel_event(view.id)
    scenario.remove_stream("coordinates")
    assert [view.name for view in scenario.streams()] == ["status"]
    with pytest.raises(NoPlan):
        scenario.request_event(scenario.parse_request(REQUEST))


def test_a_sort_of_ones_own(engine, high_speed):
    """A domain ontology, then an annotation and a request that speak of its sort."""
    engine.register_template(high_speed)
    engine.load_ontology(
        "@prefix : <http://www.ida.liu.se/dyknow/> . "
        "@prefix rdfs: <http://www.w3.org/2000/01/rdf-schema#> . "
        "@prefix owl: <http://www.w3.org/2002/07/owl#> . "
        ":Ship a owl:Class ; rdfs:subClassOf :Vehicle . "
        ":Ferry a owl:Class ; rdfs:subClassOf :Ship .",
        name="http://example.org/harbour",
    )
    engine.annotate("stream ferries contains speed(Ferry) = v [kt] for every Ferry = id")
    view = engine.request_event(engine.parse_request("dyknow:HighSpeedEvent(?o, dyknow:Ship, 30)"))
    feed(engine, "ferries", [(i, {"id": "viking", "v": 20.0}) for i in range(1, 5)])
    engine.end("ferries")
    assert {values["id"] for _, values in samples(engine, view.stream)} == {"viking"}


def test_a_request_that_joins_others_begins_where_they_are(scenario):
    first = scenario.request_event(scenario.parse_request(REQUEST))
    feed(scenario, "coordinates", rows("uav1", flight(1, 20, 150.0)))
    second = scenario.request_event(scenario.parse_request(REQUEST))
    assert first.position == 0
    assert second.position == len(samples(scenario, first.stream)) > 0
