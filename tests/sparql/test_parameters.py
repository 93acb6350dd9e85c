"""Terms in the place of a query's variables, against the same query with a row of VALUES."""

from __future__ import annotations

import pytest
from pyoxigraph import Literal, NamedNode, Quad, QueryBoolean, QuerySolutions, Store

from dyknow.sparql import parse_sparql, print_query
from dyknow.sparql.parameters import with_terms

EX = "http://example.org/"
PREFIXES = {"": EX}
P, Q, B = (NamedNode(EX + name) for name in "pqb")


@pytest.fixture(scope="module")
def store() -> Store:
    found = Store()
    for number, name in enumerate("abc", start=1):
        subject = NamedNode(EX + name)
        found.add(Quad(subject, P, Literal(number)))
        found.add(Quad(subject, Q, B))
    found.add(Quad(B, P, Literal(7), NamedNode(EX + "g")))
    return found


def rows(store: Store, text: str, **terms: NamedNode | Literal) -> list[str] | bool:
    found = store.query(print_query(with_terms(parse_sparql(text, PREFIXES), terms)))
    if isinstance(found, QueryBoolean):
        return bool(found)
    if not isinstance(found, QuerySolutions):
        return sorted(map(str, found))
    names = [variable.value for variable in found.variables]
    return sorted(" ".join(f"{name}={row[name]}" for name in names) for row in found)


TEXTS = [
    "SELECT ?s { ?s :p ?o FILTER(?o >= ?m) }",
    "SELECT ?s ?m { ?s :p ?o FILTER(?o >= ?m) }",
    "SELECT ?s { { SELECT ?s ?m { ?s :p ?o FILTER(?o >= ?m) } } }",
    "SELECT ?s ?x { ?s :p ?o BIND(?o + ?m AS ?x) }",
    "SELECT (COUNT(*) AS ?n) { ?s :p ?o FILTER(?o >= ?m) }",
    "SELECT ?m (COUNT(*) AS ?n) { ?s :p ?o FILTER(?o >= ?m) } GROUP BY ?m",
    "SELECT ?m (SUM(?o - ?m) AS ?n) { ?s :p ?o } GROUP BY ?m HAVING (COUNT(*) > ?m)",
    "SELECT ?s { ?s :p ?o FILTER EXISTS { ?s :p ?z FILTER(?z > ?m) } }",
    "SELECT ?s ?z { ?s :q ?o OPTIONAL { ?s :p ?z FILTER(?z > ?m) } }",
    "SELECT ?s { ?s :q ?o MINUS { ?s :p ?m } }",
    "SELECT ?s { ?s :p ?m } ORDER BY DESC(?m)",
    "SELECT ?s { ?s :p ?o FILTER(BOUND(?m) && ?o IN (?m, 3)) }",
    "ASK { ?s :p ?m }",
    "CONSTRUCT { ?s :r ?m } { ?s :p ?o FILTER(?o > ?m) }",
]


@pytest.mark.parametrize("text", TEXTS)
def test_a_term_stands_where_its_variable_stood(store: Store, text: str) -> None:
    pasted = text.replace("SELECT ?m ", "SELECT (2 AS ?m) ").replace("?s ?m {", "?s (2 AS ?m) {")
    pasted = pasted.replace("GROUP BY ?m", "GROUP BY (2)").replace("BOUND(?m)", "true")
    pasted = pasted.replace("AS ?m)", "AS #m)").replace("?m", "2").replace("#m", "?m")
    assert "?m" in text
    assert rows(store, text, m=Literal(2)) == rows(store, pasted)
    assert rows(store, text, m=Literal(2)) != rows(store, text, m=Literal(3)) or "ASK" in text


def test_iris_stand_in_every_place(store: Store) -> None:
    text = "SELECT ?x { ?s ?p ?x }"
    assert rows(store, text, s=B, p=P) == [f"x={Literal(2)}"]
    of_graph = "SELECT ?x { GRAPH ?g { ?s :p ?x } }"
    assert rows(store, of_graph, g=NamedNode(EX + "g")) == [f"x={Literal(7)}"]
    assert rows(store, of_graph, g=B) == []
    assert rows(store, "DESCRIBE ?s", s=B) == rows(store, "DESCRIBE :b")


@pytest.mark.parametrize(
    ("text", "name", "said"),
    [
        ("ASK { ?s :p ?o }", "m", "does not use \\$m"),
        ("ASK { ?s :p ?o BIND(1 AS ?m) }", "m", r"assigns \?m itself"),
        ("SELECT (COUNT(*) AS ?m) { ?s :p ?o }", "m", r"assigns \?m itself"),
        ("ASK { ?s :p ?m VALUES ?m { 1 2 } }", "m", r"assigns \?m itself"),
        ("SELECT ?m { ?s :p ?o } GROUP BY (?o + 1 AS ?m)", "m", r"assigns \?m itself"),
        ("ASK { ?m :p ?o }", "m", r"\$m needs an IRI"),
        ("ASK { ?s ?m ?o }", "m", r"\$m needs an IRI"),
        ("ASK { GRAPH ?m { ?s ?p ?o } }", "m", r"\$m needs an IRI"),
        ("DESCRIBE ?m", "m", r"\$m needs an IRI"),
        ("CONSTRUCT { ?m :p ?o } { ?s :p ?o }", "m", r"\$m needs an IRI"),
    ],
)
def test_what_cannot_take_the_term_is_refused(text: str, name: str, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        with_terms(parse_sparql(text, PREFIXES), {name: Literal(1)})
