"""Examine the folder of a log, by reading only: which records are good, and is something missing?

After a loss of power any part of a write that was not synced may be there: an unfinished write,
which a start cuts off. If synced records are missing or changed, that is damage, which the
examination reports and a start refuses. The ``synced`` of the records behind the place and the
high-water mark tell the two apart. Where they cannot, the end of the log may be missing: a *doubt*.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import BinaryIO

from .high_water import Mark, Reading, read_mark
from .segment import NUMBER, Damage, Scan, scan

HINT = "dyknow check shows it; dyknow repair keeps what is good, or restore a backup"


@dataclass(frozen=True, slots=True)
class Examination:
    """``scans``: all files, in order. ``whole`` of them are good up to the end of the log, which
    has records ``first`` to ``position``; what ``torn`` tells of follows it.

    ``damage`` is what is wrong with what was kept; None: nothing is. ``lost`` is how many records
    were acknowledged and are not there, and could be lost: the durability was ``write``.
    """

    scans: tuple[Scan, ...]
    reading: Reading
    whole: int
    first: int
    position: int
    torn: Damage | None
    damage: str | None
    lost: int

    @property
    def mark(self) -> Mark | None:
        return self.reading.mark

    @property
    def doubt(self) -> str | None:
        """Why records that were acknowledged are gone, or may be, though nothing is damaged that
        would hinder a start; None: all are there."""
        if self.lost:
            return f"the last {self.lost} commands that were kept are lost"
        if self.mark is not None and not self.reading.is_latest:
            return f"{self.reading.fault}: what may have followed record {self.position} is lost"
        return None


def files_of(folder: Path) -> list[Path]:
    """The files of the log in ``folder``, in order."""
    return sorted(folder.glob(f"{NUMBER}.log"))


def open_log(folder: Path, stack: ExitStack) -> tuple[Reading, dict[Path, BinaryIO]]:
    """The mark of the log in ``folder``, and its files in order, held open until the ``stack`` is
    left: what is forgotten meanwhile can be read nevertheless. Raises ``OSError``,
    ``FileNotFoundError`` where one was forgotten after it was listed."""
    # First: if a process writes meanwhile, the files go further than an earlier mark.
    reading = read_mark(folder)
    return reading, {each: stack.enter_context(each.open("rb")) for each in files_of(folder)}


def scans_of(files: Mapping[Path, BinaryIO]) -> tuple[Scan, ...]:
    """What the open ``files`` of a log hold, in their order.

    The last one is read first. A log writes to a file only when those before it are complete. So no
    file lacks records that a later one continues, even if a process writes meanwhile.
    Raises `UnknownFormat` and ``OSError``. Cost: reads all.
    """
    found = [scan(path, files[path].read()) for path in reversed(tuple(files))]
    return tuple(reversed(found))


def examine(folder: Path, *, in_use: bool = False) -> Examination:
    """Look at the log in ``folder``; ``in_use``: a process may write to it (`judged`). Raises
    `UnknownFormat` and ``OSError``. Cost: reads all."""
    with ExitStack() as stack:
        reading, files = open_log(folder, stack)
        return judged(reading, scans_of(files), in_use=in_use)


def judged(reading: Reading, scans: tuple[Scan, ...], *, in_use: bool = False) -> Examination:
    """Judge a log by its files and its mark, which was read before them. If a process may write
    (``in_use``), the judgement leaves out what follows the acknowledged records: it may be half of
    a write."""
    mark = reading.mark
    known = mark or Mark()
    if in_use:
        scans = _without_writes(scans, known.durable)
    whole, torn, overlap = 0, None, None
    first = known.first
    if scans:
        # Without a mark it is unknown whether there were earlier files. With one, files before it
        # are there if the power failed while they were being forgotten.
        first = scans[0].first if mark is None else min(first, scans[0].first)
    position = first - 1
    for each in scans:
        if each.first <= position:
            overlap = f"{each.path.name} has records that the file before it has, too"
        if each.first != position + 1:
            torn = torn or Damage(each.path, 0, each.size, position, ())
            break
        # Where the next file goes on, what is no record at the end of this one is no loss.
        torn = torn or each.damage
        if not each.end:
            break
        whole += 1
        position = each.last
    synced = max([known.synced, *(_synced(each) for each in scans)])
    damage = overlap
    if position < synced:
        what = "records are missing" if torn is None else f"damaged: {torn}"
        damage = f"{what}; records up to {synced} were kept, and are good up to {position}"
    elif damage is None and not reading.is_whole and (scans or in_use):
        # It was on the disk before them (`Log`), so no loss of power has taken it.
        damage = reading.fault
    lost = max(0, known.durable - position)
    return Examination(scans, reading, whole, first, position, torn, damage, lost)


def _synced(scan: Scan) -> int:
    """The greatest that any of its good records tells."""
    behind = () if scan.damage is None else scan.damage.behind
    return max([scan.synced, *(each.synced for each in behind)])


def _without_writes(scans: tuple[Scan, ...], acknowledged: int) -> tuple[Scan, ...]:
    """The same without what may be written just now: files that have no record yet, and the end of
    the last one that has."""
    while scans and scans[-1].last >= acknowledged:
        *before, last = scans
        if last.count:
            return (*before, replace(last, damage=None))
        scans = tuple(before)
    return scans
