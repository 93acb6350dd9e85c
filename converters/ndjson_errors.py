"""Which line is no sample, and why: looked for slowly, where the quick way has failed."""

from __future__ import annotations

import json
import re
from typing import Any, Final

import msgspec

from ..streams.sample import TIME_FIELDS, FieldType, Schema
from ..streams.yield_points import Pauses
from .errors import WireError
from .lines import Part
from .wire import not_json, shown, time_of

ONE_A_LINE: Final = "send one JSON object a line"
PYTHON_TYPES: Final[dict[FieldType, Any]] = {
    FieldType.FLOAT: float,
    FieldType.INTEGER: int,
    FieldType.BOOLEAN: bool,
    FieldType.STRING: str,
}
NO_JSON: Final = (msgspec.MsgspecError, UnicodeDecodeError, RecursionError)
"""What decoders raise for what is no sample."""
_LONG: Final = 1 << 16
"""Of a line with more bytes what is nested is not made: it may be a million objects."""
_NOT_FINITE = re.compile(rb"(?<![\"\w])-?(NaN|Infinity)(?![\"\w])")
_KEY_END = re.compile(rb'"[ \t\r]*:')
_RAW = msgspec.json.Decoder(msgspec.Raw)
_RAW_VALUES = msgspec.json.Decoder(dict[str, msgspec.Raw])


def first_bad(
    part: Part, schema: Schema, stamped: bool | None, decoder: Any, message: str, pauses: Pauses
) -> WireError:
    """The first line of ``part`` that is no sample of ``schema``, and why. ``stamped``: whether
    samples before it bring no available times. ``message`` is what ``decoder`` said of the part."""
    for number, line in part.lines():
        pauses.breathe()
        try:
            error = _error_of(line, number, schema, stamped)
        except RecursionError:
            hint = "values of a sample are plain"
            return WireError(number, "the line is nested too deeply", hint)
        if error is not None:
            return error
        if stamped is None:
            stamped = "available" not in msgspec.json.decode(line)
    # What the decoder says stands in its own words: `Number out of range - at `$[...]``. It takes
    # fewer characters for blanks than who looks for lines, which are none then.
    for line in part.data.split(b"\n"):
        pauses.breathe()
        try:
            decoder.decode_lines(line)
        except NO_JSON as error:
            return WireError(None, _words(str(error)), ONE_A_LINE)
    return WireError(None, _words(message), ONE_A_LINE)


def key_twice(line: bytes, keys: int) -> str | None:
    """A key that ``line``, a sample with all its ``keys``, has twice. JSON parsers differ in which
    of the two they take."""
    if len(_KEY_END.findall(line)) > keys:
        seen: set[str] = set()
        for key, _ in json.loads(line, object_pairs_hook=list):
            if key in seen:
                return str(key)
            seen.add(key)
    return None


def mixed_times(line: int) -> WireError:
    """Available times in some samples and not in others."""
    return WireError(
        line,
        "'available' is in some samples and not in others",
        "send it with every sample, or with none to have them stamped on arrival",
    )


def values_of(line: bytes) -> Any:
    """What ``line`` says; raises `NO_JSON`. What is nested in a long one is left as it is."""
    if len(line) <= _LONG:
        return msgspec.json.decode(line)
    _RAW.decode(line)
    if line.lstrip()[:1] != b"{":
        return msgspec.Raw(line.strip())
    return {name: _value(raw) for name, raw in _RAW_VALUES.decode(line).items()}


def _value(raw: msgspec.Raw) -> Any:
    return raw if bytes(raw)[:1] in (b"[", b"{") else msgspec.json.decode(raw)


def _words(message: str) -> str:
    return message.partition(" - at `")[0]


def _error_of(line: bytes, number: int, schema: Schema, stamped: bool | None) -> WireError | None:
    try:
        values = values_of(line)
    except msgspec.ValidationError:  # the one limit of plain JSON: 1e999
        return WireError(number, "a number is larger than a float holds", "send null for no value")
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        if _NOT_FINITE.search(line):
            return WireError(
                number, "NaN and Infinity are no JSON numbers", "send null for no value"
            )
        return WireError(number, not_json(error), ONE_A_LINE)
    if not isinstance(values, dict):
        return WireError(number, f"a sample is a JSON object, got {shown(values)}", ONE_A_LINE)
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
    twice = key_twice(line, len(values))
    if twice is not None:
        return WireError(number, f"{twice!r} is there twice", "a sample has a key once")
    for field in schema.fields:
        if field.type is FieldType.INTEGER and not _is_within(values[field.name]):
            return WireError(
                number,
                f"field {field.name!r} is outside 64 bits: {shown(values[field.name])}",
                "integers have 64 bits: declare the field as float, or as string",
            )
    if stamped is not None and ("available" not in values) is not stamped:
        return mixed_times(number)
    return None


def _is_within(value: Any) -> bool:
    return value is None or -(2**63) <= value < 2**63


def _fits(type: FieldType, value: object) -> bool:
    if value is None:
        return True
    if isinstance(value, bool):
        return type is FieldType.BOOLEAN
    if type is FieldType.FLOAT:
        return isinstance(value, float | int)
    return isinstance(value, PYTHON_TYPES[type])


def _a(type: FieldType) -> str:
    return f"an {type}" if type is FieldType.INTEGER else f"a {type}"
