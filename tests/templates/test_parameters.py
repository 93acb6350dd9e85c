"""What the parameters of templates stand for."""

from __future__ import annotations

import pytest

from dyknow.languages.templates import parse_any_template
from dyknow.ontology.ontology import Ontology
from dyknow.rdf.namespaces import DYKNOW
from dyknow.templates.library import shipped_templates
from dyknow.templates.parameters import ParameterUse, Role, parameter_uses

HEAD = "REGISTER TEMPLATE dyknow:E({parameters}) COMPUTE EVERY 1s AS\n"
TAIL = "\nWINDOW [RANGE 5s STEP 1s]"


@pytest.fixture(scope="module")
def ontology() -> Ontology:
    return Ontology.open()


def uses(ontology: Ontology, text: str) -> dict[str, ParameterUse]:
    found = parameter_uses(parse_any_template(text), ontology.vocabulary)
    return {use.name: use for use in found}


def query(parameters: str, body: str) -> str:
    return HEAD.format(parameters=parameters) + body + TAIL


@pytest.mark.parametrize(
    ("condition", "sign"),
    [("?s > ?limit", ">"), ("?limit >= ?s", "<="), ("?s = ?limit", "="), ("?limit != ?s", "!=")],
)
def test_a_number_has_the_sign_as_seen_from_the_feature(
    ontology: Ontology, condition: str, sign: str
) -> None:
    body = f"SELECT ?o ?s WHERE {{ ?o a dyknow:Car ; dyknow:speed ?s FILTER ({condition}) }}"
    use = uses(ontology, query("?limit", body))["limit"]
    assert use == ParameterUse("limit", Role.NUMBER, DYKNOW + "speed", "km.h-1", sign)


def test_a_number_is_followed_through_names_and_aggregates(ontology: Ontology) -> None:
    body = """SELECT ?o (MAX(?s) AS ?top) WHERE { ?o a dyknow:Car ; dyknow:altitude ?s }
GROUP BY ?o HAVING (?top < ?ceiling)"""
    use = uses(ontology, query("?ceiling", body))["ceiling"]
    assert (use.feature, use.comparison) == (DYKNOW + "altitude", "<")
    assert (use.aggregate, use.unit) == ("MAX", "ft")


def test_a_number_that_no_feature_is_compared_with_stays_a_number(ontology: Ontology) -> None:
    body = "SELECT ?o ?s WHERE { ?o a dyknow:Car ; dyknow:speed ?s FILTER (?s + ?plus > 3) }"
    assert uses(ontology, query("?plus", body))["plus"] == ParameterUse("plus", Role.NUMBER)


def test_objects_sorts_and_features(ontology: Ontology) -> None:
    body = "SELECT ?o ?v WHERE { ?o a ?sort ; ?feature ?v }"
    found = uses(ontology, query("?o, ?sort, ?feature", body))
    assert {name: use.role for name, use in found.items()} == {
        "o": Role.OBJECT,
        "sort": Role.SORT,
        "feature": Role.FEATURE,
    }


def test_a_formula(ontology: Ontology) -> None:
    text = """REGISTER TEMPLATE dyknow:Reckless(?car, ?limit) AS
always [0s, 5s] speed(?car) <= ?limit"""
    found = uses(ontology, text)
    assert found["car"].role is Role.OBJECT
    limit = found["limit"]
    assert (limit.role, limit.comparison) == (Role.NUMBER, "<=")
    assert (limit.feature, limit.unit) == (DYKNOW + "speed", "km.h-1")


@pytest.mark.parametrize("text", shipped_templates())
def test_shipped_templates_have_an_object_a_sort_and_a_number(
    ontology: Ontology, text: str
) -> None:
    roles = [use.role for use in uses(ontology, text).values()]
    assert roles == [Role.OBJECT, Role.SORT, Role.NUMBER]
