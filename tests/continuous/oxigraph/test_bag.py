"""Equal triples count each on Oxigraph too; where they cannot, the result says so."""

from __future__ import annotations

import pytest
from pyoxigraph import Literal, NamedNode

from dyknow.continuous.algebra.from_sparql import Unsupported
from dyknow.continuous.evaluate import evaluate
from dyknow.continuous.oxigraph.bag_rewrite import count_copies
from dyknow.rdf.namespaces import DYKNOW, RDF_TYPE, XSD
from dyknow.sparql import parse_sparql

X = "http://d.example/x"
PREFIXES = f"PREFIX d: <{DYKNOW}> PREFIX xsd: <{XSD}> "
ONE, TWO, UAV = (NamedNode(DYKNOW + name) for name in ("uav1", "uav2", "UAV"))
SPEED, NEAR, WHEN = (NamedNode(DYKNOW + name) for name in ("speed", "near", "when"))


def window(body: str, *triples, semantics="bag", static=()):
    head, where = body.split("WHERE", 1)
    text = (
        f"REGISTER QUERY q AS {PREFIXES} {head} FROM STREAM <{X}> [RANGE 9s STEP 9s] WHERE {where}"
    )
    elements = [(1, *triple) for triple in triples]
    (found,) = evaluate(text, {X: elements}, static, semantics=semantics)
    return found


def numbers(found) -> list[dict[str, str]]:
    rows = [{name: term.value for name, term in row.items()} for row in found.solutions]
    return sorted(rows, key=str)


FIVE = (ONE, SPEED, Literal(5))


@pytest.mark.parametrize(
    ("where", "count"),
    [
        ("{ ?o d:speed ?v OPTIONAL { ?o d:alt ?h } }", "3"),
        ("{ ?z d:near ?y OPTIONAL { ?o d:speed ?v } }", "3"),
        ("{ { ?o d:speed ?v } UNION { ?o d:speed ?v ; d:near ?y } }", "6"),
        ("{ ?o d:speed ?v , ?w . FILTER EXISTS { ?o d:speed ?u } }", "9"),
        ("{ ?o d:speed ?v MINUS { ?o d:alt ?h } }", "3"),
        ("{ ?o d:speed ?v . ?o d:near* ?y }", "6"),
        ("{ ?o d:speed ?v . { SELECT ?o (SUM(?w) AS ?t) { ?o d:speed ?w } GROUP BY ?o } }", "3"),
        ("{ ?o ?p ?v . FILTER (isNumeric(?v)) }", "3"),
        ("{ ?o a ?c . ?o d:speed +5 FILTER EXISTS { ?o ?p ?v } }", "3"),
        ("{ _:o d:speed ?v . _:o d:near ?y OPTIONAL { ?o d:alt ?h } }", "3"),
        ("{ [ d:speed ?v ; d:near ?y ] BIND (BNODE() AS ?b) }", "3"),
    ],
)
def test_each_of_equal_triples_is_counted(where: str, count: str) -> None:
    types = [(ONE, RDF_TYPE, UAV)] * 2
    found = window(
        f"SELECT (COUNT(*) AS ?n) WHERE {where}", FIVE, FIVE, FIVE, (ONE, NEAR, TWO), *types
    )
    assert numbers(found) == [{"n": count}]
    assert not found.merged


def test_a_window_that_needs_oxigraph_keeps_its_bag() -> None:
    """Dates are compared by Oxigraph: it used to merge the two equal elements."""
    day = Literal("2020-05-01T00:00:00Z", datatype=NamedNode(XSD + "dateTime"))
    body = (
        "SELECT ?o (COUNT(?v) AS ?n) WHERE { ?o d:speed ?v ; d:when ?t "
        "FILTER (?t > '2020-01-01T00:00:00Z'^^xsd:dateTime) } GROUP BY ?o"
    )
    found = window(body, FIVE, FIVE, (ONE, WHEN, day))
    assert numbers(found) == [{"o": ONE.value, "n": "2"}]
    assert numbers(window(body, FIVE, FIVE, (ONE, WHEN, day), semantics="set")) == [
        {"o": ONE.value, "n": "1"}
    ]


def test_a_static_triple_is_one_more_element(tmp_path) -> None:
    path = tmp_path / "static.nt"
    path.write_text(f'{ONE} {SPEED} "05"^^<{XSD}integer> .\n')
    body = "SELECT (SUM(?v) AS ?n) WHERE { ?o d:speed ?v OPTIONAL { ?o d:alt ?h } }"
    assert numbers(window(body, FIVE, static=[path])) == [{"n": "10"}]


def test_select_all_shows_no_copies() -> None:
    found = window("SELECT * WHERE { ?o d:speed ?v OPTIONAL { ?o d:alt ?h } }", FIVE, FIVE)
    assert numbers(found) == [{"o": ONE.value, "v": "5"}] * 2


@pytest.mark.parametrize(
    ("where", "reason"),
    [
        ("{ ?o d:near/d:speed ?v }", "a property path"),
        ("{ ?o ^d:speed ?v }", "a property path"),
        ("{ GRAPH ?g { ?o d:speed ?v } }", "GRAPH"),
    ],
)
def test_what_is_not_covered_is_named(where: str, reason: str) -> None:
    with pytest.raises(Unsupported, match=reason):
        count_copies(parse_sparql(f"{PREFIXES} SELECT ?v WHERE {where}", {}))


def test_a_merged_window_says_so() -> None:
    body = "SELECT (COUNT(*) AS ?n) WHERE { ?o (d:speed|d:far) ?v BIND (BNODE() AS ?b) }"
    assert not window(body, FIVE).merged
    assert window(body, FIVE, FIVE).merged
    assert not window(body, FIVE, FIVE, semantics="set").merged


def test_a_path_counts_its_elements() -> None:
    body = "SELECT (COUNT(*) AS ?n) WHERE { ?o d:near/d:speed ?v }"
    found = window(body, (TWO, NEAR, ONE), FIVE, FIVE)
    assert numbers(found) == [{"n": "2"}]
    assert not found.merged


def test_distinct_over_all_variables_is_refused() -> None:
    with pytest.raises(Unsupported, match="DISTINCT"):
        count_copies(
            parse_sparql(
                f"{PREFIXES} SELECT (COUNT(DISTINCT *) AS ?n) WHERE {{ ?o d:speed ?v }}", {}
            )
        )


def test_a_type_is_found_whatever_its_prefix() -> None:
    text = (
        "PREFIX r: <http://www.w3.org/1999/02/22-rdf-syntax-ns#> SELECT ?o WHERE { ?o r:type ?c }"
    )
    query = parse_sparql(text, {})
    assert count_copies(query) == query
