"""The fields of an open stream, which its first batch decides (docs/conversion.md)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import msgspec

from ..streams.sample import TIME_FIELDS, Field, FieldType, Schema
from ..streams.yield_points import STRAIGHT, Pauses
from .errors import WireError
from .lines import PART, Part, parts
from .ndjson_errors import NO_JSON, PYTHON_TYPES, values_of
from .wire import BatchLimits

_PLAIN = str | int | float | bool | None
_ROWS = msgspec.json.Decoder(dict[str, _PLAIN])


def decided_by(
    data: bytes, limits: BatchLimits | None = None, pauses: Pauses = STRAIGHT, size: int = PART
) -> Schema:
    """The fields of the first line, each with the narrowest type that all lines fit.

    What comes after a line that is no sample does not count: that line is told where every line is
    read. Raises `WireError` for more than ``limits`` have, and where a field has no value.
    """
    types: dict[str, set[type]] | None = None
    is_whole = True
    for rows, are_all in _rows(data, size, pauses):
        is_whole = are_all
        if types is None and rows:
            types = {name: set() for name in rows[0] if name not in TIME_FIELDS}
            if limits is not None:
                limits.check_fields(types)
        for name, found in (types or {}).items():
            found.update(type(row.get(name)) for row in rows)
        pauses.breathe()
    for name, found in (types or {}).items():
        found.discard(type(None))
        if not found and is_whole:
            raise WireError(
                None,
                f"field {name!r} has no value anywhere, so its type is not known",
                "declare the fields: PUT /streams/{name}, or a sort in KPL",
            )
    return Schema(tuple(Field(name, _narrowest(found)) for name, found in (types or {}).items()))


def _rows(
    data: bytes, size: int, pauses: Pauses
) -> Iterator[tuple[Sequence[dict[str, Any]], bool]]:
    """The samples of each part, and whether all its lines are some; none after one that is not."""
    for part in parts(data, size):
        try:
            yield _ROWS.decode_lines(part.data), True
        except NO_JSON:
            yield list(_until_bad(part, pauses)), False
            return


def _until_bad(part: Part, pauses: Pauses) -> Iterator[dict[str, Any]]:
    """The samples of a part up to the first line that is none; that one, too, if it has values."""
    for _, line in part.lines():
        pauses.breathe()
        try:
            yield _ROWS.decode(line)
        except NO_JSON:
            break
    else:
        return
    try:
        values = values_of(line)
    except NO_JSON:
        return
    if isinstance(values, dict):
        yield values


def _narrowest(types: set[type]) -> FieldType:
    if types == {int, float}:
        return FieldType.FLOAT
    for kind, python in PYTHON_TYPES.items():
        if types == {python}:
            return kind
    return FieldType.STRING  # lines that are no text are told where every line is read
