"""`GET /objects` and `GET /objects/{name}`: which objects are known, and what is known of one."""

from __future__ import annotations

from typing import Any
from urllib.parse import quote

import httpx
import pytest

from dyknow.rdf.namespaces import DYKNOW
from dyknow.service.client.client import Client, ServiceError

SSL = """stream gps contains latitude(UAV) = lat [deg], speed(UAV) = v [m.s-1] for every UAV = id
stream radar contains speed(RMAX) = v [km.h-1] for every RMAX = id"""
HARBOUR = """@prefix dyknow: <http://www.ida.liu.se/dyknow/> .
@prefix owl: <http://www.w3.org/2002/07/owl#> .
@prefix rdfs: <http://www.w3.org/2000/01/rdf-schema#> .
<http://x.org/harbour> a owl:Ontology .
dyknow:Ship a owl:Class ; rdfs:subClassOf dyknow:Thing .
<http://x.org/Anna> a dyknow:Ship . dyknow:rmax1 a dyknow:RMAX ."""


@pytest.fixture
def flying(client: Client) -> Client:
    client.put_stream("gps", {"id": "string", "lat": "float", "v": "float"})
    client.put_stream("radar", {"id": "string", "v": "float"})
    client.annotate(SSL)
    client.load_ontology(HARBOUR)
    second = 1_000_000_000
    rows: list[dict[str, Any]] = [
        {"id": "uav1", "lat": 58.0, "v": 10.0, "valid": 4 * second, "available": 5 * second},
        {"id": "uav2", "lat": 58.5, "v": 11.0, "valid": 5 * second, "available": 6 * second},
        {"id": "uav1", "lat": 59.0, "v": None, "valid": 6 * second, "available": 7 * second},
        {"id": "rmax1", "lat": 57.0, "v": 12.0, "valid": 1 * second, "available": 8 * second},
    ]
    client.publish("gps", rows)
    client.publish(
        "radar", [{"id": "rmax1", "v": 40.0, "valid": 9 * second, "available": 9 * second}]
    )
    client.end("gps")
    client.end("radar")
    return client


def names(page: dict[str, Any]) -> list[str]:
    return [each["name"] for each in page["objects"]]


def test_the_objects_of_a_sort_are_those_below_it_too(flying: Client) -> None:
    assert names(flying.objects("RMAX")) == ["dyknow:rmax1"]
    assert names(flying.objects("dyknow:UAV")) == ["dyknow:rmax1", "dyknow:uav1", "dyknow:uav2"]
    assert names(flying.objects(f"<{DYKNOW}Ship>")) == ["<http://x.org/Anna>"]
    page = flying.objects("Thing")
    assert not page["more"]
    found = {each["name"]: each for each in page["objects"]}
    assert found.keys() >= {"dyknow:rmax1", "dyknow:uav1", "<http://x.org/Anna>"}
    assert found["dyknow:rmax1"]["sorts"][:2] == ["dyknow:RMAX", "dyknow:UAV"]
    assert found["dyknow:rmax1"]["sorts"][-1] == "dyknow:Thing"
    assert names(flying.objects()) == names(page)


def test_pages_are_the_list(flying: Client, http: httpx.Client) -> None:
    whole = names(flying.objects(limit=1000))
    found: list[str] = []
    after, more = None, True
    while more:
        page = flying.objects(after=after, limit=2)
        assert 1 <= len(page["objects"]) <= 2
        found += names(page)
        after, more = page["objects"][-1]["iri"], page["more"]
    assert found == whole
    assert flying.objects(after="zzz") == {"objects": [], "more": False}
    assert http.get("/objects?limit=1001").status_code == 422
    answer = http.get("/objects?sort=Nothing")
    assert (answer.status_code, answer.json()["title"]) == (404, "unknown term")


@pytest.mark.parametrize("name", ["uav1", "dyknow:uav1", DYKNOW + "uav1", f"<{DYKNOW}uav1>"])
def test_an_object_has_its_sorts_and_newest_values(flying: Client, name: str) -> None:
    found = flying.object(name)
    assert (found["iri"], found["name"]) == (DYKNOW + "uav1", "dyknow:uav1")
    assert found["sorts"][0] == "dyknow:UAV"
    assert found["features"] == [
        {
            "feature": "dyknow:latitude",
            "value": 59.0,
            "unit": "deg",
            "of": ["dyknow:uav1"],
            "stream": "gps",
            "field": "lat",
            "valid": "1970-01-01T00:00:06Z",
            "available": "1970-01-01T00:00:07Z",
        },
        # The newest sample has no speed.
        {
            "feature": "dyknow:speed",
            "value": 10.0,
            "unit": "m.s-1",
            "of": ["dyknow:uav1"],
            "stream": "gps",
            "field": "v",
            "valid": "1970-01-01T00:00:04Z",
            "available": "1970-01-01T00:00:05Z",
        },
    ]


def test_of_a_feature_in_several_streams_the_newest_comes_first(flying: Client) -> None:
    found = flying.object("rmax1")
    speeds = [
        (each["stream"], each["value"], each["unit"])
        for each in found["features"]
        if each["feature"] == "dyknow:speed"
    ]
    assert speeds == [("radar", 40.0, "km.h-1"), ("gps", 12.0, "m.s-1")]
    assert found["sorts"][0] == "dyknow:RMAX"


def test_an_object_of_the_ontology_may_have_no_values(flying: Client) -> None:
    anna = flying.object("http://x.org/Anna")
    assert (anna["sorts"][0], anna["features"]) == ("dyknow:Ship", [])
    assert flying.object("self")["name"] == "dyknow-o:self"


def test_an_object_that_nothing_names_is_unknown(flying: Client, http: httpx.Client) -> None:
    with pytest.raises(ServiceError) as refused:
        flying.object("uav9")
    assert (refused.value.status, refused.value.title) == (404, "unknown object")
    assert "GET /objects" in refused.value.hint
    flying.remove_stream("gps")
    assert http.get("/objects/uav1").status_code == 404
    assert names(flying.objects("UAV")) == ["dyknow:rmax1"]


def test_ids_of_any_text(client: Client, http: httpx.Client) -> None:
    client.put_stream("s", {"id": "string", "n": "integer", "v": "float"})
    client.annotate("stream s contains speed(Car) = v for every Car = id")
    odd = ["a b", "50%", "ä/ö", "x#y?z", "http://x.org/q?a=1"]
    client.publish("s", [{"valid": i, "id": id, "n": i, "v": i} for i, id in enumerate(odd)])
    client.end("s")
    listed = client.objects("Car")["objects"]
    assert len(listed) == len(odd)
    for each in listed:
        found = http.get(f"/objects/{quote(each['iri'], safe='')}")
        assert found.status_code == 200, each
        assert found.json()["iri"] == each["iri"]
        assert len(found.json()["features"]) == 1
    client.annotate("stream s contains speed(Car) = v for every Car = n")
    assert [each["name"] for each in client.objects("Car")["objects"]] == [
        *(f"dyknow:{i}" for i in range(5)),
    ]
    assert client.object("3")["features"][0]["value"] == 3.0


def test_the_command_lists_objects_and_shows_one(flying: Client, dyknow: Any) -> None:
    listed = dyknow("objects", "--sort", "UAV", "--limit", "2")
    assert listed.stdout.split() == [
        "object",
        "sort",
        "dyknow:rmax1",
        "dyknow:RMAX",
        "dyknow:uav1",
        "dyknow:UAV",
    ]
    assert f"--after '{DYKNOW}uav1'" in listed.stderr
    rest = dyknow("objects", "--sort", "UAV", "--after", DYKNOW + "uav1").stdout
    assert "dyknow:uav2" in rest
    assert "rmax1" not in rest
    shown = dyknow("objects", "uav1").stdout
    assert "dyknow:UAV" in shown
    assert "59" in shown
    assert "gps" in shown
    assert '"features": [' in dyknow("objects", "uav1", "--json").stdout
    assert "leave the name out" in dyknow("objects", "uav1", "--sort", "UAV", status=2).stderr
