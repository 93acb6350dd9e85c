"""``dyknow check, repair, backup, restore, log``: commands for data directories
(docs/reference/data-directory.md)."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ..output import Json

Directory = Annotated[Path, typer.Argument(help="A data directory.", metavar="DIR")]


def check(
    directory: Directory,
    processes: Annotated[
        list[str] | None,
        typer.Option(help="A module or .py file of the next start. May be repeated."),
    ] = None,
    json: Json = False,
) -> None:
    """Check a data directory, also of a running service; status 1 if it is damaged.

    With --processes (or DYKNOW_PROCESSES) it reports what a start with these modules would miss.
    """
    from . import data_directory

    data_directory.check(directory, processes, json=json)


def repair(directory: Directory, json: Json = False) -> None:
    """Repair a damaged data directory, and set the damaged files aside as *.damaged."""
    from . import data_directory

    data_directory.repair(directory, json=json)


def log(
    directory: Directory,
    after: Annotated[int, typer.Option(help="Print only commands after this position.", min=0)] = 0,
    count: Annotated[
        int | None, typer.Option("-n", help="Print at most this number.", min=1)
    ] = None,
    full: Annotated[bool, typer.Option("--full", help="Print texts and bodies in full.")] = False,
) -> None:
    """Print the commands of a data directory's log as lines of JSON, up to any damage."""
    from . import data_directory

    data_directory.log(directory, after, count, full=full)


def backup(
    directory: Directory,
    target: Annotated[Path, typer.Argument(help="A new folder, or a .tar file.")],
    json: Json = False,
) -> None:
    """Copy a data directory, also of a running service, and verify the copy."""
    from . import backups

    backups.backup(directory, target, json=json)


def restore(
    source: Annotated[Path, typer.Argument(help="A backup of dyknow backup.")],
    directory: Annotated[
        Path, typer.Argument(help="The data directory: new, or empty.", metavar="DIR")
    ],
    json: Json = False,
) -> None:
    """Make a data directory from a backup; its next start begins new ids of events."""
    from . import backups

    backups.restore(source, directory, json=json)
