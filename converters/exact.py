"""NDJSON of any make, decoded exactly: it decides what is good and what an error is.

A body is decoded part by part (`lines`), each checked whole before the next one, so that others may
go on between two. Called by `ndjson`, for what is not regular (`regular`).
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from ..languages.object_cache import ObjectCache
from ..streams.sample import (
    Column,
    Field,
    FieldType,
    Mask,
    SampleBatch,
    Schema,
    Times,
)
from ..streams.string_pool import StringPool
from ..streams.yield_points import STRAIGHT, Pauses
from .bad_lines import NO_JSON, PYTHON_TYPES, first_bad, key_twice
from .errors import WireError
from .lines import PART, Part, parts
from .wire import Incoming, null_mask, pool_of, text_column, time_of


def decode_exactly(
    data: bytes,
    schema: Schema,
    pools: dict[str, StringPool],
    pauses: Pauses = STRAIGHT,
    size: int | None = None,
) -> Incoming:
    """`decode_ndjson` without the short way. An error tells the first line that is no sample.

    Law (tests/laws): what comes of it does not depend on ``size``, the bytes of a part. Cost: 30 to
    90 ns a byte; memory: the columns, and a Python object a text.
    """
    reader = _Reader(schema, pauses)
    # Each part has its arrays of each field.
    wide = max(1, len(schema.fields) // _WIDE)
    for part in parts(data, wide * PART if size is None else size):
        reader.read(part)
        pauses.breathe()
    if reader.stamped is None:
        raise WireError(
            None, "the body holds no sample", "send one JSON object a line, at least one"
        )
    return Incoming(reader.batch(pools), reader.stamped)


class _Rows(NamedTuple):
    """The samples of one part: values of texts as they are, those of others in arrays."""

    available: Times
    valid: Times
    columns: list[tuple[Any, Mask | None]]


class _Reader:
    """Reads the parts of one body. ``stamped``: whether its samples bring no available times; None
    before the first one."""

    def __init__(self, schema: Schema, pauses: Pauses) -> None:
        self.stamped: bool | None = None
        self._schema = schema
        self._pauses = pauses
        self._decoder = _decoder(schema)
        self._rows: list[_Rows] = []

    def read(self, part: Part) -> None:
        """Raises `WireError` for the first line that is no sample."""
        try:
            samples = self._decoder.decode_lines(part.data)
        except NO_JSON as error:
            raise self._bad(part, str(error)) from None
        if not _one_a_line(part, len(samples)):
            raise self._bad(part, "a line is not exactly one sample")
        if not samples:
            return
        stamped = self.stamped
        if stamped is None:
            stamped = samples[0].available is msgspec.UNSET
        keys = len(self._schema.fields) + (1 if stamped else 2)
        try:
            if any((sample.available is msgspec.UNSET) is not stamped for sample in samples):
                raise _Bad
            self._check_keys(part, len(samples), keys)
            valid = _times([sample.valid for sample in samples])
            available = valid if stamped else _times([sample.available for sample in samples])
            found = list(zip(*map(msgspec.structs.astuple, samples), strict=True))
            columns = [
                _values(field, values)
                for field, values in zip(self._schema.fields, found, strict=False)
            ]
        except _Bad as bad:
            raise self._bad(part, str(bad)) from None
        self.stamped = stamped
        self._rows.append(_Rows(available, valid, columns))

    def batch(self, pools: dict[str, StringPool]) -> SampleBatch:
        """All that was read. Only now do the pools grow, as all is good."""
        columns = {}
        for k, field in enumerate(self._schema.fields):
            pool = None
            if field.type is FieldType.STRING:
                pool = pool_of(field, pools)
                for rows in self._rows:
                    values, null = rows.columns[k]
                    # In the place of the texts, which so go one part after the other.
                    rows.columns[k] = text_column(values, pool, null).values, null
                    del values
                    self._pauses.breathe()
            columns[field.name] = _joined(field, [rows.columns[k] for rows in self._rows], pool)
            self._pauses.breathe()
        valid = _together([rows.valid for rows in self._rows])
        if self.stamped:
            return SampleBatch(valid, valid, columns)
        return SampleBatch(_together([rows.available for rows in self._rows]), valid, columns)

    def _bad(self, part: Part, message: str) -> WireError:
        return first_bad(part, self._schema, self.stamped, self._decoder, message, self._pauses)

    def _check_keys(self, part: Part, samples: int, keys: int) -> None:
        """Raises `_Bad` where a sample has a key twice.

        Every sample has all its ``keys``, so that more ends of keys than that are suspicious. Such
        an end may also stand in a text, so only then lines are read again, slowly.
        """
        usual = all(spelling not in part.data for spelling in _BEFORE_COLON)
        if usual and part.data.count(b'":') == samples * keys:
            return
        for number, (_, line) in enumerate(part.lines()):
            if key_twice(line, keys) is not None:
                raise _Bad("a key is there twice")
            if not number % _SOME:
                self._pauses.breathe()


_WIDE = 200
"""Of so many fields parts are as long as usual; of more, longer."""
_BEFORE_COLON = (b" :", b"\t:", b"\r:")
_SOME = 100
"""Lines that are read slowly between two moments for others."""


class _Bad(Exception):
    """A line of the part is no sample."""


def _one_a_line(part: Part, samples: int) -> bool:
    """Whether each line that is not blank is one sample: none has two, and none two have one."""
    # A sample begins with the one brace that it has: all of them begin a line, and no other does.
    data = part.data
    if data.count(b"\n{") + data.startswith(b"{") == samples:
        if data.count(b"\n") + (not data.endswith(b"\n")) == samples:
            return True
    elif any(not line.lstrip().startswith(b"{") for _, line in part.lines()):
        return False
    return part.samples() == samples


@ObjectCache
def _decoder(schema: Schema) -> Any:
    """A decoder compiled for the schema; field ``f<i>`` holds the i-th field.

    Raises `WireError` for names that are spelled otherwise in JSON: units may say such fields, and
    once they could be declared.
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
    if set(map(type, values)) == {int}:
        try:
            return np.array(values, np.int64)
        except OverflowError:
            raise _Bad from None
    if all(map(_is_plain_time, values)):
        try:  # numpy parses the usual spelling many times faster than one by one
            return np.array([v[:-1] for v in values], "M8[ns]").astype(np.int64)  # type: ignore[index]
        except ValueError:  # such as a 13th month
            raise _Bad from None
    try:
        return np.array([time_of(value, "", 0) for value in values], np.int64)
    except WireError:
        raise _Bad from None


def _is_plain_time(value: object) -> bool:
    return isinstance(value, str) and _PLAIN_TIME(value) is not None


def _values(field: Field, values: Sequence[Any]) -> tuple[Any, Mask | None]:
    """What a part has of a field, and where it is null. Raises `_Bad`."""
    null = null_mask(values)
    if field.type is FieldType.STRING:
        return values, null
    if null is not None:
        values = [0 if value is None else value for value in values]
    try:
        return np.array(values, field.type.dtype), null
    except OverflowError:
        raise _Bad from None


def _joined(
    field: Field, read: Sequence[tuple[NDArray[Any], Mask | None]], pool: StringPool | None
) -> Column:
    """The parts of a column in one."""
    if len(read) == 1:
        return Column(field.type, *read[0], pool)
    values = _together([part for part, _ in read])
    if all(null is None for _, null in read):
        return Column(field.type, values, None, pool)
    masks = [np.zeros(len(part), np.bool_) if null is None else null for part, null in read]
    return Column(field.type, values, _together(masks), pool)


def _together(arrays: Sequence[NDArray[Any]]) -> NDArray[Any]:
    return arrays[0] if len(arrays) == 1 else np.concatenate(arrays)
