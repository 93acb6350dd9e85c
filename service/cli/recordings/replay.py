"""``dyknow replay``: a recorded table comes again as a stream, a recording of many as many."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ..output import DEFAULT_URL, Json, Url
from ..parameters import Sort
from .piped import existing


def replay(
    file: Annotated[
        Path,
        typer.Argument(
            help="CSV, CSV.gz, NDJSON or Arrow; a PX4 log (.ulg); NDJSON of many streams; a pipe, "
            "or - for standard input, of CSV or NDJSON.",
            dir_okay=False,
            callback=existing,
        ),
    ],
    stream: Annotated[
        list[str] | None,
        typer.Option(
            help="The stream to publish to. Of a file of many streams: which ones, and as what; "
            "without it all. Repeatable.",
            metavar="NAME|TOPIC[=NAME]",
        ),
    ] = None,
    speed: Annotated[
        str, typer.Option(help="1 is as recorded, 10 ten times faster, max as fast as it goes.")
    ] = "1",
    rebase: Annotated[
        str | None, typer.Option(help="Let the recording begin now, or at a time.", metavar="now")
    ] = None,
    loop: Annotated[
        bool, typer.Option(help="Begin again half a minute after the end, until stopped.")
    ] = False,
    ssl: Annotated[
        str | None, typer.Option(help="What the streams are about: SSL text or its file.")
    ] = None,
    lateness: Annotated[
        str | None,
        typer.Option(
            help="How far behind the newest a sample may be, such as 5s; else as the stream has "
            "it, or 0s."
        ),
    ] = None,
    idle: Annotated[
        str | None,
        typer.Option(help="After how long without samples nobody waits for a stream, such as 10s."),
    ] = None,
    ahead: Annotated[
        str | None,
        typer.Option(
            help="How far ahead of the clock a sample may be stamped, such as 1h; oo: any; else as "
            "the stream has it, or 1h. Of a recording that --rebase plays faster than recorded: as "
            "far as it gets, and so much."
        ),
    ] = None,
    time_column: Annotated[
        str | None, typer.Option(help="The column of valid times; else by its name.")
    ] = None,
    time_unit: Annotated[
        str | None, typer.Option(help="s, ms, us or ns; else by the size of the numbers.")
    ] = None,
    utc: Annotated[
        bool, typer.Option("--utc", help="Move a PX4 log from time since boot to UTC by its GPS.")
    ] = False,
    sort: Sort = None,
    url: Url = DEFAULT_URL,
    as_json: Json = False,
) -> None:
    """Play a recording into its streams: declares them, publishes, says when it has ended."""
    from .playing import Asked, play

    play(
        Asked(
            file=file,
            stream=stream,
            speed=speed,
            rebase=rebase,
            loop=loop,
            ssl=ssl,
            lateness=lateness,
            idle=idle,
            ahead=ahead,
            time_column=time_column,
            time_unit=time_unit,
            utc=utc,
            sort=sort,
            url=url,
            as_json=as_json,
        )
    )
