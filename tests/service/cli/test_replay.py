"""A recording in parts: cut by time, moved in time, due at its pace; recordings of many streams."""

from __future__ import annotations

import json
from inspect import getattr_static
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rich.progress import Progress, TaskID
from typer.testing import CliRunner
from ulog_bytes import TWO_TOPICS

from dyknow.converters.recordings.recording import open_recording
from dyknow.converters.wire import Incoming
from dyknow.engine.processes.geodesy import SpeedFromCoordinates
from dyknow.service.cli import app
from dyknow.service.cli.recordings import playing
from dyknow.service.cli.recordings.demonstration import demo_files
from dyknow.service.cli.recordings.recording_replay import (
    PAUSE,
    ROWS,
    Part,
    Span,
    play,
    play_all,
    span,
)
from dyknow.service.client.client import Client
from dyknow.streams.sample import (
    Field,
    FieldType,
    SampleBatch,
    Schema,
    batch_from_rows,
)
from dyknow.streams.time import MILLISECOND, SECOND, format_time

SCHEMA = Schema((Field("n", FieldType.INTEGER),))


def recording(times: list[int], size: int = 7) -> list[Incoming]:
    rows = [(time, time - 5, {"n": n}) for n, time in enumerate(times)]
    return [
        Incoming(batch_from_rows(SCHEMA, rows[i : i + size]), False)
        for i in range(0, len(rows), size)
    ]


def numbers(parts: list[Part]) -> list[int]:
    return [n for part in parts for n in part.batch.columns["n"].values.tolist()]


def test_span() -> None:
    assert span([]) is None
    assert span(recording([30, 10, 20])) == Span(10, 30)
    assert Span(10, 30).period == 20 + PAUSE


def test_no_speed_spans_the_loop_of_a_recording() -> None:
    """The aircraft fly from where the recording ends to where it begins, at 44,332 km/h."""
    with demo_files() as (path, _, _):
        flown = open_recording(path)
        extent = span(flown)
        assert extent is not None
        speed, rounds = SpeedFromCoordinates(), []
        for turn in range(2):
            parts = play(flown, extent.first, shift=turn * extent.period)
            rounds.append([speeds_of(speed, part.batch) for part in parts])
    first, second = (np.concatenate(each) for each in rounds)
    assert len(first) > 5_000
    # An aircraft at its stand is at one place in both rounds: that it has not moved is no jump.
    assert np.array_equal(first[first > 0], second[second > 0])


def speeds_of(speed: SpeedFromCoordinates, batch: SampleBatch) -> np.ndarray[Any, Any]:
    position = [batch.columns[name] for name in ("latitude", "longitude")]
    rows = np.logical_and(*(column.present for column in position))
    latitude, longitude = (column.values[rows] for column in position)
    speeds, present = speed(
        batch.columns["icao24"].values[rows].astype(np.int64),
        batch.valid[rows],
        latitude,
        longitude,
    )
    return speeds[present]


def test_at_full_speed_all_is_due_at_once() -> None:
    times = list(range(0, (ROWS + 10) * SECOND, SECOND))
    parts = list(play(recording(times, len(times)), 0))
    assert [len(part.batch) for part in parts] == [ROWS, 10]
    assert {part.due for part in parts} == {0}


def test_a_part_is_due_when_its_last_sample_is() -> None:
    times = [100 * SECOND + i * 40 * MILLISECOND for i in range(6)]  # 0 .. 200 ms
    parts = list(play(recording(times), times[0], speed=1.0))
    assert [len(part.batch) for part in parts] == [3, 2, 1]
    assert [part.due for part in parts] == [80 * MILLISECOND, 160 * MILLISECOND, 200 * MILLISECOND]
    twice = list(play(recording(times), times[0], speed=2.0))
    assert twice[-1].due == 100 * MILLISECOND


def test_both_times_are_moved() -> None:
    part = next(play(recording([10, 20]), 10, shift=1000))
    assert part.batch.available.tolist() == [1010, 1020]
    assert part.batch.valid.tolist() == [1005, 1015]


@given(
    st.lists(st.integers(0, 10 * SECOND), min_size=1, max_size=60).map(sorted),
    st.sampled_from([None, 0.5, 1.0, 10.0]),
    st.integers(1, 20),
)
@settings(deadline=None, max_examples=60)
def test_nothing_is_lost_or_out_of_order(times: list[int], speed: float | None, size: int) -> None:
    parts = list(play(recording(times, size), times[0], speed=speed))
    assert numbers(parts) == list(range(len(times)))
    assert all(a.due <= b.due for a, b in pairwise(parts))
    assert all(len(part.batch) for part in parts)


def test_batches_are_views_not_copies() -> None:
    batch: SampleBatch = recording([1, 2, 3])[0].batch
    part = next(play([Incoming(batch, False)], 1))
    assert np.shares_memory(part.batch.columns["n"].values, batch.columns["n"].values)


def test_several_recordings_come_in_order_of_time() -> None:
    both = {
        "a": recording([i * SECOND for i in range(5)]),
        "b": recording([i * SECOND + SECOND // 2 for i in range(5)]),
    }
    for speed in (1.0, 1e9):
        parts = list(play_all(both, 0, speed=speed, shift=7))  # type: ignore[arg-type]
        for name in both:
            mine = [part for stream, part in parts if stream == name]
            assert numbers(mine) == list(range(5))
            assert mine[0].batch.available[0] == both[name][0].batch.available[0] + 7
    paced = list(play_all(both, 0, speed=2.0))  # type: ignore[arg-type]
    assert [name for name, _ in paced] == ["a", "b"] * 5
    assert [part.due for _, part in paced] == [i * SECOND // 4 for i in range(10)]
    at_once = list(play_all(both, 0))  # type: ignore[arg-type]
    assert [(name, part.due) for name, part in at_once] == [("a", 0), ("b", 0)]


LINES = "\n".join(
    f'{{"stream": "{name}", "t": {1_633_608_000 + i}, "{name}": {i}}}'
    for i in range(4)
    for name in ("speed", "height")
)


@pytest.fixture
def command(url: str) -> Any:
    """Runs ``dyknow replay`` against the live service; asserts its status."""

    def run(*arguments: str, status: int = 0) -> Any:
        found = CliRunner().invoke(app, ["replay", *arguments], env={"DYKNOW_URL": url})
        assert found.exit_code == status, (found.output, found.exception)
        return found

    return run


def test_lines_of_many_streams_are_published_to_each(
    command: Any, client: Client, tmp_path: Path
) -> None:
    path = tmp_path / "many.ndjson"
    path.write_text(LINES)
    told = command(str(path), "--speed", "max", "--json").stdout.splitlines()
    counts = [json.loads(line) for line in told]
    assert [(line["stream"], line["used"]) for line in counts] == [("height", 4), ("speed", 4)]
    assert "dropouts" not in counts[0]
    assert client.stream("speed")["ended"]
    chosen = command(str(path), "--stream", "speed=again", "--speed", "max").stdout
    assert "again: 4 samples accepted" in chosen
    assert "height" not in chosen
    assert client.stream("again")["fields"] == client.stream("speed")["fields"]


def test_the_bar_counts_published_and_evaluated_samples(
    command: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It goes on until the readers have evaluated all."""
    evaluation, update = getattr_static(Client, "evaluation"), Progress.update
    behind, shown = [3, 3, 3, 2, 2, 1], []

    def late(client: Client, name: str) -> dict[str, Any]:
        found = evaluation.__get__(client, Client)(name)
        lacking = behind.pop(0) if found["last"] == 4 and behind else 0
        return {**found, "evaluated": found["last"] - lacking}

    def noted(progress: Progress, task: TaskID, **fields: Any) -> None:
        shown.append(fields.get("evaluated"))
        update(progress, task, **fields)

    monkeypatch.setattr(playing, "_LOOK", 0)
    monkeypatch.setattr(Client, "evaluation", late)
    monkeypatch.setattr(Progress, "update", noted)
    path = tmp_path / "four.csv"
    path.write_text("t,v\n" + "".join(f"{t},0.5\n" for t in range(4)))
    found = command(str(path), "--stream", "s5", "--speed", "max")
    assert "4/4 published, 4 evaluated" in found.stderr
    counts = [count for count in shown if count is not None]
    assert counts[0] == 1
    assert counts == sorted(counts)


@pytest.mark.parametrize("is_csv", [True, False])
def test_numbers_that_are_rounded_are_told(
    command: Any, client: Client, tmp_path: Path, is_csv: bool
) -> None:
    path = tmp_path / ("float.csv" if is_csv else "float.ndjson")
    values = ("0.5", "1e-400", "9007199254740993")
    lines = [f"{t},{v}" if is_csv else f'{{"t":{t},"v":{v}}}' for t, v in enumerate(values)]
    path.write_text("\n".join(["t,v", *lines] if is_csv else lines))
    told = command(str(path), "--stream", "s5", "--speed", "max").stdout
    line = 3 if is_csv else 2
    expected = f"rounded 2 numbers to the nearest double, the first in line {line}, field 'v'"
    assert told.count(expected) == 1
    arguments = ("--stream", "again", "--speed", "max", "--json")
    counts = json.loads(command(str(path), *arguments).stdout)
    assert counts["rounded"] == {"count": 2, "line": line, "field": "v"}
    path.write_text("t,v\n0,0.5\n" if is_csv else '{"t":0,"v":0.5}')
    assert "rounded" not in json.loads(command(str(path), *arguments).stdout)


def test_a_stream_keeps_the_types_of_its_fields(
    command: Any, client: Client, tmp_path: Path
) -> None:
    path = tmp_path / "many.ndjson"
    path.write_text(LINES)
    client.put_stream("speed", {"speed": "string"})
    command(str(path), "--speed", "max")
    assert client.stream("speed")["fields"][0]["type"] == "string"
    assert client.stream("speed")["counters"]["used"] == 4


def test_which_streams_of_which_file(command: Any, client: Client, tmp_path: Path) -> None:
    table, many = tmp_path / "table.csv", tmp_path / "many.ndjson"
    table.write_text("t,x\n1,2\n")
    many.write_text(LINES)
    command(str(table), status=2)
    command(str(table), "--stream", "a", "--stream", "b", status=2)
    command(str(many), "--stream", "nowhere", status=2)
    command(str(many), "--stream", "speed=a", "--stream", "height=a", status=2)
    many.write_text(LINES + '\n{"stream": "speed", "t": "soon"}')
    command(str(many), status=1)
    assert [stream["name"] for stream in client.streams()] == ["status"]


def test_a_flight_log_is_published_topic_by_topic(
    command: Any, client: Client, tmp_path: Path
) -> None:
    pytest.importorskip("pyulog", reason="pyulog is not installed: pip install dyknow[px4]")
    path = tmp_path / "flight.ulg"
    path.write_bytes(TWO_TOPICS)
    # The service's clock stands in 2021.
    told = command(str(path), "--speed", "10", "--ahead", "oo").stdout
    assert "attitude: 3 samples accepted" in told
    assert "dropouts: 2, 0.042 s were not logged" in told
    assert "note: attitude.big" in told
    assert client.stream("gps_1")["counters"]["used"] == 1
    rebased = command(str(path), "--rebase", "now", "--stream", "gps", "--json").stdout
    assert json.loads(rebased)["used"] == 2
    assert json.loads(rebased)["dropouts"] == 2
    assert "no satellite receiver" in command(str(path), "--utc", status=1).stderr
    path.write_bytes(TWO_TOPICS[:-2])
    assert "cut off" in command(str(path), status=1).stderr


def table(path: Path, *times: str) -> Path:
    rows = (f"{time},{time},{n}\n" for n, time in enumerate(times))
    path.write_text("valid,available,n\n" + "".join(rows))
    return path


HONEST = ("2021-10-07T10:00:00Z", "2021-10-07T10:00:01Z")
WILD = "2262-04-11T23:47:16Z"


@pytest.mark.parametrize("more", [("--speed", "max"), ("--speed", "50")])
@pytest.mark.parametrize("rebase", [(), ("--rebase", "2021-10-07T11:00:00Z")])
def test_a_row_ahead_of_the_clock_is_named_and_left_out(
    command: Any, client: Client, tmp_path: Path, more: tuple[str, ...], rebase: tuple[str, ...]
) -> None:
    """Nothing waits until it is due, either."""
    path = table(tmp_path / "t.csv", HONEST[0], WILD, HONEST[1])
    found = command(str(path), "--stream", "s", "--json", *more, *rebase)
    (told,) = map(json.loads, found.stdout.splitlines())
    assert (told["accepted"], told["used"], told["late"], told["ahead"]) == (2, 2, 0, 1)
    assert "s: left out n=1: 'available' is 2262-04-11" in found.stderr
    assert client.stream("s")["counters"]["ahead"] == 1
    people = command(str(path), "--stream", "t", *more, *rebase).stdout
    assert "left out 1, ahead of the clock" in people


def test_a_recording_of_the_future(command: Any, client: Client, tmp_path: Path) -> None:
    path = table(tmp_path / "t.csv", WILD)
    refused = command(str(path), "--stream", "s", "--speed", "max", status=1)
    assert "the first is of 2262-04-11T23:47:16Z, and now it is" in refused.output
    assert "--ahead oo" in refused.output
    told = command(str(path), "--stream", "s", "--speed", "max", "--ahead", "oo", "--json").stdout
    assert (json.loads(told)["used"], json.loads(told)["ahead"]) == (1, 0)
    assert client.stream("s")["ahead"] == "oo"


def test_a_recording_of_the_future_may_be_moved_back(
    command: Any, client: Client, tmp_path: Path
) -> None:
    path = table(tmp_path / "t.csv", "2100-01-01T00:00:00Z", "2100-01-01T00:00:01Z")
    moved = ("--rebase", "2021-10-07T11:00:00Z")
    told = json.loads(
        command(str(path), "--stream", "s", "--speed", "max", "--json", *moved).stdout
    )
    assert (told["used"], told["ahead"]) == (2, 0)
    assert client.stream("s")["last_valid"] == "2021-10-07T11:00:01Z"


def test_a_rebased_recording_may_get_as_far_ahead_as_it_is_long(
    command: Any, client: Client, clock: Any, tmp_path: Path
) -> None:
    path = table(tmp_path / "t.csv", HONEST[0], "2021-10-07T15:00:00Z", WILD)
    begin = format_time(clock.now)
    words = (str(path), "--stream", "s", "--speed", "max", "--rebase", begin, "--json")
    told = json.loads(command(*words).stdout)
    assert (told["used"], told["ahead"]) == (2, 1)
    assert client.stream("s")["ahead"] == "6h"
