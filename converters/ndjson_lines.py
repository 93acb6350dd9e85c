"""NDJSON line by line with msgspec: the exact path, which defines the samples and the errors.

A body is decoded in parts of whole lines, each checked completely before the next, so that the
service can yield between them. Called by `ndjson` for bodies that `ndjson_scan` declines.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from contextlib import suppress
from typing import Any, Final

import msgspec
import numpy as np

from ..languages.object_cache import ObjectCache
from ..streams.sample import (
    TIME_FIELDS,
    Column,
    Field,
    FieldType,
    SampleBatch,
    Schema,
    Times,
    concatenate,
)
from ..streams.string_pool import StringPool
from .errors import WireError
from .ndjson_errors import (
    NO_JSON,
    ONE_A_LINE,
    PYTHON_TYPES,
    first_error,
    object_of,
    repeated_key,
)
from .wire import BatchLimits, Incoming, null_mask, pool_of, text_column, time_of

PART: Final = 1 << 16
"""Bytes of a part: some milliseconds of work."""
_WIDE: Final = 200
"""Schemas with more fields get longer parts, because each part has an array per field."""
_BEFORE_COLON: Final = (b" :", b"\t:", b"\r:")


def sample_lines(data: bytes, size: int = 0) -> Iterator[tuple[int, bytes]]:
    """The lines that are not blank, numbered from 1; ``size`` bytes (0: `PART`) become lines at
    once."""
    for number, part in _parts(data, size or PART):
        yield from _numbered(part, number)


def decode_lines(
    data: bytes,
    schema: Schema,
    pools: dict[str, StringPool],
    size: int = 0,
) -> Incoming:
    """Decode as `decode_ndjson`; an error names the first bad line.

    Law (tests/laws): the result does not depend on ``size``, the bytes of a part. Cost: 30 to 90 ns
    a byte. Memory: the columns, and Python objects for one part.
    """
    size = size or PART * max(1, len(schema.fields) // _WIDE)
    if len(data) <= 2 * size:  # two parts would only encode texts twice
        size = len(data)
    # `_samples` encodes texts when a part has no error. Later parts may have one.
    own = pools if len(data) <= size else {}
    decoder = _decoder(schema)
    stamped: bool | None = None
    batches: list[SampleBatch] = []
    for number, part in _parts(data, size):
        try:
            lines = list(filter(bytes.strip, part.split(b"\n")))
            if lines:
                batch, stamped = _samples(part, lines, schema, stamped, own, decoder)
                batches.append(batch)
        except (_Bad, *NO_JSON):
            bad = first_error(_numbered(part, number), schema, stamped, decoder)
            raise bad from None
    if stamped is None:
        raise WireError(None, "the body holds no sample", f"{ONE_A_LINE}, at least one")
    batch = concatenate(batches)
    columns = {
        name: column if column.pool is None else column.recoded(pools.setdefault(name, column.pool))
        for name, column in batch.columns.items()
    }
    return Incoming(SampleBatch(batch.available, batch.valid, columns), stamped)


def infer_fields(data: bytes, limits: BatchLimits | None = None, size: int = 0) -> Schema:
    """The fields of an open stream: those of its first line, each with the narrowest type that fits
    all lines up to the first bad one, which `decode_lines` reports.

    Raises `WireError` for more fields than ``limits`` allow, and for a field without a value.
    """
    types: dict[str, set[type]] | None = None
    is_good = True
    for number, line in sample_lines(data, size):
        try:
            row: dict[str, Any] = _PLAIN_ROW.decode(line)
        except NO_JSON:
            is_good = False
            try:
                row = object_of(line, number)
            except WireError:
                break
        if types is None:
            types = {name: set() for name in row if name not in TIME_FIELDS}
            if limits is not None:
                limits.check_fields(types)
        for name, found in types.items():
            found.add(type(row.get(name)))
        if not is_good:
            break
    fields = []
    for name, found in (types or {}).items():
        if found == {type(None)} and is_good:
            raise WireError(
                None,
                f"field {name!r} has no value anywhere, so its type is not known",
                "declare the fields: PUT /streams/{name}, or a sort in KPL",
            )
        fields.append(Field(name, json_type(found)))
    return Schema(tuple(fields))


_PLAIN_ROW = msgspec.json.Decoder(dict[str, str | int | float | bool | None])


def json_type(types: set[type]) -> FieldType:
    """The narrowest type of a field with values of these Python types; text for a mixture."""
    present = types - {type(None)}
    if present == {int, float}:
        return FieldType.FLOAT
    for kind, python in PYTHON_TYPES.items():
        if present == {python}:
            return kind
    return FieldType.STRING


def _parts(data: bytes, size: int) -> Iterator[tuple[int, bytes]]:
    """Parts of whole lines, at least one each, with the number of the first."""
    start, number = 0, 1
    while start < len(data):
        end = len(data)
        if end - start > size:
            end = data.rfind(b"\n", start, start + size) + 1 or data.find(b"\n", start + size) + 1
            end = end or len(data)
        part = data[start:end]
        yield number, part
        number += part.count(b"\n")
        start = end


def _numbered(part: bytes, number: int) -> Iterator[tuple[int, bytes]]:
    for at, line in enumerate(part.split(b"\n"), number):
        if line.strip():
            yield at, line


class _Bad(Exception):
    """A line of the part is no sample; `first_error` finds it."""


def _samples(
    part: bytes,
    lines: list[bytes],
    schema: Schema,
    stamped: bool | None,
    pools: dict[str, StringPool],
    decoder: Any,
) -> tuple[SampleBatch, bool]:
    """The samples of a part, and whether they lack available times. ``stamped`` is whether those
    before it did. Raises `_Bad` or `NO_JSON`; ``pools`` grow only if it raises nothing."""
    samples = list(map(decoder.decode, lines))
    lacking = [sample.available for sample in samples].count(msgspec.UNSET)
    if lacking not in (0, len(samples)) or stamped not in (None, lacking > 0):
        raise _Bad
    stamped = lacking > 0
    _check_keys(part, lines, len(schema.fields) + (1 if stamped else 2))
    found = list(zip(*map(msgspec.structs.astuple, samples), strict=True))
    valid = _times(found[-2])
    available = valid if stamped else _times(found[-1])
    sent = list(zip(schema.fields, found, strict=False))
    columns = {f.name: _column(f, v) for f, v in sent if f.type is not FieldType.STRING}
    for field, values in sent:
        if field.type is FieldType.STRING:
            columns[field.name] = text_column(values, pool_of(field, pools), null_mask(values))
    return SampleBatch(available, valid, {name: columns[name] for name in schema.names}), stamped


def _check_keys(part: bytes, lines: list[bytes], keys: int) -> None:
    """Raise `_Bad` where a sample has a key twice.

    Every sample has all its ``keys``, so that more ends of keys are suspicious. A text may hold
    such an end, too: then each line is read again.
    """
    usual = all(spelling not in part for spelling in _BEFORE_COLON)
    if usual and part.count(b'":') == len(lines) * keys:
        return
    if any(repeated_key(line, keys) is not None for line in lines):
        raise _Bad


@ObjectCache
def _decoder(schema: Schema) -> Any:
    """A decoder compiled for the schema; field ``f<i>`` holds the i-th field.

    Raises `WireError` for names that JSON spells with escapes: user-written units may name such
    fields, and old journals declare them.
    """
    fields: list[Any] = [
        (f"f{i}", PYTHON_TYPES[field.type] | None) for i, field in enumerate(schema.fields)
    ]
    fields.append(("valid", str | int))
    fields.append(("available", str | int | msgspec.UnsetType, msgspec.UNSET))
    wire_names = {f"f{i}": field.name for i, field in enumerate(schema.fields)}
    try:
        sample = msgspec.defstruct(
            "Sample", fields, rename=wire_names, forbid_unknown_fields=True, gc=False
        )
    except ValueError as error:
        hint = "send Arrow, or declare it with other names"
        raise WireError(
            None, f"no samples of this stream are read from JSON: {error}", hint
        ) from None
    return msgspec.json.Decoder(sample)


_PLAIN_TIME = re.compile(
    r"(?:19\d\d|20\d\d|21\d\d)-\d\d-\d\dT\d\d:\d\d:\d\d(?:\.\d{1,9})?Z"
).fullmatch


def _times(values: Sequence[str | int]) -> Times:
    """Raises `_Bad` where one is no time."""
    try:
        if set(map(type, values)) == {int}:
            return np.array(values, np.int64)
        if all(isinstance(value, str) and _PLAIN_TIME(value) for value in values):
            # numpy parses the usual spelling many times faster than `time_of`.
            with suppress(ValueError):  # such as a 13th month
                return np.array([v[:-1] for v in values], "M8[ns]").astype(np.int64)  # type: ignore[index]
        return np.array([time_of(value, "", 0) for value in values], np.int64)
    except (OverflowError, WireError):
        raise _Bad from None


def _column(field: Field, values: Sequence[Any]) -> Column:
    """Raises `_Bad` for an integer outside 64 bits."""
    null = null_mask(values)
    if null is not None:
        values = [0 if value is None else value for value in values]
    try:
        return Column(field.type, np.array(values, field.type.dtype), null)
    except OverflowError:
        raise _Bad from None
