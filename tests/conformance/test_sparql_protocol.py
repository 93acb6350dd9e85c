"""The W3C's SPARQL 1.1 Protocol and Service Description tests, over HTTP.

Each case has the name that it has in the W3C's manifest. The requests are written from there; the
graphs that the suite names are loaded under their names, since the service fetches none. `NOT_RUN`
lists the other cases. docs/reference/sparql-conformance.md says the same.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from urllib.parse import urlencode

import httpx
import pytest
from asking import asking
from pyoxigraph import NamedNode, RdfFormat, Triple, parse
from w3c_sparql import FOLDER, cases

from dyknow.engine.engine import Engine
from dyknow.rdf.namespaces import RDF_TYPE
from dyknow.service.app import create_app
from dyknow.service.config.settings import Settings
from dyknow.service.server import running

GRAPH = "http://kasei.us/2009/09/sparql/data/data{}.rdf"
ONE, TWO, THREE = (GRAPH.format(number) for number in (1, 2, 3))
DOCUMENT = "http://xmlns.com/foaf/0.1/Document"
QUERY = "application/sparql-query"
UPDATE = "application/sparql-update"
FORM = "application/x-www-form-urlencoded"
BOOLEAN = ("application/sparql-results+json", "application/sparql-results+xml")
TABULAR = (*BOOLEAN, "text/csv", "text/tab-separated-values")
RDF_TYPES = ("text/turtle", "application/rdf+xml", "application/n-triples", "application/ld+json")

IN_DEFAULT = f"ASK {{ <{ONE}> a ?type . <{TWO}> a ?type . }}"
IN_NAMED = f"ASK {{ GRAPH ?g1 {{ <{ONE}> a ?type }} GRAPH ?g2 {{ <{TWO}> a ?type }} }}"
IN_BOTH = f"""ASK {{
  <{THREE}> a ?type
  GRAPH ?g1 {{ <{ONE}> a ?type }}
  GRAPH ?g2 {{ <{TWO}> a ?type }}
}}"""
NOTHING = ("default-graph-uri", GRAPH.format(0))
"""A graph that the suite has no data for."""
DEFAULT_GRAPHS = [("default-graph-uri", ONE), ("default-graph-uri", TWO)]
NAMED_GRAPHS = [("named-graph-uri", ONE), ("named-graph-uri", TWO)]
CONFLICT = """PREFIX foaf: <http://xmlns.com/foaf/0.1/>
WITH <http://example/addresses>
DELETE { ?person foaf:givenName 'Bill' }
INSERT { ?person foaf:givenName 'William' }
WHERE { ?person foaf:givenName 'Bill' }"""


@dataclass(frozen=True)
class Case:
    """A request, and what the suite expects of its answer: true, one of these formats, or 4xx."""

    name: str
    method: str = "GET"
    parameters: list[tuple[str, str]] = field(default_factory=list)
    body: bytes = b""
    type: str = ""
    boolean: bool = False
    formats: tuple[str, ...] = ()


def query(text: str) -> tuple[str, str]:
    return "query", text


def form(*parameters: tuple[str, str]) -> bytes:
    return urlencode(parameters).encode()


def direct(
    name: str,
    text: str,
    parameters: Sequence[tuple[str, str]] = (),
    formats: tuple[str, ...] = (),
) -> Case:
    return Case(name, "POST", [*parameters], text.encode(), QUERY, not formats, formats)


ANSWERED = [
    Case(
        "query_post_form",
        "POST",
        [NOTHING],
        form(query("ASK {}")),
        FORM,
        boolean=True,
    ),
    Case(
        "query_dataset_default_graphs_get",
        parameters=[query(IN_DEFAULT), *DEFAULT_GRAPHS],
        boolean=True,
    ),
    direct("query_dataset_default_graphs_post", IN_DEFAULT, DEFAULT_GRAPHS),
    direct("query_dataset_named_graphs_post", IN_NAMED, NAMED_GRAPHS),
    Case(
        "query_dataset_named_graphs_get", parameters=[query(IN_NAMED), *NAMED_GRAPHS], boolean=True
    ),
    direct("query_dataset_full", IN_BOTH, [("default-graph-uri", THREE), *NAMED_GRAPHS]),
    direct("query_multiple_dataset", IN_NAMED.replace("ASK", f"ASK FROM <{THREE}>"), NAMED_GRAPHS),
    Case("query_get", parameters=[query("ASK {}"), NOTHING], boolean=True),
    direct("query_content_type_select", "SELECT (1 AS ?value) {}", [NOTHING], TABULAR),
    direct("query_content_type_ask", "ASK {}", [NOTHING], BOOLEAN),
    direct("query_content_type_describe", "DESCRIBE <http://example.org/>", [NOTHING], RDF_TYPES),
    direct(
        "query_content_type_construct", "CONSTRUCT { <s> <p> 1 } WHERE {}", [NOTHING], RDF_TYPES
    ),
    direct("query_post_direct", "ASK {}"),
]
REFUSED = [
    Case("bad_query_method", "PUT", [query("ASK {}"), NOTHING], type=FORM),
    Case("bad_multiple_queries", parameters=[query("ASK {}"), query("SELECT * {}")]),
    Case("bad_query_wrong_media_type", "POST", [], b"ASK {}", "text/plain"),
    Case("bad_query_missing_form_type", "POST", [], form(query("ASK {}"))),
    Case("bad_query_missing_direct_type", "POST", [], b"ASK {}"),
    Case("bad_query_non_utf8", "POST", [], "ASK {}".encode("utf-16"), f"{QUERY}; charset=UTF-16"),
    Case("bad_query_syntax", parameters=[query("ASK {")]),
    # As every update is: the service has none.
    Case("bad_update_get", parameters=[("update", "CLEAR ALL")]),
    Case(
        "bad_multiple_updates",
        "POST",
        [],
        form(("update", "CLEAR NAMED"), ("update", "CLEAR DEFAULT")),
        FORM,
    ),
    Case("bad_update_wrong_media_type", "POST", [], b"CLEAR NAMED", "text/plain"),
    Case("bad_update_missing_form_type", "POST", [], form(("update", "CLEAR NAMED"))),
    Case(
        "bad_update_non_utf8",
        "POST",
        [],
        "CLEAR NAMED".encode("utf-16"),
        f"{UPDATE}; charset=UTF-16",
    ),
    Case("bad_update_syntax", "POST", [], form(("update", "CLEAR XYZ")), FORM),
    Case(
        "bad_update_dataset_conflict",
        "POST",
        [("using-named-graph-uri", "http://example/people")],
        CONFLICT.encode(),
        UPDATE,
    ),
]
# These execute updates, and the service has none.
NOT_RUN = (
    "update_dataset_default_graph",
    "update_dataset_default_graphs",
    "update_dataset_named_graphs",
    "update_dataset_full",
    "update_post_form",
    "update_post_direct",
    "update_base_uri",
)
DESCRIBED = ("returns-rdf", "has-endpoint-triple", "conforms-to-schema")


@pytest.fixture(scope="module")
def http() -> Iterator[httpx.Client]:
    """A service that has the graphs of the suite."""
    settings = Settings(port=0, tick=1)
    with (
        running(create_app(Engine(epoch="e1"), settings, time.time_ns), settings) as url,
        asking(url) as client,
    ):
        for graph in (ONE, TWO, THREE):
            client.post(
                "/ontologies",
                params={"name": graph},
                content=f"<{graph}> a <{DOCUMENT}> .",
                headers={"Content-Type": "text/turtle"},
            ).raise_for_status()
        yield client


def send(http: httpx.Client, case: Case) -> httpx.Response:
    headers = {"Content-Type": case.type} if case.type else {}
    return http.request(
        case.method,
        "/sparql",
        params=case.parameters or None,
        content=case.body or None,
        headers=headers,
    )


@pytest.mark.parametrize("case", ANSWERED, ids=lambda case: case.name)
def test_queries_that_are_answered(http: httpx.Client, case: Case) -> None:
    answer = send(http, case)
    assert answer.status_code == 200, answer.text
    if case.boolean:
        assert answer.json()["boolean"] is True
    else:
        assert answer.headers["content-type"].partition(";")[0] in case.formats


@pytest.mark.parametrize("case", REFUSED, ids=lambda case: case.name)
def test_requests_that_are_refused(http: httpx.Client, case: Case) -> None:
    answer = send(http, case)
    assert 400 <= answer.status_code < 500
    assert answer.json()["hint"]


@pytest.mark.parametrize(
    "case", [case for case in ANSWERED if "dataset" in case.name], ids=lambda case: case.name
)
def test_without_the_graphs_the_answer_is_another(http: httpx.Client, case: Case) -> None:
    """The suite expects only "true", which a service that ignores the dataset may answer too."""
    others = [(k, v if k == "query" else f"{v}.none") for k, v in case.parameters]
    answer = send(http, replace(case, parameters=others))
    assert answer.status_code == 200
    assert answer.json()["boolean"] is False


@pytest.mark.parametrize(
    ("text", "types"),
    [
        ("SELECT (1 AS ?value) {}", TABULAR),
        ("ASK {}", BOOLEAN),
        (
            "CONSTRUCT { <s> <p> 1 } WHERE {}",
            (*RDF_TYPES, "application/trig", "application/n-quads"),
        ),
    ],
)
def test_every_format_that_is_asked_for(
    http: httpx.Client, text: str, types: tuple[str, ...]
) -> None:
    for accept in types:
        answer = http.get("/sparql", params={"query": text}, headers={"Accept": accept})
        assert answer.status_code == 200
        assert answer.headers["content-type"].partition(";")[0] == accept


def test_relative_iris_are_resolved_against_the_endpoint(http: httpx.Client) -> None:
    text = "CONSTRUCT { <s> <p> ?x } WHERE { BIND (IRI('x') AS ?x) }"
    answer = http.get(
        "/sparql", params={"query": text}, headers={"Accept": "application/n-triples"}
    )
    assert answer.text == f"<{http.base_url}/s> <{http.base_url}/p> <{http.base_url}/x> .\n"


def description(http: httpx.Client, accept: str = "text/turtle") -> set[Triple]:
    answer = http.get("/sparql", headers={"Accept": accept})
    assert answer.status_code == 200
    assert answer.headers["content-type"].partition(";")[0] == accept
    format = RdfFormat.from_media_type(accept)
    assert format is not None
    return {quad.triple for quad in parse(answer.content, format)}


def sd(name: str) -> NamedNode:
    return NamedNode(f"http://www.w3.org/ns/sparql-service-description#{name}")


def objects(found: set[Triple], predicate: NamedNode) -> list[str]:
    return [triple.object.value for triple in found if triple.predicate == predicate]


def test_returns_rdf(http: httpx.Client) -> None:
    assert http.get("/sparql").headers["content-type"].startswith("text/turtle")
    by_format = [description(http, accept) for accept in RDF_TYPES]
    assert {len(found) for found in by_format} == {len(by_format[0])}
    for predicate in (sd("resultFormat"), sd("name")):
        assert len({frozenset(objects(found, predicate)) for found in by_format}) == 1


def test_has_endpoint_triple(http: httpx.Client) -> None:
    assert objects(description(http), sd("endpoint")) == [f"{http.base_url}/sparql"]


# The class of the subject, and of an object that the description describes, for each property of
# the vocabulary that it may use.
SCHEMA = {
    sd("endpoint"): ("Service", None),
    sd("supportedLanguage"): ("Service", None),
    sd("resultFormat"): ("Service", None),
    sd("defaultEntailmentRegime"): ("Service", None),
    sd("defaultDataset"): ("Service", "Dataset"),
    sd("availableGraphs"): ("Service", "Dataset"),  # a kind of GraphCollection
    sd("defaultGraph"): ("Dataset", "Graph"),
    sd("namedGraph"): ("Dataset", "NamedGraph"),
    sd("name"): ("NamedGraph", None),
}


def test_conforms_to_schema(http: httpx.Client) -> None:
    found = description(http)
    types = {t.subject: t.object for t in found if t.predicate == RDF_TYPE}
    assert list(types.values()).count(sd("Service")) == 1
    used = {triple.predicate for triple in found}
    assert used == {*SCHEMA, RDF_TYPE, NamedNode("http://purl.org/dc/terms/description")}
    for triple in found:
        domain, range_ = SCHEMA.get(triple.predicate, (None, None))
        assert domain is None or types[triple.subject] == sd(domain), triple
        assert range_ is None or types[triple.object] == sd(range_), triple
    assert objects(found, sd("supportedLanguage")) == [sd("SPARQL11Query").value]
    assert list(types.values()).count(sd("NamedGraph")) == len(objects(found, sd("name")))


def test_the_description_is_true(http: httpx.Client) -> None:
    """Of its formats and its graphs: it lists neither more nor less than there is."""
    found = description(http)
    formats = {each.rpartition("/")[2] for each in objects(found, sd("resultFormat"))}
    results = {f"SPARQL_Results_{name}" for name in ("JSON", "XML", "CSV", "TSV")}
    assert formats == results | {"Turtle", "N-Triples", "JSON-LD", "RDF_XML", "TriG", "N-Quads"}
    asked = {"query": "SELECT DISTINCT ?g { GRAPH ?g { ?s ?p ?o } }"}
    bindings = http.get("/sparql", params=asked).json()["results"]["bindings"]
    assert set(objects(found, sd("name"))) == {row["g"]["value"] for row in bindings}
    assert {ONE, TWO, THREE} < set(objects(found, sd("name")))


@pytest.mark.parametrize("folder", ["protocol", "service-description"])
def test_every_case_of_the_suite_is_here(folder: str) -> None:
    manifest = FOLDER / folder / "manifest.ttl"
    if not manifest.exists():
        pytest.skip(f"{manifest} is not here (see shared_data.py)")
    names = [case.name.partition("/")[2] for case in cases() if case.folder == folder]
    here = (
        [*(case.name for case in ANSWERED + REFUSED), *NOT_RUN]
        if folder == "protocol"
        else DESCRIBED
    )
    assert sorted(names) == sorted(here)
