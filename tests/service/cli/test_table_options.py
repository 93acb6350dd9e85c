"""Tables of another dialect: the same options for replay, run and KPL."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

import dyknow
from dyknow.service.cli import app
from dyknow.service.client.client import Client

GERMAN = "Zeit;id;v\n07.10.2021 14:10:01;a;1,5\n07.10.2021 14:10:02;a;2,5\n"
COLONS = "Zeit:id:v\n2021-10-07 14.10.01:a:1.5\n2021-10-07 14.10.02:a:2.5\n"
FORMAT = ["--time-column", "Zeit", "--time-format"]
TABLES = pytest.mark.parametrize(
    ("text", "options"),
    [
        (GERMAN, [*FORMAT, "day-first"]),
        (COLONS, [*FORMAT, "%Y-%m-%d %H.%M.%S", "--delimiter", ":"]),
    ],
)
TIMES = ["2021-10-07T14:10:01Z", "2021-10-07T14:10:02Z"]
SSL = "stream s contains speed(UAV) = v for every UAV = id"


def call(*words: str, text: str | None = None, status: int = 0, url: str = "") -> Any:
    found = CliRunner().invoke(app, list(words), input=text, env={"DYKNOW_URL": url})
    assert found.exit_code == status, (found.output, found.exception)
    return found


@TABLES
@pytest.mark.parametrize("is_pipe", [False, True])
def test_replay(
    url: str, client: Client, tmp_path: Path, text: str, options: list[str], is_pipe: bool
) -> None:
    path = tmp_path / "s.csv"
    path.write_text(text)
    file = "-" if is_pipe else str(path)
    call("replay", file, "--stream", "s", "--speed", "max", *options, text=text, url=url)
    events = client.events("s", since="start")
    samples = [(e.data["valid"], e.values["v"]) for e in events if e.kind == "sample"]
    assert samples == list(zip(TIMES, [1.5, 2.5], strict=True))


@TABLES
def test_run(tmp_path: Path, text: str, options: list[str]) -> None:
    (tmp_path / "s.csv").write_text(text)
    query = tmp_path / "q"
    words = ["run", str(query), "--stream", f"s={tmp_path / 's.csv'}", "--ssl", SSL, *options]
    query.write_text("monitor slow(?x in UAV) = speed(?x) < 2 with report verdicts")
    lines = call(*words, "--json").stdout.splitlines()
    verdicts = [json.loads(line)["values"]["verdict"] for line in lines]
    assert verdicts == ["true", "false"]
    query.write_text(
        "REGISTER QUERY q AS SELECT ?v FROM STREAM <http://x/s> [RANGE 1s STEP 1s] "
        "WHERE { ?x dyknow:speed ?v }"
    )
    words[3] = f"http://x/s={tmp_path / 's.csv'}"
    lines = call(*words, "--json").stdout.splitlines()
    assert [json.loads(line)["end"] for line in lines] == TIMES


@TABLES
def test_kpl(tmp_path: Path, text: str, options: list[str]) -> None:
    (tmp_path / "s.csv").write_text(text)
    file = tmp_path / "a.kpl"
    file.write_text("sort row = (id string, v float)\nsource row s\nstrmgen x = s\nstream t = x")
    words = [str(file), str(tmp_path / "s.csv"), *options, "--json"]
    rows = [json.loads(line) for line in call("kpl", "run", *words).stdout.splitlines()]
    assert [(row["valid"], row["v"]) for row in rows] == list(zip(TIMES, [1.5, 2.5], strict=True))


def test_options_of_tables_mean_nothing_for_triples(tmp_path: Path) -> None:
    file = tmp_path / "s.csv"
    file.write_text("time,s,p,o\n1,dyknow:a,dyknow:b,1\n")
    query = tmp_path / "q"
    query.write_text(
        "REGISTER QUERY q AS SELECT ?v FROM STREAM <http://x/s> [RANGE 1s STEP 1s] "
        "WHERE { ?x ?p ?v }"
    )
    words = ["run", str(query), "--stream", f"http://x/s={file}", "--delimiter", ","]
    assert "--ssl" in call(*words, status=2).stderr


def test_a_bad_option_is_refused_before_anything_is_declared(url: str, client: Client) -> None:
    words = ["replay", "-", "--stream", "s"]
    found = call(*words, "--delimiter", ";;", text=GERMAN, status=2, url=url)
    assert "one character" in found.stderr
    found = call(*words, *FORMAT, "%H", text=GERMAN, status=1, url=url)
    assert "has no year" in found.stderr
    assert [stream["name"] for stream in client.streams()] == ["status"]


def test_an_ambiguous_date_names_line_column_and_option(url: str) -> None:
    text = "time;v\n03.04.2021 10:00;1\n"
    found = call("replay", "-", "--stream", "s", text=text, status=1, url=url)
    told = " ".join(found.stderr.split())
    assert "line 2: 'time': '03.04.2021 10:00' may begin with the day" in told
    assert "--time-format day-first, or --time-format '%m.%d.%Y %H:%M'" in told


@TABLES
def test_python(tmp_path: Path, text: str, options: list[str]) -> None:
    path = tmp_path / "s.csv"
    path.write_text(text)
    given = {
        word[2:].replace("-", "_"): value
        for word, value in zip(options[::2], options[1::2], strict=True)
    }
    found = dyknow.run(
        "monitor slow(?x in UAV) = speed(?x) < 2 with report verdicts",
        {"s": path},
        ssl=SSL,
        tables=dyknow.TableOptions(**given),
    )
    assert [row["verdict"] for row in found] == ["true", "false"]
