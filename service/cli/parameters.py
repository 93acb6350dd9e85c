"""Options of the commands that read continuous queries and recordings."""

from __future__ import annotations

from collections.abc import Iterable
from enum import StrEnum
from typing import TYPE_CHECKING, Annotated, Final

import typer

from ...streams.time import SECOND, read_time
from ..config.media_types import (
    CSV,
    JSON_LD,
    NQUADS,
    NTRIPLES,
    RDF_XML,
    SPARQL_JSON,
    SPARQL_XML,
    TRIG,
    TSV,
    TURTLE,
)
from .output import err, show_text

if TYPE_CHECKING:
    from ...converters.recordings.table_options import TableOptions
    from ...converters.recordings.time_order import TimeOrder


class SemanticsWord(StrEnum):
    """Whether a window has equal timed triples several times, or once."""

    BAG = "bag"
    SET = "set"


class BoundsWord(StrEnum):
    """Whether a window includes its later or its earlier bound."""

    LATER = "(]"
    EARLIER = "[)"


class ReportWord(StrEnum):
    """The windows that give a result."""

    NON_EMPTY = "non-empty"
    CHANGE = "change"
    CLOSE = "close"


class FormatWord(StrEnum):
    """The formats of tables and booleans, then those of graphs."""

    CSV = "csv"
    TSV = "tsv"
    JSON = "json"
    XML = "xml"
    TURTLE = "turtle"
    NTRIPLES = "ntriples"
    JSON_LD = "jsonld"
    RDF_XML = "rdfxml"
    TRIG = "trig"
    NQUADS = "nquads"


MEDIA_TYPES: Final = {
    FormatWord.CSV: CSV,
    FormatWord.TSV: TSV,
    FormatWord.JSON: SPARQL_JSON,
    FormatWord.XML: SPARQL_XML,
    FormatWord.TURTLE: TURTLE,
    FormatWord.NTRIPLES: NTRIPLES,
    FormatWord.JSON_LD: JSON_LD,
    FormatWord.RDF_XML: RDF_XML,
    FormatWord.TRIG: TRIG,
    FormatWord.NQUADS: NQUADS,
}

ResultFormat = Annotated[
    FormatWord | None, typer.Option(help="The format of the results, for programs.")
]
Semantics = Annotated[
    SemanticsWord | None, typer.Option(help="bag or set. Default: the language's.")
]
Bounds = Annotated[
    BoundsWord, typer.Option(help="Windows (end - RANGE, end] or [end - RANGE, end).")
]
Origin = Annotated[
    str, typer.Option(help="Windows end at ORIGIN + k STEP: ISO-8601 or integer ns.")
]
Report = Annotated[
    ReportWord,
    typer.Option(help="Windows that give a result: non-empty ones, changed ones, or all."),
]

Sort = Annotated[
    bool | None,
    typer.Option(
        "--sort/--no-sort",
        help="Sort tables of samples by time, whatever their size, or not. Default: sort those of "
        "up to ten million rows.",
    ),
]


TimeColumn = Annotated[
    str | None,
    typer.Option(
        help="The column of valid times; of RDF the property (IRI). Default: by its name."
    ),
]
TimeUnit = Annotated[
    str | None, typer.Option(help="s, ms, us or ns. Default: by the size of the numbers.")
]
TimeFormat = Annotated[
    str | None,
    typer.Option(
        help="How times are spelled: day-first, or a pattern such as '%d.%m.%Y %H:%M:%S'. "
        "Default: ISO-8601.",
        metavar="day-first|PATTERN",
    ),
]
Delimiter = Annotated[
    str | None,
    typer.Option(
        help="The character between the cells of CSV, or tab. Default: by the header.",
        metavar="CHARACTER",
    ),
]


def table_options(
    time_column: str | None,
    time_unit: str | None,
    time_format: str | None,
    delimiter: str | None,
    abstract_unit: str = "s",
) -> TableOptions:
    """Return the options of tables."""
    from ...converters.recordings.csv_dialect import delimiter_of
    from ...converters.recordings.table_options import TableOptions

    try:
        mark = None if delimiter is None else delimiter_of(delimiter)
    except ValueError as error:
        raise typer.BadParameter(f"--delimiter: {error}") from error
    return TableOptions(time_column, time_unit, time_format, mark, abstract_unit)


NOW: Final = "now"
"""From the next sample on."""
START: Final = "start"
"""From the beginning of the history."""


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
        help="Begin with the next samples (now), with the whole histories (start), at a time, or "
        "a duration before the newest sample: 30s.",
        metavar="now|start|TIME|DURATION",
        callback=_checked,
    ),
]
"""Where the results begin."""


def show_order(name: str, order: TimeOrder | None) -> None:
    """Report rows that are out of order."""
    if order is not None and order.note is not None:
        err().print(f"{name}: {order.note}", markup=False, highlight=False)


def show_losses(dropouts: int | None, lost: int, notes: Iterable[str]) -> None:
    """Print what a recorder has lost (None: it does not say; ``lost`` in ns), and the differences
    from the recorded data."""
    if dropouts:
        show_text(f"dropouts: {dropouts:,}, {lost / SECOND:.3f} s were not logged")
    elif dropouts == 0:
        show_text("dropouts: none")
    for note in notes:
        show_text(f"note: {note}")


def warn_of_annotations(
    annotated: Iterable[str], there: Iterable[str], use: str = "read", effect: str = ""
) -> None:
    """Warn of annotated streams that are not among those ``there``, which are read or played
    (``use``): their names may be wrong. ``effect`` is what becomes of the annotation."""
    used = list(there)
    for name in annotated:
        if name not in used:
            err().print(
                f"warning: the SSL text annotates stream {name!r}, which is not {use}; "
                f"{use}: {', '.join(used)}{effect}",
                markup=False,
            )


def origin_of(text: str) -> int:
    """Parse the time (ns) of ``--origin``."""
    try:
        return read_time(text)
    except ValueError as error:
        raise typer.BadParameter(f"--origin: {error}") from error


def parameters_of(pairs: Iterable[str]) -> dict[str, str]:
    """Return the values of ``--parameter NAME=VALUE`` by their names."""
    found = {}
    for pair in pairs:
        name, equals, value = pair.partition("=")
        if not (name and equals):
            raise typer.BadParameter(f"--parameter is NAME=VALUE, not {pair!r}")
        found[name] = value
    return found
