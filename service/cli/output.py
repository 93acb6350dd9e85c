"""What all commands share: where the service is, tables for people, JSON for programs, errors."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.cells import cell_len
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from ...streams.time import (
    DAY,
    HOUR,
    MICROSECOND,
    MILLISECOND,
    MINUTE,
    SECOND,
    parse_duration,
)
from ..config.defaults import URL

if TYPE_CHECKING:
    from ..client.client import Client

Url = Annotated[
    str, typer.Option("--url", envvar="DYKNOW_URL", help="Where the service is.", metavar="URL")
]
Json = Annotated[bool, typer.Option("--json", help="JSON for programs, a value a line.")]
DEFAULT_URL = URL
JSON_WANTED: ContextVar[bool] = ContextVar("JSON_WANTED", default=False)
"""Whether the command that runs was given ``--json``: errors are then JSON, too."""
TOKEN_GIVEN: ContextVar[str | None] = ContextVar("TOKEN_GIVEN", default=None)
"""What the command that runs was given as ``--token``."""
_UNITS = (
    ("d", DAY),
    ("h", HOUR),
    ("min", MINUTE),
    ("s", SECOND),
    ("ms", MILLISECOND),
    ("us", MICROSECOND),
)


def connect(url: str) -> Client:
    """A client of the service at ``url``, with the token that the command was given."""
    from ..client.client import Client

    return Client(url, token=TOKEN_GIVEN.get())


@contextmanager
def unless_gone() -> Iterator[None]:
    """For what is given up at the end: the service may be gone already, and what it was asked for
    with it."""
    import httpx

    from ..client.connection import ServiceError

    with suppress(ServiceError, httpx.TransportError):
        yield


def out() -> Console:
    """The console of results. Made anew each time: tests and pipes exchange standard output."""
    return Console(file=sys.stdout, highlight=False, emoji=False, soft_wrap=True)


def err() -> Console:
    """The console of progress and errors."""
    return Console(file=sys.stderr, highlight=False, emoji=False, soft_wrap=True)


def show_json(value: object) -> None:
    """One value as one line of JSON."""
    print(json.dumps(value, ensure_ascii=False), flush=True)


def show_lines(values: Iterable[object]) -> None:
    """A line of JSON a value."""
    for value in values:
        show_json(value)


def show_text(text: str) -> None:
    """Text as it is: brackets in it are no markup."""
    out().print(text.rstrip("\n"), markup=False)


def show_table(
    columns: Sequence[str],
    rows: Iterable[Sequence[object]],
    *,
    whole: Collection[str] = (),
    empty: str = "",
) -> None:
    """A table for people; numbers stand on the right. ``empty`` is said when there is no row.

    Columns that ``whole`` names are not folded, however narrow the terminal is.
    """
    rows = [list(row) for row in rows]
    if not rows:
        out().print(empty or "nothing", markup=False)
        return
    table = Table(header_style="bold", box=None)
    widths: list[int] = []
    for i, column in enumerate(columns):
        numeric = all(isinstance(row[i], int | float) or row[i] is None for row in rows)
        longest = max(len(column), *(cell_len(_plain(row[i])) for row in rows))
        if column in whole:
            widths.append(longest)
        table.add_column(
            column,
            justify="right" if numeric else "left",
            overflow="fold",
            min_width=longest if column in whole else None,
        )
    for row in rows:
        table.add_row(*(_cell(value) for value in row))
    # A pipe has no width of its own; the table then takes what it needs.
    width = None if sys.stdout.isatty() or "COLUMNS" in os.environ else 10_000
    console = Console(file=sys.stdout, highlight=False, emoji=False, width=width)
    least = sum(widths) + len(columns) * 2 + 6 * (len(columns) - len(widths))
    if widths and console.width < least:
        # What is not folded needs more than there is: the terminal breaks the line, not the name.
        console.width = least
    console.print(table)


def show_values(values: Mapping[str, object]) -> str:
    """``name=value`` for each value there is, as people read it."""
    return "  ".join(f"{name}={_plain(value)}" for name, value in values.items())


def fail(
    message: str, hint: str = "", *, problem: Mapping[str, Any] | None = None, status: int = 1
) -> typer.Exit:
    """Say on standard error what went wrong; raise what is returned.

    Under ``--json`` it is one JSON object: ``problem`` if there is one, else made of the words.
    """
    if JSON_WANTED.get():
        told = {"title": "error", "detail": message, "hint": hint}
        known = {key: value for key, value in (problem or told).items() if value}
        print(json.dumps(known, ensure_ascii=False), file=sys.stderr, flush=True)
        return typer.Exit(status)
    console = err()
    console.print("[bold red]error:[/]", end=" ")
    console.print(message, markup=False)
    if hint:
        console.print(f"hint: {hint}", markup=False)
    return typer.Exit(status)


def clock_of(time: str | None) -> str:
    """A time as people read it in a table: without the day when it is today's."""
    if time is None:
        return ""
    today = datetime.now(UTC).strftime("%Y-%m-%d")
    return time.removeprefix(f"{today}T")


def clock_ms(time: str | None) -> str:
    """The same, to the millisecond."""
    head, dot, digits = clock_of(time).removesuffix("Z").partition(".")
    return f"{head}{dot}{digits[:3]}Z" if head else ""


def brief(duration: str | None) -> str | None:
    """A duration of the service in three digits, for a table: ``1.87d``, ``40ms``."""
    if duration is None:
        return None
    nanoseconds = parse_duration(duration.removeprefix("-"))
    sign = "-" if duration.startswith("-") else ""
    for unit, size in _UNITS:
        if nanoseconds >= size:
            return f"{sign}{nanoseconds / size:.3g}{unit}"
    return f"{sign}{nanoseconds}ns" if nanoseconds else "0"


def _cell(value: Any) -> str:
    return escape(_plain(value))


def _plain(value: object) -> str:
    if value is None:
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, list | tuple):
        return ", ".join(_plain(item) for item in value)
    return str(value)
