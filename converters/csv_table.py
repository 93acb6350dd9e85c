"""Samples as CSV: batches out, tables in (RFC 4180; an empty cell is no_value)."""

from __future__ import annotations

import csv
import gzip
import io
import re
import zlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import accumulate, islice
from operator import not_
from typing import Any, Final

import numpy as np

from ..streams.sample import Column, Field, FieldType, SampleBatch
from ..streams.string_pool import StringPool
from .errors import EmptyTable, WireError
from .inference import TRUTH
from .wire import format_times, text_column

CONTENT_TYPE = "text/csv"
CHUNK = 8192
"""Rows that are read at once, which bounds memory for any table."""

UNPACKING: Final = (EOFError, zlib.error, gzip.BadGzipFile)
"""The exceptions of reading a damaged gzip file."""

_LINE_END: Final = re.compile(r"\r\n|\r|\n").findall
TextChunk = tuple[Sequence[int], dict[str, Sequence[str]]]
"""Line numbers and the cells of each column."""


def encode_csv(batch: SampleBatch, *, header: bool = True) -> bytes:
    """Write ``available,valid,<fields>`` and a row a sample: times in ISO-8601, no_value empty."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    if header:
        writer.writerow(["available", "valid", *batch.columns])
    times = [format_times(batch.available), format_times(batch.valid)]
    columns = [_cells(column) for column in batch.columns.values()]
    writer.writerows(zip(*times, *columns, strict=True))
    return text.getvalue().encode()


def read_csv_lines(
    lines: Iterable[str], delimiter: str = ",", ends: Callable[[], bool] | None = None
) -> Iterator[TextChunk]:
    """The table's cells in chunks of rows; a chunk also ends after a row for which ``ends`` returns
    True.

    Raises `WireError` with the line for a row of the wrong length, bad quoting or bytes that are no
    UTF-8, and for a table without header.
    """
    reader = csv.reader(lines, strict=True, delimiter=delimiter)
    try:
        names = next(reader, [])
        if not any(names) and not any(any(row) for row in reader):
            raise EmptyTable(1, "the table is empty", "its first line names the columns")
        _check_header(names)
        while True:
            numbers, rows = _chunk(reader, ends)
            if not rows:
                return
            yield _columns(names, numbers, rows)
    except (csv.Error, UnicodeDecodeError, *UNPACKING) as error:
        raise WireError(reader.line_num + 1, f"the table cannot be read: {error}") from error


def _chunk(reader: Any, ends: Callable[[], bool] | None) -> tuple[Sequence[int], list[list[str]]]:
    """Rows, and the line at which each ends."""
    before = reader.line_num
    if ends is None:
        rows = list(islice(reader, CHUNK))
        if reader.line_num - before == len(rows):
            return range(before + 1, before + 1 + len(rows)), rows
        # A quoted cell may have several lines.
        return list(accumulate((_line_count(row) for row in rows), initial=before))[1:], rows
    lines, rows = [], []
    for row in islice(reader, CHUNK):
        lines.append(reader.line_num)
        rows.append(row)
        if ends():
            break
    return lines, rows


def _line_count(row: Sequence[str]) -> int:
    return 1 + sum(len(_LINE_END(cell)) for cell in row)


def column_from_cells(
    field: Field, cells: Sequence[str], lines: Sequence[int], pool: StringPool | None
) -> Column:
    """A column from its cells; raises `WireError` with the line."""
    empty = "" in cells
    null = np.fromiter(map(not_, cells), np.bool_, len(cells)) if empty else None
    if field.type is FieldType.STRING:
        assert pool is not None
        return text_column([cell or None for cell in cells], pool, null)
    parse = _PARSERS[field.type]
    try:
        # Only Python reads 1_000 as a number.
        if "_" in "".join(cells):
            raise ValueError
        told = map(parse, cells) if not empty else (parse(c) if c else 0 for c in cells)
        values = np.fromiter(told, field.type.dtype, len(cells))
        if field.type is not FieldType.FLOAT or np.isfinite(values).all():
            return Column(field.type, values, null)
    except (ValueError, KeyError, OverflowError):
        pass  # the loop below finds the line
    for cell, line in zip(cells, lines, strict=True):
        if cell and not _fits(field.type, cell):
            raise WireError(
                line,
                f"column {field.name!r} is {field.type}, got {cell!r}",
                "an empty cell is no value",
            )
    raise AssertionError("a column that cannot be read has a cell that cannot")


def _cells(column: Column) -> list[Any]:
    values = column.tolist()
    if column.type is FieldType.BOOLEAN:
        return [None if value is None else str(value).lower() for value in values]
    return values


def _check_header(names: Sequence[str]) -> None:
    if not names:
        raise WireError(1, "the first line is empty", "the first line names the columns")
    for i, name in enumerate(names):
        if not name:
            raise WireError(1, f"column {i + 1} has no name", "the first line names the columns")
        if name in names[:i]:
            raise WireError(1, f"column {name!r} is there twice")


def _columns(names: Sequence[str], lines: Sequence[int], rows: Sequence[list[str]]) -> TextChunk:
    if not all(rows):  # a blank line is no row
        kept = [i for i, row in enumerate(rows) if row]
        lines, rows = [lines[i] for i in kept], [rows[i] for i in kept]
    if not rows:
        return [], dict.fromkeys(names, ())
    if set(map(len, rows)) != {len(names)}:
        wrong = next(i for i, row in enumerate(rows) if len(row) != len(names))
        raise WireError(
            lines[wrong],
            f"{len(rows[wrong])} cells, but the header has {len(names)}",
            "--delimiter names the character between cells",
        )
    return lines, dict(zip(names, zip(*rows, strict=True), strict=True))


_PARSERS: dict[FieldType, Callable[[str], Any]] = {
    FieldType.FLOAT: float,
    FieldType.INTEGER: int,
    FieldType.BOOLEAN: TRUTH.__getitem__,
}


def _fits(type: FieldType, cell: str) -> bool:
    try:
        value = _PARSERS[type](cell)
        return "_" not in cell and bool(np.isfinite(np.array(value, type.dtype)))
    except (ValueError, KeyError, OverflowError):
        return False
