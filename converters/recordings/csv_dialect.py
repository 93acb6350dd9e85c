"""Dialects of CSV: which character separates cells, and whether numbers have a decimal comma.

`detect_delimiter` reads the header only, so that a pipe and a file are read alike. A decimal comma
is looked for in tables with semicolons, where spreadsheets write it. `DecimalCommas` follows the
cells of all columns: one table has one decimal mark, and a table that leaves it open is an error.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Iterable, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass
from typing import Final

from ..csv_table import TextChunk
from ..errors import WireError
from ..inference import names_objects

DELIMITERS: Final = {",": ",", ";": ";", "\t": "tab", "|": "|"}
"""The characters that are looked for, and how ``--delimiter`` names them."""
WITH_COMMAS: Final = ";"
"""The delimiter of tables that may have decimal commas."""

_EXPONENT = r"(?:[eE][+-]?\d+)?"
# Leading zeros and more digits than 64 bits hold make a column text (`TextColumnType`).
_INTEGER = re.compile(r"[+-]?(?:0|[1-9]\d{0,17})", re.ASCII).fullmatch
_COMMA = re.compile(rf"[+-]?(?:0|[1-9]\d*)?,\d+{_EXPONENT}", re.ASCII).fullmatch
_POINT = re.compile(rf"[+-]?(?:0|[1-9]\d*)?\.\d+{_EXPONENT}", re.ASCII).fullmatch
_THOUSANDS = re.compile(r"[+-]?[1-9]\d{0,2},\d{3}", re.ASCII).fullmatch


def detect_delimiter(header: str) -> str:
    """The delimiter that cuts ``header`` into the most columns; a comma if none cuts it.

    Raises `WireError` if two cut it into equally many.
    """
    counts = {one: _columns(header, one) for one in DELIMITERS}
    most = max(counts.values())
    best = [one for one, count in counts.items() if count == most]
    if most <= 1:
        return ","
    if len(best) > 1:
        raise WireError(
            1,
            f"{' and '.join(repr(one) for one in best)} both cut the header into {most} columns",
            f"name the delimiter: {' or '.join(f'--delimiter {DELIMITERS[b]!r}' for b in best)}",
        )
    return best[0]


def delimiter_of(text: str) -> str:
    """The delimiter that a user names: a character, or ``tab``. Raises `ValueError`."""
    found = "\t" if text in ("tab", r"\t") else text
    if len(found) != 1 or found in '"\r\n':
        raise ValueError(f"a delimiter is one character, or tab, and not {text!r}")
    return found


def with_points(cells: Iterable[str]) -> Sequence[str]:
    """The cells of a column with decimal commas, as numbers with a decimal point."""
    return [cell.replace(",", ".") for cell in cells]


class DecimalCommas:
    """Follows the cells of a table, and finds the columns of numbers with a decimal comma."""

    def __init__(self) -> None:
        self._columns: dict[str, _Numbers] = {}

    def observe(self, chunk: TextChunk) -> None:
        """Look at more rows."""
        lines, cells = chunk
        for name, values in cells.items():
            if not names_objects(name):
                self._columns.setdefault(name, _Numbers()).observe(lines, values)

    def columns(self) -> AbstractSet[str]:
        """The columns with decimal commas.

        Raises `WireError` with the column if the table has decimal points, too, or if every comma
        may separate thousands.
        """
        numbers = {name: column for name, column in self._columns.items() if column.all_fit}
        commas = {name: column for name, column in numbers.items() if column.comma is not None}
        if not commas:
            return frozenset()
        name, column = next(iter(commas.items()))
        assert column.comma is not None
        line, cell = column.comma
        for other, its in numbers.items():
            if its.point is not None:
                raise WireError(
                    line,
                    f"column {name!r} has {cell!r}, with a comma, and column {other!r} has "
                    f"{its.point[1]!r}, with a point, in line {its.point[0]}",
                    "write all numbers of a table with the same decimal mark",
                )
        if not any(column.is_definite for column in commas.values()):
            raise WireError(
                line,
                f"column {name!r}: {cell!r} may be {cell.replace(',', '.')} or "
                f"{cell.replace(',', '')}",
                "write it with a decimal point, or without the comma",
            )
        return commas.keys()


@dataclass(slots=True)
class _Numbers:
    """A column, as far as it was read. ``comma`` and ``point``: the first cell with one, and its
    line. ``is_definite``: a comma of it cannot separate thousands."""

    all_fit: bool = True
    is_definite: bool = False
    comma: tuple[int, str] | None = None
    point: tuple[int, str] | None = None

    def observe(self, lines: Sequence[int], cells: Sequence[str]) -> None:
        if not self.all_fit:
            return
        for line, cell in zip(lines, cells, strict=True):
            if not cell or _INTEGER(cell):
                continue
            if _COMMA(cell):
                self.comma = self.comma or (line, cell)
                self.is_definite = self.is_definite or not _THOUSANDS(cell)
            elif _POINT(cell):
                self.point = self.point or (line, cell)
            else:
                self.all_fit = False
                return


def _columns(header: str, delimiter: str) -> int:
    try:
        cells = next(csv.reader([header], delimiter=delimiter), [])
    except csv.Error:  # a cell that is too long: the reader of the table says so
        return 1
    # A delimiter that cuts through quotation marks is none.
    return 1 if any('"' in cell for cell in cells) else len(cells)
