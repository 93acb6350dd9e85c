"""Features and sorts inferred from queries ([Events14 §IV.A], SPEC §5)."""

import pytest

from dyknow.languages.csparql import parse_argument, parse_query, parse_template
from dyknow.matching.want import THING, Want
from dyknow.rdf.namespaces import DYKNOW
from dyknow.templates.instantiate import instantiate
from dyknow.templates.library import shipped_templates
from dyknow.templates.needs import NeedsError, Product, needs

HIGH_SPEED = parse_template(next(text for text in shipped_templates() if "HighSpeedEvent" in text))
SPEED, ALTITUDE, UAV = DYKNOW + "speed", DYKNOW + "altitude", DYKNOW + "UAV"


def wants(body, vocabulary, head="SELECT *", streams=""):
    text = (
        "REGISTER STREAM q COMPUTE EVERY 1s AS PREFIX dyknow: <http://www.ida.liu.se/dyknow/> "
        f"{head} {streams} WHERE {{ {body} }} WINDOW [RANGE 5s STEP 1s]"
    )
    if streams:
        text = text.rpartition(" WINDOW")[0]
    return list(needs(parse_query(text), vocabulary).wants)


def instance(vocabulary, *texts):
    return instantiate(HIGH_SPEED, [parse_argument(text) for text in texts], vocabulary)


def test_the_scenario_of_events14(vocabulary):
    """§V.C: "those that contain dyknow:speed information specific to object dyknow:uav1"."""
    found = needs(instance(vocabulary, "dyknow:uav1", "dyknow:UAV", "100"), vocabulary)
    event = DYKNOW + "HighSpeedEvent"
    assert found.wants == (Want(SPEED, UAV, DYKNOW + "uav1"),)
    assert found.product == Product(event, (UAV,), (DYKNOW + "uav1",))


def test_every_object(vocabulary):
    found = needs(instance(vocabulary, "?o", "dyknow:Thing", "100"), vocabulary)
    assert found.wants == (Want(SPEED, THING, None),)
    assert found.product == Product(DYKNOW + "HighSpeedEvent", (THING,), ())


def test_a_free_type_restricts_nothing(vocabulary):
    assert needs(instance(vocabulary, "?o", "?type", "1"), vocabulary).wants == (
        Want(SPEED, THING, None),
    )


def test_listing_3(vocabulary):
    text = """REGISTER STREAM HighSpeedEvent COMPUTE EVERY 1s AS
    PREFIX dyknow: <http://www.ida.liu.se/dyknow/>
    CONSTRUCT {?uav dyknow:speed ?avgSpeed}
    FROM <http://www.ida.liu.se/dyknow/ontology.rdf>
    FROM STREAM <http://www.ida.liu.se/dyknow/s59.trdf> [RANGE 5s STEP 1s]
    WHERE { ?uav a dyknow:UAV . ?uav dyknow:speed ?spd . }
    AGGREGATE {(?avgSpeed, AVG, {?spd}) FILTER (?avgSpeed > 100)}"""
    assert needs(parse_query(text), vocabulary).wants == (Want(SPEED, UAV, None),)


def test_the_narrowest_sort_holds(vocabulary):
    body = "?o a dyknow:Aircraft, dyknow:UAV, dyknow:Thing ; dyknow:speed ?s"
    assert wants(body, vocabulary) == [Want(SPEED, UAV, None)]


def test_sorts_of_optional_parts_and_branches_hold_only_there(vocabulary):
    body = """?o dyknow:speed ?s . OPTIONAL { ?o a dyknow:UAV ; dyknow:altitude ?a }"""
    assert wants(body, vocabulary) == [Want(SPEED, THING, None), Want(ALTITUDE, UAV, None)]
    body = """{ ?o a dyknow:UAV ; dyknow:speed ?s } UNION { ?o a dyknow:Car ; dyknow:speed ?s }"""
    assert wants(body, vocabulary) == [
        Want(SPEED, UAV, None),
        Want(SPEED, DYKNOW + "Car", None),
    ]
    body = "{ ?o a dyknow:UAV } UNION { ?o a dyknow:Car } ?o dyknow:speed ?s"
    assert wants(body, vocabulary) == [Want(SPEED, THING, None)]
    body = "?o dyknow:speed ?s MINUS { ?o a dyknow:UAV }"
    assert wants(body, vocabulary) == [Want(SPEED, THING, None)]


def test_sorts_around_a_sub_query_do_not_reach_in(vocabulary):
    body = "?o a dyknow:UAV . { SELECT (AVG(?s) AS ?all) WHERE { ?o dyknow:speed ?s } }"
    assert wants(body, vocabulary) == [Want(SPEED, THING, None)]


def test_sorts_of_a_sub_query_reach_out(vocabulary):
    body = "?o dyknow:speed ?s { SELECT ?o WHERE { ?o a dyknow:UAV } }"
    assert wants(body, vocabulary) == [Want(SPEED, UAV, None)]


def test_features_in_exists_and_paths_are_needed(vocabulary):
    body = "?o a dyknow:UAV FILTER EXISTS { ?o dyknow:altitude ?a }"
    assert wants(body, vocabulary) == [Want(ALTITUDE, UAV, None)]
    assert wants("?o (dyknow:speed|dyknow:altitude) ?v", vocabulary) == [
        Want(SPEED, THING, None),
        Want(ALTITUDE, THING, None),
    ]


def test_constant_subjects_are_objects(vocabulary):
    assert wants("dyknow:uav1 dyknow:speed ?s", vocabulary) == [Want(SPEED, THING, DYKNOW + "uav1")]


def test_other_predicates_are_static(vocabulary):
    body = "?o dyknow:speed ?s ; <http://example.org/owner> ?w . ?w a <http://example.org/Person>"
    assert wants(body, vocabulary) == [Want(SPEED, THING, None)]
    assert wants("GRAPH <http://example.org/g> { ?o ?p ?v }", vocabulary) == []


def test_unknown_dyknow_names_are_errors(vocabulary):
    with pytest.raises(NeedsError) as caught:
        wants("?o dyknow:sped ?s", vocabulary)
    assert caught.value.hint == "did you mean dyknow:speed?"
    with pytest.raises(NeedsError, match="dyknow:Aircrft is not a known sort") as caught:
        wants("?o a dyknow:Aircrft ; dyknow:speed ?s", vocabulary)
    assert "dyknow:Aircraft" in caught.value.hint


def test_a_variable_predicate_hides_the_streams(vocabulary):
    with pytest.raises(NeedsError) as caught:
        wants("?o ?p ?s", vocabulary)
    assert "FROM STREAM" in caught.value.hint
    named = "FROM STREAM <http://www.ida.liu.se/dyknow/s59.trdf> [RANGE 5s STEP 1s]"
    assert wants("?o ?p ?s", vocabulary, streams=named) == []
