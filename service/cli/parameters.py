"""Options of the commands that read continuous queries and recordings."""

from __future__ import annotations

from enum import StrEnum
from typing import TYPE_CHECKING, Annotated, Final

import typer

from ...streams.time import read_time
from .output import err

if TYPE_CHECKING:
    from ...converters.recordings.time_order import TimeOrder


class SemanticsWord(StrEnum):
    """Whether a window holds each timed triple, or each triple once."""

    BAG = "bag"
    SET = "set"


class BoundsWord(StrEnum):
    """Which end of a window belongs to it."""

    LATER = "(]"
    EARLIER = "[)"


class ReportWord(StrEnum):
    """Which windows give a result."""

    NON_EMPTY = "non-empty"
    CHANGE = "change"
    CLOSE = "close"


Semantics = Annotated[
    SemanticsWord | None, typer.Option(help="bag or set; else as the language has it.")
]
Bounds = Annotated[
    BoundsWord, typer.Option(help="Windows (end - RANGE, end] or [end - RANGE, end).")
]
Origin = Annotated[
    str, typer.Option(help="Windows end at ORIGIN + k STEP: ISO-8601 or integer ns.")
]
Report = Annotated[
    ReportWord,
    typer.Option(help="Windows that give a result: with content, with other than before, all."),
]

Sort = Annotated[
    bool | None,
    typer.Option(
        "--sort/--no-sort",
        help="Sort tables of samples by time, whatever their size, or leave them; else those of up "
        "to ten million rows are sorted.",
    ),
]


NOW: Final = "now"
"""What comes from now on."""
START: Final = "start"
"""All that is kept."""


def _checked(text: str) -> str:
    if text in (NOW, START):
        return text
    from ...engine.model.beginning import parse_beginning
    from ...engine.model.errors import BadArguments

    try:
        parse_beginning(text)
    except BadArguments as error:
        raise typer.BadParameter(f"{error.detail}: {error.hint}") from error
    return text


Beginning = Annotated[
    str,
    typer.Option(
        help="Begin with what comes (now), with all that the streams keep (start), at a time, or "
        "so long before the newest sample of them: 30s.",
        metavar="now|start|TIME|DURATION",
        callback=_checked,
    ),
]
"""Where an answer begins."""


def show_order(name: str, order: TimeOrder | None) -> None:
    """Report rows that are out of order."""
    if order is not None and order.note is not None:
        err().print(f"{name}: {order.note}", markup=False, highlight=False)


def origin_of(text: str) -> int:
    """The time (ns) of ``--origin``."""
    try:
        return read_time(text)
    except ValueError as error:
        raise typer.BadParameter(f"--origin: {error}") from error
