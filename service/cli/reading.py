"""Options of the commands that read a continuous query: how, where its text leaves that open."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated

import typer

from ...streams.time import read_time


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


def origin_of(text: str) -> int:
    """The time (ns) of ``--origin``."""
    try:
        return read_time(text)
    except ValueError as error:
        raise typer.BadParameter(f"--origin: {error}") from error
