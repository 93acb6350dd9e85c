"""The work of ``dyknow backup`` and ``restore`` (docs/reference/data-directory.md)."""

from __future__ import annotations

from pathlib import Path

import msgspec

from ....engine.durability.checkpoint import program
from ....journal.backup import Manifest, back_up
from ....journal.backup import restore as restore_directory
from ....journal.errors import JournalError
from ..output import fail, out, show_json


def backup(directory: Path, target: Path, *, json: bool) -> None:
    """Copy a data directory, also of a running service, and verify the copy."""
    try:
        manifest = back_up(directory, target, program())
    except JournalError as error:
        raise fail(error.message, error.hint) from error
    _show(manifest, f"{target}: a copy of {directory}", json)


def restore(source: Path, directory: Path, *, json: bool) -> None:
    """Make a data directory from a backup; its next start begins new ids of events."""
    try:
        manifest = restore_directory(source, directory, program())
    except JournalError as error:
        raise fail(error.message, error.hint) from error
    _show(manifest, f"{directory}: restored from {source}", json)


def _show(manifest: Manifest, what: str, json: bool) -> None:
    if json:
        show_json(msgspec.to_builtins(manifest))
        return
    size = sum(size for size, _ in manifest.files.values())
    begin = "no checkpoint" if manifest.checkpoint is None else f"checkpoint {manifest.checkpoint}"
    count = max(0, manifest.position - manifest.first + 1)
    out().print(
        f"{what}, up to record {manifest.position}: {begin} and {count} records, {size:,} bytes",
        markup=False,
    )
