"""A store with marks of deep hierarchies answers like one with all their pairs."""

from collections import Counter
from collections.abc import Iterable
from itertools import chain
from unittest.mock import patch

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pyoxigraph import NamedNode, Quad, QueryBoolean, QuerySolutions, Store

from dyknow.continuous.operators.background import Background
from dyknow.ontology.entailment import deep_hierarchies
from dyknow.ontology.entailment.closure_queries import QueryResults, answer
from dyknow.ontology.entailment.deep_hierarchies import MARKERS, deep_kinds
from dyknow.ontology.entailment.owlrl_closure import closure_of
from dyknow.ontology.errors import OntologyError
from dyknow.ontology.graphs import ENTAILMENTS
from dyknow.rdf.namespaces import DYKNOW, OWL, RDF_TYPE, RDFS

GRAPHS = [NamedNode(f"urn:test:{name}") for name in ("one", "two")]
KINDS = {
    RDFS + "subClassOf": "c",
    OWL + "equivalentClass": "c",
    RDFS + "subPropertyOf": "p",
    OWL + "equivalentProperty": "p",
}


def node(name: str) -> NamedNode:
    return NamedNode(DYKNOW + name)


@st.composite
def statements(draw: st.DrawFn) -> Quad:
    predicate = draw(st.sampled_from([*KINDS, RDFS + "subClassOf", RDFS + "subPropertyOf"]))
    ends = [node(f"{KINDS[predicate]}{draw(st.integers(0, 5))}") for _ in range(2)]
    if KINDS[predicate] == "c" and draw(st.integers(0, 9)) == 0:
        ends[1] = NamedNode(OWL + "Thing")
    return Quad(ends[0], NamedNode(predicate), ends[1], draw(st.sampled_from(GRAPHS)))


@st.composite
def facts(draw: st.DrawFn) -> Quad:
    graph = draw(st.sampled_from(GRAPHS))
    subject = node(draw(st.sampled_from(["a", "b", "c1", "c2", "p1"])))
    predicate, object = draw(
        st.sampled_from(
            [
                (RDF_TYPE, node("c1")),
                (RDF_TYPE, node("c4")),
                (RDF_TYPE, NamedNode(OWL + "Class")),
                (node("p0"), node("b")),
                (node("about"), node("c2")),
            ]
        )
    )
    return Quad(subject, predicate, object, graph)


def store_of(quads: Iterable[Quad], most_pairs: int) -> Store:
    """As `Ontology` fills it: the default graph is the merge of the others."""
    stated = set(quads)
    with patch.object(deep_hierarchies, "MOST_PAIRS", most_pairs):
        implied = closure_of(frozenset(quad.triple for quad in stated))
    found = Store()
    found.extend([*stated, *(Quad(t.subject, t.predicate, t.object, ENTAILMENTS) for t in implied)])
    triples = chain((quad.triple for quad in stated), implied)
    found.extend([Quad(t.subject, t.predicate, t.object) for t in triples])
    return found


SUB, EQUAL = "rdfs:subClassOf", "owl:equivalentClass"
PATTERNS = [
    *(f"?x {SUB} ?y", f"?x {SUB} dyknow:c1", f"dyknow:c1 {SUB} ?y", f"?x {SUB} ?x"),
    *("?x rdfs:subPropertyOf ?y", "?x owl:equivalentProperty ?y", f"?x {EQUAL} ?y"),
    *(f"[] {SUB} ?y", f"_:n {SUB} ?y . ?z {EQUAL} _:n", f"?a a ?x ; dyknow:about/{SUB} ?y"),
    *("?x ?p ?y", "dyknow:c1 ?p ?y", "?x ?p dyknow:c1", "?x ?p ?x", "?p ?p ?y", "?x ?y [] "),
    *(f"?x {SUB}+ ?y", f"?x {SUB}* ?y", f"?x {SUB}? ?y", f"?x (^{SUB}|{EQUAL}) ?y"),
    *(f"?x {SUB}/{SUB} ?y", f"?x a/{SUB}* ?y", f"?x ^{SUB}/{EQUAL} dyknow:c2", f"?x ({EQUAL})+ ?y"),
    *(f"?x !{SUB} ?y", f"?x !(rdf:type|^{SUB}) ?y", "?x !^rdf:type ?y", "?x (!rdf:type)+ ?y"),
    *(f"?x (^{SUB})+ ?y", f"?x ({SUB}|dyknow:about)* dyknow:c2", "?x (!(^rdf:type|rdf:type))* ?y"),
    f"?x a ?y OPTIONAL {{ ?y {SUB} ?z }}",
    f"?x a ?y FILTER EXISTS {{ ?y {SUB} ?z . FILTER(?z != ?x) }}",
    f"?x {SUB} ?y FILTER NOT EXISTS {{ ?y {SUB} [] }}",
    f"?x a ?y FILTER EXISTS {{ ?z (^{SUB}|{EQUAL}) ?y . ?z {SUB} dyknow:c1 }}",
    f"?x {SUB}/^{SUB} ?y",
    f"?x {SUB} ?y MINUS {{ ?y {EQUAL} ?x }}",
    f"{{ ?x {SUB} ?y }} UNION {{ ?x {EQUAL} ?y }}",
    f"{{ SELECT ?x (COUNT(*) AS ?y) {{ ?x {SUB} ?z }} GROUP BY ?x }}",
    f"{{ SELECT * {{ ?x {SUB}/{SUB} ?y }} }}",
    f"GRAPH ?g {{ ?x {SUB} ?y }}",
    f"GRAPH ?g {{ ?x {EQUAL} ?y . ?x ?p ?z }}",
    f"GRAPH <{ENTAILMENTS.value}> {{ ?x ?p ?y }}",
    f"GRAPH <urn:test:one> {{ ?x {SUB} ?y }} ?y {SUB} ?z",
    f"VALUES ?x {{ dyknow:c1 dyknow:c3 }} ?x {SUB} ?y BIND(STR(?y) AS ?z)",
]
QUERIES = [
    *(f"SELECT * {{ {pattern} }}" for pattern in PATTERNS),
    f"SELECT * FROM <urn:test:one> {{ ?x {SUB} ?y }}",
    f"SELECT * FROM <urn:test:one> FROM <{ENTAILMENTS.value}> {{ ?x {SUB} ?y . ?y ?p ?z }}",
    f"SELECT * FROM NAMED <{ENTAILMENTS.value}> {{ GRAPH ?g {{ ?x {SUB} ?y }} }}",
    f"SELECT DISTINCT ?y (EXISTS {{ ?y {SUB} dyknow:c1 }} AS ?under) {{ ?x {SUB} ?y }} ORDER BY ?y",
    f"SELECT (COUNT(*) AS ?n) {{ ?x {SUB} ?y }} HAVING (COUNT(*) > 1)",
    f"ASK {{ dyknow:c0 {SUB} dyknow:c1 }}",
    f"CONSTRUCT {{ ?y dyknow:over ?x }} WHERE {{ ?x {SUB} ?y }}",
    f"CONSTRUCT WHERE {{ ?x {SUB} ?y . ?y ?p ?z }}",
    "DESCRIBE dyknow:c1 dyknow:p2",
    f"DESCRIBE ?x {{ ?x {SUB} dyknow:c2 }}",
    f"DESCRIBE * {{ ?x {SUB}/{SUB} dyknow:c2 }}",
]


def rows(found: QueryResults) -> object:
    if isinstance(found, QueryBoolean):
        return bool(found)
    if isinstance(found, QuerySolutions):
        names = [variable.value for variable in found.variables]
        return names, Counter(tuple(map(str, solution)) for solution in found)
    return {str(triple) for triple in found}


@given(st.lists(statements(), min_size=1, max_size=9), st.lists(facts(), max_size=4))
@settings(deadline=None, max_examples=60)
def test_queries_see_the_pairs_of_deep_hierarchies(stated: list[Quad], said: list[Quad]) -> None:
    try:
        whole, marked = (store_of([*stated, *said], most) for most in (10_000, 0))
    except OntologyError:
        return
    for text in QUERIES:
        assert rows(answer(marked, text)) == rows(answer(whole, text)), text
    one, other = Background(marked), Background(whole)
    assert set(one.triples()) == set(other.triples())
    for predicate in (RDF_TYPE, *map(NamedNode, KINDS)):
        for subject in (None, node("c1")):
            for object in (None, node("c2")):
                asked = subject, predicate, object
                assert set(one.scan(*asked)) == set(other.scan(*asked))
        assert one.has(predicate) == other.has(predicate)
        assert set(one.copy([predicate], None)) == set(other.copy([predicate], None))


@pytest.mark.parametrize("pattern", PATTERNS)
@pytest.mark.parametrize(
    ("default", "named"),
    [((*GRAPHS, ENTAILMENTS), ()), ((), (GRAPHS[0], ENTAILMENTS)), (GRAPHS[:1], (ENTAILMENTS,))],
)
def test_a_chosen_dataset_is_that_of_from(
    pattern: str, default: tuple[NamedNode, ...], named: tuple[NamedNode, ...]
) -> None:
    edges = [("c2", "c1"), ("c1", "c0"), ("c3", "c2")]
    quads = [
        Quad(node(sub), NamedNode(RDFS + "subClassOf"), node(sup), GRAPHS[sub == "c3"])
        for sub, sup in edges
    ]
    clauses = " ".join([*(f"FROM {g}" for g in default), *(f"FROM NAMED {g}" for g in named)])
    for most_pairs in (0, 10_000):
        store = store_of(quads, most_pairs)
        chosen = answer(store, f"SELECT * {{ {pattern} }}", (default, named))
        stated = answer(store, f"SELECT * {clauses} {{ {pattern} }}")
        assert rows(chosen) == rows(stated)
        # And it goes before another one in the text.
        other = f"SELECT * FROM <urn:other> FROM NAMED <urn:other> {{ {pattern} }}"
        assert rows(answer(store, other, (default, named))) == rows(
            answer(store, f"SELECT * {{ {pattern} }}", (default, named))
        )


def test_only_a_deep_hierarchy_has_marks() -> None:
    chained = [
        Quad(node(f"c{i + 1}"), NamedNode(RDFS + "subClassOf"), node(f"c{i}"), GRAPHS[0])
        for i in range(4)
    ]
    assert not deep_kinds(store_of(chained, 10))
    marked = store_of(chained, 9)
    assert [marks.kind[0].value for marks in deep_kinds(marked)] == [RDFS + "subClassOf"]
    assert not {q.predicate for q in store_of(chained, 10)} & MARKERS
    table = answer(marked, "SELECT ?n { dyknow:c4 rdfs:subClassOf ?n }")
    assert isinstance(table, QuerySolutions)
    assert {row["n"].value[-1] for row in table} == set("0123")


@pytest.mark.parametrize("text", ["SELECT * { ?s ?p ?o }", "DESCRIBE dyknow:c1"])
def test_marks_are_not_seen(text: str) -> None:
    chained = [Quad(node("c1"), NamedNode(RDFS + "subClassOf"), node("c0"), GRAPHS[0])]
    assert "entailments#" not in str(rows(answer(store_of(chained, 0), text)))
