"""Repair a damaged data directory: keep what is good, and set the rest aside.

Of all good records, in whichever file they stand, a repair keeps the longest run that goes on from
a sound checkpoint, or from the first record. It deletes nothing: a file that it changes stays as
``NAME.damaged``. Where acknowledged records are lost, the file ``repaired`` tells the next start,
which must not give their numbers again under the same ids.

A repair may be stopped at any moment and called again, since it has four steps:

1. format.json says how far the log went, and no format, so that nothing starts before the end.
2. Files that change are renamed to ``NAME.repairing``. The next call searches these, too.
3. Records and checkpoints to keep that stand in no good file are written into new ones, under their
   final names; then the mark and the list of checkpoints.
4. ``NAME.repairing`` becomes ``NAME.damaged``, and format.json says its format again.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Final

import msgspec

from .checkpoints import KEPT, LIST, checkpoint_in, checkpoint_path, list_bytes
from .directory import (
    MANIFEST,
    REPAIRED,
    check_restored,
    format_bytes,
    lacks_format,
    write_whole,
)
from .disk import DISK, Disk
from .errors import JournalDamaged
from .high_water import NAME as MARK
from .high_water import Mark
from .inspection import Inspection
from .segment import HEAD, Scan, found_in, header_of, path_of, walk

_REPAIRING: Final = ".repairing"
"""Ends the name of a file that is set aside while the repair lasts."""


@dataclass(frozen=True, slots=True)
class Repair:
    """``kept``: first and last position of the log now. ``lost``: what was acknowledged and is
    gone, for people; None: nothing. ``aside``: the files that were set aside."""

    kept: tuple[int, int]
    lost: str | None
    aside: tuple[Path, ...]


def repair(found: Inspection, disk: Disk = DISK) -> Repair:
    """Repair the directory that was inspected. Contract: its lock is held.

    Raises `JournalDamaged`, and changes nothing, where nothing can be gone on from, or files may
    never have come here; ``OSError``: then it may be called again. Cost: reads all, and what has
    to be written anew twice.
    """
    path, journal, checkpoints = found.path, found.path / "journal", found.path / "checkpoints"
    check_restored(path)
    if (path / MANIFEST).exists():
        raise JournalDamaged(
            f"{path} is a backup, no data directory: dyknow restore would take it no more",
            "use another backup, or repair a copy of the folder without backup.json",
        )
    begun = _begun(path)
    unsound = _unsound(found)
    misplaced = _misplaced(found, unsound)
    sound = {each.position for each in found.checkpoints if each.damage is None}
    begins = sound | set(misplaced)
    good = _good(found, unsound, max([0, *begins, 0 if begun is None else begun.reached]))
    first, last = _run(good, begins)
    reached = begun or _reached(found, good, last)
    whole = _whole(found.log.scans, first, last)
    moved: dict[Path, Path] = {}
    # Step 1.
    if begun is None:
        named = path / "format.json"
        if lacks_format(path) and named.exists():
            moved[named] = _rename(disk, named, f"{named.name}{_REPAIRING}")
        write_whole(disk, named, msgspec.json.encode(reached) + b"\n")
    disk.make_folder(journal)
    disk.make_folder(checkpoints)
    # A killed process or a copy may have left them in the cache of the operating system.
    for each in (*whole, *(checkpoint_path(checkpoints, position) for position in sound)):
        _sync(disk, each)
    # Step 2.
    told = {
        journal / MARK: Mark(first, last, last).whole(),
        checkpoints / LIST: list_bytes(sorted(begins, reverse=True)[:KEPT]),
    }
    changed = [each.path for each in found.log.scans if each.path not in whole]
    changed += [each.path for each in found.checkpoints if each.damage is not None]
    changed += [each for each, data in told.items() if each.exists() and each.read_bytes() != data]
    moved |= {each: _rename(disk, each, f"{each.name}{_REPAIRING}") for each in changed}
    for folder in (journal, checkpoints):
        disk.sync_folder(folder)
    # Step 3.
    for begin, content in _new_files(good, moved, whole, first, last):
        write_whole(disk, path_of(journal, begin), content)
    for position, named in misplaced.items():
        content = moved.get(named, named).read_bytes()
        write_whole(disk, checkpoint_path(checkpoints, position), content)
    for each, data in told.items():
        if not each.exists():
            write_whole(disk, each, data)
    # Step 4.
    aside = [
        _rename(disk, each, each.name.replace(_REPAIRING, ".damaged")) for each in _set_aside(path)
    ]
    for folder in (journal, checkpoints):
        disk.sync_folder(folder)
    lost = reached.lost(last)
    if lost is not None:
        _note(disk, path / REPAIRED, f"{lost} lost")
    write_whole(disk, path / "format.json", format_bytes())
    return Repair((first, last), lost, tuple(aside))


@dataclass(frozen=True, slots=True)
class _Place:
    """Where a good record stands, with its head."""

    path: Path
    begin: int
    end: int


class _Reached(msgspec.Struct, frozen=True):
    """How far the log went: to record ``reached``, and no further if that ``is_sure``. In the place
    of format.json it says that a repair has begun and not ended."""

    reached: int
    is_sure: bool
    format: None = None

    def lost(self, last: int) -> str | None:
        """What came after record ``last``, in words."""
        if self.reached > last:
            many = self.reached > last + 1
            return f"records {last + 1} to {self.reached}" if many else f"record {self.reached}"
        return None if self.is_sure else f"what may have followed record {last}"


def _misplaced(found: Inspection, unsound: list[Path]) -> dict[int, Path]:
    """Good checkpoints under names of other files, by position, newest first."""
    known = {each.position for each in found.checkpoints if each.damage is None}
    there: dict[int, Path] = {}
    for path in unsound:
        with suppress(JournalDamaged):
            position = checkpoint_in(path).position
            if position not in known:
                there.setdefault(position, path)
    return dict(sorted(there.items(), reverse=True))


def _unsound(found: Inspection) -> list[Path]:
    """Files that may hold something else than their names tell, in an order that stays when they
    are set aside."""
    paths = [each.path for each in found.log.scans if each.damage is not None]
    paths += [each.path for each in found.checkpoints if each.damage is not None]
    paths += [found.path / "checkpoints" / LIST]
    if found.log.reading.fault is not None:
        paths.append(found.path / "journal" / MARK)
    if lacks_format(found.path):
        paths.append(found.path / "format.json")
    return _in_order([*(each for each in paths if each.exists()), *_set_aside(found.path)])


def _in_order(paths: Iterable[Path]) -> list[Path]:
    return sorted(paths, key=lambda path: (path.parent.name != "journal", path))


def _set_aside(path: Path) -> list[Path]:
    """The files of the data directory ``path`` that this repair, or one that was stopped, has set
    aside."""
    return _in_order(path.glob(f"*{_REPAIRING}*")) + _in_order(path.glob(f"*/*{_REPAIRING}*"))


def _good(found: Inspection, unsound: list[Path], most: int) -> dict[int, _Place]:
    """All good records. Of one that is there more than once, the first in the order of files. The
    log went at least to record ``most``."""
    log = found.log
    most = max(
        [most, *(each.last for each in log.scans), 0 if log.mark is None else log.mark.durable]
    )
    most += sum(each.stat().st_size for each in unsound) // HEAD
    there: dict[int, _Place] = {}
    for path in _in_order({*unsound, *(each.path for each in log.scans)}):
        data = path.read_bytes()
        known = found_in(data, 0, most) if path in unsound else walk(data, int(path.stem))
        for each in known:
            there.setdefault(
                each.position, _Place(path, each.begin - HEAD, each.begin + each.length)
            )
    return there


def _run(there: Collection[int], sound: Collection[int]) -> tuple[int, int]:
    """First and last position of the records to keep."""
    begins = [0, *sound] if 1 in there or not (there or sound) else sound
    if not begins:
        raise JournalDamaged(
            "nothing can be gone on from: there is no sound checkpoint, and the log does not "
            "begin at its beginning",
            "restore a backup (dyknow restore)",
        )

    def end(begin: int) -> int:
        while begin + 1 in there:
            begin += 1
        return begin

    last, begin = max((end(begin), -begin) for begin in begins)
    first = 1 - begin
    while first - 1 in there:
        first -= 1
    return first, last


def _begun(path: Path) -> _Reached | None:
    """What a repair that was stopped has left; None: none was, since it began to set aside."""
    named = path / "format.json"
    with suppress(msgspec.DecodeError, UnicodeDecodeError):
        return msgspec.json.decode(named.read_bytes(), type=_Reached) if named.exists() else None
    return None


def _reached(found: Inspection, good: dict[int, _Place], last: int) -> _Reached:
    log = found.log
    most = max([last, *good, 0 if log.mark is None else log.mark.durable])
    goes_on = any(
        each.damage is not None and each.damage.after == last and each.damage.count
        for each in log.scans
    )
    if last in good and not goes_on:
        # Also in a file that has another's name.
        place = good[last]
        follows = place.path.read_bytes()[place.end :].rstrip(b"\0")
        known = any(each.path == place.path and each.begin == place.end for each in good.values())
        goes_on = bool(follows) and not known
    return _Reached(most, log.reading.is_latest and not goes_on)


def _whole(scans: tuple[Scan, ...], first: int, last: int) -> dict[Path, range]:
    """Files of the log that stay as they are, with the positions of their records."""
    whole = {}
    for each in scans:
        is_next = each.first >= first and each.last <= last
        # One without records is the last, or would begin where another does.
        if each.damage is None and is_next and (each.count or each.first == last + 1):
            whole[each.path] = range(each.first, each.last + 1)
            first = each.last + 1
    return whole


def _new_files(
    good: dict[int, _Place],
    moved: Mapping[Path, Path],
    whole: dict[Path, range],
    first: int,
    last: int,
) -> Iterator[tuple[int, bytes]]:
    """What is to be kept and is in none of the files that stay, as files: first position, content.
    What stands in one file comes into one. ``moved`` are files that have got another name."""
    taken = {position for of_file in whole.values() for position in of_file}
    missing = [position for position in range(first, last + 1) if position not in taken]
    # Consecutive ones have the same difference to their places in the list.
    runs = groupby(enumerate(missing), lambda each: (each[1] - each[0], good[each[1]].path))
    for (_, path), run in runs:
        positions, data = [position for _, position in run], moved.get(path, path).read_bytes()
        # Each with its head, as it was written.
        parts = [data[good[each].begin : good[each].end] for each in positions]
        yield positions[0], header_of(positions[0]) + b"".join(parts)


def _sync(disk: Disk, path: Path) -> None:
    file = disk.open(path)
    try:
        disk.sync(file)
    finally:
        disk.close(file)


def _rename(disk: Disk, path: Path, name: str) -> Path:
    """Rename the file to ``name``, with a number if there is such a file."""
    target, number = path.with_name(name), 1
    while target.exists():
        number += 1
        target = path.with_name(f"{name}{number}")
    disk.rename(path, target)
    return target


def _note(disk: Disk, path: Path, told: str) -> None:
    """Add ``told`` to ``path``: a start may not have read yet what an earlier repair wrote."""
    known = path.read_text(errors="replace").strip() if path.exists() else ""
    if told not in known.split("; "):
        write_whole(disk, path, f"{'; '.join(filter(None, (known, told)))}\n".encode())
