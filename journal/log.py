"""The log: payloads at positions 1, 2, 3 …, in files that are written at their ends only.

A caller opens an `entry` for what it is about to do, does it, and tells of it when `commit` has
returned; many that do so together share one commit. What fails leaves no entry.
"""

from __future__ import annotations

import errno
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

from .disk import DISK, Disk
from .errors import JournalBroken, JournalDamaged, JournalFull
from .segment import Damage, Scan, Segment, framed, path_of, scan

SEGMENT = 64 << 20
"""A file takes so many bytes, and the record that passes them."""
_RESTART = "restart the service when the disk is sound"
_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


class Durability(StrEnum):
    """When a commit returns."""

    FSYNC = "fsync"
    """The disk has it: it survives a loss of power."""
    WRITE = "write"
    """The operating system has it: it survives the end of the process."""


@dataclass(slots=True)
class Entry:
    """What is about to be kept."""

    payload: bytes


class Log:
    """One log in a folder. `commit` may be called in another thread, one call at a time.

    Law (tests/laws): a log that is opened again holds a prefix of what was appended, and in it all
    that was committed, whatever of the rest the disk has kept; or it says where it is damaged.

    Cost: `append` O(payload); `commit` one write and one sync a file. Memory: what waits for one.
    """

    def __init__(
        self,
        folder: Path,
        *,
        durability: Durability = Durability.FSYNC,
        segment: int = SEGMENT,
        disk: Disk = DISK,
    ) -> None:
        """Raises `JournalDamaged` where something is damaged that others follow, ``OSError``."""
        self.torn: Damage | None = None
        """What was cut off: a write that the last run did not finish."""
        self._folder = folder
        self._durability = durability
        self._limit = segment
        self._disk = disk
        self._lock = threading.Lock()
        self._broken: str | None = None
        self._new_names = False
        self.written = 0
        """Bytes of records that this one has taken."""
        folder.mkdir(parents=True, exist_ok=True)
        found = scan_folder(folder)
        for each in found:
            if each.damage is not None and (each is not found[-1] or not each.damage.torn):
                raise JournalDamaged(
                    str(each.damage),
                    "dyknow check shows it; dyknow repair cuts the log there and keeps the rest",
                )
        self._firsts = [each.first for each in found]
        self.position = found[-1].last if found else 0
        """That of the last payload appended."""
        self.durable = self.position
        """Up to here everything is committed."""
        self._open: list[Segment] = []
        if found:
            self.torn = found[-1].damage
            path = path_of(folder, found[-1].first)
            self._open.append(Segment.go_on(disk, found[-1], path))

    @property
    def first(self) -> int:
        """The position of the oldest payload there is, or would be."""
        return self._firsts[0] if self._firsts else self.position + 1

    @property
    def size(self) -> int:
        """Bytes of the files on the disk."""
        return sum(path_of(self._folder, first).stat().st_size for first in self._firsts)

    @contextmanager
    def entry(self, payload: bytes, room: int = 0) -> Iterator[Entry]:
        """``payload`` (not empty) is kept with the next commit if the block ends without an error,
        and never was if it raises. The block may put another in its place that has up to ``room``
        bytes more.

        Raises `JournalFull` when the disk has no room for it, and `JournalBroken`, before the block
        begins. Contract: one block at a time.
        """
        if self._broken is not None:
            raise JournalBroken(self._broken, _RESTART)
        position = self.position + 1
        entry = Entry(payload)
        least = len(framed(position, payload)) + room
        with self._lock:
            try:
                if not self._open or self._open[-1].end >= self._limit:
                    self._begin(position, least)
                segment = self._open[-1]
                segment.make_room(least)
            except OSError as error:
                raise _refusal(error) from error
        yield entry
        record = framed(position, entry.payload)
        with self._lock:
            try:
                segment.make_room(len(record))
            except OSError as error:
                # It is done, and cannot be taken back.
                self._broken = f"what was done could not be written down: {error}"
                raise JournalBroken(self._broken, _RESTART) from error
            segment.add(record)
            self.position = position
            self.written += len(record)

    def append(self, payload: bytes) -> int:
        """Keep ``payload`` with the next commit; returns its position. Raises as `entry` does."""
        with self.entry(payload):
            pass
        return self.position

    def commit(self) -> int:
        """Return when all that is appended by now is kept; gives its position.

        Raises `JournalFull`: then it is kept in memory, and the next commit tries again. Raises
        `JournalBroken`: nobody knows what is kept.
        """
        if self._broken is not None:
            raise JournalBroken(self._broken, _RESTART)
        with self._lock:
            until, new_names = self.position, self._new_names
            parts = [(segment, segment.waiting()) for segment in self._open]
        try:
            for segment, records in parts:
                segment.write(records)
        except OSError as error:
            raise _refusal(error) from error
        try:
            if self._durability is Durability.FSYNC:
                for segment, _ in parts:
                    segment.sync()
                if new_names:
                    self._disk.sync_folder(self._folder)
        except OSError as error:
            # What a failed sync has kept cannot be known, and asking again would tell nothing.
            self._broken = f"the disk did not keep the log: {error}"
            raise JournalBroken(self._broken, _RESTART) from error
        with self._lock:
            self._new_names = self._new_names and not new_names
            self.durable = until
            for segment, _ in parts[:-1]:
                segment.close()
                self._open.remove(segment)
        return until

    def read(self, after: int = 0) -> Iterator[tuple[int, bytes]]:
        """Position and payload of what is committed, from ``after`` + 1 on. Raises
        `JournalDamaged` when it is not as it was written."""
        for i, first in enumerate(self._firsts):
            if i + 1 < len(self._firsts) and self._firsts[i + 1] <= after + 1:
                continue
            path = path_of(self._folder, first)
            data = path.read_bytes()
            found = scan(path, data)
            for position, begin, length in found.records:
                if after < position <= self.durable:
                    yield position, data[begin : begin + length]

    def drop(self, until: int) -> None:
        """Forget files of which nothing after position ``until`` is needed. The last one stays."""
        with self._lock:
            while len(self._firsts) > 1 and self._firsts[1] <= until + 1:
                self._disk.remove(path_of(self._folder, self._firsts.pop(0)))

    def close(self) -> None:
        """Commit what there is, and let the files go."""
        try:
            if self._broken is None:
                self.commit()
        finally:
            for segment in self._open:
                segment.close()
            self._open.clear()

    def _begin(self, first: int, room: int) -> None:
        self._open.append(Segment.begin(self._disk, self._folder, first, room))
        self._firsts.append(first)
        self._new_names = True


def scan_folder(folder: Path) -> list[Scan]:
    """What every file of a log holds, in order. Raises `JournalDamaged` for a header or a file that
    is missing. Cost: reads all of it."""
    found: list[Scan] = []
    for path in sorted(folder.glob("*.log")):
        data = path.read_bytes()
        if not data.strip(b"\0") and path == max(folder.glob("*.log")):
            # The machine stopped before the header was written: no record was.
            path.unlink()
            break
        each = scan(path, data)
        if found and each.first != found[-1].last + 1:
            raise JournalDamaged(
                f"{path.name} does not follow record {found[-1].last}: a file is missing or cut",
                "restore the folder from a backup (dyknow restore), or see dyknow repair",
            )
        found.append(each)
    return found


def _refusal(error: OSError) -> JournalFull | JournalBroken:
    if error.errno in _FULL:
        return JournalFull(
            "there is no room left on the disk of the data directory",
            "make room; the service goes on by itself",
        )
    return JournalBroken(f"the disk of the data directory fails: {error}", "see its logs")
