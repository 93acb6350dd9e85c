"""The work of ``dyknow check``, ``repair`` and ``log`` (docs/reference/data-directory.md)."""

from __future__ import annotations

import base64
import os
from collections.abc import Iterator, Mapping, Sequence
from itertools import islice
from pathlib import Path
from typing import Any, BinaryIO

import msgspec
import typer

from ....engine.durability.checkpoint import program
from ....engine.durability.commands import Begin, decode_command
from ....engine.processes.loading import load_processes
from ....engine.processes.registry import PROCESSES
from ....journal.directory import format_of, lacks_format, locked
from ....journal.errors import JournalError
from ....journal.inspection import TRIES, Inspection, inspect, log_of
from ....journal.repair import repair as repair_directory
from ....journal.segment import Scan, walk
from ...config.settings import Settings
from ..output import err, fail, out, show_json, show_table
from .process_state import found_processes, writer_of

_BRIEF = 60
"""Characters that are shown of a text or body."""


def check(directory: Path, processes: list[str] | None, *, json: bool) -> None:
    """Report the content of a data directory, and what a start with these modules would miss;
    status 1 if it is damaged."""
    modules = processes or Settings().processes
    errors = [each.error for each in load_processes(modules) if each.error is not None]
    found, needed = _checked(directory, modules_are_known=bool(modules))
    if json:
        show_json({**_as_json(found), "processes": needed, "not_loaded": errors})
    else:
        _show(found)
        for line in (*(f"not loaded: {each}" for each in errors), *needed):
            out().print(line, markup=False)
    if not found.is_sound:
        raise typer.Exit(1)


def repair(directory: Path, *, json: bool) -> None:
    """Repair a damaged data directory, and set the damaged files aside as *.damaged."""
    try:
        if not lacks_format(directory) and format_of(directory) is None:
            raise fail(f"{directory} has no format.json: there is nothing to repair")
        lock = locked(directory)
    except JournalError as error:
        raise fail(error.message, error.hint) from error
    try:
        found = _inspected(directory, is_held=True)
        if found.is_sound:
            raise fail(f"{directory} is sound: there is nothing to repair", status=0)
        done = repair_directory(found)
    except JournalError as error:
        raise fail(error.message, error.hint) from error
    finally:
        os.close(lock)
    first, last = done.kept
    if json:
        aside = [str(path) for path in done.aside]
        show_json({"first": first, "position": last, "lost": done.lost, "aside": aside})
        return
    show_table(["set aside"], [[str(path)] for path in done.aside])
    kept = f"records {first} to {last}" if first <= last else "the checkpoint, and no record"
    out().print(f"kept: {kept}", markup=False)
    if done.lost is None:
        out().print("lost: nothing")
    else:
        out().print(f"lost: {done.lost}; the next start begins new ids of events", markup=False)


def log(directory: Path, after: int, count: int | None, *, full: bool) -> None:
    """Print at most ``count`` commands of the log after a position, up to any damage."""
    if not (directory / "journal").is_dir():
        raise fail(f"{directory} has no log")
    with log_of(directory) as (found, files):
        for position, data in islice(_records(found.scans, files, after), count):
            command = msgspec.msgpack.decode(data)
            show_json({"position": position, "bytes": len(data), **_plain(command, full)})
    fault = found.damage or found.doubt
    if fault is not None:
        raise fail(fault, "see dyknow check")
    if found.torn is not None:
        err().print(f"an unfinished write, which a start cuts off: {found.torn}", markup=False)


def _records(
    scans: Sequence[Scan], files: Mapping[Path, BinaryIO], after: int
) -> Iterator[tuple[int, bytes]]:
    """Yield the valid records after a position, up to the first gap or damage."""
    position = None
    for each in scans:
        if position not in (None, each.last - each.count):
            return
        position = each.last
        if each.last > after:
            files[each.path].seek(0)
            data = files[each.path].read(each.end)
            for record in walk(data, each.first):
                if record.position > after:
                    yield record.position, data[record.begin : record.begin + record.length]
        if each.damage is not None:
            return


def _plain(command: dict[str, Any], full: bool) -> dict[str, Any]:
    return {str(name): _value(value, full) for name, value in command.items() if value is not None}


def _value(value: Any, full: bool) -> Any:
    if isinstance(value, bytes):
        try:
            value = value.decode()
        except UnicodeDecodeError:
            value = base64.b64encode(value).decode()
    if isinstance(value, str):
        return value if full or len(value) <= _BRIEF else f"{value[:_BRIEF]}… ({len(value)})"
    if isinstance(value, dict):
        return _plain(value, full)
    if isinstance(value, list):
        return [_value(each, full) for each in value]
    return value


def _checked(directory: Path, *, modules_are_known: bool) -> tuple[Inspection, list[str]]:
    for _ in range(TRIES):
        found = _inspected(directory, needs_modules=modules_are_known)
        try:
            return found, found_processes(found, modules_are_known=modules_are_known)
        except FileNotFoundError:
            # The running service deleted a file after the inspection.
            if found.holder is None:
                raise
    raise fail(f"{directory} changes too quickly", "try again")


def _inspected(
    directory: Path, *, needs_modules: bool = False, is_held: bool = False
) -> Inspection:
    own = program(PROCESSES)
    try:
        found = inspect(directory, own, _begun_by, is_held=is_held)
        writer = writer_of(found)
        if not needs_modules and writer is not None and writer.startswith(f"{program()}, "):
            # This program wrote it, with user-written processes that the next start has, too.
            found = inspect(directory, writer, _begun_by, is_held=is_held)
    except JournalError as error:
        raise fail(error.message, error.hint) from error
    return found


def _begun_by(data: bytes) -> str | None:
    first = decode_command(data)
    return first.program if isinstance(first, Begin) else None


def _as_json(found: Inspection) -> dict[str, Any]:
    log_, mark = found.log, found.log.mark
    return {
        "directory": str(found.path),
        "format": found.format,
        "in_use_by": found.holder,
        "first": log_.first,
        "position": log_.position,
        "log": [
            {
                "file": each.path.name,
                "first": each.first,
                "records": each.count,
                "bytes": each.size,
                "damage": None if each.damage is None else str(each.damage),
            }
            for each in log_.scans
        ],
        "unfinished": None if log_.torn is None else str(log_.torn),
        "mark": None if mark is None else {"synced": mark.synced, "durable": mark.durable},
        "checkpoints": [
            {
                "file": each.path.name,
                "position": each.position,
                "bytes": each.size,
                "program": each.program,
                "damage": each.damage,
            }
            for each in found.checkpoints
        ],
        "sound": found.is_sound,
        "damage": list(found.damage),
        "strays": list(found.strays),
        "start": found.start,
    }


def _show(found: Inspection) -> None:
    console = out()
    console.print(f"{found.path}: format {found.format}", markup=False)
    if found.holder is not None:
        console.print(f"in use by process {found.holder}", markup=False)
    if found.log.scans:
        show_table(
            ["log file", "first", "records", "bytes", ""],
            [
                [each.path.name, each.first, each.count, each.size, _state(each.damage)]
                for each in found.log.scans
            ],
        )
    if found.checkpoints:
        show_table(
            ["checkpoint", "bytes", "program", ""],
            [
                [each.position, each.size, each.program or "-", "damaged" if each.damage else "ok"]
                for each in found.checkpoints
            ],
        )
    if found.log.torn is not None and found.log.damage is None and found.holder is None:
        console.print(
            f"an unfinished write, which a start cuts off: {found.log.torn}", markup=False
        )
    for each in found.damage:
        console.print(f"damage: {each}", markup=False)
    for each in found.strays:
        console.print(f"unknown, not checked: {each}", markup=False)
    console.print(f"a start {found.start}", markup=False)


def _state(damage: object) -> str:
    return "ok" if damage is None else "not whole"
