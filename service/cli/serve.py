"""``dyknow serve``: run the service until it is stopped."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from ...journal.durability import Durability


def serve(
    recording: Annotated[
        Path | None,
        typer.Argument(
            metavar="[FILE]",
            help="A recording that `dyknow replay` reads: all of it is played at the start.",
            exists=True,
        ),
    ] = None,
    host: Annotated[str | None, typer.Option(help="Address to listen at.")] = None,
    port: Annotated[int | None, typer.Option(help="Port; 0 takes a free one.", min=0)] = None,
    data: Annotated[
        Path | None, typer.Option(help="The data directory, kept over restarts.", file_okay=False)
    ] = None,
    processes: Annotated[
        list[str] | None,
        typer.Option(help="A module or .py file with user-written processes. May be repeated."),
    ] = None,
    tokens: Annotated[
        Path | None,
        typer.Option(
            help="File of tokens and their permissions, one per line (dyknow token).",
            dir_okay=False,
        ),
    ] = None,
    durability: Annotated[
        Durability | None,
        typer.Option(help="With --data: survive a power failure, or only the end of the process."),
    ] = None,
    log_level: Annotated[str | None, typer.Option(help="debug, info, warning, error.")] = None,
    flights: Annotated[
        bool, typer.Option("--flights", help="Play the recorded flights in a loop.")
    ] = False,
    ssl: Annotated[
        str | None,
        typer.Option(help="The annotation of the recording's streams: SSL text or its file."),
    ] = None,
) -> None:
    """Run the service. Every setting can also be given as DYKNOW_<NAME>."""
    if ssl is not None and recording is None:
        raise typer.BadParameter("--ssl annotates the streams of a recording: name its file")
    given: dict[str, Any] = {"host": host, "port": port, "data": data, "log_level": log_level}
    given["durability"] = durability
    given["processes"] = processes or None
    given["tokens_file"] = tokens
    from .serving import start

    start(
        {key: value for key, value in given.items() if value is not None},
        flights=flights,
        recording=recording,
        ssl=ssl,
    )
