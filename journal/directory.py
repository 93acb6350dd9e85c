"""A data directory: which format it has, and that one process has it.

    DIR/format.json        {"format": 2}
    DIR/lock               held by the process that runs
    DIR/journal/           the log: 00000000000000000001.log …
    DIR/checkpoints/       states at positions of the log
    DIR/ontology/          format 1: an Oxigraph store, read once; kept as ontology.format1

docs/data-directory.md says what each version of DyKnow does with each format.
"""

from __future__ import annotations

import fcntl
import os
from pathlib import Path
from types import TracebackType
from typing import Final, Self

import msgspec

from .disk import DISK, Disk
from .errors import DirectoryInUse, JournalDamaged, UnknownFormat

FORMAT: Final = 2


class _Format(msgspec.Struct):
    format: int


class DataDirectory:
    """An open data directory, made if it is not there. Raises `DirectoryInUse`, `UnknownFormat`,
    `JournalDamaged` and ``OSError``."""

    def __init__(self, path: Path, disk: Disk = DISK) -> None:
        self.path = path
        path.mkdir(parents=True, exist_ok=True)
        self._lock = _locked(path)
        try:
            self.old_store = self._adopt(disk)
        except BaseException:
            os.close(self._lock)
            raise

    @property
    def journal(self) -> Path:
        return self.path / "journal"

    @property
    def checkpoints(self) -> Path:
        return self.path / "checkpoints"

    def forget_old_store(self) -> None:
        """What it says is in a checkpoint now. It stays for who goes back to an earlier version."""
        if self.old_store is not None:
            self.old_store.rename(self.path / "ontology.format1")
            self.old_store = None

    def close(self) -> None:
        """Let another process have it."""
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

    def _adopt(self, disk: Disk) -> Path | None:
        """Check the format, or say it in a new directory; gives the store of format 1, if that is
        all there is."""
        path = self.path / "format.json"
        if path.exists():
            try:
                known = msgspec.json.decode(path.read_bytes(), type=_Format)
            except msgspec.DecodeError as error:
                raise JournalDamaged(
                    f"{path} is damaged: {error}", f'it should say {{"format": {FORMAT}}}'
                ) from error
            if known.format != FORMAT:
                raise UnknownFormat(
                    f"{self.path} has format {known.format}, this program writes {FORMAT}",
                    "use the version of DyKnow that wrote it, or a later one",
                )
        else:
            part = path.with_suffix(".part")
            part.unlink(missing_ok=True)
            file = disk.open(part, new=True)
            try:
                disk.write(file, msgspec.json.encode(_Format(FORMAT)) + b"\n", 0)
                disk.sync(file)
            finally:
                disk.close(file)
            disk.rename(part, path)
            disk.sync_folder(self.path)
        old = self.path / "ontology"
        return old if old.is_dir() else None


def _locked(path: Path) -> int:
    file = os.open(path / "lock", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        holder = os.pread(file, 32, 0).decode(errors="replace").strip()
        os.close(file)
        raise DirectoryInUse(
            f"{path} is in use by process {holder or 'unknown'}",
            "stop it first, or name another directory",
        ) from error
    os.ftruncate(file, 0)
    os.pwrite(file, f"{os.getpid()}\n".encode(), 0)
    return file
