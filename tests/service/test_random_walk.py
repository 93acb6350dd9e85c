"""Long random lives over HTTP: what one request makes, others use, change and remove. Whatever the
order, nothing fails in the service, and every status is one that its schema says."""

from __future__ import annotations

import json
from random import Random
from typing import Any

import httpx
import pytest
from commanding import ANNOTATIONS, FAST, KPL, POLICIES, QUERIES, TURN

STEPS = 400
NAMES = ("s", "t", "s_late", "event1", "subscription1", "q0", "nothing", "%2e%2e", "a b", "ü", "k")
HOSTILE = (b"", b"{", b"[]", b"null", b"\xff\xfe", b'{"a": 1}', b"REGISTER", b"0" * 2000)
TEXT, JSON, LINES = "text/plain", "application/json", "application/x-ndjson"
MADE = ("/streams", "/templates", "/events", "/queries", "/subscriptions", "/transformations")
SPECIFICATION = """<specification xmlns="http://www.dyknow.eu/ontology#Specification">
<insert><cu type="coordinatesToSpeed" name="c"/></insert></specification>"""


class Walk:
    """Requests drawn at random, of which some make sense."""

    def __init__(self, http: httpx.Client, pick: Random) -> None:
        self.schema: dict[str, Any] = http.get("/openapi.json").json()
        self.statuses: dict[str, set[int]] = {}
        self._http = http
        self._pick = pick
        self._known: dict[str, list[str]] = {path: [] for path in MADE}
        self._time = 0
        self._operations = [
            (method, path)
            for path, operations in self.schema["paths"].items()
            for method in operations
            # Answers without an end are what test_sse.py is about.
            if not (method == "get" and (path.endswith("/events") and path != "/events"))
            and path not in ("/follow", "/streams/{name}/samples/live")
        ]

    def step(self) -> None:
        pick = self._pick
        method, path = pick.choice(self._operations)
        address = path
        for name in ("{name}", "{id}"):
            family = next((f for f in MADE if path.startswith(f)), "/streams")
            known = self._known[family]
            chosen = pick.choice(known if known and pick.random() < 0.7 else NAMES)
            address = address.replace(name, chosen)
        kind, body = self._body(method, path)
        parameters = self._parameters(path)
        answer = self._http.request(
            method,
            address,
            content=body,
            params=parameters,
            headers={"Content-Type": kind} if body is not None else {},
        )
        operation = self.schema["paths"][path][method]
        told = f"{method} {address} {parameters} {body!r}: {answer.status_code} {answer.text[:500]}"
        assert answer.status_code < 500 or answer.status_code in (501, 503), told
        assert str(answer.status_code) in operation["responses"], told
        self.statuses.setdefault(f"{method} {path}", set()).add(answer.status_code)
        family = path.split("/{")[0]
        if answer.status_code in (200, 201) and family in MADE and method in ("post", "put"):
            found = answer.json()
            if isinstance(found, dict):
                self._known[family].append(str(found.get("name", found.get("id"))))

    def _body(self, method: str, path: str) -> tuple[str, bytes | None]:
        pick = self._pick
        if method in ("get", "delete"):
            return "", None
        if pick.random() < 0.15:
            return pick.choice((TEXT, JSON, LINES, "a/b")), pick.choice(HOSTILE)
        kind, text = self._sensible(path)
        return kind, text if isinstance(text, bytes) else text.encode()

    def _sensible(self, path: str) -> tuple[str, Any]:
        pick = self._pick
        match path:
            case "/templates" | "/templates/{name}":
                return TEXT, pick.choice((FAST, TURN))
            case "/events":
                return TEXT, f"dyknow:FastEvent(?o, dyknow:UAV, {pick.randrange(4)})"
            case "/queries":
                number = pick.randrange(len(QUERIES))
                return TEXT, f"REGISTER QUERY q{number} AS {QUERIES[number]}"
            case "/streams/{name}":
                late = pick.choice(("0s", "2s"))
                fields = {"id": "string", "v": "float", "h": "float"}
                return JSON, json.dumps({"fields": fields, "lateness": late})
            case "/streams/{name}/samples":
                return LINES, self._samples()
            case "/streams/{name}/quality":
                return JSON, json.dumps({"quality": pick.random()})
            case "/annotations":
                return TEXT, pick.choice(ANNOTATIONS)
            case "/kpl":
                return TEXT, pick.choice(KPL)
            case "/subscriptions":
                wanted = {"stream": pick.choice(("s", "t")), "policy": pick.choice(POLICIES)}
                feature = {"feature": "dyknow:speed", "sort": "dyknow:UAV"}
                return JSON, json.dumps(pick.choice((wanted, feature)))
            case "/transformations" | "/transformations/{name}":
                ssl = "compunit knots transforms speed(UAV) = v to speed(UAV) = w"
                return JSON, json.dumps({"annotation": ssl, "cost": pick.random()})
            case "/ontologies":
                return "text/turtle", "@prefix : <http://e.org/> . :u a :T ."
            case "/specifications":
                return "application/xml", SPECIFICATION
            case "/match":
                return JSON, json.dumps({"feature": "dyknow:speed", "sort": "dyknow:UAV"})
            case "/sparql":
                return "application/sparql-query", "ASK { ?s ?p ?o }"
            case _:
                return JSON, b"{}"

    def _samples(self) -> bytes:
        rows = []
        for _ in range(self._pick.randrange(1, 6)):
            self._time += self._pick.choice((10**8, 10**9))
            row = {"id": "uav1", "v": float(self._pick.randrange(6)), "h": None}
            rows.append(json.dumps({"valid": self._time, "available": self._time, **row}))
        return "\n".join(rows).encode()

    def _parameters(self, path: str) -> dict[str, str]:
        choices = {
            "/explain": {"query": QUERIES[0], "id": "event1", "event": "dyknow:FastEvent(?o)"},
            "/sparql": {"query": "SELECT ?s WHERE { ?s ?p ?o } LIMIT 3"},
            "/streams/{name}/samples": {"limit": "3", "at": "5", "from": "x"},
            "/ontologies": {"name": "http://e.org/walk"},
        }.get(path, {})
        return {key: value for key, value in choices.items() if self._pick.random() < 0.7}


@pytest.mark.parametrize("seed", range(4))
def test_whatever_the_order(http: httpx.Client, seed: int) -> None:
    walk = Walk(http, Random(seed))
    for path, text in (("/streams/s", JSON), ("/streams/t", JSON)):
        fields = {"fields": {"id": "string", "v": "float", "h": "float"}, "lateness": "2s"}
        http.put(path, content=json.dumps(fields), headers={"Content-Type": text})
    for _ in range(STEPS):
        walk.step()
    done = {name for name, found in walk.statuses.items() if found & {200, 201, 202, 204}}
    assert len(done) > 25
