"""Explanations of verdicts over HTTP, by the client, and on the command line."""

from __future__ import annotations

from typing import Any

import httpx
import pytest

from dyknow.service.client.client import Client

MONITOR = """monitor calm(?x in UAV) = always [0s, 2s] speed(?x) < 100
with sample every 1s, max delay 0s, report violations"""
TABLE = """calm, ?x = u1, from 1970-01-01T00:00:01Z: false, decided at 1970-01-01T00:00:02Z

a  always [0s, 2s] speed(?x) < 100
b    speed(?x) < 100

state                 speed(?x) [km.h-1]  a      b
1970-01-01T00:00:01Z  50                  false  true
1970-01-01T00:00:02Z  120                 false  false
"""


@pytest.fixture
def calm(client: Client) -> Client:
    client.put_stream("s", {"id": "string", "v": "float"})
    client.annotate("stream s contains speed(UAV) = v [km.h-1] for every UAV = id")
    client.register_query(MONITOR)
    for second, speed in enumerate((50.0, 120.0, 60.0, 60.0), 1):
        time = second * 1_000_000_000
        client.publish("s", [{"valid": time, "available": time, "id": "u1", "v": speed}])
    return client


def test_it_is_a_table_for_people_and_json_for_programs(
    calm: Client, http: httpx.Client, dyknow: Any
) -> None:
    found = calm.why("calm", "1970-01-01T00:00:01Z", ["u1"])
    assert found["query"] == "calm"
    assert found["objects"] == {"x": "u1"}
    assert found["verdict"] == "false"
    assert found["decided"] == "1970-01-01T00:00:02Z"
    assert found["features"] == [
        {"text": "speed(?x) [km.h-1]", "depth": 0, "values": [50.0, 120.0]}
    ]
    assert [each["values"] for each in found["formulas"]] == [["false"] * 2, ["true", "false"]]
    query = {"start": "1000000000", "object": "u1"}
    table = http.get("/queries/calm/why", params=query, headers={"Accept": "text/plain"})
    assert table.text == TABLE
    shown = dyknow("query", "why", "calm", "1970-01-01T00:00:01Z", "--object", "u1")
    assert shown.stdout.rstrip() == TABLE.rstrip()


CALM = """REGISTER TEMPLATE dyknow:Calm(?x in UAV, ?limit) AS
always [0s, 2s] speed(?x) < ?limit [km.h-1]
with sample every 1s, max delay 0s, report violations"""
CLIMB = """REGISTER TEMPLATE dyknow:Faster(?limit) AS PATTERN SEQ(speed a, speed b)
WHERE [id] AND a.v < b.v AND b.v > ?limit WITHIN 10 seconds RETURN a.id AS id, b.v AS v"""
FAST = """REGISTER TEMPLATE dyknow:Quick(?o) COMPUTE EVERY 1s AS
PREFIX dyknow: <http://www.ida.liu.se/dyknow/>
CONSTRUCT { ?o dyknow:speed ?v } WHERE { ?o dyknow:speed ?v } WINDOW [RANGE 1s STEP 1s]"""


def asked(calm: Client, template: str, request: str) -> str:
    calm.register_template(template)
    found = calm.request_event(request, since="start")
    id: str = found["id"]
    return id


def test_a_requested_formula_is_explained_as_a_registered_one(
    calm: Client, http: httpx.Client, dyknow: Any
) -> None:
    id = asked(calm, CALM, "dyknow:Calm(?x, 100)")
    assert calm.request(id)["kind"] == "MONITOR"
    start = "1970-01-01T00:00:01Z"
    found, other = calm.event_why(id, start, ["u1"]), calm.why("calm", start, ["u1"])
    assert found == other | {"query": id, "formulas": found["formulas"]}
    assert [each["values"] for each in found["formulas"]] == [["false"] * 2, ["true", "false"]]
    query = {"start": "1000000000", "object": "u1"}
    table = http.get(f"/events/{id}/why", params=query, headers={"Accept": "text/plain"})
    shown = dyknow("query", "why", id, start, "--object", "u1").stdout.rstrip()
    assert shown == table.text.rstrip()
    assert f"{id}, ?x = u1, from {start}: false, decided at 1970-01-01T00:00:02Z" in shown


def test_a_requested_pattern_is_explained_and_shows_what_has_come(
    calm: Client, dyknow: Any
) -> None:
    id = asked(calm, CLIMB, "dyknow:Faster(70)")
    assert calm.request(id)["kind"] == "PATTERN"
    (match,) = calm.event_why(id, "1970-01-01T00:00:02Z")["matches"]
    assert [event["values"]["v"] for event in match["events"]] == [50.0, 120.0]
    came = [
        [event["values"] for event in each["events"]]
        for each in calm.event_partial_matches(id)["partial"]
    ]
    assert came
    assert all(len(each) == 1 for each in came)
    assert f"{id}, by " in dyknow("query", "partial", id).stdout


def test_what_has_no_explanation_of_a_request(calm: Client, http: httpx.Client) -> None:
    id, query = asked(calm, CALM, "dyknow:Calm(?x, 100)"), asked(calm, FAST, "dyknow:Quick(?o)")
    assert calm.request(query)["kind"] == "QUERY"

    def answer(path: str, **query: str) -> tuple[int, str]:
        found = http.get(path, params=query)
        return found.status_code, found.text

    status, text = answer(f"/events/{id}/why", start="5", object="u1")
    assert status == 404
    assert "no state at this time" in text
    assert "there are states at" in text
    assert answer(f"/events/{id}/why", start="1000000000")[0] == 400
    for path in (f"/events/{query}/why", f"/events/{query}/partial"):
        status, text = answer(path, start="5")
        assert status == 400
        assert f"GET /explain?id={query}" in text
    for path in ("/events/event99/why", "/events/event99/partial"):
        assert answer(path, start="5")[0] == 404
    calm.put_stream("s", {"id": "string", "v": "float"}, retention={"samples": 2})
    assert answer(f"/events/{id}/why", start="1000000000", object="u1")[0] == 410


def test_what_has_no_explanation(calm: Client, http: httpx.Client) -> None:
    def answer(name: str = "calm", **query: str) -> tuple[int, str]:
        found = http.get(f"/queries/{name}/why", params=query)
        return found.status_code, found.text

    status, text = answer(start="5", object="u1")
    assert status == 404
    assert "no state at this time" in text
    status, text = answer(start="1000000000")
    assert status == 400
    assert "?x" in text
    assert answer(start="soon", object="u1")[0] == 400
    assert answer(object="u1")[0] == 422
    assert answer("other", start="1000000000", object="u1")[0] == 404
