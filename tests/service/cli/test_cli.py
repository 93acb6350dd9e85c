"""The command line against a live service, and `run` without one."""

from __future__ import annotations

import gzip
import json
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner, Result

from dyknow.service.cli import app
from dyknow.service.cli.recordings.triples_file import read_timed_triples
from dyknow.service.client.client import Client
from dyknow.templates.library import shipped_texts

TEMPLATE = """REGISTER TEMPLATE dyknow:HighSpeedEvent(?o, ?type, ?threshold) COMPUTE EVERY 1s AS
PREFIX dyknow: <http://www.ida.liu.se/dyknow/>
CONSTRUCT {?o dyknow:speed ?avgSpeed}
WHERE { ?o a ?type . ?o dyknow:speed ?spd . }
AGGREGATE {(?avgSpeed, AVG, {?spd}) FILTER (?avgSpeed > ?threshold)}
WINDOW [RANGE 5s STEP 1s]
"""
SSL = "stream s5 contains speed(UAV) = spd [km.h-1] for every UAV = id"
REQUEST = "dyknow:HighSpeedEvent(?o, dyknow:UAV, 100)"


@pytest.fixture
def table(tmp_path: Path) -> Path:
    """Twenty seconds of two aircraft: uav1 at 50, uav2 at 150 km/h."""
    path = tmp_path / "speeds.csv"
    rows = [
        f"{1_633_633_973_000 + i * 500},uav{i % 2 + 1},{50 + 100 * (i % 2)}.0" for i in range(40)
    ]
    path.write_text("\n".join(["timestamp,id,spd", *rows]) + "\n")
    return path


@pytest.fixture
def template(tmp_path: Path) -> str:
    path = tmp_path / "high_speed.rq"
    path.write_text(TEMPLATE)
    return str(path)


def lines(result: Result) -> list[Any]:
    return [json.loads(line) for line in result.stdout.splitlines()]


def test_from_a_table_to_events(dyknow: Any, table: Path, template: str, client: Client) -> None:
    client.put_stream("s5", {"id": "string", "spd": "float"})
    dyknow("annotate", SSL)
    dyknow("template", "add", template)
    dyknow("events", REQUEST, "--no-follow", "--keep")
    played = dyknow("replay", str(table), "--stream", "s5", "--speed", "max", "--json")
    counts = lines(played)[0]
    assert (counts["accepted"], counts["used"], counts["late"]) == (40, 40, 0)
    found = dyknow("events", REQUEST, "--json", "--keep", "--since", "start")
    samples = [line for line in lines(found) if line["event"] == "sample"]
    assert samples
    assert lines(found)[-1]["event"] == "end"
    assert all("uav2" in sample["rdf"] for sample in samples)
    one = dyknow("events", REQUEST, "-n", "1", "--since", "start")
    assert "uav2" in one.stdout
    assert "request" in one.stderr
    listed = dyknow("events", "--json")
    assert len(lines(listed)) == 2  # the last one was given up when its following ended
    assert "HighSpeedEvent" in dyknow("events").stdout


def test_annotate_ask_then_play(dyknow: Any, template: str, client: Client, tmp_path: Path) -> None:
    """The table has a column more than the annotation speaks of; samples may be 5 s late."""
    path = tmp_path / "more.csv"
    rows = [f"{1_633_633_973_000 + i * 500},uav2,150.0,{i}" for i in range(20)]
    path.write_text("\n".join(["timestamp,id,spd,alt", *rows]) + "\n")
    dyknow("template", "add", template)
    dyknow("annotate", SSL)
    dyknow("events", REQUEST, "--no-follow", "--keep")
    play = ("replay", str(path), "--stream", "s5", "--speed", "max", "--json")
    assert lines(dyknow(*play, "--lateness", "5s"))[0]["used"] == 20
    found = dyknow("events", REQUEST, "--json", "--keep", "--since", "start")
    assert [line["event"] for line in lines(found)].count("sample") == 15
    stream = client.stream("s5")
    assert stream["annotation"] == SSL
    assert stream["lateness"] == "5s"
    # Once more in a table of fewer columns: what it lacks is named.
    path.write_text("timestamp,id\n1,uav2\n")
    refused = dyknow(*play, status=1)
    assert "lacks its field 'spd'" in refused.stderr


def test_silence_has_a_reason(dyknow: Any, table: Path, template: str) -> None:
    other = SSL.replace("stream s5", "stream s6")
    played = dyknow(
        "replay", str(table), "--stream", "s5", "--speed", "max", "--ssl", f"{SSL}\n{other}"
    )
    assert "'s6', which is not played; played: s5" in played.stderr
    dyknow("template", "add", template)
    none = dyknow("events", REQUEST.replace("100", "1000"), "--since", "start")
    assert "nothing came: 40 samples read, 40 triples: none of" in none.stderr


@pytest.mark.parametrize(
    ("query", "hints"),
    [
        (
            "SELECT * { ?x dyknow:sped ?y }",
            ["nothing is called dyknow:sped; did you mean dyknow:speed?"],
        ),
        (
            "PREFIX d: <http://www.dyknow.eu/ontology#> ASK { ?s a d:Stram # d:Unknown\n}",
            ["nothing is called dyknow-o:Stram; did you mean dyknow-o:Stream"],
        ),
        (
            "CONSTRUCT { ?x a ?y } { ?x <http://www.ida.liu.se/dyknow/zzzzzzzz> ?y }",
            ["nothing is called dyknow:zzzzzzzz"],
        ),
        (
            "SELECT (COUNT(?x) AS ?n) (SUM(?v) AS ?sum) (MAX(?v) AS ?most) { ?x dyknow:sped ?v }",
            ["nothing is called dyknow:sped; did you mean dyknow:speed?"],
        ),
        (
            "SELECT (COUNT(*) AS ?n) { ?x a dyknow:Uav }",
            ["nothing is called dyknow:Uav; did you mean dyknow:UAV"],
        ),
        ("SELECT (COUNT(*) AS ?n) { ?x dyknow:sped 1 } GROUP BY ?x", ["nothing is called"]),
        ("SELECT (COUNT(*) AS ?n) { ?x a dyknow:UAV }", []),
        ("SELECT (COUNT(*) AS ?n) { ?x a ?y FILTER (?y != dyknow:Uav) }", []),
        ("SELECT * { ?x dyknow:speed 'dyknow:sped' }", []),
        ("SELECT * { dyknow:speed a ?kind OPTIONAL { ?x dyknow:sped ?y } }", []),
    ],
)
def test_sparql_suggests_terms_where_it_finds_nothing(
    dyknow: Any, query: str, hints: list[str]
) -> None:
    said = dyknow("sparql", query).stderr.splitlines()
    assert len(said) == len(hints)
    assert all(line.startswith(f"hint: {hint}") for line, hint in zip(said, hints, strict=True))


def test_no_plan_says_each_cause_once(dyknow: Any, template: str) -> None:
    dyknow("template", "add", template)
    dyknow("annotate", SSL.replace("speed(UAV)", "altitude(UAV)").replace("km.h-1", "ft"))
    refused = dyknow("events", REQUEST, status=1).stderr
    for cause in ("gives dyknow:latitude", "gives dyknow:longitude"):
        assert refused.count(cause) == 1, refused
    assert "no stream and no transformation answers dyknow:HighSpeedEvent" in refused
    tried = dyknow("match", "altitude", "--sort", "Car", status=1).stdout
    assert tried.count("sort dyknow:UAV is not a dyknow:Car") == 1, tried
    assert "failed: stream s5 : altitude [ft] for every UAV = id\n" in tried


def test_an_object_by_its_id(dyknow: Any, client: Client) -> None:
    """An id without a prefix is one of the streams' object namespace, as in samples."""
    fleet = "http://example.org/fleet/"
    client.put_stream("s5", {"id": "string", "spd": "float"}, namespace=fleet)
    dyknow("annotate", SSL)
    found = client.subscribe_to("speed", objects=["39b415"])
    client.publish("s5", [{"valid": 1, "available": 1, "id": "39b415", "spd": 5}])
    client.publish("s5", [{"valid": 2, "available": 2, "id": "uav2", "spd": 6}])
    samples = client.history(found["stream"])
    assert [(s["object"], s["speed"]) for s in samples] == [(fleet + "39b415", 5.0)]
    assert "39b415" in dyknow("match", "speed", "--object", "39b415").stdout


def test_replay_for_people_declares_annotates_and_ends(
    dyknow: Any, table: Path, client: Client
) -> None:
    # The service's clock stands in 2021.
    words = ("replay", str(table), "--stream", "s5", "--speed", "max")
    first = dyknow(*words, "--ssl", SSL, "--ahead", "oo")
    assert "40 samples accepted" in first.stdout
    assert "used 40" in first.stdout
    view = client.stream("s5")
    assert view["ended"] is True
    assert view["annotation"] == SSL
    assert {f["name"]: f["type"] for f in view["fields"]} == {"id": "string", "spd": "float"}
    again = dyknow("replay", str(table), "--stream", "s5", "--speed", "max")
    assert "used 0" in again.stdout
    assert "--rebase now" in again.stdout
    rebased = dyknow("replay", str(table), "--stream", "s5", "--speed", "max", "--rebase", "now")
    assert "used 40" in rebased.stdout


@pytest.fixture
def unsorted(table: Path, tmp_path: Path) -> Path:
    """The same table object by object, as databases export them."""
    head, *rows = table.read_text().splitlines()
    path = tmp_path / "unsorted.csv"
    path.write_text("\n".join([head, *sorted(rows, key=lambda row: row.split(",")[1])]) + "\n")
    return path


def test_replay_sorts_a_table_and_says_so(dyknow: Any, unsorted: Path, client: Client) -> None:
    command = ("replay", str(unsorted), "--speed", "max")
    played = dyknow(*command, "--stream", "s5")
    assert "s5: sorted: 19 of 40 rows were out of order" in played.stderr
    assert "out of order" not in played.stdout
    values = [row["id"] for row in client.history("s5", start=0, limit=4)]
    assert values == ["uav1", "uav2"] * 2
    left = dyknow(*command, "--stream", "left", "--no-sort")
    assert "left: not sorted: 19 of 40 rows were out of order" in left.stderr
    assert "--sort" in left.stderr
    (told,) = lines(dyknow(*command, "--stream", "told", "--json"))
    assert (told["out_of_order"], told["sorted"]) == (19, True)


def test_run_gives_the_same_windows_of_an_unsorted_table(
    unsorted: Path, table: Path, query: str
) -> None:
    def run(file: Path, *options: str) -> Result:
        arguments = ["run", query, "--stream", f"{STREAM}={file}", "--ssl", SSL, "--json", *options]
        return CliRunner().invoke(app, arguments)

    assert lines(run(unsorted)) == lines(run(table))
    assert "sorted: 19 of 40 rows were out of order" in run(unsorted).stderr
    assert run(table).stderr == ""
    collapsed = run(unsorted, "--no-sort")
    assert "not sorted: 19 of 40" in collapsed.stderr
    assert lines(collapsed) != lines(run(table))


def test_replay_at_a_pace(dyknow: Any, table: Path) -> None:
    played = dyknow("replay", str(table), "--stream", "s5", "--speed", "200", "--json")
    assert lines(played)[0]["used"] == 40
    assert lines(played)[0]["seconds"] >= 19.5 / 200


def test_replay_from_a_time_in_nanoseconds(dyknow: Any, table: Path, client: Client) -> None:
    """As the error for any other text says it may be written."""
    command = ("replay", str(table), "--stream", "s5", "--speed", "max", "--rebase", "5000000000")
    assert "used 40" in dyknow(*command).stdout
    assert client.history("s5", start=0, limit=1)[0]["valid"] == "1970-01-01T00:00:05Z"


def test_replay_of_what_is_no_recording(dyknow: Any, tmp_path: Path) -> None:
    bad = tmp_path / "bad.csv"
    bad.write_text("timestamp,id,spd\n1,uav1,2.5\nyesterday,uav1,3\n")
    result = dyknow("replay", str(bad), "--stream", "s5", status=1)
    assert "line 3" in result.stderr
    dyknow("replay", str(tmp_path / "none.csv"), "--stream", "s5", status=2)
    dyknow("replay", str(bad), "--stream", "s5", "--speed", "0", status=2)
    dyknow("replay", str(bad), "--stream", "s5", "--rebase", "someday", status=2)


def test_templates(dyknow: Any, template: str) -> None:
    assert (
        "registered HighSpeedEvent(?o, ?type, ?threshold)"
        in dyknow("template", "add", template).stdout
    )
    twice = dyknow("template", "add", template, status=1)
    assert "already exists" in twice.stderr
    dyknow("template", "add", template, "--replace", "HighSpeedEvent")
    assert "HighSpeedEvent" in dyknow("template", "list").stdout
    assert lines(dyknow("template", "list", "--json"))[0]["local_name"] == "HighSpeedEvent"
    assert dyknow("template", "show", "HighSpeedEvent").stdout.strip() == TEMPLATE.strip()
    dyknow("template", "remove", "HighSpeedEvent")
    assert "no templates" in dyknow("template", "list").stdout
    dyknow("template", "show", "HighSpeedEvent", status=1)
    text = TEMPLATE.replace("?threshold)", "?threshold = 100)", 1)
    shown = "HighSpeedEvent(?o, ?type, ?threshold = 100)"
    assert shown in dyknow("template", "add", text).stdout
    assert "?threshold = 100" in dyknow("template", "list").stdout
    assert dyknow("template", "show", "HighSpeedEvent").stdout.strip() == text.strip()
    assert f"parameters: {shown[15:-1]}" in dyknow("explain", "--template", "HighSpeedEvent").stdout


def test_templates_of_the_package(dyknow: Any, client: Client) -> None:
    added = dyknow("template", "add", "--library", "high_speed").stdout
    assert added.strip() == "registered HighSpeedEvent(?o, ?type, ?threshold)"
    dyknow("template", "add", "--library", "low_altitude")
    dyknow("template", "add", "--library", "high_speed", "--replace", "HighSpeedEvent")
    assert len(client.templates()) == 2
    unknown = dyknow("template", "add", "--library", "hihg_speed", status=1).stderr
    assert "it has high_speed, low_altitude" in unknown
    dyknow("template", "add", "text", "--library", "high_speed", status=2)
    dyknow("template", "add", status=2)


def test_help_lists_the_templates_of_the_package() -> None:
    told = " ".join(CliRunner().invoke(app, ["template", "add", "--help"]).output.split())
    assert all(name in told for name in shipped_texts())


def test_errors_show_the_place(dyknow: Any) -> None:
    result = dyknow("template", "add", "REGISTER TEMPLATE dyknow:X(?o AS SELECT", status=1)
    assert "line 1, column" in result.stderr
    assert "^" in result.stderr
    assert result.stdout == ""


def test_streams(dyknow: Any, client: Client) -> None:
    client.put_stream("s5", {"id": "string", "spd": "float"})
    client.publish("s5", [{"valid": 1, "id": "uav1", "spd": 1.5}])
    assert "s5" in dyknow("streams").stdout
    assert {line["name"] for line in lines(dyknow("streams", "--json"))} == {"status", "s5"}
    shown = dyknow("streams", "s5").stdout
    assert "accepted=1" in shown
    assert "id: string, spd: float" in shown
    dyknow("streams", "nowhere", status=1)
    dyknow("streams", "nowhere", "--remove", "s5", status=2)
    assert dyknow("streams", "--remove", "s5").stdout == "removed s5\n"
    assert "there is no stream called 's5'" in dyknow("streams", "--remove", "s5", status=1).stderr


def test_sparql(dyknow: Any, client: Client, tmp_path: Path) -> None:
    client.put_stream("s5", {"a": "float"})
    query = tmp_path / "names.rq"
    query.write_text(
        "PREFIX o: <http://www.dyknow.eu/ontology#> SELECT ?n { ?s a o:Stream ; o:hasName ?n }"
    )
    assert "s5" in dyknow("sparql", str(query)).stdout
    assert lines(dyknow("sparql", str(query), "--json"))[0]["head"]["vars"] == ["n"]
    assert dyknow("sparql", "ASK { ?s ?p ?o }").stdout.strip() == "yes"
    assert dyknow("sparql", "CONSTRUCT { ?s ?p ?o } { ?s ?p ?o } LIMIT 1").stdout.strip()
    assert "line 1" in dyknow("sparql", "SELECT", status=1).stderr
    ask = "ASK { ?s a :Stream ; :hasName ?n }"
    assert dyknow("sparql", ask, "--parameter", 'n="s5"').stdout.strip() == "yes"
    assert dyknow("sparql", ask, "--parameter", 'n="s6"').stdout.strip() == "no"
    assert "NAME=VALUE" in dyknow("sparql", ask, "--parameter", "n", status=2).stderr


def test_sparql_over_chosen_graphs_in_a_format(dyknow: Any) -> None:
    stated = "http://www.dyknow.eu/ontology"
    ask, of_graph = "ASK { ?s ?p ?o }", "ASK { GRAPH ?g { ?s ?p ?o } }"
    assert dyknow("sparql", ask, "--default-graph", "urn:none").stdout.strip() == "no"
    several = ("--default-graph", "urn:none", "--default-graph", stated)
    assert dyknow("sparql", ask, *several).stdout.strip() == "yes"
    assert dyknow("sparql", of_graph, "--named-graph", stated).stdout.strip() == "yes"
    assert dyknow("sparql", ask, "--named-graph", stated).stdout.strip() == "no"
    graph = "CONSTRUCT { <urn:a> <urn:b> 1 } WHERE {}"
    assert dyknow("sparql", graph, "--format", "rdfxml").stdout.startswith("<?xml")
    assert dyknow("sparql", graph, "--format", "nquads").stdout.startswith("<urn:a> <urn:b> ")
    refused = dyknow("sparql", ask, "--default-graph", "none", status=1).stderr
    assert "default-graph-uri is no absolute IRI: none" in refused
    # A relative IRI has the base that the service gave it, also where the result is empty.
    dyknow("sparql", "SELECT * { <x> dyknow:speed ?o }")


def test_match_and_explain(dyknow: Any, client: Client, template: str) -> None:
    client.annotate(SSL)
    client.register_template(Path(template).read_text())
    assert "s5" in dyknow("match", "dyknow:speed", "--sort", "dyknow:UAV").stdout
    nothing = dyknow("match", "dyknow:altitude", "--sort", "dyknow:UAV", "--json", status=1)
    assert lines(nothing)[0]["found"] is False
    assert "HighSpeedEvent" in dyknow("explain", REQUEST).stdout
    assert "text" in lines(dyknow("explain", "--template", "HighSpeedEvent", "--json"))[0]
    assert "--template" in dyknow("explain", status=2).stderr
    tried = dyknow("explain", REQUEST, "--since", "start").stdout
    assert tried.splitlines()[-2:] == ["on what is kept", "  not tried: no sample is kept"]
    assert "since" in dyknow("explain", REQUEST, "--since", "soon", status=1).stderr
    lacking = REQUEST.replace("UAV", "Human")
    assert "failed" in dyknow("explain", lacking, status=1).stdout
    missed = lines(dyknow("explain", lacking, "--json", status=1))[0]
    assert (missed["found"], missed["stages"][-1]["title"]) == (False, "semantic matching")
    assert "knows no feature" in dyknow("explain", "--feature", "nosuch", status=1).stderr


def test_no_service_at_the_address() -> None:
    result = CliRunner().invoke(app, ["streams", "--url", "http://127.0.0.1:1"])
    assert result.exit_code == 1
    assert "dyknow serve" in result.stderr


def test_usage() -> None:
    assert CliRunner().invoke(app, ["streams", "--nonsense"]).exit_code == 2
    assert CliRunner().invoke(app, ["--version"]).stdout.strip()
    assert "replay" in CliRunner().invoke(app, ["--help"]).stdout


QUERY = """REGISTER STREAM Fast COMPUTE EVERY 1s AS
PREFIX dyknow: <http://www.ida.liu.se/dyknow/>
SELECT ?o ?avg
FROM STREAM <http://www.ida.liu.se/dyknow/s5.trdf> [RANGE 5s STEP 1s]
WHERE { ?o dyknow:speed ?spd . }
AGGREGATE {(?avg, AVG, {?spd}) FILTER (?avg > 100)}
"""
STREAM = "http://www.ida.liu.se/dyknow/s5.trdf"


@pytest.fixture
def query(tmp_path: Path) -> str:
    path = tmp_path / "fast.rq"
    path.write_text(QUERY)
    return str(path)


PROV = "http://www.w3.org/ns/prov#generatedAtTime"


@pytest.mark.parametrize("kind", ["csv", "ndjson", "nq", "nq.gz", "trig"])
def test_run_over_timed_triples(tmp_path: Path, query: str, kind: str) -> None:
    rows = [(i * 500_000_000, f"dyknow:uav{i % 2 + 1}", 50 + 100 * (i % 2)) for i in range(1, 9)]
    path = tmp_path / f"speeds.{kind}"
    if kind == "csv":
        text = "time,s,p,o\n" + "".join(f"{t},{s},dyknow:speed,{o}\n" for t, s, o in rows)
    elif kind == "trig":
        text = "@prefix dyknow: <http://www.ida.liu.se/dyknow/> .\n" + "".join(
            f"<urn:{t}> <{PROV}> {t} . <urn:{t}> {{ {s} dyknow:speed {o} }}\n" for t, s, o in rows
        )
    elif kind.startswith("nq"):
        base, integer = "http://www.ida.liu.se/dyknow/", "http://www.w3.org/2001/XMLSchema#integer"
        text = "".join(
            f'<{base}{s[7:]}> <{base}speed> "{o}"^^<{integer}> <urn:{t}> .\n'
            f'<urn:{t}> <{PROV}> "{t}"^^<{integer}> .\n'
            for t, s, o in rows
        )
    else:
        text = "".join(
            json.dumps({"time": t, "s": s, "p": "dyknow:speed", "o": o}) + "\n" for t, s, o in rows
        )
    data = text.encode()
    path.write_bytes(gzip.compress(data) if kind.endswith("gz") else data)
    arguments = ["run", query, "--stream", f"{STREAM}={path}"]
    result = CliRunner().invoke(app, [*arguments, "--json"])
    assert result.exit_code == 0, (result.output, result.exception)
    windows = lines(result)
    assert windows[0]["end"] == "1970-01-01T00:00:01Z"
    assert len(windows[0]["solutions"]) == 1
    assert "uav2" in windows[0]["solutions"][0]["o"]
    people = CliRunner().invoke(app, arguments)
    assert "dyknow:uav2" in people.stdout
    assert "windows with a result" in people.stdout


def test_run_over_a_table_of_samples(table: Path, query: str) -> None:
    arguments = ["run", query, "--stream", f"{STREAM}={table}", "--ssl", SSL, "--json"]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, (result.output, result.exception)
    windows = lines(result)
    assert len(windows) > 15
    assert "uav2" in str(windows[3]["solutions"])
    assert "uav1" not in str(windows[3]["solutions"])


@pytest.mark.parametrize(
    ("name", "text", "part"),
    [
        ("a.csv", "time,s,p\n", "time,s,p,o"),
        ("a.csv", "time,s,p,o\n1,dyknow:a,dyknow:b\n", "line 2"),
        ("a.csv", "time,s,p,o\nnoon,dyknow:a,dyknow:b,1\n", "line 2"),
        ("a.csv", "time,s,p,o\n1,dyknow:a,5,1\n", "a predicate is an IRI"),
        ("a.csv", "time,s,p,o\n1,?a,dyknow:b,1\n", "variable"),
        ("a.ndjson", '{"time": 1}\n', "line 1"),
        ("a.ndjson", "[]\n", "line 1"),
        ("a.nq", "<urn:a> <urn:b> <urn:c> <urn:g> .\n", "graph <urn:g> has no time"),
        ("a.nq", "<urn:a> <urn:b> 5 .\n", "line 1"),
        ("a.nt", "", "says no times"),
        ("a.txt", "", "unknown kind"),
    ],
)
def test_run_with_files_that_are_none(
    tmp_path: Path, query: str, name: str, text: str, part: str
) -> None:
    (tmp_path / name).write_text(text)
    result = CliRunner().invoke(app, ["run", query, "--stream", f"{STREAM}={tmp_path / name}"])
    assert result.exit_code == 1, result.output
    assert part in result.stderr


TIMED = b"time,s,p,o\n1000000000,dyknow:uav1,dyknow:speed,5\n"
XSD = "http://www.w3.org/2001/XMLSchema#"
GRAPHS = f"""<urn:uav1> <urn:speed> "5"^^<{XSD}integer> <urn:g> .
<urn:g> <http://www.w3.org/ns/prov#generatedAtTime> "1000000000"^^<{XSD}integer> .
""".encode()


@pytest.mark.parametrize("mark", [b"", b"\xef\xbb\xbf"])
@pytest.mark.parametrize(
    ("name", "data"), [("A.CSV.GZ", TIMED), ("a.nq.gz", GRAPHS), ("A.NQ.GZ", GRAPHS)]
)
def test_run_over_packed_files(tmp_path: Path, name: str, data: bytes, mark: bytes) -> None:
    query, path = tmp_path / "q.rq", tmp_path / name
    query.write_text(f"SELECT ?v FROM STREAM <{STREAM}> [RANGE 1s STEP 1s] WHERE {{ ?o ?p ?v }}")
    arguments = ["run", str(query), "--stream", f"{STREAM}={path}", "--json"]
    path.write_bytes(gzip.compress(mark + data))
    (window,) = lines(CliRunner().invoke(app, arguments))
    assert window["end"] == "1970-01-01T00:00:01Z"
    path.write_bytes(path.read_bytes()[:-20])
    cut = CliRunner().invoke(app, arguments)
    assert (cut.exit_code, f"{name} cannot be unpacked" in cut.stderr) == (1, True)
    path.write_bytes(data)
    assert "gzip" in CliRunner().invoke(app, arguments).stderr


def test_run_with_timed_triples_that_are_no_text(tmp_path: Path, query: str) -> None:
    path = tmp_path / "a.csv"
    path.write_bytes(TIMED + b"\xff")
    result = CliRunner().invoke(app, ["run", query, "--stream", f"{STREAM}={path}"])
    assert (result.exit_code, "line 3: no UTF-8" in result.stderr) == (1, True)


def test_run_with_a_text_that_is_none(tmp_path: Path, table: Path) -> None:
    path = tmp_path / "bad.rq"
    path.write_text("REGISTER STREAM")
    result = CliRunner().invoke(app, ["run", str(path), "--stream", f"{STREAM}={table}"])
    assert result.exit_code == 1
    missing = CliRunner().invoke(app, ["run", str(path), "--stream", "nothing"])
    assert missing.exit_code == 2


def test_run_converts_to_the_units_of_the_ontology(table: Path, query: str) -> None:
    ssl = SSL.replace("km.h-1", "m.s-1")  # 50 m/s are 180 km/h
    arguments = ["run", query, "--stream", f"{STREAM}={table}", "--ssl", ssl, "--json"]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, (result.output, result.exception)
    means = {row["o"]: row["avg"] for window in lines(result) for row in window["solutions"]}
    values = {name[-2]: float(mean.split('"')[1]) for name, mean in means.items()}
    assert values == {"1": 180.0, "2": 540.0}


def test_run_leaves_empty_windows_out(table: Path, tmp_path: Path) -> None:
    path = tmp_path / "never.rq"
    path.write_text(QUERY.replace("> 100", "> 1000"))
    arguments = ["run", str(path), "--stream", f"{STREAM}={table}", "--ssl", SSL]
    people = CliRunner().invoke(app, arguments)
    assert people.stdout.strip() == "(0 windows with a result)"
    said = "nothing came: 40 triples read: no window satisfied the query's conditions"
    assert people.stderr.strip() == said
    silent = CliRunner().invoke(app, [*arguments, "--json"])
    assert (silent.stdout, silent.stderr) == ("", "")


def test_run_says_why_no_window_has_a_result(table: Path, tmp_path: Path) -> None:
    query, static, triples = tmp_path / "q.rq", tmp_path / "s.ttl", tmp_path / "t.ndjson"
    static.write_text(
        "@prefix d: <http://www.ida.liu.se/dyknow/> . @prefix r: <http://www.w3.org/2000/01/"
        "rdf-schema#> . d:UAV r:subClassOf d:Craft . d:speed r:subPropertyOf d:motion ."
    )
    rows = [{"time": t, "s": "dyknow:u", "p": "dyknow:speed", "o": t} for t in range(5)]
    triples.write_text("".join(json.dumps(row) + "\n" for row in rows))

    def said(where: str, *more: str) -> str:
        query.write_text(
            f"REGISTER QUERY q AS SELECT * FROM STREAM <{STREAM}> [RANGE 5s STEP 1s] "
            f"WHERE {{ {where} }}"
        )
        run = CliRunner().invoke(app, ["run", str(query), *more])
        assert run.exit_code == 0, (run.output, run.exception)
        return run.stderr.strip()

    samples = ["--stream", f"{STREAM}={table}", "--ssl", SSL, "--static", str(static)]
    lacking = said("?o a dyknow:Car . ?o dyknow:altitude ?v", *samples)
    assert lacking == (
        "nothing came: 40 triples read: no member of dyknow:Car seen; no triple of dyknow:altitude"
    )
    assert said("?o a dyknow:Craft . ?o dyknow:motion ?v", *samples) == ""
    assert "no window satisfied" in said("?o a dyknow:Craft ; dyknow:motion -1", *samples)
    for lateness in ([], ["--lateness", "1s"]):
        found = said("?o dyknow:track ?v", "--stream", f"{STREAM}={triples}", *lateness)
        assert found == "nothing came: 5 triples read: no triple of dyknow:track"


def test_run_warns_of_annotations_of_other_streams(table: Path, query: str) -> None:
    """The only annotation is used whatever stream it names; a wrong name must not be silent."""
    wrong = SSL.replace("stream s5", "stream s55")
    reading = ["run", query, "--stream", f"{STREAM}={table}", "--json", "--ssl"]
    warning = "warning: the SSL text annotates stream 's55', which is not read; read: s5"
    one = CliRunner().invoke(app, [*reading, wrong])
    assert one.exit_code == 0, (one.output, one.exception)
    assert one.stderr.strip() == f"{warning}; it is used all the same"
    both = CliRunner().invoke(app, [*reading, f"{SSL}\n{wrong}"])
    assert both.stderr.strip() == warning
    right = CliRunner().invoke(app, [*reading, SSL])
    assert (right.stderr, right.stdout) == ("", one.stdout)
    assert both.stdout == one.stdout


def test_run_over_a_stream_that_the_query_does_not_read(table: Path, query: str) -> None:
    other = STREAM.replace("s5", "s6")
    arguments = ["run", query, "--stream", f"{other}={table}", "--ssl", SSL]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 1, (result.output, result.exception)
    assert "s6" in result.stderr


def test_run_writes_what_came_too_late(tmp_path: Path) -> None:
    path, late, query = tmp_path / "s.ndjson", tmp_path / "late.ndjson", tmp_path / "n.rq"
    rows = [(3, "dyknow:a"), (12, '"x y"@en'), (9, 2.5), (4, "_:b"), (22, True)]
    texts = [json.dumps({"time": t, "s": "dyknow:o", "p": "dyknow:p", "o": o}) for t, o in rows]
    path.write_text("\n".join(texts))
    query.write_text(
        "REGISTER QUERY q AS SELECT (COUNT(?v) AS ?n) "
        f"FROM STREAM <{STREAM}> [RANGE 10ns STEP 10ns] WHERE {{ ?o ?p ?v }}"
    )
    arguments = ["run", str(query), "--stream", f"{STREAM}={path}"]
    result = CliRunner().invoke(app, [*arguments, "--lateness", "3ns", "--late", str(late)])
    assert result.exit_code == 0, (result.output, result.exception)
    assert result.stdout.splitlines()[-1] == "(3 windows with a result, 1 late)"
    (dropped,) = read_timed_triples(late)
    (_, _, _, given, _) = read_timed_triples(path)
    assert dropped == given
    # Sorted, all of it is in time.
    whole = CliRunner().invoke(app, arguments)
    assert whole.stdout.splitlines()[-1] == "(3 windows with a result)"
    for wrong in (["--late", str(late)], ["--lateness", "3ns", "--late", str(late), "--ssl", SSL]):
        assert CliRunner().invoke(app, [*arguments, *wrong]).exit_code == 2
    named = CliRunner().invoke(app, [*arguments, "--lateness", "3ns", "--late", "late.csv"])
    assert named.exit_code == 1
    assert "written as .ndjson" in named.stderr


def test_run_with_a_lateness_that_is_none(table: Path, query: str) -> None:
    arguments = ["run", query, "--stream", f"{STREAM}={table}", "--ssl", SSL, "--lateness", "soon"]
    assert CliRunner().invoke(app, arguments).exit_code == 2


@pytest.mark.parametrize(
    ("text", "ssl"),
    [
        ("timestamp,id,spd\n1,uav1,2.5\nyesterday,uav1,3\n", SSL),
        ("timestamp,id,spd\n1,uav1,2.5\n", "stream s5 contains"),
        ("timestamp,id,spd\n1,uav1,2.5\n", SSL.replace("= spd", "= alt")),
        ("timestamp,id,spd\n1,uav1,2.5\n", SSL.replace("speed(", "nosuchfeature(")),
    ],
    ids=["bad time", "SSL syntax", "SSL of another field", "SSL of no feature"],
)
def test_a_replay_that_fails_leaves_nothing(
    dyknow: Any, client: Client, tmp_path: Path, text: str, ssl: str
) -> None:
    path = tmp_path / "bad.csv"
    path.write_text(text)
    dyknow("replay", str(path), "--stream", "s5", "--speed", "max", "--ssl", ssl, status=1)
    assert [stream["name"] for stream in client.streams()] == ["status"]
    client.put_stream("s5", {"id": "string", "spd": "float"})
    dyknow("replay", str(path), "--stream", "s5", "--speed", "max", "--ssl", ssl, status=1)
    assert client.stream("s5")["counters"]["accepted"] == 0  # what was there before stays


@pytest.mark.parametrize("name", ["nofile.rq", "no file.rq", "./nofile"])
def test_a_file_that_is_not_there(dyknow: Any, name: str) -> None:
    for command in (("template", "add"), ("annotate",), ("sparql",)):
        assert "no file" in dyknow(*command, name, status=1).stderr


def test_files_with_a_byte_order_mark(dyknow: Any, tmp_path: Path, table: Path) -> None:
    path = tmp_path / "marked.rq"
    path.write_text(TEMPLATE, encoding="utf-8-sig")
    dyknow("template", "add", str(path))
    path.write_text(QUERY, encoding="utf-8-sig")
    dyknow("run", str(path), "--stream", f"{STREAM}={table}", "--ssl", SSL)


def test_errors_for_programs(dyknow: Any) -> None:
    def told(*arguments: str, status: int = 1) -> dict[str, Any]:
        result = dyknow(*arguments, "--json", status=status)
        assert result.stdout == ""
        found: dict[str, Any] = json.loads(result.stderr)
        return found

    assert told("streams", "nowhere")["status"] == 404
    syntax = told("template", "add", "REGISTER TEMPLATE dyknow:X(?o AS SELECT")
    assert (syntax["title"], syntax["line"]) == ("syntax error", 1)
    assert "no file" in told("template", "add", "nofile.rq")["detail"]
    assert told("streams", "--nonsense", status=2)["title"] == "wrong usage"
    assert "hint" in told("streams", "--url", "http://127.0.0.1:1")
    # The next command is for people again.
    assert "error:" in dyknow("streams", "nowhere", status=1).stderr


def test_events_of_a_recording_that_has_ended(dyknow: Any, table: Path, template: str) -> None:
    dyknow("replay", str(table), "--stream", "s5", "--speed", "max", "--ssl", SSL)
    dyknow("template", "add", template)
    assert "--since start" in dyknow("events", REQUEST).stderr
    past = dyknow("events", REQUEST, "--since", "start")
    assert "uav2" in past.stdout
    assert "hint" not in past.stderr


def test_what_the_service_knows_of_itself_is_not_of_1970(monkeypatch: pytest.MonkeyPatch) -> None:
    served: list[Any] = []

    def serve(app: Any, listener: Any) -> bool:
        listener.close()
        served.append(app.state.service)
        return False

    monkeypatch.setattr("dyknow.service.cli.serving.run", serve)
    monkeypatch.setattr("dyknow.service.cli.serving.configure", lambda *arguments: None)
    for work in ("loops", "workers", "application"):
        monkeypatch.setattr(f"dyknow.service.cli.serving.WarmUp.{work}", lambda *arguments: None)
    result = CliRunner().invoke(app, ["serve", "--port", "0"])
    assert result.exit_code == 0, (result.output, result.exception)
    times = served[0].engine.generator("status").stream.since(0)
    assert all(segment.batch.valid.min() > 10**18 for segment in times)
