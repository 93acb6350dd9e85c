"""Names and values stay names and values, whatever is in them: they are bound as terms."""

from __future__ import annotations

import json
from urllib.parse import quote
from xml.etree import ElementTree

import httpx
import pytest
from pyoxigraph import Literal, NamedNode, RdfFormat, parse

SSL = "stream s5 contains speed(UAV) = spd [km.h-1] for every UAV = id"
TEXT = {"Content-Type": "text/plain"}
LINES = {"Content-Type": "application/x-ndjson"}
HOSTILE = [
    '" . <urn:evil> <urn:evil> <urn:evil> . #',
    '" || "" = "',
    '") || true || ("" = "',
    "' || '' = '",
    "x> . <urn:evil> <urn:evil> <urn:evil> . <urn:x",
    "} UNION { ?s ?p ?o",
    "} } ; DROP ALL ; INSERT DATA { <urn:evil> <urn:evil> <urn:evil> } #",
    "# the rest is a comment",
    "a\nb\r\n\tc",
    "\\",
    '\\"',
    "\\u0022 || true || \\u0022",
    '"""',
    "'''",
    "${name} {name} %s {0}",
    "<!-- ]]> &lt; <a/> &#0;",
    "a\u202eb\u2028c\u00a0d\ufeff",
    "é\U0001f681",
    "?o",
    "dyknow:UAV",
]
TEMPLATE = """REGISTER TEMPLATE dyknow:NamedEvent(?o, ?text) COMPUTE EVERY 1s AS
PREFIX dyknow: <http://www.ida.liu.se/dyknow/>
CONSTRUCT { ?o dyknow:speed ?v }
WHERE { ?o a dyknow:UAV . ?o dyknow:speed ?v . FILTER(?text = "never") }
WINDOW [RANGE 5s STEP 1s]"""


@pytest.fixture
def annotated(http: httpx.Client) -> httpx.Client:
    fields = {"id": "string", "spd": "float"}
    http.put("/streams/s5", json={"fields": fields}).raise_for_status()
    http.post("/annotations", content=SSL, headers=TEXT).raise_for_status()
    return http


def publish(http: httpx.Client, ids: list[str]) -> None:
    rows = [
        {"valid": 10**9 + i, "available": 10**9 + i, "id": id, "spd": 150.0}
        for i, id in enumerate(ids)
    ]
    body = "\n".join(map(json.dumps, rows))
    http.post("/streams/s5/samples", content=body, headers=LINES).raise_for_status()
    http.post("/streams/s5/end").raise_for_status()


def is_untouched(http: httpx.Client) -> bool:
    asked = "ASK { { <urn:evil> ?p ?o } UNION { GRAPH ?g { <urn:evil> ?q ?r } } }"
    found = http.get("/sparql", params={"query": asked})
    return found.json()["boolean"] is False


def test_arguments_of_events(annotated: httpx.Client) -> None:
    http = annotated
    http.post("/templates", content=TEMPLATE, headers=TEXT).raise_for_status()
    streams = []
    for text in [*HOSTILE, "never"]:
        argument = str(Literal(text))
        body = {"event": "dyknow:NamedEvent", "arguments": ["?o", argument]}
        answer = http.post("/events", json=body)
        assert answer.status_code == 201, (text, answer.text)
        streams.append(answer.json()["stream"])
    publish(http, ["uav1"])
    counts = [len(http.get(f"/streams/{name}/samples").text.splitlines()) for name in streams]
    # What equals "never" is told, and nothing else gets through the FILTER.
    assert counts[:-1] == [0] * len(HOSTILE)
    assert counts[-1] > 0
    assert is_untouched(http)


@pytest.mark.parametrize(
    "argument",
    [
        "<http://e.org/a> || true",
        "<http://e.org/a b>",
        '<http://e.org/">',
        "<http://e.org/a>}",
        '"a" "b"',
        '"a"@en) || (true',
        '"a"^^<http://e.org/a> || true',
        "dyknow:UAV, dyknow:UAV",
        "?o) { }",
        "1 + 1",
        "",
    ],
)
def test_arguments_that_are_no_single_term(annotated: httpx.Client, argument: str) -> None:
    http = annotated
    http.post("/templates", content=TEMPLATE, headers=TEXT).raise_for_status()
    body = {"event": "dyknow:NamedEvent", "arguments": ["?o", argument]}
    assert http.post("/events", json=body).status_code == 400
    assert http.get("/events").json() == []


def test_ids_in_samples(annotated: httpx.Client) -> None:
    """Each is one node, in what columns answer, what Oxigraph answers, and as RDF."""
    http = annotated
    for name, where in {
        "columns": "?o dyknow:speed ?v",
        "oxigraph": "?o dyknow:speed ?v . FILTER(STRLEN(CONCAT(STR(?o), 'x')) > 0)",
    }.items():
        query = (
            f"REGISTER QUERY {name} COMPUTE EVERY 1s AS SELECT ?o FROM STREAM "
            f"<http://www.ida.liu.se/dyknow/s5.trdf> [RANGE 5s STEP 5s] WHERE {{ {where} }}"
        )
        http.post("/queries", content=query, headers=TEXT).raise_for_status()
    publish(http, HOSTILE)
    accept = {"Accept": "application/n-triples"}
    told = http.get("/streams/s5/samples", headers=accept).content
    triples = [quad.triple for quad in parse(told, RdfFormat.N_TRIPLES)]
    assert len(triples) == len(HOSTILE)
    nodes = {triple.subject for triple in triples}
    assert len(nodes) == len(HOSTILE)
    speed = NamedNode("http://www.ida.liu.se/dyknow/speed")
    assert all(triple.predicate == speed for triple in triples)
    for name in ("columns", "oxigraph"):
        found = http.get(f"/queries/{name}/results").json()["results"]["bindings"]
        assert {NamedNode(row["o"]["value"]) for row in found} == nodes
    assert is_untouched(http)


@pytest.mark.parametrize("text", HOSTILE)
def test_names_of_streams(http: httpx.Client, text: str) -> None:
    """A name that is taken is told as it is wherever it is told; others are refused."""
    body = {"fields": {"id": "string", "spd": "float"}}
    answer = http.put(f"/streams/{quote(text, safe='')}", json=body)
    assert answer.status_code in (201, 400, 404, 422), answer.text
    names = {stream["name"] for stream in http.get("/streams").json()}
    assert names == {"status"} | ({text} if answer.status_code == 201 else set())
    current = http.get("/specifications/current").text
    ElementTree.fromstring(current)
    asked = "PREFIX s: <http://www.dyknow.eu/ontology#> SELECT ?n { ?x a s:Stream ; s:hasName ?n }"
    found = http.get("/sparql", params={"query": asked}).json()["results"]["bindings"]
    assert {row["n"]["value"] for row in found} == names
    assert is_untouched(http)


@pytest.mark.parametrize(
    "namespace",
    ["http://e.org/> . <urn:evil> <urn:evil> <urn:evil> . <urn:", "http://e.org/ x", "x y", "}"],
)
def test_namespaces(http: httpx.Client, namespace: str) -> None:
    body = {"fields": {"id": "string", "spd": "float"}, "namespace": namespace}
    answer = http.put("/streams/s5", json=body)
    assert answer.status_code in (400, 422), answer.text
    assert is_untouched(http)


@pytest.mark.parametrize("text", HOSTILE[:-1])
def test_names_in_texts(annotated: httpx.Client, text: str) -> None:
    """Where a language wants a name, these are none, and nothing of the text takes effect."""
    http = annotated
    before = http.get("/streams").json(), http.get("/queries").json(), http.get("/kpl").json()
    body = "SELECT ?o FROM STREAM <http://www.ida.liu.se/dyknow/s5.trdf> [RANGE 5s STEP 5s]"
    sent = [
        ("/queries", f"REGISTER QUERY <{text}> AS {body} WHERE {{ ?o dyknow:speed ?v }}"),
        ("/queries", f"REGISTER QUERY q AS {body.replace('s5', text)} WHERE {{ ?o ?p ?v }}"),
        ("/templates", TEMPLATE.replace("dyknow:NamedEvent", f"<{text}>")),
        ("/kpl", f"strmgen {text} = s5"),
        ("/annotations", f"stream {text} contains speed(UAV) = spd for every UAV = id"),
        ("/annotations", SSL.replace("km.h-1", text)),
    ]
    for path, whole in sent:
        answer = http.post(path, content=whole.encode(), headers=TEXT)
        assert 400 <= answer.status_code < 500, (path, answer.status_code, answer.text)
    after = http.get("/streams").json(), http.get("/queries").json(), http.get("/kpl").json()
    assert after == before
    assert is_untouched(http)


@pytest.mark.parametrize("text", HOSTILE)
def test_texts_that_are_kept(http: httpx.Client, text: str) -> None:
    """A comment in a template comes back with it, and is no part of the store's updates."""
    comment = text.replace("\n", " ").replace("\r", " ").replace("\u2028", " ")
    source = TEMPLATE.replace("COMPUTE", f"# {comment}\nCOMPUTE", 1)
    answer = http.post("/templates", content=source.encode(), headers=TEXT)
    assert answer.status_code == 201, answer.text
    told = http.get("/templates/NamedEvent", headers={"Accept": "text/plain"})
    assert told.text.strip() == source.strip()
    assert http.delete("/templates/NamedEvent").status_code == 204
    assert is_untouched(http)
