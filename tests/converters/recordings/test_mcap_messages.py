"""Messages of MCAP logs in Protobuf and of ROS 1."""

from __future__ import annotations

import struct
import sys
from pathlib import Path

import pytest

pytest.importorskip("mcap", reason="mcap is not installed: pip install 'dyknow[mcap]'")

from google.protobuf.descriptor_pb2 import FieldDescriptorProto, FileDescriptorProto
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass
from google.protobuf.timestamp_pb2 import DESCRIPTOR as TIMESTAMP
from mcap.writer import Writer
from mcap_protobuf.schema import build_file_descriptor_set

from dyknow.converters.errors import WireError
from dyknow.converters.recordings.many_streams import open_recordings

SECOND = 1_000_000_000
ROS1 = f"""Header header
geometry_msgs/Point position
int32[2] counts
{"=" * 80}
MSG: std_msgs/Header
uint32 seq
time stamp
string frame_id
{"=" * 80}
MSG: geometry_msgs/Point
float64 x
float64 y
float64 z
"""
KINDS = {
    "level": (FieldDescriptorProto.TYPE_DOUBLE, ""),
    "count": (FieldDescriptorProto.TYPE_INT64, ""),
    "ok": (FieldDescriptorProto.TYPE_BOOL, ""),
    "name": (FieldDescriptorProto.TYPE_STRING, ""),
    "timestamp": (FieldDescriptorProto.TYPE_MESSAGE, ".google.protobuf.Timestamp"),
    "position": (FieldDescriptorProto.TYPE_MESSAGE, ".robots.Place"),
}


def messages():
    """The classes of ``robots.State`` and ``robots.Place``."""
    file = FileDescriptorProto(name="robots.proto", package="robots", syntax="proto3")
    file.dependency.append(TIMESTAMP.name)
    place = file.message_type.add(name="Place")
    place.field.add(name="x", number=1, type=FieldDescriptorProto.TYPE_DOUBLE, label=1)
    place.field.add(name="q", number=2, type=FieldDescriptorProto.TYPE_FLOAT, label=3)
    state = file.message_type.add(name="State")
    for number, (name, (kind, of)) in enumerate(KINDS.items(), 1):
        state.field.add(name=name, number=number, type=kind, type_name=of or None, label=1)
    pool = DescriptorPool()
    pool.AddSerializedFile(TIMESTAMP.serialized_pb)
    pool.Add(file)
    return [GetMessageClass(pool.FindMessageTypeByName(f"robots.{n}")) for n in ("State", "Place")]


def write(
    path: Path, name: str, encoding: str, kind: str, schema: bytes, data: list[bytes]
) -> Path:
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        id = writer.register_schema(name, kind, schema)
        channel = writer.register_channel("/state", encoding, id)
        for i, message in enumerate(data):
            writer.add_message(channel, (100 + i) * SECOND, message, (100 + i) * SECOND)
        writer.finish()
    return path


def rows(path: Path):
    (recording,) = open_recordings([path]).values()
    return [row for batch in recording.read() for row in batch.rows()]


def test_protobuf(tmp_path: Path) -> None:
    state, place = messages()
    schema = build_file_descriptor_set(state).SerializeToString()
    full = state(level=1.5, count=2**40, ok=True, name="a")
    full.timestamp.seconds, full.timestamp.nanos = 90, 7
    full.position.CopyFrom(place(x=3.0, q=[1.0, 2.0]))
    sent = [full.SerializeToString(), state(level=2.0).SerializeToString()]
    path = write(tmp_path / "a.mcap", "robots.State", "protobuf", "protobuf", schema, sent)
    first, second = rows(path)
    assert first == (
        100 * SECOND,
        90 * SECOND + 7,
        {
            "level": 1.5,
            "count": 2**40,
            "ok": True,
            "name": "a",
            "position.x": 3.0,
            "position.q.0": 1.0,
            "position.q.1": 2.0,
        },
    )
    # Without a timestamp the time of publication; what is not present has no value.
    assert second[:2] == (101 * SECOND, 101 * SECOND)
    assert second[2]["position.x"] is None
    assert (second[2]["count"], second[2]["ok"], second[2]["name"]) == (0, False, "")


def ros1_message(i: int) -> bytes:
    head = struct.pack("<IIII", i, 90 + i, 5, 3) + b"map"
    return head + struct.pack("<dddii", i, -i, 0.5, i, 2 * i)


def test_ros_1(tmp_path: Path) -> None:
    pytest.importorskip("rosbags", reason="rosbags is not installed: pip install 'dyknow[rosbag]'")
    sent = [ros1_message(i) for i in range(2)]
    path = write(tmp_path / "a.mcap", "r/State", "ros1", "ros1msg", ROS1.encode(), sent)
    assert rows(path)[1] == (
        101 * SECOND,
        91 * SECOND + 5,
        {
            "header.seq": 1,
            "header.frame_id": "map",
            "position.x": 1.0,
            "position.y": -1.0,
            "position.z": 0.5,
            "counts.0": 1,
            "counts.1": 2,
        },
    )


def test_ros_1_without_rosbags_is_left_out_with_a_note(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "rosbags.typesys", None)
    path = write(
        tmp_path / "a.mcap", "r/State", "ros1", "ros1msg", ROS1.encode(), [ros1_message(1)]
    )
    with pytest.raises(WireError, match="no messages that can be read") as caught:
        open_recordings([path])
    assert "/state is left out: its messages are ros1" in str(caught.value.hint)
    assert "pip install 'dyknow[rosbag]'" in str(caught.value.hint)


@pytest.mark.parametrize(
    ("encoding", "kind", "schema", "data"),
    [
        ("protobuf", "protobuf", b"\xff\xff", b""),
        ("ros1", "ros1msg", b"Nonsense $$", b""),
        ("ros1", "ros1msg", ROS1.encode(), b"\x01"),
    ],
)
def test_a_damaged_message_is_said(
    tmp_path: Path, encoding: str, kind: str, schema: bytes, data: bytes
) -> None:
    pytest.importorskip("rosbags", reason="rosbags is not installed: pip install 'dyknow[rosbag]'")
    path = write(tmp_path / "a.mcap", "r/State", encoding, kind, schema, [data])
    with pytest.raises(WireError, match="damaged or cut off"):
        open_recordings([path])
