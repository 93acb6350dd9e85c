"""One file of the log: a header, then records with checksums, then zeros.

    header: "DYKNOWLG", format u32, crc32 u32 of format and first position, first position u64
    record: length u32, crc32 u32, position u64, synced u64, payload

Integers are little-endian. The checksum of a record is of the payload, then length, position and
``synced``: up to which position the log was on the disk before this record was written. So records
behind a damaged one tell whether that had been kept, or was part of an unfinished write. A length
of zero ends the file: room is made before it is written to.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from .disk import Disk
from .errors import UnknownFormat

FORMAT: Final = 1
_MAGIC: Final = b"DYKNOWLG"
_HEADER: Final = struct.Struct("<8sIIQ")
_RECORD: Final = struct.Struct("<IIQQ")
NUMBER: Final = 20 * "[0-9]"
"""A pattern of positions in names of files."""
HEAD: Final = _RECORD.size
"""Bytes of a record before its payload."""
_CHECKED: Final = struct.Struct("<IQQ")
_POSITION: Final = 8
"""Where the position stands in a record."""
_LOOK: Final = 1 << 20
"""Bytes searched at once for a record behind damage."""
_ROOM: Final = 4 << 20
"""Bytes of room made on the disk at once, if it has them."""


class Found(NamedTuple):
    """A record in the bytes of a file: its payload begins at ``begin``."""

    position: int
    begin: int
    length: int
    synced: int


def path_of(folder: Path, first: int) -> Path:
    """The file whose first record has position ``first``."""
    return folder / f"{first:020d}.log"


def header_of(first: int) -> bytes:
    """The header of a file."""
    return _HEADER.pack(_MAGIC, FORMAT, _header_checksum(FORMAT, first), first)


def framed(position: int, payload: bytes, synced: int) -> bytes:
    """``payload`` as a record."""
    return _framed(position, payload, zlib.crc32(payload), synced)


def size_of(payload: bytes) -> int:
    """The bytes of its record."""
    return _RECORD.size + len(payload)


def _framed(position: int, payload: bytes, checksum: int, synced: int) -> bytes:
    checksum = zlib.crc32(_CHECKED.pack(len(payload), position, synced), checksum)
    return _RECORD.pack(len(payload), checksum, position, synced) + payload


@dataclass(frozen=True, slots=True)
class Damage:
    """What of a file is no record: ``count`` bytes from ``start`` on, after record ``after``.

    ``behind``: good records that follow it in the file.
    """

    path: Path
    start: int
    count: int
    after: int
    behind: tuple[Found, ...]

    def __str__(self) -> str:
        more = f", {len(self.behind)} good records behind it" if self.behind else ""
        return (
            f"{self.path.name}: {self.count} bytes from byte {self.start} on, after record "
            f"{self.after}{more}"
        )


@dataclass(frozen=True, slots=True)
class Scan:
    """What a file holds: ``count`` good records from position ``first`` on, up to byte ``end``; 0,
    if the header is not good either. ``synced`` is the greatest that any of these records tells."""

    path: Path
    first: int
    count: int
    end: int
    size: int
    synced: int
    damage: Damage | None

    @property
    def last(self) -> int:
        """The position of the last good record before damage; ``first`` - 1 if there is none."""
        return self.first + self.count - 1

    @property
    def is_empty(self) -> bool:
        """Whether nothing but zeros is in it."""
        return not self.end and self.damage is not None and not self.damage.count


def scan(path: Path, data: bytes | None = None) -> Scan:
    """Find how far a file is good; ``data``: what it holds, where that is known. Raises
    `UnknownFormat` and ``OSError``. Cost: O(bytes)."""
    data = path.read_bytes() if data is None else data
    first = int(path.stem)
    count, end, synced = 0, 0, 0
    if _has_header(path, data, first):
        end = _HEADER.size
        for record in walk(data, first):
            count += 1
            end = record.begin + record.length
            synced = record.synced
    damage = _damage(path, data, end, first + count)
    return Scan(path, first, count, end, len(data), synced, damage)


def walk(data: bytes, first: int) -> Iterator[Found]:
    """The good records of a file, from its first one on, up to what is none."""
    place, position = _HEADER.size, first
    while (found := _at(data, place)) is not None and found.position == position:
        yield found
        place, position = found.begin + found.length, position + 1


def found_in(data: bytes, start: int, most: int) -> Iterator[Found]:
    """Good records anywhere from byte ``start`` on, of positions up to ``most``, in order of place.
    Cost: O(bytes), and where what is damaged is full of numbers like these, what their checksums
    take.

    Not inside of a damaged record of which it is known where it ends: what a client has sent might
    look like one.
    """
    passed = _behind_damaged(data, start)
    for begin in range(start + _POSITION, len(data) - 7, _LOOK):
        count = min(_LOOK, len(data) - 7 - begin)
        # Eight bytes from every place on, as they overlap.
        numbers = np.ndarray((count,), "<u8", data, begin, (1,))
        for at in np.flatnonzero((numbers >= 1) & (numbers <= most)).tolist():
            place = begin + at - _POSITION
            found = _at(data, place) if place >= passed else None
            if found is not None:
                yield found
                passed = _behind_damaged(data, found.begin + found.length)


def _behind_damaged(data: bytes, place: int) -> int:
    """Where the damaged record ends that begins at ``place``, if what its head says of that is
    sure: the next record begins there, or nothing follows. Else ``place``."""
    begin = place + _RECORD.size
    if begin > len(data):
        return place
    length, _, position, _ = _RECORD.unpack_from(data, place)
    end = begin + length
    if not length or end > len(data) or _at(data, place) is not None:
        return place
    follows = _at(data, end)
    is_sure = follows.position == position + 1 if follows else end == len(data.rstrip(b"\0"))
    return end if is_sure else place


def _at(data: bytes, place: int) -> Found | None:
    """The good record that begins at byte ``place``."""
    begin = place + _RECORD.size
    if begin > len(data):
        return None
    length, checksum, position, synced = _RECORD.unpack_from(data, place)
    if not length or begin + length > len(data):
        return None
    payload = memoryview(data)[begin : begin + length]
    if zlib.crc32(_CHECKED.pack(length, position, synced), zlib.crc32(payload)) != checksum:
        return None
    return Found(position, begin, length, synced)


def _has_header(path: Path, data: bytes, first: int) -> bool:
    if len(data) < _HEADER.size:
        return False
    magic, version, checksum, position = _HEADER.unpack_from(data)
    if magic != _MAGIC or checksum != _header_checksum(version, position):
        return False
    if version != FORMAT:
        raise UnknownFormat(
            f"{path.name} has format {version}, this program reads {FORMAT}",
            "use the version of DyKnow that wrote it, or a later one",
        )
    return bool(position == first)


def _header_checksum(version: int, first: int) -> int:
    return zlib.crc32(struct.pack("<IQ", version, first))


def _damage(path: Path, data: bytes, place: int, position: int) -> Damage | None:
    """What there is from ``place`` on, where a record with ``position`` would be the next. Without
    a header there is always something wrong."""
    rest = len(data[place:].rstrip(b"\0"))
    if not rest and place:
        return None
    # Earlier ones are none that follow, but what is in them need not be looked at.
    most = position + len(data) // _RECORD.size
    behind = tuple(each for each in found_in(data, place, most) if each.position >= position)
    return Damage(path, place, rest, position - 1, behind)


class Waiting(NamedTuple):
    """A record that is to be written."""

    position: int
    payload: bytes
    checksum: int
    """Of the payload."""


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
        self._waiting: list[Waiting] = []

    @classmethod
    def begin(cls, disk: Disk, folder: Path, first: int, room: int) -> Segment:
        """A new file with room for ``room`` bytes of records; nothing is left of one that fails."""
        path = path_of(folder, first)
        file = disk.open(path, new=True)
        try:
            segment = cls(disk, path, file, first, _HEADER.size)
            segment.make_room(room)
            disk.write(file, header_of(first), 0)
        except OSError:
            disk.close(file)
            disk.remove(path)
            raise
        return segment

    @classmethod
    def go_on(cls, disk: Disk, found: Scan) -> Segment:
        """A file that is there, without what follows its last good record: the room behind it is
        zeros again, where nothing old can be taken for a record."""
        file = disk.open(found.path)
        try:
            if found.size != found.end:
                disk.cut(file, found.end)
            disk.sync(file)
        except OSError:
            disk.close(file)
            raise
        return cls(disk, found.path, file, found.first, found.end)

    def make_room(self, count: int) -> None:
        """Reserve room on the disk for ``count`` bytes more."""
        least = self.end + count - self._room
        if least <= 0:
            return
        try:
            room = max(_ROOM, least)
            self._disk.allocate(self._file, self._room, room)
        except OSError:
            # Perhaps there is as much as is needed, and no more.
            room = least
            self._disk.allocate(self._file, self._room, room)
        self._room += room

    def add(self, position: int, payload: bytes) -> None:
        """Add a record to write next. Contract: `make_room` was called for it."""
        self._waiting.append(Waiting(position, payload, zlib.crc32(payload)))
        self.end += size_of(payload)

    def waiting(self) -> Sequence[Waiting]:
        """The records that `write` is to write next."""
        return tuple(self._waiting)

    def write(self, records: Sequence[Waiting], synced: int) -> None:
        """Write what `waiting` gave; if that fails it may be tried again."""
        if records:
            data = b"".join(_framed(*each, synced) for each in records)
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
