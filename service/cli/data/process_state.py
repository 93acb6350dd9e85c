"""User-written processes in a data directory, for ``dyknow check``."""

from __future__ import annotations

from pathlib import Path

import msgspec

from ....engine.durability.commands import Begin, decode_command
from ....engine.durability.missing_processes import missing_message, missing_processes
from ....engine.durability.portable_state import PortableHead
from ....engine.processes.registry import PROCESSES, Processes
from ....journal.checkpoints import read_checkpoint
from ....journal.inspection import Inspection, KnownCheckpoint
from ....journal.segment import walk


def writer_of(found: Inspection) -> str | None:
    """Return the program that wrote the newest checkpoint, or else the log; None without both."""
    newest = _newest(found)
    if newest is not None:
        return newest.program
    begin = _begin(found)
    return None if begin is None else begin.program


def found_processes(found: Inspection, *, modules_are_known: bool) -> list[str]:
    """Return notes on the processes that a start needs: the missing ones if ``modules_are_known``
    and loaded, else all; and those whose state is not in the checkpoint."""
    newest, begin = _newest(found), _begin(found)
    head, quads = PortableHead(), b""
    if newest is not None:
        portable = read_checkpoint(newest.path).portable
        head = msgspec.msgpack.decode(portable, type=PortableHead)
        quads = portable
    elif begin is not None:
        head = PortableHead(begin.processes)
    logs = [each.path.read_bytes() for each in found.log.scans if head.processes]
    there = PROCESSES if modules_are_known else Processes()
    lines = []
    for name, module in sorted(missing_processes(head.processes, there, [quads, *logs]).items()):
        if modules_are_known:
            lines.append(f"missing: {missing_message(name, module)}")
        else:
            lines.append(f"a start needs the user-written process {name!r} of module {module!r}")
    for each in head.unkept:
        anew = "; ids of events begin anew" if each.is_computing else ""
        lines.append(f"not kept: {each}{anew}")
    return lines


def _newest(found: Inspection) -> KnownCheckpoint | None:
    return next((each for each in found.checkpoints if each.damage is None), None)


def _begin(found: Inspection) -> Begin | None:
    """Return the first record of the log, if it is intact."""
    if not found.log.whole or found.log.first != 1 or not found.log.scans[0].count:
        return None
    data = Path(found.log.scans[0].path).read_bytes()
    record = next(walk(data, 1))
    first = decode_command(data[record.begin : record.begin + record.length])
    return first if isinstance(first, Begin) else None
