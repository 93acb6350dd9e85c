"""Recorded tables as streams: CSV, NDJSON, Arrow and Parquet, for ``dyknow replay``.

The valid time is the time column. The available time is the ``available`` column if there is one,
else the valid time. A row that steps back in time becomes available with the row before it; rows of
one time are one instant (SPEC §1).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np

from ...streams.sample import (
    Column,
    Field,
    FieldType,
    SampleBatch,
    SampleError,
    Schema,
    Times,
    column_from_values,
)
from ...streams.string_pool import StringPool
from ...streams.time import TIME_MIN
from ..arrow.parquet import read_parquet
from ..arrow.stream import (
    arrow_field_type,
    column_from_arrow,
    read_arrow,
    times_from_arrow,
)
from ..csv_table import CHUNK, TextChunk, column_from_cells
from ..errors import EmptyTable, WireError
from ..inference import TextColumnType, TimeReader, time_column
from ..ndjson_errors import object_of
from ..ndjson_lines import json_type
from ..rounding import EXACT, Spelled, Tally, has_small, rounded_rows
from ..wire import Incoming
from .csv_dialect import WITH_COMMAS, DecimalCommas, with_points
from .table_options import GUESSED, TableOptions
from .text_files import csv_delimiter, read_csv, read_lines

CSV: Final = (".csv",)
NDJSON: Final = (".ndjson", ".jsonl")
ARROW: Final = (".arrow", ".arrows", ".feather")
PARQUET: Final = (".parquet", ".pq")

ValueChunk = tuple[list[int], list[dict[str, Any]]]
_SPELLED: Final = msgspec.json.Decoder(dict[str, Any], float_hook=Spelled.read)


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """A table after a first pass: its fields, its number of rows, and the function that reads it.

    Iteration reads the table from the start, in chunks, in the table's order; the text columns of
    all chunks share ``pools``. It raises `WireError` with the line.
    """

    schema: Schema
    rows: int
    pools: dict[str, StringPool]
    read: Callable[[], Iterator[SampleBatch]] = field(repr=False)
    """Read the rows with the times of the table, valid times in place of missing available ones."""
    has_available: bool = False
    """Whether the table has available times."""
    time_column: str = ""
    """The column of the valid times."""
    rounding: Tally = field(default_factory=Tally, repr=False)
    """Which numbers float fields have rounded, as far as it was read."""
    is_rdf: bool = False
    """Whether its rows are statements of RDF."""
    read_times: Callable[[], Iterator[Times]] | None = field(default=None, repr=False)
    """Read the available times alone, which costs less; None: they come with the rows."""

    def available_times(self) -> Iterator[Times]:
        """The times of `read` by which rows become available, in chunks."""
        if self.read_times is not None:
            return self.read_times()
        return (batch.available for batch in self.read())

    @property
    def out_of_order_effect(self) -> str:
        """What becomes of rows that are taken out of order."""
        if self.has_available:
            return (
                "each comes after a later available time:\n"
                "      it is late where the lateness of the stream is shorter"
            )
        return (
            "each becomes available just after the row above it;\n"
            "      windows take such rows at that time"
        )

    def __iter__(self) -> Iterator[Incoming]:
        last = TIME_MIN
        for batch in self.read():
            if not self.has_available:
                batch = batch.with_available(running_maximum(batch.valid, last))
            if len(batch):
                last = int(batch.available[-1])
                yield Incoming(batch, False)


def open_recording(
    path: Path | str,
    options: TableOptions = GUESSED,
    types: Mapping[str, FieldType] | None = None,
    pools: dict[str, StringPool] | None = None,
) -> Recording:
    """Infer fields and times of the table at ``path``: ``.csv .ndjson .arrow .parquet``.

    ``types`` of fields: default by their values (CSV: columns named like identifiers stay text).
    ``pools`` encode text.

    Raises `WireError` with the line, `OSError` if the file cannot be read.
    Cost: it reads the file twice, CSV with semicolons three times. Memory: a chunk of rows, and
    every distinct text; of Arrow and Parquet all.
    """
    path = Path(path)
    name = path.name.lower().removesuffix(".gz")
    if path.is_fifo():
        raise WireError(
            None,
            f"{path.name} is a pipe, and a recording is read several times",
            "write it to a file first: then its rows are counted and sorted by time",
        )
    pools = {} if pools is None else pools
    wanted, times = options.time_column, options.times()
    if name.endswith(CSV):
        mark = options.delimiter or csv_delimiter(path)
        return open_cells(lambda: read_csv(path, mark), mark, wanted, times, types or {}, pools)
    if name.endswith(NDJSON):
        return open_rows(lambda: decode_rows(read_lines(path)), wanted, times, types, pools)
    if name == path.name.lower():
        if name.endswith(ARROW):
            return _of_arrow(read_arrow(path), wanted, times, types or {}, pools)
        if name.endswith(PARQUET):
            return _of_arrow(read_parquet(path), wanted, times, types or {}, pools)
    raise WireError(
        None,
        f"{path.name}: unknown kind of table",
        "recordings end in .csv, .ndjson, .arrow or .parquet",
    )


def open_cells(
    cells_again: Callable[[], Iterator[TextChunk]],
    delimiter: str,
    wanted: str | None,
    times: TimeReader,
    types: Mapping[str, FieldType],
    pools: dict[str, StringPool],
) -> Recording:
    """The recording of a table's cells; each call of ``cells_again`` returns them from the start.

    Other arguments and errors as for `open_recording`, with one unit of time.
    """
    commas = _decimal_commas(cells_again) if delimiter == WITH_COMMAS else frozenset()
    commas -= {name for name, type in types.items() if type is FieldType.STRING}

    def chunks() -> Iterator[TextChunk]:
        for lines, cells in cells_again():
            yield lines, {n: with_points(c) if n in commas else c for n, c in cells.items()}

    observed: dict[str, TextColumnType] = {}
    valid, count = "", 0
    for lines, cells in chunks():
        if not observed:
            valid = time_column(list(cells), wanted)
            observed = {name: TextColumnType(name) for name in cells}
        count += len(lines)
        for name, column in observed.items():
            if name in (valid, "available"):
                times.observe(cells[name])
            else:
                column.observe(cells[name])
    if not count:
        raise EmptyTable(1, "the table has no rows")
    clocks = (valid, "available")
    schema = _schema([(n, c.type) for n, c in observed.items() if n not in clocks], types)
    _make_pools(schema, pools)
    stamped_column = "available" in observed and valid != "available"

    tally = Tally()

    def read() -> Iterator[SampleBatch]:
        rounded = None
        for lines, cells in chunks():
            valid_times = times.read(cells[valid], lines, valid)
            available = valid_times
            if stamped_column:
                available = times.read(cells["available"], lines, "available")
            columns = {
                f.name: column_from_cells(f, cells[f.name], lines, pools.get(f.name))
                for f in schema.fields
            }
            batch = SampleBatch(available, valid_times, columns)
            rounded = tally.count(rounded, cells, lines, batch)
            yield batch

    def read_times() -> Iterator[Times]:
        name = "available" if stamped_column else valid
        return (times.read(cells[name], lines, name) for lines, cells in chunks())

    # What cannot be read is told before the first row is used.
    are_read = all(_reads(f.type, observed[f.name]) for f in schema.fields)
    times_alone = read_times if are_read else None
    return Recording(
        schema, count, pools, read, stamped_column, valid, tally, read_times=times_alone
    )


def _reads(wanted: FieldType, found: TextColumnType) -> bool:
    """Whether each cell of a column is surely one of the type wanted."""
    if wanted is FieldType.FLOAT:
        return found.type in (FieldType.FLOAT, FieldType.INTEGER) and not found.may_overflow
    return wanted in (found.type, FieldType.STRING)


def _decimal_commas(cells_again: Callable[[], Iterator[TextChunk]]) -> AbstractSet[str]:
    """The columns of numbers with a decimal comma."""
    commas = DecimalCommas()
    for chunk in cells_again():
        commas.observe(chunk)
    return commas.columns()


def open_rows(
    rows_again: Callable[[], Iterator[ValueChunk]],
    wanted: str | None,
    times: TimeReader,
    types: Mapping[str, FieldType] | None,
    pools: dict[str, StringPool],
) -> Recording:
    """The recording of rows of named values; each call of ``rows_again`` returns them from the
    start.

    Tables of one file may share ``times``, which fixes its unit at the first iteration. Raises
    `WireError` with the line.
    """
    seen: dict[str, set[type]] = {}
    with_available = count = 0
    for _, rows in rows_again():
        for row in rows:
            for name, value in row.items():
                seen.setdefault(name, set()).add(type(value))
        with_available += sum("available" in row for row in rows)
        count += len(rows)
    if not count:
        raise EmptyTable(None, "the table has no rows")
    valid = time_column(list(seen), wanted)
    stamped_column = "available" in seen and valid != "available"
    if stamped_column and with_available != count:
        raise WireError(None, "'available' is in some samples and not in others")
    clocks = (valid, "available")
    for _, rows in rows_again():
        for clock in clocks:
            times.observe(row.get(clock) for row in rows)
    kinds = {n: {float if kind is Spelled else kind for kind in t} for n, t in seen.items()}
    schema = _schema([(n, json_type(t)) for n, t in kinds.items() if n not in clocks], types or {})
    _make_pools(schema, pools)

    tally = Tally()

    def read() -> Iterator[SampleBatch]:
        rounded = None
        for lines, rows in rows_again():
            valid_times = times.read([row.get(valid) for row in rows], lines, valid)
            available = valid_times
            if stamped_column:
                given = [row["available"] for row in rows]
                available = times.read(given, lines, "available")
            values = {f.name: [row.get(f.name) for row in rows] for f in schema.fields}
            columns = {f.name: _json_column(f, values[f.name], lines, pools) for f in schema.fields}
            batch = SampleBatch(available, valid_times, columns)
            rounded = tally.count(rounded, values, lines, batch)
            yield batch

    return Recording(schema, count, pools, read, stamped_column, valid, tally)


def _of_arrow(
    table: Any,
    wanted: str | None,
    times: TimeReader,
    types: Mapping[str, FieldType],
    pools: dict[str, StringPool],
) -> Recording:
    if not table.num_rows:
        raise EmptyTable(None, "the table has no rows")
    valid = time_column(table.column_names, wanted)
    stamped_column = "available" in table.column_names and valid != "available"
    valid_times = times_from_arrow(table.column(valid), valid, times)
    available = valid_times
    if stamped_column:
        available = times_from_arrow(table.column("available"), "available", times)
    clocks = (valid, "available")
    schema = _schema(
        [
            (name, arrow_field_type(name, table.column(name).type))
            for name in table.column_names
            if name not in clocks
        ],
        types,
    )
    columns = {f.name: column_from_arrow(f, table.column(f.name), pools) for f in schema.fields}
    whole = SampleBatch(available, valid_times, columns)
    tally = Tally(rounded_rows({name: table.column(name) for name in columns}, whole))

    def read() -> Iterator[SampleBatch]:
        for start in range(0, len(whole), CHUNK):
            yield whole.take(slice(start, start + CHUNK))

    return Recording(schema, len(whole), pools, read, stamped_column, valid, tally)


def decode_rows(numbered: Iterable[tuple[int, bytes]]) -> Iterator[ValueChunk]:
    """Line numbers and objects in chunks; raises `WireError` with the line."""
    lines: list[int] = []
    rows: list[dict[str, Any]] = []
    for number, line in numbered:
        lines.append(number)
        rows.append(_decode_line(number, line))
        if len(rows) == CHUNK:
            yield lines, rows
            lines, rows = [], []
    if rows:
        yield lines, rows


def _decode_line(number: int, line: bytes) -> dict[str, Any]:
    row = object_of(line, number)
    may_be_rounded = has_small(line)
    for name, value in row.items():
        if isinstance(value, list | dict | msgspec.Raw):
            raise WireError(number, f"field {name!r} is nested: values are plain")
        if type(value) is float and not -EXACT < value < EXACT:
            may_be_rounded = True
    return _SPELLED.decode(line) if may_be_rounded else row


def _json_column(
    field: Field, values: list[Any], lines: Sequence[int], pools: Mapping[str, StringPool]
) -> Column:
    if field.type is FieldType.STRING:
        values = [v if v is None or isinstance(v, str) else _json_text(v) for v in values]
    try:
        return column_from_values(field, values, pools.get(field.name))
    except SampleError as error:
        line = None if error.row is None else lines[error.row]
        raise WireError(line, str(error)) from None


def _json_text(value: object) -> str:
    return msgspec.json.encode(float(value) if isinstance(value, Spelled) else value).decode()


def _schema(found: Sequence[tuple[str, FieldType]], types: Mapping[str, FieldType]) -> Schema:
    names = [name for name, _ in found]
    for name in types:
        if name not in names:
            raise WireError(None, f"there is no column {name!r}", f"fields: {', '.join(names)}")
    return Schema(tuple(Field(name, types.get(name, type)) for name, type in found))


def _make_pools(schema: Schema, pools: dict[str, StringPool]) -> None:
    for f in schema.fields:
        if f.type is FieldType.STRING:
            pools.setdefault(f.name, StringPool())


def running_maximum(times: Times, last: int) -> Times:
    """The running maximum of ``times``, from ``last`` on."""
    return np.maximum.accumulate(np.maximum(times, last))
