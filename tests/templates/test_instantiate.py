"""Arguments of templates ([Events14 §IV.B, §V.B-C])."""

import pytest
from pyoxigraph import BlankNode, Literal, NamedNode, Variable

from dyknow.languages.csparql import (
    parse_argument,
    parse_event_request,
    parse_template,
)
from dyknow.rdf.namespaces import DYKNOW, XSD
from dyknow.templates.instantiate import ArgumentError, instantiate
from dyknow.templates.library import shipped_templates

HIGH_SPEED = parse_template(next(text for text in shipped_templates() if "HighSpeedEvent" in text))
RANGED = parse_template(
    """REGISTER TEMPLATE dyknow:Ranged(?o, ?feature, ?low, ?high, ?label) COMPUTE EVERY 1s AS
    PREFIX dyknow: <http://www.ida.liu.se/dyknow/>
    SELECT ?o ?v WHERE {
      ?o ?feature ?v ; dyknow:altitude ?alt .
      BIND (?alt * 2 AS ?double) FILTER (?double > ?low && ?alt < ?high + 1 && ?v != ?label)
    } WINDOW [RANGE 5s STEP 1s]"""
)


def arguments(*texts):
    return [parse_argument(text) for text in texts]


def test_the_scenario_of_events14(vocabulary):
    request = parse_event_request(
        'dyknow:HighSpeedEvent(dyknow:uav1, dyknow:UAV, "100"^^xsd:integer)'
    )
    query = instantiate(HIGH_SPEED, request.arguments, vocabulary)
    assert query.bindings == {
        Variable("o"): NamedNode(DYKNOW + "uav1"),
        Variable("type"): NamedNode(DYKNOW + "UAV"),
        Variable("threshold"): Literal("100", datatype=NamedNode(XSD + "integer")),
    }


@pytest.mark.parametrize("free", ["?o", "?anything"])
def test_every_object_of_every_sort(vocabulary, free):
    query = instantiate(HIGH_SPEED, arguments(free, "dyknow:Thing", "100"), vocabulary)
    assert set(query.bindings) == {Variable("type"), Variable("threshold")}


def test_a_type_may_stay_free(vocabulary):
    query = instantiate(HIGH_SPEED, arguments("?o", "?type", "1.5e2"), vocabulary)
    assert set(query.bindings) == {Variable("threshold")}


@pytest.mark.parametrize(
    ("texts", "index", "message", "hint"),
    [
        (("?o", "dyknow:UAV"), None, "takes 3 arguments, not 2", "(?o, ?type, ?threshold)"),
        (("?o", "dyknow:UVA", "1"), 1, "dyknow:UVA is not a known sort", "dyknow:UAV"),
        (("?o", "dyknow:speed", "1"), 1, "dyknow:speed is not a known sort", ""),
        (("?o", '"UAV"', "1"), 1, "expected an IRI", "dyknow:UAV"),
        (("5", "dyknow:UAV", "1"), 0, "expected an IRI, found the literal", "dyknow:uav1"),
        (("?o", "dyknow:UAV", "?threshold"), 2, "must be given", "100"),
        (("?o", "dyknow:UAV", "?o"), 2, "must be given", "100"),
        (("?o", "dyknow:UAV", '"fast"'), 2, "is not a number", "100"),
        (("?o", "dyknow:UAV", "dyknow:UAV"), 2, "is not a literal", "100"),
        (("?o", "dyknow:UAV", "true"), 2, "is not a number", "100"),
        (("?o", "dyknow:UAV", '"NaN"^^xsd:double'), 2, "NaN is not finite", "100"),
        (("?o", "dyknow:UAV", '"INF"^^xsd:float'), 2, "INF is not finite", "100"),
        (("?o", "dyknow:UAV", '"-INF"^^xsd:double'), 2, "-INF is not finite", "100"),
        (("?o", "dyknow:UAV", "1e999"), 2, "1e999 is not finite", "100"),
        (("?o", "dyknow:UAV", '"1.5"^^xsd:integer'), 2, "not an xsd:integer", "100"),
        (("?x", "?x", "100"), 1, "is used for two arguments", "?type"),
    ],
)
def test_arguments_that_do_not_fit(vocabulary, texts, index, message, hint):
    with pytest.raises(ArgumentError) as caught:
        instantiate(HIGH_SPEED, arguments(*texts), vocabulary)
    error = caught.value
    assert error.index == index
    assert error.parameter == (None if index is None else ("o", "type", "threshold")[index])
    assert message in error.message
    assert hint in error.hint


def test_blank_nodes_are_refused(vocabulary):
    with pytest.raises(ArgumentError, match="blank node"):
        instantiate(RANGED, [BlankNode(), *arguments("?f", "1", "2", "3")], vocabulary)
    with pytest.raises(ArgumentError, match="blank node"):
        instantiate(RANGED, [*arguments("?o", "dyknow:speed", "1", "2"), BlankNode()], vocabulary)


@pytest.mark.parametrize(
    ("texts", "parameter"),
    [
        (("?o", "dyknow:sped", "1", "2", "3"), "feature"),
        (("?o", "dyknow:speed", '"x"', "2", "3"), "low"),
        (("?o", "dyknow:speed", "1", '"x"', "3"), "high"),
        (("?o", "dyknow:speed", "1", "2", "?label"), "label"),
    ],
)
def test_numbers_through_bind_and_sums(vocabulary, texts, parameter):
    with pytest.raises(ArgumentError) as caught:
        instantiate(RANGED, arguments(*texts), vocabulary)
    assert caught.value.parameter == parameter


def test_what_is_compared_with_anything_takes_any_term(vocabulary):
    query = instantiate(RANGED, arguments("?o", "dyknow:speed", "1", "2.5", '"label"'), vocabulary)
    assert query.bindings[Variable("label")] == Literal("label")


def test_numbers_of_derived_datatypes(vocabulary):
    for text in ('"7"^^xsd:int', '"+7"^^xsd:nonNegativeInteger', '"7."^^xsd:decimal'):
        instantiate(HIGH_SPEED, arguments("?o", "dyknow:UAV", text), vocabulary)
