"""Inspect a data directory for ``dyknow check``, by reading only: what it holds, what a start would
do."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import BinaryIO, Final, TypeAlias

from .checkpoints import (
    LIST,
    checkpoint_path,
    gone_from,
    positions_in,
    read_checkpoint,
)
from .checkpoints import NAME as CHECKPOINT
from .directory import (
    FORMAT,
    MANIFEST,
    REPAIRED,
    RESTORING,
    format_of,
    holder_of,
    lacks_format,
)
from .errors import JournalDamaged
from .examination import Examination, examine, judged, open_log, scans_of
from .high_water import NAME as MARK
from .segment import NUMBER, walk

BegunBy: TypeAlias = Callable[[bytes], str | None]

_KNOWN = (
    (
        "format.json*",
        "lock",
        "journal",
        "checkpoints",
        f"{REPAIRED}*",
        f"{RESTORING}*",
        "ontology",
        "ontology.format1",
        MANIFEST,
    ),
    (f"{NUMBER}.log*", f"{MARK}*", f"{NUMBER}{CHECKPOINT}*", f"{LIST}*", "*.part"),
)
"""Patterns of what may be in a data directory, and in its two folders."""
UNFINISHED: Final = "a restore was not finished"
TRIES: Final = 5
"""How often what looks damaged is read again while a process writes."""
_PAUSE: Final = 0.02
"""Seconds before it is: a log that is being begun has its mark by then."""


@dataclass(frozen=True, slots=True)
class KnownCheckpoint:
    """``damage``: why it cannot be read; None: it is sound."""

    path: Path
    position: int
    size: int
    program: str | None
    damage: str | None


@dataclass(frozen=True, slots=True)
class Inspection:
    """A data directory. ``format`` 1: an Oxigraph store of an earlier version, nothing else.

    ``damage``: what is wrong, worst first. ``strays``: names in it that are none of its own.
    ``start``: what a start would do, for people.
    """

    path: Path
    format: int
    holder: str | None
    log: Examination
    checkpoints: tuple[KnownCheckpoint, ...]
    damage: tuple[str, ...]
    strays: tuple[str, ...]
    start: str

    @property
    def is_sound(self) -> bool:
        return not self.damage


def inspect(
    path: Path, program: str, begun_by: BegunBy | None = None, *, is_held: bool = False
) -> Inspection:
    """Look at the data directory ``path``, that may be in use, for a start by ``program``.
    ``begun_by`` tells which program has begun the log that has this first record. With ``is_held``
    the caller holds its lock: no process writes meanwhile.

    Raises `JournalDamaged` where there is none, or its format cannot be read, `UnknownFormat`,
    ``OSError``. Cost: reads all of it.
    """
    if lacks_format(path):
        # Its file is gone, the rest is not.
        format: int | None = FORMAT
    else:
        format = format_of(path) if path.is_dir() else None
    if format is None:
        if not (path / "ontology").is_dir():
            raise JournalDamaged(f"{path} is no data directory", "it has no format.json")
        format = 1
    for tries in range(TRIES):
        holder = None if is_held else holder_of(path)
        try:
            found = _look(path, format, program, holder, begun_by)
        except FileNotFoundError:
            # The process that writes has removed it after it was listed.
            if holder is None or tries == TRIES - 1:
                raise
        else:
            if found.is_sound or holder is None:
                break
        time.sleep(_PAUSE)
    return found


@contextmanager
def log_of(path: Path) -> Iterator[tuple[Examination, Mapping[Path, BinaryIO]]]:
    """The log of the data directory ``path``, that may be in use, and its files, held open. Raises
    `UnknownFormat` and ``OSError``. Cost: reads all of it."""
    for tries in range(TRIES):
        holder = holder_of(path)
        is_last = holder is None or tries == TRIES - 1
        with ExitStack() as stack:
            try:
                reading, files = open_log(path / "journal", stack)
            except FileNotFoundError:
                if is_last:
                    raise
            else:
                found = judged(reading, scans_of(files), in_use=holder is not None)
                if is_last or not (found.damage or found.doubt):
                    yield found, files
                    return
        time.sleep(_PAUSE)


def _look(
    path: Path, format: int, program: str, holder: str | None, begun_by: BegunBy | None
) -> Inspection:
    log = examine(path / "journal", in_use=holder is not None)
    gone = gone_from(path / "checkpoints")
    found = tuple(_checkpoint(path / "checkpoints", p) for p in positions_in(path / "checkpoints"))
    damage = [] if log.damage is None else [log.damage]
    is_unfinished = (path / RESTORING).exists()
    if is_unfinished:
        damage.append(UNFINISHED)
    if log.lost and log.damage is None and log.doubt is not None:
        damage.append(log.doubt)
    damage += [each.damage for each in found if each.damage is not None] + gone
    fault = log.reading.fault
    if log.scans and fault is not None and fault != log.damage:
        damage.append(fault)
    sound = [each for each in found if each.damage is None]
    refusal = misfit(log, [each.position for each in sound])
    if refusal is not None and log.damage is None:
        damage.insert(0, refusal)
    if lacks_format(path):
        damage.insert(0, "format.json is missing or damaged")
        start = "refuses: see dyknow repair"
    elif is_unfinished:
        start = "refuses: remove the directory and restore again"
    elif (path / MANIFEST).exists():
        start = "refuses: it is a backup, of which dyknow restore makes a directory"
    elif log.damage is None and refusal is None:
        begun = _begun(log, begun_by) if not sound else None
        start = _start(path, format, log, sound, program, begun or program)
    else:
        start = "refuses: see dyknow repair, or restore a backup"
    return Inspection(path, format, holder, log, found, tuple(damage), _strays(path), start)


def _strays(path: Path) -> tuple[str, ...]:
    """Names of files that the program did not make, or no longer reads."""
    folders = [each for each in (path, path / "journal", path / "checkpoints") if each.is_dir()]
    return tuple(
        str(each.relative_to(path))
        for folder in folders
        for each in sorted(folder.iterdir())
        if not any(fnmatchcase(each.name, known) for known in _KNOWN[folder != path])
    )


def misfit(log: Examination, positions: list[int]) -> str | None:
    """Why log and sound checkpoints (newest first) do not make a state; None: they do."""
    if not positions:
        missing = log.first > 1
        return f"no sound checkpoint, and the log begins with {log.first}" if missing else None
    newest = positions[0]
    if newest > log.position or newest + 1 < log.first:
        return (
            f"the newest checkpoint is of record {newest}, the log has records "
            f"{log.first} to {log.position}"
        )
    return None


def _checkpoint(folder: Path, position: int) -> KnownCheckpoint:
    path = checkpoint_path(folder, position)
    size = path.stat().st_size
    try:
        found = read_checkpoint(path)
    except JournalDamaged as error:
        return KnownCheckpoint(path, position, size, None, error.message)
    return KnownCheckpoint(path, position, size, found.program, None)


def _start(
    path: Path,
    format: int,
    log: Examination,
    sound: list[KnownCheckpoint],
    program: str,
    begun: str,
) -> str:
    if format == 1:
        return "takes over the definitions of an earlier version; samples were not kept"
    begin = sound[0].position if sound else 0
    count = log.position - begin
    if not begin and not count:
        return "begins with nothing"
    told = f"goes on from {f'checkpoint {begin}' if begin else 'the beginning'}"
    told += f", does {count} commands again"
    named = path / REPAIRED
    if named.exists():
        reason = named.read_text(errors="replace").strip()
        return f"{told}; ids of events begin anew: {reason}"
    if log.doubt is not None:
        return f"{told}; ids of events begin anew: {log.doubt}"
    if sound and sound[0].program != program:
        return (
            f"takes over definitions and samples of checkpoint {begin}, written by "
            f"{sound[0].program}, and does {count} commands again; ids of events begin anew"
        )
    if begun != program:
        return f"{told}, that {begun} did; ids of events begin anew"
    return told


def _begun(log: Examination, begun_by: BegunBy | None) -> str | None:
    if begun_by is None or not log.whole or not log.scans[0].count:
        return None
    data = log.scans[0].path.read_bytes()
    first = next(walk(data, log.first))
    return begun_by(data[first.begin : first.begin + first.length])
