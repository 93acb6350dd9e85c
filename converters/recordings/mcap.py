"""MCAP logs (``.mcap``) as recordings: a stream for each topic. Read by ``mcap``.

Called by `many_streams.open_recordings`. Messages in JSON are read, and those of ROS 2 (CDR with a
``ros2msg`` schema) by ``mcap-ros2-support``. A topic in another encoding is left out with a note.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec

from ..errors import WireError
from .topics import DAMAGED, TopicLog, Topics


def open_mcap(path: Path | str) -> TopicLog:
    """Read the log at ``path``; times are those of the log (`topics`).

    Raises `WireError` for a file that is no log, damaged or cut off, or without the extra ``mcap``;
    `OSError` if the file cannot be read. Memory: all values that become fields.
    """
    path = Path(path)
    try:
        from mcap.exceptions import McapError  # an optional dependency
        from mcap.reader import make_reader
        from mcap_ros2.decoder import DecoderFactory
        from zstandard import ZstdError
    except ImportError:
        raise WireError(
            None, f"{path.name}: reading MCAP needs mcap", "pip install 'dyknow[mcap]'"
        ) from None
    topics, left_out = Topics(), dict[str, str]()
    ros2 = DecoderFactory()
    with path.open("rb") as file:
        try:
            for schema, channel, message in make_reader(file, validate_crcs=True).iter_messages():
                decode = _decoder(ros2, channel.message_encoding, schema)
                if decode is None:
                    left_out[channel.topic] = channel.message_encoding
                    continue
                members = decode(message.data)
                topics.add(channel.topic, members, message.log_time, message.publish_time)
        except WireError:
            raise
        except (McapError, ZstdError, msgspec.MsgspecError, *DAMAGED) as error:
            raise WireError(
                None,
                f"{path.name}: this is no MCAP log, or it is damaged or cut off: {error}",
                "copy it again, or repair it: mcap recover",
            ) from None
    return topics.log(
        path.name,
        [
            f"{topic} is left out: its messages are {encoding or 'of no encoding'}, and JSON and "
            "ROS 2 (cdr) are read"
            for topic, encoding in sorted(left_out.items())
        ],
    )


def _decoder(ros2: Any, encoding: str, schema: Any) -> Callable[[bytes], Any] | None:
    if encoding == "json":
        return _json
    found: Callable[[bytes], Any] | None = ros2.decoder_for(encoding, schema)
    return found


def _json(data: bytes) -> dict[str, Any]:
    return msgspec.json.decode(data, type=dict[str, Any])
