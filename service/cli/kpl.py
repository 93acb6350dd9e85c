"""``dyknow kpl``: check declarations, and prove and run them on a recording, without a server; add,
show and remove them in a running service."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from .output import (
    DEFAULT_URL,
    Json,
    Url,
    connect,
    show_json,
    show_lines,
    show_table,
    show_text,
)
from .parameters import Delimiter, TimeColumn, TimeFormat, table_options
from .streams import text_or_file

kpl = typer.Typer(
    help="KPL, the knowledge processing language: check, prove, run, add, show, remove.",
    no_args_is_help=True,
)

File = Annotated[
    Path, typer.Argument(help="A text of KPL declarations.", exists=True, dir_okay=False)
]
Unit = Annotated[
    Literal["ns", "us", "ms", "s"],
    typer.Option(help="The unit of integers, if the text has none."),
]


@kpl.command()
def check(file: File, unit: Unit = "ms", as_json: Json = False) -> None:
    """Check declarations, and print them in canonical form."""
    from .recordings import rehearsal

    rehearsal.check(file, unit, as_json=as_json)


Recordings = Annotated[
    list[str],
    typer.Argument(
        help="A flight log, a table named like its source, NAME=FILE, or a folder of them.",
        metavar="RECORDING...",
    ),
]
Modules = Annotated[
    list[str] | None,
    typer.Option(
        "--processes", help="A module or .py file with computational units. May be repeated."
    ),
]
TimeUnit = Annotated[
    str | None,
    typer.Option(
        help="Unit of numeric times in tables: s, ms, us, ns. Default: by their magnitude; small "
        "ones have the unit of the text's integers."
    ),
]
Sorted = Annotated[
    bool,
    typer.Option(
        "--sort",
        help="Sort tables by time. Default: in the order of their rows, which policies may check.",
    ),
]
Ssl = Annotated[
    str | None,
    typer.Option(
        help="Annotation of the sources, SSL text or its file: policies then hold for each object "
        "separately."
    ),
]


@kpl.command()
def prove(
    file: File,
    recording: Recordings,
    ssl: Ssl = None,
    processes: Modules = None,
    unit: Unit = "ms",
    time_column: TimeColumn = None,
    time_unit: TimeUnit = None,
    time_format: TimeFormat = None,
    delimiter: Delimiter = None,
    sort: Sorted = False,
    as_json: Json = False,
) -> None:
    """Replay a recording and prove each policy, join and sync against its definition.

    Status 1 if one does not hold, or if nothing was proved. "as recorded" reports whether the
    recording itself satisfies the policy, and its first violation.
    """
    from .recordings import rehearsal

    tables = table_options(time_column, time_unit, time_format, delimiter)
    recorded = rehearsal.Recorded(file, recording, ssl, processes, unit, tables, sort)
    rehearsal.prove(recorded, as_json=as_json)


@kpl.command()
def run(
    file: File,
    recording: Recordings,
    stream: Annotated[
        list[str] | None,
        typer.Option(
            help="A stream, label or source. Default: all declared streams. May be repeated."
        ),
    ] = None,
    ssl: Ssl = None,
    processes: Modules = None,
    unit: Unit = "ms",
    time_column: TimeColumn = None,
    time_unit: TimeUnit = None,
    time_format: TimeFormat = None,
    delimiter: Delimiter = None,
    sort: Sorted = False,
    as_json: Json = False,
) -> None:
    """Replay a recording and print the samples of the declared streams, by available time.

    With --json one per line, in the form for publishing.
    """
    from .recordings import rehearsal

    tables = table_options(time_column, time_unit, time_format, delimiter)
    recorded = rehearsal.Recorded(file, recording, ssl, processes, unit, tables, sort)
    rehearsal.run(recorded, stream, as_json=as_json)


@kpl.command()
def add(
    source: Annotated[str, typer.Argument(help="KPL text, its file, or - .")],
    unit: Unit = "ms",
    url: Url = DEFAULT_URL,
    as_json: Json = False,
) -> None:
    """Declare processes and streams in a running service."""
    text = text_or_file(source)
    with connect(url) as client:
        found = client.declare_kpl(text, unit)
    if as_json:
        show_lines(found)
        return
    for declaration in found:
        show_text(declaration["text"])
    if not found:
        show_text("nothing new: an equal declaration exists for each")


@kpl.command()
def show(
    name: Annotated[str | None, typer.Argument(help="A name or label. Default: all.")] = None,
    url: Url = DEFAULT_URL,
    as_json: Json = False,
) -> None:
    """Print the declarations of a running service, or the details of one."""
    with connect(url) as client:
        if name is not None:
            one = client.kpl_declaration(name)
            if as_json:
                show_json(one)
            else:
                _show_one(one)
            return
        found = client.kpl()
    if as_json:
        show_lines(found)
    elif found:
        show_text("\n".join(declaration["text"] for declaration in found))
    else:
        show_text("nothing is declared yet: dyknow kpl add FILE")


@kpl.command()
def remove(
    name: Annotated[str, typer.Argument(help="A name or label.")],
    cascade: Annotated[
        bool, typer.Option("--cascade", help="Remove the declarations that depend on it, too.")
    ] = False,
    url: Url = DEFAULT_URL,
    as_json: Json = False,
) -> None:
    """Stop and remove a declaration in a running service."""
    with connect(url) as client:
        removed = client.remove_kpl(name, cascade=cascade)
    if as_json:
        show_json({"removed": removed})
    else:
        show_text(f"removed {', '.join(removed)}")


def _show_one(one: dict[str, Any]) -> None:
    show_text(one["text"])
    rows = [
        ("stream", one["stream"]),
        ("unit", one["unit"]),
        ("uses", ", ".join(one["uses"])),
        ("used by", ", ".join(one["used_by"])),
        ("failure", one["failure"]),
        ("errors", one["errors"] or None),
        ("restarts", one["restarts"] or None),
        ("last error", one["last_error"]),
        ("violations", one["violations"]),
        *_counted(one["counters"]),
    ]
    show_table(["", ""], [(key, str(value)) for key, value in rows if value], empty="")


def _counted(counters: dict[str, Any]) -> list[tuple[str, str]]:
    """Return counters as rows; dropped samples by reason."""
    rows = []
    for key, value in counters.items():
        if isinstance(value, dict):
            rows += [(f"{key}: {reason}", str(count)) for reason, count in value.items()]
        else:
            rows.append((key, str(value)))
    return rows
