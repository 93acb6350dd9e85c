"""What runs on Oxigraph has the standard's boolean values and orders, as columns have them."""

from __future__ import annotations

import pytest
from pyoxigraph import Literal, NamedNode

from dyknow.continuous.evaluate import evaluate
from dyknow.rdf.namespaces import DYKNOW, XSD

X = "http://d.example/x"
SPEED = NamedNode(DYKNOW + "speed")


def typed(text: str, name: str) -> Literal:
    return Literal(text, datatype=NamedNode(XSD + name))


VALUES = [
    Literal(True),
    Literal(False),
    Literal("a", language="en"),
    Literal("", language="en"),
    Literal("a"),
    Literal("b"),
    Literal(""),
    typed("abc", "integer"),
    typed(str(2**63), "integer"),
    Literal(2),
    Literal(0),
    typed("2.5", "decimal"),
    typed("NaN", "double"),
    typed("2020-01-01T00:00:00Z", "dateTime"),
    NamedNode(DYKNOW + "o"),
]
CONDITIONS = [
    "?v",
    "!?v",
    "?v && true",
    "!(?v || false)",
    "IF(?v, true, false)",
    "COALESCE(?v, 1)",
    "?v < true",
    "?v >= false",
    "?v <= ?v",
    "?v > 1",
    'STR(?v) < "b"',
    "?v < '2021-01-01T00:00:00Z'^^xsd:dateTime",
    f"?v <= {2**63}",
    "(?v < true) < (?v >= true)",
    "EXISTS { ?o d:speed ?w FILTER(?v) }",
]


def passing(condition: str, shown: str) -> set:
    elements = [(1, NamedNode(f"{DYKNOW}o{i}"), SPEED, value) for i, value in enumerate(VALUES)]
    query = (
        f"REGISTER QUERY q AS PREFIX d: <{DYKNOW}> PREFIX xsd: <{XSD}> SELECT {shown} "
        f"FROM STREAM <{X}> [RANGE 10ns STEP 10ns] WHERE {{ ?o d:speed ?v FILTER({condition}) }}"
    )
    (window,) = evaluate(query, {X: elements})
    return {str(row["v"]) for row in window.solutions}


@pytest.mark.parametrize("condition", CONDITIONS)
def test_a_window_on_oxigraph_is_as_one_in_columns(condition: str) -> None:
    assert passing(condition, "?v (BNODE() AS ?b)") == passing(condition, "?v")


def test_a_having_on_oxigraph_asks_for_the_boolean_value() -> None:
    elements = [(1, NamedNode(DYKNOW + "o"), SPEED, Literal("a", language="en"))]
    query = (
        f"REGISTER QUERY q AS PREFIX d: <{DYKNOW}> SELECT ?v (BNODE() AS ?b) "
        f"FROM STREAM <{X}> [RANGE 10ns STEP 10ns] WHERE {{ ?o d:speed ?v }} "
        "GROUP BY ?v HAVING (MAX(?v))"
    )
    (window,) = evaluate(query, {X: elements})
    assert [row["v"] for row in window.solutions] == [Literal("a", language="en")]
