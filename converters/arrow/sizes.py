"""How large an Arrow IPC message is, and what it holds: read before anything is decompressed.

A message is a length, a flatbuffer that tells its kind and how long its body is, and the body
(Arrow columnar format, "Encapsulated message format"). A record batch says how many rows it has,
and a compressed buffer how long it was: so a body of some hundred bytes that stands for gigabytes
is refused by what it declares. Used by `stream` and `messages`.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

from ...streams.yield_points import STRAIGHT, Pauses
from ..errors import WireError
from ..wire import BatchLimits

SCHEMA, DICTIONARY, RECORDS = 1, 2, 3
"""Kinds of messages."""
_CONTINUATION = 0xFFFFFFFF
_HEADER_TYPE, _HEADER, _BODY_LENGTH = 1, 2, 3
"""Places in the table `Message`, as in Message.fbs; below those of the other tables."""
_LENGTH, _NODES, _BUFFERS, _COMPRESSION = 0, 1, 2, 3
_OF_DICTIONARY = 1
_VALUE = 4
"""Bytes that a value is reckoned with at least: a truth value is a bit in a message, a text of a
dictionary may be a byte, but here they are columns as others are."""
_FARTHEST = 2**62
"""No message begins or ends beyond this, whatever it says: no memory has so many bytes."""
_EARLY_COMPRESSION = b"ARROW:experimental_compression"
"""Before Arrow 1.0 it stood among the remarks of a message."""


@dataclass(frozen=True, slots=True)
class Message:
    """How many bytes it has, its kind (0 is the end of a stream), and where its body begins."""

    size: int
    kind: int
    body: int = 0


@dataclass(frozen=True, slots=True)
class Size:
    """What a batch declares: its rows, and the bytes of its buffers once they are decompressed, or
    of its values (`_VALUE`), if that is more."""

    rows: int
    bytes: int

    def __add__(self, other: Size) -> Size:
        return Size(self.rows + other.rows, self.bytes + other.bytes)

    def check(self, limits: BatchLimits) -> None:
        """Raises `WireError` for more than a batch may have."""
        limits.check_samples(self.rows)
        if self.bytes > limits.decoded:
            raise WireError(
                None,
                f"a batch has at most {limits.decoded} bytes once it is decompressed, "
                f"and this one {self.bytes} ({_VALUE} for each value at least)",
                "send several batches",
            )


def check_sizes(data: bytes, limits: BatchLimits, pauses: Pauses = STRAIGHT) -> None:
    """Raises `WireError` where the batches of an IPC stream have more than ``limits`` together.

    Cost: O(buffers).
    """
    found, at = Size(0, 0), 0
    while (message := message_at(data, at)) is not None and message.kind:
        if message.kind != SCHEMA:
            found += size_of(data, at)
            found.check(limits)
        at += message.size
        pauses.breathe()


def declares_more(data: bytes, most: int) -> bool:
    """Whether the batches of an IPC stream declare more than so many bytes together, as one of
    fewer bytes may: compressed, or with the same ones for many buffers. What is no such stream
    declares nothing. Cost: O(buffers)."""
    total = at = 0
    try:
        while (message := message_at(data, at)) is not None and message.kind:
            if message.kind != SCHEMA:
                total += size_of(data, at).bytes
                if total > most:
                    return True
            at += message.size
    except WireError:  # told when it is decoded
        return False
    return False


def message_at(data: bytes | bytearray, at: int = 0) -> Message | None:
    """The message that begins ``at``, None before its metadata is there. Raises `WireError`."""
    try:
        prefix = 4
        (length,) = struct.unpack_from("<I", data, at)
        if length == _CONTINUATION:  # before Arrow 0.15 there was none
            prefix = 8
            (length,) = struct.unpack_from("<I", data, at + 4)
    except struct.error:
        return None
    if length == 0:
        return Message(prefix, 0)
    if length > 2**31 - 1 or (prefix == 4 and data[at : at + 4] == b"ARRO"):
        raise WireError(None, "no Arrow IPC stream", "send the stream format, not the file format")
    if len(data) < at + prefix + length:
        return None
    metadata = bytes(data[at + prefix : at + prefix + length])
    try:
        table = _root(metadata)
        kind, body = int(table.number(_HEADER_TYPE, "<B")), table.number(_BODY_LENGTH, "<q")
    except struct.error:
        raise WireError(None, "no Arrow IPC stream: a message without its table") from None
    if kind not in (SCHEMA, DICTIONARY, RECORDS):
        raise WireError(None, f"no Arrow IPC stream: a message of kind {kind}")
    if not 0 <= body <= _FARTHEST:
        raise WireError(None, f"no Arrow IPC stream: a message with a body of {body} bytes")
    return Message(prefix + length + body, kind, prefix + length)


def size_of(data: bytes | bytearray, at: int = 0) -> Size:
    """What the record batch, or the dictionary, that begins ``at`` declares: a dictionary has no
    rows. Raises `WireError`. Contract: its metadata is there, and of one of these kinds."""
    message = message_at(data, at)
    assert message is not None
    body = at + message.body
    metadata = bytes(data[at:body])
    if _EARLY_COMPRESSION in metadata:
        raise WireError(None, "an Arrow stream compressed as before Arrow 1.0")
    try:
        table = _root(metadata[8 if metadata[:4] == b"\xff" * 4 else 4 :]).table(_HEADER)
        if message.kind == DICTIONARY:
            table = table.table(_OF_DICTIONARY)
        is_compressed = table.has(_COMPRESSION)
        first, count = table.vector(_BUFFERS)
        total = 0
        for place in range(count):
            start, length = struct.unpack_from("<qq", table.data, first + 16 * place)
            if not 0 <= start <= _FARTHEST:
                raise struct.error("a buffer that begins nowhere")
            if is_compressed and length:
                (declared,) = struct.unpack_from("<q", data, body + start)
                length = length - 8 if declared == -1 else declared  # -1: as it is
            if length < 0:
                raise struct.error("a buffer of less than nothing")
            total += length
        length = table.number(_LENGTH, "<q")
        values = length * table.vector(_NODES)[1]
    except struct.error:
        raise WireError(None, "no Arrow IPC stream: a batch without its buffers") from None
    return Size(length if message.kind == RECORDS else 0, max(total, _VALUE * values))


@dataclass(frozen=True, slots=True)
class _Table:
    """A table of a flatbuffer. Reading raises ``struct.error`` where there is none."""

    data: bytes
    at: int

    def has(self, place: int) -> bool:
        """Whether the field is written."""
        return bool(self._offset(place))

    def number(self, place: int, form: str) -> int:
        """A number; what is not written is 0."""
        offset = self._offset(place)
        return int(struct.unpack_from(form, self.data, self.at + offset)[0]) if offset else 0

    def table(self, place: int) -> _Table:
        """A table within."""
        if not self.has(place):
            raise struct.error("no such table")
        return _Table(self.data, self._target(place))

    def vector(self, place: int) -> tuple[int, int]:
        """Where the elements of a vector begin, and how many there are."""
        if not self.has(place):
            return 0, 0
        target = self._target(place)
        (count,) = struct.unpack_from("<I", self.data, target)
        return target + 4, count

    def _target(self, place: int) -> int:
        at = self.at + self._offset(place)
        return int(at + struct.unpack_from("<I", self.data, at)[0])

    def _offset(self, place: int) -> int:
        (back,) = struct.unpack_from("<i", self.data, self.at)
        fields = self.at - back
        if fields < 0:
            raise struct.error("a table without its fields")
        (size,) = struct.unpack_from("<H", self.data, fields)
        entry = 4 + 2 * place
        return int(struct.unpack_from("<H", self.data, fields + entry)[0]) if entry < size else 0


def _root(data: bytes) -> _Table:
    return _Table(data, struct.unpack_from("<I", data)[0])
