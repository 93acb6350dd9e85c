"""Samples as CSV: batches out, tables in (RFC 4180; an empty cell is no_value)."""

from __future__ import annotations

import csv
import gzip
import io
import zlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import islice
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

TextChunk = tuple[list[int], dict[str, Sequence[str]]]
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
        while rows := _chunk(reader, ends):
            yield _columns(names, rows)
    except (csv.Error, UnicodeDecodeError, *UNPACKING) as error:
        raise WireError(reader.line_num + 1, f"the table cannot be read: {error}") from error


def _chunk(reader: Any, ends: Callable[[], bool] | None) -> list[tuple[int, list[str]]]:
    rows = []
    for row in islice(reader, CHUNK):
        rows.append((reader.line_num, row))
        if ends is not None and ends():
            break
    return rows


def column_from_cells(
    field: Field, cells: Sequence[str], lines: Sequence[int], pool: StringPool | None
) -> Column:
    """A column from its cells; raises `WireError` with the line."""
    empty = "" in cells
    null = np.fromiter((cell == "" for cell in cells), np.bool_, len(cells)) if empty else None
    if field.type is FieldType.STRING:
        assert pool is not None
        return text_column([cell or None for cell in cells], pool, null)
    parse = _PARSERS[field.type]
    try:
        values = np.array([parse(cell) if cell else 0 for cell in cells], field.type.dtype)
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


def _columns(names: Sequence[str], rows: list[tuple[int, list[str]]]) -> TextChunk:
    kept = [(line, row) for line, row in rows if row]  # a blank line is no row
    for line, row in kept:
        if len(row) != len(names):
            raise WireError(
                line,
                f"{len(row)} cells, but the header has {len(names)}",
                "--delimiter names the character between cells",
            )
    cells = zip(*(row for _, row in kept), strict=True) if kept else [()] * len(names)
    return [line for line, _ in kept], dict(zip(names, cells, strict=True))


def _float(cell: str) -> float:
    if "_" in cell:  # only Python reads 1_000 as a number
        raise ValueError(cell)
    return float(cell)


def _integer(cell: str) -> int:
    if "_" in cell:
        raise ValueError(cell)
    return int(cell)


_PARSERS: dict[FieldType, Callable[[str], Any]] = {
    FieldType.FLOAT: _float,
    FieldType.INTEGER: _integer,
    FieldType.BOOLEAN: TRUTH.__getitem__,
}


def _fits(type: FieldType, cell: str) -> bool:
    try:
        value = _PARSERS[type](cell)
        return bool(np.isfinite(np.array(value, type.dtype)))
    except (ValueError, KeyError, OverflowError):
        return False
