"""What has ended says so: requests, queries, subscriptions and streams, over HTTP and in tables."""

from __future__ import annotations

from typing import Any

import pytest

from dyknow.service.client.client import Client

CALM = """REGISTER TEMPLATE dyknow:Calm(?x in UAV, ?limit = 100) AS
speed(?x) < ?limit [km.h-1] with report violations"""
MONITOR = "monitor slow(?x in UAV) = speed(?x) < 50 [km.h-1]"
CAR = {"id": "u1", "v": 60.0}


@pytest.fixture
def running(client: Client) -> Client:
    client.put_stream("s", {"id": "string", "v": "float"})
    client.annotate("stream s contains speed(UAV) = v [km.h-1] for every UAV = id")
    client.register_template(CALM)
    client.request_event("dyknow:Calm(?x)")
    client.register_query(MONITOR)
    client.subscribe("s")
    client.subscribe("s", policy="sample every 1s")
    for second in range(1, 11):
        time = second * 1_000_000_000
        client.publish("s", [{"valid": time, "available": time, **CAR}])
    return client


def states(client: Client) -> list[str]:
    asked = (client.requests(), client.queries(), client.subscriptions())
    return [each["state"] for one in asked for each in one]


def test_requests_say_that_their_streams_have_ended(running: Client, dyknow: Any) -> None:
    assert set(states(running)) == {"running"}
    assert running.stream("s")["rate"] == 1
    assert "(ended)" not in dyknow("events").stdout
    running.end("s")
    assert set(states(running)) == {"ended"}
    assert running.request("event1")["state"] == "ended"
    assert {each["rate"] for each in running.streams() if each["name"] != "status"} == {0}
    stream = running.request("event1")["stream"]
    assert f"{stream} (ended)" in dyknow("events").stdout
    row = next(line for line in dyknow("query", "list").stdout.splitlines() if "slow" in line)
    assert " ended " in row
    row = next(line for line in dyknow("streams").stdout.splitlines() if line.startswith(" s "))
    assert row.split()[3] == "0"
    nodes = {each["name"]: each["state"] for each in running.graph()["nodes"]}
    assert nodes["event1"] == nodes["slow"] == nodes["s"] == "ended"


def test_a_stream_that_goes_on_runs_again(running: Client) -> None:
    running.end("s")
    time = 11_000_000_000
    running.publish("s", [{"valid": time, "available": time, **CAR}])
    assert running.stream("s")["rate"] > 0
    assert "running" in states(running)
