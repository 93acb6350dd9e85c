"""Event templates as transformations ([Events14 §VI]): events that build on events."""

import pytest
from feeding import feed, samples

from dyknow.engine.model.errors import NoPlan, Refused

SPEEDS = "stream speeds contains speed(UAV) = spd [km.h-1] for every UAV = id"
PREFIX = "PREFIX dyknow: <http://www.ida.liu.se/dyknow/>\n"


def template(name, parameters, head, body, aggregate=""):
    return (
        f"REGISTER TEMPLATE dyknow:{name}({parameters}) COMPUTE EVERY 1s AS\n{PREFIX}"
        f"CONSTRUCT {{{head}}} WHERE {{ {body} }} {aggregate} WINDOW [RANGE 5s STEP 1s]"
    )


FAST = template(
    "Fast",
    "?o, ?type",
    "?o dyknow:speed ?m",
    "?o a ?type . ?o dyknow:speed ?s .",
    "AGGREGATE {(?m, AVG, {?s}) FILTER (?m > 100)}",
)
LONG_FAST = template(
    "LongFast",
    "?o, ?type",
    "?o dyknow:Fast ?n",
    "?o a ?type . ?o dyknow:Fast ?v .",
    "AGGREGATE {(?n, COUNT, {?v}) FILTER (?n > 3)}",
)
BOTH = template("Both", "?o", "?o dyknow:speed ?v", "?o dyknow:Fast ?v . ?o dyknow:LongFast ?n .")


@pytest.fixture
def flying(engine):
    engine.annotate(SPEEDS)
    for text in (FAST, LONG_FAST, BOTH):
        engine.register_template(text)
    return engine


def fly(engine, seconds=30):
    rows = []
    for t in range(seconds):
        rows += [(t + 0.1, {"id": "uav1", "spd": 150.0}), (t + 0.2, {"id": "uav2", "spd": 50.0})]
    feed(engine, "speeds", rows)


def test_an_event_of_an_event_is_built_from_below(flying):
    view = flying.request_event(flying.parse_request("dyknow:LongFast(?o, dyknow:UAV)"))
    assert [unit.transformation for unit in view.plan.units] == ["cSparql", "cSparql"]
    fly(flying)
    found = samples(flying, view.stream)
    assert {values["id"] for _, values in found} == {"uav1"}
    assert len(found) > 20
    assert all(values["Fast"] in (4, 5) for _, values in found)


def test_the_plan_is_the_tree_of_events(flying):
    text = flying.match("LongFast", objects=["uav1"]).plan.text
    assert text == (
        "LongFast of dyknow:uav1\n"
        "└─ chosen: event dyknow:LongFast\n"
        "   └─ event dyknow:Fast\n"
        "      └─ select id = uav1\n"
        "         └─ stream speeds : speed [km.h-1] for every UAV = id"
    )


def test_what_two_events_need_is_detected_once(flying):
    flying.request_event(flying.parse_request("dyknow:Both(?o)"))
    queries = [
        u for u in flying._parts.configuration.units.values() if u.transformation == "cSparql"
    ]
    assert len(queries) == 3


def test_an_event_that_runs_already_is_used(flying):
    flying.request_event(flying.parse_request("dyknow:Fast(?o, dyknow:UAV)"))
    view = flying.request_event(flying.parse_request("dyknow:LongFast(?o, dyknow:UAV)"))
    assert len(flying._parts.configuration.units) == 2
    flying.cancel_event("event1")
    fly(flying)
    assert samples(flying, view.stream)
    flying.cancel_event("event2")
    assert not flying._parts.configuration.units


def test_a_subscription_to_an_event(flying):
    view = flying.subscribe_to_feature("Fast", objects=["uav1"])
    fly(flying, 10)
    found = samples(flying, view.stream)
    assert found
    assert {values["object"] for _, values in found} == {"uav1"}


def test_a_threshold_must_be_given_by_somebody(engine, high_speed):
    engine.annotate(SPEEDS)
    engine.register_template(high_speed)
    engine.register_template(
        template("Often", "?o", "?o dyknow:speed ?v", "?o dyknow:HighSpeedEvent ?v")
    )
    with pytest.raises(NoPlan) as refused:
        engine.request_event(engine.parse_request("dyknow:Often(?o)"))
    assert "?threshold must be given" in str(refused.value)
    # Once somebody asks for it with a threshold, its stream is there.
    engine.request_event(engine.parse_request("dyknow:HighSpeedEvent(?o, dyknow:Thing, 100)"))
    engine.request_event(engine.parse_request("dyknow:Often(?o)"))


def test_a_circle_is_refused_with_its_path(flying):
    text = template("Fast", "?o", "?o dyknow:speed ?v", "?o dyknow:Both ?v")
    with pytest.raises(Refused) as refused:
        flying.register_template(text, replace=True)
    assert str(refused.value).startswith(
        "dyknow:Fast would need itself: dyknow:Fast needs dyknow:Both needs dyknow:Fast"
    )
    assert flying.template("Fast").source == FAST


def test_a_template_is_a_transformation_in_the_ontology(flying):
    _, rows = flying.ontology.query_rows(
        "SELECT ?needs WHERE { ?t a dyknow-o:Transformation ; dyknow-o:hasName 'dyknow:LongFast' ; "
        "dyknow-o:hasAnnotation/dyknow-o:hasInputAnnotation/dyknow-o:describesFeature ?needs }"
    )
    assert [row[0].value for row in rows] == ["http://www.ida.liu.se/dyknow/Fast"]
    flying.remove_template("Both")
    assert "dyknow:Both" not in flying._parts.manager.space.transformations
