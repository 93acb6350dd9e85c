"""What columns evaluate though it looks as if only Oxigraph could: IRI() with a BASE, EXISTS in a
condition of OPTIONAL."""

import time

import pytest
from pyoxigraph import Literal, NamedNode, Quad, Store

import dyknow
from dyknow.continuous.evaluate import Explained

S = "urn:s"
XSD = "http://www.w3.org/2001/XMLSchema#"


def node(name):
    return NamedNode(f"http://e/{name}")


TRIPLES = [
    (node("a"), node("p"), Literal("b")),
    (node("a"), node("p"), Literal(3)),
    (node("a"), node("q"), node("z")),
    (node("b"), node("p"), Literal(2**62)),
    (node("b"), node("p"), Literal("../x")),
    (node("b"), node("r"), Literal(2**62 + 1)),
    (node("z"), node("p"), Literal("http://f/ä")),
    (node("z"), node("p"), Literal("no iri")),
]


def windows(prologue, head, where, tail=""):
    """The solutions of the one window, and how the query was computed."""
    explained = Explained(time.perf_counter_ns)
    text = f"{prologue} {head} FROM STREAM <{S}> [RANGE 1s STEP 1s] WHERE {{ {where} }} {tail}"
    streams = {S: [(10**9, *triple) for triple in TRIPLES]}
    (window,) = dyknow.evaluate(text, streams, explained=explained)
    return list(window.solutions), str(explained)


def by_oxigraph(prologue, head, where):
    store = Store()
    store.extend(Quad(*triple) for triple in TRIPLES)
    found = store.query(f"{prologue} {head} WHERE {{ {where} }}")
    names = [variable.value for variable in found.variables]
    return [
        {name: term for name in names if (term := solution[name]) is not None} for solution in found
    ]


def rows(solutions):
    return sorted(sorted((name, str(term)) for name, term in row.items()) for row in solutions)


PREFIX = "PREFIX : <http://e/>"
CASES = [
    "?o :p ?v BIND(IRI(?v) AS ?x)",
    "?o :p ?v BIND(URI(?v) AS ?x)",
    "?o :p ?v BIND(IRI(?o) AS ?x)",
    "?o :p ?v BIND(COALESCE(IRI(CONCAT('../', ?v)), 1) AS ?x)",
    "?o :p ?v FILTER(IRI(STR(?o)) = ?o) BIND(STR(IRI('#f')) AS ?x)",
    "{ SELECT ?o (IRI('sub') AS ?x) { ?o :p ?v } }",
    "?o :p ?v FILTER EXISTS { ?o :q ?w FILTER(IRI('z') = ?w || isIRI(IRI('z'))) }",
    "?o ?p ?v OPTIONAL { ?o :p ?x FILTER(EXISTS { ?o :q ?y } && ?x != ?v) }",
    "?o ?p ?v OPTIONAL { ?o :p ?x FILTER NOT EXISTS { ?o :q ?y MINUS { ?y :p 'b' } } }",
    "?o ?p ?v OPTIONAL { ?v :p ?x FILTER EXISTS { ?z :q ?v } }",
]


@pytest.mark.parametrize("where", CASES)
@pytest.mark.parametrize("base", ["", "BASE <http://base/d/f>"])
def test_columns_give_what_oxigraph_gives(base, where):
    prologue, head = f"{PREFIX} {base}", "SELECT ?o ?v ?x"
    found, explained = windows(prologue, head, where)
    assert rows(found) == rows(by_oxigraph(prologue, head, where))
    assert "on Oxigraph" not in explained


def test_exists_over_what_only_the_outer_side_binds_runs_on_oxigraph():
    where = "?o ?p ?v OPTIONAL { ?z :p ?x FILTER NOT EXISTS { ?o :q ?y } }"
    found, explained = windows(PREFIX, "SELECT ?o ?v ?x", where)
    assert rows(found) == rows(by_oxigraph(PREFIX, "SELECT ?o ?v ?x", where))
    assert "because of EXISTS over outer variables in a condition of OPTIONAL" in explained


def test_iri_does_not_make_numbers_overflow():
    where = "?o :p|:r ?v FILTER(IRI(STR(?o)) = :b && isNumeric(?v))"
    found, _ = windows(PREFIX, "SELECT (SUM(?v) AS ?x)", where)
    assert found == [{"x": Literal(str(2**63 + 1), datatype=NamedNode(XSD + "integer"))}]


def test_iri_goes_with_times_and_chance():
    where = "?o :p ?v BIND(IRI('x') AS ?x) BIND(f:timestamp(?v) AS ?t) BIND(RAND() AS ?r)"
    found, _ = windows(f"{PREFIX} BASE <http://b/>", "SELECT ?x ?t ?r", where)
    assert {(row["x"], row["t"]) for row in found} == {(NamedNode("http://b/x"), Literal(10**9))}


def test_explain_names_the_base():
    _, explained = windows(
        f"{PREFIX} BASE <http://b/>", "SELECT ?x", "?o :p ?v BIND(IRI(?v) AS ?x)"
    )
    assert "asked of Oxigraph, a distinct combination of values: BASE <http://b/> IRI" in explained
