"""Graphs in each format: what is written is what was asked for, or an error says why not."""

from __future__ import annotations

import io

import pytest
import rdflib
from pyoxigraph import BlankNode, Literal, NamedNode, Triple, parse

from dyknow.service.http.encodings.sparql_formats import GRAPHS, NotWritable, write_graph

XSD = "http://www.w3.org/2001/XMLSchema#"
S, P = NamedNode("http://e.org/s?a&b"), NamedNode("http://e.org/p")
GRAPH = [
    Triple(S, P, Literal("<&>\" '\t\n\r\r\n ü 😀")),
    Triple(S, P, Literal("", language="sv")),
    Triple(S, P, Literal("01", datatype=NamedNode(XSD + "integer"))),
    Triple(S, NamedNode("http://e.org/1a.b-c"), NamedNode("http://e.org/1")),
    Triple(S, NamedNode("urn:a:é"), S),
    Triple(BlankNode("0"), P, BlankNode("b0")),
    Triple(BlankNode("b0"), P, BlankNode("0")),
]


def written(triples: list[Triple], kind: str) -> bytes:
    found = io.BytesIO()
    write_graph(triples, found, kind, {"e": "http://e.org/"})
    return found.getvalue()


def shape(triples: list[Triple]) -> set[tuple[object, ...]]:
    """The triples, with one name for all blank nodes."""
    return {
        tuple("_" if isinstance(term, BlankNode) else term for term in triple) for triple in triples
    }


@pytest.mark.parametrize("kind", GRAPHS)
def test_each_format_reads_back(kind: str) -> None:
    quads = list(parse(written(GRAPH, kind), GRAPHS[kind]))
    assert shape([quad.triple for quad in quads]) == shape(GRAPH)
    nodes = [t for quad in quads for t in quad.triple if isinstance(t, BlankNode)]
    assert len(set(nodes)) == 2
    assert {str(quad.graph_name) for quad in quads} == {"DEFAULT"}


def test_other_parsers_read_the_xml() -> None:
    """Oxigraph's own takes names that XML does not have, and keeps a plain carriage return."""
    found = rdflib.Graph().parse(data=written(GRAPH, "application/rdf+xml"), format="xml")
    assert len(found) == len(GRAPH)
    text = GRAPH[0].object
    assert isinstance(text, Literal)
    assert (rdflib.URIRef(S.value), rdflib.URIRef(P.value), rdflib.Literal(text.value)) in found


@pytest.mark.parametrize(
    ("triple", "word"),
    [
        (Triple(S, NamedNode("http://e.org/1"), Literal("")), "<http://e.org/1>"),
        (Triple(S, NamedNode("http://e.org/"), Literal("")), "<http://e.org/>"),
        (Triple(S, NamedNode("http://e.org/a%20"), Literal("")), "<http://e.org/a%20>"),
        (Triple(S, P, Literal("a\x01b")), "U+0001"),
        (Triple(S, P, Literal("\uffff")), "U+FFFF"),
    ],
)
def test_what_rdf_xml_cannot_express_is_an_error(triple: Triple, word: str) -> None:
    with pytest.raises(NotWritable, match="text/turtle") as refused:
        written([GRAPH[0], triple], "application/rdf+xml")
    assert word in str(refused.value)
    for kind in GRAPHS:
        if kind != "application/rdf+xml":
            quads = list(parse(written([triple], kind), GRAPHS[kind]))
            assert [quad.triple for quad in quads] == [triple]


def test_a_long_property_takes_linear_time() -> None:
    """A search for a name at each of its characters would take hours."""
    with pytest.raises(NotWritable):
        written([Triple(S, NamedNode("urn:" + "a" * 1_000_000 + "/"), S)], "application/rdf+xml")
