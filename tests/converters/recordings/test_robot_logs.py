"""MCAP logs and bags of ROS: small ones, written by the libraries that read them."""

import json
import sys

import pytest
from robot_logs import BEGIN, MESSAGES, SECOND, STAMP, times, write_mcap, write_rosbag

from dyknow.converters import WireError
from dyknow.converters.recordings.many_streams import is_log, open_recordings
from dyknow.converters.recordings.topics import MOST_ELEMENTS, Topics

pytest.importorskip("mcap", reason="mcap is not installed: pip install 'dyknow[mcap]'")
pytest.importorskip("rosbags", reason="rosbags is not installed: pip install 'dyknow[rosbag]'")

WRITERS = {
    "a.mcap": write_mcap,
    "a.bag": lambda path: write_rosbag(path, 1),
    "folder": lambda path: write_rosbag(path, 2),
}
FILES = pytest.mark.parametrize("name", WRITERS)


def rows(recording):
    return [row for incoming in recording for row in incoming.batch.rows()]


def types(recording):
    return {field.name: str(field.type) for field in recording.schema.fields}


@FILES
def test_topics_are_streams_and_members_fields(tmp_path, name):
    path = tmp_path / name
    WRITERS[name](path)
    found = open_recordings([path])
    assert {"robot_odom", "robot_volt"} <= set(found)
    kinds = types(found["robot_odom"])
    assert kinds.pop("header.seq", "integer") == "integer"  # of ROS 1
    assert kinds.pop("position.z", "float") == "float"  # the definition of rosbags has it
    assert kinds == {
        "header.frame_id": "string",
        "position.x": "float",
        "position.y": "float",
        "q.0": "float",
        "q.1": "float",
        "q.2": "float",
        "q.3": "float",
        "image.0": "integer",
        "image.1": "integer",
        "image.2": "integer",
        "ok": "boolean",
        "big": "float",
    }
    values = rows(found["robot_odom"])[1][2]
    assert (values["position.x"], values["position.y"]) == (1.5, None)  # NaN is no_value
    assert (values["q.3"], values["ok"], values["big"]) == (1.0, False, float(2**63))
    assert types(found["robot_volt"]) == {"data": "float"}


@FILES
def test_stamps_are_valid_times_and_the_logs_are_available_times(tmp_path, name):
    path = tmp_path / name
    WRITERS[name](path)
    found = open_recordings([path])
    assert [row[:2] for row in rows(found["robot_odom"])] == [
        (times(i), (BEGIN + i - 1) * SECOND + STAMP) for i in range(MESSAGES)
    ]
    assert found["robot_odom"].time_column == "header.stamp"
    assert found["robot_odom"].has_available
    # Only MCAP has a time of publication beside that of the log.
    early = 1 if name == "a.mcap" else 0
    assert [row[:2] for row in rows(found["robot_volt"])] == [
        (times(i) + 1, times(i) + 1 - early) for i in range(MESSAGES)
    ]
    assert found["robot_volt"].time_column == "time of publication"


@FILES
def test_what_is_left_out_is_said(tmp_path, name):
    path = tmp_path / name
    WRITERS[name](path)
    found = open_recordings([path])
    assert found.dropouts is None
    notes = list(found.notes)
    if name == "a.mcap":
        assert notes.pop(0).startswith("/other is left out: its messages are protobuf")
    assert notes == [
        "/robot/odom: ranges is left out, an array of changing length",
        "/robot/odom: covariance is left out, an array of 36 elements; up to 16 become fields",
        "/robot/odom: big is a float: not all of its integers fit signed 64 bits",
    ]


def test_messages_in_json(tmp_path):
    write_mcap(tmp_path / "a.mcap")
    tags = open_recordings([tmp_path / "a.mcap"])["tags"]
    assert types(tags) == {"id": "string", "at.x": "integer", "n": "integer", "valid_": "boolean"}
    assert rows(tags)[1] == (
        times(1) + 2,
        times(1) + 2,
        {"id": "t1", "at.x": 1, "n": None, "valid_": True},
    )


@pytest.mark.parametrize(
    ("name", "version", "kind"),
    [("a.bag", 1, "BZ2"), ("a.bag", 1, "LZ4"), ("folder", 2, "MCAP"), ("folder", 2, "ZSTD")],
)
def test_bags_of_each_storage_and_compression(tmp_path, name, version, kind):
    plain, other = tmp_path / f"plain_{name}", tmp_path / name
    write_rosbag(plain, version)
    write_rosbag(other, version, kind)
    expected, found = open_recordings([plain]), open_recordings([other])
    assert list(found) == list(expected)
    for topic, recording in expected.items():
        assert rows(found[topic]) == rows(recording)
    for file in other.iterdir() if other.is_dir() else [other]:
        whole = file.read_bytes()
        file.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(WireError, match="damaged or cut off"):
        open_recordings([other])


def test_a_bag_of_ros_2_may_be_named_by_its_file(tmp_path):
    write_rosbag(tmp_path / "folder", 2)
    (file,) = (tmp_path / "folder").glob("*.db3")
    assert list(open_recordings([file])) == list(open_recordings([tmp_path / "folder"]))


def test_a_folder_of_logs_and_tables(tmp_path):
    write_mcap(tmp_path / "a.mcap")
    (tmp_path / "b.csv").write_text("t,x\n1,1\n")
    assert set(open_recordings([tmp_path])) == {"b", "robot_odom", "robot_volt", "tags"}
    assert not is_log(tmp_path)
    write_rosbag(tmp_path / "folder", 2)
    with pytest.raises(WireError, match="stream 'robot_odom' in another file"):
        open_recordings([tmp_path])
    with pytest.raises(WireError, match="holds many streams"):
        open_recordings([f"name={tmp_path / 'folder'}"])


@pytest.mark.parametrize("name", ["a.mcap", "a.bag", "a.db3"])
def test_what_is_no_log_is_refused(tmp_path, name):
    path = tmp_path / name
    for data in (b"", b"time,x\n1,2\n" * 99, b"\0" * 999):
        path.write_bytes(data)
        with pytest.raises(WireError, match=rf"{name}: (this is no|the log has no)"):
            open_recordings([path])


@pytest.mark.parametrize("name", ["a.mcap", "a.bag"])
def test_damaged_logs_never_raise_anything_else(tmp_path, name):
    path = tmp_path / name
    WRITERS[name](path)
    whole = path.read_bytes()
    refused = 0
    for place in range(5, len(whole), max(1, len(whole) // 150)):
        flipped = bytearray(whole)
        flipped[place] ^= 255
        for data in (whole[:place], bytes(flipped)):
            path.write_bytes(data)
            try:
                open_recordings([path])
            except WireError:
                refused += 1
    assert refused > 150


@pytest.mark.parametrize(
    ("name", "module", "extra"), [("a.mcap", "mcap", "mcap"), ("a.bag", "rosbags", "rosbag")]
)
def test_without_the_extra_it_says_what_to_install(tmp_path, monkeypatch, name, module, extra):
    WRITERS[name](tmp_path / name)
    for known in [*sys.modules]:
        if known.partition(".")[0] == module:
            monkeypatch.delitem(sys.modules, known)
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(WireError, match=f"needs {module}") as caught:
        open_recordings([tmp_path / name])
    assert caught.value.hint == f"pip install 'dyknow[{extra}]'"


def collected(*messages):
    topics = Topics()
    for i, message in enumerate(messages):
        topics.add("/a/b c", message, i + 1)
    return topics.log("a.mcap")


def test_names_are_valid_and_distinct():
    topics = Topics()
    for name in ("/a/b", "a_b", "/9"):
        topics.add(name, {"x": 1}, 1)
    assert list(topics.log("a").recordings) == ["a_b", "a_b_2", "topic_9"]
    log = collected({'a"b': 1, "valid": 2, "x": {"available": 3}})
    assert log.recordings["a_b_c"].schema.names == ("a_b", "valid_", "x.available")


def test_a_member_that_is_missing_is_no_value():
    log = collected({"x": 1}, {"y": {"z": 2}}, {"x": None})
    assert [row[2] for row in rows(log.recordings["a_b_c"])] == [
        {"x": 1, "y.z": None},
        {"x": None, "y.z": 2},
        {"x": None, "y.z": None},
    ]


@pytest.mark.parametrize(
    ("stamp", "valid"),
    [
        ({"sec": 3, "nanosec": 5}, 3 * SECOND + 5),
        ({"secs": 3, "nsecs": 5}, 3 * SECOND + 5),
        ({"sec": 3, "nsec": 5}, 3 * SECOND + 5),
        ({"sec": 0, "nanosec": 0}, 1),
        ({"sec": 3}, 1),
        ({"sec": "3", "nanosec": 5}, 1),
        ([3, 5], 1),
        (3, 1),
        (None, 1),
    ],
)
def test_a_stamp_has_seconds_and_nanoseconds(stamp, valid):
    log = collected({"header": {"stamp": stamp, "seq": 1}, "x": 1})
    assert rows(log.recordings["a_b_c"])[0][:2] == (1, valid)


def test_a_header_of_another_kind_is_a_field():
    assert types(collected({"header": "h"}).recordings["a_b_c"]) == {"header": "string"}
    assert types(collected({"header": [1, 2]}).recordings["a_b_c"]) == {
        "header.0": "integer",
        "header.1": "integer",
    }


def test_arrays_of_few_elements_are_fields():
    most = list(range(MOST_ELEMENTS))
    log = collected({"x": 1, "most": most, "more": [*most, 0], "none": [], "deep": [{"a": 1}]})
    assert [name for name in log.recordings["a_b_c"].schema.names if "." in name] == [
        f"most.{i}" for i in most
    ]
    assert json.dumps(log.notes).count("is left out") == 3


def test_a_time_outside_64_bits_names_its_topic():
    topics = Topics()
    with pytest.raises(WireError, match="/a: its times are outside"):
        topics.add("/a", {"x": 1}, 2**63)


def test_topics_without_fields_are_told():
    topics = Topics()
    topics.add("/only", {"header": {"stamp": {"sec": 1, "nanosec": 1}}}, 1)
    with pytest.raises(WireError, match="no messages that can be read") as caught:
        topics.log("a.mcap")
    assert "/only has no fields" in caught.value.hint
