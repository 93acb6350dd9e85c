"""``dyknow inspect``: what a recording holds, and a first SSL text for it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ..output import Json
from ..parameters import Delimiter, TimeColumn, TimeFormat, TimeUnit, table_options


def inspect(
    file: Annotated[
        Path,
        typer.Argument(help="A recording, as dyknow replay takes it; no pipe.", exists=True),
    ],
    time_column: TimeColumn = None,
    time_unit: TimeUnit = None,
    time_format: TimeFormat = None,
    delimiter: Delimiter = None,
    utc: Annotated[
        bool, typer.Option("--utc", help="Move a PX4 log from time since boot to UTC by its GPS.")
    ] = False,
    ontology: Annotated[
        list[Path] | None,
        typer.Option(
            help="A domain ontology, whose features are looked for, too. May be repeated.",
            exists=True,
            dir_okay=False,
        ),
    ] = None,
    url: Annotated[
        str | None,
        typer.Option("--url", help="A service, whose features are looked for, too.", metavar="URL"),
    ] = None,
    skeleton: Annotated[
        Path | None,
        typer.Option(help="Write the SSL text to this file, a new one.", dir_okay=False),
    ] = None,
    as_json: Json = False,
) -> None:
    """Show a recording's streams, fields, times and rates, and a first SSL text for it.

    Nothing is published. Fields with the name of a feature become that feature; others are comments
    to fill in.
    """
    from .inspection import inspect as inspected
    from .inspection import show_json_streams, show_streams, write_skeletons

    tables = table_options(time_column, time_unit, time_format, delimiter)
    found = inspected(file, tables, utc, ontology or (), url)
    if skeleton is not None:
        write_skeletons(found, skeleton)
    if as_json:
        show_json_streams(found)
    else:
        show_streams(found, skeleton)
