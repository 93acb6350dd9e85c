"""A member that stands twice in a JSON body is refused, wherever JSON is taken."""

from __future__ import annotations

import httpx
import pytest
from fastapi import FastAPI
from fastapi.routing import APIRoute

from dyknow.engine.engine import Engine
from dyknow.service.app import RESOURCES, create_app
from dyknow.service.config.settings import Settings
from dyknow.service.http.negotiation import LONGEST_JSON, MOST_VALUES
from dyknow.service.http.problems import MOST_TOLD
from dyknow.service.routes.json_body import JsonRoute


def test_every_route_with_a_model_for_a_body_reads_it_so() -> None:
    routes = [
        route
        for resource in RESOURCES
        for route in resource.router.routes
        if isinstance(route, APIRoute) and route.body_field is not None
    ]
    assert len(routes) > 5
    for route in routes:
        assert isinstance(route, JsonRoute), route.path


def json_routes() -> list[tuple[str, str]]:
    app: FastAPI = create_app(Engine(epoch="e1"), Settings(), lambda: 0)
    return [
        (method.upper(), path.replace("{name}", "s").replace("{id}", "s"))
        for path, operations in app.openapi()["paths"].items()
        for method, operation in operations.items()
        if "application/json" in operation.get("requestBody", {}).get("content", {})
    ]


@pytest.mark.parametrize("padding", [0, 100_000])
def test_a_member_twice_is_refused(http: httpx.Client, padding: int) -> None:
    """At any depth, in short bodies and in long ones."""
    routes = json_routes()
    assert ("PUT", "/streams/s") in routes
    assert ("POST", "/events") in routes
    body = b'{"a": [{"x": 1, "na\\u006de": 1, "name": 2}]' + b" " * padding + b"}"
    for method, path in routes:
        headers = {"Content-Type": "application/json"}
        answer = http.request(method, path, content=body, headers=headers)
        assert answer.status_code == 400, (method, path, answer.text)
        problem = answer.json()
        assert problem["title"] == "bad JSON"
        assert "'name' is there twice" in problem["detail"]
        assert problem["hint"]


def test_the_last_one_does_not_count(http: httpx.Client) -> None:
    body = '{"fields": {"v": "float", "v": "string"}}'
    headers = {"Content-Type": "application/json"}
    assert http.put("/streams/s", content=body, headers=headers).status_code == 400
    assert http.get("/streams/s").status_code == 404
    once = '{"fields": {"v": "float"}}'
    assert http.put("/streams/s", content=once, headers=headers).status_code == 201


def test_what_is_no_json_is_told_as_before(http: httpx.Client) -> None:
    headers = {"Content-Type": "application/json"}
    for path in ("/match", "/events"):
        for body in (b"{", b"[" * 100_000, b"\xff", b'{"a": 1,}'):
            answer = http.post(path, content=body, headers=headers)
            assert answer.status_code == 400, (path, body[:10], answer.text)
            assert answer.json()["hint"]


@pytest.mark.parametrize("count", [MOST_VALUES + 1, 200_000])
def test_json_has_so_many_values(http: httpx.Client, count: int) -> None:
    """Members that nobody knows, each of which would be told; or a list that is one value's."""
    members = ",".join(f'"{number}":0' for number in range(count))
    numbers = ",".join(["0"] * count)
    headers = {"Content-Type": "application/json"}
    for method, path in json_routes():
        for body in (f"{{{members}}}", f'{{"fields": [{numbers}]}}'):
            answer = http.request(method, path, content=body, headers=headers)
            assert answer.status_code == 413, (method, path, answer.text[:200])
            assert answer.json()["hint"]


def test_json_has_so_many_bytes(http: httpx.Client) -> None:
    headers = {"Content-Type": "application/json"}
    body = '{"feature": "' + "a" * (LONGEST_JSON - 15) + '"}'
    assert len(body) == LONGEST_JSON
    assert http.post("/match", content=body, headers=headers).status_code != 413
    answer = http.post("/match", content=body + " ", headers=headers)
    assert answer.status_code == 413
    assert str(LONGEST_JSON) in answer.json()["detail"]


def test_an_answer_tells_some_of_what_does_not_fit(http: httpx.Client) -> None:
    members = ",".join(f'"{number}":0' for number in range(MOST_VALUES - 1))
    answer = http.post(
        "/match", content=f"{{{members}}}", headers={"Content-Type": "application/json"}
    )
    assert answer.status_code == 422
    assert len(answer.json()["errors"]) == MOST_TOLD
    assert answer.json()["detail"].endswith(" more")
