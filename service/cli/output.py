"""Shared by all commands: the service's address, tables for users, JSON for programs, errors."""

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
from ..config.defaults import ADDRESS, URL

if TYPE_CHECKING:
    from ..client.client import Client

Url = Annotated[
    str, typer.Option("--url", envvar=ADDRESS, help="The service's address.", metavar="URL")
]
Json = Annotated[bool, typer.Option("--json", help="Print JSON, one value per line.")]
DEFAULT_URL = URL
JSON_WANTED: ContextVar[bool] = ContextVar("JSON_WANTED", default=False)
"""Whether the running command has ``--json``: its errors are then JSON, too."""
TOKEN_GIVEN: ContextVar[str | None] = ContextVar("TOKEN_GIVEN", default=None)
"""The value of the running command's ``--token``."""
_UNITS = (
    ("d", DAY),
    ("h", HOUR),
    ("min", MINUTE),
    ("s", SECOND),
    ("ms", MILLISECOND),
    ("us", MICROSECOND),
)


def connect(url: str) -> Client:
    """Return a client of the service at ``url``, with the command's token."""
    from ..client.client import Client

    return Client(url, token=TOKEN_GIVEN.get())


@contextmanager
def ignore_gone() -> Iterator[None]:
    """Ignore errors of a cancellation: the service may have ended already, and the request with
    it."""
    import httpx

    from ..client.connection import ServiceError

    with suppress(ServiceError, httpx.TransportError):
        yield


def out() -> Console:
    """Return the console of results: a new one, since tests and pipes replace standard output."""
    return Console(file=sys.stdout, highlight=False, emoji=False, soft_wrap=True)


def err() -> Console:
    """Return the console of progress and errors."""
    return Console(file=sys.stderr, highlight=False, emoji=False, soft_wrap=True)


def show_json(value: object) -> None:
    """Print a value as one line of JSON."""
    print(json.dumps(value, ensure_ascii=False), flush=True)


def show_lines(values: Iterable[object]) -> None:
    """Print each value as a line of JSON."""
    for value in values:
        show_json(value)


def show_text(text: str) -> None:
    """Print text without interpreting brackets as markup."""
    out().print(text.rstrip("\n"), markup=False)


def show_table(
    columns: Sequence[str],
    rows: Iterable[Sequence[object]],
    *,
    unfolded: Collection[str] = (),
    empty: str = "",
) -> None:
    """Print a table, with numbers aligned right, or the text ``empty`` if there are no rows.

    The columns ``unfolded`` are not folded, however narrow the terminal is: they can be copied.
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
        if column in unfolded:
            widths.append(longest)
        table.add_column(
            column,
            justify="right" if numeric else "left",
            overflow="fold",
            min_width=longest if column in unfolded else None,
        )
    for row in rows:
        table.add_row(*(_cell(value) for value in row))
    # A pipe has no width, so the table takes what it needs.
    width = None if sys.stdout.isatty() or "COLUMNS" in os.environ else 10_000
    console = Console(file=sys.stdout, highlight=False, emoji=False, width=width)
    least = sum(widths) + len(columns) * 2 + 6 * (len(columns) - len(widths))
    if widths and console.width < least:
        # Let the terminal break the line rather than the table a name.
        console.width = least
    console.print(table)


def show_values(values: Mapping[str, object], units: Mapping[str, str] | None = None) -> str:
    """Format values as ``name=value``, numbers with their unit: ``speed=105 km.h-1``."""
    return "  ".join(
        f"{name}={_plain(value)}{_unit_of(name, value, units)}" for name, value in values.items()
    )


def _unit_of(name: str, value: object, units: Mapping[str, str] | None) -> str:
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    return f" {units[name]}" if units and is_number and name in units else ""


def fail(
    message: str, hint: str = "", *, problem: Mapping[str, Any] | None = None, status: int = 1
) -> typer.Exit:
    """Print an error on standard error, and return the exit to raise.

    With ``--json`` it is one JSON object: ``problem`` if there is one, else from the texts.
    """
    if JSON_WANTED.get():
        texts = {"title": "error", "detail": message, "hint": hint}
        members = {key: value for key, value in (problem or texts).items() if value}
        print(json.dumps(members, ensure_ascii=False), file=sys.stderr, flush=True)
        return typer.Exit(status)
    console = err()
    console.print("[bold red]error:[/]", end=" ")
    console.print(message, markup=False)
    if hint:
        console.print(f"hint: {hint}", markup=False)
    return typer.Exit(status)


def clock_of(time: str | None) -> str:
    """Format a time for a table, without the date if it is today's."""
    if time is None:
        return ""
    today = datetime.now(UTC).strftime("%Y-%m-%d")
    return time.removeprefix(f"{today}T")


def clock_ms(time: str | None) -> str:
    """Format a time like `clock_of`, to the millisecond."""
    head, dot, digits = clock_of(time).removesuffix("Z").partition(".")
    return f"{head}{dot}{digits[:3]}Z" if head else ""


def brief(duration: str | None) -> str | None:
    """Format a duration of the service with three digits: ``1.87d``, ``40ms``."""
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
