"""Recordings of many streams: what is accepted, what each holds, and their common order."""

import json
import os
from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from ulog_bytes import TWO_TOPICS

from dyknow.converters import WireError
from dyknow.converters.recordings.many_streams import (
    has_many_streams,
    in_order,
    open_recordings,
    open_stream,
)
from dyknow.converters.recordings.table_options import TableOptions
from dyknow.converters.wire import Incoming
from dyknow.streams.sample import Field, FieldType, Schema, batch_from_rows
from dyknow.streams.time import SECOND

MANY = (
    '{"stream": "gps", "t": 1, "lat": 1.5}\n'
    '{"stream": "imu", "t": 2, "x": 1, "id": "a"}\n'
    "\n"
    '{"t": 200000000000, "lat": 2, "stream": "gps"}\n'
)


def rows(recording):
    return [row for incoming in recording for row in incoming.batch.rows()]


def kinds(recording):
    return {field.name: str(field.type) for field in recording.schema.fields}


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "b.csv").write_text("t,x\n1,1\n3,2\n")
    (tmp_path / "2nd-run.ndjson").write_text('{"t": 2, "y": true}\n')
    (tmp_path / "notes.txt").write_text("no recording")
    return tmp_path


def test_lines_that_name_their_stream(tmp_path):
    path = tmp_path / "many.ndjson"
    path.write_text(MANY)
    found = open_recordings([path])
    assert has_many_streams(path)
    assert {name: kinds(recording) for name, recording in found.items()} == {
        "gps": {"lat": "float"},
        "imu": {"x": "integer", "id": "string"},
    }
    # The unit of the file's times is one, though imu alone would be seconds.
    assert [row[1] for row in rows(found["imu"])] == [2_000_000]
    assert rows(found["gps"])[1] == (2 * 10**17, 2 * 10**17, {"lat": 2.0})
    assert rows(found["gps"]) == rows(found["gps"])
    given = open_recordings([path], types={"imu": {"x": FieldType.FLOAT}})
    assert kinds(given["imu"])["x"] == "float"


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ('{"t": 1, "x": 1}', "'stream' is missing"),
        ('{"t": 1, "stream": 3}', "'stream' is missing"),
        ('{"t": 1, "stream": "a b"}', "no name"),
        ('{"t": "soon", "stream": "gps", "lat": 1}', "'t'"),
        ("[]", "object"),
    ],
)
def test_bad_lines_are_named(tmp_path, line, message):
    path = tmp_path / "many.ndjson"
    path.write_text(MANY + line)
    with pytest.raises(WireError, match=message) as caught:
        rows(open_recordings([path])["gps"])
    assert caught.value.line == 5


def test_folders_files_and_names(folder, tmp_path):
    assert list(open_recordings([folder])) == ["b", "stream_2nd_run"]
    named = open_recordings([f"speeds={folder / 'b.csv'}", folder / "b.csv"])
    assert {name: recording.rows for name, recording in named.items()} == {"b": 2, "speeds": 2}
    with pytest.raises(WireError, match="in another file already") as caught:
        open_recordings([folder, folder / "b.csv"])
    assert "NAME=FILE" in caught.value.hint
    (tmp_path / "empty").mkdir()
    with pytest.raises(WireError, match="no recording in this folder"):
        open_recordings([tmp_path / "empty"])
    with pytest.raises(WireError, match="holds many streams"):
        open_recordings([f"name={folder}"])
    with pytest.raises(FileNotFoundError):
        open_recordings([tmp_path / "nowhere.csv"])


def test_a_flight_log_and_its_losses(folder):
    pytest.importorskip("pyulog", reason="pyulog is not installed: pip install dyknow[px4]")
    (folder / "flight.ulg").write_bytes(TWO_TOPICS)
    found = open_recordings([folder])
    assert list(found) == ["attitude", "b", "gps", "gps_1", "stream_2nd_run"]
    assert (found.dropouts, found.lost, len(found.notes)) == (2, 42_000_000, 1)
    with pytest.raises(WireError, match="holds many streams"):
        open_recordings([f"name={folder / 'flight.ulg'}"])


SCHEMA = Schema((Field("n", FieldType.INTEGER),))


def cut(times, size):
    made = [(time, 0, {"n": n}) for n, time in enumerate(times)]
    return [
        Incoming(batch_from_rows(SCHEMA, made[i : i + size]), False)
        for i in range(0, len(made), size)
    ]


TIMES = st.lists(
    st.integers(0, 60) | st.integers(-(2**63), 2**63 - 1), max_size=20, unique=True
).map(sorted)


@given(
    st.dictionaries(st.sampled_from("abc"), TIMES),
    st.integers(1, 30),
    st.integers(1, 7),
    st.integers(1, 7),
)
@settings(deadline=None, max_examples=100)
def test_all_samples_come_in_order_of_time(streams, step, size, other):
    merged = list(in_order({n: cut(times, size) for n, times in streams.items()}, step))
    for name, times in streams.items():
        got = [t for n, part in merged if n == name for t in part.batch.available.tolist()]
        assert got == times
    slots = [part.batch.available // step for _, part in merged]
    assert all(slot[0] == slot[-1] for slot in slots)
    assert all(a[0] <= b[0] for a, b in pairwise(slots))

    def samples(parts):
        """By slice and stream: how a stream was cut into chunks must not tell."""
        every = [(t // step, n, t) for n, part in parts for t in part.batch.available.tolist()]
        return sorted(every)

    again = in_order({n: cut(times, other) for n, times in streams.items()}, step)
    assert samples(merged) == samples(again)


def test_rows_that_step_back_stay_in_their_place():
    merged = list(in_order({"a": cut([5, 25, 7, 31], 2), "b": cut([8], 1)}, 10))
    told = [(name, part.batch.available.tolist()) for name, part in merged]
    assert told == [("a", [5]), ("b", [8]), ("a", [25]), ("a", [7]), ("a", [31])]
    with pytest.raises(ValueError, match="longer than 0"):
        list(in_order({}, 0))


def test_slices_are_seconds_unless_told(tmp_path):
    path = tmp_path / "many.ndjson"
    lines = [{"stream": s, "t": i * 0.25, "x": i} for i in range(12) for s in ("a", "b")]
    path.write_text("\n".join(map(json.dumps, lines)))
    merged = list(in_order(open_recordings([path], TableOptions(time_unit="s"))))
    assert [(name, len(part.batch)) for name, part in merged] == [("a", 4), ("b", 4)] * 3
    assert merged[2][1].batch.available[0] == SECOND


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no named pipes")
@pytest.mark.parametrize("open_it", [open_stream, lambda path, _: open_recordings([path])])
def test_a_pipe_is_refused_before_it_is_read(tmp_path, open_it):
    """Its first line was looked at, and waited for."""
    os.mkfifo(tmp_path / "a.ndjson")
    with pytest.raises(WireError, match="is a pipe"):
        open_it(tmp_path / "a.ndjson", "a")


def test_a_stream_of_a_file(tmp_path):
    path = tmp_path / "many.ndjson"
    path.write_text(MANY)
    every = open_recordings([path])
    assert [rows(open_stream(path, name)) for name in every] == [
        rows(each) for each in every.values()
    ]
    with pytest.raises(WireError, match="no stream 'other' in this recording"):
        open_stream(path, "other")
    (tmp_path / "b.csv").write_text("t,x\n1,2\n")
    assert open_stream(tmp_path / "b.csv", "other").rows == 1
