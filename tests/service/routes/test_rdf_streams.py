"""RDF in over HTTP: a stream of statements is published as it is, and queried without an
annotation."""

from __future__ import annotations

import json

import httpx
import pytest

from dyknow.service.workers import json_ld

NTRIPLES, NQUADS, TRIG = "application/n-triples", "application/n-quads", "application/trig"
TURTLE, JSON_LD = "text/turtle", "application/ld+json"
PROV = "http://www.w3.org/ns/prov#generatedAtTime"
SOSA = "http://www.w3.org/ns/sosa/"
QUERY = """PREFIX : <http://example.org/>
REGISTER QUERY fast AS
SELECT ?o (AVG(?v) AS ?mean)
FROM STREAM dyknow:speeds [RANGE 2s STEP 1s]
WHERE { ?o :speed ?v } GROUP BY ?o HAVING (?mean > 100)"""
GRAPHS = f"""PREFIX : <http://example.org/>
PREFIX prov: <http://www.w3.org/ns/prov#>
PREFIX xsd: <http://www.w3.org/2001/XMLSchema#>
:g1 {{ :uav1 :speed 90 . :uav2 :speed 80.5 }}
:g2 {{ :uav1 :speed 130 ; :name "x" , "ö"@de . [] :of :uav1 }}
:g1 <{PROV}> "2021-05-01T12:00:01Z"^^xsd:dateTime .
:g2 <{PROV}> "2021-05-01T12:00:02Z"^^xsd:dateTime .
"""


def send(
    http: httpx.Client, body: str | bytes, kind: str, stream: str = "speeds", **query: str
) -> httpx.Response:
    return http.post(
        f"/streams/{stream}/samples", content=body, headers={"Content-Type": kind}, params=query
    )


def samples(http: httpx.Client, stream: str = "speeds") -> list[dict[str, object]]:
    found = http.get(f"/streams/{stream}/samples", headers={"Accept": "application/json"})
    return list(found.json())


@pytest.fixture
def rdf(http: httpx.Client) -> httpx.Client:
    """A service with the stream ``speeds`` of RDF."""
    answer = http.put("/streams/speeds", json={"kind": "rdf"})
    assert answer.status_code == 201, answer.text
    assert answer.json()["kind"] == "rdf"
    return http


def test_timestamped_graphs_are_queried_without_an_annotation(rdf: httpx.Client) -> None:
    added = rdf.post("/queries", content=QUERY, headers={"Content-Type": "text/plain"})
    assert added.status_code == 201, added.text
    answer = send(rdf, GRAPHS, TRIG)
    assert (answer.status_code, answer.json()) == (202, {"accepted": 6})
    rdf.post("/streams/speeds/end")
    found = samples(rdf, "fast")
    assert [(each["o"], each["mean"]) for each in found] == [
        ("http://example.org/uav1", 110),
        ("http://example.org/uav1", 130),
    ]


def test_statements_are_samples_with_terms_and_numbers(rdf: httpx.Client) -> None:
    assert send(rdf, GRAPHS, TRIG).status_code == 202
    first, *_, last = samples(rdf)
    assert first == {
        "available": "2021-05-01T12:00:01Z",
        "valid": "2021-05-01T12:00:01Z",
        "subject": "<http://example.org/uav1>",
        "predicate": "<http://example.org/speed>",
        "object": None,
        "number": 90,
        "datatype": "integer",
        "graph": "<http://example.org/g1>",
    }
    assert last["object"] == "<http://example.org/uav1>"
    history = rdf.get("/streams/speeds/samples", headers={"Accept": NTRIPLES}).text
    assert '<http://example.org/uav1> <http://example.org/name> "ö"@de .\n' in history
    assert '"80.5"^^<http://www.w3.org/2001/XMLSchema#decimal>' in history


@pytest.mark.parametrize(
    ("kind", "text"),
    [
        (NTRIPLES, "<urn:a> <urn:p> <urn:b> .\n<urn:a> <urn:p> _:x .\n_:x <urn:p> _:y .\n"),
        (NQUADS, "<urn:a> <urn:p> <urn:b> <urn:g> .\n<urn:a> <urn:p> _:x .\n_:x <urn:p> _:y .\n"),
        (TURTLE, "<urn:a> <urn:p> <urn:b>, [ <urn:p> [] ] ."),
        (TRIG, "<urn:g> { <urn:a> <urn:p> <urn:b> } <urn:a> <urn:p> [ <urn:p> [] ] ."),
        (
            JSON_LD,
            json.dumps({"@id": "urn:a", "urn:p": [{"@id": "urn:b"}, {"urn:p": [{}]}]}),
        ),
    ],
)
def test_all_formats_come_in_and_have_the_time_of_arrival(
    rdf: httpx.Client, kind: str, text: str
) -> None:
    for _ in range(2):
        assert send(rdf, text, kind).json() == {"accepted": 3}
    found = samples(rdf)
    times = [each["available"] for each in found]
    assert times == [each["valid"] for each in found]
    assert len(set(times)) == 2
    nodes = [
        {str(each[name]) for each in part for name in ("subject", "object")}
        - {"<urn:a>", "<urn:b>"}
        for part in (found[:3], found[3:])
    ]
    assert [len(each) for each in nodes] == [2, 2]
    assert not nodes[0] & nodes[1], "blank nodes of two texts are two"


def test_a_time_property_gives_times(http: httpx.Client) -> None:
    http.put("/streams/obs", json={"kind": "rdf", "time": SOSA + "resultTime"})
    observation = f"""PREFIX sosa: <{SOSA}> PREFIX xsd: <http://www.w3.org/2001/XMLSchema#>
    <urn:o2> sosa:resultTime "2021-05-01T12:00:02Z"^^xsd:dateTime ; sosa:madeBySensor <urn:s> .
    <urn:o1> sosa:resultTime "2021-05-01T12:00:01Z"^^xsd:dateTime ; sosa:madeBySensor <urn:s> ;
       sosa:hasResult [ <urn:value> 5 ] .
    <urn:s> a sosa:Sensor ."""
    assert send(http, observation, TURTLE, "obs").json() == {"accepted": 7}
    found = samples(http, "obs")
    assert [str(each["valid"])[17:19] for each in found] == ["01"] * 5 + ["02"] * 2
    lost = send(http, "<urn:x> <urn:p> 1 .", TURTLE, "obs")
    assert lost.status_code == 400
    assert "<urn:x> has no time" in lost.json()["detail"]
    assert len(samples(http, "obs")) == 7


def test_a_stream_of_rdf_is_made_by_its_first_batch(http: httpx.Client) -> None:
    assert send(http, "<urn:a> <urn:p> 1 .", TURTLE, "new").status_code == 404
    assert send(http, "<urn:a> <urn:p> 1 .", TURTLE, "new", create="rdf").status_code == 202
    assert http.get("/streams/new").json()["kind"] == "rdf"
    assert send(http, "<urn:a> <urn:p> 2 .", TURTLE, "new", create="rdf").status_code == 202
    assert len(samples(http, "new")) == 2


@pytest.mark.parametrize(
    ("kind", "text", "line", "told"),
    [
        (NTRIPLES, "<urn:a> <urn:p> 1 .\n", 1, "column"),
        (NQUADS, "<urn:a> <urn:p> <urn:b> .\n<urn:a> <urn:p> oops .\n", 2, "column"),
        (TURTLE, "<urn:a> <urn:p> << <urn:a> <urn:p> 1 >> .", 1, "triples about triples"),
        (TURTLE, "<urn:a> <urn:p> " + "[ <urn:p> " * 200 + "1" + "]" * 200 + " .", 1, "nested"),
        (JSON_LD, '{"@context": "http://example.org/c", "urn:p": 1}', None, "never fetched"),
        (JSON_LD, '{"urn:p":' * 50_000 + "1" + "}" * 50_000, 1, "nested"),
        (NTRIPLES, "<urn:a> <urn:p> " + "<<( <urn:a> <urn:p> " * 50_000, 1, "triples about"),
        (
            TRIG,
            f'<urn:g> {{ <urn:a> <urn:p> 1 }} <urn:h> <{PROV}> "2021-05-01T12:00:01Z"'
            "^^<http://www.w3.org/2001/XMLSchema#dateTime> .",
            None,
            "graph <urn:g> has no time",
        ),
    ],
)
def test_a_bad_text_is_refused_whole(
    rdf: httpx.Client, kind: str, text: str, line: int | None, told: str
) -> None:
    answer = send(rdf, text, kind)
    assert answer.status_code == 400, answer.text
    assert told in answer.json()["detail"]
    assert answer.json().get("line") == line
    assert samples(rdf) == []


def test_samples_of_a_stream_of_rdf_are_checked(rdf: httpx.Client) -> None:
    row = {
        "valid": "2021-05-01T12:00:01Z",
        "available": "2021-05-01T12:00:01Z",
        "subject": "<urn:a>",
        "predicate": "<urn:p>",
        "object": '"5"^^<http://www.w3.org/2001/XMLSchema#integer>',
        "number": None,
        "datatype": None,
        "graph": None,
    }
    assert send(rdf, json.dumps(row), "application/x-ndjson").status_code == 202
    for name, value, told in [
        ("subject", '"a"', "is no IRI or blank node"),
        ("subject", "<urn:a", "is no IRI or blank node"),
        ("predicate", "_:b", "is no IRI"),
        ("object", "<<( <urn:a> <urn:p> <urn:b> )>>", "is no term"),
        ("object", "<urn:a> .\n<urn:b> <urn:c> <urn:d>", "is no term"),
        ("object", None, "either an object or a number"),
        ("number", 5, "either an object or a number"),
        ("datatype", "integer", "a number has a datatype"),
        ("subject", None, "a statement has a subject"),
    ]:
        answer = send(rdf, json.dumps(row | {name: value}), "application/x-ndjson")
        assert answer.status_code == 400, name
        assert told in answer.json()["detail"]
        assert answer.json()["line"] == 1
    assert len(samples(rdf)) == 1


def test_declarations_of_streams_of_rdf(rdf: httpx.Client) -> None:
    for body, told in [
        ({"kind": "rdf", "fields": {"id": "string"}}, "fields of its own"),
        ({"fields": {}}, "at least one field"),
        ({"fields": {"id": "string"}, "time": "urn:t"}, "streams of RDF"),
    ]:
        answer = rdf.put("/streams/other", json=body)
        assert answer.status_code == 422, answer.text
        assert told in answer.text
    assert rdf.put("/streams/speeds", json={"kind": "rdf"}).status_code == 200
    send(rdf, "<urn:a> <urn:p> 1 .", TURTLE)
    changed = rdf.put("/streams/speeds", json={"kind": "rdf", "time": "urn:t"})
    assert changed.status_code == 409
    assert "its times come from no property" in changed.json()["detail"]
    annotated = rdf.post(
        "/annotations",
        content="stream speeds contains speed(UAV) = number for every UAV = subject",
        headers={"Content-Type": "text/plain"},
    )
    assert annotated.status_code == 403
    assert "says itself what it means" in annotated.json()["detail"]


def test_rdf_to_a_stream_of_samples_is_a_conflict(http: httpx.Client) -> None:
    http.put("/streams/s", json={"fields": {"id": "string"}})
    answer = send(http, "<urn:a> <urn:p> 1 .", TURTLE, "s")
    assert answer.status_code == 409
    assert '{"kind": "rdf"}' in answer.json()["hint"]


def test_an_empty_query_does_not_ask_for_an_annotation(rdf: httpx.Client) -> None:
    rdf.post("/queries", content=QUERY, headers={"Content-Type": "text/plain"})
    send(rdf, GRAPHS.replace(":speed", ":height"), TRIG)
    rdf.post("/streams/speeds/end")
    told = rdf.get("/queries/fast").json()["empty"]
    assert "6 samples read, 6 triples" in told
    assert "annotated" not in told


@pytest.mark.parametrize("kind", [NQUADS, TRIG, JSON_LD])
def test_the_history_is_timestamped_graphs_that_come_in_again(rdf: httpx.Client, kind: str) -> None:
    rdf.put("/streams/copy", json={"kind": "rdf"})
    send(rdf, GRAPHS, TRIG)
    written = rdf.get("/streams/speeds/samples", headers={"Accept": kind})
    assert written.headers["content-type"].startswith(kind)
    assert send(rdf, written.content, kind, "copy").status_code == 202
    nodes = "of>"
    first, second = samples(rdf), samples(rdf, "copy")
    assert [e for e in first if nodes not in str(e["predicate"])] == [
        e for e in second if nodes not in str(e["predicate"])
    ]
    assert len(first) == len(second)


def test_annotated_samples_are_timestamped_graphs_too(http: httpx.Client) -> None:
    http.put("/streams/s", json={"fields": {"id": "string", "spd": "float", "graph": "string"}})
    http.post(
        "/annotations",
        content="stream s contains speed(UAV) = spd [km.h-1] for every UAV = id",
        headers={"Content-Type": "text/plain"},
    )
    row = {"valid": 1, "available": 2, "id": "u", "spd": 5, "graph": "nothing of RDF"}
    assert send(http, json.dumps(row), "application/x-ndjson", "s").status_code == 202
    written = http.get("/streams/s/samples", headers={"Accept": TRIG}).text
    graph = "<http://www.ida.liu.se/dyknow/s/1970-01-01T00:00:00.000000002Z>"
    assert written.splitlines() == [
        f'{graph} <{PROV}> "1970-01-01T00:00:00.000000002Z"'
        "^^<http://www.w3.org/2001/XMLSchema#dateTime> .",
        f"{graph} {{ <http://www.ida.liu.se/dyknow/u> <http://www.ida.liu.se/dyknow/speed> "
        '"5"^^<http://www.w3.org/2001/XMLSchema#double> . }',
    ]


def test_json_ld_that_ends_or_occupies_its_worker_harms_nobody(
    rdf: httpx.Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(json_ld, "SECONDS", 1.0)
    chain = {f"c{i}": f"c{i + 1}:x" for i in range(20_000)} | {"c20000": "urn:z"}
    ends = send(rdf, json.dumps({"@context": chain, "c0": 1}), JSON_LD)
    assert (ends.status_code, "stopped" in ends.json()["detail"]) == (400, True), ends.text
    terms = {f"t{i}": f"urn:t{i}" for i in range(6_000)}
    scoped = {**terms, "p": {"@id": "urn:p", "@context": {"a": "urn:a"}}}
    many = [{"p": {"a": 1}}] * 6_000
    takes_long = send(rdf, json.dumps({"@context": scoped, "@graph": many}), JSON_LD)
    assert takes_long.status_code == 400, takes_long.text
    assert "stopped" in takes_long.json()["detail"]
    assert samples(rdf) == []
    assert send(rdf, '{"@id": "urn:a", "urn:p": 1}', JSON_LD).status_code == 202


def test_json_ld_may_be_sent_again_under_its_key(rdf: httpx.Client) -> None:
    text = '{"@id": "urn:a", "urn:p": {"urn:q": [1, {}]}}'
    for _ in range(2):
        answer = rdf.post(
            "/streams/speeds/samples",
            content=text,
            headers={"Content-Type": JSON_LD, "Idempotency-Key": "k"},
        )
        assert answer.json() == {"accepted": 3}
    assert len(samples(rdf)) == 3
