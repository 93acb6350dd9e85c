"""Ontologies are read and removed; one whose terms are in use stays, with the list of its users."""

from __future__ import annotations

from typing import Any
from urllib.parse import quote

import httpx
import pytest
from pyoxigraph import RdfFormat, parse

from dyknow.service.client.client import Client, ServiceError

HARBOUR = "http://example.org/harbour"
PREFIXES = """@prefix : <http://www.dyknow.eu/ontology#> .
@prefix dyknow: <http://www.ida.liu.se/dyknow/> .
@prefix owl: <http://www.w3.org/2002/07/owl#> .
@prefix rdfs: <http://www.w3.org/2000/01/rdf-schema#> .
@prefix xsd: <http://www.w3.org/2001/XMLSchema#> .
"""
SHIP = "dyknow:Ship a owl:Class ; rdfs:subClassOf dyknow:Vehicle .\n"
DRAUGHT = """dyknow:draught a :UnaryFeature, owl:DatatypeProperty ; rdfs:range xsd:double ;
  :hasUnit "m" .
"""
TURTLE = f"{PREFIXES}<{HARBOUR}> a owl:Ontology .\n{SHIP}{DRAUGHT}"
TEMPLATE = """REGISTER TEMPLATE dyknow:DeepEvent(?o, ?type, ?limit) COMPUTE EVERY 1s AS
PREFIX dyknow: <http://www.ida.liu.se/dyknow/>
CONSTRUCT {?o dyknow:draught ?d}
WHERE { ?o a ?type . ?o dyknow:draught ?d . FILTER (?d > ?limit) }
WINDOW [RANGE 1s STEP 1s]"""
FORMULA = "REGISTER TEMPLATE dyknow:ShallowEvent(?o) AS always draught(?o) < 3 [m]"
FAST = """REGISTER TEMPLATE dyknow:QuickEvent(?o, ?type, ?limit) COMPUTE EVERY 1s AS
PREFIX dyknow: <http://www.ida.liu.se/dyknow/>
CONSTRUCT {?o dyknow:speed ?s}
WHERE { ?o a ?type . ?o dyknow:speed ?s . FILTER (?s > ?limit) }
WINDOW [RANGE 1s STEP 1s]"""
QUERY = """REGISTER QUERY deep AS PREFIX dyknow: <http://www.ida.liu.se/dyknow/>
SELECT ?o ?d FROM STREAM <http://www.ida.liu.se/dyknow/ais.trdf> [RANGE 1s STEP 1s]
WHERE { ?o dyknow:draught ?d }"""
SPEEDS = QUERY.replace("draught", "speed").replace("deep", "quick")
FROM = SPEEDS.replace("FROM STREAM", f"FROM <{HARBOUR}> FROM STREAM")
MONITOR = "monitor shallow(?o in Ship) = draught(?o) < 3 [m]"
ANNOTATION = "stream ais contains draught(Ship) = d, speed(Ship) = v for every Ship = id"
VEHICLES = "stream ais contains speed(Vehicle) = v for every Vehicle = id"


@pytest.fixture
def harbour(client: Client) -> Client:
    client.load_ontology(TURTLE)
    client.put_stream("ais", {"id": "string", "d": "float", "v": "float"})
    return client


def refusal(client: Client, name: str = HARBOUR) -> ServiceError:
    with pytest.raises(ServiceError) as refused:
        client.remove_ontology(name)
    return refused.value


def test_its_text_says_what_was_loaded(harbour: Client, http: httpx.Client) -> None:
    def triples(text: str) -> set[Any]:
        return {quad.triple for quad in parse(text, format=RdfFormat.TURTLE)}

    assert triples(harbour.ontology(HARBOUR)) == triples(TURTLE)
    answer = http.get(f"/ontologies/{quote(HARBOUR, safe='')}")
    assert answer.headers["content-type"].startswith("text/turtle")
    assert "dyknow:Ship" in answer.text
    shipped = harbour.ontology("http://www.ida.liu.se/dyknow/ontology.rdf")
    assert "dyknow:speed" in shipped
    path = f"/ontologies/{quote(HARBOUR, safe='')}"
    assert http.get(path, headers={"Accept": "image/png"}).status_code == 406


@pytest.mark.parametrize("name", ["http://example.org/nowhere", "nowhere", "not an iri: <>"])
def test_an_ontology_that_there_is_not(client: Client, name: str) -> None:
    for call in (client.ontology, client.remove_ontology):
        with pytest.raises(ServiceError) as unknown:
            call(name)
        assert (unknown.value.status, unknown.value.title) == (404, "unknown ontology")
        assert "GET /ontologies" in unknown.value.hint


def test_a_removed_ontology_leaves_nothing(harbour: Client, http: httpx.Client) -> None:
    before = http.get("/vocabulary").json()
    harbour.remove_ontology(HARBOUR)
    assert HARBOUR not in harbour.ontologies()
    vocabulary = harbour.vocabulary()
    assert "dyknow:Ship" not in [each["name"] for each in vocabulary["sorts"]]
    question = {"query": "ASK { { dyknow:Ship ?p ?o } UNION { dyknow:draught ?p ?o } }"}
    assert http.get("/sparql", params=question).json()["boolean"] is False
    with pytest.raises(ServiceError):
        harbour.annotate(ANNOTATION)
    assert refusal(harbour).status == 404
    # And it comes back as it was.
    harbour.load_ontology(TURTLE)
    assert harbour.vocabulary() == before
    harbour.annotate(ANNOTATION)


def test_a_short_name_is_a_name(client: Client) -> None:
    client.load_ontology(PREFIXES + SHIP, "ships")
    assert "dyknow:Ship" in client.ontology("ships")
    client.remove_ontology("ships")
    assert not any(name.endswith("/ships") for name in client.ontologies())


def test_shipped_ontologies_stay(client: Client) -> None:
    for name in client.ontologies():
        refused = refusal(client, name)
        assert (refused.status, refused.title) == (403, "refused")
        assert "part of DyKnow" in refused.detail


USES: list[tuple[str, list[Any], str]] = [
    ("annotate", [ANNOTATION], "the annotation of stream ais"),
    ("register_template", [TEMPLATE], "template dyknow:DeepEvent"),
    ("register_template", [FORMULA], "template dyknow:ShallowEvent"),
    ("register_query", [QUERY], "query deep"),
    ("register_query", [FROM], "query quick"),
    ("register_query", [MONITOR], "query shallow"),
    ("subscribe_to", ["draught"], "subscription subscription1"),
    ("declare_kpl", ["source draught echo"], "`echo` of KPL"),
    ("load_ontology", [f"{PREFIXES}dyknow:Ferry rdfs:subClassOf dyknow:Ship .", "ferries"], ""),
]


@pytest.mark.parametrize(("verb", "arguments", "user"), USES, ids=[use[2] for use in USES])
def test_what_names_its_terms_is_listed(
    harbour: Client, verb: str, arguments: list[Any], user: str
) -> None:
    harbour.annotate(ANNOTATION)
    getattr(harbour, verb)(*arguments)
    if verb != "annotate":
        assert len(refusal(harbour).problem["used_by"]) == 2
    refused = refusal(harbour)
    assert (refused.status, refused.title) == (409, "conflict")
    user = user or "ontology http://www.ida.liu.se/dyknow/ontology/ferries"
    assert user in refused.problem["used_by"]
    assert user in refused.detail
    assert refused.hint == "remove or cancel these first"
    assert HARBOUR in harbour.ontologies()


def test_requests_of_its_sorts_and_of_templates_with_its_terms(harbour: Client) -> None:
    harbour.annotate(ANNOTATION)
    harbour.register_template(FAST)
    harbour.register_template(TEMPLATE)
    request = harbour.request_event("dyknow:QuickEvent(?o, dyknow:Ship, 1)")["id"]
    other = harbour.request_event("dyknow:DeepEvent(?o, dyknow:Vehicle, 1)")["id"]
    used = refusal(harbour).problem["used_by"]
    assert {f"request {request}", f"request {other}", "template dyknow:DeepEvent"} <= set(used)
    assert "template dyknow:QuickEvent" not in used


def test_what_names_other_terms_does_not_hold_it(harbour: Client) -> None:
    harbour.annotate(VEHICLES)
    harbour.register_template(FAST)
    harbour.register_query(SPEEDS)
    harbour.subscribe_to("speed", sort="Vehicle")
    harbour.request_event("dyknow:QuickEvent(?o, dyknow:Vehicle, 1)")
    harbour.remove_ontology(HARBOUR)
    assert HARBOUR not in harbour.ontologies()


def test_a_term_that_another_ontology_says_too_is_not_lost(harbour: Client) -> None:
    harbour.annotate(ANNOTATION)
    harbour.load_ontology(TURTLE.replace(f"<{HARBOUR}> a owl:Ontology .", ""), "twin")
    harbour.remove_ontology(HARBOUR)
    # Now the twin is the only one.
    assert refusal(harbour, "twin").problem["used_by"] == ["the annotation of stream ais"]
    harbour.annotate(VEHICLES)
    harbour.remove_ontology("twin")


def test_another_unit_is_a_change(client: Client) -> None:
    """The other ontology keeps the feature, but plain numbers would be in another unit."""
    bare = DRAUGHT.replace(':hasUnit "m"', "rdfs:label 'draught'")
    client.load_ontology(PREFIXES + SHIP + bare, "ships")
    client.load_ontology(PREFIXES + DRAUGHT, "units")
    client.put_stream("ais", {"id": "string", "d": "float", "v": "float"})
    client.annotate(ANNOTATION)
    assert refusal(client, "units").problem["used_by"] == ["the annotation of stream ais"]


def test_commands(dyknow: Any, harbour: Client) -> None:
    assert "dyknow:Ship" in dyknow("ontology", "show", HARBOUR).stdout
    harbour.annotate(ANNOTATION)
    refused = dyknow("ontology", "remove", HARBOUR, status=1).stderr
    assert "the annotation of stream ais" in refused
    harbour.annotate(VEHICLES)
    assert dyknow("ontology", "remove", HARBOUR).stdout.strip() == f"removed {HARBOUR}"
    assert "GET /ontologies" in dyknow("ontology", "remove", HARBOUR, status=1).stderr
