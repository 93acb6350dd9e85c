"""``dyknow run``: a continuous query over recorded streams, without a server."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ..output import Json
from ..parameters import Bounds, BoundsWord, Origin, Report, ReportWord, Semantics, Sort


def run(
    query: Annotated[
        Path, typer.Argument(help="A REGISTER STREAM|QUERY text.", exists=True, dir_okay=False)
    ],
    stream: Annotated[
        list[str],
        typer.Option(
            help="A recorded stream: its IRI and file. May be repeated.", metavar="IRI=FILE"
        ),
    ],
    static: Annotated[
        list[str] | None,
        typer.Option(
            help="A file of static knowledge; with IRI= the graph of this name in FROM. May be "
            "repeated.",
            metavar="[IRI=]FILE",
        ),
    ] = None,
    ssl: Annotated[
        str | None,
        typer.Option(help="SSL for the streams whose files are tables of samples."),
    ] = None,
    semantics: Semantics = None,
    bounds: Bounds = BoundsWord.LATER,
    origin: Origin = "0",
    report: Report = ReportWord.NON_EMPTY,
    lateness: Annotated[
        str | None,
        typer.Option(
            help="Read timed triples in the order of their files, and drop those that are further "
            "behind than this, such as 5s. Default: sort the files."
        ),
    ] = None,
    late: Annotated[
        Path | None,
        typer.Option(
            help="With --lateness: write the dropped triples to this file, as .ndjson of "
            "time,s,p,o.",
            dir_okay=False,
        ),
    ] = None,
    sort: Sort = None,
    explain: Annotated[
        bool, typer.Option("--explain", help="Print the plan and its cost afterwards.")
    ] = False,
    as_json: Json = False,
) -> None:
    """Evaluate a continuous query over recorded streams and print each window's result.

    A FILE has timed triples (.ndjson or .csv of time,s,p,o; .nq or .trig whose graphs have a
    prov:generatedAtTime), or with --ssl a table of samples.
    """
    from .query_run import RunOptions, run_query

    run_query(
        RunOptions(
            query=query,
            stream=stream,
            static=static,
            ssl=ssl,
            semantics=semantics,
            bounds=bounds,
            origin=origin,
            report=report,
            lateness=lateness,
            late=late,
            sort=sort,
            explain=explain,
            as_json=as_json,
        )
    )
