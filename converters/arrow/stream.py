"""Samples as an Arrow IPC stream, ``application/vnd.apache.arrow.stream``.

Columns: ``valid`` and, optionally, ``available`` (a timestamp of any unit, or int64 ns), and one a
field. pyarrow is an optional dependency: `ArrowMissing` names the command that installs it.
"""

from __future__ import annotations

import io
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...streams.sample import (
    TIME_FIELDS,
    Column,
    Field,
    FieldType,
    Mask,
    SampleBatch,
    Schema,
    Times,
)
from ...streams.string_pool import StringPool
from ...streams.time import TIME_MAX, TIME_MIN
from ..errors import WireError
from ..inference import TIME_UNITS, TimeReader
from ..rounding import rounded_rows
from ..wire import (
    TIME_RANGE_HINT,
    BatchLimits,
    Incoming,
    check_names,
    null_mask,
    pool_of,
    text_column,
)
from .sizes import check_sizes

CONTENT_TYPE = "application/vnd.apache.arrow.stream"


class ArrowMissing(WireError):
    """pyarrow is not installed."""

    def __init__(self) -> None:
        super().__init__(None, "Arrow is not installed here", "pip install 'dyknow[arrow]'")


def decode_arrow(
    data: bytes,
    schema: Schema,
    pools: dict[str, StringPool],
    limits: BatchLimits | None = None,
) -> Incoming:
    """Decode a batch from an IPC stream; an error refuses all of it (`WireError`, lines are rows).

    A ``schema`` without fields belongs to an open stream: the table's columns then decide them. A
    body that declares more than ``limits`` is refused before pyarrow reads it.
    """
    if limits is not None:
        check_sizes(data, limits)
    return samples_of_table(_read(data), schema, pools, limits)


def samples_of_table(
    table: Any,
    schema: Schema,
    pools: dict[str, StringPool],
    limits: BatchLimits | None = None,
) -> Incoming:
    """Decode as `decode_arrow`, from a table; checks the ``limits`` of texts and fields."""
    names = table.column_names
    times = Counter(names)
    if not schema.fields and len(times) == len(names):
        if limits is not None:
            limits.check_fields([name for name in times if name not in TIME_FIELDS])
        own = [(name, table.column(name).type) for name in names if name not in TIME_FIELDS]
        schema = Schema(tuple(Field(name, arrow_field_type(name, type)) for name, type in own))
    check_names(schema)
    for name in names:
        if times[name] > 1:
            raise WireError(None, f"column {name!r} is there twice")
        if name not in TIME_FIELDS and schema.get(name) is None:
            raise WireError(
                None, f"{name!r} is not declared", f"the fields are {', '.join(schema.names)}"
            )
    for name in ("valid", *schema.names):
        if name not in times:
            raise WireError(None, f"column {name!r} is missing")
    if not table.num_rows:
        raise WireError(None, "the body holds no sample", "send at least one")
    valid = times_from_arrow(table.column("valid"), "valid", TimeReader("ns"))
    stamped = "available" not in times
    available = (
        valid
        if stamped
        else times_from_arrow(table.column("available"), "available", TimeReader("ns"))
    )
    # Text last: the pools grow only if every other column is good.
    text_last = sorted(schema.fields, key=lambda field: field.type is FieldType.STRING)
    given = {}
    for field in text_last:
        column = given[field.name] = table.column(field.name)
        _expect(field, column)
        if field.type is FieldType.STRING:
            given[field.name] = _together(column)
            if limits is not None:
                _check_texts(field.name, given[field.name], limits)
    found = {field.name: column_from_arrow(field, given[field.name], pools) for field in text_last}
    columns = {name: found[name] for name in schema.names}
    batch = SampleBatch(available, valid, columns)
    return Incoming(batch, stamped, rounded_rows(given, batch))


def joined(tables: Sequence[Any]) -> Any:
    """Concatenate tables of the same columns."""
    return tables[0] if len(tables) == 1 else pyarrow_module().concat_tables(tables)


def bytes_of_table(table: Any) -> bytes:
    """A table as an IPC stream, for `decode_arrow`."""
    pa = pyarrow_module()
    sink = pa.BufferOutputStream()
    with pa.ipc.new_stream(sink, table.schema) as writer:
        writer.write_table(table)
    found: bytes = sink.getvalue().to_pybytes()
    return found


def encode_arrow(batch: SampleBatch) -> bytes:
    """An IPC stream of one record batch; `decode_arrow` gives the batch back."""
    writer = ArrowWriter()
    return writer.write(batch) + writer.close()


class ArrowWriter:
    """Writes an IPC stream of batches of the same fields, one record batch each."""

    def __init__(self) -> None:
        self._sink = _Sink()
        self._writer: Any = None

    def write(self, batch: SampleBatch) -> bytes:
        """The bytes of ``batch``; those of the first one begin with the schema."""
        table = table_of(batch)
        if self._writer is None:
            self._writer = pyarrow_module().ipc.new_stream(self._sink, table.schema)
        self._writer.write_table(table)
        return self._sink.take()

    def close(self) -> bytes:
        """The end of the stream. Contract: `write` was called."""
        self._writer.close()
        return self._sink.take()


class _Sink(io.RawIOBase):
    """The bytes that pyarrow has written since the last `take`."""

    def __init__(self) -> None:
        super().__init__()
        self._data = bytearray()
        self._taken = 0

    def writable(self) -> bool:
        return True

    def tell(self) -> int:
        return self._taken + len(self._data)

    def write(self, data: Any) -> int:
        self._data += data
        return len(data)

    def take(self) -> bytes:
        found = bytes(self._data)
        self._taken += len(found)
        self._data.clear()
        return found


def table_of(batch: SampleBatch) -> Any:
    """A batch as an Arrow table, texts as strings."""
    pa = pyarrow_module()
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
    return pa.table(arrays)


def read_arrow(path: Path) -> Any:
    """A recording's table, from an IPC stream or file."""
    return _read(path.read_bytes())


def arrow_field_type(name: str, type: Any) -> FieldType:
    """The field type that holds an Arrow column; raises `WireError` if none does."""
    pa = pyarrow_module()
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
    pa = pyarrow_module()
    if column.null_count:
        row = int(np.argmax(column.is_null().to_numpy())) + 1
        raise WireError(row, f"{key!r} is missing", "every sample has its times")
    if pa.types.is_timestamp(column.type) or pa.types.is_signed_integer(column.type):
        if pa.types.is_timestamp(column.type):
            counts = column.to_numpy().view(np.int64)
            scale = TIME_UNITS[column.type.unit]
        else:
            counts = _as(column, pa.int64()).to_numpy()
            reader.observe((int(counts.min(initial=0)), int(counts.max(initial=0))))
            scale = TIME_UNITS[reader.unit]
        if scale > 1:
            outside = (counts > TIME_MAX // scale) | (counts < -(TIME_MIN // -scale))
            if outside.any():
                row = int(np.argmax(outside)) + 1
                raise WireError(
                    row, f"{key!r} is outside signed 64-bit nanoseconds", TIME_RANGE_HINT
                )
        times: Times = counts * np.int64(scale)
        return times
    values = column.to_pylist()
    reader.observe(values)
    return reader.read(values, range(1, len(values) + 1), key)


def column_from_arrow(field: Field, column: Any, pools: dict[str, StringPool]) -> Column:
    """A field's column; raises `WireError` with the row of a bad value."""
    if field.type is FieldType.STRING:
        return _text(field, column, pools)
    return _numbers(field, column)


def _numbers(field: Field, column: Any) -> Column:
    """A column of numbers or booleans."""
    pa = pyarrow_module()
    null = column.is_null().to_numpy() if column.null_count else None
    if field.type is FieldType.INTEGER and pa.types.is_uint64(column.type):
        unsigned = column.fill_null(0).to_numpy()
        beyond = unsigned >= 2**63
        if beyond.any():
            row = int(np.argmax(beyond))
            raise WireError(
                row + 1, f"field {field.name!r} is outside 64 bits: {int(unsigned[row])}"
            )
    target = {
        FieldType.FLOAT: pa.float64(),
        FieldType.INTEGER: pa.int64(),
        FieldType.BOOLEAN: pa.bool_(),
    }[field.type]
    filled = _as(column, target)
    if null is not None:
        filled = filled.fill_null(False if field.type is FieldType.BOOLEAN else 0)
    # A view of the body if that has the column's type.
    values = np.require(filled.to_numpy(), field.type.dtype, ("C", "A"))
    if field.type is FieldType.FLOAT and not np.isfinite(values).all():
        row = int(np.argmin(np.isfinite(values)))
        raise WireError(
            row + 1,
            f"field {field.name!r} must be finite, got {values[row]}",
            "send null for no value",
        )
    return Column(field.type, values, null)


_FEW = 64
"""Rows below which texts are encoded one by one, without a dictionary."""


def _together(column: Any) -> Any:
    """A column of texts in one chunk, if possible: each chunk has a dictionary to read."""
    pa = pyarrow_module()
    if column.num_chunks <= 1:
        return column
    try:
        return pa.chunked_array([column.combine_chunks()])
    except pa.ArrowNotImplementedError:  # dictionaries with an entry for null
        return column


def _text(field: Field, column: Any, pools: dict[str, StringPool]) -> Column:
    """Encode text with the field's pool, which gets new texts in the order of the rows.

    Cost: Python once per distinct text and chunk. A dictionary column is not encoded again.
    """
    pa = pyarrow_module()
    pool = pool_of(field, pools)
    if len(column) < _FEW:
        values = _as(column, pa.string()).to_pylist()
        return text_column(values, pool, null_mask(values))
    if not pa.types.is_dictionary(column.type):
        column = column.dictionary_encode()
    parts = [_codes(chunk, pool) for chunk in column.chunks if len(chunk)]
    null = np.concatenate([absent for _, absent in parts])
    return Column(
        field.type,
        np.concatenate([codes for codes, _ in parts]),
        null if null.any() else None,
        pool,
    )


def _check_texts(name: str, column: Any, limits: BatchLimits) -> None:
    """Raise `WireError` with the row of a text that is too long. Each text of a dictionary is
    measured once."""
    pa = pyarrow_module()
    before = 0
    for chunk in column.chunks:
        is_coded = pa.types.is_dictionary(chunk.type)
        texts = chunk.dictionary if is_coded else chunk
        if pa.types.is_dictionary(texts.type):
            raise WireError(None, f"column {name!r} is a dictionary of dictionaries")
        if not pa.types.is_null(texts.type) and texts.nbytes > limits.text:
            sizes = _sizes(texts)
            if is_coded:
                there = chunk.indices.is_valid().to_numpy(zero_copy_only=False)
                places = chunk.indices.fill_null(0).to_numpy(zero_copy_only=False)
                sizes = np.where(there, sizes[places.astype(np.int64)], 0)
            if sizes.max(initial=0) > limits.text:
                row = int(np.argmax(sizes > limits.text))
                raise limits.too_long(before + row + 1, name, int(sizes[row]))
        before += len(chunk)


def _sizes(texts: Any) -> NDArray[np.int64]:
    """Bytes of each text of an array, 0 for none."""
    pa = pyarrow_module()
    kind = np.int64 if pa.types.is_large_string(texts.type) else np.int32
    _, offsets, _ = texts.buffers()
    if offsets is None:
        return np.zeros(len(texts), np.int64)
    ends = np.frombuffer(offsets, kind)[texts.offset : texts.offset + len(texts) + 1]
    sizes = np.diff(ends).astype(np.int64)
    sizes[texts.is_null().to_numpy(zero_copy_only=False)] = 0
    return sizes


def _codes(chunk: Any, pool: StringPool) -> tuple[NDArray[np.int32], Mask]:
    """Codes of a dictionary array's rows, and which rows are null (their codes have no meaning)."""
    absent: Mask = chunk.indices.is_null().to_numpy(zero_copy_only=False)
    places = chunk.indices
    if places.null_count:
        places = places.fill_null(0)
    places = places.to_numpy(zero_copy_only=False).astype(np.int64)
    texts = chunk.dictionary
    if not len(texts):
        return np.zeros(len(chunk), np.int32), absent
    used = places[~absent] if chunk.indices.null_count else places
    first = np.full(len(texts), len(used), np.int64)
    first[used[::-1]] = np.arange(len(used) - 1, -1, -1)  # numpy keeps the last of equal places
    met = np.flatnonzero(first < len(used))
    met = met[np.argsort(first[met])]
    if texts.null_count:  # a dictionary may have an entry for null
        nothing = texts.is_null().to_numpy(zero_copy_only=False)
        met = met[~nothing[met]]
        absent = absent | nothing[places]
    codes = np.zeros(len(texts), np.int32)
    codes[met] = pool.encode(texts.take(met).to_numpy(zero_copy_only=False).tolist())
    return codes[places], absent


def _as(column: Any, type: Any) -> Any:
    """The column cast to ``type``, where numbers wrap; unchanged if it has that type."""
    return column if column.type == type else column.cast(type, safe=False)


def _expect(field: Field, column: Any) -> None:
    """Raise `WireError` unless the column's type can hold the field's values."""
    pa = pyarrow_module()
    if pa.types.is_null(column.type):
        return
    got = arrow_field_type(field.name, column.type)
    if got is not field.type and (got, field.type) != (FieldType.INTEGER, FieldType.FLOAT):
        raise WireError(None, f"field {field.name!r} is {field.type}, got {column.type}")


def _read(data: bytes) -> Any:
    pa = pyarrow_module()
    if not data:
        raise WireError(None, "the body is empty", "send an Arrow IPC stream")
    is_file = data[:6] == b"ARROW1"
    try:
        opened = pa.ipc.open_file(data) if is_file else pa.ipc.open_stream(data)
        table = opened.read_all()
        table.validate(full=True)
    except failures(pa) as error:
        raise WireError(None, f"no Arrow IPC stream: {error}") from None
    return table


def failures(pa: Any) -> tuple[type[Exception], ...]:
    """The exceptions that pyarrow raises for bytes that are no Arrow."""
    return (pa.ArrowException, OSError, ValueError, UnicodeDecodeError)


def _is_text(type: Any) -> bool:
    pa = pyarrow_module()
    if pa.types.is_dictionary(type):
        return _is_text(type.value_type)
    return bool(pa.types.is_string(type) or pa.types.is_large_string(type))


def pyarrow_module() -> Any:
    """The module pyarrow; raises `ArrowMissing` if it is not installed."""
    try:
        import pyarrow
    except ImportError:
        raise ArrowMissing from None
    return pyarrow
