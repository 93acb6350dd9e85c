"""Checkpoints: states at positions of the log, whole or not there.

A file is a line of JSON, that says what it is, then the state. It gets its name when all of it is
on the disk. The newest two are kept: where one is damaged, the other and more of the log do.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import msgspec

from .disk import DISK, Disk
from .errors import JournalDamaged, JournalFull, UnknownFormat

FORMAT: Final = 1
KEPT: Final = 2
_NAME: Final = ".checkpoint"


class Head(msgspec.Struct, frozen=True):
    """What a checkpoint says of itself. ``position``: it is the state after this entry of the log.

    ``program`` is for which ``state`` is; ``portable`` bytes at its beginning are for any.
    """

    format: int
    position: int
    program: str
    bytes: int
    portable: int
    crc32: int


@dataclass(frozen=True, slots=True)
class Checkpoint:
    """A state at a position of the log: for the ``program`` that wrote it, and what of it is
    ``portable`` to others."""

    position: int
    program: str
    portable: bytes
    state: bytes


class Checkpoints:
    """Those of one folder. Raises ``OSError``."""

    def __init__(self, folder: Path, disk: Disk = DISK) -> None:
        self._folder = folder
        self._disk = disk
        folder.mkdir(parents=True, exist_ok=True)
        for left in folder.glob("*.part"):
            left.unlink()

    def positions(self) -> list[int]:
        """Of which positions there are checkpoints, newest first."""
        found = (int(path.stem) for path in self._folder.glob(f"*{_NAME}"))
        return sorted(found, reverse=True)

    def write(self, checkpoint: Checkpoint) -> None:
        """Keep ``checkpoint``, and of the others the newest. Raises `JournalFull`; nothing is lost
        then."""
        body = checkpoint.portable + checkpoint.state
        head = Head(
            FORMAT,
            checkpoint.position,
            checkpoint.program,
            len(body),
            len(checkpoint.portable),
            zlib.crc32(body),
        )
        path = self._path(checkpoint.position)
        part = path.with_suffix(".part")
        part.unlink(missing_ok=True)
        file = self._disk.open(part, new=True)
        try:
            line = msgspec.json.encode(head) + b"\n"
            self._disk.allocate(file, 0, len(line) + len(body))
            self._disk.write(file, line, 0)
            self._disk.write(file, body, len(line))
            self._disk.sync(file)
        except OSError as error:
            part.unlink(missing_ok=True)
            raise JournalFull(
                f"a checkpoint of {len(body)} bytes cannot be written: {error}",
                "make room on the disk of the data directory",
            ) from error
        finally:
            self._disk.close(file)
        self._disk.rename(part, path)
        self._disk.sync_folder(self._folder)
        for old in self.positions()[KEPT:]:
            self._disk.remove(self._path(old))

    def read(self, position: int) -> Checkpoint:
        """The one of this position. Raises `JournalDamaged` and `UnknownFormat`."""
        path = self._path(position)
        data = path.read_bytes()
        line, _, body = data.partition(b"\n")
        try:
            head = msgspec.json.decode(line, type=Head)
        except msgspec.DecodeError as error:
            raise JournalDamaged(f"the head of {path.name} is damaged: {error}") from error
        if head.format != FORMAT:
            raise UnknownFormat(
                f"{path.name} has format {head.format}, this program reads {FORMAT}"
            )
        if len(body) != head.bytes or zlib.crc32(body) != head.crc32:
            raise JournalDamaged(f"{path.name} is damaged: its checksum is another")
        if head.position != position:
            raise JournalDamaged(f"{path.name} is of position {head.position}")
        return Checkpoint(position, head.program, body[: head.portable], body[head.portable :])

    def _path(self, position: int) -> Path:
        return self._folder / f"{position:020d}{_NAME}"
