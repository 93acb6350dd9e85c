"""Quotas: what would make one thing too many is refused, and nothing else is."""

from __future__ import annotations

from pathlib import Path

import httpx
import pytest

from dyknow.engine.durability.durable_engine import RecordedEngine
from dyknow.engine.engine import Engine
from dyknow.service.admission.quotas import MAKES
from dyknow.service.admission.scopes import NEEDED
from dyknow.service.app import create_app
from dyknow.service.client.client import Client, ServiceError
from dyknow.service.config.settings import Settings
from dyknow.service.server import running

FIELDS = {"id": "string", "speed": "float"}
TEMPLATE = """REGISTER TEMPLATE dyknow:{name}(?o, ?type, ?threshold) COMPUTE EVERY 1s AS
PREFIX dyknow: <http://www.ida.liu.se/dyknow/>
CONSTRUCT {{?o dyknow:speed ?avgSpeed}}
FROM <http://www.ida.liu.se/dyknow/ontology.rdf>
WHERE {{ ?o a ?type . ?o dyknow:speed ?spd . }}
AGGREGATE {{(?avgSpeed, AVG, {{?spd}}) FILTER (?avgSpeed > ?threshold)}}
WINDOW [RANGE 5s STEP 1s]"""
QUERY = """REGISTER QUERY {name} AS SELECT ?o
FROM STREAM <http://www.ida.liu.se/dyknow/s1.trdf> [RANGE 5s STEP 1s]
WHERE {{ ?o a dyknow:UAV }}"""
SPEED = "stream {name} contains speed(UAV) = speed [m.s-1] for every UAV = id"

COMPUNIT = "compunit {name} transforms a:latitude [deg], b:longitude [deg] to c:speed [m.s-1]"
PREFIXES = """@prefix : <http://www.dyknow.eu/ontology#> .
@prefix dyknow: <http://www.ida.liu.se/dyknow/> .
"""
LISTING = """:{name} a :Transformation ; :hasAnnotation [
  :hasInputAnnotation [ :describesFeature dyknow:latitude ;
    :nextSegment [ :hasInputAnnotation [ :describesFeature dyknow:longitude ] ] ] ;
  :hasOutputAnnotation [ :describesFeature dyknow:speed ; :hasUnit "m.s-1" ] ] ;
  :hasImplementation [ :hasName "coordinatesToSpeed" ] ."""
KNOWN = Engine().totals().transformations
SHIPPED = Engine().totals().ontologies


@pytest.fixture
def settings() -> Settings:
    # The status stream is one of them.
    return Settings(
        port=0,
        tick=0.02,
        sse_ping=0,
        max_streams=4,
        max_templates=1,
        max_requests=3,
        max_declarations=2,
        max_transformations=KNOWN + 1,
        max_ontologies=SHIPPED + 1,
    )


@pytest.fixture
def full(client: Client) -> Client:
    """A service with as many streams as it may have."""
    for name in ("s1", "s2", "s3"):
        client.put_stream(name, FIELDS)
    return client


def refused(problem: ServiceError, setting: str) -> bool:
    return (
        problem.status == 403
        and problem.title == "quota reached"
        and f"{setting} is " in problem.detail
        and f"DYKNOW_{setting.upper()}" in problem.hint
        and "DELETE /" in problem.hint
    )


def test_what_makes_things_is_a_route() -> None:
    assert set(MAKES) <= set(NEEDED)


def test_a_stream_too_many_is_refused_and_others_may_be_changed(full: Client) -> None:
    with pytest.raises(ServiceError) as caught:
        full.put_stream("s4", FIELDS)
    assert refused(caught.value, "max_streams")
    assert full.put_stream("s1", FIELDS)["name"] == "s1"
    assert full.put_stream("s1", FIELDS, idle="5s")["name"] == "s1"
    full.remove_stream("s3")
    assert full.put_stream("s4", FIELDS)["name"] == "s4"


def test_streams_on_demand_count(full: Client, http: httpx.Client, engine: Engine) -> None:
    for path in ("/streams/s1_late", "/streams/s1_late/samples", "/streams/s1_late/events"):
        answer = http.get(path)
        assert answer.status_code == 403, path
        assert answer.json()["title"] == "quota reached"
    with pytest.raises(ServiceError) as caught:
        full.explain(query=QUERY.format(name="q").replace("s1.trdf", "s1_late.trdf"))
    assert refused(caught.value, "max_streams")
    with pytest.raises(ServiceError) as caught:
        full.subscribe("s1_late")
    assert refused(caught.value, "max_streams")
    assert not engine.has_stream("s1_late")
    assert http.get("/streams/nowhere").status_code == 404
    assert http.get("/streams/s2").status_code == 200
    full.remove_stream("s3")
    assert http.get("/streams/s1_late").status_code == 200
    assert http.get("/streams/s1_late/samples").status_code == 200  # it is there now
    with pytest.raises(ServiceError) as caught:
        full.put_stream("s4", FIELDS)
    assert refused(caught.value, "max_streams")


def test_annotations_of_what_is_there_are_taken(full: Client) -> None:
    assert full.annotate(SPEED.format(name="s1"))
    contents = [
        {"feature": "dyknow:speed", "field": "speed", "of": [{"name": "dyknow:UAV", "id": "id"}]}
    ]
    assert full.describe({"stream": "s2", "contents": contents})
    for several in (
        [SPEED.format(name="s9")],
        [SPEED.format(name="s2"), SPEED.format(name="s9")],
    ):
        with pytest.raises(ServiceError) as caught:
            full.annotate("\n".join(several))
        assert refused(caught.value, "max_streams")
    with pytest.raises(ServiceError) as caught:
        full.describe([{"stream": name, "contents": contents} for name in ("s3", "s9")])
    assert refused(caught.value, "max_streams")
    assert {stream["name"] for stream in full.streams()} == {"status", "s1", "s2", "s3"}
    full.remove_stream("s3")
    assert full.annotate(SPEED.format(name="s9"))


def test_templates(client: Client) -> None:
    made = client.register_template(TEMPLATE.format(name="Fast"))
    for replace in (None, "Faster"):
        with pytest.raises(ServiceError) as caught:
            client.register_template(TEMPLATE.format(name="Faster"), replace=replace)
        assert refused(caught.value, "max_templates")
    assert client.register_template(TEMPLATE.format(name="Fast"), replace="Fast") == made
    client.remove_template("Fast")
    assert client.register_template(TEMPLATE.format(name="Faster"))


def test_requests_of_every_kind_count_together(client: Client) -> None:
    client.put_stream("s1", FIELDS)
    client.annotate(SPEED.format(name="s1"))
    client.register_template(TEMPLATE.format(name="Fast"))
    event = client.request_event("dyknow:Fast(?o, dyknow:UAV, 100)")
    subscription = client.subscribe("s1")
    client.register_query(QUERY.format(name="q1"))
    specification = """<spec:specification xmlns:spec="http://www.dyknow.eu/ontology#Specification">
      <spec:insertions><spec:cu name="u" type="coordinatesToSpeed">
      <spec:stream name="s1"/></spec:cu></spec:insertions></spec:specification>"""
    attempts = (
        lambda: client.request_event("dyknow:Fast(?o, dyknow:UAV, 200)"),
        lambda: client.subscribe("s1"),
        lambda: client.subscribe_to("dyknow:speed", sort="dyknow:UAV"),
        lambda: client.register_query(QUERY.format(name="q2")),
        lambda: client.apply_specification(specification),
    )
    for attempt in attempts:
        with pytest.raises(ServiceError) as caught:
            attempt()
        assert refused(caught.value, "max_requests")
    client.cancel_event(event["id"])
    client.unsubscribe(subscription["id"])
    client.remove_query("q1")
    assert client.register_query(QUERY.format(name="q2"))


def test_declarations_in_kpl(client: Client) -> None:
    client.declare_kpl("source float a")
    client.declare_kpl("source float b")
    with pytest.raises(ServiceError) as caught:
        client.declare_kpl("source float c")
    assert refused(caught.value, "max_declarations")
    client.remove_kpl("b")
    assert client.declare_kpl("source float c")


def test_transformations_however_they_are_described(http: httpx.Client) -> None:
    def in_json(name: str) -> httpx.Response:
        annotation = COMPUNIT.format(name=name)
        body = {"annotation": annotation, "implementation": "coordinatesToSpeed"}
        return http.post("/transformations", json=body)

    def in_turtle(method: str, path: str, *names: str) -> httpx.Response:
        text = PREFIXES + "\n".join(LISTING.format(name=name) for name in names)
        return http.request(method, path, content=text, headers={"Content-Type": "text/turtle"})

    def in_ssl(name: str) -> httpx.Response:
        text = COMPUNIT.format(name=name)
        return http.post("/annotations", content=text, headers={"Content-Type": "text/plain"})

    def is_full(answer: httpx.Response) -> bool:
        problem = answer.json()
        return answer.status_code == 403 and "max_transformations is " in problem["detail"]

    assert is_full(in_turtle("POST", "/transformations", "mine", "other"))
    assert in_json("mine").status_code == 201
    assert is_full(in_json("other"))
    assert is_full(in_ssl("other"))
    assert is_full(in_turtle("POST", "/transformations", "other"))
    assert is_full(in_turtle("PUT", "/transformations/other", "other"))
    assert in_ssl("coordinatesToSpeed").status_code == 201
    assert in_turtle("PUT", "/transformations/mine", "mine").status_code == 200
    assert len(http.get("/transformations").json()) == KNOWN + 1
    assert http.delete("/transformations/mine").status_code == 204
    assert in_turtle("POST", "/transformations", "other").status_code == 201


def test_ontologies(http: httpx.Client) -> None:
    def load(name: str) -> httpx.Response:
        text = f"<http://e.org/{name}> a <http://www.w3.org/2002/07/owl#Ontology> ."
        return http.post("/ontologies", content=text, headers={"Content-Type": "text/turtle"})

    assert load("first").status_code == 201
    problem = load("second")
    assert (problem.status_code, problem.json()["title"]) == (403, "quota reached")
    assert "max_ontologies is " in problem.json()["detail"]
    assert load("first").status_code == 201
    assert "http://e.org/second" not in http.get("/ontologies").json()
    assert http.delete("/ontologies/http%3A%2F%2Fe.org%2Ffirst").status_code == 204
    assert load("second").status_code == 201


def test_refusals_are_counted(full: Client, http: httpx.Client) -> None:
    with pytest.raises(ServiceError):
        full.put_stream("s4", FIELDS)
    assert 'dyknow_refusals_total{reason="quota reached"} 1.0' in http.get("/metrics").text


def test_a_service_that_is_recorded_has_quotas_too(tmp_path: Path, settings: Settings) -> None:
    """What is refused is not written down, and what asks for room is no part of the state."""
    recorded = RecordedEngine(tmp_path, now=1)
    with (
        running(create_app(recorded, settings, lambda: 1), settings) as url,
        Client(url) as client,
    ):
        for name in ("s1", "s2", "s3"):
            client.put_stream(name, FIELDS)
        written = recorded.log.position
        with pytest.raises(ServiceError) as caught:
            client.subscribe("s1_late")
        assert refused(caught.value, "max_streams")
        client.remove_stream("s3")
        client.subscribe("s1_late")
    reopened = RecordedEngine(tmp_path, now=2)
    assert reopened.recovery.position > written  # from a checkpoint
    assert reopened.engine.has_stream("s1_late")
    assert reopened.engine.totals().streams == settings.max_streams
    reopened.close()
