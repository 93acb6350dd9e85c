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

state                 speed(?x)  a      b
1970-01-01T00:00:01Z  50         false  true
1970-01-01T00:00:02Z  120        false  false
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
    assert found["features"] == [{"text": "speed(?x)", "depth": 0, "values": [50.0, 120.0]}]
    assert [each["values"] for each in found["formulas"]] == [["false"] * 2, ["true", "false"]]
    query = {"start": "1000000000", "object": "u1"}
    table = http.get("/queries/calm/why", params=query, headers={"Accept": "text/plain"})
    assert table.text == TABLE
    shown = dyknow("query", "why", "calm", "1970-01-01T00:00:01Z", "--object", "u1")
    assert shown.stdout.rstrip() == TABLE.rstrip()


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
