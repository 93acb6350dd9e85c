"""Making a damaged data directory one that starts: what is good is kept, the rest is set aside.

Of all good records, in whichever file they stand, the longest run is kept that goes on from a sound
checkpoint, or from the first record. Nothing is deleted: a file that is changed stays as
``NAME.damaged``. Where records are lost that were acknowledged, the file ``repaired`` says so to
the next start: their numbers must not be given again under the same ids.

It may be stopped at any moment, and goes on when it is called again, since there are three steps:

1. format.json says no format from here on, if it said one, so that nothing starts before the end;
   and how far the log went, which nothing else will tell. What is kept and does not stand where it
   should is written into new files, behind all others (`_STAGED`), that the next call reads, too.
2. All files that are changed are set aside, format.json where it was damaged.
3. The new files get their names, then mark, list of checkpoints and format.json are written.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
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
from .segment import HEAD, NUMBER, Found, Scan, found_in, header_of, path_of, walk

_STAGED: Final = 10**19
"""New files are called as if they began here, where no log comes to, until others have gone."""


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
    misplaced = _misplaced(found)
    sound = {each.position for each in found.checkpoints if each.damage is None} | set(misplaced)
    good = _good(found, sound)
    first, last = _run(good, sound)
    begun, says_format = _begun(path), not lacks_format(path)
    reached = begun or _reached(found, good, last)
    whole = _whole(found.log.scans, first, last)
    # Step 1.
    says_none = msgspec.json.encode(reached) + b"\n"
    if says_format:
        write_whole(disk, path / "format.json", says_none)
    disk.make_folder(journal)
    disk.make_folder(checkpoints)
    moves = {
        _stage(disk, path_of, journal, content): path_of(journal, begin)
        for begin, content in _new_files(good, whole, first, last)
    }
    for position, named in misplaced.items():
        staged = _stage(disk, checkpoint_path, checkpoints, named.read_bytes())
        moves[staged] = checkpoint_path(checkpoints, position)
    # Step 2.
    aside = []
    if begun is None and not says_format:
        if (path / "format.json").exists():
            aside.append(_set_aside(disk, path / "format.json"))
        write_whole(disk, path / "format.json", says_none)
    # A process that was killed, or who copied them, may have left them to the operating system.
    for each in (*whole, *(checkpoint_path(checkpoints, n) for n in sound - set(misplaced))):
        _sync(disk, each)
    new = {
        journal / MARK: Mark(first, last, last).whole(),
        checkpoints / LIST: list_bytes(sorted(sound, reverse=True)[:KEPT]),
    }
    stay = {*whole, *moves}
    changed = [each.path for each in found.log.scans]
    changed += [each.path for each in found.checkpoints if each.damage is not None]
    changed += [each for each, data in new.items() if each.exists() and each.read_bytes() != data]
    aside += [_set_aside(disk, each) for each in changed if each not in stay]
    for folder in (journal, checkpoints):
        disk.sync_folder(folder)
    # Step 3.
    for staged, target in moves.items():
        disk.rename(staged, target)
    for folder in (journal, checkpoints):
        disk.sync_folder(folder)
    for each, data in new.items():
        if not each.exists():
            write_whole(disk, each, data)
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
        """What came after record ``last``, for people."""
        if self.reached > last:
            many = self.reached > last + 1
            return f"records {last + 1} to {self.reached}" if many else f"record {self.reached}"
        return None if self.is_sure else f"what may have followed record {last}"


def _misplaced(found: Inspection) -> dict[int, Path]:
    """Good checkpoints under names of other files, by position, newest first."""
    known = {each.position for each in found.checkpoints if each.damage is None}
    there: dict[int, Path] = {}
    for path in _unsound(found):
        with suppress(JournalDamaged):
            position = checkpoint_in(path).position
            if position not in known:
                there.setdefault(position, path)
    return dict(sorted(there.items(), reverse=True))


def _unsound(found: Inspection) -> list[Path]:
    """Files that may hold something else than their names tell."""
    checkpoints = found.path / "checkpoints"
    paths = [each.path for each in found.log.scans if each.damage is not None]
    paths += [each.path for each in found.checkpoints if each.damage is not None]
    if found.log.reading.fault is not None:
        paths.append(found.path / "journal" / MARK)
    if lacks_format(found.path):
        paths.append(found.path / "format.json")
    return [each for each in (*paths, checkpoints / LIST) if each.exists()]


def _good(found: Inspection, sound: set[int]) -> dict[int, _Place]:
    """All good records. Of one that is there more than once, that in its place."""
    there: dict[int, _Place] = {}
    for scan in found.log.scans:
        if scan.end:
            for each in walk(scan.path.read_bytes(), scan.first):
                there.setdefault(each.position, _place(scan.path, each))
    ends = {each.path: each.end for each in found.log.scans}
    unsound = _unsound(found)
    mark = found.log.mark
    names = [each.first for each in found.log.scans if each.first < _STAGED]
    # What is kept goes on from a checkpoint, or the beginning; what is lost is to be told.
    most = max([0, *sound, *there, *names, 0 if mark is None else mark.durable])
    most += sum(each.stat().st_size for each in unsound) // HEAD
    for path in unsound:
        for each in found_in(path.read_bytes(), ends.get(path, 0), most):
            there.setdefault(each.position, _place(path, each))
    return there


def _place(path: Path, found: Found) -> _Place:
    return _Place(path, found.begin - HEAD, found.begin + found.length)


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
    good: dict[int, _Place], whole: dict[Path, range], first: int, last: int
) -> Iterator[tuple[int, bytes]]:
    """What is to be kept and is in none of the files that stay, as files: first position, content.
    What stands in one file comes into one: the next call finds it so in the new ones."""
    taken = {position for of_file in whole.values() for position in of_file}
    missing = [position for position in range(first, last + 1) if position not in taken]
    # Consecutive ones have the same difference to their places in the list.
    runs = groupby(enumerate(missing), lambda each: (each[1] - each[0], good[each[1]].path))
    for (_, path), run in runs:
        positions, data = [position for _, position in run], path.read_bytes()
        # Each with its head, as it was written.
        parts = [data[good[each].begin : good[each].end] for each in positions]
        yield positions[0], header_of(positions[0]) + b"".join(parts)


def _stage(disk: Disk, name: Callable[[Path, int], Path], folder: Path, content: bytes) -> Path:
    """A file of ``content`` that is not where it belongs yet: one that an earlier call has written,
    or a new one."""
    suffix = name(folder, _STAGED).suffix
    there = sorted(folder.glob(f"{NUMBER}{suffix}"))
    staged = [each for each in there if int(each.stem) >= _STAGED]
    for each in staged:
        if each.stat().st_size == len(content) and each.read_bytes() == content:
            return each
    path = name(folder, 1 + int(staged[-1].stem) if staged else _STAGED)
    write_whole(disk, path, content)
    return path


def _sync(disk: Disk, path: Path) -> None:
    file = disk.open(path)
    try:
        disk.sync(file)
    finally:
        disk.close(file)


def _set_aside(disk: Disk, path: Path) -> Path:
    name, number = f"{path.name}.damaged", 1
    while path.with_name(name).exists():
        number += 1
        name = f"{path.name}.damaged{number}"
    disk.rename(path, path.with_name(name))
    return path.with_name(name)


def _note(disk: Disk, path: Path, told: str) -> None:
    """Let ``path`` say so, too: what an earlier repair has told may not have been heard yet."""
    known = path.read_text(errors="replace").strip() if path.exists() else ""
    if told not in known.split("; "):
        write_whole(disk, path, f"{'; '.join(filter(None, (known, told)))}\n".encode())
