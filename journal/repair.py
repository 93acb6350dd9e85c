"""Making a damaged data directory one that starts: what is good is kept, the rest is set aside.

Of all good records the longest run is kept that goes on from a sound checkpoint, or from the first
record. A file that has more than those is written anew without it; the old one stays as
``NAME.damaged``. Nothing is deleted. Where records are lost that were acknowledged, the file
``repaired`` says so to the next start: their numbers must not be given again under the same ids.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from .checkpoints import KEPT, write_list
from .directory import REPAIRED, format_bytes, lacks_format, write_whole
from .disk import DISK, Disk
from .errors import JournalDamaged
from .examination import Examination
from .high_water import NAME as MARK
from .high_water import HighWater, Mark
from .inspection import Inspection
from .segment import HEAD, Found, Scan, header_of, path_of, walk


@dataclass(frozen=True, slots=True)
class Repair:
    """``kept``: first and last position of the log now. ``lost``: what was acknowledged and is
    gone, for people; None: nothing. ``aside``: the files that were set aside."""

    kept: tuple[int, int]
    lost: str | None
    aside: tuple[Path, ...]


def repair(found: Inspection, disk: Disk = DISK) -> Repair:
    """Repair the directory that was inspected. Contract: its lock is held.

    Raises `JournalDamaged`, and changes nothing, where nothing can be gone on from; ``OSError``:
    then it may be called again.
    """
    log = found.log
    records = {scan.path: _records(scan) for scan in log.scans}
    there = {each.position for of_file in records.values() for each in of_file}
    sound = [each.position for each in found.checkpoints if each.damage is None]
    first, last = _run(there, sound)
    lost = _lost(found, there, last)
    aside = []
    if lacks_format(found.path):
        if (found.path / "format.json").exists():
            aside.append(_set_aside(disk, found.path / "format.json"))
        write_whole(disk, found.path / "format.json", format_bytes())
    if lost is not None:
        write_whole(disk, found.path / REPAIRED, f"{lost} lost\n".encode())
    bad = [_set_aside(disk, each.path) for each in found.checkpoints if each.damage is not None]
    aside += bad
    if bad:
        disk.sync_folder(found.path / "checkpoints")
    disk.make_folder(found.path / "checkpoints")
    write_list(found.path / "checkpoints", disk, sound[:KEPT])
    taken: set[int] = set()
    for scan in log.scans:
        wanted = [
            each
            for each in records[scan.path]
            if first <= each.position <= last and each.position not in taken
        ]
        taken.update(each.position for each in wanted)
        if len(wanted) != len(records[scan.path]) or scan.damage is not None:
            aside.append(_rewrite(disk, scan, wanted))
    folder = found.path / "journal"
    disk.make_folder(folder)
    if log.reading.fault is not None and (folder / MARK).exists():
        aside.append(_set_aside(disk, folder / MARK))
    water = HighWater(folder, disk)
    try:
        water.keep(Mark(first, last, last))
    finally:
        water.close()
    disk.sync_folder(folder)
    return Repair((first, last), lost, tuple(aside))


def _records(scan: Scan) -> list[Found]:
    found = list(walk(scan.path.read_bytes(), scan.first)) if scan.end else []
    return found + list(scan.damage.behind if scan.damage is not None else ())


def _run(there: set[int], sound: list[int]) -> tuple[int, int]:
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


def _lost(found: Inspection, there: set[int], last: int) -> str | None:
    """What came after record ``last``."""
    log: Examination = found.log
    most = max([last, *there, 0 if log.mark is None else log.mark.durable])
    if most > last:
        return f"records {last + 1} to {most}" if most > last + 1 else f"record {most}"
    ends_so = any(
        each.damage is not None and each.damage.after == last and each.damage.count
        for each in log.scans
    )
    is_sure = log.reading.is_latest and not ends_so
    return None if is_sure else f"what may have followed record {last}"


def _rewrite(disk: Disk, scan: Scan, wanted: list[Found]) -> Path:
    """Put a file with the records ``wanted`` in the place of one; gives where the old one is. At
    any time each record is in a file of the log."""
    path, data = scan.path, scan.path.read_bytes()
    aside = _free_name(path)
    if wanted:
        first = wanted[0].position
        # Each with its head, as it was written.
        parts = [data[each.begin - HEAD : each.begin + each.length] for each in wanted]
        os.link(path, aside)
        write_whole(disk, path_of(path.parent, first), header_of(first) + b"".join(parts))
        if path != path_of(path.parent, first):
            disk.remove(path)
    else:
        disk.rename(path, aside)
    disk.sync_folder(path.parent)
    return aside


def _set_aside(disk: Disk, path: Path) -> Path:
    aside = _free_name(path)
    disk.rename(path, aside)
    return aside


def _free_name(path: Path) -> Path:
    name, number = f"{path.name}.damaged", 1
    while path.with_name(name).exists():
        number += 1
        name = f"{path.name}.damaged{number}"
    return path.with_name(name)
