"""Bodies that are nearly right: numbers without end, no numbers, half characters, depth. Each is a
4xx that says where; none is a failure within, and none takes effect."""

from __future__ import annotations

import json
from typing import Any

import httpx
import pytest

FIELDS = {"fields": {"id": "string", "v": "float"}}
ANNOTATION = "stream s contains speed(UAV) = v for every UAV = id"
PORTS = '[{"feature": "dyknow:latitude"}, {"feature": "dyknow:longitude"}]'
OF_SPEED = '"contents": [{"feature": "dyknow:speed", "field": "v"'
BODIES = {
    ("PUT", "/streams/a"): [
        '{"fields": {"v": "float"}, "lateness": %s}',
        '{"fields": {"v": "float"}, "retention": %s}',
        '{"fields": {"v": "float"}, "idle": %s}',
        '{"fields": %s}',
    ],
    ("PUT", "/streams/s/quality"): ['{"quality": %s}'],
    ("POST", "/annotations"): [
        '{"stream": %s, ' + OF_SPEED + "}]}",
        '{"stream": "s", ' + OF_SPEED + ', "unit": %s}]}',
        '{"stream": "s", ' + OF_SPEED + ', "of": [%s]}]}',
    ],
    ("POST", "/events"): ['{"event": %s, "arguments": []}', '{"event": "E", "arguments": [%s]}'],
    ("POST", "/subscriptions"): [
        '{"stream": %s}',
        '{"stream": "s", "policy": %s}',
        '{"feature": "dyknow:speed", "min_quality": %s}',
        '{"feature": "dyknow:speed", "hold_off": %s}',
        '{"feature": "dyknow:speed", "objects": [%s]}',
    ],
    ("POST", "/match"): ['{"feature": %s}', '{"feature": "dyknow:speed", "objects": [%s]}'],
    ("POST", "/transformations"): [
        '{"annotation": %s}',
        f'{{"name": "t", "inputs": {PORTS}, "output": {{"feature": "dyknow:speed"}}, '
        '"implementation": "coordinatesToSpeed", "cost": %s}',
    ],
    ("PATCH", "/transformations/coordinatesToSpeed"): ['{"cost": %s}'],
}
VALUES = {
    "NaN": "NaN",
    "Infinity": "Infinity",
    "minus Infinity": "-Infinity",
    "beyond floats": "1e999",
    "deep list": "[" * 50_000 + "]" * 50_000,
    "deep object": '{"a":' * 50_000 + "1" + "}" * 50_000,
    "half a character, escaped": '"\\ud800"',
    "the other half": '"a\\udc00"',
    "a control character": '"a\x01"',
    "a number of 5,000 digits": "9" * 5000,
    "beyond 64 bits": "-9223372036854775809",
}
CASES = [(*route, form) for route, forms in BODIES.items() for form in forms]


def state(http: httpx.Client) -> list[Any]:
    paths = ("/streams", "/annotations", "/subscriptions", "/events", "/transformations")
    found = [http.get(path).json() for path in paths]
    return [
        [{k: v for k, v in one.items() if k in ("name", "source", "cost", "id")} for one in each]
        for each in found
    ]


@pytest.fixture
def served(http: httpx.Client) -> httpx.Client:
    http.put("/streams/s", json=FIELDS).raise_for_status()
    text = {"Content-Type": "text/plain"}
    http.post("/annotations", content=ANNOTATION, headers=text).raise_for_status()
    return http


@pytest.mark.parametrize(("method", "path", "form"), CASES, ids=lambda text: text[:60])
def test_what_json_cannot_mean(served: httpx.Client, method: str, path: str, form: str) -> None:
    before = state(served)
    for name, value in VALUES.items():
        body = (form % value).encode()
        kind = {"Content-Type": "application/json"}
        answer = served.request(method, path, content=body, headers=kind)
        assert 400 <= answer.status_code < 500, (name, answer.status_code, answer.text[:300])
        problem = answer.json()
        assert problem["status"] == answer.status_code, name
        assert problem["detail"], name
        if answer.status_code == 422:  # where in the body
            assert "body." in problem["detail"], (name, problem)
    assert state(served) == before


@pytest.mark.parametrize("field", ["valid", "id", "v"])
def test_samples_say_in_which_line(served: httpx.Client, field: str) -> None:
    good = {"valid": 1, "available": 1, "id": "a", "v": 1.0}
    for name, value in VALUES.items():
        bad = json.dumps({**good, field: 0}).replace(f'"{field}": 0', f'"{field}": {value}')
        body = f"{json.dumps(good)}\n{bad}\n".encode()
        kind = {"Content-Type": "application/x-ndjson"}
        answer = served.post("/streams/s/samples", content=body, headers=kind)
        is_number = field == "v" and name in ("a number of 5,000 digits", "beyond 64 bits")
        if is_number and answer.status_code == 202:
            continue  # a float takes it, as near as floats come
        assert answer.status_code == 400, (name, answer.status_code, answer.text[:300])
        assert answer.json()["line"] == 2, name
        assert served.get("/streams/s").json()["counters"]["accepted"] == 0


@pytest.mark.parametrize(
    ("path", "kind"),
    [
        ("/annotations", "text/plain"),
        ("/kpl", "text/plain"),
        ("/templates", "text/plain"),
        ("/queries", "text/plain"),
        ("/events", "text/plain"),
        ("/specifications", "application/xml"),
        ("/ontologies", "text/turtle"),
        ("/transformations", "text/turtle"),
        ("/sparql", "application/sparql-query"),
    ],
)
def test_bytes_that_are_no_text(served: httpx.Client, path: str, kind: str) -> None:
    for body in (
        b"\xed\xa0\x80",  # half a character
        b"stream \xe2\x82",  # cut off
        b"\xc0\x80",  # longer than it may be
        b"stream \x00",
        b"\xff\xfe",
        "stream s".encode("utf-16"),
        b"stream\xe2\x80\xa8s",  # a line separator
    ):
        answer = served.post(path, content=body, headers={"Content-Type": kind})
        assert answer.status_code == 400, (body, answer.status_code, answer.text[:300])
        assert answer.json()["detail"]
