"""``dyknow replay`` of a pipe: standard input, and a named pipe that brings its rows slowly."""

from __future__ import annotations

import json
import os
import threading
import time
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from dyknow.service.cli import app
from dyknow.service.client.client import Client

CSV = "t,id,n\n1,a,1\n3,a,2\n2,a,3\n5,a,4\n4,a,5\n6,a,6\n"
NDJSON = "".join(f'{{"t": {t}, "id": "a", "n": {n}}}\n' for n, t in enumerate((1, 3, 2, 5, 4, 6)))


@pytest.fixture
def replay(url: str) -> Any:
    """Runs ``dyknow replay - --stream s`` on a text; asserts its status."""

    def run(text: str, *arguments: str, file: str = "-", stream: str = "s", status: int = 0) -> Any:
        words = ["replay", file, "--stream", stream, *arguments]
        found = CliRunner().invoke(app, words, input=text, env={"DYKNOW_URL": url})
        assert found.exit_code == status, (found.output, found.exception)
        return found

    return run


def samples(client: Client, stream: str) -> list[Any]:
    events = client.events(stream, since="start")
    return [(e.data["available"], e.data["values"]) for e in events if e.kind == "sample"]


@pytest.mark.parametrize("text", [CSV, NDJSON])
def test_rows_that_are_out_of_order_are_counted_and_left(
    replay: Any, client: Client, text: str
) -> None:
    found = replay(text, "--speed", "max")
    assert "s: 6 samples accepted, 6 evaluated" in found.stdout
    assert "s: not sorted: 2 of 6 rows were out of order" in found.stderr
    assert "write it to a file and replay that, whose rows are sorted" in " ".join(
        found.stderr.split()
    )
    assert client.stream("s")["ended"]


@pytest.mark.parametrize("text", [CSV, NDJSON])
def test_a_pipe_plays_what_the_file_plays_unsorted(
    replay: Any, client: Client, tmp_path: Path, text: str
) -> None:
    path = tmp_path / ("a.csv" if text is CSV else "a.ndjson")
    path.write_text(text)
    replay(text, "--speed", "max")
    replay("", "--speed", "max", "--no-sort", file=str(path), stream="file")
    assert samples(client, "s") == samples(client, "file")
    assert [values["n"] for _, values in samples(client, "s")] == list(
        range(1, 7) if text is CSV else range(6)
    )


def test_counts_for_programs(replay: Any) -> None:
    (told,) = map(json.loads, replay(CSV, "--speed", "max", "--json").stdout.splitlines())
    assert (told["accepted"], told["evaluated"]) == (6, 6)
    assert (told["out_of_order"], told["sorted"]) == (2, False)


def test_rows_in_order_are_not_spoken_of(replay: Any) -> None:
    found = replay("t,n\n1,1\n2,2\n2,3\n", "--speed", "max", "--json")
    (told,) = map(json.loads, found.stdout.splitlines())
    assert told["accepted"] == 3
    assert "sorted" not in told
    assert "sorted" not in found.stderr


@pytest.mark.parametrize("option", ["--sort", "--loop"])
def test_what_needs_all_rows_is_refused(replay: Any, client: Client, option: str) -> None:
    found = replay(CSV, option, status=2)
    told = " ".join(found.stderr.replace("│", " ").split())
    assert option in told
    assert "write it to a file and replay that" in told
    assert [stream["name"] for stream in client.streams()] == ["status"]


@pytest.mark.parametrize(
    ("text", "message"),
    [("", "the table is empty"), ("t,n\n", "no rows"), ("a,b\n1,2\n", "no column is called")],
)
def test_a_pipe_that_is_no_table_leaves_no_stream(
    replay: Any, client: Client, text: str, message: str
) -> None:
    assert message in replay(text, status=1).output
    assert [stream["name"] for stream in client.streams()] == ["status"]


def test_a_row_that_does_not_fit_is_named(replay: Any, client: Client) -> None:
    client.put_stream("s", {"id": "string", "n": "integer"})
    found = replay(CSV + "7,a,much\n", "--speed", "max", status=1)
    assert "line 8" in found.output
    assert "'much'" in found.output


def test_a_stream_keeps_the_types_of_its_fields(replay: Any, client: Client) -> None:
    client.put_stream("s", {"id": "string", "n": "float"})
    replay(CSV, "--speed", "max")
    kinds = {field["name"]: field["type"] for field in client.stream("s")["fields"]}
    assert kinds == {"id": "string", "n": "float"}


def test_a_rebased_pipe_may_be_of_any_length(replay: Any, client: Client) -> None:
    """How long it will be is not known: the stream takes any time."""
    (told,) = map(
        json.loads,
        replay(CSV, "--speed", "max", "--rebase", "now", "--json").stdout.splitlines(),
    )
    assert told["ahead"] == 0
    assert client.stream("s")["ahead"] == "oo"


def test_rows_are_published_as_they_come(url: str, client: Client, tmp_path: Path) -> None:
    """The pipe is open until what it brought first is in the stream."""
    client.put_stream("s", {"id": "string", "n": "integer"})
    pipe = tmp_path / "rows.csv"
    os.mkfifo(pipe)
    ended: list[Any] = []

    def run() -> None:
        words = ["replay", str(pipe), "--stream", "s", "--speed", "max", "--json"]
        ended.append(CliRunner().invoke(app, words, env={"DYKNOW_URL": url}))

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    with pipe.open("w", buffering=1) as writer:
        writer.write("t,id,n\n")
        for n in range(1, 4):
            writer.write(f"{n},a,{n}\n")
            writer.flush()
            until(lambda n=n: client.stream("s")["counters"]["accepted"] == n)
        assert not ended
        assert not client.stream("s")["ended"]
    thread.join(60)
    (found,) = ended
    assert found.exit_code == 0, found.output
    assert json.loads(found.stdout)["accepted"] == 3
    assert client.stream("s")["ended"]


def until(holds: Any) -> None:
    """Wait for what takes as long as the machine is busy."""
    for _ in range(6000):
        if holds():
            return
        time.sleep(0.01)
    raise AssertionError("it did not happen within a minute")
