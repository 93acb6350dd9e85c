"""Small logs of robots, written by the libraries that read them: MCAP, bags of ROS 1 and ROS 2.

Each has a topic ``/robot/odom`` with header stamps, and a topic ``/robot/volt`` without: the stamps
are a tenth of a second before the time of the log.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

SECOND = 10**9
BEGIN = 1_633_615_801
MESSAGES = 3
ODOM = """\
std_msgs/Header header
geometry_msgs/Point position
float64[4] q
float32[] ranges
uint8[] image
float64[36] covariance
bool ok
uint64 big
================================================================================
MSG: std_msgs/Header
{header}string frame_id
================================================================================
MSG: geometry_msgs/Point
float64 x
float64 y
"""
HEADERS = {1: "uint32 seq\ntime stamp\n", 2: "builtin_interfaces/Time stamp\n"}
VOLT = "float32 data\n"
STAMP = 900_000_000
"""Nanoseconds of each stamp."""


def odom(i: int) -> dict[str, Any]:
    """Message ``i`` of the topic ``/robot/odom``."""
    return {
        "header": {"stamp": {"sec": BEGIN + i - 1, "nanosec": STAMP}, "frame_id": "map"},
        "position": {"x": i + 0.5, "y": float("nan") if i == 1 else float(-i)},
        "q": [0.0, 0.0, 0.0, 1.0],
        "ranges": [1.0] * i,
        "image": [0, 1, 2],
        "covariance": [0.0] * 36,
        "ok": i == 2,
        "big": 2**63 + i if i else 0,
    }


def times(i: int) -> int:
    """The time of the log of message ``i``."""
    return (BEGIN + i) * SECOND


def write_mcap(path: Path) -> None:
    """An MCAP log with the two topics in ROS 2, and one in JSON."""
    from mcap_ros2.writer import Writer

    with path.open("wb") as file, Writer(file) as writer:
        schema = writer.register_msgdef("robot_msgs/msg/Odom", ODOM.format(header=HEADERS[2]))
        volt = writer.register_msgdef("std_msgs/msg/Float32", VOLT)
        raw = writer._writer
        plain = raw.register_schema("tag", "jsonschema", b"{}")
        tag = raw.register_channel("tags", "json", plain)
        other = raw.register_channel("/other", "protobuf", plain)
        for i in range(MESSAGES):
            time = times(i)
            writer.write_message("/robot/odom", schema, odom(i), time, time - 1)
            writer.write_message("/robot/volt", volt, {"data": 12.5}, time + 1, time)
            text = json.dumps({"id": f"t{i}", "at": {"x": i}, "n": None if i else 1, "valid": True})
            raw.add_message(tag, time + 2, text.encode(), time + 2)
        raw.add_message(other, times(MESSAGES), b"\x08\x01", times(MESSAGES))


def write_rosbag(path: Path, version: int, kind: str = "") -> None:
    """A bag of ROS 1 (a file) or of ROS 2 (a folder) with the two topics. ``kind``: of ROS 1 the
    compression (``BZ2``, ``LZ4``), of ROS 2 the storage (``MCAP``) or compression (``ZSTD``)."""
    from rosbags import rosbag1, rosbag2
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC if version == 1 else Stores.ROS2_HUMBLE)
    store.register(
        get_types_from_msg(
            ODOM.format(header=HEADERS[version]).partition("=" * 80)[0], "robot_msgs/msg/Odom"
        )
    )
    writer: Any
    if version == 1:
        writer = rosbag1.Writer(path)
        if kind:
            writer.set_compression(rosbag1.Writer.CompressionFormat[kind])
    else:
        plugin = rosbag2.StoragePlugin.MCAP if kind == "MCAP" else rosbag2.StoragePlugin.SQLITE3
        writer = rosbag2.Writer(path, version=9, storage_plugin=plugin)
        if kind == "ZSTD":
            mode = rosbag2.CompressionMode.MESSAGE
            writer.set_compression(mode, rosbag2.CompressionFormat.ZSTD)
    encode = store.serialize_ros1 if version == 1 else store.serialize_cdr
    types = store.types
    with writer:
        first = writer.add_connection("/robot/odom", "robot_msgs/msg/Odom", typestore=store)
        second = writer.add_connection("/robot/volt", "std_msgs/msg/Float32", typestore=store)
        for i in range(MESSAGES):
            told = odom(i)
            stamp = types["builtin_interfaces/msg/Time"](**told["header"]["stamp"])
            seq = {"seq": i} if version == 1 else {}
            header = types["std_msgs/msg/Header"](stamp=stamp, frame_id="map", **seq)
            told["header"] = header
            told["position"] = types["geometry_msgs/msg/Point"](z=0.0, **told["position"])
            for name, kind in (
                ("q", "f8"),
                ("ranges", "f4"),
                ("image", "u1"),
                ("covariance", "f8"),
            ):
                told[name] = np.array(told[name], kind)
            message = types["robot_msgs/msg/Odom"](**told)
            writer.write(first, times(i), encode(message, "robot_msgs/msg/Odom"))
            volt = types["std_msgs/msg/Float32"](12.5)
            writer.write(second, times(i) + 1, encode(volt, "std_msgs/msg/Float32"))
