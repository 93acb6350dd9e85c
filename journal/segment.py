"""One file of the log: a header, then records with checksums, then zeros.

    header: "DYKNOWLG", format u32, crc32 u32 of the rest of the header, first position u64
    record: length u32, crc32 u32 of position and payload, position u64, payload

Integers are little-endian. A length of zero ends the file: room is made before it is written to.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from .disk import Disk
from .errors import JournalDamaged, UnknownFormat

FORMAT: Final = 1
_MAGIC: Final = b"DYKNOWLG"
_HEADER: Final = struct.Struct("<8sIIQ")
_RECORD: Final = struct.Struct("<IIQ")
_POSITION: Final = struct.Struct("<Q")
_AHEAD: Final = 4096
"""Of so many positions after the last good one a record is looked for behind damage."""
_ROOM: Final = 4 << 20
"""Room on the disk is made by so many bytes."""


def path_of(folder: Path, first: int) -> Path:
    """The file whose first record has position ``first``."""
    return folder / f"{first:020d}.log"


def framed(position: int, payload: bytes) -> bytes:
    """``payload`` as a record."""
    checksum = zlib.crc32(payload, zlib.crc32(_POSITION.pack(position)))
    return _RECORD.pack(len(payload), checksum, position) + payload


@dataclass(frozen=True, slots=True)
class Damage:
    """What of a file is no record: ``count`` bytes from ``start`` on.

    ``torn``: nothing that was written later follows it, as where the machine stopped amid a write.
    """

    path: Path
    start: int
    count: int
    torn: bool
    after: int
    """The last position before it."""

    def __str__(self) -> str:
        kind = "an unfinished write" if self.torn else "damage"
        return (
            f"{kind} in {self.path.name}: {self.count} bytes from byte {self.start} on, "
            f"after record {self.after}"
        )


@dataclass(slots=True)
class Scan:
    """What a file holds. ``records``: position, start of the payload, its length."""

    first: int
    records: list[tuple[int, int, int]]
    end: int
    damage: Damage | None

    @property
    def last(self) -> int:
        return self.first + len(self.records) - 1


def scan(path: Path, data: bytes) -> Scan:
    """Read a file as far as it is good. Raises `JournalDamaged` for a header that is not, and
    `UnknownFormat`. Cost: O(bytes)."""
    first = _first_of(path, data)
    records: list[tuple[int, int, int]] = []
    place, position = _HEADER.size, first
    while place + _RECORD.size <= len(data):
        length, checksum, found = _RECORD.unpack_from(data, place)
        begin = place + _RECORD.size
        if not length or found != position or begin + length > len(data):
            break
        payload = memoryview(data)[begin : begin + length]
        if zlib.crc32(payload, zlib.crc32(_POSITION.pack(position))) != checksum:
            break
        records.append((position, begin, length))
        place, position = begin + length, position + 1
    return Scan(first, records, place, _damage(path, data, place, position))


def _first_of(path: Path, data: bytes) -> int:
    if len(data) < _HEADER.size:
        raise JournalDamaged(f"{path.name} has no header", "see dyknow check")
    magic, version, checksum, first = _HEADER.unpack_from(data)
    if magic != _MAGIC:
        raise JournalDamaged(f"{path.name} is no log of DyKnow, or damaged", "see dyknow check")
    if checksum != _header_checksum(version, first) or path.stem != f"{first:020d}":
        raise JournalDamaged(f"the header of {path.name} is damaged", "see dyknow check")
    if version != FORMAT:
        raise UnknownFormat(
            f"{path.name} has format {version}, this program reads {FORMAT}",
            "use the version of DyKnow that wrote it, or a later one",
        )
    assert isinstance(first, int)
    return first


def _header_checksum(version: int, first: int) -> int:
    return zlib.crc32(struct.pack("<IQ", version, first))


def _damage(path: Path, data: bytes, place: int, position: int) -> Damage | None:
    """What there is from ``place`` on, where a record with ``position`` would be the next."""
    rest = data[place:].rstrip(b"\0")
    if not rest:
        return None
    torn = not any(_is_record(rest, later) for later in range(position, position + _AHEAD))
    return Damage(path, place, len(rest), torn, position - 1)


def _is_record(data: bytes, position: int) -> bool:
    """Whether a good record with this position is somewhere in ``data``."""
    sought = _POSITION.pack(position)
    found = data.find(sought)
    while found >= 0:
        start = found - 8
        if start >= 0:
            length, checksum, _ = _RECORD.unpack_from(data, start)
            payload = data[start + _RECORD.size : start + _RECORD.size + length]
            is_whole = length and len(payload) == length
            if is_whole and zlib.crc32(payload, zlib.crc32(sought)) == checksum:
                return True
        found = data.find(sought, found + 1)
    return False


class Segment:
    """A file that is written to. ``end`` is where the next record goes, those told of by `add` and
    not written yet included. Raises ``OSError``."""

    def __init__(self, disk: Disk, path: Path, file: int, first: int, end: int) -> None:
        self.path = path
        self.first = first
        self.end = end
        self._disk = disk
        self._file = file
        self._written = end
        self._room = end
        self._unsynced = False
        self._waiting: list[bytes] = []

    @classmethod
    def begin(cls, disk: Disk, folder: Path, first: int, room: int) -> Segment:
        """A new file with room for ``room`` bytes of records; nothing is left of one that fails."""
        path = path_of(folder, first)
        file = disk.open(path, new=True)
        try:
            segment = cls(disk, path, file, first, _HEADER.size)
            segment.make_room(room)
            header = _HEADER.pack(_MAGIC, FORMAT, _header_checksum(FORMAT, first), first)
            disk.write(file, header, 0)
        except OSError:
            disk.close(file)
            disk.remove(path)
            raise
        return segment

    @classmethod
    def go_on(cls, disk: Disk, found: Scan, path: Path) -> Segment:
        """A file that is there, without what follows its last good record: the room behind it is
        zeros again, where nothing old can be taken for a record."""
        file = disk.open(path)
        try:
            disk.cut(file, found.end)
            disk.sync(file)
        except OSError:
            disk.close(file)
            raise
        return cls(disk, path, file, found.first, found.end)

    def make_room(self, count: int) -> None:
        """So many bytes more can be written for sure."""
        if self.end + count > self._room:
            room = max(_ROOM, self.end + count - self._room)
            self._disk.allocate(self._file, self._room, room)
            self._room += room

    def add(self, record: bytes) -> None:
        """A record to be written next; `make_room` was called for it."""
        self._waiting.append(record)
        self.end += len(record)

    def waiting(self) -> Sequence[bytes]:
        """The records that are to be written by now."""
        return tuple(self._waiting)

    def write(self, records: Sequence[bytes]) -> None:
        """Write what `waiting` gave; if that fails it may be tried again."""
        if records:
            data = b"".join(records)
            self._disk.write(self._file, data, self._written)
            self._written += len(data)
            del self._waiting[: len(records)]
            self._unsynced = True

    def sync(self) -> None:
        """Return when what was written is on the disk."""
        if self._unsynced:
            self._disk.sync(self._file)
            self._unsynced = False

    def close(self) -> None:
        self._disk.close(self._file)
