"""What decodes the messages of an MCAP log: a decoder for each encoding and schema.

| encoding | schema | read by |
|---|---|---|
| ``json`` | any | msgspec |
| ``cdr`` | ``ros2msg`` | mcap-ros2-support |
| ``ros1`` | ``ros1msg`` | rosbags (the extra ``rosbag``) |
| ``protobuf`` | ``protobuf`` | mcap-protobuf-support |
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, Final, TypeAlias

import msgspec

from .topics import HEADER, NANOSECONDS, SECONDS, STAMP

Decode: TypeAlias = Callable[[bytes], Any]
"""Returns the message: a mapping, or an object whose attributes are its members."""
_TIMESTAMP: Final = "timestamp"
"""The member with the valid time in the schemas of Foxglove."""


class Decoders:
    """The decoders of a log. Raises `ImportError` without the extra ``mcap``."""

    def __init__(self) -> None:
        from mcap_protobuf.decoder import DecoderFactory as Protobuf  # optional dependencies
        from mcap_ros2.decoder import DecoderFactory as Ros2

        self._ros2, self._protobuf = Ros2(), Protobuf()
        self._ros1: dict[int, Decode | None] = {}
        """By the id of the schema."""

    def of(self, encoding: str, schema: Any) -> Decode | None:
        """The decoder of messages in this encoding; None if there is none."""
        match encoding:
            case "json":
                return _json
            case "protobuf":
                decode: Decode | None = self._protobuf.decoder_for(encoding, schema)
                return None if decode is None else lambda data: _timed(_members(decode(data)))
            case "ros1" if schema is not None and schema.encoding == "ros1msg":
                if schema.id not in self._ros1:
                    self._ros1[schema.id] = _ros1(schema)
                return self._ros1[schema.id]
        found: Decode | None = self._ros2.decoder_for(encoding, schema)
        return found


def _json(data: bytes) -> dict[str, Any]:
    return msgspec.json.decode(data, type=dict[str, Any])


def _ros1(schema: Any) -> Decode | None:
    """The decoder of a type of ROS 1; None without the extra ``rosbag``."""
    try:
        from rosbags.serde import SerdeError
        from rosbags.typesys import Stores, TypesysError, get_types_from_msg, get_typestore
    except ImportError:
        return None
    store = get_typestore(Stores.EMPTY)
    try:
        types = get_types_from_msg(schema.data.decode(), schema.name)
        store.register(types)
    except TypesysError as error:
        raise ValueError(f"the type {schema.name}: {error}") from error
    name = next(iter(types))

    def decode(data: bytes) -> Any:
        try:
            return store.deserialize_ros1(data, name)
        except SerdeError as error:
            raise ValueError(str(error)) from error

    return decode


def _members(message: Any) -> dict[str, Any]:
    """A message of Protobuf as a mapping; what is known not to be present has no value there."""
    return {field.name: _member(message, field) for field in message.DESCRIPTOR.fields}


def _member(message: Any, field: Any) -> Any:
    value = getattr(message, field.name)
    if field.message_type is not None and field.message_type.GetOptions().map_entry:
        is_plain = field.message_type.fields_by_name["value"].message_type is None
        return {str(key): each if is_plain else _members(each) for key, each in value.items()}
    if field.is_repeated:
        return list(_repeated(field, value))
    if field.has_presence and not message.HasField(field.name):
        return None if field.message_type is None else {}
    return value if field.message_type is None else _members(value)


def _repeated(field: Any, values: Iterable[Any]) -> Iterable[Any]:
    return values if field.message_type is None else map(_members, values)


def _timed(members: dict[str, Any]) -> dict[str, Any]:
    """With a ``timestamp`` of seconds and nanos as the stamp of a header, which it is."""
    stamp = members.get(_TIMESTAMP)
    if HEADER in members or not isinstance(stamp, dict) or set(stamp) != {"seconds", "nanos"}:
        return members
    rest = {name: value for name, value in members.items() if name != _TIMESTAMP}
    return {HEADER: {STAMP: {SECONDS[0]: stamp["seconds"], NANOSECONDS[0]: stamp["nanos"]}}, **rest}
