"""Recorded cars over HTTP: their stream and templates, their samples, and the console's pages."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import httpx

TEXT = {"Content-Type": "text/plain"}
LINES = {"Content-Type": "application/x-ndjson"}
SECOND = 1_000_000_000
BEGIN = 1_777_885_200 * SECOND
"""2026-05-04T09:00:00Z"""
SSL = "stream cars contains speed(Car) = v [km.h-1] for every Car = id"
CALM = """REGISTER TEMPLATE dyknow:Calm(?x in Car, ?limit) AS
always [0s, 2s] speed(?x) < ?limit [km.h-1]
with sample every 1s, max delay 0s, report violations"""
FASTER = """REGISTER TEMPLATE dyknow:Faster(?limit) AS PATTERN SEQ(speed a, speed b)
WHERE [id] AND b.v > ?limit AND a.v < 60 WITHIN 1 second RETURN a.id AS id, b.v AS reached"""
SPEEDS = {"c1": (50.0, 55.0, 120.0, 70.0, 70.0), "c2": (80.0, 80.0, 80.0, 80.0, 80.0)}


def publish(http: httpx.Client, stream: str, *rows: dict[str, object]) -> None:
    body = "\n".join(map(json.dumps, rows))
    answer = http.post(f"/streams/{stream}/samples", content=body, headers=LINES)
    assert answer.status_code == 202, answer.text


def declare(http: httpx.Client) -> None:
    """The stream of cars, and the templates."""
    assert http.put("/streams/cars", json={"fields": {"id": "string", "v": "float"}}).is_success
    for path, text in (("annotations", SSL), ("templates", CALM), ("templates", FASTER)):
        answer = http.post(f"/{path}", content=text, headers=TEXT)
        assert answer.status_code == 201, answer.text


def play(http: httpx.Client) -> None:
    """Five seconds of two cars, and the end of the stream."""
    for second in range(5):
        at = BEGIN + second * SECOND
        for name, speeds in SPEEDS.items():
            publish(http, "cars", {"valid": at, "available": at, "id": name, "v": speeds[second]})
    assert http.post("/streams/cars/end").is_success


def opened(open_page: Callable[..., Any], http: httpx.Client, name: str, **how: str | int) -> Any:
    """A page of the console, as the fixture ``open_page`` opens it."""
    return open_page(f"{str(http.base_url).rstrip('/')}/#{name}", **how)
