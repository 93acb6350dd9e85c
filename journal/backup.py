"""Back up a data directory, also while a service writes to it, and restore one from a backup.

A copy is a folder, or a tar file with the same in it: ``format.json``, the newest sound checkpoint,
the log from it on, and ``backup.json``, that has the checksum of each. A record
that a service appends meanwhile may be in it; a file that it removes meanwhile is held open and
therefore copied.
"""

from __future__ import annotations

import os
import shutil
import tarfile
import tempfile
import zlib
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import BinaryIO, Final

import msgspec

from .checkpoints import checkpoint_path, positions_in
from .directory import (
    MANIFEST,
    REPAIRED,
    RESTORING,
    check_restored,
    format_bytes,
    format_of,
    holder_of,
    locked,
    write_whole,
)
from .disk import DISK
from .errors import JournalDamaged, JournalError, UnknownFormat
from .examination import Examination, judged, open_log, scans_of
from .high_water import NAME as MARK
from .high_water import Mark
from .inspection import UNFINISHED, inspect

FORMAT: Final = 1
_TRIES: Final = 10


class Manifest(msgspec.Struct, frozen=True):
    """The description of a backup in it. ``files``: size and crc32 of each, by its name in it."""

    format: int
    first: int
    position: int
    checkpoint: int | None
    program: str | None
    files: dict[str, tuple[int, int]]


def back_up(path: Path, target: Path, program: str) -> Manifest:
    """Copy the data directory ``path`` to ``target``, and see that the copy is sound.

    Raises `JournalError` where there is something already, ``path`` is damaged, or what was
    acknowledged is missing in it; ``OSError``. Nothing is left of one that fails; of one that is
    killed a ``.part`` of its own is.
    """
    if os.path.lexists(target):
        raise _taken(target)
    if target.absolute().is_relative_to(path.absolute()):
        raise JournalError(
            f"{target} is in the data directory itself", "name a target outside of it"
        )
    if format_of(path) is None:
        raise JournalError(
            f"{path} has no format.json: it is no data directory, or of an earlier version",
            "start dyknow serve on it once, or copy the folder while no service has it open",
        )
    check_restored(path)
    folder = target.absolute().parent
    missing = [each for each in (folder, *folder.parents) if not each.exists()]
    DISK.make_folder(folder)
    # Others may copy to the same place, or have something there that is called so.
    part = Path(tempfile.mkdtemp(".part", f"{target.name}.", folder))
    try:
        copy = part / "copy"
        manifest = _copy(path, copy)
        _verify(copy, manifest, program)
        if target.suffix == ".tar":
            copy = _pack(copy, part / "copy.tar")
        if os.path.lexists(target):
            raise _taken(target)
        copy.rename(target)
        DISK.sync_folder(folder)
    except BaseException:
        shutil.rmtree(part, ignore_errors=True)
        with suppress(OSError):  # another process has put something there
            for each in missing:
                each.rmdir()
        raise
    shutil.rmtree(part, ignore_errors=True)
    return manifest


def _taken(target: Path) -> JournalError:
    return JournalError(f"{target} is there already", "name another target, or move it away")


def restore(source: Path, path: Path, program: str) -> Manifest:
    """Make the data directory ``path`` out of a backup. Its next start begins new ids: the service
    that the backup was made of may have given more of the old ones.

    Raises `JournalError` where ``path`` holds something or the backup is not as it was written.
    """
    if path.exists() and not path.is_dir():
        raise JournalError(f"{path} is no directory", "name another one, or move it away")
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
        _verify(path, manifest, program)
        disk.remove(path / RESTORING)
        disk.sync_folder(path)
    finally:
        os.close(lock)
    return manifest


def _copy(path: Path, part: Path) -> Manifest:
    for tries in range(_TRIES):
        is_last, holder = tries == _TRIES - 1, holder_of(path)
        with ExitStack() as stack:
            try:
                folder = path / "checkpoints"
                checkpoints = {
                    position: stack.enter_context(checkpoint_path(folder, position).open("rb"))
                    for position in positions_in(folder)
                }
                # Afterwards: the log goes on from the checkpoints that are held open.
                reading, log = open_log(path / "journal", stack)
            except FileNotFoundError:
                continue  # forgotten after it was listed
            newest = max(checkpoints, default=0)
            begins = [int(each.stem) for each in log]
            if not is_last and begins and begins[0] > newest + 1:
                continue
            first = max((each for each in begins if each <= newest + 1), default=newest + 1)
            needed = {each: file for each, file in log.items() if int(each.stem) >= first}
            in_use = holder is not None
            found = judged(reading.since(first), scans_of(needed), in_use=in_use)
            fault = found.damage or found.doubt
            if fault is None:
                return _write(part, newest, checkpoints.get(newest), found, needed)
            # What is being written may look so.
            if holder is None or is_last:
                raise _unsound(fault)
    raise JournalError(f"{path} changes too quickly", "try again")


def _write(
    part: Path,
    newest: int,
    checkpoint: BinaryIO | None,
    found: Examination,
    log: Mapping[Path, BinaryIO],
) -> Manifest:
    """Write the copy into the folder ``part``: the checkpoint of record ``newest``, and what was
    ``found`` good of the files of the ``log``."""
    part.mkdir(mode=0o700, parents=True)
    (part / "journal").mkdir()
    (part / "checkpoints").mkdir()
    files: dict[str, tuple[int, int]] = {}

    def put(name: str, data: bytes) -> None:
        write_whole(DISK, part / name, data)
        files[name] = (len(data), zlib.crc32(data))

    put("format.json", format_bytes())
    program = None
    if checkpoint is not None:
        data = checkpoint.read()
        put(f"checkpoints/{checkpoint_path(part, newest).name}", data)
        program = _program(data.partition(b"\n")[0])
    for each in found.scans[: found.whole]:
        if each.count:
            log[each.path].seek(0)
            put(f"journal/{each.path.name}", log[each.path].read(each.end))
    put(f"journal/{MARK}", Mark(found.first, found.position, found.position).whole())
    manifest = Manifest(FORMAT, found.first, found.position, newest or None, program, files)
    write_whole(DISK, part / MANIFEST, msgspec.json.encode(manifest))
    return manifest


def _program(head: bytes) -> str | None:
    try:
        return str(msgspec.json.decode(head)["program"])
    except (msgspec.DecodeError, UnicodeDecodeError, KeyError):
        return None


def _verify(path: Path, manifest: Manifest, program: str) -> None:
    found = inspect(path, program, is_held=True)
    # It is not finished before it is verified.
    damage = [each for each in found.damage if each != UNFINISHED]
    if damage:
        raise _unsound("; ".join(damage))
    if (found.log.first, found.log.position) != (manifest.first, manifest.position):
        raise _unsound(
            f"it has records {found.log.first} to {found.log.position} instead of "
            f"{manifest.first} to {manifest.position}"
        )


def _unsound(reason: str) -> JournalDamaged:
    return JournalDamaged(
        f"what was copied is not sound: {reason}", "dyknow check shows what is damaged"
    )


def _pack(copy: Path, packed: Path) -> Path:
    # As the files that are in it: for their owner alone.
    with os.fdopen(os.open(packed, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as file:
        with tarfile.open(fileobj=file, mode="w") as tar:
            for each in sorted(copy.rglob("*")):
                if each.is_file():
                    tar.add(each, str(each.relative_to(copy)))
        file.flush()
        os.fsync(file.fileno())
    _check(packed, _manifest(packed))
    return packed


def _manifest(source: Path) -> Manifest:
    try:
        manifest = msgspec.json.decode(_read(source, MANIFEST), type=Manifest)
    except (KeyError, FileNotFoundError, NotADirectoryError, tarfile.TarError) as error:
        raise JournalError(
            f"{source} is no backup: it has no {MANIFEST}", "dyknow backup makes one"
        ) from error
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise JournalDamaged(f"{MANIFEST} of {source} is damaged: {error}") from error
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
