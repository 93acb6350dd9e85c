"""Bad input gets its error, in the form of RFC 9457, and changes nothing."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from typing import Any

import httpx
import pytest
from asking import asking

from dyknow.engine.engine import Engine
from dyknow.service.app import create_app
from dyknow.service.client.client import ServiceError
from dyknow.service.config.settings import Settings
from dyknow.streams.time import Clock

TEMPLATE = """REGISTER TEMPLATE dyknow:HighSpeedEvent(?o, ?type, ?threshold) COMPUTE EVERY 1s AS
PREFIX dyknow: <http://www.ida.liu.se/dyknow/>
CONSTRUCT {?o dyknow:speed ?avgSpeed}
WHERE { ?o a ?type . ?o dyknow:speed ?spd . }
AGGREGATE {(?avgSpeed, AVG, {?spd}) FILTER (?avgSpeed > ?threshold)}
WINDOW [RANGE 5s STEP 1s]"""
SSL = "stream s5 contains speed(UAV) = spd [km.h-1] for every UAV = id"
TEXT = {"Content-Type": "text/plain"}
LINES = {"Content-Type": "application/x-ndjson"}
GOOD = '{"valid": 1, "id": "uav1", "spd": 1.5}'


@pytest.fixture(scope="module")
def http() -> Iterator[httpx.Client]:
    """One service for the module: what is refused changes nothing, so that tests do not meet."""
    settings = Settings(port=0, body_limit=1 << 20)
    with _service(Engine(epoch="e1"), settings, lambda: 10**18) as client:
        client.put("/streams/s5", json={"fields": {"id": "string", "spd": "float"}})
        client.post("/annotations", content=SSL, headers=TEXT).raise_for_status()
        client.post("/templates", content=TEMPLATE, headers=TEXT).raise_for_status()
        yield client


def _service(engine: Engine, settings: Settings, clock: Clock) -> Any:
    from dyknow.service.server import running

    class Service:
        def __enter__(self) -> httpx.Client:
            self._running = running(create_app(engine, settings, clock), settings)
            url = self._running.__enter__()
            self._http = asking(url)
            return self._http

        def __exit__(self, *error: object) -> None:
            self._http.close()
            self._running.__exit__(None, None, None)

    return Service()


def state(http: httpx.Client) -> dict[str, Any]:
    """Everything that a refused request must leave as it is."""
    streams = http.get("/streams").json()
    return {
        "streams": [
            (s["name"], s["fields"], s["counters"], s["annotation"], s["subscribers"])
            for s in streams
        ],
        "templates": http.get("/templates").json(),
        "events": http.get("/events").json(),
        "annotations": http.get("/annotations").json(),
    }


def problem(answer: httpx.Response, status: int) -> dict[str, Any]:
    assert answer.status_code == status, answer.text
    assert answer.headers["content-type"] == "application/problem+json"
    found: dict[str, Any] = answer.json()
    assert found["status"] == status
    assert found["type"].startswith("urn:dyknow:problem:")
    assert found["title"]
    assert found["detail"]
    return found


@pytest.mark.parametrize(
    ("path", "text", "line"),
    [
        ("/templates", TEMPLATE.replace("HighSpeedEvent", "Other").replace("WHERE {", "WHERE"), 4),
        ("/templates", "REGISTER NONSENSE", 1),
        ("/annotations", "stream s9 contains\n  speed(UAV) == spd", 2),
        ("/events", "dyknow:HighSpeedEvent(?o, dyknow:UAV,", 1),
    ],
    ids=["template body", "template head", "SSL", "request"],
)
def test_syntax_errors_have_line_column_and_excerpt(
    http: httpx.Client, path: str, text: str, line: int
) -> None:
    before = state(http)
    found = problem(http.post(path, content=text, headers=TEXT), 400)
    assert found["title"] == "syntax error"
    assert found["line"] == line
    assert found["column"] >= 1
    assert "^" in found["excerpt"]
    assert state(http) == before


@pytest.mark.parametrize(
    ("title", "detail", "told"),
    [
        ("unknown query", "there is no query called 'q'", "there is no query called 'q'"),
        ("no such route", "no route has this address", "no route has this address"),
        ("conflict", "stream 's5' has no field 'x'", "conflict: stream 's5' has no field 'x'"),
    ],
)
def test_a_client_prints_no_title_that_the_detail_repeats(
    title: str, detail: str, told: str
) -> None:
    assert str(ServiceError(404, title, detail)) == told


def test_a_detail_and_its_hint_say_different_things(http: httpx.Client) -> None:
    bad_time = {"valid": "abc", "id": "a", "spd": 1.0}
    asked = http.get("/streams/s5/samples", params={"at": "abc"})
    for answer in (
        http.post("/streams/s5/samples", content=json.dumps(bad_time), headers=LINES),
        asked,
    ):
        found = problem(answer, 400)
        assert f"{found['detail']} {found['hint']}".count("ISO-8601") == 1
    absent = problem(http.get("/nope"), 404)
    assert absent["detail"].lower() not in ("not found", absent["title"])
    length = http.put("/streams/x", json={"fields": {"id": "string"}, "lateness": "abc"})
    assert "Value error" not in problem(length, 422)["detail"]


def test_syntax_error_in_sparql(http: httpx.Client) -> None:
    query = "SELECT ?s\nWHERE { ?s ?p }"
    found = problem(http.get("/sparql", params={"query": query}), 400)
    assert found["line"] == 2


@pytest.mark.parametrize(
    "query",
    [
        "SELECT * { SERVICE <http://example.org/> { ?s ?p ?o } }",
        "LOAD <http://example.org/>",
        "INSERT DATA { <urn:a> <urn:b> <urn:c> }",
        "DROP ALL",
    ],
)
def test_sparql_that_is_refused(http: httpx.Client, query: str) -> None:
    before = state(http)
    headers = {"Content-Type": "application/sparql-query"}
    found = problem(http.post("/sparql", content=query, headers=headers), 400)
    assert "hint" in found
    assert state(http) == before


@pytest.mark.parametrize(
    "body",
    [
        {"event": "dyknow:NoSuchEvent", "arguments": []},
        {"event": "http://example.org/x", "arguments": ["1"]},
    ],
)
def test_unknown_event(http: httpx.Client, body: dict[str, Any]) -> None:
    before = state(http)
    assert problem(http.post("/events", json=body), 404)["title"] == "unknown event"
    assert state(http) == before


@pytest.mark.parametrize(
    "arguments",
    [
        ["?o", "dyknow:UAV"],
        ["?o", "dyknow:UAV", "100", "1"],
        ["?o", "dyknow:UAV", '"fast"'],
        ["?o", "100", "100"],
        ["?o", "dyknow:speed", "100"],
        ["?o", "dyknow:UAV", "nonsense("],
    ],
    ids=["too few", "too many", "text for a number", "number for a sort", "no sort", "no term"],
)
def test_wrong_arguments(http: httpx.Client, arguments: list[str]) -> None:
    before = state(http)
    body = {"event": "dyknow:HighSpeedEvent", "arguments": arguments}
    problem(http.post("/events", json=body), 400)
    assert state(http) == before


def test_no_plan_says_what_is_missing(http: httpx.Client) -> None:
    text = TEMPLATE.replace("HighSpeedEvent", "HotEvent").replace("dyknow:speed", "dyknow:altitude")
    assert http.post("/templates", content=text, headers=TEXT).status_code == 201
    before = state(http)
    body = {"event": "dyknow:HotEvent", "arguments": ["?o", "dyknow:UAV", "30"]}
    found = problem(http.post("/events", json=body), 422)
    assert any("altitude" in missing for missing in found["missing"])
    after = state(http)
    assert (after["streams"], after["events"]) == (before["streams"], before["events"])
    assert http.delete("/templates/HotEvent").status_code == 204


@pytest.mark.parametrize(
    "ssl",
    [
        "stream s9 contains speed(UAV) = spd [ft] for every UAV = id",
        "stream s9 contains speed(UAV) = spd [furlongs_and_more] for every UAV = id",
        "stream s9 contains nosuchfeature(UAV) = spd for every UAV = id",
        "stream s9 contains speed(Nothing9) = spd for every Nothing9 = id",
    ],
    ids=["dimension", "unit", "feature", "sort"],
)
def test_annotations_that_mean_nothing(http: httpx.Client, ssl: str) -> None:
    before = state(http)
    problem(http.post("/annotations", content=ssl, headers=TEXT), 400)
    assert state(http) == before


@pytest.mark.parametrize(
    ("bad", "part"),
    [
        ('{"valid": 2, "id": "uav1"}', "spd"),
        ('{"valid": 2, "id": "uav1", "spd": "fast"}', "spd"),
        ('{"valid": 2, "id": "uav1", "spd": NaN}', "NaN"),
        ('{"valid": 2, "id": "uav1", "spd": Infinity}', "Infinity"),
        ('{"valid": 2, "id": "uav1", "spd": 1e999}', ""),
        ('{"valid": 2, "id": "uav1", "spd": 1, "more": 1}', "more"),
        ('{"id": "uav1", "spd": 1}', "valid"),
        ('{"valid": "yesterday", "id": "uav1", "spd": 1}', "valid"),
        ("[1, 2]", ""),
        ("{", ""),
    ],
)
def test_bad_sample_in_the_middle_of_a_batch(http: httpx.Client, bad: str, part: str) -> None:
    before = state(http)
    body = "\n".join([GOOD, GOOD, bad, GOOD])
    found = problem(http.post("/streams/s5/samples", content=body, headers=LINES), 400)
    assert found["title"] == "bad samples"
    assert found["line"] == 3
    assert part in found["detail"]
    assert state(http) == before


def test_empty_batch_and_bytes_that_are_no_text(http: httpx.Client) -> None:
    for body in (b"", b"\n\n", b"\xff\xfe"):
        problem(http.post("/streams/s5/samples", content=body, headers=LINES), 400)
    problem(http.post("/templates", content=b"\xff", headers=TEXT), 400)
    problem(http.post("/annotations", content=b"  ", headers=TEXT), 400)


def test_unknown_stream(http: httpx.Client) -> None:
    before = state(http)
    for method, path in [
        ("GET", "/streams/nowhere"),
        ("GET", "/streams/nowhere/samples"),
        ("POST", "/streams/nowhere/samples"),
        ("POST", "/streams/nowhere/end"),
        ("GET", "/streams/nowhere/events"),
    ]:
        found = problem(http.request(method, path, content=GOOD, headers=LINES), 404)
        assert found["title"] == "unknown stream"
    assert state(http) == before


def test_streams_of_the_system_are_its_own(http: httpx.Client) -> None:
    line = json.dumps({"valid": 1, **dict.fromkeys(_fields(http, "status"), "x")})
    problem(http.post("/streams/status/samples", content=line, headers=LINES), 403)
    problem(http.post("/streams/status/end"), 403)
    for name in ("status", "dyknow_reserved7"):
        problem(http.put(f"/streams/{name}", json={"fields": {"a": "float"}}), 403)


def _fields(http: httpx.Client, name: str) -> list[str]:
    return [field["name"] for field in http.get(f"/streams/{name}").json()["fields"]]


def test_template_name_twice(http: httpx.Client) -> None:
    before = state(http)
    found = problem(http.post("/templates", content=TEMPLATE, headers=TEXT), 409)
    assert found["title"] == "already exists"
    assert state(http) == before


@pytest.mark.parametrize(
    "path", ["/streams/s5/samples", "/templates", "/annotations", "/events", "/sparql", "/match"]
)
def test_ten_megabytes_are_too_many(http: httpx.Client, path: str) -> None:
    before = state(http)
    body = b'{"valid": 1}\n' * (10 * (1 << 20) // 13)
    found = problem(http.post(path, content=body, headers=LINES), 413)
    assert found["title"] == "body too large"
    # A body that does not say how long it is, is refused as soon as it is too long.
    chunks = (body[i : i + (1 << 16)] for i in range(0, len(body), 1 << 16))
    kind = {"/match": "application/json", "/events": "application/json", "/sparql": ""}
    headers = {"Content-Type": kind.get(path, "text/plain")}
    if path.endswith("samples"):
        headers = LINES
    if path == "/sparql":
        headers = {"Content-Type": "application/sparql-query"}
    assert http.post(path, content=chunks, headers=headers).status_code == 413
    assert state(http) == before


@pytest.mark.parametrize(
    ("method", "path", "kind"),
    [
        ("POST", "/templates", "application/json"),
        ("PUT", "/templates/HighSpeedEvent", "application/json"),
        ("POST", "/events", "application/xml"),
        ("POST", "/annotations", "application/xml"),
        ("POST", "/streams/s5/samples", "application/json"),
        ("PUT", "/streams/s6", "text/plain"),
        ("POST", "/match", "text/plain"),
        ("POST", "/sparql", "application/sparql-update"),
    ],
)
def test_media_types_that_are_not_taken(
    http: httpx.Client, method: str, path: str, kind: str
) -> None:
    before = state(http)
    answer = http.request(method, path, content="{}", headers={"Content-Type": kind})
    found = problem(answer, 415)
    assert "Content-Type" in found["hint"]
    assert state(http) == before


@pytest.mark.parametrize(
    ("method", "path", "status", "title"),
    [
        ("GET", "/nowhere", 404, "no such route"),
        ("DELETE", "/streams", 405, "method not allowed"),
        ("GET", "/templates/Nothing", 404, "unknown template"),
        ("DELETE", "/templates/Nothing", 404, "unknown template"),
        ("GET", "/events/nothing", 404, "unknown request"),
        ("DELETE", "/events/nothing", 404, "unknown request"),
        ("GET", "/streams/s5/samples?from=yesterday", 400, "bad time"),
        ("GET", "/streams/s5/samples?limit=0", 422, "values do not fit"),
        ("GET", "/streams/s5/samples?at=1&from=1", 400, "wrong arguments"),
        ("GET", "/explain", 400, "wrong arguments"),
        ("GET", "/explain?template=A&id=b", 400, "wrong arguments"),
        ("GET", "/explain?feature=nosuchfeature", 404, "unknown term"),
        ("GET", "/sparql?default-graph-uri=urn:a", 400, "wrong arguments"),
        ("GET", "/sparql?query=ASK%7B%7D&default-graph-uri=a", 400, "query refused"),
        ("GET", "/sparql?query=ASK%7B%7D&named-graph-uri=", 400, "query refused"),
        ("GET", "/sparql?query=ASK%7B%7D&using-graph-uri=urn:a", 400, "query refused"),
    ],
)
def test_other_refusals(
    http: httpx.Client, method: str, path: str, status: int, title: str
) -> None:
    assert problem(http.request(method, path), status)["title"] == title


@pytest.mark.parametrize(
    "body",
    [
        {},
        {"fields": {}},
        {"fields": {"a": "colour"}},
        {"fields": {"valid": "float"}},
        {"fields": [{"name": "a", "type": "float"}, {"name": "a", "type": "float"}]},
        {"fields": {"a": "float"}, "lateness": "soon"},
        {"fields": {"a": "float"}, "lateness": -1},
        {"fields": {"a": "float"}, "retention": {"samples": 0}},
        {"fields": {"a": "float"}, "colour": "red"},
    ],
)
def test_declarations_that_do_not_fit(http: httpx.Client, body: dict[str, Any]) -> None:
    before = state(http)
    found = problem(http.put("/streams/s9", json=body), 422)
    assert found["errors"]
    assert state(http) == before


def test_a_stream_is_not_declared_otherwise_while_in_use(http: httpx.Client) -> None:
    http.put("/streams/used", json={"fields": {"a": "float"}}).raise_for_status()
    http.post("/streams/used/samples", content='{"valid": 1, "a": 1}', headers=LINES)
    problem(http.put("/streams/used", json={"fields": {"a": "string"}}), 409)
    problem(http.put("/streams/1bad", json={"fields": {"a": "float"}}), 422)


def test_json_that_is_none(http: httpx.Client) -> None:
    headers = {"Content-Type": "application/json"}
    for method, path in (("POST", "/events"), ("PUT", "/streams/s9"), ("POST", "/match")):
        for body in ("{", "[", "{}{}"):
            problem(http.request(method, path, content=body, headers=headers), 400)


def test_not_acceptable(http: httpx.Client) -> None:
    for path in ("/streams/s5/samples", "/templates", "/annotations", "/explain?template=x"):
        found = problem(http.get(path, headers={"Accept": "image/png"}), 406)
        assert "Accept one of" in found["hint"]


def test_a_failure_within_says_nothing_of_it(monkeypatch: pytest.MonkeyPatch) -> None:
    engine = Engine(epoch="e1")

    def broken() -> None:
        raise RuntimeError("secret place")

    monkeypatch.setattr(engine, "generators", broken)
    app = create_app(engine, Settings(), lambda: 0)
    transport = httpx.ASGITransport(app, raise_app_exceptions=False)

    async def ask() -> httpx.Response:
        async with httpx.AsyncClient(transport=transport, base_url="http://test") as client:
            return await client.get("/streams")

    import anyio

    found = problem(anyio.run(ask), 500)
    assert "secret" not in json.dumps(found)


def test_the_connection_outlives_a_failure_within(monkeypatch: pytest.MonkeyPatch) -> None:
    engine = Engine(epoch="e1")

    def broken() -> None:
        raise RuntimeError

    with _service(engine, Settings(port=0), lambda: 0) as http:
        monkeypatch.setattr(engine, "generators", broken)
        for _ in range(3):
            answer = http.get("/streams")
            problem(answer, 500)
            used = answer.extensions["network_stream"].get_extra_info("client_addr")
            again = http.get("/healthz")
            assert again.status_code == 200
            assert again.extensions["network_stream"].get_extra_info("client_addr") == used


@pytest.mark.parametrize("body", ["[" * 2000, '{"a":' * 100_000])
@pytest.mark.parametrize(
    ("method", "path"),
    [("POST", "/streams/s5/samples"), ("PUT", "/streams/s9"), ("POST", "/events")],
)
def test_deep_nesting(http: httpx.Client, method: str, path: str, body: str) -> None:
    before = state(http)
    kind = LINES if path.endswith("samples") else {"Content-Type": "application/json"}
    found = problem(http.request(method, path, content=body, headers=kind), 400)
    if kind is LINES:
        assert found["line"] == 1
        assert found["hint"]
    assert state(http) == before


@pytest.mark.parametrize(
    ("method", "path", "allowed"),
    [
        ("PATCH", "/streams/s5", {"GET", "HEAD", "PUT", "DELETE"}),
        ("DELETE", "/streams/s5/samples", {"GET", "HEAD", "POST"}),
        ("DELETE", "/templates", {"GET", "HEAD", "POST"}),
        ("POST", "/templates/HighSpeedEvent", {"GET", "HEAD", "PUT", "DELETE"}),
        ("PUT", "/sparql", {"GET", "HEAD", "POST"}),
        ("HEAD", "/match", {"POST"}),
    ],
)
def test_allow_lists_every_method(
    http: httpx.Client, method: str, path: str, allowed: set[str]
) -> None:
    answer = http.request(method, path)
    assert answer.status_code == 405
    assert set(answer.headers["allow"].split(", ")) == allowed


def test_the_systems_streams_are_refused_before_the_body_is_looked_at(http: httpx.Client) -> None:
    problem(http.post("/streams/status/samples", content=b"\xff{", headers=LINES), 403)
    other = {"Content-Type": "image/png"}
    problem(http.post("/streams/status/samples", content=b"", headers=other), 403)


def test_an_idempotency_key_for_another_body(http: httpx.Client) -> None:
    http.put("/streams/keyed", json={"fields": {"a": "float"}}).raise_for_status()

    def send(body: str) -> httpx.Response:
        headers = {**LINES, "Idempotency-Key": "k"}
        return http.post("/streams/keyed/samples", content=body, headers=headers)

    assert send('{"valid": 1, "a": 1}').status_code == 202
    before = state(http)
    assert send('{"valid": 1, "a": 1}').status_code == 202
    problem(send('{"valid": 2, "a": 1}'), 409)
    assert state(http) == before


def test_a_byte_order_mark_before_texts(http: httpx.Client) -> None:
    mark = b"\xef\xbb\xbf"
    for method, path, text, kind in (
        ("PUT", "/templates/HighSpeedEvent", TEMPLATE, TEXT),
        ("POST", "/annotations", SSL, TEXT),
        ("POST", "/sparql", "ASK {}", {"Content-Type": "application/sparql-query"}),
    ):
        answer = http.request(method, path, content=mark + text.encode(), headers=kind)
        assert answer.is_success, (path, answer.text)
    request = b'{"event": "dyknow:HighSpeedEvent", "arguments": ["?o", "dyknow:UAV", "1"]}'
    made = http.post("/events", content=mark + request)
    assert made.status_code == 201, made.text
    http.delete(made.headers["location"])


def test_an_idempotency_key_that_is_too_long(http: httpx.Client) -> None:
    http.put("/streams/plain", json={"fields": {"v": "float"}})
    for length, status in ((200, 202), (201, 422)):
        headers = {"Idempotency-Key": "x" * length}
        answer = http.post(
            "/streams/plain/samples", content='{"valid": 1, "v": 1.0}', headers=headers
        )
        assert answer.status_code == status
    assert answer.json()["title"] == "values do not fit"
    assert answer.json()["errors"][0]["at"] == "header.idempotency-key"


@pytest.mark.parametrize("path", ["samples", "samples/live"])
def test_without_arrow(http: httpx.Client, monkeypatch: pytest.MonkeyPatch, path: str) -> None:
    http.put("/streams/plain", json={"fields": {"v": "float"}})
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    headers = {"Content-Type": "application/vnd.apache.arrow.stream"}
    answer = http.post(f"/streams/plain/{path}", content=b"\xff" * 4 + b"\0" * 4, headers=headers)
    assert answer.status_code == 501
    assert "dyknow[arrow]" in answer.json()["hint"]
