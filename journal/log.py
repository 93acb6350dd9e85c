"""The log: payloads at positions 1, 2, 3 …, in files that are written at their ends only.

A caller opens an `entry` for a command, executes it, and acknowledges it when `commit` returns.
Several callers share one commit. A command that fails leaves no entry.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from .disk import DISK, Disk
from .durability import Durability
from .errors import (
    JournalBroken,
    JournalDamaged,
    JournalError,
    JournalFull,
    is_full,
)
from .examination import HINT, Examination, examine
from .high_water import HighWater, Mark
from .segment import HEAD, Segment, path_of, size_of, walk

SEGMENT = 64 << 20
"""Bytes after which a file is full; the record that passes them still belongs to it."""
_RESTART = "restart the service when the disk is sound"


@dataclass(slots=True)
class Entry:
    """A payload that the log is about to keep.

    ``has_room(size)`` says whether another payload of ``size`` bytes may take its place, and from
    then on that is sure; it may be called in another thread, one call at a time.
    """

    payload: bytes
    has_room: Callable[[int], bool]


class Log:
    """One log in a folder. `commit`, `sync` and `drop` may be called in another thread, one call at
    a time.

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
        on_doubt: Callable[[str], None] = lambda reason: None,
    ) -> None:
        """Raises `JournalDamaged` where something is damaged that was kept, ``OSError``.

        ``on_doubt`` is called with the reason if acknowledged records may be missing, before any
        change: the next start would not see it any more.
        """
        self._folder = folder
        self._durability = durability
        self._limit = segment
        self._disk = disk
        self._lock = threading.Lock()
        self._broken: str | None = None
        self._stuck = False
        """What was taken could not be written: nothing more is taken before it is."""
        self._new_names = False
        self.written = 0
        """Bytes of records that this one has taken."""
        disk.make_folder(folder)
        found = examine(folder)
        if found.damage is not None:
            raise JournalDamaged(found.damage, HINT)
        self.torn = found.torn
        """What was cut off: a write that the last run did not finish."""
        self.lost = found.lost
        """Records that were acknowledged by durability ``write`` and are missing."""
        self.mark_fault = found.reading.fault if found.scans else None
        """What of the high-water mark was not as it was written."""
        self.doubt = found.doubt
        """Why records that were acknowledged may not be there."""
        if self.doubt is not None:
            on_doubt(self.doubt)
        self.position = found.position
        """That of the last payload appended."""
        self.durable = self.position
        """Up to here everything is committed."""
        self.synced = self.position
        """Up to here everything is on the disk."""
        self._firsts = [each.first for each in found.scans[: found.whole]]
        self._open: list[Segment] = []
        self._go_on(found)

    def _go_on(self, found: Examination) -> None:
        """Let all that is good be on the disk, and nothing else."""
        for each in found.scans[found.whole :]:
            if each.is_empty:
                self._disk.remove(each.path)
            else:
                self._disk.rename(each.path, each.path.with_name(f"{each.path.name}.torn"))
        for each in found.scans[: found.whole]:
            # A process that was killed may have left what it wrote to the operating system.
            segment = Segment.go_on(self._disk, each)
            if each is found.scans[found.whole - 1]:
                self._open.append(segment)
            else:
                segment.close()
        try:
            self._mark = HighWater(self._folder, self._disk)
            self._mark.keep(self._now())
            self._disk.sync_folder(self._folder)
        except OSError:
            for segment in self._open:
                segment.close()
            raise

    @property
    def first(self) -> int:
        """The position of the oldest payload there is, or would be."""
        return self._firsts[0] if self._firsts else self.position + 1

    @property
    def size(self) -> int:
        """Bytes of the files on the disk."""
        with self._lock:
            firsts = tuple(self._firsts)
        # Without the lock, for which commands wait: a disk may take its time.
        return sum(_size_of(path_of(self._folder, first)) for first in firsts)

    @property
    def segments(self) -> int:
        """How many files there are."""
        return len(self._firsts)

    @contextmanager
    def entry(self, payload: bytes) -> Iterator[Entry]:
        """``payload`` (not empty) is kept with the next commit if the block ends without an error,
        and never was if it raises. The block may put another in its place, of a size for which
        there is room (`Entry.has_room`), or an empty one: then nothing is kept.

        Raises `JournalFull` when the disk has no room for it, and `JournalBroken`, before the block
        begins. Contract: one block at a time.
        """
        if not payload:
            raise ValueError("a record is not empty")
        position, entry = self.position + 1, Entry(payload, self._has_room)
        segment = self._with_room(size_of(payload))
        yield entry
        if not entry.payload:
            return
        size = size_of(entry.payload)
        with self._lock:
            try:
                segment.make_room(size)
            except OSError as error:
                # It is done, and cannot be taken back.
                self._broken = f"what was done could not be written down: {error}"
                raise JournalBroken(self._broken, _RESTART) from error
            segment.add(position, entry.payload)
            self.position = position
            self.written += size

    def check_room(self, size: int) -> None:
        """Raise `JournalFull` or `JournalBroken` if `entry` would, for ``size`` bytes."""
        self._with_room(size)

    def _has_room(self, size: int) -> bool:
        try:
            self._with_room(HEAD + size)
        except JournalError:
            return False
        return True

    def _with_room(self, size: int) -> Segment:
        if self._broken is not None:
            raise JournalBroken(self._broken, _RESTART)
        if self._stuck:
            # Else what waits in memory would grow for as long as the disk is full.
            raise _full()
        with self._lock:
            try:
                if not self._open or self._is_full(self._open[-1]):
                    self._begin(self.position + 1, size)
                segment = self._open[-1]
                segment.make_room(size)
            except OSError as error:
                raise _refusal(error) from error
        return segment

    def append(self, payload: bytes) -> int:
        """Keep ``payload`` with the next commit; returns its position. Raises as `entry` does."""
        with self.entry(payload):
            pass
        return self.position

    def commit(self) -> int:
        """Return when all that is appended by now is kept; gives its position.

        Raises `JournalFull`: then it is kept in memory, nothing more is taken, and the next commit
        tries again. Raises `JournalBroken`: it is unknown what is kept.
        """
        return self._commit(self._durability is Durability.FSYNC)

    def sync(self) -> int:
        """Commit, and return when it is on the disk, for either durability."""
        return self._commit(True)

    def _commit(self, must_sync: bool) -> int:
        if self._broken is not None:
            raise JournalBroken(self._broken, _RESTART)
        with self._lock:
            until, new_names = self.position, self._new_names
            parts = [(segment, segment.waiting()) for segment in self._open]
        try:
            for segment, records in parts:
                segment.write(records, self.synced)
        except OSError as error:
            raise self._failed(error) from error
        try:
            if must_sync:
                for segment, _ in parts:
                    segment.sync()
                if new_names:
                    self._disk.sync_folder(self._folder)
        except OSError as error:
            # What a failed sync has kept cannot be known, and asking again would tell nothing.
            self._broken = f"the disk did not keep the log: {error}"
            raise JournalBroken(self._broken, _RESTART) from error
        with self._lock:
            self.durable = until
            if must_sync:
                self.synced = until
                self._new_names = self._new_names and not new_names
                for segment, _ in parts[:-1]:
                    segment.close()
                    self._open.remove(segment)
        try:
            self._mark.write(self._now())
        except OSError as error:
            refusal = _refusal(error)
            if isinstance(refusal, JournalBroken):
                self._broken = refusal.message
                raise refusal from error
            # What was taken is kept. The mark tells a later start of damage; the next commit
            # writes it anew.
        self._stuck = False
        return until

    def read(self, after: int = 0) -> Iterator[tuple[int, bytes]]:
        """Yield position and payload of each committed record from ``after`` + 1 on. Raises
        `JournalDamaged` when it is not as it was written, and ``OSError``."""
        with self._lock:
            firsts, until = tuple(self._firsts), self.durable
        position = max(after, firsts[0] - 1) if firsts else until
        for i, first in enumerate(firsts):
            if i + 1 < len(firsts) and firsts[i + 1] <= position + 1:
                continue
            data = path_of(self._folder, first).read_bytes()
            for found in walk(data, first):
                if found.position == position + 1 and position < until:
                    position = found.position
                    yield position, data[found.begin : found.begin + found.length]
        if position < until:
            raise JournalDamaged(f"record {position + 1} is not as it was written", HINT)

    def drop(self, until: int) -> None:
        """Remove files whose records all have positions up to ``until``. The last one that is on
        the disk stays. Raises ``OSError``."""
        with self._lock:
            # One that follows and is not on the disk may not be there tomorrow.
            most = min(until + 1, self.synced)
            count = sum(first <= most for first in self._firsts[1:])
            gone = self._firsts[:count]
            del self._firsts[:count]
        if gone:
            self._mark.keep(self._now())
        for first in gone:
            self._disk.remove(path_of(self._folder, first))
            # One by one: of several the disk might keep any.
            self._disk.sync_folder(self._folder)

    def close(self) -> None:
        """Commit what waits, and close the files."""
        try:
            if self._broken is None:
                self.sync()
                self._mark.keep(self._now())
        finally:
            for segment in self._open:
                segment.close()
            self._open.clear()
            self._mark.close()

    def _is_full(self, segment: Segment) -> bool:
        """One without a record has the name that the next one would have."""
        return segment.end >= self._limit and segment.first <= self.position

    def _begin(self, first: int, room: int) -> None:
        self._open.append(Segment.begin(self._disk, self._folder, first, room))
        self._firsts.append(first)
        self._new_names = True

    def _now(self) -> Mark:
        return Mark(self.first, self.synced, self.durable)

    def _failed(self, error: OSError) -> JournalFull | JournalBroken:
        """What a write that failed means from now on."""
        found = _refusal(error)
        if isinstance(found, JournalBroken):
            self._broken = found.message
        else:
            self._stuck = True
        return found


def _refusal(error: OSError) -> JournalFull | JournalBroken:
    if is_full(error):
        return _full()
    return JournalBroken(f"the disk of the data directory fails: {error}", "see its logs")


def _full() -> JournalFull:
    return JournalFull(
        "there is no room left on the disk of the data directory",
        "make room; the service goes on by itself",
    )


def _size_of(path: Path) -> int:
    try:
        return path.stat().st_size
    except FileNotFoundError:  # no checkpoint needs it any more
        return 0
