"""Common parts of the wire formats: decoded batches, their limits, times, text columns."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import msgspec
import numpy as np

from ..streams.sample import (
    TIME_FIELDS,
    Column,
    Field,
    FieldType,
    Mask,
    SampleBatch,
    Schema,
    Times,
    check_field_name,
)
from ..streams.string_pool import StringPool
from ..streams.time import TIME_MIN, format_time, parse_time
from .errors import WireError

BOM = b"\xef\xbb\xbf"
"""The byte order mark that some editors write before UTF-8; decoders skip it."""


@dataclass(frozen=True, slots=True)
class Rounded:
    """Rounded values of a batch (see `rounding`): their ``count``, and the place of the first."""

    count: int
    line: int
    field: str


@dataclass(frozen=True, slots=True)
class Incoming:
    """A decoded batch. ``stamped``: it has no available times, the generator must stamp it
    (``batch.available`` then repeats the valid times). ``rounded`` is None if no number was.
    ``valid_on_arrival``: the stamps are its valid times, too. ``has_nodes``: it is RDF with blank
    nodes, which the stream names (`rdf.statements.with_named_nodes`)."""

    batch: SampleBatch
    stamped: bool
    rounded: Rounded | None = None
    valid_on_arrival: bool = False
    has_nodes: bool = False


@dataclass(frozen=True, slots=True)
class BatchLimits:
    """Limits of a batch from outside: samples, UTF-8 bytes of one text, bytes after decompression,
    bytes of one line, and fields where the batch decides them. Recovery decodes without limits,
    because the service accepted the batch under the limits of that time."""

    samples: int
    text: int
    decoded: int
    line: int = 1 << 20
    fields: int = 1_000

    def check_samples(self, count: int, line: int | None = None) -> None:
        """Raise `WireError` for more samples; ``line`` is that of the first excess one."""
        if count > self.samples:
            raise WireError(
                line, f"a batch has at most {self.samples} samples", "send several batches"
            )

    def check_fields(self, names: Collection[str]) -> None:
        """Raise `WireError` for no fields, too many, or an invalid name: the first batch of an open
        stream decides them."""
        if not names:
            raise WireError(
                None,
                "the first sample decides the fields, and this one has none",
                "send it with its values, or declare the fields: PUT /streams/{name}",
            )
        if len(names) > self.fields:
            raise WireError(
                None, f"a sample has at most {self.fields} fields", "publish to several streams"
            )
        for name in names:
            try:
                check_field_name(name)
            except ValueError as error:
                raise WireError(None, str(error), "give it another name") from None

    def too_long(self, line: int, field: str, size: int) -> WireError:
        """The error for a text of ``size`` bytes."""
        return WireError(
            line,
            f"field {field!r}: a text has at most {self.text} bytes, and this one {size}",
            "keep the text elsewhere and send its address",
        )

    def line_too_long(self, line: int, size: int) -> WireError:
        """The error for a line of ``size`` bytes."""
        return WireError(
            line,
            f"a line has at most {self.line} bytes, and this one {size}",
            "send one JSON object a line",
        )


def check_names(schema: Schema) -> None:
    """Raise `WireError` for a field named like one of a sample's times."""
    for name in TIME_FIELDS:
        if schema.get(name) is not None:
            raise WireError(None, f"a field cannot be called {name!r}: that is a sample's time")


def format_times(times: Times) -> list[str]:
    """`format_time` of a whole column, many times faster than one by one."""
    texts = np.datetime_as_string(times.view("M8[ns]"), unit="ns").tolist()
    return [
        # The least time is numpy's "not a time".
        format_time(TIME_MIN) if text == "NaT" else text.rstrip("0").rstrip(".") + "Z"
        for text in texts
    ]


def time_of(value: object, key: str, line: int) -> int:
    """One time point in ns; raises `WireError` with the line."""
    if isinstance(value, bool) or not isinstance(value, str | int):
        raise WireError(line, f"{key!r} is a time, got {shown(value)}", TIME_HINT)
    try:
        return parse_time(value)
    except ValueError as error:
        reason, _, _ = str(error).partition(": write ")  # as the hint says
        raise WireError(line, f"{key!r}: {reason}", TIME_HINT) from None


def not_json(error: Exception) -> str:
    """The message for an error of the JSON parser."""
    return f"not JSON: {str(error).removeprefix('JSON is malformed: ')}"


def shown(value: object) -> str:
    """A value in an error's message: as JSON, cut to 40 characters."""
    if isinstance(value, int) and value.bit_length() > 64:
        return str(value) if value.bit_length() < 100 else "a number of many digits"
    text = msgspec.json.encode(value, enc_hook=str).decode()
    return text if len(text) <= 40 else f"{text[:37]}…"


TIME_RANGE_HINT = "times are from year 1678 to 2262; is the unit another one?"
TIME_HINT = "write ISO-8601 such as 2021-10-07T19:12:53.5Z, or integer nanoseconds since 1970"


def text_column(values: Sequence[str | None], pool: StringPool, null: Mask | None) -> Column:
    """Text as codes of ``pool``; a code under a set null bit has no meaning."""
    if null is None:
        codes = pool.encode(values)  # type: ignore[arg-type]  # null is None: all are text
    else:
        code = pool.code
        codes = np.fromiter(
            (0 if value is None else code(value) for value in values), np.int32, len(values)
        )
    return Column(FieldType.STRING, codes, null, pool)


def null_mask(values: Sequence[object]) -> Mask | None:
    """True where a value is None; None if no value is."""
    if None not in values:
        return None
    return np.fromiter((value is None for value in values), np.bool_, len(values))


def pool_of(field: Field, pools: dict[str, StringPool]) -> StringPool:
    """The pool of a text field, made if missing."""
    pool = pools.get(field.name)
    if pool is None:
        pool = pools[field.name] = StringPool()
    return pool
