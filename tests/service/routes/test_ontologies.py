"""Domain ontologies come while the service runs: by route, by client, by command."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import httpx
import pytest
from typer.testing import CliRunner

from dyknow.service.cli import app
from dyknow.service.client.client import Client, ServiceError

HARBOUR = "http://example.org/harbour"
PREFIXES = """@prefix dyknow: <http://www.ida.liu.se/dyknow/> .
@prefix owl: <http://www.w3.org/2002/07/owl#> .
@prefix rdfs: <http://www.w3.org/2000/01/rdf-schema#> .
"""
SHIP = "dyknow:Ship a owl:Class ; rdfs:subClassOf dyknow:Vehicle .\n"
TURTLE = f"{PREFIXES}<{HARBOUR}> a owl:Ontology .\n{SHIP}"
OWL = "http://www.w3.org/2002/07/owl#"
RDF = "http://www.w3.org/1999/02/22-rdf-syntax-ns#"
NTRIPLES = f"<{HARBOUR}> <{RDF}type> <{OWL}Ontology> .\n"
RDF_XML = f'<r:RDF xmlns:r="{RDF}" xmlns:o="{OWL}"><o:Ontology r:about="{HARBOUR}"/></r:RDF>'
JSON_LD = f'{{"@id": "{HARBOUR}", "@type": "{OWL}Ontology"}}'
SSL = "stream ais contains speed(Ship) = sog [kt] for every Ship = id"


def post(http: httpx.Client, text: str, kind: str = "text/turtle", **query: str) -> httpx.Response:
    return http.post("/ontologies", content=text, headers={"Content-Type": kind}, params=query)


def test_a_sort_that_is_added_can_be_annotated(http: httpx.Client, client: Client) -> None:
    client.put_stream("ais", {"id": "string", "sog": "float"})
    with pytest.raises(ServiceError) as unknown:
        client.annotate(SSL)
    assert unknown.value.status == 400
    answer = post(http, TURTLE)
    assert (answer.status_code, answer.json()) == (201, {"name": HARBOUR})
    client.annotate(SSL)
    assert client.match("dyknow:speed", sort="dyknow:Ship")["found"] is True
    assert HARBOUR in client.ontologies()


@pytest.mark.parametrize(
    ("kind", "text"),
    [
        ("text/turtle", TURTLE),
        ("application/rdf+xml", RDF_XML),
        ("application/ld+json", JSON_LD),
        ("application/n-triples", NTRIPLES),
    ],
)
def test_its_name_is_in_the_text_or_given(client: Client, kind: str, text: str) -> None:
    assert client.load_ontology(text, media_type=kind) == {"name": HARBOUR}
    other = f"{HARBOUR}2"
    assert client.load_ontology(text, other, kind) == {"name": other}
    assert {HARBOUR, other} <= set(client.ontologies())


@pytest.mark.parametrize(
    "text",
    [
        PREFIXES + SHIP,
        f"{PREFIXES}<{HARBOUR}> a owl:Ontology . <{HARBOUR}2> a owl:Ontology .",
        f"{PREFIXES}<> a owl:Ontology .",
        f"{PREFIXES}[] a owl:Ontology .",
    ],
    ids=["none", "two", "relative", "blank"],
)
def test_a_text_without_a_name(http: httpx.Client, text: str) -> None:
    before = http.get("/ontologies").json()
    answer = post(http, text)
    assert answer.status_code == 400
    assert "?name=" in answer.json()["hint"]
    assert http.get("/ontologies").json() == before
    assert post(http, text, name=HARBOUR).json() == {"name": HARBOUR}


@pytest.mark.parametrize("query", [{}, {"name": HARBOUR}])
def test_a_text_that_is_none(http: httpx.Client, query: dict[str, str]) -> None:
    answer = post(http, TURTLE + "dyknow:Ship a a .", **query)
    assert answer.status_code == 400
    assert answer.json()["title"] == "bad ontology"
    assert answer.json()["line"] == TURTLE.count("\n") + 1
    assert HARBOUR not in http.get("/ontologies").json()


def test_what_is_refused(http: httpx.Client) -> None:
    assert post(http, TURTLE, "text/csv").status_code == 415
    assert post(http, TURTLE, name="http://a b/").status_code == 400
    assert post(http, " ").status_code == 400
    far = post(http, '{"@context": "http://example.org/c"}', "application/ld+json")
    assert "context" in far.json()["hint"]


@pytest.mark.parametrize(
    ("text", "query"),
    [
        (TURTLE, {"name": "http://www.dyknow.eu/ontology"}),
        ("<http://www.dyknow.eu/ontology> a <http://www.w3.org/2002/07/owl#Ontology> .", {}),
    ],
)
def test_the_terms_of_the_stream_space_are_not_replaced(
    http: httpx.Client, text: str, query: dict[str, str]
) -> None:
    answer = post(http, text, **query)
    assert answer.status_code == 400
    assert "another name" in answer.json()["hint"]
    question = (
        "ASK { <http://www.dyknow.eu/ontology#Stream> a <http://www.w3.org/2002/07/owl#Class> }"
    )
    assert http.get("/sparql", params={"query": question}).json()["boolean"]


def test_a_query_sees_all_pairs_of_a_deep_hierarchy(http: httpx.Client) -> None:
    """400 classes in a chain: the store, and its copies in workers, have marks and no pairs."""
    lines = [f"dyknow:D{i + 1} rdfs:subClassOf dyknow:D{i} ." for i in range(400)]
    deep = "\n".join(["dyknow:D0 rdfs:subClassOf dyknow:Vehicle .", *lines])
    assert post(http, TURTLE + deep).status_code == 201
    question = "SELECT (COUNT(*) AS ?n) { ?class rdfs:subClassOf dyknow:D0 }"
    answer = http.get("/sparql", params={"query": question}).json()
    assert answer["results"]["bindings"][0]["n"]["value"] == "400"
    described = http.get("/sparql", params={"query": "DESCRIBE dyknow:D400"}).text
    assert "dyknow/D0>" in described
    assert "entailments#" not in described


def test_commands(dyknow: Any, tmp_path: Path) -> None:
    path = tmp_path / "harbour.ttl"
    path.write_text(TURTLE)
    assert dyknow("ontology", "add", str(path)).stdout.strip() == f"loaded {HARBOUR}"
    dyknow("ontology", "add", str(path), "--name", f"{HARBOUR}2", "--json")
    listed = dyknow("ontology", "list").stdout.split()
    assert {HARBOUR, f"{HARBOUR}2"} <= set(listed)
    assert len(dyknow("ontology", "list", "--json").stdout.splitlines()) == len(listed)
    path.write_text(PREFIXES + SHIP)
    assert "--name" in dyknow("ontology", "add", str(path), status=1).stderr
    assert ".ttl" in dyknow("ontology", "add", str(tmp_path / "a.txt"), status=1).stderr
    assert "no file" in dyknow("ontology", "add", str(tmp_path / "a.ttl"), status=1).stderr


def test_the_stream_space_is_checked_on_request(
    client: Client, http: httpx.Client, url: str
) -> None:
    assert client.ontology_report() == {"conforms": True, "violations": []}
    done = CliRunner().invoke(app, ["ontology", "check", "--url", url])
    assert (done.exit_code, done.output.strip()) == (0, "well-formed")
    broken = "<http://example.org/u> a <http://www.dyknow.eu/ontology#ComputationalUnit> ."
    post(http, broken, "text/turtle", name="broken")
    report = client.ontology_report()
    assert report["conforms"] is False
    (violation, *_) = report["violations"]
    assert violation["node"] == "<http://example.org/u>"
    done = CliRunner().invoke(app, ["ontology", "check", "--url", url])
    assert done.exit_code == 1
    assert "<http://example.org/u>: " in done.output
