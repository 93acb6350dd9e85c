"""Subscriptions under a policy over HTTP: from now on or into the past, shared, given up."""

from __future__ import annotations

import httpx
from typer.testing import CliRunner

from dyknow.service.cli import app as commands
from dyknow.service.client.client import Client

LINES = {"Content-Type": "application/x-ndjson"}


def publish(http: httpx.Client, *rows: tuple[int, int, float]) -> None:
    body = "".join(
        f'{{"available": {a}000000, "valid": {v}000000, "value": {x}}}\n' for a, v, x in rows
    )
    answer = http.post("/streams/p/samples", content=body, headers=LINES)
    assert answer.status_code == 202, answer.text


def declare(http: httpx.Client) -> None:
    assert http.put("/streams/p", json={"fields": {"value": "float"}}).status_code == 201


def values(http: httpx.Client, stream: str) -> list[float]:
    found = http.get(f"/streams/{stream}/samples", headers={"Accept": "application/json"}).json()
    return [sample["value"] for sample in found]


def test_from_now_on_and_from_the_start(http: httpx.Client) -> None:
    declare(http)
    publish(http, (1, 10, 1.0), (2, 5, 2.0), (3, 20, 3.0))
    wanted = {"stream": "p", "policy": "monotone order"}
    past = http.post("/subscriptions", json=wanted | {"since": "start"})
    assert past.status_code == 201
    assert past.headers["Location"] == "/subscriptions/subscription1"
    now = http.post("/subscriptions", json=wanted).json()
    publish(http, (4, 15, 4.0), (5, 30, 5.0))
    assert values(http, past.json()["stream"]) == [1.0, 3.0, 5.0]
    assert values(http, now["stream"]) == [4.0, 5.0]
    view = http.get("/subscriptions/subscription1").json()
    assert view["policy"] == "monotone order"
    assert view["counters"]["dropped"] == {"order": 2}
    dropped = view["violations"]
    assert values(http, dropped) == [2.0, 4.0]
    # It cannot go while somebody reads it.
    assert http.delete("/streams/p").status_code == 409
    for id in ("subscription1", "subscription2"):
        assert http.delete(f"/subscriptions/{id}").status_code == 204
    assert http.get("/subscriptions").json() == []
    assert {one["name"] for one in http.get("/streams").json()} == {"status", "p"}


def test_equal_ones_share_a_stream(http: httpx.Client) -> None:
    declare(http)
    first = http.post("/subscriptions", json={"stream": "p", "policy": "max delay 1s"}).json()
    second = http.post("/subscriptions", json={"stream": "p", "policy": "max delay 1000"}).json()
    assert first["stream"] == second["stream"] != "p"
    http.delete(f"/subscriptions/{first['id']}")
    publish(http, (1, 1, 1.0))
    assert values(http, second["stream"]) == [1.0]
    plain = http.post("/subscriptions", json={"stream": "p"}).json()
    assert plain["stream"] == "p"


def test_what_is_wrong(http: httpx.Client) -> None:
    declare(http)
    answer = http.post("/subscriptions", json={"stream": "p", "policy": "sample evry 1s"})
    assert answer.status_code == 400
    assert (answer.json()["line"], answer.json()["column"]) == (1, 8)
    assert http.post("/subscriptions", json={"stream": "q"}).status_code == 404
    assert http.post("/subscriptions", json={}).status_code == 400
    assert http.get("/subscriptions/subscription9").status_code == 404
    assert http.get("/subscriptions/subscription9/events").status_code == 404
    assert http.delete("/subscriptions/subscription9").status_code == 404


def test_followed_by_client_and_command(http: httpx.Client, url: str, client: Client) -> None:
    declare(http)
    publish(http, (1, 10, 1.0), (2, 5, 2.0), (3, 20, 3.0))
    assert http.post("/streams/p/end").status_code == 204
    view = client.subscribe("p", "strict order", since="start")
    found = [event.values["value"] for event in client.events(view["stream"], since="start")
             if event.kind == "sample"]  # fmt: skip
    assert found == [1.0, 3.0]
    client.unsubscribe(view["id"])
    said = CliRunner().invoke(
        commands, ["follow", "p", "--policy", "strict order", "--since", "start", "--url", url]
    )
    assert said.exit_code == 0
    assert [line.split("value=")[1] for line in said.output.splitlines()[:2]] == ["1", "3"]
    assert client.subscriptions() == []
