"""The high-water mark of a log: how far it went, kept outside of its files, so that a start notices
a file that was cut or lost.

    thrice: "DYKNOWH3", crc32 u32 of the rest, first u64, synced u64, durable u64  (little-endian)

The first copy is synced, when the log is opened, closed and shortened. One write replaces the rest
after each commit, never before, and is not synced: they are newer. A process that is killed amid
that write damages one of them; after a loss of power the first is still true. All are on the disk
before the log has a file. So beside a file a mark is damaged if it is missing, has another length,
or has no good copy. Earlier versions wrote two copies that begin with "DYKNOWHW".
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

from .disk import Disk

NAME: Final = "high-water-mark"
_MAGIC: Final = b"DYKNOWH3"
_OLD: Final = b"DYKNOWHW"
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
        """One copy, always as many bytes."""
        rest = _REST.pack(self.first, self.synced, self.durable)
        return _HEAD.pack(_MAGIC, zlib.crc32(rest)) + rest

    def whole(self) -> bytes:
        """All copies: what the file is at rest."""
        return 3 * self.encoded()


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

    def since(self, first: int) -> Reading:
        """The same for the part of the log from record ``first`` on."""
        mark = self.mark or Mark()
        return replace(self, mark=replace(mark, first=max(mark.first, first)))


def read_mark(folder: Path) -> Reading:
    """That of the log in ``folder``. Raises ``OSError``."""
    path = folder / NAME
    if not path.exists():
        return Reading(None, f"{NAME} is missing", is_whole=False, is_latest=False)
    data = path.read_bytes()
    is_old = data[: len(_OLD)] == _OLD
    # One that an earlier version has written is being made longer.
    fits = 2 * _SIZE <= len(data) <= 3 * _SIZE if is_old else len(data) == 3 * _SIZE
    parts = [data[start : start + _SIZE] for start in range(0, max(len(data), 1), _SIZE)]
    copies = [_decoded(part) for part in parts[:3]]
    found = [mark for mark in copies if mark is not None]
    if not found:
        fault = f"{NAME} is damaged: no copy in it is good"
        return Reading(None, fault, is_whole=False, is_latest=False)
    mark = Mark(
        max(mark.first for mark in found),
        max(mark.synced for mark in found),
        max(mark.durable for mark in found),
    )
    if not fits:
        fault = f"{NAME} is damaged: it has {len(data)} bytes instead of {3 * _SIZE}"
        return Reading(mark, fault, is_whole=False, is_latest=False)
    if not any(copies[1:]):
        fault = f"of {NAME} only the first copy is good, and others tell of the last commits"
        return Reading(mark, fault, is_latest=False)
    if len(found) < len(copies):
        which = ("first", "second", "third")[copies.index(None)]
        return Reading(mark, f"the {which} copy of {NAME} is not good, the others are used")
    return Reading(mark)


def _decoded(data: bytes) -> Mark | None:
    if len(data) != _SIZE:
        return None
    magic, checksum = _HEAD.unpack_from(data)
    rest = data[_HEAD.size :]
    if magic not in (_MAGIC, _OLD) or zlib.crc32(rest) != checksum:
        return None
    return Mark(*_REST.unpack(rest))


class HighWater:
    """The mark of one log, open for writing. Raises ``OSError``."""

    def __init__(self, folder: Path, disk: Disk) -> None:
        path = folder / NAME
        self._disk = disk
        self._file = disk.open(path, new=not path.exists())
        if path.stat().st_size > 3 * _SIZE:
            disk.cut(self._file, 3 * _SIZE)
        self._written: Mark | None = None

    def write(self, mark: Mark) -> None:
        """Write ``mark``, which claims no more than is true."""
        if mark != self._written:
            self._disk.write(self._file, 2 * mark.encoded(), _SIZE)
            self._written = mark

    def keep(self, mark: Mark) -> None:
        """Write ``mark``, and return when it is on the disk."""
        self.write(mark)
        self._disk.sync(self._file)
        # Only now: one of them is whole at any time.
        self._disk.write(self._file, mark.encoded(), 0)
        self._disk.sync(self._file)

    def close(self) -> None:
        self._disk.close(self._file)
