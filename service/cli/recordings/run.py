"""``dyknow run``: a continuous query or a monitor over recorded streams, without a server."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ..output import Json, err
from ..parameters import (
    Bounds,
    BoundsWord,
    Delimiter,
    Origin,
    Report,
    ReportWord,
    Semantics,
    Sort,
    TimeColumn,
    TimeFormat,
    TimeUnit,
    table_options,
)

_COMPILING = "compiling loops; the next run finds them compiled"


def run(
    query: Annotated[
        Path,
        typer.Argument(
            help="A REGISTER STREAM|QUERY text, or a monitor.", exists=True, dir_okay=False
        ),
    ],
    stream: Annotated[
        list[str],
        typer.Option(
            help="A recorded stream: its IRI, for a monitor its name in SSL, and file. May be "
            "repeated.",
            metavar="IRI=FILE",
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
    ontology: Annotated[
        list[Path] | None,
        typer.Option(
            help="A domain ontology with the sorts and features of a monitor. May be repeated.",
            exists=True,
            dir_okay=False,
        ),
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
    time_column: TimeColumn = None,
    time_unit: TimeUnit = None,
    time_format: TimeFormat = None,
    delimiter: Delimiter = None,
    sort: Sort = None,
    explain: Annotated[
        bool, typer.Option("--explain", help="Print the plan and its cost afterwards.")
    ] = False,
    as_json: Json = False,
) -> None:
    """Evaluate a query over recorded streams, check a monitor, or find a pattern in them.

    A query prints each window's result. A FILE has timed triples (.ndjson or .csv of time,s,p,o;
    .nq or .trig whose graphs have a prov:generatedAtTime), or with --ssl a table of samples.

    A monitor or pattern reads tables of samples. Its results are printed like the samples of dyknow
    follow, and then the counts. Status 1 if it fails; a violation is no failure.
    """
    from ....languages.mtl import is_monitor
    from ....languages.patterns import is_pattern
    from ....streams.jit import when_compiling
    from ..streams import read_text
    from .run_options import RunOptions

    when_compiling(lambda: err().print(_COMPILING, style="dim"))
    text = read_text(query)
    options = RunOptions(
        text=text,
        stream=stream,
        static=static,
        ssl=ssl,
        ontology=ontology,
        semantics=semantics,
        bounds=bounds,
        origin=origin,
        report=report,
        lateness=lateness,
        late=late,
        sort=sort,
        tables=table_options(time_column, time_unit, time_format, delimiter),
        explain=explain,
        as_json=as_json,
    )
    if is_monitor(text) or is_pattern(text):
        from .samples_run import run_over_samples

        run_over_samples(options, "monitor" if is_monitor(text) else "pattern")
    else:
        from .query_run import run_query

        run_query(options)
