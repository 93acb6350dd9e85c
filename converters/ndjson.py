"""Samples as newline-delimited JSON, ``application/x-ndjson`` (docs/conversion.md).

A line is ``{"valid": time, "available": time (optional), <field>: value …}``: every declared field
and no other; null is no_value; a time is ISO-8601 or integer nanoseconds.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any

import msgspec
import numpy as np

from ..streams.sample import (
    TIME_FIELDS,
    Column,
    Field,
    FieldType,
    SampleBatch,
    Schema,
    Times,
    Value,
)
from ..streams.strings import StringPool
from ..streams.time import format_time
from .errors import WireError
from .regular import decode_regular
from .wire import (
    BOM,
    TIME_HINT,
    BatchLimits,
    Incoming,
    check_names,
    format_times,
    null_mask,
    pool_of,
    shown,
    text_column,
    time_of,
)

CONTENT_TYPE = "application/x-ndjson"

_PYTHON_TYPES: dict[FieldType, Any] = {
    FieldType.FLOAT: float,
    FieldType.INTEGER: int,
    FieldType.BOOLEAN: bool,
    FieldType.STRING: str,
}
_PART = 1000
"""Lines that are looked at together for the one that is wrong."""
_NOT_FINITE = re.compile(rb"(?<![\"\w])-?(NaN|Infinity)(?![\"\w])")


def decode_ndjson(
    data: bytes,
    schema: Schema,
    pools: dict[str, StringPool],
    limits: BatchLimits | None = None,
) -> Incoming:
    """A batch from its lines, taken whole or refused whole.

    Text is encoded with ``pools`` (by field; made where one lacks), which grow only when the
    whole batch is good. Without fields in ``schema`` (an open stream) the batch decides them:
    those of its first line, typed by all values. Raises `WireError` with the line, also for more
    than ``limits``. Cost: lines of
    one make (`regular`) take 3 ns a byte, others and small batches 0.3 µs a field.
    """
    data = data.removeprefix(BOM)
    if limits is not None:
        _check_limits(data, limits)
    schema = schema if schema.fields else _decided_by(data)
    check_names(schema)
    regular = decode_regular(data, schema, pools)
    return decode_exactly(data, schema, pools) if regular is None else regular


def decode_exactly(data: bytes, schema: Schema, pools: dict[str, StringPool]) -> Incoming:
    """`decode_ndjson` without the short way: what is good and what an error is, it decides."""
    try:
        samples = _decoder(schema).decode_lines(data)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
        raise _cause(data, schema, str(error)) from None
    if len(samples) != sum(1 for line in data.split(b"\n") if line.strip()):
        raise _cause(data, schema, "a line is not exactly one sample")
    if not samples:
        raise WireError(
            None, "the body holds no sample", "send one JSON object a line, at least one"
        )
    lines = _Lines(data)
    stamped = samples[0].available is msgspec.UNSET
    for i, sample in enumerate(samples):
        if (sample.available is msgspec.UNSET) is not stamped:
            raise mixed_times(lines.of(i))
    _check_keys(data, len(samples), len(schema.fields) + (1 if stamped else 2))
    valid = _times([sample.valid for sample in samples], "valid", lines)
    available = (
        valid if stamped else _times([sample.available for sample in samples], "available", lines)
    )
    found = list(zip(*map(msgspec.structs.astuple, samples), strict=True))[: len(schema.fields)]
    for field, values in zip(schema.fields, found, strict=True):
        if field.type is FieldType.INTEGER:
            _check_integers(field, values, lines)
    columns = {
        field.name: _column(field, values, pools)
        for field, values in zip(schema.fields, found, strict=True)
    }
    return Incoming(SampleBatch(available, valid, columns), stamped)


def _check_limits(data: bytes, limits: BatchLimits) -> None:
    """Raises `WireError` for too many lines, and for a text that is too long. Cost: a look at a
    line every ``limits.text`` bytes, and where the line feeds may be too many."""
    if data.count(b"\n") >= limits.samples:
        numbers = [n for n, line in enumerate(data.split(b"\n"), 1) if line.strip()]
        first = numbers[limits.samples] if len(numbers) > limits.samples else None
        limits.check_samples(len(numbers), first)
    start = 0
    while start + limits.text < len(data):
        end = data.rfind(b"\n", start, start + limits.text + 1)
        if end < 0:  # a text that is too long stands in a line that is
            end = data.find(b"\n", start)
            end = len(data) if end < 0 else end
            _check_texts(data[start:end], data.count(b"\n", 0, start) + 1, limits)
        start = end + 1


def _check_texts(line: bytes, number: int, limits: BatchLimits) -> None:
    try:
        values = msgspec.json.decode(line)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError):
        return  # what it is instead is told where it is decoded
    for name, value in values.items() if isinstance(values, dict) else ():
        size = len(value.encode()) if isinstance(value, str) else 0
        if size > limits.text:
            raise limits.too_long(number, name, size)


def mixed_times(line: int) -> WireError:
    """Available times in some samples and not in others."""
    return WireError(
        line,
        "'available' is in some samples and not in others",
        "send it with every sample, or with none to have them stamped on arrival",
    )


def _decided_by(data: bytes) -> Schema:
    """The fields of the first line, each with the narrowest type that all lines fit."""
    try:
        rows = [row for row in msgspec.json.Decoder().decode_lines(data) if isinstance(row, dict)]
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError):
        rows = []  # the line is told where every line is read
    names = [name for name in (rows[0] if rows else ()) if name not in TIME_FIELDS]
    types = {name: {type(row.get(name)) for row in rows} - {type(None)} for name in names}
    for name, found in types.items():
        if not found:
            raise WireError(
                None,
                f"field {name!r} has no value anywhere, so its type is not known",
                "declare the fields: PUT /streams/{name}, or a sort in KPL",
            )
    return Schema(tuple(Field(name, _narrowest(found)) for name, found in types.items()))


def _narrowest(types: set[type]) -> FieldType:
    if types == {int, float}:
        return FieldType.FLOAT
    for kind, python in _PYTHON_TYPES.items():
        if types == {python}:
            return kind
    return FieldType.STRING  # lines that are no text are told where every line is read


def encode_ndjson(batch: SampleBatch) -> bytes:
    """One line a sample, with both times; `decode_ndjson` gives the batch back."""
    names = ("available", "valid", *batch.columns)
    columns = [column.tolist() for column in batch.columns.values()]
    rows = zip(format_times(batch.available), format_times(batch.valid), *columns, strict=True)
    return msgspec.json.Encoder().encode_lines([dict(zip(names, row, strict=True)) for row in rows])


def sample_json(available: int, valid: int, values: Mapping[str, Value]) -> dict[str, Value]:
    """A sample as the JSON object that stands for it, times in ISO-8601."""
    return {"available": format_time(available), "valid": format_time(valid), **values}


_KEY_END = re.compile(rb'"[ \t\r]*:')
_BEFORE_COLON = (b" :", b"\t:", b"\r:")


def _check_keys(data: bytes, samples: int, keys: int) -> None:
    """Refuse a sample with a key twice: JSON parsers differ in which of the two they take.

    Every sample has all its ``keys``, so that more ends of keys than that are suspicious. Such an
    end may also stand in a text, so only then lines are read again, slowly.
    """
    usual = all(spelling not in data for spelling in _BEFORE_COLON)
    if usual and data.count(b'":') == samples * keys:
        return
    for number, line in enumerate(data.split(b"\n"), 1):
        if len(_KEY_END.findall(line)) > keys:
            pairs = json.loads(line, object_pairs_hook=list)
            seen: set[str] = set()
            for key, _ in pairs:
                if key in seen:
                    raise WireError(number, f"{key!r} is there twice", "a sample has a key once")
                seen.add(key)


class _Lines:
    """Which line the n-th sample stands in: looked up only to report an error."""

    def __init__(self, data: bytes) -> None:
        self._data = data

    def of(self, sample: int) -> int:
        numbers = [n for n, line in enumerate(self._data.split(b"\n"), 1) if line.strip()]
        return numbers[min(sample, len(numbers) - 1)]


@lru_cache(maxsize=256)
def _decoder(schema: Schema) -> Any:
    """A decoder compiled for the schema; field ``f<i>`` holds the i-th field."""
    fields: list[Any] = [
        (f"f{i}", _PYTHON_TYPES[field.type] | None) for i, field in enumerate(schema.fields)
    ]
    fields.append(("valid", str | int))
    fields.append(("available", str | int | msgspec.UnsetType, msgspec.UNSET))
    wire_names = {f"f{i}": field.name for i, field in enumerate(schema.fields)}
    sample = msgspec.defstruct(
        "Sample", fields, rename=wire_names, forbid_unknown_fields=True, gc=False
    )
    return msgspec.json.Decoder(sample)


_PLAIN_TIME = re.compile(
    r"(?:19\d\d|20\d\d|21\d\d)-\d\d-\d\dT\d\d:\d\d:\d\d(?:\.\d{1,9})?Z"
).fullmatch


def _times(values: Sequence[str | int], key: str, lines: _Lines) -> Times:
    if set(map(type, values)) == {int}:
        try:
            return np.array(values, np.int64)
        except OverflowError:
            pass  # the one-by-one way says which line
    elif all(map(_is_plain_time, values)):
        try:  # numpy parses the usual spelling many times faster than one by one
            return np.array([v[:-1] for v in values], "M8[ns]").astype(np.int64)  # type: ignore[index]
        except ValueError:
            pass  # such as a 13th month: the one-by-one way says which line
    found = []
    for i, value in enumerate(values):
        try:
            found.append(time_of(value, key, 0))
        except WireError as error:
            raise WireError(lines.of(i), error.message, TIME_HINT) from None
    return np.array(found, np.int64)


def _is_plain_time(value: object) -> bool:
    return isinstance(value, str) and _PLAIN_TIME(value) is not None


def _check_integers(field: Field, values: Sequence[Any], lines: _Lines) -> None:
    for i, value in enumerate(values):
        if value is not None and not -(2**63) <= value < 2**63:
            raise WireError(
                lines.of(i),
                f"field {field.name!r} is outside 64 bits: {shown(value)}",
                "integers have 64 bits: declare the field as float, or as string",
            )


def _column(field: Field, values: Sequence[Any], pools: dict[str, StringPool]) -> Column:
    null = null_mask(values)
    if field.type is FieldType.STRING:
        return text_column(values, pool_of(field, pools), null)
    if null is not None:
        values = [0 if value is None else value for value in values]
    return Column(field.type, np.array(values, field.type.dtype), null)


def _cause(data: bytes, schema: Schema, message: str) -> WireError:
    """The first line that is no sample, and why: those of the first part that cannot be decoded
    are read again one by one, slowly."""
    lines = data.split(b"\n")
    for first in range(0, len(lines), _PART):
        part = lines[first : first + _PART]
        if _are_samples(part, schema):
            continue
        for number, line in enumerate(part, first + 1):
            if line.strip():
                try:
                    error = _line_error(line, number, schema)
                except RecursionError:
                    hint = "values of a sample are plain"
                    error = WireError(number, "the line is nested too deeply", hint)
                if error is not None:
                    return error
    # What the decoder says stands in its own words: `Number out of range - at `$[...]``.
    return WireError(None, message.partition(" - at `")[0], "send one JSON object a line")


def _are_samples(lines: Sequence[bytes], schema: Schema) -> bool:
    """Whether each line is one, but for what `decode_exactly` looks at later."""
    try:
        samples = _decoder(schema).decode_lines(b"\n".join(lines))
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError):
        return False
    return len(samples) == sum(1 for line in lines if line.strip())


def _line_error(line: bytes, number: int, schema: Schema) -> WireError | None:
    try:
        values = msgspec.json.decode(line)
    except msgspec.ValidationError:  # the one limit of plain JSON: 1e999
        return WireError(number, "a number is larger than a float holds", "send null for no value")
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        if _NOT_FINITE.search(line):
            return WireError(
                number, "NaN and Infinity are no JSON numbers", "send null for no value"
            )
        return WireError(number, f"not JSON: {error}", "send one JSON object a line")
    if not isinstance(values, dict):
        return WireError(
            number, f"a sample is a JSON object, got {shown(values)}", "send one JSON object a line"
        )
    for name in ("valid", *schema.names):
        if name not in values:
            hint = (
                "every sample has its valid time"
                if name == "valid"
                else "send null for a field without value"
            )
            return WireError(number, f"{name!r} is missing", hint)
    for name in values:
        if name not in TIME_FIELDS and schema.get(name) is None:
            return WireError(
                number, f"{name!r} is not declared", f"the fields are {', '.join(schema.names)}"
            )
    for key in TIME_FIELDS:
        if key in values:
            try:
                time_of(values[key], key, number)
            except WireError as error:
                return error
    for field in schema.fields:
        if not _fits(field.type, values[field.name]):
            return WireError(
                number, f"field {field.name!r} is {_a(field.type)}, got {shown(values[field.name])}"
            )
    return None


def _fits(type: FieldType, value: object) -> bool:
    if value is None:
        return True
    if isinstance(value, bool):
        return type is FieldType.BOOLEAN
    if type is FieldType.FLOAT:
        return isinstance(value, float | int)
    return isinstance(value, _PYTHON_TYPES[type])


def _a(type: FieldType) -> str:
    return f"an {type}" if type is FieldType.INTEGER else f"a {type}"
