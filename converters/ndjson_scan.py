"""NDJSON with regular lines: the fast path, a compiled scan into columns.

A regular line has the declared fields, each key once and without escapes, in any order and with any
blanks. Its values have the field's type in a spelling that `cells` reads; texts have no escapes;
times are integers or ISO-8601 in UTC. `ndjson_lines` decodes every other body, good or bad. Called
by `ndjson` only.

Law (tests/laws): the result is None or equals that of `ndjson_lines`, codes of pools included.
"""

from __future__ import annotations

from typing import Any, NamedTuple, assert_never

import numpy as np

from ..streams.jit import JIT, Kernel
from ..streams.sample import (
    Column,
    FieldType,
    Mask,
    SampleBatch,
    Schema,
    Times,
)
from ..streams.string_pool import StringPool
from . import cells
from .cells import BACKSLASH, CLOSE, COLON, COMMA, CR, LF, OPEN, QUOTE, SPACE, TAB
from .decimals import floats
from .wire import Incoming, pool_of

_LONGEST_BODY = 2**31 - 1
"""Bytes that 32-bit positions can address."""


def _tokens(
    data: Any, keys: Any, offsets: Any, starts: Any, ends: Any, order: Any, seen: Any
) -> tuple[int, bool]:
    """Find the bytes of each value: ``starts[field, row]`` to ``ends[field, row]``, with quotes.

    ``keys[offsets[k]:offsets[k + 1]]`` is the name of field k. The last two fields are `valid` and
    `available`, which all lines have or none. ``order`` and ``seen`` are scratch: ``order[p]`` is
    the field at place p of the line before, ``seen[k]`` the last row with field k. Returns the
    number of rows and whether `available` is missing; ``-1`` for irregular lines.
    """
    size = data.shape[0]
    fields = offsets.shape[0] - 1
    rows = 0
    expected = -1
    stamped = True
    i = 0
    while i < size:
        # A line begins; blank lines are skipped.
        while i < size and (data[i] == SPACE or data[i] == TAB or data[i] == CR or data[i] == LF):
            i += 1
        if i == size:
            break
        if data[i] != OPEN or rows == starts.shape[1]:
            return -1, False
        i += 1
        place = 0
        while True:
            while i < size and (data[i] == SPACE or data[i] == TAB):
                i += 1
            if i == size or data[i] != QUOTE or place == fields:
                return -1, False
            i += 1
            # Try the key at this place of the line before first, then all others.
            field = order[place]
            for attempt in range(fields + 1):
                if attempt > 0:
                    field = attempt - 1
                length = offsets[field + 1] - offsets[field]
                k = 0
                if i + length < size:
                    while k < length and data[i + k] == keys[offsets[field] + k]:
                        k += 1
                    if k == length and data[i + k] == QUOTE:
                        break
                if attempt == fields:
                    return -1, False
            if seen[field] == rows:
                return -1, False
            seen[field] = rows
            order[place] = field
            i += offsets[field + 1] - offsets[field] + 1
            while i < size and (data[i] == SPACE or data[i] == TAB):
                i += 1
            if i == size or data[i] != COLON:
                return -1, False
            i += 1
            while i < size and (data[i] == SPACE or data[i] == TAB):
                i += 1
            if i == size:
                return -1, False
            starts[field, rows] = i
            if data[i] == QUOTE:
                i += 1
                while i < size and data[i] != QUOTE and data[i] != BACKSLASH and data[i] >= SPACE:
                    i += 1
                if i == size or data[i] != QUOTE:
                    return -1, False
                i += 1
            else:
                # `cells` checks the characters of a number or literal.
                while i < size and data[i] > SPACE and data[i] != COMMA and data[i] != CLOSE:
                    i += 1
                if i == starts[field, rows]:
                    return -1, False
            ends[field, rows] = i
            place += 1
            while i < size and (data[i] == SPACE or data[i] == TAB):
                i += 1
            if i == size:
                return -1, False
            if data[i] == COMMA:
                i += 1
            elif data[i] == CLOSE:
                i += 1
                break
            else:
                return -1, False
        if rows == 0:
            stamped = seen[fields - 1] != 0
            expected = fields - stamped
        if place != expected or (stamped and seen[fields - 1] == rows):
            return -1, False
        # The rest of the line is blank.
        while i < size and (data[i] == SPACE or data[i] == TAB or data[i] == CR):
            i += 1
        if i < size and data[i] != LF:
            return -1, False
        rows += 1
    return rows, stamped


def _signature() -> Any:
    from numba import types

    data = types.Array(types.uint8, 1, "C", readonly=True)
    offsets, places = types.int64[::1], types.int32[:, ::1]
    found: Any = types.Tuple
    return found((types.int64, types.boolean))(
        data, data, offsets, places, places, offsets, offsets
    )


_tokens_kernel = Kernel(_tokens, _signature)


def scan_lines(
    raw: bytes,
    schema: Schema,
    pools: dict[str, StringPool],
    least: int = cells.LEAST,
) -> Incoming | None:
    """Decode as `decode_ndjson`, or return None for irregular lines and for fewer bytes than
    ``least``; ``pools`` are then unchanged.

    Cost: about 3 ns a byte, nearly all in compiled loops, and Python once per distinct text.
    """
    if not JIT or not least <= len(raw) <= _LONGEST_BODY:
        return None
    try:
        return _decode(raw, schema, pools)
    except (cells.Irregular, UnicodeDecodeError):
        return None


def _decode(raw: bytes, schema: Schema, pools: dict[str, StringPool]) -> Incoming | None:
    data = np.frombuffer(raw, np.uint8)
    names = [name.encode() for name in (*schema.names, "valid", "available")]
    if any(b < 32 or b in b'"\\' for name in names for b in name):
        return None
    offsets = np.cumsum([0, *map(len, names)], dtype=np.int64)
    keys = np.frombuffer(b"".join(names), np.uint8)
    # The shortest line has two braces, and per key but `available` a name, four signs, a value.
    shortest = 2 + int(offsets[-2]) + 5 * (len(names) - 1) - 1
    shape = (len(names), min(int(np.count_nonzero(data == LF)), len(raw) // shortest) + 1)
    starts, ends = np.empty(shape, np.int32), np.empty(shape, np.int32)
    order = np.arange(len(names), dtype=np.int64)
    seen = np.full(len(names), -1, np.int64)
    rows, stamped = _tokens_kernel(data, keys, offsets, starts, ends, order, seen)
    if rows <= 0:
        return None
    fields = len(schema.fields)
    available = valid = _time(data, starts[fields, :rows], ends[fields, :rows])
    if not stamped:
        available = _time(data, starts[fields + 1, :rows], ends[fields + 1, :rows])
    columns: dict[str, Column] = {}
    texts: dict[str, _Texts] = {}
    for k, field in enumerate(schema.fields):
        column = data, starts[k, :rows], ends[k, :rows]
        match field.type:
            case FieldType.FLOAT:
                columns[field.name] = Column(field.type, *floats(*column))
            case FieldType.INTEGER:
                columns[field.name] = Column(field.type, *cells.integers(*column))
            case FieldType.BOOLEAN:
                columns[field.name] = Column(field.type, *cells.booleans(*column))
            case FieldType.STRING:
                texts[field.name] = _texts(raw, *column)
            case _:
                assert_never(field.type)
    # The pools grow only now, because every column is good.
    for field in schema.fields:
        if field.type is FieldType.STRING:
            columns[field.name] = texts.pop(field.name).column(pool_of(field, pools))
    ordered = {name: columns[name] for name in schema.names}
    return Incoming(SampleBatch(available, valid, ordered), bool(stamped))


def _time(data: cells.Bytes, starts: cells.Positions, ends: cells.Positions) -> Times:
    if data[starts[0]] == ord('"'):
        return cells.times(data, starts, ends)
    values, null = cells.integers(data, starts, ends)
    if null is not None:
        raise cells.Irregular
    return values


class _Texts(NamedTuple):
    """A column of texts: ``codes`` of its distinct cells by row and where they are ``null``; by
    code, whether the cell is a text; the texts in order of their codes."""

    codes: cells.Positions
    null: Mask | None
    is_text: Mask
    strings: list[str]

    def column(self, pool: StringPool) -> Column:
        """The column in codes of ``pool``, which gets the texts that it lacks."""
        found = np.zeros(len(self.is_text), np.int32)
        found[self.is_text] = pool.encode(self.strings)
        return Column(FieldType.STRING, found[self.codes], self.null, pool)


def _texts(raw: bytes, data: cells.Bytes, starts: cells.Positions, ends: cells.Positions) -> _Texts:
    codes, first = cells.distinct(data, starts, ends)
    starts, ends = starts[first], ends[first]
    is_text = data[starts] == ord('"')
    others = np.flatnonzero(~is_text)
    null = None
    if len(others):
        if len(others) > 1 or raw[starts[others[0]] : ends[others[0]]] != b"null":
            raise cells.Irregular
        null = codes == others[0]
    places = zip((starts[is_text] + 1).tolist(), (ends[is_text] - 1).tolist(), strict=True)
    texts = [raw[start:end] for start, end in places]
    # Texts hold no line feed, so that one call decodes all of them.
    strings = b"\n".join(texts).decode().split("\n") if texts else []
    return _Texts(codes, null, is_text, strings)
