"""An Arrow IPC stream that arrives in pieces: record batch by record batch.

This module reads only the ends of messages and their declared sizes (`sizes`); pyarrow reads the
rest. Used by service/runtime/live_ingest.
"""

from __future__ import annotations

import io
from collections.abc import Iterator
from typing import Any

from ..errors import WireError
from ..wire import BatchLimits
from .sizes import DICTIONARY, RECORDS, Message, message_at, size_of
from .stream import failures, pyarrow_module


class ArrowMessages:
    """Takes bytes and returns a table for each complete record batch.

    Another stream may follow the end of one. Law (tests/laws): the tables do not depend on how the
    bytes were cut. Memory: the messages up to the next record batch, and the dictionaries.
    """

    def __init__(self, limits: BatchLimits | None = None) -> None:
        self._limits = limits
        """The limits of each record batch."""
        self._waiting = bytearray()
        self._message: Message | None = None
        self._source = _Source()
        self._reader: Any = None

    @property
    def held(self) -> int:
        """Bytes of incomplete record batches, and of dictionaries."""
        return len(self._waiting) + self._source.size

    def take(self, data: bytes) -> Iterator[Any]:
        """The tables that ``data`` completes. Raises `WireError`."""
        self._waiting += data
        while True:
            if self._message is None:
                self._message = message_at(self._waiting)
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
        if self._limits is not None and kind in (DICTIONARY, RECORDS):
            size_of(piece).check(self._limits)
        self._source.add(piece)
        try:
            if kind == 0:
                self._source, self._reader = _Source(), None
            elif self._reader is None:
                self._reader = pa.ipc.open_stream(self._source)
            elif kind == RECORDS:
                table = pa.Table.from_batches([self._reader.read_next_batch()])
                table.validate(full=True)
                return table
            elif kind != DICTIONARY:
                raise WireError(None, "a schema within an Arrow stream", "end the stream first")
        except failures(pa) as error:
            raise WireError(None, f"no Arrow IPC stream: {error}") from None
        return None


class _Source(io.RawIOBase):
    """The messages that pyarrow reads next. Contract: they are complete before it reads."""

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
