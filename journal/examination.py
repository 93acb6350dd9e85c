"""What a log's folder holds, and what is to be believed of it. Reads only.

After a loss of power of what was written and not synced any part may be there: the last write is
unfinished, and is cut off. What was synced is there, or the disk or somebody has damaged it: that
is told, and nothing is done. Which of both it is tell the records behind the place (their
``synced``) and the high-water mark. Where that cannot tell all, nobody knows whether something is
missing at the log's end: that is told, too.
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
    # First: whoever writes meanwhile, the files say more than a mark of before.
    reading = read_mark(folder)
    return reading, {each: stack.enter_context(each.open("rb")) for each in files_of(folder)}


def scans_of(files: Mapping[Path, BinaryIO]) -> tuple[Scan, ...]:
    """What the open ``files`` of a log hold, in their order.

    The last one is read first. A log writes to a file when all is written that goes into those
    before it, so whoever writes meanwhile, none of them lacks what a later one goes on from.
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
    """What is to be believed of a log with these files, of which the mark was read before. Where a
    process may have written ``in_use``, what follows all that was acknowledged is not looked at:
    it may be half of a write."""
    mark = reading.mark
    known = mark or Mark()
    if in_use:
        scans = _without_writes(scans, known.durable)
    whole, torn, overlap = 0, None, None
    first = known.first
    if scans:
        # Without a mark nobody knows whether there was more before; with one, files before it are
        # there if they were to be forgotten and the power went.
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
