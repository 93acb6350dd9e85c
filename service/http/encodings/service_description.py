"""What ``/sparql`` says of itself: SPARQL 1.1 Service Description, as triples.

It states only what holds. So ``sd:UnionDefaultGraph`` is missing: the default graph is the union of
all named graphs but one, the catalog. ``sd:DereferencesURIs`` and ``sd:BasicFederatedQuery`` are
missing too: the service contacts no other.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Final

from pyoxigraph import BlankNode, Literal, NamedNode, Triple

from ....ontology.graphs import CATALOG
from ....rdf.namespaces import RDF_TYPE
from ...config.media_types import JSON_LD, NTRIPLES, RDF_XML, TURTLE
from .sparql_formats import GRAPHS, TABLES

KINDS: Final = (TURTLE, NTRIPLES, JSON_LD, RDF_XML)
"""The formats of a description."""
SD: Final = "http://www.w3.org/ns/sparql-service-description#"
FORMATS: Final = "http://www.w3.org/ns/formats/"
ENTAILMENT: Final = "http://www.w3.org/ns/entailment/"
DCTERMS: Final = "http://purl.org/dc/terms/"
PREFIXES: Final = {"sd": SD, "formats": FORMATS, "ent": ENTAILMENT, "dcterms": DCTERMS}
_TEXT: Final = NamedNode(DCTERMS + "description")
_DEFAULT_GRAPH: Final = (
    f"The merge of all named graphs but <{CATALOG.value}>: ontologies, templates, annotations, "
    "declarations, the live stream space, and triples that rules of OWL 2 RL entail from these. A "
    "query entails no others."
)


def describe(endpoint: str, graphs: Iterable[str]) -> Iterator[Triple]:
    """Yield the description of the service at the IRI ``endpoint``, whose store has these named
    graphs."""
    service = NamedNode(f"{endpoint}#service")
    dataset, default_graph = NamedNode(f"{endpoint}#dataset"), BlankNode()
    yield Triple(service, RDF_TYPE, _sd("Service"))
    yield Triple(service, _sd("endpoint"), NamedNode(endpoint))
    yield Triple(service, _sd("supportedLanguage"), _sd("SPARQL11Query"))
    for iri in _formats():
        yield Triple(service, _sd("resultFormat"), NamedNode(iri))
    yield Triple(service, _sd("defaultEntailmentRegime"), NamedNode(ENTAILMENT + "Simple"))
    yield Triple(service, _sd("defaultDataset"), dataset)
    # A request chooses among the graphs of the store only: nothing is fetched.
    yield Triple(service, _sd("availableGraphs"), dataset)
    yield Triple(dataset, RDF_TYPE, _sd("Dataset"))
    yield Triple(dataset, _sd("defaultGraph"), default_graph)
    named = [(BlankNode(), NamedNode(graph)) for graph in graphs]
    for node, _ in named:
        yield Triple(dataset, _sd("namedGraph"), node)
    yield Triple(default_graph, RDF_TYPE, _sd("Graph"))
    yield Triple(default_graph, _TEXT, Literal(_DEFAULT_GRAPH, language="en"))
    for node, name in named:
        yield Triple(node, RDF_TYPE, _sd("NamedGraph"))
        yield Triple(node, _sd("name"), name)


def _sd(name: str) -> NamedNode:
    return NamedNode(SD + name)


def _formats() -> list[str]:
    """Return the W3C's IRIs of the formats of results, each once."""
    tables = dict.fromkeys(format.iri for format in TABLES.values())
    # Oxigraph's IRI of JSON-LD is none of http://www.w3.org/ns/formats/.
    graphs = [FORMATS + "JSON-LD" if k == JSON_LD else f.iri for k, f in GRAPHS.items()]
    return [*tables, *graphs]
