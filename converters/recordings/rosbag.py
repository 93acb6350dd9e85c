"""Bags of ROS 1 (``.bag``) and ROS 2 (a folder, or ``.db3``) as recordings. Read by ``rosbags``.

Called by `many_streams.open_recordings`. It needs no installation of ROS: the definitions of the
messages are in the bag, or those of the newest ROS 2 apply.
"""

from __future__ import annotations

import sqlite3
from pathlib import Path

from ..errors import WireError
from .topics import DAMAGED, TopicLog, Topics

METADATA = "metadata.yaml"
"""The file that makes a folder a bag of ROS 2."""


def open_rosbag(path: Path | str) -> TopicLog:
    """Read the bag at ``path``; available times are those of the bag (`topics`).

    Raises `WireError` for what is no bag, damaged or cut off, or without the extra ``rosbag``;
    `OSError` if a file cannot be read. Memory: all values that become fields.
    """
    path = Path(path)
    try:
        import apsw  # an optional dependency, as all below
        from rosbags import rosbag1, rosbag2
        from rosbags.highlevel import AnyReader, AnyReaderError
        from rosbags.rosbag2.reader import zstd  # type: ignore[attr-defined]  # by Python's version
        from rosbags.serde import SerdeError
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise WireError(
            None, f"{path.name}: reading bags of ROS needs rosbags", "pip install 'dyknow[rosbag]'"
        ) from None
    topics = Topics()
    if path.is_file():
        path.open("rb").close()  # a file that cannot be opened is not damaged
    try:
        with AnyReader([path], default_typestore=get_typestore(Stores.LATEST)) as reader:
            for connection, logged, data in reader.messages():
                message = reader.deserialize(data, connection.msgtype)
                topics.add(connection.topic, message, logged)
    except WireError:
        raise
    except (
        AnyReaderError,
        rosbag1.ReaderError,
        rosbag2.ReaderError,
        SerdeError,
        zstd.ZstdError,
        apsw.Error,
        sqlite3.Error,
        *DAMAGED,
    ) as error:
        raise WireError(
            None,
            f"{path.name}: this is no bag of ROS, or it is damaged or cut off: {error}",
            "copy it again, or repair it: rosbag reindex, ros2 bag reindex",
        ) from None
    return topics.log(path.name)
