"""The declared size of an Arrow IPC message, read before pyarrow decompresses anything.

A message is a length, a flatbuffer with its kind and the length of its body, and the body (Arrow
columnar format, "Encapsulated message format"). A record batch declares its rows, and a compressed
buffer its original length. The service therefore refuses a body of some hundred bytes that would
become gigabytes. Used by `stream` and `messages`.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

from ..errors import WireError
from ..wire import BatchLimits

SCHEMA, DICTIONARY, RECORDS = 1, 2, 3
"""Kinds of messages."""
_CONTINUATION = 0xFFFFFFFF
_HEADER_TYPE, _HEADER, _BODY_LENGTH = 1, 2, 3
"""Places in the table `Message`, as in Message.fbs; the next lines have those of other tables."""
_LENGTH, _NODES, _BUFFERS, _COMPRESSION = 0, 1, 2, 3
_OF_DICTIONARY = 1
_VALUE = 4
"""Bytes that a value counts at least. In a message a boolean may be a bit, and a text of a
dictionary a byte; decoded columns are larger."""
_FARTHEST = 2**62
"""The greatest plausible position of a message: no memory has as many bytes."""
_EARLY_COMPRESSION = b"ARROW:experimental_compression"
"""The key in a message's metadata that marked compression before Arrow 1.0."""


@dataclass(frozen=True, slots=True)
class Message:
    """A message: its bytes, its kind (0 is the end of a stream), and the begin of its body."""

    size: int
    kind: int
    body: int = 0


@dataclass(frozen=True, slots=True)
class Size:
    """The declared size of a batch: its rows, and the greater of the bytes of its decompressed
    buffers and those of its values (`_VALUE`)."""

    rows: int
    bytes: int

    def __add__(self, other: Size) -> Size:
        return Size(self.rows + other.rows, self.bytes + other.bytes)

    def check(self, limits: BatchLimits) -> None:
        """Raise `WireError` for a size beyond ``limits``."""
        limits.check_samples(self.rows)
        if self.bytes > limits.decoded:
            raise WireError(
                None,
                f"a batch has at most {limits.decoded} bytes once it is decompressed, "
                f"and this one {self.bytes} ({_VALUE} for each value at least)",
                "send several batches",
            )


def check_sizes(data: bytes, limits: BatchLimits) -> None:
    """Raise `WireError` if the batches of an IPC stream have more than ``limits`` together.

    Cost: O(buffers).
    """
    found, at = Size(0, 0), 0
    while (message := message_at(data, at)) is not None and message.kind:
        if message.kind != SCHEMA:
            found += size_of(data, at)
            found.check(limits)
        at += message.size


def declares_more(data: bytes, most: int) -> bool:
    """Whether the batches of an IPC stream declare more than ``most`` bytes together. A shorter
    body can do so by compression, or by buffers that share bytes. False for other bytes than an
    IPC stream. Cost: O(buffers)."""
    total = at = 0
    try:
        while (message := message_at(data, at)) is not None and message.kind:
            if message.kind != SCHEMA:
                total += size_of(data, at).bytes
                if total > most:
                    return True
            at += message.size
    except WireError:  # the decoder reports it
        return False
    return False


def message_at(data: bytes | bytearray, at: int = 0) -> Message | None:
    """The message at ``at``, or None if its metadata is incomplete. Raises `WireError`."""
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
    """The declared size of the record batch or dictionary at ``at``; a dictionary has no rows.
    Raises `WireError`. Contract: the metadata is complete, and of one of these kinds."""
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
    """A table of a flatbuffer. Its methods raise ``struct.error`` for bytes that are none."""

    data: bytes
    at: int

    def has(self, place: int) -> bool:
        """Whether the field is present."""
        return bool(self._offset(place))

    def number(self, place: int, form: str) -> int:
        """A number, 0 if absent."""
        offset = self._offset(place)
        return int(struct.unpack_from(form, self.data, self.at + offset)[0]) if offset else 0

    def table(self, place: int) -> _Table:
        """A nested table."""
        if not self.has(place):
            raise struct.error("no such table")
        return _Table(self.data, self._target(place))

    def vector(self, place: int) -> tuple[int, int]:
        """The begin of a vector's elements, and their number."""
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
