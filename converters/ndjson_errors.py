"""Errors of NDJSON: the first bad line of a part, and its cause."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable
from typing import Any, Final

import msgspec

from ..streams.sample import TIME_FIELDS, FieldType, Schema
from .errors import WireError
from .wire import not_json, shown, time_of

ONE_A_LINE: Final = "send one JSON object a line"
PYTHON_TYPES: Final[dict[FieldType, Any]] = {
    FieldType.FLOAT: float,
    FieldType.INTEGER: int,
    FieldType.BOOLEAN: bool,
    FieldType.STRING: str,
}
NO_JSON: Final = (msgspec.MsgspecError, UnicodeDecodeError, RecursionError)
"""Exceptions of msgspec's decoders for a bad line."""
_LONG: Final = 1 << 16
"""Bytes of a line up to which nested values are decoded: a longer one may hold a million."""
_NOT_FINITE = re.compile(rb"(?<![\"\w])-?(NaN|Infinity)(?![\"\w])")
_KEY_END = re.compile(rb'"[ \t\r]*:')
_RAW = msgspec.json.Decoder(msgspec.Raw)
_RAW_VALUES = msgspec.json.Decoder(dict[str, msgspec.Raw])


def first_error(
    lines: Iterable[tuple[int, bytes]],
    schema: Schema,
    stamped: bool | None,
    decoder: Any,
) -> WireError:
    """The error of the first bad line among ``lines``, which have their numbers. ``stamped`` is
    whether samples before them lack available times, ``decoder`` the one that reads samples.

    Contract: one of the lines is bad.
    """
    for number, line in lines:
        try:
            values = _check(line, number, schema, stamped)
            decoder.decode(line)
        except WireError as error:
            return error
        except RecursionError:
            return _too_deep(number)
        except NO_JSON as error:  # in the decoder's own words: `Number out of range - at `$[...]``
            return WireError(number, str(error).partition(" - at `")[0], ONE_A_LINE)
        stamped = "available" not in values
    raise AssertionError("no line of the part is bad")


def object_of(line: bytes, number: int) -> dict[str, Any]:
    """The JSON object of line ``number``; raises `WireError`. Nested values of a long line stay
    raw."""
    try:
        values = _values_of(line)
    except RecursionError:
        raise _too_deep(number) from None
    except msgspec.ValidationError:  # the one limit of plain JSON: 1e999
        hint = "send null for no value"
        raise WireError(number, "a number is larger than a float holds", hint) from None
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        if _NOT_FINITE.search(line):
            hint = "send null for no value"
            raise WireError(number, "NaN and Infinity are no JSON numbers", hint) from None
        raise WireError(number, not_json(error), ONE_A_LINE) from None
    if not isinstance(values, dict):
        raise WireError(number, f"a sample is a JSON object, got {shown(values)}", ONE_A_LINE)
    return values


def repeated_key(line: bytes, keys: int) -> str | None:
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


def _values_of(line: bytes) -> Any:
    if len(line) <= _LONG:
        return msgspec.json.decode(line)
    _RAW.decode(line)
    if line.lstrip()[:1] != b"{":
        return msgspec.Raw(line.strip())
    return {name: _value(raw) for name, raw in _RAW_VALUES.decode(line).items()}


def _value(raw: msgspec.Raw) -> Any:
    return raw if bytes(raw)[:1] in (b"[", b"{") else msgspec.json.decode(raw)


def _too_deep(line: int) -> WireError:
    return WireError(line, "the line is nested too deeply", "values of a sample are plain")


def _check(line: bytes, number: int, schema: Schema, stamped: bool | None) -> dict[str, Any]:
    """The values of a good line; raises `WireError` for a bad one."""
    values = object_of(line, number)
    for name in ("valid", *schema.names):
        if name not in values:
            hint = (
                "every sample has its valid time"
                if name == "valid"
                else "send null for a field without value"
            )
            raise WireError(number, f"{name!r} is missing", hint)
    for name in values:
        if name not in TIME_FIELDS and schema.get(name) is None:
            raise WireError(
                number, f"{name!r} is not declared", f"the fields are {', '.join(schema.names)}"
            )
    for key in TIME_FIELDS:
        if key in values:
            time_of(values[key], key, number)
    for field in schema.fields:
        if not _fits(field.type, values[field.name]):
            raise WireError(
                number, f"field {field.name!r} is {_a(field.type)}, got {shown(values[field.name])}"
            )
    twice = repeated_key(line, len(values))
    if twice is not None:
        raise WireError(number, f"{twice!r} is there twice", "a sample has a key once")
    for field in schema.fields:
        if field.type is FieldType.INTEGER and not _is_within(values[field.name]):
            raise WireError(
                number,
                f"field {field.name!r} is outside 64 bits: {shown(values[field.name])}",
                "integers have 64 bits: declare the field as float, or as string",
            )
    if stamped is not None and ("available" not in values) is not stamped:
        raise mixed_times(number)
    return values


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
