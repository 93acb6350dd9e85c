"""``dyknow replay``: replay a recorded table as a stream, or a recording of several as several."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ..output import DEFAULT_URL, Json, Url
from ..parameters import Delimiter, Sort, TimeColumn, TimeFormat, TimeUnit, table_options
from .piped import existing


def replay(
    file: Annotated[
        Path,
        typer.Argument(
            help="CSV, NDJSON, Arrow or Parquet; a log of PX4 (.ulg), MCAP or ROS (.bag, .db3, a "
            "folder); NDJSON of many streams; RDF with times (.nq .trig .ttl .nt .jsonld); a pipe, "
            "or - for standard input, of CSV or NDJSON.",
            callback=existing,
        ),
    ],
    stream: Annotated[
        list[str] | None,
        typer.Option(
            help="The stream to publish to. For a file of several streams: a selection, with new "
            "names. Default: all of them. May be repeated.",
            metavar="NAME|TOPIC[=NAME]",
        ),
    ] = None,
    speed: Annotated[
        str, typer.Option(help="1: as recorded; 10: ten times faster; max: as fast as possible.")
    ] = "1",
    rebase: Annotated[
        str | None, typer.Option(help="Let the recording begin now, or at a time.", metavar="now")
    ] = None,
    loop: Annotated[
        bool, typer.Option(help="Begin again half a minute after the end, until stopped.")
    ] = False,
    ssl: Annotated[
        str | None, typer.Option(help="The annotation of the streams: SSL text or its file.")
    ] = None,
    lateness: Annotated[
        str | None,
        typer.Option(
            help="How far behind the newest sample one may arrive, such as 5s. Default: the "
            "stream's, or 0s."
        ),
    ] = None,
    idle: Annotated[
        str | None,
        typer.Option(
            help="The silence after which readers no longer wait for a stream, such as 10s."
        ),
    ] = None,
    ahead: Annotated[
        str | None,
        typer.Option(
            help="How far ahead of the clock a sample may be stamped, such as 1h; oo: any. "
            "Default: the stream's, or 1h. A faster replay with --rebase adds its own lead."
        ),
    ] = None,
    time_column: TimeColumn = None,
    time_unit: TimeUnit = None,
    time_format: TimeFormat = None,
    delimiter: Delimiter = None,
    utc: Annotated[
        bool, typer.Option("--utc", help="Move a PX4 log from time since boot to UTC by its GPS.")
    ] = False,
    sort: Sort = None,
    url: Url = DEFAULT_URL,
    as_json: Json = False,
) -> None:
    """Play a recording into its streams: declare them, publish, report the end."""
    from .playing import ReplayOptions, play

    play(
        ReplayOptions(
            file=file,
            stream=stream,
            speed=speed,
            rebase=rebase,
            loop=loop,
            ssl=ssl,
            lateness=lateness,
            idle=idle,
            ahead=ahead,
            tables=table_options(time_column, time_unit, time_format, delimiter),
            utc=utc,
            sort=sort,
            url=url,
            as_json=as_json,
        )
    )
