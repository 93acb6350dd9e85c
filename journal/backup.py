"""Copies of a data directory, also of one that a service writes to, and directories out of them.

A copy is a folder, or a tar file with the same in it: ``format.json``, the newest sound checkpoint,
the log from it on, and ``backup.json``, that has the checksum of each. What a service appends while
it is copied is in it or not; what it forgets meanwhile is held open, so it is in it.
"""

from __future__ import annotations

import os
import shutil
import tarfile
import zlib
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import BinaryIO, Final

import msgspec

from .checkpoints import NAME as CHECKPOINT
from .directory import REPAIRED, RESTORING, format_bytes, format_of, locked, write_whole
from .disk import DISK
from .errors import JournalDamaged, JournalError, UnknownFormat
from .examination import examine, files_of
from .high_water import NAME as MARK
from .high_water import Mark
from .inspection import inspect
from .segment import HEAD, header_of, path_of, walk

FORMAT: Final = 1
_MANIFEST: Final = "backup.json"
_TRIES: Final = 10


class Manifest(msgspec.Struct, frozen=True):
    """What a backup says of itself. ``files``: size and crc32 of each, by its name in it."""

    format: int
    first: int
    position: int
    checkpoint: int | None
    program: str | None
    files: dict[str, tuple[int, int]]


def back_up(path: Path, target: Path, program: str) -> Manifest:
    """Copy the data directory ``path`` to ``target``, and see that the copy is sound.

    Raises `JournalError` where there is something already, or ``path`` is damaged; ``OSError``.
    Nothing is left of one that fails.
    """
    if target.exists():
        raise JournalError(f"{target} is there already", "name another target, or move it away")
    if format_of(path) is None:
        raise JournalError(
            f"{path} has no format.json: it is no data directory, or of an earlier version",
            "start dyknow serve on it once, or copy the folder while no service has it open",
        )
    part = target.with_name(f"{target.name}.part")
    shutil.rmtree(part, ignore_errors=True)
    try:
        manifest = _copy(path, part)
        _verify(part, manifest, program)
        if target.suffix == ".tar":
            _pack(part, target)
            shutil.rmtree(part)
        else:
            part.rename(target)
        DISK.sync_folder(target.absolute().parent)
    except BaseException:
        shutil.rmtree(part, ignore_errors=True)
        raise
    return manifest


def restore(source: Path, path: Path, program: str) -> Manifest:
    """Make the data directory ``path`` out of a backup. Its next start begins new ids: the service
    that the backup was made of may have given more of the old ones.

    Raises `JournalError` where ``path`` holds something or the backup is not as it was written.
    """
    if path.exists() and any(path.iterdir()):
        raise JournalError(f"{path} is not empty", "name another directory, or move it away")
    manifest = _manifest(source)
    _check(source, manifest)
    disk = DISK
    disk.make_folder(path)
    write_whole(disk, path / RESTORING, f"from {source}\n".encode())
    lock = locked(path)
    try:
        for name, data in _contents(source, manifest):
            disk.make_folder((path / name).parent)
            write_whole(disk, path / name, data)
        told = f"restored from a backup of record {manifest.position}; what followed is not in it"
        write_whole(disk, path / REPAIRED, f"{told}\n".encode())
        disk.remove(path / RESTORING)
        disk.sync_folder(path)
        _verify(path, manifest, program)
    finally:
        os.close(lock)
    return manifest


def _copy(path: Path, part: Path) -> Manifest:
    for tries in range(_TRIES):
        with ExitStack() as stack:
            try:
                checkpoints = [
                    (each.name, stack.enter_context(each.open("rb")))
                    for each in sorted((path / "checkpoints").glob(f"*{CHECKPOINT}"))
                ]
                # Afterwards: the log goes on from the checkpoints that are held open.
                log = [
                    (int(each.stem), stack.enter_context(each.open("rb")))
                    for each in files_of(path / "journal")
                ]
            except FileNotFoundError:
                continue  # forgotten after it was listed
            newest = int(checkpoints[-1][0].removesuffix(CHECKPOINT)) if checkpoints else 0
            if tries < _TRIES - 1 and log and log[0][0] > newest + 1:
                continue
            return _write(part, newest, checkpoints, log)
    raise JournalError(f"{path} changes too quickly", "try again")


def _write(
    part: Path,
    newest: int,
    checkpoints: Sequence[tuple[str, BinaryIO]],
    log: Sequence[tuple[int, BinaryIO]],
) -> Manifest:
    """Write the copy into the folder ``part``."""
    part.mkdir(mode=0o700, parents=True)
    (part / "journal").mkdir()
    (part / "checkpoints").mkdir()
    files: dict[str, tuple[int, int]] = {}

    def put(name: str, data: bytes) -> None:
        write_whole(DISK, part / name, data)
        files[name] = (len(data), zlib.crc32(data))

    put("format.json", format_bytes())
    program = None
    for name, file in checkpoints[-1:]:
        put(f"checkpoints/{name}", data := file.read())
        head = data.partition(b"\n")[0]
        program = _program(head)
    begins = [first for first, _ in log if first <= newest + 1]
    first = begins[-1] if begins else newest + 1
    position = first - 1
    for begin, file in log:
        if begin < first:
            continue
        data = file.read()
        good = bytearray(header_of(begin))
        for found in walk(data, begin):
            good += data[found.begin - HEAD : found.begin + found.length]
            position = found.position
        if begin <= position:
            put(f"journal/{path_of(part, begin).name}", bytes(good))
    mark = Mark(first, position, position).encoded()
    put(f"journal/{MARK}", 3 * mark)
    manifest = Manifest(FORMAT, first, position, newest or None, program, files)
    write_whole(DISK, part / _MANIFEST, msgspec.json.encode(manifest))
    return manifest


def _program(head: bytes) -> str | None:
    try:
        return str(msgspec.json.decode(head)["program"])
    except (msgspec.DecodeError, KeyError):
        return None


def _verify(path: Path, manifest: Manifest, program: str) -> None:
    found = inspect(path, program)
    if found.damage or examine(path / "journal").position != manifest.position:
        reason = "; ".join(found.damage) or "records are missing"
        raise JournalDamaged(
            f"what was copied is not sound: {reason}", "dyknow check shows what is damaged"
        )


def _pack(part: Path, target: Path) -> None:
    packed = target.with_name(f"{target.name}.part.tar")
    try:
        # As the files that are in it: for their owner alone.
        with os.fdopen(os.open(packed, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as file:
            with tarfile.open(fileobj=file, mode="w") as tar:
                for each in sorted(part.rglob("*")):
                    if each.is_file():
                        tar.add(each, str(each.relative_to(part)))
            file.flush()
            os.fsync(file.fileno())
        _check(packed, _manifest(packed))
        packed.rename(target)
    finally:
        packed.unlink(missing_ok=True)


def _manifest(source: Path) -> Manifest:
    try:
        manifest = msgspec.json.decode(_read(source, _MANIFEST), type=Manifest)
    except (KeyError, FileNotFoundError, NotADirectoryError, tarfile.TarError) as error:
        raise JournalError(
            f"{source} is no backup: it has no {_MANIFEST}", "dyknow backup makes one"
        ) from error
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise JournalDamaged(f"{_MANIFEST} of {source} is damaged: {error}") from error
    if manifest.format != FORMAT:
        raise UnknownFormat(
            f"the backup has format {manifest.format}, this program reads {FORMAT}",
            "use the version of DyKnow that wrote it, or a later one",
        )
    return manifest


def _check(source: Path, manifest: Manifest) -> None:
    """Compare every file with its checksum."""
    for _ in _contents(source, manifest):
        pass


def _contents(source: Path, manifest: Manifest) -> Iterator[tuple[str, bytes]]:
    """Every file of a backup by its name. Raises `JournalDamaged` for one that is not as it was."""
    for name, (size, checksum) in manifest.files.items():
        parts = Path(name).parts
        if name.startswith("/") or ".." in parts:
            raise JournalDamaged(f"the backup names a file outside of it: {name}")
        try:
            data = _read(source, name)
        except (KeyError, FileNotFoundError, tarfile.TarError) as error:
            raise JournalDamaged(f"{name} is missing in {source}", "use another backup") from error
        if len(data) != size or zlib.crc32(data) != checksum:
            raise JournalDamaged(f"{name} in {source} is damaged", "use another backup")
        yield name, data


def _read(source: Path, name: str) -> bytes:
    if source.is_dir():
        return (source / name).read_bytes()
    with tarfile.open(source, "r:") as tar:
        file = tar.extractfile(name)
        return b"" if file is None else file.read()
