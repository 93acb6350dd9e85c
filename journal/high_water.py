"""The high-water mark of a log: how far it went, told outside of its files, so that one that was
cut or lost is missed.

    twice: "DYKNOWHW", crc32 u32 of the rest, first u64, synced u64, durable u64   (little-endian)

The first copy is synced, when the log is opened, closed and shortened. The second is written over
after each commit, never before, and is not synced: it tells more, and if the power goes amid a
write of it, the first is true as well.
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from .disk import Disk

NAME: Final = "high-water-mark"
_MAGIC: Final = b"DYKNOWHW"
_HEAD: Final = struct.Struct("<8sI")
_REST: Final = struct.Struct("<QQQ")
_SIZE: Final = _HEAD.size + _REST.size


@dataclass(frozen=True, slots=True)
class Mark:
    """Records from ``first`` on are there; up to ``synced`` they were on the disk, up to
    ``durable`` acknowledged."""

    first: int = 1
    synced: int = 0
    durable: int = 0

    def encoded(self) -> bytes:
        """As bytes, always as many."""
        rest = _REST.pack(self.first, self.synced, self.durable)
        return _HEAD.pack(_MAGIC, zlib.crc32(rest)) + rest


def read_mark(folder: Path) -> Mark | None:
    """That of the log in ``folder``; None where there is none that can be believed."""
    path = folder / NAME
    data = path.read_bytes() if path.exists() else b""
    found = [mark for start in (0, _SIZE) if (mark := _decoded(data[start : start + _SIZE]))]
    if not found:
        return None
    return Mark(
        max(mark.first for mark in found),
        max(mark.synced for mark in found),
        max(mark.durable for mark in found),
    )


def _decoded(data: bytes) -> Mark | None:
    if len(data) != _SIZE:
        return None
    magic, checksum = _HEAD.unpack_from(data)
    rest = data[_HEAD.size :]
    if magic != _MAGIC or zlib.crc32(rest) != checksum:
        return None
    return Mark(*_REST.unpack(rest))


class HighWater:
    """The mark of one log, open for writing. Raises ``OSError``."""

    def __init__(self, folder: Path, disk: Disk) -> None:
        path = folder / NAME
        self._disk = disk
        self._file = disk.open(path, new=not path.exists())
        self._written: Mark | None = None

    def write(self, mark: Mark) -> None:
        """Let it be ``mark``: no more than is true."""
        if mark != self._written:
            self._disk.write(self._file, mark.encoded(), _SIZE)
            self._written = mark

    def keep(self, mark: Mark) -> None:
        """The same, and return when it is on the disk."""
        self.write(mark)
        self._disk.sync(self._file)
        # Only now: one of both is whole at any time.
        self._disk.write(self._file, mark.encoded(), 0)
        self._disk.sync(self._file)

    def close(self) -> None:
        self._disk.close(self._file)
