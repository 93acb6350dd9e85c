"""A data directory: its format, and the lock by which one process at a time has it.

    DIR/format.json        {"format": 2}
    DIR/lock               held by the process that runs
    DIR/journal/           the log: 00000000000000000001.log …
    DIR/checkpoints/       states at positions of the log
    DIR/restoring          a restore has begun and not ended
    DIR/repaired           what is lost, or may be, until a start has begun new ids
    DIR/backup.json        marks a backup: no service starts on it
    DIR/ontology/          format 1: an Oxigraph store, read once; kept as ontology.format1

docs/reference/data-directory.md says what each version of DyKnow does with each format.
"""

from __future__ import annotations

import fcntl
import os
import time
from pathlib import Path
from types import TracebackType
from typing import Final, Self

import msgspec

from .disk import DISK, Disk
from .errors import DirectoryInUse, JournalDamaged, JournalError, UnknownFormat

FORMAT: Final = 2
REPAIRED: Final = "repaired"
RESTORING: Final = "restoring"
MANIFEST: Final = "backup.json"
_PATIENCE: Final = 0.2
"""Seconds for which a lock is tried again: an inspection holds it for a moment."""


class _Format(msgspec.Struct):
    format: int


class DataDirectory:
    """An open data directory, made if it is not there. Raises `DirectoryInUse`, `UnknownFormat`,
    `JournalDamaged`, `JournalError` for a backup, and ``OSError``."""

    def __init__(self, path: Path, disk: Disk = DISK) -> None:
        self.path = path
        self._disk = disk
        disk.make_folder(path)
        self._lock = locked(path)
        try:
            self.old_store = self._adopt()
        except BaseException:
            os.close(self._lock)
            raise

    @property
    def journal(self) -> Path:
        return self.path / "journal"

    @property
    def checkpoints(self) -> Path:
        return self.path / "checkpoints"

    @property
    def repaired(self) -> str | None:
        """What a repair has cut off or a start has missed, and none has begun anew for yet: numbers
        that were given then must not be given again."""
        path = self.path / REPAIRED
        return path.read_text(errors="replace").strip() if path.exists() else None

    def note_loss(self, reason: str) -> None:
        """What was acknowledged is lost, or may be: however this start ends, numbers begin anew."""
        told = [each for each in (self.repaired, reason) if each]
        write_whole(self._disk, self.path / REPAIRED, f"{'; '.join(told)}\n".encode())

    def forget_loss(self) -> None:
        """Remove the note, since the log now records that numbers begin anew."""
        if self.repaired is not None:
            self._disk.remove(self.path / REPAIRED)
            self._disk.sync_folder(self.path)

    def forget_old_store(self) -> None:
        """Set the old store aside: a checkpoint has its contents. An earlier version can still use
        it."""
        if self.old_store is not None:
            self._disk.rename(self.old_store, self.path / "ontology.format1")
            self._disk.sync_folder(self.path)
            self.old_store = None

    def close(self) -> None:
        """Release the lock."""
        os.close(self._lock)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def _adopt(self) -> Path | None:
        """Check the format, or say it in a new directory; gives the store of format 1, if that is
        all there is."""
        check_restored(self.path)
        if (self.path / MANIFEST).exists():
            # The service that it was made of gives the ids that follow.
            raise JournalError(
                f"{self.path} is a backup, no data directory",
                "dyknow restore makes a directory of it, in which ids of events begin anew",
            )
        if lacks_format(self.path):
            raise JournalDamaged(
                f"{self.path} has a journal, and format.json is missing or damaged",
                "dyknow check shows what is there; dyknow repair writes it anew",
            )
        if format_of(self.path) is None:
            write_whole(self._disk, self.path / "format.json", format_bytes())
        old = self.path / "ontology"
        return old if old.is_dir() else None


def check_restored(path: Path) -> None:
    """Raises `JournalDamaged` where a restore into the data directory ``path`` has not ended: not
    all of the backup may be there."""
    if (path / RESTORING).exists():
        raise JournalDamaged(
            f"a restore into {path} was not finished: not all of the backup may be there",
            "remove the directory and restore again (dyknow restore)",
        )


def format_bytes() -> bytes:
    """The content of format.json."""
    return msgspec.json.encode(_Format(FORMAT)) + b"\n"


def write_whole(disk: Disk, path: Path, data: bytes) -> None:
    """Write ``data`` to a file that is on the disk as a whole, or not at all."""
    part = path.with_name(f"{path.name}.part")
    if part.exists():
        disk.remove(part)
    file = disk.open(part, new=True)
    try:
        disk.write(file, data, 0)
        disk.sync(file)
    finally:
        disk.close(file)
    disk.rename(part, path)
    disk.sync_folder(path.parent)


def lacks_format(path: Path) -> bool:
    """Whether what says the format of the data directory ``path`` is gone, or says nothing: it is
    on the disk before anything else is there. Each file there says its own format, too. Raises
    `UnknownFormat`."""
    if not any((path / name).exists() for name in ("journal", "checkpoints")):
        return False
    try:
        return format_of(path) is None
    except JournalDamaged:
        return True


def format_of(path: Path) -> int | None:
    """The format of the data directory ``path``, if it says one: it is `FORMAT`. Raises
    `UnknownFormat` and `JournalDamaged`."""
    named = path / "format.json"
    if not named.exists():
        return None
    try:
        known = msgspec.json.decode(named.read_bytes(), type=_Format)
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise JournalDamaged(
            f"{named} is damaged: {error}", f'it should say {{"format": {FORMAT}}}'
        ) from error
    if known.format != FORMAT:
        raise UnknownFormat(
            f"{path} has format {known.format}, this program reads {FORMAT}",
            "use the version of DyKnow that wrote it, or a later one",
        )
    return known.format


def locked(path: Path) -> int:
    """The lock of a data directory, as an open file: close it to let another process have it.
    Raises `DirectoryInUse` and ``OSError``."""
    file = os.open(path / "lock", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    until = time.monotonic() + _PATIENCE
    while True:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            if time.monotonic() < until:
                time.sleep(_PATIENCE / 20)
                continue
            holder = os.pread(file, 32, 0).decode(errors="replace").strip()
            os.close(file)
            raise DirectoryInUse(
                f"{path} is in use by process {holder or 'unknown'}",
                "stop it first, or name another directory",
            ) from error
        break
    try:
        # Written over, never made shorter: on a full disk there might be no room for it again.
        os.pwrite(file, f"{os.getpid():<20}\n".encode(), 0)
    except OSError:
        os.close(file)
        raise
    return file


def holder_of(path: Path) -> str | None:
    """The process that has the data directory ``path`` open, by its lock; None: none has."""
    named = path / "lock"
    if not named.exists():
        return None
    file = os.open(named, os.O_RDONLY | os.O_CLOEXEC)
    try:
        fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except OSError:
        return os.pread(file, 32, 0).decode(errors="replace").strip() or "unknown"
    finally:
        os.close(file)
    return None
