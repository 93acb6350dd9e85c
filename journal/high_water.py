"""The high-water mark of a log: how far it went, told outside of its files, so that one that was
cut or lost is missed.

    twice: "DYKNOWHW", crc32 u32 of the rest, first u64, synced u64, durable u64   (little-endian)

The first copy is synced, when the log is opened, closed and shortened. The second is written over
after each commit, never before, and is not synced: it tells more, and if the power goes amid a
write of it, the first is true as well. Both are on the disk before the log has a file: where that
has one, a mark that is missing, has another length, or of which neither copy is good, is damaged.
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


@dataclass(frozen=True, slots=True)
class Reading:
    """What a mark's file says. ``mark``: None where nothing of it can be believed. ``fault``: what
    of it is not as it was written, for people; None: nothing.

    ``is_whole``: no write that was cut short leaves it otherwise. ``is_latest``: no later mark of
    this log can have been lost.
    """

    mark: Mark | None
    fault: str | None = None
    is_whole: bool = True
    is_latest: bool = True


def read_mark(folder: Path) -> Reading:
    """That of the log in ``folder``. Raises ``OSError``."""
    path = folder / NAME
    if not path.exists():
        return Reading(None, f"{NAME} is missing", is_whole=False, is_latest=False)
    data = path.read_bytes()
    copies = [_decoded(data[start : start + _SIZE]) for start in (0, _SIZE)]
    found = [mark for mark in copies if mark is not None]
    if not found:
        fault = f"{NAME} is damaged: neither of its copies is good"
        return Reading(None, fault, is_whole=False, is_latest=False)
    mark = Mark(
        max(mark.first for mark in found),
        max(mark.synced for mark in found),
        max(mark.durable for mark in found),
    )
    if len(data) != 2 * _SIZE:
        fault = f"{NAME} is damaged: it has {len(data)} bytes instead of {2 * _SIZE}"
        return Reading(mark, fault, is_whole=False, is_latest=False)
    if copies[1] is None:
        # It is the one that tells of the last commits.
        fault = f"the second copy of {NAME} is not good, the first is used"
        return Reading(mark, fault, is_latest=False)
    if copies[0] is None:
        return Reading(mark, f"the first copy of {NAME} is not good, the second is used")
    return Reading(mark)


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
        if path.stat().st_size > 2 * _SIZE:
            disk.cut(self._file, 2 * _SIZE)
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
