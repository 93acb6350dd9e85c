"""Checkpoints: states at positions of the log, each complete or absent.

A file is a line of JSON that describes it, then the state. It gets its name when all of it is on
the disk. The newest two are kept: if one is damaged, a start uses the other and more of the log.
``kept.json`` lists them, so that a start notices one that is missing.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import msgspec

from .directory import write_whole
from .disk import DISK, Disk
from .errors import (
    JournalBroken,
    JournalDamaged,
    JournalFull,
    UnknownFormat,
    is_full,
)
from .segment import NUMBER

FORMAT: Final = 1
KEPT: Final = 2
NAME: Final = ".checkpoint"
LIST: Final = "kept.json"


class Head(msgspec.Struct, frozen=True):
    """The description of a checkpoint in its file: the state after record ``position``.

    ``program`` is for which ``state`` is; ``portable`` bytes at its beginning are for any.
    ``crc32`` is of the other members in this order, as UTF-8 with blanks between, then the bytes.
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


@dataclass(frozen=True, slots=True)
class Kept:
    """A checkpoint as a file: its position, its bytes, when (ns since 1970) it was written."""

    position: int
    size: int
    written: int


class Checkpoints:
    """The checkpoints of one folder. Raises ``OSError``."""

    def __init__(self, folder: Path, disk: Disk = DISK) -> None:
        self._folder = folder
        self._disk = disk
        disk.make_folder(folder)
        for left in folder.glob("*.part"):
            disk.remove(left)

    def positions(self) -> list[int]:
        """The positions of the checkpoints, newest first."""
        return positions_in(self._folder)

    def gone(self) -> list[str]:
        """The missing checkpoints, in words."""
        return gone_from(self._folder)

    def newest(self) -> Kept | None:
        """The newest one as a file; None where there is none. May be asked in any thread."""
        for position in self.positions():
            try:
                found = self._path(position).stat()
            except FileNotFoundError:  # a newer one has taken its place meanwhile
                continue
            return Kept(position, found.st_size, found.st_mtime_ns)
        return None

    def write(self, checkpoint: Checkpoint) -> None:
        """`put` and `keep`."""
        self.put(checkpoint)
        self.keep(checkpoint.position)

    def put(self, checkpoint: Checkpoint) -> None:
        """Put ``checkpoint`` on the disk, where no start reads it before `keep`. May be called in
        another process, one at a time. Raises `JournalFull` and `JournalBroken`; nothing is lost
        then."""
        part = self._part(checkpoint.position)
        with self._told(part):
            # Also those of others that came to nothing: each has as many bytes.
            for left in self._folder.glob("*.part"):
                self._disk.remove(left)
            self._write_part(part, checkpoint)

    def drop(self, position: int) -> None:
        """Remove what `put` has put there, as far as it came: it is not to be kept. Raises
        ``OSError``."""
        part = self._part(position)
        if part.exists():
            self._disk.remove(part)

    def keep(self, position: int) -> None:
        """Keep what `put` has put there, and of the others the newest. Raises as it does."""
        part = self._part(position)
        with self._told(part):
            self._disk.rename(part, self._path(position))
            self._disk.sync_folder(self._folder)
            # Before the older ones go: what it names is there at any time.
            write_list(self._folder, self._disk, self.positions()[:KEPT])
        for old in self.positions()[KEPT:]:
            self._disk.remove(self._path(old))

    @contextmanager
    def _told(self, part: Path) -> Iterator[None]:
        """An error of the disk says what it means, and leaves no ``part``."""
        try:
            yield
        except OSError as error:
            if part.exists():
                self._disk.remove(part)
            what = f"a checkpoint cannot be written: {error}"
            if is_full(error):
                raise JournalFull(what, "make room on the disk of the data directory") from error
            raise JournalBroken(what, "see the logs of the disk") from error

    def read(self, position: int) -> Checkpoint:
        """The one of this position. Raises `JournalDamaged` and `UnknownFormat`."""
        return read_checkpoint(self._path(position))

    def _write_part(self, part: Path, checkpoint: Checkpoint) -> None:
        parts = parts_of(checkpoint)
        file = self._disk.open(part, new=True)
        try:
            self._disk.allocate(file, 0, sum(map(len, parts)))
            start = 0
            for part_of_it in parts:
                self._disk.write(file, part_of_it, start)
                start += len(part_of_it)
            self._disk.sync(file)
        finally:
            self._disk.close(file)

    def _path(self, position: int) -> Path:
        return checkpoint_path(self._folder, position)

    def _part(self, position: int) -> Path:
        return self._path(position).with_suffix(".part")


def checkpoint_path(folder: Path, position: int) -> Path:
    """The file of the checkpoint of this position."""
    return folder / f"{position:020d}{NAME}"


def positions_in(folder: Path) -> list[int]:
    """Of which positions there are checkpoints in ``folder``, newest first."""
    found = (int(path.stem) for path in folder.glob(f"{NUMBER}{NAME}"))
    return sorted(found, reverse=True)


def write_list(folder: Path, disk: Disk, positions: list[int]) -> None:
    """List these positions in ``folder`` as its checkpoints. Raises ``OSError``."""
    write_whole(disk, folder / LIST, list_bytes(positions))


def list_bytes(positions: list[int]) -> bytes:
    """The content of kept.json."""
    return msgspec.json.encode(positions) + b"\n"


def gone_from(folder: Path) -> list[str]:
    """Which checkpoints were in ``folder`` and are not, or that what says so is damaged; for
    people. Raises ``OSError``."""
    named = folder / LIST
    try:
        # None yet, or a version that wrote none.
        known = msgspec.json.decode(named.read_bytes(), type=list[int]) if named.exists() else []
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        return [f"{LIST} of the checkpoints is damaged: {error}"]
    missing = sorted(set(known) - set(positions_in(folder)), reverse=True)
    return [f"the checkpoint of record {each} is missing" for each in missing]


def parts_of(checkpoint: Checkpoint) -> tuple[bytes, bytes, bytes]:
    """``checkpoint`` as a file: what follows each other in it. Nothing large is copied, which would
    hold up other threads."""
    size = len(checkpoint.portable) + len(checkpoint.state)
    head = Head(
        FORMAT,
        checkpoint.position,
        checkpoint.program,
        size,
        len(checkpoint.portable),
        0,
    )
    checksum = _checksum(head, checkpoint.portable, checkpoint.state)
    head = msgspec.structs.replace(head, crc32=checksum)
    return msgspec.json.encode(head) + b"\n", checkpoint.portable, checkpoint.state


def read_checkpoint(path: Path) -> Checkpoint:
    """The checkpoint in a file. Raises `JournalDamaged`, `UnknownFormat` and ``OSError``."""
    found = checkpoint_in(path)
    if int(path.stem) != found.position:
        raise JournalDamaged(f"{path.name} is of position {found.position}")
    return found


def checkpoint_in(path: Path) -> Checkpoint:
    """The checkpoint in a file, for any position and under any name."""
    line, _, body = path.read_bytes().partition(b"\n")
    try:
        head = msgspec.json.decode(line, type=Head)
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise JournalDamaged(f"the head of {path.name} is damaged: {error}") from error
    if len(body) != head.bytes or _checksum(head, body) != head.crc32:
        raise JournalDamaged(f"{path.name} is damaged: its checksum is another")
    if head.format != FORMAT:
        raise UnknownFormat(
            f"{path.name} has format {head.format}, this program reads {FORMAT}",
            "use the version of DyKnow that wrote it, or a later one",
        )
    return Checkpoint(head.position, head.program, body[: head.portable], body[head.portable :])


def _checksum(head: Head, *body: bytes) -> int:
    told = f"{head.format} {head.position} {head.program} {head.bytes} {head.portable}"
    found = zlib.crc32(told.encode())
    for part in body:
        found = zlib.crc32(part, found)
    return found
