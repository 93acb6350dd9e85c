"""`GET /graph`: the same as the lists of streams, units and requests, in one answer."""

from __future__ import annotations

from typing import Any
from urllib.parse import quote

import httpx
import pytest

from dyknow.service.client.client import Client

SSL = """stream gps contains latitude(Car) = lat [deg], longitude(Car) = lon, speed(Car) = v
for every Car = car"""
TEMPLATE = """PREFIX dyknow: <http://www.ida.liu.se/dyknow/>
REGISTER TEMPLATE dyknow:Fast (?o, ?limit) AS
SELECT ?o ?spd WHERE { ?o dyknow:speed ?spd . FILTER (?spd > ?limit) }
WINDOW [RANGE 5s STEP 1s]"""
QUERY = """REGISTER QUERY highest COMPUTE EVERY 1s AS
PREFIX dyknow: <http://www.ida.liu.se/dyknow/>
SELECT ?o (MAX(?a) AS ?top) WHERE { ?o a dyknow:Car ; dyknow:latitude ?a } GROUP BY ?o
WINDOW [RANGE 2s STEP 1s]"""


@pytest.fixture
def busy(client: Client) -> Client:
    """A service where each kind of request runs."""
    client.put_stream("gps", {"car": "string", "lat": "float", "lon": "float", "v": "float"})
    client.put_stream("alone", {"x": "float"})
    client.annotate(SSL)
    client.register_template(TEMPLATE)
    client.request_event("dyknow:Fast(?o, 10)")
    client.request_event("dyknow:Fast(?o, 10)")
    client.register_query(QUERY)
    client.subscribe("gps", "sample every 1000")
    client.subscribe("highest")
    client.subscribe_to("dyknow:speed", sort="dyknow:Car")
    client.subscribe_to("dyknow:altitude", sort="dyknow:Car")
    return client


def near(client: Client, **around: Any) -> set[str]:
    return {node["id"] for node in client.graph(**around)["nodes"]}


def test_the_graph_is_what_the_lists_say(busy: Client, http: httpx.Client) -> None:
    graph = busy.graph()
    nodes = {node["id"]: node for node in graph["nodes"]}
    assert len(nodes) == len(graph["nodes"])
    streams, units = http.get("/streams").json(), http.get("/units").json()
    requests, queries = busy.requests(), busy.queries()
    subscriptions = busy.subscriptions()
    assert nodes.keys() == {
        *(f"/streams/{each['name']}" for each in streams),
        *(f"/units/{each['name']}" for each in units),
        *(f"/events/{each['id']}" for each in requests),
        *(f"/queries/{each['name']}" for each in queries),
        *(f"/subscriptions/{each['id']}" for each in subscriptions),
    }
    there = {each["name"] for each in streams}
    edges = {(edge["from"], edge["to"]) for edge in graph["edges"]}
    assert len(edges) == len(graph["edges"])
    assert edges == {
        *((f"/streams/{s}", f"/units/{u['name']}") for u in units for s in u["inputs"]),
        *(
            (f"/units/{u['name']}", f"/streams/{u['output']}")
            for u in units
            if u["output"] in there
        ),
        *((f"/streams/{each['stream']}", f"/events/{each['id']}") for each in requests),
        *((f"/streams/{each['stream']}", f"/queries/{each['name']}") for each in queries),
        *((f"/streams/{each['stream']}", f"/subscriptions/{each['id']}") for each in subscriptions),
    }
    for id in nodes:
        assert http.get(id).status_code == 200, id
    assert nodes["/streams/gps"]["text"] == "dyknow:latitude, dyknow:longitude, dyknow:speed"
    assert nodes["/events/event1"] == {
        "id": "/events/event1",
        "kind": "request",
        "name": "event1",
        "text": "dyknow:Fast(?o, 10)",
        "state": "running",
    }
    assert nodes["/queries/highest"]["text"] == "query"
    assert nodes["/subscriptions/subscription1"]["text"] == "gps sample every 1000"
    states = [nodes[f"/subscriptions/subscription{i}"]["state"] for i in (2, 3, 4)]
    assert states == ["running", "running", "waiting"]
    for unit in units:
        assert nodes[f"/units/{unit['name']}"]["text"] == unit["transformation"]


def test_around_a_name_are_its_steps_up_and_down_but_no_siblings(busy: Client) -> None:
    highest = busy.query("highest")["plan"]["units"][-1]["name"]
    assert near(busy, around="highest", depth=1) == {
        *("/streams/highest", "/queries/highest", "/subscriptions/subscription2"),
        f"/units/{highest}",
    }
    chain = near(busy, around="highest")
    assert chain == near(busy, around="highest", depth=2) == near(busy, around="highest", depth=99)
    assert chain - near(busy, around="highest", depth=1) == {"/streams/gps"}
    assert near(busy, around="alone") == {"/streams/alone"}
    assert near(busy, around="event1") < near(busy, around="gps")
    graph = busy.graph(around="highest", depth=1)
    ids = {node["id"] for node in graph["nodes"]}
    assert {edge["from"] for edge in graph["edges"]} | {
        edge["to"] for edge in graph["edges"]
    } <= ids
    assert len(graph["edges"]) == 3


def test_a_name_that_nothing_has(busy: Client, http: httpx.Client) -> None:
    answer = http.get("/graph", params={"around": "nothing"})
    assert answer.status_code == 404
    assert answer.json()["title"] == "unknown node"
    assert "GET /graph" in answer.json()["hint"]
    assert http.get("/graph?depth=2").status_code == 400
    assert http.get("/graph?around=gps&depth=0").status_code == 422


def test_the_etag_changes_with_what_runs_and_not_with_samples(
    busy: Client, http: httpx.Client, clock: Any
) -> None:
    first = http.get("/graph")
    etag = first.headers["etag"]
    assert etag.startswith('W/"')

    def again(path: str = "/graph") -> httpx.Response:
        return http.get(path, headers={"If-None-Match": f'"other", {etag}'})

    busy.publish("gps", [{"valid": clock.now, "car": "c1", "lat": 1, "lon": 1, "v": 2}])
    same = again()
    assert (same.status_code, same.content, same.headers["etag"]) == (304, b"", etag)
    assert again("/graph?around=gps").status_code == 200
    busy.cancel_event("event2")
    changed = again()
    assert changed.status_code == 200
    assert changed.headers["etag"] != etag
    etag = changed.headers["etag"]
    busy.end("alone")
    ended = again().json()["nodes"]
    assert [each["state"] for each in ended if each["name"] == "alone"] == ["ended"]


def test_names_are_quoted_in_ids(client: Client, http: httpx.Client) -> None:
    client.put_stream("gps", {"car": "string", "v": "float"})
    client.annotate("stream gps contains speed(Car) = v for every Car = car")
    client.register_query("monitor slow(?x in Car) = speed(?x) < 1000 [m.s-1]")
    graph = client.graph()
    for node in graph["nodes"]:
        assert node["id"].rpartition("/")[2] == quote(node["name"], safe="")
        assert http.get(node["id"]).status_code == 200
