"""``dyknow serve``: the service, until it is stopped."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from ...journal.durability import Durability


def serve(
    host: Annotated[str | None, typer.Option(help="Address to listen at.")] = None,
    port: Annotated[int | None, typer.Option(help="Port; 0 takes a free one.", min=0)] = None,
    data: Annotated[
        Path | None, typer.Option(help="Directory of what outlives a restart.", file_okay=False)
    ] = None,
    processes: Annotated[
        list[str] | None,
        typer.Option(help="A module or .py file with user-written processes. May be repeated."),
    ] = None,
    tokens: Annotated[
        Path | None,
        typer.Option(
            help="File of who may do what; a line a token (dyknow token).", dir_okay=False
        ),
    ] = None,
    durability: Annotated[
        Durability | None,
        typer.Option(help="With --data: survive loss of power, or only of the process."),
    ] = None,
    log_level: Annotated[str | None, typer.Option(help="debug, info, warning, error.")] = None,
    flights: Annotated[
        bool, typer.Option("--flights", help="Play the recorded flights, again and again.")
    ] = False,
) -> None:
    """Run the service. Every setting can also be given as DYKNOW_<NAME>."""
    given: dict[str, Any] = {"host": host, "port": port, "data": data, "log_level": log_level}
    given["durability"] = durability
    given["processes"] = processes or None
    given["tokens_file"] = tokens
    from .serving import start

    start({key: value for key, value in given.items() if value is not None}, flights=flights)
