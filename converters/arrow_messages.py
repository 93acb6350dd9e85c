"""An Arrow IPC stream that comes in pieces, cut wherever: record batch by record batch.

A message is a length, a flatbuffer that tells its kind and how long its body is, and the body
(Arrow columnar format, "Encapsulated message format"). Only these two are read here, to know when
a message is there; what it says pyarrow reads. Used by service/live.
"""

from __future__ import annotations

import io
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from .arrow import failures, pyarrow_module
from .errors import WireError

_SCHEMA, _DICTIONARY, _RECORDS = 1, 2, 3
_CONTINUATION = 0xFFFFFFFF
_HEADER_TYPE, _BODY_LENGTH = 1, 3
"""Places in the table `Message`, as in Message.fbs."""


@dataclass(frozen=True, slots=True)
class _Message:
    """How many bytes it has, and its kind; 0 is the end of a stream."""

    size: int
    kind: int


class ArrowMessages:
    """Takes bytes, gives a table for each record batch that is complete.

    After the end of a stream another one may begin. Law (tests/laws): the tables do not depend on
    how the bytes were cut. Memory: the messages up to the next record batch, and the dictionaries.
    """

    def __init__(self) -> None:
        self._waiting = bytearray()
        self._message: _Message | None = None
        self._source = _Source()
        self._reader: Any = None

    @property
    def held(self) -> int:
        """Bytes that no table has come of yet."""
        return len(self._waiting) + self._source.size

    def take(self, data: bytes) -> Iterator[Any]:
        """The tables that are complete with ``data``. Raises `WireError`."""
        self._waiting += data
        while True:
            if self._message is None:
                self._message = _next(self._waiting)
            if self._message is None or len(self._waiting) < self._message.size:
                return
            message, self._message = self._message, None
            piece = bytes(self._waiting[: message.size])
            del self._waiting[: message.size]
            table = self._read(message.kind, piece)
            if table is not None:
                yield table

    def _read(self, kind: int, piece: bytes) -> Any:
        pa = pyarrow_module()
        self._source.add(piece)
        try:
            if kind == 0:
                self._source, self._reader = _Source(), None
            elif self._reader is None:
                self._reader = pa.ipc.open_stream(self._source)
            elif kind == _RECORDS:
                table = pa.Table.from_batches([self._reader.read_next_batch()])
                table.validate(full=True)
                return table
            elif kind != _DICTIONARY:
                raise WireError(None, "a schema within an Arrow stream", "end the stream first")
        except failures(pa) as error:
            raise WireError(None, f"no Arrow IPC stream: {error}") from None
        return None


class _Source(io.RawIOBase):
    """The messages that pyarrow is to read: never asked for one that is not there."""

    def __init__(self) -> None:
        super().__init__()
        self._data = bytearray()

    @property
    def size(self) -> int:
        return len(self._data)

    def add(self, piece: bytes) -> None:
        self._data += piece

    def readable(self) -> bool:
        return True

    def read(self, size: int | None = -1) -> bytes:
        count = len(self._data) if size is None or size < 0 else size
        found = bytes(self._data[:count])
        del self._data[:count]
        return found


def _next(data: bytearray) -> _Message | None:
    """The message at the beginning, None before its metadata is there."""
    try:
        prefix = 4
        (length,) = struct.unpack_from("<I", data)
        if length == _CONTINUATION:  # before Arrow 0.15 there was none
            prefix = 8
            (length,) = struct.unpack_from("<I", data, 4)
    except struct.error:
        return None
    if length == 0:
        return _Message(prefix, 0)
    if length > 2**31 - 1 or (prefix == 4 and data[:4] == b"ARRO"):
        raise WireError(None, "no Arrow IPC stream", "send the stream format, not the file format")
    if len(data) < prefix + length:
        return None
    metadata = bytes(data[prefix : prefix + length])
    try:
        kind, body = _kind_and_body(metadata)
    except struct.error:
        raise WireError(None, "no Arrow IPC stream: a message without its table") from None
    if kind not in (_SCHEMA, _DICTIONARY, _RECORDS) or body < 0:
        raise WireError(None, f"no Arrow IPC stream: a message of kind {kind}")
    return _Message(prefix + length + body, kind)


def _kind_and_body(metadata: bytes) -> tuple[int, int]:
    """What a flatbuffer `Message` says of itself. Raises ``struct.error`` where it is none."""
    (table,) = struct.unpack_from("<I", metadata)
    (back,) = struct.unpack_from("<i", metadata, table)
    fields = table - back
    if fields < 0:
        raise struct.error("a table without its fields")
    (size,) = struct.unpack_from("<H", metadata, fields)

    def read(place: int, form: str) -> int:
        entry = 4 + 2 * place
        offset = struct.unpack_from("<H", metadata, fields + entry)[0] if entry < size else 0
        # What is not written has its default.
        return int(struct.unpack_from(form, metadata, table + offset)[0]) if offset else 0

    return read(_HEADER_TYPE, "<B"), read(_BODY_LENGTH, "<q")
