"""Names beyond ASCII, namespaces that are none, and a stream that changes while a body comes."""

import json
from collections.abc import Iterator
from urllib.parse import quote

import httpx
import pyarrow as pa
import pytest
from asking import asking

TEMPLATE = """REGISTER TEMPLATE {name}(?o) COMPUTE EVERY 1s AS
PREFIX dyknow: <http://www.ida.liu.se/dyknow/>
CONSTRUCT {{?o dyknow:speed ?spd}}
WHERE {{ ?o a dyknow:UAV . ?o dyknow:speed ?spd }}
WINDOW [RANGE 5s STEP 1s]"""
TEXT = {"Content-Type": "text/plain"}
LINES = {"Content-Type": "application/x-ndjson"}


def fields(*named: tuple[str, str]) -> dict[str, object]:
    return {"fields": [{"name": name, "type": kind} for name, kind in named]}


@pytest.mark.parametrize("name", ["dyknow:Συμβάν", "<http://ex.org/ns#Foo>", "<http://ex.org/é>"])
def test_the_location_of_a_template_leads_to_it(http: httpx.Client, name: str) -> None:
    text = TEMPLATE.format(name=name)
    made = http.post("/templates", content=text.encode(), headers=TEXT)
    assert made.status_code == 201
    location = made.headers["Location"]
    assert http.get(location).json() == made.json()
    assert http.put(location, content=text.encode(), headers=TEXT).status_code == 200
    assert http.delete(location).status_code == 204


def test_a_template_is_put_under_any_of_its_names(http: httpx.Client) -> None:
    text = TEMPLATE.format(name="dyknow:Fast")
    for name in ("Fast", "dyknow:Fast", quote("http://www.ida.liu.se/dyknow/Fast", safe="")):
        answer = http.put(f"/templates/{name}", content=text, headers=TEXT)
        assert answer.status_code in (200, 201), answer.text


@pytest.mark.parametrize("strategy", ["cheap", "cost:colour=1"])
def test_a_strategy_that_is_not_served_is_a_client_error(http: httpx.Client, strategy: str) -> None:
    answer = http.post("/match", json={"feature": "speed", "strategy": strategy})
    assert answer.status_code == 400
    assert strategy.partition(":")[0] in answer.json()["detail"]
    assert http.get(f"/explain?feature=speed&strategy={strategy}").status_code == 400


@pytest.mark.parametrize("namespace", ["not an iri", "http://x y/", "<"])
def test_a_namespace_is_an_iri(http: httpx.Client, namespace: str) -> None:
    declaration = fields(("id", "string")) | {"namespace": namespace}
    answer = http.put("/streams/z", json=declaration)
    assert answer.status_code == 400
    assert "not an IRI" in answer.json()["detail"]
    assert http.get("/streams/z").status_code == 404


NO_NAMES = ['a"b', "a\\b", "a\bc", "a\0", "", "a" * 201]


@pytest.mark.parametrize("name", NO_NAMES)
def test_what_no_field_is_called(http: httpx.Client, name: str) -> None:
    """In JSON it would be spelled in another way, which the reader of samples does not know."""
    answer = http.put("/streams/z", json=fields((name, "float")))
    assert answer.status_code == 422
    assert "a field cannot be called" in answer.text
    http.post("/kpl", content="source Whatever open", headers=TEXT).raise_for_status()
    table = pa.table({"valid": [1], "available": [1], name: [1.0]})
    sink = pa.BufferOutputStream()
    with pa.ipc.new_stream(sink, table.schema) as writer:
        writer.write_table(table)
    for kind, body in (
        (LINES["Content-Type"], json.dumps({"valid": 1, "available": 1, name: 1.0})),
        ("application/vnd.apache.arrow.stream", sink.getvalue().to_pybytes()),
    ):
        answer = http.post("/streams/open/samples", content=body, headers={"Content-Type": kind})
        assert answer.status_code == 400
        assert "a field cannot be called" in answer.json()["detail"]
    assert http.get("/streams/open").json()["fields"] == []


def test_samples_fit_the_stream_that_is_there_when_the_body_is_complete(
    http: httpx.Client, url: str
) -> None:
    http.put("/streams/z", json=fields(("id", "string"), ("spd", "float")))

    def body() -> Iterator[bytes]:
        yield b'{"valid": 1, "id": "uav1", '
        with asking(url) as other:
            answer = other.put("/streams/z", json=fields(("id", "string"), ("alt", "integer")))
            assert answer.status_code == 200
        yield b'"alt": 5}\n'

    answer = http.post("/streams/z/samples", content=body(), headers=LINES)
    assert (answer.status_code, answer.json()) == (202, {"accepted": 1})
    (sample,) = http.get("/streams/z/samples", headers={"Accept": "application/json"}).json()
    assert sample["id"] == "uav1"
    assert sample["alt"] == 5
