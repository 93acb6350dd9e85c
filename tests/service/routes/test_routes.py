"""Every route does what docs/reference/http.md says, over the real engine."""

from __future__ import annotations

import csv
import io
import json
import os
import socket
from typing import Any
from urllib.parse import quote, urlencode

import httpx
import pyarrow as pa
import pytest
from pyoxigraph import DefaultGraph, RdfFormat, parse

from dyknow.engine.engine import Engine
from dyknow.rdf.namespaces import DYKNOW
from dyknow.service.client.client import Client
from dyknow.service.config.settings import Settings
from dyknow.service.http.body_limit import BodyLimit
from dyknow.service.http.problems import LONGEST
from dyknow.service.runtime import trials
from dyknow.service.server import bind

PREFIX = "PREFIX dyknow: <http://www.ida.liu.se/dyknow/>"
WINDOW = "WINDOW [RANGE 5s STEP 1s]"
TEMPLATE = """REGISTER TEMPLATE dyknow:HighSpeedEvent(?o, ?type, ?threshold) COMPUTE EVERY 1s AS
PREFIX dyknow: <http://www.ida.liu.se/dyknow/>
CONSTRUCT {?o dyknow:speed ?avgSpeed}
WHERE { ?o a ?type . ?o dyknow:speed ?spd . }
AGGREGATE {(?avgSpeed, AVG, {?spd}) FILTER (?avgSpeed > ?threshold)}
WINDOW [RANGE 5s STEP 1s]"""
IRI = "http://www.ida.liu.se/dyknow/HighSpeedEvent"
SSL = "stream s5 contains speed(UAV) = spd [km.h-1] for every UAV = id"
STREAMED = (
    TEMPLATE.replace("TEMPLATE dyknow:HighSpeedEvent(?o, ?type, ?threshold)", "STREAM fast")
    .replace("> ?threshold", "> 100")
    .replace(WINDOW, "")
    .replace("WHERE", f"FROM STREAM <{DYKNOW}s5.trdf> {WINDOW.removeprefix('WINDOW ')}\nWHERE")
)
REQUEST = "dyknow:HighSpeedEvent(?o, dyknow:UAV, 100)"
TEXT = {"Content-Type": "text/plain"}
LINES = {"Content-Type": "application/x-ndjson"}


def declare(http: httpx.Client) -> httpx.Response:
    fields = [{"name": "id", "type": "string"}, {"name": "spd", "type": "float"}]
    return http.put("/streams/s5", json={"fields": fields, "lateness": "5s"})


def publish(http: httpx.Client, rows: list[dict[str, Any]], **headers: str) -> httpx.Response:
    body = "\n".join(json.dumps(row) for row in rows)
    return http.post("/streams/s5/samples", content=body, headers=LINES | headers)


def row(second: int, id: str = "uav1", spd: float = 150.0) -> dict[str, Any]:
    time = second * 1_000_000_000
    return {"valid": time, "available": time, "id": id, "spd": spd}


@pytest.fixture
def annotated(http: httpx.Client) -> httpx.Client:
    """A service with a stream of speeds and the papers' template."""
    assert declare(http).status_code == 201
    assert http.post("/annotations", content=SSL, headers=TEXT).status_code == 201
    assert http.post("/templates", content=TEMPLATE, headers=TEXT).status_code == 201
    return http


def test_declare_a_stream(http: httpx.Client) -> None:
    answer = declare(http)
    assert answer.status_code == 201
    assert answer.headers["location"] == "/streams/s5"
    found = answer.json()
    assert found["lateness"] == "5s"
    assert found["fields"][1] == {"name": "spd", "type": "float"}
    assert found["counters"] == dict.fromkeys(
        ("accepted", "used", "late", "duplicate", "expired", "pending", "ahead"), 0
    )
    again = declare(http)
    assert again.status_code == 200
    assert again.json() == found
    assert found in http.get("/streams").json()
    assert http.head("/streams/s5").status_code == 200
    assert http.head("/streams/s5").content == b""


def test_fields_as_an_object_and_types_by_other_names(http: httpx.Client) -> None:
    answer = http.put("/streams/s6", json={"fields": {"a": "double", "b": "int"}, "retention": 7})
    assert [field["type"] for field in answer.json()["fields"]] == ["float", "integer"]
    assert answer.json()["retention"] == {"samples": 7, "age": None, "bytes": None}


def test_how_much_is_kept(http: httpx.Client, client: Client) -> None:
    def kept(**retention: Any) -> dict[str, Any]:
        fields = {"v": "float", "text": "string"}
        found = client.put_stream("s7", fields, retention=retention)["retention"]
        assert found == http.get("/streams/s7").json()["retention"]
        return dict(found)

    usual = {"samples": 100_000, "age": None, "bytes": 256 << 20}
    assert kept() == usual
    assert kept(age="1h") == {**usual, "age": "1h"}
    assert kept(bytes=1_000) == {**usual, "bytes": 1_000}
    # Who says how many has so many.
    assert kept(samples=10**7) == {"samples": 10**7, "age": None, "bytes": None}
    assert kept(samples=5, bytes=300) == {"samples": 5, "age": None, "bytes": 300}
    # It is changed while the stream is in use, and at once.
    kept()
    for i in range(4):
        client.publish("s7", [{"valid": i, "v": 1.0, "text": "x" * 100}])
    assert http.get("/streams/s7").json()["kept"] == 4
    assert kept(bytes=600)["bytes"] == 600
    found = http.get("/streams/s7").json()
    assert (found["kept"], found["first"], found["last"]) == (2, 3, 4)
    assert kept() == usual
    assert http.get("/streams/s7").json()["kept"] == 2
    # And that of streams that annotations make.
    text = "stream s8 contains speed(UAV) = v for every UAV = id"
    assert http.post("/annotations", content=text, headers=TEXT).status_code == 201
    assert http.get("/streams/s8").json()["retention"] == usual
    fields = {"v": "float", "text": "string"}
    for wrong in (0, -1, 2**63, 1.5, "many"):
        answer = http.put("/streams/s7", json={"fields": fields, "retention": {"bytes": wrong}})
        assert answer.status_code == 422


def test_publish_and_read_back_in_every_format(annotated: httpx.Client) -> None:
    http = annotated
    answer = publish(http, [row(1), row(2, "uav2", 80.5), row(8)])
    assert answer.status_code == 202
    assert answer.json() == {"accepted": 3}
    assert http.post("/streams/s5/end").status_code == 204
    path = "/streams/s5/samples"

    lines = http.get(path).text.splitlines()
    assert json.loads(lines[1]) == {
        "available": "1970-01-01T00:00:02Z",
        "valid": "1970-01-01T00:00:02Z",
        "id": "uav2",
        "spd": 80.5,
    }
    as_json = http.get(path, headers={"Accept": "application/json"})
    assert as_json.json() == [json.loads(line) for line in lines]
    as_csv = http.get(path, headers={"Accept": "text/csv"})
    assert [r["id"] for r in csv.DictReader(io.StringIO(as_csv.text))] == ["uav1", "uav2", "uav1"]
    arrow = http.get(path, headers={"Accept": "application/vnd.apache.arrow.stream"})
    assert pa.ipc.open_stream(arrow.content).read_all().column("spd").to_pylist() == [
        150.0,
        80.5,
        150.0,
    ]
    rdf = http.get(path, headers={"Accept": "application/n-triples"}).text.splitlines()
    assert len(rdf) == 3
    assert rdf[0].startswith(
        "<http://www.ida.liu.se/dyknow/uav1> <http://www.ida.liu.se/dyknow/speed>"
    )


def test_publish_arrow(http: httpx.Client) -> None:
    declare(http)
    table = pa.table(
        {"valid": pa.array([1, 2], pa.timestamp("s", "UTC")), "id": ["a", "b"], "spd": [1.0, None]}
    )
    sink = io.BytesIO()
    with pa.ipc.new_stream(sink, table.schema) as writer:
        writer.write_table(table)
    headers = {"Content-Type": "application/vnd.apache.arrow.stream"}
    answer = http.post("/streams/s5/samples", content=sink.getvalue(), headers=headers)
    assert answer.json() == {"accepted": 2}
    found = http.get("/streams/s5/samples", headers={"Accept": "application/json"}).json()
    assert [sample["spd"] for sample in found] == [1.0, None]
    # Without times of their own they are stamped by the service's clock.
    assert found[0]["available"] == "2021-10-07T19:12:53Z"


def test_history_by_time_number_and_most_recent(http: httpx.Client) -> None:
    declare(http)
    publish(http, [row(i, spd=float(i)) for i in range(1, 11)])
    http.post("/streams/s5/end")

    def speeds(query: str) -> list[float]:
        answer = http.get(f"/streams/s5/samples{query}", headers={"Accept": "application/json"})
        return [sample["spd"] for sample in answer.json()]

    assert speeds("") == [float(i) for i in range(1, 11)]
    assert speeds("?limit=2") == [9.0, 10.0]
    assert speeds("?from=1970-01-01T00:00:03Z&limit=2") == [3.0, 4.0]
    assert speeds("?from=3000000000&to=5000000000") == [3.0, 4.0, 5.0]
    assert speeds("?at=1970-01-01T00:00:04.5Z") == [4.0]
    assert speeds("?at=9000000000&known=2000000000") == [2.0]
    assert speeds("?at=0") == []


def test_idempotency_key_has_one_effect(http: httpx.Client) -> None:
    declare(http)
    for _ in range(3):
        answer = publish(http, [row(1), row(9)], **{"Idempotency-Key": "k"})
        assert answer.json() == {"accepted": 2}
    assert http.get("/streams/s5").json()["counters"]["accepted"] == 2


def test_which_of_several_idempotency_keys_counts_is_not_guessed(http: httpx.Client) -> None:
    declare(http)
    headers = [("Content-Type", "application/x-ndjson")]
    headers += [("Idempotency-Key", key) for key in ("k", "l")]
    answer = http.post("/streams/s5/samples", content=json.dumps(row(1)), headers=headers)
    assert answer.status_code == 400
    assert answer.json()["detail"] == "there are several Idempotency-Key headers"
    assert http.get("/streams/s5").json()["counters"]["accepted"] == 0


def test_template_life(http: httpx.Client) -> None:
    made = http.post("/templates", content=TEMPLATE, headers=TEXT)
    assert made.status_code == 201
    assert made.headers["location"] == "/templates/HighSpeedEvent"
    assert made.json()["parameters"] == ["?o", "?type", "?threshold"]
    etag = made.headers["etag"]
    for name in ("HighSpeedEvent", quote(IRI, safe="")):
        found = http.get(f"/templates/{name}")
        assert found.json() == made.json()
        assert found.headers["etag"] == etag
    assert http.get("/templates/HighSpeedEvent", headers={"Accept": "text/plain"}).text == TEMPLATE
    unchanged = http.get("/templates/HighSpeedEvent", headers={"If-None-Match": etag})
    assert unchanged.status_code == 304
    assert http.get("/templates").json() == [made.json()]
    assert http.get("/templates", headers={"Accept": "text/plain"}).text == TEMPLATE

    faster = TEMPLATE.replace("RANGE 5s", "RANGE 9s")
    path = "/templates/HighSpeedEvent"
    stale = http.put(path, content=faster, headers=TEXT | {"If-Match": '"other"'})
    assert stale.status_code == 412
    assert http.get(path).headers["etag"] == etag
    there = http.put(path, content=faster, headers=TEXT | {"If-None-Match": "*"})
    assert there.status_code == 412
    replaced = http.put(path, content=faster, headers=TEXT | {"If-Match": etag})
    assert replaced.status_code == 200
    assert replaced.headers["etag"] != etag
    wrong = http.put("/templates/Other", content=faster, headers=TEXT)
    assert wrong.status_code == 409
    assert http.delete(path, headers={"If-Match": etag}).status_code == 412
    assert http.delete(path).status_code == 204
    assert http.get("/templates").json() == []
    assert http.put(path, content=faster, headers=TEXT).status_code == 201


def test_event_life(annotated: httpx.Client) -> None:
    http = annotated
    body = {"event": "dyknow:HighSpeedEvent", "arguments": ["?o", "dyknow:UAV", "100"]}
    made = http.post("/events", json=body)
    assert made.status_code == 201
    view = made.json()
    assert made.headers["location"] == f"/events/{view['id']}"
    assert view["stream"].startswith("dyknow_reserved")
    assert view["events"] == f"/streams/{view['stream']}/events"
    assert "s5" in view["plan"]["streams"]
    twin = http.post("/events", content=REQUEST, headers=TEXT).json()
    assert twin["stream"] == view["stream"]
    assert twin["id"] != view["id"]
    assert {found["id"] for found in http.get("/events").json()} == {view["id"], twin["id"]}
    assert http.get(f"/events/{view['id']}").json()["arguments"] == view["arguments"]

    publish(http, [row(i, "uav1" if i % 2 else "uav2", 150.0 - 100 * (i % 2)) for i in range(1, 9)])
    http.post("/streams/s5/end")
    events = http.get(f"{view['events']}?since=start").text
    samples = [json.loads(line[6:]) for line in events.splitlines() if "sequence" in line]
    values = [sample["values"] for sample in samples if "values" in sample]
    assert values
    assert {value["id"] for value in values} == {"http://www.ida.liu.se/dyknow/uav2"} or {
        value["id"] for value in values
    } == {"uav2"}
    assert "speed" in samples[0]["rdf"]

    assert http.delete(f"/events/{view['id']}").status_code == 204
    assert http.get(twin["events"], headers={"Accept": "x/y"}).status_code == 406  # still there
    assert http.delete(f"/events/{twin['id']}").status_code == 204
    assert http.get(twin["events"]).status_code == 404
    assert http.get("/events").json() == []


def test_annotations(annotated: httpx.Client) -> None:
    found = annotated.get("/annotations").json()
    speeds = next(a for a in found if a["name"] == "s5")
    assert speeds["kind"] == "stream"
    assert speeds["features"] == ["http://www.ida.liu.se/dyknow/speed"]
    assert SSL in annotated.get("/annotations", headers={"Accept": "text/plain"}).text
    assert annotated.get("/streams/s5").json()["annotation"] == SSL


def test_match_starts_nothing(annotated: httpx.Client) -> None:
    before = annotated.get("/streams").json()
    wanted = {"feature": "dyknow:speed", "sort": "dyknow:UAV"}
    found = annotated.post("/match", json=wanted).json()
    assert found["found"] is True
    assert "s5" in found["plan"]["text"]
    wanted["feature"] = "dyknow:altitude"
    nothing = annotated.post("/match", json=wanted).json()
    assert nothing["found"] is False
    assert nothing["plan"] is None
    assert nothing["reasons"]
    assert annotated.get("/streams").json() == before


def test_explain_every_kind(annotated: httpx.Client) -> None:
    view = annotated.post("/events", content=REQUEST, headers=TEXT).json()
    for parameter, value in {
        "event": REQUEST,
        "template": "HighSpeedEvent",
        "query": STREAMED,
        "id": view["id"],
        "feature": "dyknow:speed",
    }.items():
        answer = annotated.get("/explain", params={parameter: value})
        assert answer.status_code == 200, answer.text
        assert answer.headers["content-type"].startswith("text/plain")
        assert len(answer.text) > 40
        as_json = annotated.get(
            "/explain", params={parameter: value}, headers={"Accept": "application/json"}
        )
        found = as_json.json()
        assert found["text"] == answer.text
        assert found["found"]
        assert all(stage["text"] in answer.text or stage["title"] for stage in found["stages"])
        posted = annotated.post(
            "/explain", json={parameter: value}, headers=as_json.request.headers
        )
        assert posted.json() == found
    for body in ({}, {"event": REQUEST, "query": STREAMED}):
        assert annotated.post("/explain", json=body).status_code == 400


def test_the_plan_of_an_explanation_is_a_tree(annotated: httpx.Client) -> None:
    accept = {"Accept": "application/json"}
    found = annotated.post("/explain", json={"event": REQUEST}, headers=accept).json()
    assert [stage["title"] for stage in found["stages"]] == [
        "request",
        "template",
        "features needed",
        "semantic matching",
        "query",
        "evaluation",
    ]
    (speed,) = found["plan"]
    assert speed["text"] == "speed of every dyknow:UAV [km.h-1]"
    assert (speed["parts"][0]["verdict"], speed["parts"][0]["stream"]) == ("chosen", "s5")
    match = {"feature": "dyknow:speed", "sort": "dyknow:UAV"}
    assert annotated.post("/match", json=match).json()["tree"]["parts"][0]["stream"] == "s5"
    # What each part adds to the cost: nothing that exists, and the computations that it needs.
    chosen = speed["parts"][0]
    assert (speed["cost"], chosen["cost"]) == (None, 0.0)
    computed = "stream s5 contains latitude(UAV) = spd, longitude(UAV) = spd for every UAV = id"
    annotated.post("/annotations", content=computed, headers=TEXT).raise_for_status()
    found = annotated.post("/match", json=match).json()
    parts = [found["tree"]]
    spent = 0.0
    while parts:
        part = parts.pop()
        spent += part["cost"] or 0.0
        parts += part["parts"]
    assert spent == found["cost"] > 0


def test_the_operators_of_an_explanation_have_costs(annotated: httpx.Client) -> None:
    annotated.post("/queries", content=STREAMED).raise_for_status()
    accept = {"Accept": "application/json"}
    for thing in ({"event": REQUEST}, {"query": STREAMED}, {"id": "fast"}):
        found = annotated.post("/explain", json=thing, headers=accept).json()
        first, *below = found["operators"]
        assert first["depth"] == 0
        assert {one["depth"] for one in below} > {1, 2}
        assert "folded, each step" in {one["way"] for one in found["operators"]}
        assert first["estimated"]["rows"] > 0
        spent = [one["estimated"]["nanoseconds"] for one in found["operators"]]
        assert min(spent) >= 0 < sum(spent)
        assert [one["operator"] for one in below if one["operator"] in found["text"]]
        assert {one["measured"] for one in found["operators"]} == {None}
    template = annotated.post("/explain", json={"template": "HighSpeedEvent"}, headers=accept)
    assert template.json()["operators"] == []


def test_a_request_and_a_query_are_tried_on_what_is_kept(annotated: httpx.Client) -> None:
    rows = [{"valid": i * 10**9, "available": i * 10**9, "id": "u", "spd": 150} for i in range(20)]
    publish(annotated, rows)
    accept = {"Accept": "application/json"}
    for thing in ({"event": REQUEST}, {"query": STREAMED}):
        body = {**thing, "since": "start"}
        found = annotated.post("/explain", json=body, headers=accept).json()
        assert found["tried"] == {
            "since": "1970-01-01T00:00:00Z",
            "until": "1970-01-01T00:00:14Z",
            "samples": 15,  # The others may still be overtaken.
            "results": 14,
            "first": "1970-01-01T00:00:00Z",
            "last": "1970-01-01T00:00:13Z",
            "complete": True,
            "failure": None,
        }
        assert found["stages"][-1]["title"] == "on what is kept"
        text = annotated.get("/explain", params=body).text
        assert text == found["text"]
        assert text.endswith(
            "on what is kept\n  15 samples from 1970-01-01T00:00:00Z to 1970-01-01T00:00:14Z: "
            "14 results,\n  the first at 1970-01-01T00:00:00Z, the last at 1970-01-01T00:00:13Z\n"
        )
        assert not annotated.get("/events").json()
    for body, status in (
        ({"feature": "dyknow:speed", "since": "start"}, 400),
        ({"event": REQUEST, "since": "tomorrow"}, 400),
        ({"event": REQUEST, "since": "now"}, 400),
    ):
        assert annotated.post("/explain", json=body, headers=accept).status_code == status
    quiet = annotated.post("/explain", json={"event": REQUEST}, headers=accept).json()
    assert quiet["tried"] is None


def test_only_some_wait_for_a_back_test(
    annotated: httpx.Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    body = {"event": REQUEST, "since": "start"}
    monkeypatch.setattr(trials, "_MOST", 0)
    refused = annotated.post("/explain", json=body)
    assert (refused.status_code, refused.headers["retry-after"]) == (503, "5")
    monkeypatch.setattr(trials, "_MOST", 1)
    assert annotated.post("/explain", json=body).status_code == 200


def test_a_back_test_whose_process_dies_is_a_problem(
    annotated: httpx.Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(trials, "back_test", lambda *_, **__: os.kill(os.getpid(), 9))
    answer = annotated.post("/explain", json={"event": REQUEST, "since": "start"})
    assert answer.status_code == 503
    assert "died" in answer.json()["detail"]


def test_an_explanation_without_a_plan_is_a_problem(annotated: httpx.Client) -> None:
    accept = {"Accept": "application/json"}
    lacking = REQUEST.replace("UAV", "Human")
    missed = annotated.post("/explain", json={"event": lacking}, headers=accept).json()
    assert {part["verdict"] for part in missed["plan"][0]["parts"]} == {"failed"}
    (s5,) = [part for part in missed["plan"][0]["parts"] if part["stream"] == "s5"]
    assert s5["reason"]
    query = f"REGISTER QUERY t AS {PREFIX} SELECT ?o WHERE {{ ?o dyknow:altitude ?a }} {WINDOW}"
    for thing in ({"event": lacking}, {"feature": "altitude"}, {"query": query}):
        text = annotated.post("/explain", json=thing, headers={"Accept": "text/plain"})
        assert text.status_code == 200
        answer = annotated.post("/explain", json=thing, headers=accept)
        assert answer.status_code == 422, answer.text
        assert answer.headers["content-type"] == "application/problem+json"
        missed = answer.json()
        assert (missed["type"], missed["found"]) == ("urn:dyknow:problem:no-plan", False)
        assert missed["text"] == text.text
        assert missed["stages"][-1]["title"] == "semantic matching"
        assert missed["plan"][0]["parts"][0]["verdict"] in ("failed", "")
        assert missed["missing"]
        assert "annotate a stream" in missed["hint"]
        got = annotated.get("/explain", params=thing, headers=accept)
        assert got.status_code == 422
        assert {**got.json(), "instance": ""} == {**missed, "instance": ""}


def test_a_long_explanation_without_a_plan_is_whole(annotated: httpx.Client) -> None:
    body = f'?o dyknow:altitude ?a FILTER (?a != "{"long " * LONGEST}")'
    query = f"REGISTER QUERY t AS {PREFIX} SELECT ?o WHERE {{ {body} }} {WINDOW}"
    accept = {"Accept": "application/json"}
    missed = annotated.post("/explain", json={"query": query}, headers=accept).json()
    assert len(missed["text"]) > len(query)
    assert "…" not in missed["text"]


def test_a_template_tells_what_its_parameters_stand_for(annotated: httpx.Client) -> None:
    found = annotated.get("/templates/HighSpeedEvent").json()
    assert found["window"] == "the last 5s, every 1s"
    roles = {use["name"]: use["role"] for use in found["uses"]}
    assert roles == {"?o": "object", "?type": "sort", "?threshold": "number"}
    threshold = found["uses"][2]
    assert threshold["feature"] == "dyknow:speed"
    assert threshold["unit"] == "km.h-1"
    assert threshold["comparison"] == ">"
    assert threshold["aggregate"] == "AVG"


def test_a_template_tells_its_defaults_and_a_request_leaves_them_out(
    annotated: httpx.Client,
) -> None:
    text = annotated.get("/templates/HighSpeedEvent", headers={"Accept": "text/plain"}).text
    text = text.replace("?type, ?threshold)", "?type = dyknow:UAV, ?threshold = 100.5)")
    text = text.replace("HighSpeedEvent", "FastEvent")
    found = annotated.post("/templates", content=text, headers={"Content-Type": "text/plain"})
    assert found.status_code == 201
    assert [use["default"] for use in found.json()["uses"]] == [None, "dyknow:UAV", "100.5"]
    assert annotated.get("/templates/FastEvent", headers={"Accept": "text/plain"}).text == text
    first = annotated.post("/events", content="dyknow:FastEvent(?o)").json()
    assert first["arguments"] == ["?o", "dyknow:UAV", "100.5"]
    body = {"event": "dyknow:FastEvent", "arguments": ["?o", "?threshold = 100.5"]}
    assert annotated.post("/events", json=body).json()["stream"] == first["stream"]
    explained = annotated.post("/explain", json={"event": "dyknow:FastEvent(?o)"})
    assert explained.status_code == 200
    wrong = text.replace("100.5", '"fast"').replace("FastEvent", "WrongEvent")
    refused = annotated.post("/templates", content=wrong, headers={"Content-Type": "text/plain"})
    assert refused.status_code == 400
    line = next(each for each in wrong.splitlines() if '"fast"' in each)
    assert refused.json()["column"] == line.index('"fast"') + 1
    assert "the default of `?threshold`" in refused.json()["detail"]


def test_a_duration_is_a_parameter(annotated: httpx.Client) -> None:
    text = (
        "REGISTER TEMPLATE Twice(?x, ?low, ?time) AS PATTERN SEQ(speed a, speed b) "
        "WHERE [id = ?x] and b.value < ?low WITHIN ?time"
    )
    assert annotated.post("/templates", content=text).status_code == 201
    found = annotated.get("/templates/Twice").json()
    roles = {use["name"]: use["role"] for use in found["uses"]}
    assert roles == {"?x": "object", "?low": "number", "?time": "duration"}
    for given, status in (('"5s"', 201), ('"PT5S"^^xsd:duration', 201), ("5", 400)):
        answer = annotated.post("/events", content=f"dyknow:Twice(?x, 100, {given})")
        assert answer.status_code == status, answer.text


NAMES = """PREFIX o: <http://www.dyknow.eu/ontology#>
SELECT ?name WHERE { ?s a o:Stream ; o:hasName ?name } ORDER BY ?name"""


@pytest.mark.parametrize(
    ("kind", "part"),
    [
        ("application/sparql-results+json", '"s5"'),
        ("application/json", '"s5"'),
        ("application/sparql-results+xml", "<literal>s5</literal>"),
        ("text/csv", "s5"),
        ("text/tab-separated-values", '"s5"'),
    ],
)
def test_sparql_over_the_live_stream_space(annotated: httpx.Client, kind: str, part: str) -> None:
    answer = annotated.get("/sparql", params={"query": NAMES}, headers={"Accept": kind})
    assert answer.status_code == 200, answer.text
    assert answer.headers["content-type"].startswith(kind)
    assert part in answer.text


@pytest.mark.parametrize(
    "kind",
    [
        "text/turtle",
        "application/n-triples",
        "application/ld+json",
        "application/rdf+xml",
        "application/trig",
        "application/n-quads",
    ],
)
def test_sparql_graphs(http: httpx.Client, kind: str) -> None:
    query = "CONSTRUCT { ?s a ?c } WHERE { ?s a ?c } LIMIT 3"
    answer = http.get("/sparql", params={"query": query}, headers={"Accept": kind})
    assert answer.status_code == 200
    assert answer.headers["content-type"].startswith(kind)
    format = RdfFormat.from_media_type(kind)
    assert format is not None
    quads = list(parse(answer.content, format))
    assert len(quads) == 3
    assert {quad.graph_name for quad in quads} == {DefaultGraph()}


def test_a_graph_that_rdf_xml_cannot_express(http: httpx.Client) -> None:
    query = "CONSTRUCT { <urn:a> <http://e.org/1> 1 } WHERE {}"
    asked = {"params": {"query": query}, "headers": {"Accept": "application/rdf+xml"}}
    refused = http.get("/sparql", **asked)
    assert refused.status_code == 400
    assert "<http://e.org/1>" in refused.json()["detail"]
    assert "text/turtle" in refused.json()["detail"]


OWN = "http://www.dyknow.eu/graphs/"


def test_sparql_over_chosen_graphs(annotated: httpx.Client) -> None:
    """``default-graph-uri`` and ``named-graph-uri``, in the address and in a form, go before FROM;
    a graph that is not there is empty."""
    count = "SELECT (COUNT(*) AS ?n) {0} {{ ?s ?p ?o }}"
    named = "SELECT (COUNT(DISTINCT ?g) AS ?n) {0} {{ GRAPH ?g {{ ?s ?p ?o }} }}"

    def ask(text: str, *graphs: tuple[str, str], clause: str = "") -> int:
        parameters = [("query", text.format(clause)), *graphs]
        by_get = annotated.get("/sparql", params=parameters)
        kind = {"Content-Type": "application/x-www-form-urlencoded"}
        by_form = annotated.post("/sparql", content=urlencode(parameters), headers=kind)
        assert by_get.status_code == 200, by_get.text
        assert by_get.json() == by_form.json()
        return int(by_get.json()["results"]["bindings"][0]["n"]["value"])

    one = ("default-graph-uri", OWN + "annotations")
    other = ("default-graph-uri", OWN + "templates")
    nowhere = ("default-graph-uri", OWN + "nowhere")
    assert ask(count) > ask(count, one, other) == ask(count, one) + ask(count, other)
    assert ask(count, one) == ask(count, clause=f"FROM <{OWN}annotations>") > 0
    assert ask(count, one, clause=f"FROM <{OWN}templates>") == ask(count, one)
    assert ask(count, nowhere) == ask(count, clause=f"FROM <{OWN}nowhere>") == 0
    # Only named graphs: the default graph is empty. Only default graphs: there are no named ones.
    graph = ("named-graph-uri", OWN + "templates")
    assert ask(named, graph) == 1
    assert ask(count, graph) == ask(count, graph, clause=f"FROM <{OWN}templates>") == 0
    assert ask(named, one) == 0
    assert ask(named) > 5


def test_the_client_chooses_graphs_and_formats(annotated: httpx.Client, client: Client) -> None:
    ask, of_graph = "ASK { ?s :hasText ?text }", "ASK { GRAPH ?g { ?s :hasText ?text } }"
    one, none = [OWN + "annotations"], [OWN + "templates", OWN + "nowhere"]
    assert client.sparql(ask, default_graphs=[*none, *one]) == {"head": {}, "boolean": True}
    assert client.sparql(ask, default_graphs=none) == {"head": {}, "boolean": False}
    assert client.sparql(of_graph, named_graphs=one) == {"head": {}, "boolean": True}
    assert client.sparql(ask, named_graphs=one) == {"head": {}, "boolean": False}
    graph = "CONSTRUCT WHERE { ?s :hasText ?text }"
    text = client.sparql_text(graph, "application/n-quads", default_graphs=one)
    assert text.startswith("<http://www.dyknow.eu/annotations/s5> ")
    assert client.sparql_text(graph, "application/n-quads", default_graphs=none) == ""
    assert f"sd:name <{one[0]}>" in client.describe_sparql()


def test_parameters_of_a_query(annotated: httpx.Client, client: Client) -> None:
    """``$name`` in the address, in a form, and of the client: a term for a variable."""
    text = "SELECT ?s FROM <{0}annotations> {{ ?s :hasText ?text FILTER(STRLEN(?text) > ?least) }}"
    text = text.format(OWN)

    def asked(**more: str) -> list[httpx.Response]:
        parameters = {"query": text} | {f"${name}": term for name, term in more.items()}
        by_get = annotated.get("/sparql", params=parameters)
        return [by_get, annotated.post("/sparql", data=parameters)]

    for least, number in (("5", 1), ("5000", 0)):
        for answer in asked(least=least):
            assert len(answer.json()["results"]["bindings"]) == number, answer.text
        assert (
            len(client.sparql(text, parameters={"least": least})["results"]["bindings"]) == number
        )
    of_sort = "ASK { ?stream a ?kind ; :hasName ?name }"
    chosen = {"kind": ":Stream", "name": '"s5"'}
    assert client.sparql(of_sort, parameters=chosen) == {"head": {}, "boolean": True}
    assert client.sparql(of_sort, parameters=chosen | {"name": '"s6"'})["boolean"] is False

    for more, said in (
        ({"most": "5"}, "does not use $most"),
        ({"least": "two words"}, "$least is no term"),
        ({"least": ""}, "$least is no term"),
        ({"least": "?o"}, "$least is no IRI and no literal"),
        ({"least": "1" * 1025}, "$least has more than 1024 characters"),
        ({"s": "5"}, "$s needs an IRI"),
    ):
        for answer in asked(**more):
            assert answer.status_code == 400
            assert said in answer.json()["detail"]
    forgotten = annotated.get("/sparql", params={"query": text, "least": "5", "format": "json"})
    assert "write $least=5" in forgotten.json()["hint"]
    assert client.sparql(of_sort, parameters={"$kind": ":Stream", "?name": '"s5"'})["boolean"]
    twice = annotated.get("/sparql", params=[("query", text), ("$least", "1"), ("$least", "2")])
    assert "$least is given twice" in twice.json()["detail"]


def test_sparql_protocol_forms(http: httpx.Client) -> None:
    ask = "ASK { ?s ?p ?o }"
    by_get = http.get("/sparql", params={"query": ask})
    by_form = http.post("/sparql", data={"query": ask})
    by_body = http.post(
        "/sparql", content=ask, headers={"Content-Type": "application/sparql-query"}
    )
    for answer in (by_get, by_form, by_body):
        assert answer.status_code == 200
        assert answer.headers["content-type"].startswith("application/sparql-results+json")
        assert answer.json()["boolean"] is True
    assert (
        http.get("/sparql", params={"query": ask}, headers={"Accept": "text/csv"}).status_code
        == 406
    )


def test_status_health_and_metrics(annotated: httpx.Client) -> None:
    http = annotated
    publish(http, [row(1), row(9)])
    status = http.get("/status").json()
    assert status["epoch"] == "e1"
    assert status["now"] == "2021-10-07T19:12:53Z"
    assert status["templates"] == 1
    assert http.get("/healthz").json()["status"] == "ok"
    assert http.get("/readyz").json()["status"] == "ok"
    metrics = http.get("/metrics").text
    assert 'dyknow_samples_total{fate="accepted",stream="s5"} 2.0' in metrics
    assert (
        'dyknow_http_requests_total{method="PUT",route="/streams/{name}",status="201"}' in metrics
    )


def test_not_ready_while_the_tick_fails(
    http: httpx.Client, engine: Engine, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(now: int) -> None:
        raise RuntimeError("out of order")

    monkeypatch.setattr(engine, "tick", broken)
    while http.get("/readyz").status_code == 200:
        pass
    answer = http.get("/readyz")
    assert answer.status_code == 503
    assert "out of order" in answer.json()["reason"]
    monkeypatch.undo()
    while http.get("/readyz").status_code == 503:
        pass


def test_docs_are_served_without_any_outside_address(http: httpx.Client) -> None:
    page = http.get("/docs")
    assert page.headers["content-type"].startswith("text/html")
    policy = page.headers["content-security-policy"]
    assert policy.startswith("default-src 'none'; script-src 'self'; style-src 'self'; ")
    assert "//" not in policy
    for name in ("docs.css", "docs.js"):
        assert f"/static/{name}" in page.text
        text = http.get(f"/static/{name}")
        assert text.status_code == 200
        assert "http://" not in text.text
        assert "https://" not in text.text
    assert "http" not in page.text.replace("http-equiv", "")
    assert http.get("/static/settings.py").status_code == 404


def test_too_many_bodies_at_once_are_asked_to_wait() -> None:
    import anyio
    from starlette.types import Receive, Scope, Send

    inside = anyio.Event()
    go_on = anyio.Event()

    async def slow(scope: Scope, receive: Receive, send: Send) -> None:
        await receive()
        inside.set()
        await go_on.wait()
        await send({"type": "http.response.start", "status": 204, "headers": []})
        await send({"type": "http.response.body", "body": b""})

    async def run() -> tuple[int, httpx.Response]:
        limit = BodyLimit(slow, limit=100, total=100)
        transport = httpx.ASGITransport(limit)
        first: list[int] = []
        async with httpx.AsyncClient(transport=transport, base_url="http://test") as client:

            async def post() -> None:
                first.append((await client.post("/", content=b"x" * 80)).status_code)

            async with anyio.create_task_group() as tasks:
                tasks.start_soon(post)
                await inside.wait()
                second = await client.post("/", content=b"x" * 80)
                go_on.set()
        return first[0], second

    status, refused = anyio.run(run)
    assert status == 204
    assert refused.status_code == 429
    assert refused.headers["retry-after"] == "1"


def test_answers_are_not_held_back_by_nagle() -> None:
    """asyncio switches Nagle's algorithm off for sockets that name their protocol."""
    with bind(Settings(port=0)) as listener:
        assert listener.proto == socket.IPPROTO_TCP


def test_a_stream_is_removed(http: httpx.Client, client: Client) -> None:
    client.put_stream("s5", {"id": "string", "spd": "float"})
    client.publish("s5", [{"valid": 1, "id": "a", "spd": 1.5}])
    client.remove_stream("s5")
    assert http.get("/streams/s5").status_code == 404
    assert http.delete("/streams/s5").status_code == 404
    assert http.delete("/streams/status").status_code == 403
    # It may be declared otherwise now.
    client.put_stream("s5", {"other": "float"})


def test_a_stream_that_is_read_is_not_removed(http: httpx.Client, client: Client) -> None:
    client.annotate(SSL)
    client.register_template(TEMPLATE)
    request = client.request_event("dyknow:HighSpeedEvent(?o, dyknow:UAV, 100)")
    assert http.delete("/streams/s5").status_code == 409
    assert http.delete(f"/streams/{request['stream']}").status_code == 403
    client.cancel_event(request["id"])
    assert http.delete("/streams/s5").status_code == 204


@pytest.mark.parametrize("way", ["", "/live"])
def test_what_a_float_field_does_not_hold_is_told(http: httpx.Client, way: str) -> None:
    http.put("/streams/s5", json={"fields": {"v": "float"}})

    def published(*values: str) -> Any:
        body = "".join(f'{{"valid": 1, "v": {value}}}\n' for value in values)
        answer = http.post(f"/streams/s5/samples{way}", content=body, headers=LINES)
        assert answer.status_code == 202, answer.text
        return answer.json()

    assert published("1.5", "0.1") == {"accepted": 2}
    told = {"count": 2, "line": 2, "field": "v"}
    assert published("1", "9007199254740993", "1e-400") == {"accepted": 3, "rounded": told}
