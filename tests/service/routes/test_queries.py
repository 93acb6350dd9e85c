"""Continuous queries over HTTP, with the client and on the command line."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import httpx
import pytest
from registering import check_shared_until_the_last_has_left, register
from typer.testing import CliRunner

from dyknow.engine.engine import Engine
from dyknow.service.cli import app
from dyknow.service.client.client import Client, ServiceError
from dyknow.service.config.settings import Settings

DYKNOW = "http://www.ida.liu.se/dyknow/"
TEXT = {"Content-Type": "text/plain"}
SSL = "stream s5 contains speed(UAV) = spd [km.h-1] for every UAV = id"
STREAM = f"FROM STREAM <{DYKNOW}s5.trdf> [RANGE 2s STEP 1s]"
FAST = f"""REGISTER STREAM fast COMPUTE EVERY 1s AS
CONSTRUCT {{ ?o dyknow:speed ?mean }} {STREAM}
WHERE {{ ?o a dyknow:UAV . ?o dyknow:speed ?v . }}
AGGREGATE {{(?mean, AVG, {{?v}}) FILTER (?mean > 100)}}"""
MEANS = f"""REGISTER QUERY means AS
SELECT ?o (AVG(?v) AS ?mean) {STREAM} WHERE {{ ?o dyknow:speed ?v }} GROUP BY ?o"""
ANY = f"""REGISTER QUERY any AS ASK {STREAM} WHERE {{ ?o dyknow:speed ?v FILTER (?v > 100) }}"""
SECOND = 1_000_000_000


@pytest.fixture
def flying(http: httpx.Client) -> httpx.Client:
    """A service with an annotated stream s5."""
    assert http.post("/annotations", content=SSL, headers=TEXT).status_code == 201
    return http


def play(http: httpx.Client) -> None:
    """uav1 at 50, uav2 at 150 km/h, five seconds long, then the end."""
    rows = [
        {"valid": s * SECOND, "available": s * SECOND + i, "id": name, "spd": spd}
        for s in range(1, 6)
        for i, (name, spd) in enumerate((("uav1", 50.0), ("uav2", 150.0)))
    ]
    body = "\n".join(json.dumps(row) for row in rows)
    headers = {"Content-Type": "application/x-ndjson"}
    assert http.post("/streams/s5/samples", content=body, headers=headers).status_code == 202
    http.post("/streams/s5/end")


# -- registering -----------------------------------------------------------------------------


def test_a_query_from_text_to_events(flying: httpx.Client, client: Client) -> None:
    made = register(flying, FAST)
    assert made.status_code == 201, made.text
    assert made.headers["location"] == "/queries/fast"
    told = made.json()
    assert (told["name"], told["kind"], told["form"]) == ("fast", "STREAM", "CONSTRUCT")
    assert told["dialect"] == "C-SPARQL"
    assert told["options"] == {
        "semantics": "bag",
        "bounds": "(]",
        "origin": "1970-01-01T00:00:00Z",
        "report": "non-empty",
        "strategy": "fast",
        "since": "now",
    }
    assert told["events"] == "/streams/fast/events"
    assert told["waits_for"] == ["s5"]
    assert told["fields"] == {"id": "string", "speed": "float"}
    play(flying)
    events = [e for e in client.events("fast", since="start") if e.kind == "sample"]
    assert {event.values["id"] for event in events} == {"uav2"}
    assert f"<{DYKNOW}uav2> <{DYKNOW}speed>" in events[0].rdf
    assert client.query("fast")["state"] == "ended"


def test_the_same_again_is_shared_until_the_last_has_left(flying: httpx.Client) -> None:
    check_shared_until_the_last_has_left(flying, "fast", FAST, FAST)


def test_options_are_parameters(flying: httpx.Client) -> None:
    told = register(
        flying,
        FAST,
        semantics="set",
        bounds="[)",
        origin="1970-01-01T00:00:00.5Z",
        report="change",
        since="start",
    ).json()
    assert told["options"]["semantics"] == "set"
    assert told["options"]["bounds"] == "[)"
    assert told["options"]["origin"] == "1970-01-01T00:00:00.5Z"
    assert (told["options"]["report"], told["options"]["since"]) == ("change", "start")


@pytest.mark.parametrize(
    ("text", "parameters", "status", "words"),
    [
        ("REGISTER QUERY q AS SELECT", {}, 400, "line"),
        (FAST.replace("STREAM fast", "TEMPLATE fast(?o)"), {}, 400, "template"),
        (FAST.replace("s5", "s55"), {}, 404, f"did you mean <{DYKNOW}s5.trdf>"),
        (FAST.replace("s5", "status"), {}, 422, "POST /annotations"),
        (FAST.replace("FROM ST", "FROM <http://x.org/> FROM ST"), {}, 422, "ontology.rdf"),
        (FAST.replace("STREAM fast", "STREAM s5"), {}, 409, "another name"),
        (FAST.replace("STREAM fast", "STREAM dyknow_x"), {}, 403, "the system uses the name"),
        (MEANS.replace("SELECT ?o (AVG(?v) AS ?mean)", "DESCRIBE ?o"), {}, 400, "write CONSTRUCT"),
        (FAST, {"semantics": "list"}, 422, "semantics"),
        (FAST, {"bounds": "[]"}, 422, "bounds"),
        (FAST, {"origin": "noon"}, 400, "origin"),
        (FAST, {"report": "never"}, 422, "report"),
        (FAST, {"strategy": "slow"}, 400, "slow"),
        (
            "REGISTER QUERY q AS SELECT ?h WHERE { ?o dyknow:heading ?h } "
            "WINDOW [RANGE 1s STEP 1s]",
            {},
            422,
            "heading",
        ),
        ("", {}, 400, "empty"),
    ],
)
def test_what_is_refused_says_why(
    flying: httpx.Client, text: str, parameters: dict[str, str], status: int, words: str
) -> None:
    answer = register(flying, text, **parameters)
    assert answer.status_code == status, answer.text
    assert answer.headers["content-type"] == "application/problem+json"
    assert words in answer.text.replace('\\"', '"')
    assert flying.get("/queries").json() == []
    assert {each["name"] for each in flying.get("/streams").json()} == {"s5", "status"}


def test_conflicts(flying: httpx.Client) -> None:
    register(flying, FAST)
    other = register(flying, FAST.replace("100", "120"))
    assert other.status_code == 409
    assert "another text" in other.json()["detail"]
    reader = MEANS.replace("s5.trdf", "fast.trdf")
    assert register(flying, reader).status_code == 201
    used = flying.delete("/queries/fast")
    assert (used.status_code, "query means" in used.json()["detail"]) == (409, True)


def test_bodies_of_other_kinds(flying: httpx.Client) -> None:
    sent = flying.post("/queries", content=FAST, headers={"Content-Type": "application/json"})
    assert sent.status_code == 415
    kind = {"Content-Type": "application/sparql-query"}
    assert flying.post("/queries", content=FAST, headers=kind).status_code == 201


# -- reading ---------------------------------------------------------------------------------


def test_the_text_and_the_stages(flying: httpx.Client) -> None:
    register(flying, FAST)
    plain = {"Accept": "text/plain"}
    assert flying.get("/queries/fast", headers=plain).text.strip() == FAST
    stages = flying.get("/queries/fast?explain=true").json()["explanation"]
    assert "in columns, incrementally" in stages
    assert flying.get("/queries/fast").json()["explanation"] is None
    same = flying.get("/explain", params={"id": "fast"}, headers=plain).text
    assert same == flying.get("/queries/fast?explain=true", headers=plain).text
    assert flying.get("/queries/fats").json()["hint"] == "did you mean fast?"


FORMATS = {
    "application/sparql-results+json": '"vars": ["o", "mean"]',
    "application/json": f'"value": "{DYKNOW}uav2"',
    "application/sparql-results+xml": '<variable name="mean"/>',
    "text/csv": f"o,mean\r\n{DYKNOW}uav",
    "text/tab-separated-values": f"?o\t?mean\n<{DYKNOW}uav",
}


@pytest.mark.parametrize("kind", FORMATS)
def test_a_table_in_each_format(flying: httpx.Client, kind: str) -> None:
    register(flying, MEANS)
    play(flying)
    answer = flying.get("/queries/means/results", headers={"Accept": kind})
    assert answer.status_code == 200
    assert answer.headers["content-type"].partition(";")[0] == kind
    assert answer.headers["dyknow-window-end"] == "1970-01-01T00:00:07Z"
    assert FORMATS[kind] in answer.text


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        ("text/turtle", "dyknow:uav2 dyknow:speed"),
        ("application/n-triples", f"<{DYKNOW}uav2> <{DYKNOW}speed>"),
        ("application/ld+json", f'"@id":"{DYKNOW}uav2"'),
        ("application/rdf+xml", f'<rdf:Description rdf:about="{DYKNOW}uav2">'),
        ("application/trig", "dyknow:uav2 dyknow:speed"),
        ("application/n-quads", f"<{DYKNOW}uav2> <{DYKNOW}speed>"),
    ],
)
def test_a_graph_in_each_format(flying: httpx.Client, kind: str, words: str) -> None:
    register(flying, FAST)
    play(flying)
    answer = flying.get("/queries/fast/results", headers={"Accept": kind})
    assert answer.headers["content-type"].partition(";")[0] == kind
    assert words in answer.text
    many = flying.get("/queries/fast/results?limit=3", headers={"Accept": kind})
    assert words in many.text


@pytest.mark.parametrize("kind", ["application/trig", "application/n-quads"])
def test_windows_are_timestamped_graphs_that_a_stream_of_rdf_takes(
    flying: httpx.Client, kind: str
) -> None:
    register(flying, FAST)
    play(flying)
    windows = flying.get("/queries/fast/results?limit=100", headers={"Accept": kind})
    rows = flying.get("/streams/fast/samples", headers={"Accept": "application/json"}).json()
    sent = flying.post(
        "/streams/copy/samples?create=rdf", content=windows.content, headers={"Content-Type": kind}
    )
    assert sent.json() == {"accepted": len(rows)}
    copied = flying.get("/streams/copy/samples", headers={"Accept": "application/json"}).json()
    assert [each["valid"] for each in copied] == [each["valid"] for each in rows]
    assert len({each["graph"] for each in copied}) == len({each["valid"] for each in rows})


def test_a_graph_that_rdf_xml_cannot_express(flying: httpx.Client) -> None:
    register(flying, FAST.replace("CONSTRUCT { ?o dyknow:speed", "CONSTRUCT { ?o <http://e.org/1>"))
    play(flying)
    refused = flying.get("/queries/fast/results", headers={"Accept": "application/rdf+xml"})
    assert refused.status_code == 400
    assert "<http://e.org/1>" in refused.json()["detail"]
    assert flying.get("/queries/fast/results", headers={"Accept": "text/turtle"}).is_success


def test_an_answer(flying: httpx.Client) -> None:
    register(flying, ANY)
    play(flying)
    assert flying.get("/queries/any/results").json()["boolean"] is True
    csv = {"Accept": "text/csv"}
    assert flying.get("/queries/any/results", headers=csv).status_code == 406
    lines = flying.get("/queries/any/results?from=5000000000", headers=csv).text.split()
    assert lines == [
        "window_end,answer",
        "1970-01-01T00:00:05Z,true",
        "1970-01-01T00:00:06Z,true",
        "1970-01-01T00:00:07Z,true",
    ]


def test_several_windows_are_one_table(flying: httpx.Client) -> None:
    register(flying, MEANS)
    play(flying)
    parameters = {"from": "1970-01-01T00:00:02Z", "to": "3000000000"}
    found = flying.get("/queries/means/results", params=parameters).json()
    assert found["head"]["vars"] == ["window_end", "o", "mean"]
    ends = [row["window_end"]["value"] for row in found["results"]["bindings"]]
    assert ends == [f"1970-01-01T00:00:0{s}Z" for s in (2, 2, 3, 3)]
    assert flying.get("/queries/means/results?from=noon").status_code == 400
    assert flying.get("/queries/means/results?limit=0").status_code == 422


def test_no_result_yet(flying: httpx.Client) -> None:
    register(flying, MEANS)
    answer = flying.get("/queries/means/results")
    assert answer.status_code == 404
    assert answer.json()["type"] == "urn:dyknow:problem:no-result-yet"
    assert answer.json()["hint"] == "it waits for s5"
    assert flying.get("/queries/means/results?limit=5").json()["results"]["bindings"] == []
    wrong = {"Accept": "image/png"}
    assert flying.get("/queries/means/results?limit=5", headers=wrong).status_code == 406
    assert flying.get("/queries/nobody/results").status_code == 404


def test_followers_hear_that_it_was_removed(flying: httpx.Client, client: Client) -> None:
    register(flying, FAST)
    messages = client.events("fast", since="start")
    assert flying.delete("/queries/fast").status_code == 204
    with pytest.raises(ServiceError, match="no stream"):
        list(messages)


def test_the_stream_space_shows_it(flying: httpx.Client, client: Client) -> None:
    register(flying, MEANS)
    found = client.sparql(
        'ASK { ?u dyknow-o:hasOutput ?s . ?s dyknow-o:hasName "means" . '
        "?u dyknow-o:instantiationOf dyknow-o:cSparql }"
    )
    assert found == {"head": {}, "boolean": True}
    assert client.stream("means")["producer"].startswith("dyknow_cu")


# -- an earlier run --------------------------------------------------------------------------


class TestRestart:
    """What cannot be restored is shown with its reason, and can be removed."""

    @pytest.fixture
    def engine(self) -> Engine:
        engine = Engine(epoch="e1")
        engine.annotate(SSL)
        engine.queries.register(FAST)
        kept = dict(engine.ontology.registered.queries)
        engine.queries.remove("fast")
        engine.ontology.registered.queries["fast"] = kept["fast"].replace("s5.trdf", "s6.trdf")
        engine.queries.recall()
        engine.queries.restore(lambda name: None)
        return engine

    def test_it_is_listed(self, http: httpx.Client) -> None:
        (told,) = http.get("/queries").json()
        assert (told["state"], told["stream"], told["plan"]) == ("not restored", None, None)
        assert "names no stream" in told["failure"]
        assert http.get("/queries/fast/results").status_code == 404
        assert http.get("/queries/fast?explain=true").status_code == 404
        assert http.delete("/queries/fast").status_code == 204
        assert http.get("/queries").json() == []


# -- client and command line -----------------------------------------------------------------


def test_the_client_has_the_verbs(flying: httpx.Client, client: Client) -> None:
    assert client.register_query(MEANS, bounds="[)", since="start")["users"] == 1
    assert client.register_query(ANY)["form"] == "ASK"
    assert client.register_query(FAST)["form"] == "CONSTRUCT"
    play(flying)
    assert [query["name"] for query in client.queries()] == ["means", "any", "fast"]
    table = client.query_results("means")
    assert isinstance(table, dict)
    assert table["head"]["vars"] == ["o", "mean"]
    graph = client.query_results("fast", limit=2)
    assert isinstance(graph, str)
    assert "dyknow:uav2" in graph
    assert client.query_results_text("means", limit=1).startswith("window_end,o,mean")
    assert "units" in client.query("means", explain=True)["explanation"]
    client.remove_query("means")
    with pytest.raises(ServiceError, match="no query"):
        client.query("means")


def test_on_the_command_line(dyknow: Any, flying: httpx.Client, tmp_path: Path) -> None:
    path = tmp_path / "means.rq"
    path.write_text(MEANS)
    assert "no queries yet" in dyknow("query", "list").stdout
    added = dyknow("query", "add", str(path)).stdout
    assert "registered means" in added
    assert "dyknow follow means" in added
    assert "shared by 2" in dyknow("query", "add", MEANS).stdout
    assert "waits for s5" in dyknow("query", "results", "means", status=1).stderr
    assert "no sample read yet from s5" in dyknow("query", "show", "means").stdout
    dyknow("query", "add", FAST, "--bounds", "[)", "--origin", "500000000", "--report", "close")
    play(flying)
    listed = dyknow("query", "list").stdout
    assert "1970-01-01T00:00:07Z" in listed
    shown = dyknow("query", "results", "means").stdout
    assert "window that ends 1970-01-01T00:00:07Z" in shown
    assert "dyknow:uav2  150" in shown
    assert "(1 row)" in shown
    several = dyknow("query", "results", "means", "--limit", "2").stdout
    assert "window_end" in several
    assert "dyknow:uav2" in dyknow("query", "results", "fast", "--limit", "9").stdout
    assert "o,mean" in dyknow("query", "results", "means", "--format", "csv").stdout
    assert json.loads(dyknow("query", "results", "means", "--json").stdout)["head"]
    assert "at 1970-01-01T00:00:00.5Z and so on" in dyknow("query", "show", "fast").stdout
    assert "evaluation" in dyknow("query", "show", "fast", "--explain").stdout
    assert json.loads(dyknow("query", "list", "--json").stdout.splitlines()[0])["name"] == "means"
    assert "runs on for 1" in dyknow("query", "remove", "means").stdout
    assert "removed means" in dyknow("query", "remove", "means").stdout
    assert "did you mean fast" in dyknow("query", "show", "fasst", status=1).stderr


def test_how_the_command_run_reads_a_text(tmp_path: Path) -> None:
    iri = f"{DYKNOW}s5.trdf"
    query, data, graph = tmp_path / "q.rq", tmp_path / "s5.csv", tmp_path / "sorts.ttl"
    query.write_text(
        f"REGISTER QUERY q AS SELECT ?o (COUNT(?v) AS ?n) FROM <http://x.org/sorts> {STREAM} "
        "WHERE { ?o a <http://x.org/Fast> . ?o dyknow:speed ?v } GROUP BY ?o"
    )
    data.write_text("time,s,p,o\n1000000000,dyknow:uav1,dyknow:speed,5\n")
    graph.write_text(f"<{DYKNOW}uav1> a <http://x.org/Fast> .")
    base = ["run", str(query), "--stream", f"{iri}={data}", "--json"]

    def ends(*arguments: str, status: int = 0) -> list[str]:
        result = CliRunner().invoke(app, [*base, *arguments])
        assert result.exit_code == status, (result.output, result.exception)
        return [json.loads(line)["end"][17:] for line in result.stdout.splitlines()]

    named = ["--static", f"http://x.org/sorts={graph}"]
    assert ends(*named) == ["01Z", "02Z"]
    assert ends(*named, "--bounds", "[)") == ["02Z", "03Z"]
    assert ends(*named, "--origin", "500000000") == ["01.5Z", "02.5Z"]
    assert ends(*named, "--report", "change") == ["01Z"]
    assert ends("--static", str(graph)) == ["01Z", "02Z"]
    assert ends("--static", f"http://x.org/other={graph}", status=1) == []
    assert ends(*named, "--static", str(graph), status=2) == []
    assert ends(*named, "--origin", "noon", status=2) == []
    assert ends(*named, *named, status=2) == []
    assert ends("--stream", f"{iri}={data}", status=2) == []
    assert ends("--static", "http://x.org/sorts=nowhere.ttl", status=1) == []


def test_a_result_has_so_many_bytes(flying: httpx.Client, settings: Settings) -> None:
    """A text that many solutions share is kept once: some kilobytes may stand for gigabytes."""
    register(flying, MEANS)
    register(flying, FAST)
    play(flying)
    settings.sparql_bytes = 100  # of one window about ninety
    assert flying.get("/queries/means/results").status_code == 200
    assert flying.get("/queries/fast/results").status_code == 200
    answer = flying.get("/queries/means/results?limit=5")
    assert (answer.status_code, answer.json()["title"]) == (422, "result too large")
    settings.sparql_bytes = 10
    for name in ("means", "fast"):
        answer = flying.get(f"/queries/{name}/results")
        assert answer.status_code == 422
        assert answer.json()["detail"] == "the result has more than 10 bytes"
