"""Rows of recordings in order of time, whatever the size of a run."""

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from dyknow.converters.recordings import time_order
from dyknow.converters.recordings.piped import open_pipe
from dyknow.converters.recordings.recording import open_recording
from dyknow.converters.recordings.table_options import TableOptions
from dyknow.converters.recordings.time_order import in_time_order

SMALL = settings(
    deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=60
)


def table(path, times, stamps=None):
    """A table of rows that are numbered, and named by text."""
    stamps = times if stamps is None else stamps
    head = "valid,available,n,name"
    rows = [f"{t},{a},{n},row {n}" for n, (t, a) in enumerate(zip(times, stamps, strict=True))]
    path.write_text("\n".join([head, *rows]) + "\n")
    return open_recording(path, TableOptions(time_unit="ns"))


def rows_of(recording):
    return [
        (valid, values["n"], values["name"])
        for incoming in recording
        for _, valid, values in incoming.batch.rows()
    ]


@SMALL
@given(st.lists(st.integers(0, 9), min_size=1, max_size=30), st.integers(1, 8))
def test_rows_are_sorted_by_time_and_then_as_they_stood(tmp_path, times, run):
    recording = table(tmp_path / "a.csv", times)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(time_order, "RUN", run)
        patch.setattr(time_order, "CHUNK", 3)
        order = in_time_order(recording, sort=True)
        expected = sorted((t, n, f"row {n}") for n, t in enumerate(times))
        assert rows_of(order.recording) == expected
        assert rows_of(order.recording) == expected  # read again
    assert order.out_of_order == sum(t < max(times[: n + 1]) for n, t in enumerate(times))
    assert order.is_sorted == (order.out_of_order > 0)


def test_available_times_decide_where_the_table_has_them(tmp_path):
    recording = table(tmp_path / "a.csv", [5, 4, 3], [1, 2, 3])
    order = in_time_order(recording)
    assert order.out_of_order == 0
    assert order.note is None
    assert [valid for valid, *_ in rows_of(order.recording)] == [5, 4, 3]


@pytest.mark.parametrize("stamped", [False, True])
def test_the_note_says_what_becomes_of_rows_that_are_left(tmp_path, stamped):
    """A row with an available time of its own keeps it, and comes late."""
    path = tmp_path / "a.csv"
    path.write_text("valid,available,n\n3,3,0\n1,1,1\n" if stamped else "valid,n\n3,0\n1,1\n")
    recording = open_recording(path, TableOptions(time_unit="ns"))
    taken = [int(time) for incoming in recording for time in incoming.batch.available]
    assert taken == ([3, 1] if stamped else [3, 3])
    with path.open("rb") as file:
        piped = open_pipe(file, TableOptions(time_unit="ns"))
        assert len(list(piped.recording)) > 0
    for note in (in_time_order(recording, sort=False).note, piped.note):
        assert note.startswith("not sorted: 1 of 2 rows were out of order, and each ")
        assert ("it is late where the lateness of the stream is shorter" in note) == stamped
        assert ("becomes available just after the row above it" in note) == (not stamped)


def test_a_large_table_is_sorted_on_demand_only(tmp_path, monkeypatch):
    monkeypatch.setattr(time_order, "RUN", 1)
    monkeypatch.setattr(time_order, "RUNS", 2)
    recording = table(tmp_path / "a.csv", [3, 1, 2])
    assert not in_time_order(recording).is_sorted
    assert "2 of 3 rows were out of order" in in_time_order(recording).note
    assert "--sort" in in_time_order(recording, sort=False).note
    assert in_time_order(recording, sort=True).note == "sorted: 2 of 3 rows were out of order"
