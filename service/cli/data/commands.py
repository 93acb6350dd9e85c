"""``dyknow check, repair, backup, restore, log``: what a data directory holds
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
    """Look at a data directory, also of a running service: status 1 if it is damaged.

    With --processes (or DYKNOW_PROCESSES) it tells what a start with these modules would miss.
    """
    from . import data_directory

    data_directory.check(directory, processes, json=json)


def repair(directory: Directory, json: Json = False) -> None:
    """Keep what is good of a damaged data directory, and set the rest aside as *.damaged."""
    from . import data_directory

    data_directory.repair(directory, json=json)


def log(
    directory: Directory,
    after: Annotated[int, typer.Option(help="Only what follows this position.", min=0)] = 0,
    count: Annotated[int | None, typer.Option("-n", help="So many, no more.", min=1)] = None,
    full: Annotated[bool, typer.Option("--full", help="Texts and bodies whole.")] = False,
) -> None:
    """Print the commands of a data directory's log, a line of JSON each, up to what is damaged."""
    from . import data_directory

    data_directory.log(directory, after, count, full=full)


def backup(
    directory: Directory,
    target: Annotated[Path, typer.Argument(help="A folder to be made, or a .tar file.")],
    json: Json = False,
) -> None:
    """Copy a data directory, also of a running service, and verify the copy."""
    from . import backups

    backups.backup(directory, target, json=json)


def restore(
    source: Annotated[Path, typer.Argument(help="What dyknow backup has made.")],
    directory: Annotated[
        Path, typer.Argument(help="The data directory to be made; empty, if there.", metavar="DIR")
    ],
    json: Json = False,
) -> None:
    """Make a data directory out of a backup; its next start begins new ids of events."""
    from . import backups

    backups.restore(source, directory, json=json)
