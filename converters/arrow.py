"""Samples as an Arrow IPC stream, ``application/vnd.apache.arrow.stream``.

Columns: ``valid`` and, optionally, ``available`` (a timestamp of any unit, or int64 ns), and one a
field. pyarrow is an extra of the installation: `ArrowMissing` says how to get it.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ..streams.sample import TIME_FIELDS, Column, Field, FieldType, SampleBatch, Schema, Times
from ..streams.strings import StringPool
from .errors import WireError
from .inference import TIME_UNITS, TimeReader
from .wire import Incoming, check_names, pool_of

CONTENT_TYPE = "application/vnd.apache.arrow.stream"


class ArrowMissing(WireError):
    """pyarrow is not installed."""

    def __init__(self) -> None:
        super().__init__(None, "Arrow is not installed here", "pip install dyknow[arrow]")


def decode_arrow(data: bytes, schema: Schema, pools: dict[str, StringPool]) -> Incoming:
    """A batch from an IPC stream, taken whole or refused whole (`WireError`, lines are rows).

    Without fields in ``schema`` (an open stream) the table's columns decide them.
    """
    table = _read(data)
    names = table.column_names
    if not schema.fields and len(set(names)) == len(names):
        own = [(name, table.column(name).type) for name in names if name not in TIME_FIELDS]
        schema = Schema(tuple(Field(name, arrow_field_type(name, type)) for name, type in own))
    check_names(schema)
    for name in names:
        if names.count(name) > 1:
            raise WireError(None, f"column {name!r} is there twice")
        if name not in TIME_FIELDS and schema.get(name) is None:
            raise WireError(
                None, f"{name!r} is not declared", f"the fields are {', '.join(schema.names)}"
            )
    for name in ("valid", *schema.names):
        if name not in names:
            raise WireError(None, f"column {name!r} is missing")
    if not table.num_rows:
        raise WireError(None, "the body holds no sample", "send at least one")
    valid = times_from_arrow(table.column("valid"), "valid", TimeReader("ns"))
    stamped = "available" not in names
    available = (
        valid
        if stamped
        else times_from_arrow(table.column("available"), "available", TimeReader("ns"))
    )
    # Text last: the pools grow only when every other column is good.
    text_last = sorted(schema.fields, key=lambda field: field.type is FieldType.STRING)
    found = {
        field.name: column_from_arrow(field, table.column(field.name), pools)
        for field in text_last
        if _expect(field, table.column(field.name))
    }
    columns = {name: found[name] for name in schema.names}
    return Incoming(SampleBatch(available, valid, columns), stamped)


def encode_arrow(batch: SampleBatch) -> bytes:
    """An IPC stream of one record batch; `decode_arrow` gives the batch back."""
    pa = _arrow()
    zoned = pa.timestamp("ns", "UTC")
    arrays = {
        "available": pa.array(batch.available, pa.int64()).cast(zoned),
        "valid": pa.array(batch.valid, pa.int64()).cast(zoned),
    }
    for name, column in batch.columns.items():
        if column.pool is None:
            arrays[name] = pa.array(column.values, mask=column.null)
        else:
            arrays[name] = pa.array(column.tolist(), pa.string())
    table = pa.table(arrays)
    sink = pa.BufferOutputStream()
    with pa.ipc.new_stream(sink, table.schema) as writer:
        writer.write_table(table)
    result: bytes = sink.getvalue().to_pybytes()
    return result


def read_arrow(path: Path) -> Any:
    """A recording's table, from an IPC stream or file."""
    return _read(path.read_bytes())


def arrow_field_type(name: str, type: Any) -> FieldType:
    """The field type that holds an Arrow column; raises `WireError` if none does."""
    pa = _arrow()
    if pa.types.is_boolean(type):
        return FieldType.BOOLEAN
    if pa.types.is_integer(type):
        return FieldType.INTEGER
    if pa.types.is_floating(type):
        return FieldType.FLOAT
    if _is_text(type):
        return FieldType.STRING
    raise WireError(None, f"column {name!r} is {type}", "fields are numbers, booleans and strings")


def times_from_arrow(column: Any, key: str, reader: TimeReader) -> Times:
    """A column of times in ns; plain numbers are in the reader's unit."""
    pa = _arrow()
    if column.null_count:
        row = column.is_null().to_pylist().index(True) + 1
        raise WireError(row, f"{key!r} is missing", "every sample has its times")
    if pa.types.is_timestamp(column.type):
        counts = column.cast(pa.int64()).to_numpy()
        scale = TIME_UNITS[column.type.unit]
        limit = (2**63 - 1) // scale
        outside = (counts > limit) | (counts < -((2**63) // scale))
        if outside.any():
            row = int(np.argmax(outside)) + 1
            raise WireError(row, f"{key!r} is outside signed 64-bit nanoseconds")
        times: Times = counts * np.int64(scale)
        return times
    values = column.to_pylist()
    reader.observe(values)
    return reader.read(values, range(1, len(values) + 1), key)


def column_from_arrow(field: Field, column: Any, pools: dict[str, StringPool]) -> Column:
    """A field's column; raises `WireError` with the row for a value that is none."""
    pa = _arrow()
    null = None
    if column.null_count:
        null = column.is_null().to_numpy()
    if field.type is FieldType.STRING:
        values = column.cast(pa.string()).to_pylist()
        pool = pool_of(field, pools)
        codes = np.fromiter((0 if v is None else pool.code(v) for v in values), np.int32)
        return Column(field.type, codes, null, pool)
    if field.type is FieldType.INTEGER and pa.types.is_uint64(column.type):
        for row, value in enumerate(column.to_pylist(), 1):
            if value is not None and value >= 2**63:
                raise WireError(row, f"field {field.name!r} is outside 64 bits: {value}")
    target = {
        FieldType.FLOAT: pa.float64(),
        FieldType.INTEGER: pa.int64(),
        FieldType.BOOLEAN: pa.bool_(),
    }[field.type]
    filled = column.cast(target, safe=False)
    if null is not None:
        filled = filled.fill_null(False if field.type is FieldType.BOOLEAN else 0)
    values = filled.to_numpy().astype(field.type.dtype)
    if field.type is FieldType.FLOAT and not np.isfinite(values).all():
        row = int(np.argmin(np.isfinite(values)))
        raise WireError(
            row + 1,
            f"field {field.name!r} must be finite, got {values[row]}",
            "send null for no value",
        )
    return Column(field.type, values, null)


def _expect(field: Field, column: Any) -> bool:
    """True if the column can hold the field's values, by type alone; else raises `WireError`."""
    pa = _arrow()
    if pa.types.is_null(column.type):
        return True
    got = arrow_field_type(field.name, column.type)
    if got is not field.type and (got, field.type) != (FieldType.INTEGER, FieldType.FLOAT):
        raise WireError(None, f"field {field.name!r} is {field.type}, got {column.type}")
    return True


def _read(data: bytes) -> Any:
    pa = _arrow()
    if not data:
        raise WireError(None, "the body is empty", "send an Arrow IPC stream")
    is_file = data[:6] == b"ARROW1"
    try:
        opened = pa.ipc.open_file(data) if is_file else pa.ipc.open_stream(data)
        table = opened.read_all()
        table.validate(full=True)
    except (pa.ArrowException, OSError, ValueError, UnicodeDecodeError) as error:
        raise WireError(None, f"no Arrow IPC stream: {error}") from None
    return table


def _is_text(type: Any) -> bool:
    pa = _arrow()
    if pa.types.is_dictionary(type):
        return _is_text(type.value_type)
    return bool(pa.types.is_string(type) or pa.types.is_large_string(type))


def _arrow() -> Any:
    try:
        import pyarrow
    except ImportError:
        raise ArrowMissing from None
    return pyarrow
