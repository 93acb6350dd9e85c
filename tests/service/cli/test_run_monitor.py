"""`dyknow run` and `dyknow.run`: recordings checked with a monitor, without a service."""

from __future__ import annotations

import gzip
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import run
from places import ROOT

import dyknow
from dyknow.converters.errors import ConversionError, WireError
from dyknow.engine.model.errors import Conflict, NoPlan, NotAnnotated
from dyknow.engine.recorded_run import RunFailed
from dyknow.languages.errors import LanguageError
from dyknow.ontology.errors import OntologyError
from dyknow.rdf.namespaces import DYKNOW
from dyknow.streams.time import SECOND

LOW = "monitor low(?x in UAV) = altitude(?x) < 100"
SSL = "stream heights contains altitude(UAV) = alt [ft] for every UAV = id"
BOTH = f"{SSL}\nstream speeds contains speed(UAV) = spd [km.h-1] for every UAV = id"
ROWS = [
    {"valid": t * SECOND, "id": id, "alt": height}
    for t, heights in enumerate([(10.0, 90.0), (50.0, 110.0), (90.0, 120.0), (130.0, 80.0)])
    for id, height in zip(("a", "b"), heights, strict=True)
]
VIOLATIONS = [(1, "b"), (2, "b"), (3, "a")]


def table(path: Path, rows: list[dict[str, Any]]) -> Path:
    """A table of ``rows``, with times in seconds after 2021-10-07."""
    names = list(rows[0])
    cells = [[1633564800 + row["valid"] // SECOND, *map(row.get, names[1:])] for row in rows]
    lines = [["timestamp", *names[1:]], *cells]
    path.write_text("".join(",".join(map(str, line)) + "\n" for line in lines))
    return path


@pytest.fixture
def heights(tmp_path: Path) -> Path:
    rows = [{**row, "valid": 1633564800 * SECOND + row["valid"]} for row in ROWS]
    path = tmp_path / "heights.ndjson"
    path.write_text("".join(json.dumps(row) + "\n" for row in rows))
    return path


@pytest.fixture
def low(tmp_path: Path) -> Path:
    return monitor(tmp_path, LOW)


def monitor(folder: Path, text: str) -> Path:
    path = folder / "m.mtl"
    path.write_text(text)
    return path


def start_and_object(verdict: Mapping[str, Any]) -> tuple[int, str]:
    return verdict["valid"] // SECOND, verdict["x"].removeprefix(DYKNOW)


# -- dyknow run ----------------------------------------------------------------------------------


def test_violations_like_the_samples_of_follow(low: Path, heights: Path) -> None:
    done = run("run", low, "--stream", f"heights={heights}", "--ssl", SSL)
    assert done.stdout.splitlines() == [
        f"2021-10-07T00:00:0{t}Z  x={id}  verdict=false  decided=2021-10-07T00:00:0{t}Z"
        f"  witness=2021-10-07T00:00:0{t}Z"
        for t, id in VIOLATIONS
    ]
    assert done.stderr.strip() == ("8 samples read, 8 states; verdicts: 5 true, 3 false, 0 unknown")


def test_json(tmp_path: Path, heights: Path) -> None:
    text = monitor(tmp_path, f"{LOW} with report changes")
    done = run("run", text, "--stream", f"heights={heights}", "--ssl", SSL, "--json")
    first, *rest = map(json.loads, done.stdout.splitlines())
    assert first == {
        "event": "sample",
        "stream": "low",
        "sequence": 1,
        "available": "2021-10-07T00:00:02Z",
        "valid": "2021-10-07T00:00:00Z",
        "values": {
            "x": "b",
            "verdict": "true",
            "decided": "2021-10-07T00:00:00Z",
            "witness": "2021-10-07T00:00:00Z",
            "last": "2021-10-07T00:00:00Z",
        },
    }
    assert [each["sequence"] for each in rest] == [2, 3, 4, 5]
    assert json.loads(done.stderr) == {
        "samples": 8,
        "results": 5,
        "states": 8,
        "verdicts": {"true": 5, "false": 3, "unknown": 0},
        "late": 0,
        "empty": None,
    }


def test_robustness(tmp_path: Path, heights: Path) -> None:
    text = monitor(tmp_path, f"{LOW} with robustness")
    done = run("run", text, "--stream", f"heights={heights}", "--ssl", SSL)
    margins = (-10.0, -20.0, -30.0)
    assert done.stdout.splitlines() == [
        f"2021-10-07T00:00:0{t}Z  x={id}  verdict=false  decided=2021-10-07T00:00:0{t}Z"
        f"  witness=2021-10-07T00:00:0{t}Z  robustness={margin:g}"
        for (t, id), margin in zip(VIOLATIONS, margins, strict=True)
    ]
    found = dyknow.run(text.read_text(), {"heights": ROWS}, ssl=SSL)
    assert tuple(verdict["robustness"] for verdict in found) == margins


def test_nothing_to_report(tmp_path: Path, heights: Path) -> None:
    text = monitor(tmp_path, LOW.replace("100", "1000"))
    done = run("run", text, "--stream", f"heights={heights}", "--ssl", SSL)
    assert done.stdout == ""
    assert done.stderr.splitlines()[-1] == (
        "nothing came: 8 samples read, 8 states: the verdicts are 8 true, and it reports violations"
    )


def test_an_unsorted_table_gives_the_same(tmp_path: Path, low: Path, heights: Path) -> None:
    lines = heights.read_text().splitlines(keepends=True)
    mixed = tmp_path / "mixed.ndjson"
    mixed.write_text("".join(reversed(lines)))
    wanted = run("run", low, "--stream", f"heights={heights}", "--ssl", SSL)
    done = run("run", low, "--stream", f"heights={mixed}", "--ssl", SSL)
    assert done.stdout == wanted.stdout
    assert "mixed.ndjson: sorted: 6 of 8 rows were out of order" in done.stderr
    left = run("run", low, "--stream", f"heights={mixed}", "--ssl", SSL, "--no-sort")
    assert "not sorted: 6 of 8 rows were out of order" in left.stderr


def test_several_streams(tmp_path: Path, heights: Path) -> None:
    speeds = table(
        tmp_path / "speeds.csv",
        [{"valid": t * SECOND, "id": "a", "spd": 100.0 * t} for t in range(4)],
    )
    text = monitor(
        tmp_path,
        "monitor m(?x in UAV) = speed(?x) > 250 -> altitude(?x) > 200 with use most recent",
    )
    arguments = ("run", text, "--stream", f"heights={heights}", "--ssl", BOTH)
    done = run(*arguments, "--stream", f"speeds={speeds}", "--explain")
    assert done.stdout.startswith("2021-10-07T00:00:03Z  x=a  verdict=false")
    assert len(done.stdout.splitlines()) == 1
    assert "stream speeds : speed [km.h-1] for every UAV = id" in done.stderr
    lacking = run(*arguments, status=1)
    assert "no stream and no transformation" in lacking.stderr
    assert "it annotates speeds, of which there is no recording" in lacking.stderr
    problem = json.loads(run(*arguments, "--json", status=1).stderr)
    assert problem["title"] == "no plan"
    assert len(problem["missing"]) == 2
    assert "speeds" in problem["hint"]


def test_streams_that_are_not_needed(low: Path, heights: Path, tmp_path: Path) -> None:
    arguments = ("run", low, "--stream", f"heights={heights}", "--ssl", BOTH)
    alone = run(*arguments)
    assert "warning: the SSL text annotates stream 'speeds', which is not read" in alone.stderr
    speeds = table(tmp_path / "speeds.csv", [{"valid": 0, "id": "a", "spd": 1.0}])
    both = run(*arguments, "--stream", f"speeds={speeds}")
    assert "warning: the monitor does not need stream 'speeds'" in both.stderr
    assert both.stdout == alone.stdout


@pytest.mark.parametrize(
    ("options", "instead"),
    [
        (["--static", "s.ttl"], "--ontology"),
        (["--semantics", "set"], "no windows"),
        (["--bounds", "[)"], "no windows"),
        (["--origin", "5"], "from TIME"),
        (["--report", "close"], "report violations"),
        (["--lateness", "5s"], "max delay"),
        (["--late", "late.ndjson"], "counted"),
    ],
)
def test_options_of_queries(low: Path, heights: Path, options: list[str], instead: str) -> None:
    arguments = ("run", low, "--stream", f"heights={heights}", "--ssl", SSL, "--json")
    refused = json.loads(run(*arguments, *options, status=2).stderr)["detail"]
    assert f"{options[0]} means nothing for a monitor" in refused
    assert instead in refused


def test_wrong_usage(low: Path, heights: Path, tmp_path: Path) -> None:
    def said(*arguments: object, status: int) -> str:
        found: str = json.loads(run("run", *arguments, "--json", status=status).stderr)["detail"]
        return found

    stream = ("--stream", f"heights={heights}")
    assert "--ssl" in said(low, *stream, status=2)
    assert "NAME=FILE" in said(low, "--stream", heights, "--ssl", SSL, status=2)
    assert "already" in said(low, *stream, *stream, "--ssl", SSL, status=2)
    assert "no file" in said(low, "--stream", "heights=no.csv", "--ssl", SSL, status=1)
    query = tmp_path / "q.rq"
    query.write_text("REGISTER QUERY q AS SELECT * WHERE { ?s ?p ?o }")
    assert "for monitors" in said(query, *stream, "--ontology", low, status=2)


@pytest.mark.parametrize(
    ("text", "ssl", "part"),
    [
        ("monitor low(?x in UAV) = depth(?x) < 1", SSL, "hint: add it to the ontology first"),
        (f"{LOW} [s]", SSL, "do not fit together"),
        (f"{LOW} with frobnicate", SSL, "line 1"),
        (LOW, SSL.replace("heights", "h"), "no annotation of stream 'heights' (it annotates h)"),
        (LOW, SSL.replace("= alt", "= a"), "no field 'a' (its fields are id, alt)"),
        (LOW, SSL.replace("[ft]", "[kg]"), "kg"),
        (LOW, SSL.replace("= alt [ft]", "= id [ft]"), "field 'id' holds string values"),
        (LOW.replace("low", "heights"), SSL, "give the query another name"),
    ],
)
def test_errors_say_what_to_do(
    tmp_path: Path, heights: Path, text: str, ssl: str, part: str
) -> None:
    arguments = ("run", monitor(tmp_path, text), "--stream", f"heights={heights}", "--ssl", ssl)
    done = run(*arguments, status=1)
    assert done.stdout == ""
    assert part in done.stderr
    assert json.loads(run(*arguments, "--json", status=1).stderr)["detail"]


def test_a_table_with_a_mistake_names_its_stream(tmp_path: Path, low: Path) -> None:
    path = tmp_path / "h.csv"
    path.write_text("timestamp,id,alt\n1,a,2.5\nyesterday,b,3\n")
    done = run("run", low, "--stream", f"heights={path}", "--ssl", SSL, status=1)
    assert "line 3: stream heights: " in done.stderr


def test_a_failed_unit(tmp_path: Path, heights: Path) -> None:
    text = monitor(tmp_path, f"{LOW} with sample every 1ns")
    done = run("run", text, "--stream", f"heights={heights}", "--ssl", SSL, status=1)
    assert "8 samples read, 0 states" in done.stderr
    assert "TooManyDue" in done.stderr.splitlines()[-1]


def test_a_domain_ontology(tmp_path: Path) -> None:
    ontology = tmp_path / "ships.ttl"
    ontology.write_text(
        "@prefix : <http://www.dyknow.eu/ontology#> . @prefix s: <http://www.ida.liu.se/dyknow/> . "
        "@prefix rdfs: <http://www.w3.org/2000/01/rdf-schema#> . "
        "@prefix owl: <http://www.w3.org/2002/07/owl#> . "
        "@prefix xsd: <http://www.w3.org/2001/XMLSchema#> . "
        "s:Ship a owl:Class ; rdfs:subClassOf s:Vehicle . "
        's:draught a :UnaryFeature, owl:DatatypeProperty ; rdfs:range xsd:double ; :hasUnit "m" .'
    )
    text = monitor(tmp_path, "monitor m(?x in Ship) = draught(?x) < 5 [m]")
    path = table(
        tmp_path / "ships.csv", [{"valid": t * SECOND, "id": "a", "d": 4.5 + t} for t in range(3)]
    )
    ssl = "stream ships contains draught(Ship) = d for every Ship = id"
    arguments = ("run", text, "--stream", f"ships={path}", "--ssl", ssl)
    assert "not a sort of the ontology" in run(*arguments, status=1).stderr
    done = run(*arguments, "--ontology", ontology)
    assert len(done.stdout.splitlines()) == 2
    other = ontology.rename(tmp_path / "ships.txt")
    assert "of an unknown kind" in run(*arguments, "--ontology", other, status=1).stderr


# -- dyknow.run ----------------------------------------------------------------------------------


def test_verdicts() -> None:
    checked = dyknow.run(LOW, {"heights": ROWS}, ssl=SSL)
    first = next(checked)
    # The state leaves with the next sample.
    times = {"available": 2 * SECOND, **dict.fromkeys(("valid", "decided", "witness"), SECOND)}
    assert first == {**times, "x": f"{DYKNOW}b", "verdict": "false"}
    assert [start_and_object(each) for each in (first, *checked)] == VIOLATIONS
    assert checked.summary.verdicts == {"true": 5, "false": 3, "unknown": 0}


def test_runs_of_verdicts_and_unknown_ones() -> None:
    rows = [*ROWS, {"valid": "1970-01-01T00:00:04Z", "id": "a", "alt": None}]
    text = f"{LOW} with report changes, no approximation"
    rows = [each for each in dyknow.run(text, {"heights": rows}, ssl=SSL) if each["x"][-1] == "a"]
    assert [(each["valid"], each["verdict"], each["last"]) for each in rows] == [
        (0, "true", 2 * SECOND),
        (3 * SECOND, "false", 3 * SECOND),
    ] + [(4 * SECOND, "unknown", 4 * SECOND)] * (len(rows) - 2)


def test_values_of_numpy() -> None:
    rows = [{**row, "valid": np.int64(row["valid"]), "alt": np.float64(row["alt"])} for row in ROWS]
    found = dyknow.run(LOW, {"heights": rows}, ssl=SSL)
    assert [start_and_object(each) for each in found] == VIOLATIONS


def test_samples_that_came_late_are_in_time_without_a_max_delay() -> None:
    late = [{**row, "available": row["valid"]} for row in ROWS]
    late[2]["available"] = 9 * SECOND
    whole = dyknow.run(LOW, {"heights": late}, ssl=SSL)
    assert [start_and_object(each) for each in whole] == VIOLATIONS
    assert whole.summary.late == 0
    bounded = dyknow.run(f"{LOW} with max delay 2s", {"heights": late}, ssl=SSL)
    assert sorted(map(start_and_object, bounded)) == VIOLATIONS
    assert (bounded.summary.late, bounded.summary.states) == (1, 7)


@pytest.mark.parametrize(
    ("change", "error", "part"),
    [
        ({"text": "SELECT"}, LanguageError, "line 1"),
        ({"text": "monitor"}, LanguageError, "line 1"),
        ({"text": LOW.replace("altitude", "speed")}, NoPlan, "speed"),
        ({"ssl": "stream"}, LanguageError, "line 1"),
        ({"streams": {"h": ROWS}}, NotAnnotated, "it annotates heights"),
        ({"ssl": SSL.replace("= alt", "= a")}, Conflict, "no field 'a'"),
        ({"streams": {"heights": []}}, WireError, "stream heights: the table has no rows"),
        ({"streams": {"heights": [{"id": "a", "alt": 1.0}]}}, WireError, "'valid'"),
        ({"streams": {"heights": [{"valid": [], "alt": 1.0}]}}, WireError, "is a list"),
        ({"streams": {"heights": [{**ROWS[0], "alt": "high"}]}}, ConversionError, "string"),
        ({"streams": {"heights": Path("no.csv")}}, FileNotFoundError, "no.csv"),
        ({"ontology": ["no.txt"]}, OntologyError, "unknown kind"),
    ],
)
def test_errors(change: dict[str, Any], error: type[Exception], part: str) -> None:
    arguments: dict[str, Any] = {"text": LOW, "streams": {"heights": ROWS}, "ssl": SSL, **change}
    with pytest.raises(error, match=part):
        dyknow.run(**arguments)


def test_a_failure_ends_the_iteration() -> None:
    with pytest.raises(RunFailed, match="TooManyDue"):
        list(dyknow.run(f"{LOW} with sample every 1ns", {"heights": ROWS}, ssl=SSL))


def test_recorded_flights() -> None:
    """The lines of the recording itself say which aircraft are fast and low."""
    path = ROOT / "examples" / "adsb.csv.gz"
    text = "monitor high(?x in Aircraft) = speed(?x) > 250 [kt] -> altitude(?x) > 5000 [ft]"
    ssl = (ROOT / "examples" / "adsb_speed.ssl").read_text()
    checked = dyknow.run(text, {"adsb": path}, ssl=ssl)
    found = {(each["valid"] // 1_000_000, each["x"].removeprefix(DYKNOW)) for each in checked}
    rows = [
        line.split(",") for line in gzip.decompress(path.read_bytes()).decode().splitlines()[1:]
    ]
    wanted = {
        (int(time), id)
        for time, id, _, _, _, altitude, speed, *_ in rows
        if speed and altitude and float(speed) > 250 and float(altitude) <= 5000
    }
    assert found == wanted
    assert checked.summary.samples == len(rows)
    assert checked.summary.late == 0


def test_objects_of_a_stream_that_has_ended_are_gone() -> None:
    ssl = (
        "stream heights contains altitude(RMAX) = alt [ft] for every RMAX = id\n"
        "stream others contains altitude(Car) = alt [ft] for every Car = id"
    )
    streams = {
        "heights": [{"valid": t * SECOND, "id": "a", "alt": 90.0} for t in range(2)],
        "others": [{"valid": t * SECOND, "id": "c", "alt": 110.0} for t in range(5)],
    }

    def verdicts(formula: str, options: str) -> list[str]:
        text = f"monitor m = {formula} with {options}, report verdicts"
        return [row["verdict"] for row in dyknow.run(text, streams, ssl=ssl)]

    recent = "use most recent"
    low, high = "altitude(?x) < 100", "altitude(?x) > 100"
    gone = ["true"] * 2 + ["false"] * 3
    assert verdicts(f"exists ?x in Vehicle {low}", recent) == gone
    assert verdicts(f"forall ?x in Vehicle {high}", recent) == ["false"] * 2 + ["true"] * 3
    longer = verdicts(f"exists ?x in Vehicle {low}", f"{recent}, present for 2s")
    assert longer == ["true"] * 4 + ["false"]


@pytest.mark.parametrize(
    ("formula", "normal", "verdict", "memory"),
    [
        (
            "always [0s, 10s] (altitude(?x) > 3.048 [m] -> eventually [0s, 5s] altitude(?x) < 9) "
            "with sample every 1s, max delay 2s",
            "always [0s, 10s] (not dyknow:altitude(?x) > 10 [ft] or eventually [0s, 5s] "
            "dyknow:altitude(?x) < 9 [ft])",
            "at most 17s after the time of the start: 15s of intervals and 2s of max delay; ",
            "at most 17 states, about 3.5 bytes of each for an object",
        ),
        (
            "eventually [0s, 4s] altitude(?x) < 9 and once [1s, 3s] altitude(?x) < 9",
            "eventually [0s, 4s] dyknow:altitude(?x) < 9 [ft] and once [1s, 3s] "
            "dyknow:altitude(?x) < 9 [ft]",
            "at most 4s after the time of the start; ",
            "the states of 7s, about 120 bytes of each for an object",
        ),
        (
            "historically altitude(?x) < 9",
            "historically dyknow:altitude(?x) < 9 [ft]",
            "with the state of its start; ",
            "one state and 2 of the past without an end, about 72 bytes of each for an object",
        ),
        (
            "true since altitude(?x) < 9",
            "true since dyknow:altitude(?x) < 9 [ft]",
            "with the state of its start; ",
            "all states from the first on, about 104 bytes of each for an object; "
            "the monitor fails with more than 1,000,000",
        ),
        (
            "eventually altitude(?x) < 9 with once",
            "eventually dyknow:altitude(?x) < 9 [ft]",
            "an interval has no end, so some verdicts wait for the end of the streams; ",
            "all states since the oldest start without a verdict, about 72 bytes of each for an "
            "object; the monitor fails with more than 1,000,000",
        ),
    ],
)
def test_a_monitor_is_explained(formula: str, normal: str, verdict: str, memory: str) -> None:
    made = dyknow.run(f"monitor m(?x in UAV) = {formula}", {"heights": ROWS}, ssl=SSL)
    lines = [line.strip() for line in made.explain().splitlines()]
    assert f"normal form  {normal}" in lines
    assert f"memory       {memory}" in lines
    assert any(line.startswith(f"a verdict    {verdict}") for line in lines), lines
