"""MCAP logs (``.mcap``) as recordings: a stream for each topic. Read by ``mcap``.

Called by `many_streams.open_recordings`. `mcap_messages` has the encodings of messages that are
read. A topic in another one is left out with a note.
"""

from __future__ import annotations

from pathlib import Path

import msgspec

from ..errors import WireError
from .mcap_messages import Decoders
from .topics import DAMAGED, TopicLog, Topics


def open_mcap(path: Path | str) -> TopicLog:
    """Read the log at ``path``; times are those of the log (`topics`).

    Raises `WireError` for a file that is no log, damaged or cut off, or without the extra ``mcap``;
    `OSError` if the file cannot be read. Memory: all values that become fields.
    """
    path = Path(path)
    try:
        from google.protobuf.message import DecodeError  # optional dependencies
        from mcap.exceptions import McapError
        from mcap.reader import make_reader
        from zstandard import ZstdError

        decoders = Decoders()
    except ImportError:
        raise WireError(
            None, f"{path.name}: reading MCAP needs mcap", "pip install 'dyknow[mcap]'"
        ) from None
    topics, left_out = Topics(), dict[str, str]()
    with path.open("rb") as file:
        try:
            for schema, channel, message in make_reader(file, validate_crcs=True).iter_messages():
                decode = decoders.of(channel.message_encoding, schema)
                if decode is None:
                    left_out[channel.topic] = channel.message_encoding
                    continue
                members = decode(message.data)
                topics.add(channel.topic, members, message.log_time, message.publish_time)
        except WireError:
            raise
        except (McapError, DecodeError, ZstdError, msgspec.MsgspecError, *DAMAGED) as error:
            raise WireError(
                None,
                f"{path.name}: this is no MCAP log, or it is damaged or cut off: {error}",
                "copy it again, or repair it: mcap recover",
            ) from None
    return topics.log(
        path.name,
        [
            f"{topic} is left out: its messages are {encoding or 'of no encoding'}, and JSON, "
            "Protobuf, ROS 2 (cdr) and, with pip install 'dyknow[rosbag]', ROS 1 are read"
            for topic, encoding in sorted(left_out.items())
        ],
    )
