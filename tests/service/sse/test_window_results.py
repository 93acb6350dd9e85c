"""Results of queries over SSE: a message a window, with the terms of the query."""

from __future__ import annotations

import json
from typing import Any

import httpx
import pytest
from registering import register

from dyknow.service.client.client import Client, ServiceError
from dyknow.service.config.settings import Settings

DYKNOW = "http://www.ida.liu.se/dyknow/"
SSL = "stream s5 contains speed(UAV) = spd [km.h-1] for every UAV = id"
STREAM = f"FROM STREAM <{DYKNOW}s5.trdf> [RANGE 2s STEP 1s]"
MEANS = f"""REGISTER QUERY means AS
SELECT ?o (AVG(?v) AS ?mean) {STREAM} WHERE {{ ?o dyknow:speed ?v }} GROUP BY ?o ORDER BY ?o"""
FAST = f"REGISTER STREAM fast AS CONSTRUCT {{ ?o dyknow:speed ?v }} {STREAM} WHERE {{ ?o dyknow:speed ?v }}"  # noqa: E501
ANY = f"REGISTER QUERY any AS ASK {STREAM} WHERE {{ ?o dyknow:speed ?v FILTER (?v > 100) }}"
SECOND = 1_000_000_000


@pytest.fixture
def flying(http: httpx.Client) -> httpx.Client:
    assert http.post("/annotations", content=SSL).status_code == 201
    return http


def play(http: httpx.Client, *seconds: int, end: bool = True) -> None:
    rows = [
        {"valid": s * SECOND, "available": s * SECOND, "id": name, "spd": 50.0 * s}
        for s in seconds
        for name in ("uav1", "uav2")
    ]
    body = "\n".join(map(json.dumps, rows))
    headers = {"Content-Type": "application/x-ndjson"}
    assert http.post("/streams/s5/samples", content=body, headers=headers).status_code == 202
    if end:
        http.post("/streams/s5/end")


def told(client: Client, name: str, since: str = "start") -> list[Any]:
    return list(client.query_events(name, since=since))


def test_each_window_is_a_message_with_the_terms_of_the_query(
    flying: httpx.Client, client: Client
) -> None:
    register(flying, MEANS)
    play(flying, 1, 2)
    *windows, end = told(client, "means")
    assert (end.kind, end.data["reason"]) == ("end", "ended")
    assert [each.kind for each in windows] == ["result"] * 3
    assert [each.data["window_end"][17:] for each in windows] == ["01Z", "02Z", "03Z"]
    result = windows[1].data
    assert result["head"] == {"vars": ["o", "mean"]}
    assert result["results"]["bindings"][0] == {
        "o": {"type": "uri", "value": DYKNOW + "uav1"},
        "mean": {
            "type": "literal",
            "value": "75",
            "datatype": "http://www.w3.org/2001/XMLSchema#double",
        },
    }
    # As the results of one window over HTTP.
    latest = flying.get("/queries/means/results", headers={"Accept": "application/json"}).json()
    last = windows[-1].data
    assert {"head": last["head"], "results": last["results"]} == latest


def test_a_client_resumes_after_a_window(flying: httpx.Client, client: Client) -> None:
    register(flying, MEANS)
    play(flying, 1, 2)
    windows = told(client, "means")
    for i, window in enumerate(windows[:-1]):
        again = told(client, "means", window.id)
        assert [each.data for each in again] == [each.data for each in windows[i + 1 :]]


def test_graphs_and_answers(flying: httpx.Client, client: Client) -> None:
    register(flying, FAST)
    register(flying, ANY)
    play(flying, 2, 3)
    graph = told(client, "fast")[0].data["graph"]
    assert f"<{DYKNOW}uav1> <{DYKNOW}speed>" in graph
    assert graph.count(" .") == 2
    answers = [each.data["boolean"] for each in told(client, "any")[:-1]]
    assert True in answers


def test_a_window_that_is_not_kept_is_a_gap(flying: httpx.Client, client: Client) -> None:
    register(flying, MEANS)
    play(flying, *range(1, 1_200))
    first, *_, last, _ = told(client, "means")
    assert first.kind == "gap"
    assert first.data["reason"] == "this window is no longer kept"
    assert last.kind == "result"


def test_what_has_no_windows_is_refused(flying: httpx.Client, client: Client) -> None:
    flying.post(
        "/queries", content="monitor calm(?x in UAV) = always [0s, 1s] speed(?x) < 100"
    ).raise_for_status()
    with pytest.raises(ServiceError, match="has no windows"):
        told(client, "calm")
    with pytest.raises(ServiceError, match="no query called"):
        told(client, "nothing")


class TestLarge:
    @pytest.fixture
    def settings(self, settings: Settings) -> Settings:
        return settings.model_copy(update={"sparql_bytes": 50})

    def test_a_window_that_is_too_large_is_a_gap(
        self, flying: httpx.Client, client: Client
    ) -> None:
        register(flying, MEANS)
        play(flying, 1)
        first = told(client, "means")[0]
        assert (first.kind, "more than 50 bytes" in first.data["reason"]) == ("gap", True)
