"""PX4 logs: bytes written by hand, and a real flight where there is one."""

import sys

import numpy as np
import pytest
from shared_data import DATA
from ulog_bytes import TWO_TOPICS, data, form, log, subscribe

from dyknow.converters import WireError
from dyknow.converters.recordings.ulog import open_ulog

REAL = DATA / "px4" / "sample.ulg"
US = 1000

pytest.importorskip("pyulog", reason="pyulog is not installed: pip install dyknow[px4]")


@pytest.fixture
def write(tmp_path):
    def written(content, name="flight.ulg"):
        path = tmp_path / name
        path.write_bytes(content)
        return path

    return written


def rows(recording):
    return [row for incoming in recording for row in incoming.batch.rows()]


def test_a_stream_for_each_topic_instance(write):
    found = open_ulog(write(TWO_TOPICS))
    assert list(found.recordings) == ["attitude", "gps", "gps_1"]
    assert (found.dropouts, found.lost) == (2, 42_000_000)
    assert [recording.rows for recording in found.recordings.values()] == [3, 2, 1]
    kinds = {f.name: str(f.type) for f in found.recordings["attitude"].schema.fields}
    assert kinds == {
        "q_0": "float",
        "q_1": "float",
        "armed": "boolean",
        "where_x": "float",
        "where_y": "integer",
        "big": "float",
        "valid_": "integer",
    }
    assert found.notes == ("attitude.big is a float: not all of its integers fit signed 64 bits",)


def test_valid_is_when_it_was_sensed_and_available_when_it_was_published(write):
    recording = open_ulog(write(TWO_TOPICS)).recordings["attitude"]
    first, second, third = rows(recording)
    assert first[:2] == (1000 * US, 900 * US)
    assert second[:2] == (2000 * US, 2000 * US)  # nobody told when it was sensed
    assert third[:2] == (2000 * US, 1950 * US)  # of the same instant
    assert first[2] == {
        "q_0": 0.5,
        "q_1": None,
        "armed": True,
        "where_x": 1.5,
        "where_y": -2,
        "big": float(2**63),
        "valid_": 1,
    }
    assert second[2]["q_0"] is None
    assert rows(recording) == rows(recording)
    gps = open_ulog(write(TWO_TOPICS)).recordings["gps"]
    assert rows(gps) == [
        (1500 * US, 1500 * US, {"lat": 58.5}),
        (2500 * US, 2500 * US, {"lat": None}),
    ]


def test_what_was_published_before_the_log_began_became_available_then(write):
    content = bytearray(TWO_TOPICS)
    content[8:16] = (1200).to_bytes(8, "little")
    recording = open_ulog(write(bytes(content))).recordings["attitude"]
    assert [row[:2] for row in rows(recording)][:2] == [
        (1200 * US, 900 * US),
        (2000 * US, 2000 * US),
    ]


def test_what_does_not_tell_when_it_was_published_became_available_when_logged(write):
    text = log(
        form("told", "uint64_t timestamp", "int8_t x"),
        form("silent", "uint64_t timestamp", "int8_t y"),
        form("still", "uint64_t timestamp", "int8_t z"),
        *(subscribe(i, name) for i, name in enumerate(("told", "silent", "still"))),
        data(1, "Qb", 0, 1),
        data(0, "Qb", 50, 1),
        data(2, "Qb", 40, 1),
        data(1, "Qb", 0, 2),
        data(0, "Qb", 70, 2),
        data(2, "Qb", 40, 2),
        data(1, "Qb", 0, 3),
    )
    found = open_ulog(write(text)).recordings
    assert [row[:2] for row in rows(found["silent"])] == [(t * US, t * US) for t in (0, 50, 70)]
    assert [row[:2] for row in rows(found["still"])] == [(40 * US, 40 * US), (70 * US, 40 * US)]
    assert [row[:2] for row in rows(found["told"])] == [(50 * US, 50 * US), (70 * US, 70 * US)]


def test_times_are_moved_to_utc_by_the_receiver(write):
    text = log(
        form("vehicle_gps_position", "uint64_t timestamp", "uint64_t time_utc_usec"),
        subscribe(0, "vehicle_gps_position"),
        data(0, "QQ", 10, 0),
        data(0, "QQ", 30, 1_633_608_001_000_030),
    )
    recording = open_ulog(write(text), utc=True).recordings["vehicle_gps_position"]
    epoch = 1_633_608_001_000_000 * US
    assert [row[1] for row in rows(recording)] == [epoch + 10 * US, epoch + 30 * US]
    with pytest.raises(WireError, match="no satellite receiver"):
        open_ulog(write(TWO_TOPICS), utc=True)


def test_names_are_valid_and_distinct(write):
    text = log(
        form("a-b", "uint64_t timestamp", "int8_t x[0", "int8_t x_0", "int8_t 9"),
        form("a_b", "uint64_t timestamp", "int8_t z"),
        subscribe(0, "a-b"),
        subscribe(1, "a_b"),
        data(0, "Qbbb", 1, 1, 2, 3),
        data(1, "Qb", 1, 4),
    )
    found = open_ulog(write(text)).recordings
    assert [r.schema.names for r in found.values()] == [("x_0", "x_0_2", "field_9"), ("z",)]
    assert list(found) == ["a_b", "a_b_2"]


def test_topics_without_fields_or_messages_are_told(write):
    text = log(
        form("only", "uint64_t timestamp"),
        form("none", "uint64_t timestamp", "int8_t x"),
        form("some", "uint64_t timestamp", "int8_t x"),
        *(subscribe(i, name) for i, name in enumerate(("only", "none", "some"))),
        data(0, "Q", 1),
        data(2, "Qb", 1, 2),
    )
    found = open_ulog(write(text))
    assert list(found.recordings) == ["some"]
    assert any("only" in note for note in found.notes)
    with pytest.raises(WireError, match="no messages"):
        open_ulog(write(log()))


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "no PX4 log"),
        (b"time,x\n1,2\n" * 9, "no PX4 log"),
        (TWO_TOPICS[:-1], "cut off"),
        (TWO_TOPICS + b"\0", "cut off"),
        (log(data(7, "Q", 1)), "damaged|no messages"),
        (log(form("a", "uint64_t timestamp"), subscribe(0, "b")), "damaged|no messages"),
        (
            log(form("a", "uint64_t timestamp", "int8_t x"), subscribe(0, "a"), data(0, "b", 1)),
            "damaged|no messages",
        ),
        (
            log(
                form("a", "uint64_t timestamp", "int8_t x"),
                subscribe(0, "a"),
                data(0, "Qb", 2**63, 1),
            ),
            "outside 64-bit",
        ),
    ],
)
def test_what_is_no_whole_log_is_refused(write, content, message):
    with pytest.raises(WireError, match=message):
        open_ulog(write(content))


def test_cut_and_garbled_logs_never_raise_anything_else(write):
    random = np.random.default_rng(7)
    for _ in range(150):
        garbled = bytearray(TWO_TOPICS)
        for place in random.integers(16, len(garbled), 3):
            garbled[place] = random.integers(0, 256)
        try:
            open_ulog(write(bytes(garbled[: random.integers(17, len(garbled) + 1)])))
        except WireError:
            continue


def test_without_pyulog_it_says_what_to_install(write, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyulog", None)
    with pytest.raises(WireError, match="needs pyulog") as caught:
        open_ulog(write(TWO_TOPICS))
    assert caught.value.hint == "pip install 'dyknow[px4]'"


@pytest.mark.skipif(not REAL.exists(), reason="the recorded flight in shared/data is not here")
def test_a_real_flight():
    found = open_ulog(REAL)
    assert len(found.recordings) == 15
    assert found.dropouts == 4
    assert found.recordings["vehicle_attitude"].rows == 6461
    assert found.recordings["vehicle_attitude"].schema.names[3:] == ("q_0", "q_1", "q_2", "q_3")
    sensed = rows(found.recordings["actuator_controls_0"])
    assert all(available >= valid for available, valid, _ in sensed)
    # Told once, two seconds after boot, and logged again and again two minutes later.
    state = rows(found.recordings["commander_state"])
    assert {row[1] for row in state} == {2_069_758 * US}
    assert 112 * 10**9 < state[0][0] < 113 * 10**9 < 180 * 10**9 < state[-1][0]
    # Its timestamps are all 0.
    assert rows(found.recordings["sensor_preflight"])[-1][0] > 181 * 10**9
    for recording in found.recordings.values():
        times = np.concatenate([incoming.batch.available for incoming in recording])
        assert len(times) == recording.rows
        assert np.all(times[1:] >= times[:-1])  # rows of one time are one instant
        assert times[0] >= 112_500_176 * US
