"""What the head says of a body: compressed ones and other charsets are refused before they come."""

from __future__ import annotations

import gzip
import json
import socket
from typing import Any
from urllib.parse import urlsplit

import httpx
import pytest
from fastapi import FastAPI

from dyknow.engine.engine import Engine
from dyknow.service.app import create_app
from dyknow.service.config.settings import Settings
from dyknow.service.http.body_headers import checked_length
from dyknow.service.http.problems import Problem

LINES = "application/x-ndjson"
SAMPLE = b'{"valid": 1, "available": 1, "v": 1.5}\n'


@pytest.fixture
def samples(http: httpx.Client) -> str:
    http.put("/streams/s", json={"fields": {"v": "float"}}).raise_for_status()
    return "/streams/s/samples"


def accepted(http: httpx.Client) -> int:
    found: int = http.get("/streams/s").json()["counters"]["accepted"]
    return found


def routes_with_bodies() -> list[tuple[str, str]]:
    app: FastAPI = create_app(Engine(epoch="e1"), Settings(), lambda: 0)
    return [
        (method.upper(), path.replace("{name}", "s").replace("{id}", "s"))
        for path, operations in app.openapi()["paths"].items()
        for method, operation in operations.items()
        if "requestBody" in operation
    ]


def test_every_route_refuses_bodies_that_it_would_misread(http: httpx.Client) -> None:
    """Whatever it takes: a compressed body, and one in another charset."""
    routes = routes_with_bodies()
    assert len(routes) > 12
    for method, path in routes:
        for headers in (
            {"Content-Encoding": "gzip"},
            {"Content-Encoding": "identity, br"},
            {"Content-Type": "text/plain; charset=utf-16"},
            {"Content-Type": 'application/json; x="a;b" ; Charset="latin-1"'},
        ):
            answer = http.request(method, path, content=gzip.compress(b"{}"), headers=headers)
            assert answer.status_code == 415, (method, path, headers, answer.text)
            assert answer.json()["hint"]


@pytest.mark.parametrize(
    "coding",
    ["Content-Encoding: gzip\r\nContent-Length: 1000000", "Transfer-Encoding: gzip, chunked"],
)
def test_it_is_refused_before_it_is_there(http: httpx.Client, samples: str, coding: str) -> None:
    parts = urlsplit(str(http.base_url))
    with socket.create_connection((parts.hostname, parts.port), timeout=120) as connection:
        connection.sendall(
            f"POST {samples} HTTP/1.1\r\nHost: localhost\r\n{coding}\r\n"
            "Expect: 100-continue\r\n\r\n".encode()
        )
        assert connection.recv(4096).startswith(b"HTTP/1.1 415 ")


@pytest.mark.parametrize(
    "headers",
    [
        {"Content-Encoding": "identity"},
        {"Content-Encoding": ""},
        {"Content-Type": f"{LINES}; charset=UTF-8"},
        {"Content-Type": f'{LINES};charset="utf8"'},
        {"Content-Type": f'{LINES};x="; charset=utf-16"'},
    ],
)
def test_what_is_said_in_other_words_is_taken(
    http: httpx.Client, samples: str, headers: dict[str, str]
) -> None:
    assert http.post(samples, content=SAMPLE, headers=headers).status_code == 202
    assert accepted(http) == 1


def test_a_body_is_of_one_kind(http: httpx.Client, samples: str) -> None:
    twice = [("Content-Type", LINES), ("Content-Type", "text/html")]
    answer = http.post(samples, content=SAMPLE, headers=twice)
    assert answer.status_code == 400
    assert answer.json()["title"] == "bad Content-Type header"
    assert answer.json()["hint"]
    assert accepted(http) == 0


def test_a_request_without_a_body_says_what_it_likes() -> None:
    said = [(b"content-encoding", b"gzip"), (b"content-type", b"a/b; charset=latin-1")]
    assert checked_length(said) is None
    assert checked_length([*said, (b"content-length", b"0")]) == 0
    with pytest.raises(Problem):
        checked_length([*said, (b"transfer-encoding", b"chunked")])


def test_errors_have_hints(http: httpx.Client, samples: str) -> None:
    """Of answers that had none."""
    text: dict[str, Any] = {"headers": {"Content-Type": "text/plain"}}
    turtle: dict[str, Any] = {"headers": {"Content-Type": "text/turtle"}}
    for answer in (
        http.get("/templates/x"),
        http.get("/sparql", params={"query": "SELECT * { ?s ?p ?o } LIMIT x"}),
        http.get(f"{samples}?limit=x"),
        http.get(f"{samples}?from=2021-10-07T19:12:53%2B99:00"),
        http.get(f"{samples}?from={'9' * 5000}"),
        http.get(samples, headers={"Accept": ";;"}),
        http.post("/session", json={"token": "x"}),
        http.post("/ontologies?name=x:y", content="x", **turtle),
        http.post("/kpl", content="source float pos x", **text),
        http.post("/subscriptions", content="{"),
        http.put("/streams/t", json={"fields": []}),
        http.post(samples, content=b'{"valid": 1, "v": 1e999}'),
        http.post(samples, content=b'{"valid": null, "v": 1}'),
        http.post(samples, content=b'{"valid": 99999999999999999999, "v": 1}'),
    ):
        assert answer.status_code >= 400, answer.request.url
        problem = json.loads(answer.content)
        assert problem.get("hint"), problem
        assert problem["instance"].endswith(answer.headers["X-Request-Id"])
        for word in ("isoformat", "timedelta", "None", "expected", "$["):
            assert word not in problem["detail"], problem


def test_a_refusal_at_the_gate_has_its_request(http: httpx.Client) -> None:
    answer = http.get("/streams", headers={"Host": "evil.example", "X-Request-Id": "mine"})
    assert answer.status_code == 421
    assert answer.json()["instance"] == "urn:dyknow:request:mine"
