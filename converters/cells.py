"""Cells of a text, read by compiled loops: integers, booleans, times, distinct texts.

A *cell* is the bytes of one value, ``start <= position < end``; a column of cells is two int32
arrays of shape ``(n,)``. A loop reads only unambiguous spellings and returns ``-1`` for all others.
The caller then decodes the whole text by its exact path, which also makes the errors, so that a
loop affects speed only. Callers use the exact path alone where loops are not compiled (`JIT`).

`decimals` reads numbers with fractions. Used by `ndjson_scan` and `ntriples`. Cost: 1 to 2 ns a
byte.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..streams.jit import Kernel

LEAST = 4_096
"""Bytes of a text from which the loops pay off; no loop is compiled for a shorter one."""
TAB, LF, CR, SPACE = b"\t\n\r "
QUOTE, HASH, PLUS, COMMA, MINUS, POINT, ZERO, NINE = b'"#+,-.09'
COLON, LESS, GREATER, AT, BACKSLASH, CARET, UNDERSCORE, OPEN, CLOSE = b":<>@\\^_{}"
Bytes = NDArray[np.uint8]
Positions = NDArray[np.int32]


def _integers(data: Any, starts: Any, ends: Any, values: Any, null: Any) -> int:
    """Read JSON integers within 64 bits; returns the number of nulls, ``-1`` for other cells."""
    nulls = 0
    for row in range(starts.shape[0]):
        i = starts[row]
        end = ends[row]
        null[row] = False
        if data[i] == 110:
            if end - i != 4 or data[i + 1] != 117 or data[i + 2] != 108 or data[i + 3] != 108:
                return -1
            null[row] = True
            values[row] = 0
            nulls += 1
            continue
        negative = data[i] == MINUS
        if negative:
            i += 1
        if i == end or end - i > 19 or (data[i] == ZERO and end - i > 1):
            return -1
        value = np.uint64(0)
        while i < end:
            if data[i] < ZERO or data[i] > NINE:
                return -1
            value = value * np.uint64(10) + np.uint64(data[i] - ZERO)
            i += 1
        if value > np.uint64(2**63 - 1):
            return -1
        values[row] = -np.int64(value) if negative else np.int64(value)
    return nulls


def _booleans(data: Any, starts: Any, ends: Any, values: Any, null: Any) -> int:
    """Read ``true``, ``false`` and ``null``; returns the number of nulls, ``-1`` for others."""
    nulls = 0
    for row in range(starts.shape[0]):
        i = starts[row]
        length = ends[row] - i
        null[row] = False
        values[row] = False
        if length == 4 and data[i + 1] == 114:
            if data[i] != 116 or data[i + 2] != 117 or data[i + 3] != 101:
                return -1
            values[row] = True
        elif length == 4:
            if data[i] != 110 or data[i + 1] != 117 or data[i + 2] != 108 or data[i + 3] != 108:
                return -1
            null[row] = True
            nulls += 1
        elif (
            length != 5
            or data[i] != 102
            or data[i + 1] != 97
            or data[i + 2] != 108
            or data[i + 3] != 115
            or data[i + 4] != 101
        ):
            return -1
    return nulls


def _times(data: Any, starts: Any, ends: Any, values: Any) -> int:
    """Read quoted ISO-8601 times in UTC, years 1900 to 2199, as ns; ``-1`` for other cells.

    ``"YYYY-MM-DDThh:mm:ssZ"``, with up to nine digits of a fraction.
    """
    for row in range(starts.shape[0]):
        i = starts[row] + 1
        end = ends[row] - 1  # at the closing quote
        if end - i < 20 or data[i - 1] != QUOTE or data[end] != QUOTE or data[end - 1] != 90:
            return -1
        for k in range(19):
            byte = data[i + k]
            if k == 4 or k == 7:
                if byte != MINUS:
                    return -1
            elif k == 10:
                if byte != 84:
                    return -1
            elif k == 13 or k == 16:
                if byte != COLON:
                    return -1
            elif byte < ZERO or byte > NINE:
                return -1
        year = np.int64(data[i] - ZERO) * 1000 + np.int64(data[i + 1] - ZERO) * 100
        year += np.int64(data[i + 2] - ZERO) * 10 + np.int64(data[i + 3] - ZERO)
        month = np.int64(data[i + 5] - ZERO) * 10 + np.int64(data[i + 6] - ZERO)
        day = np.int64(data[i + 8] - ZERO) * 10 + np.int64(data[i + 9] - ZERO)
        hour = np.int64(data[i + 11] - ZERO) * 10 + np.int64(data[i + 12] - ZERO)
        minute = np.int64(data[i + 14] - ZERO) * 10 + np.int64(data[i + 15] - ZERO)
        second = np.int64(data[i + 17] - ZERO) * 10 + np.int64(data[i + 18] - ZERO)
        leap = year % 4 == 0 and (year % 100 != 0 or year % 400 == 0)
        length = 31 - (month == 4 or month == 6 or month == 9 or month == 11)
        if month == 2:
            length = 28 + leap
        if not (1900 <= year < 2200 and 1 <= month <= 12 and 1 <= day <= length):
            return -1
        if hour > 23 or minute > 59 or second > 59:
            return -1
        fraction = 0
        if end - i > 20:
            if data[i + 19] != POINT or end - i == 21 or end - i > 30:
                return -1
            for k in range(i + 20, i + 29):
                fraction *= 10
                if k < end - 1:
                    if data[k] < ZERO or data[k] > NINE:
                        return -1
                    fraction += int(data[k] - ZERO)
        # Count years from March, so that a leap day is the last of its year.
        y = year - (month <= 2)
        days = 365 * y + y // 4 - y // 100 + y // 400
        days += (153 * ((month + 9) % 12) + 2) // 5 + day - 719469
        seconds = ((days * 24 + hour) * 60 + minute) * 60 + second
        values[row] = seconds * 1_000_000_000 + fraction
    return 0


def _distinct(
    data: Any, starts: Any, ends: Any, table: Any, hashes: Any, codes: Any, first: Any
) -> int:
    """Number the distinct cells in order of appearance: ``codes`` by row, ``first`` row by code.

    Empty cells (``end <= start``) get code 0 and do not count. ``table`` is scratch: -1 everywhere,
    a power of 2 of slots, more than twice the rows. Returns the number of distinct cells; ``-1``
    after a thousand taken slots in a row, which only texts made for collisions reach.
    """
    mask = np.int64(table.shape[0] - 1)
    count = 0
    prime = np.uint64(0x100000001B3)
    for row in range(starts.shape[0]):
        start = starts[row]
        end = ends[row]
        codes[row] = 0
        if end <= start:
            continue
        # FNV-1a in four lanes: a multiplication waits for the one before.
        h0 = np.uint64(0xCBF29CE484222325)
        h1 = np.uint64(0x9E3779B97F4A7C15)
        h2 = np.uint64(0xC2B2AE3D27D4EB4F)
        h3 = np.uint64(end - start)
        i = start
        while i + 4 <= end:
            h0 = (h0 ^ np.uint64(data[i])) * prime
            h1 = (h1 ^ np.uint64(data[i + 1])) * prime
            h2 = (h2 ^ np.uint64(data[i + 2])) * prime
            h3 = (h3 ^ np.uint64(data[i + 3])) * prime
            i += 4
        while i < end:
            h0 = (h0 ^ np.uint64(data[i])) * prime
            i += 1
        h = (h0 ^ (h1 >> np.uint64(7))) * prime
        h = (h ^ h2 ^ (h3 << np.uint64(11))) * prime
        h ^= h >> np.uint64(29)
        slot = np.int64(h) & mask
        probes = 0
        while True:
            code = table[slot]
            if code < 0:
                table[slot] = count
                hashes[count] = h
                first[count] = row
                codes[row] = count
                count += 1
                break
            if hashes[code] == h:
                other = starts[first[code]]
                length = end - start
                if ends[first[code]] - other == length:
                    k = 0
                    while k < length and data[other + k] == data[start + k]:
                        k += 1
                    if k == length:
                        codes[row] = code
                        break
            probes += 1
            if probes > 1000:
                return -1
            slot = (slot + 1) & mask
    return count


def _signature(kind: str) -> Any:
    def make() -> Any:
        from numba import types

        data = types.Array(types.uint8, 1, "C", readonly=True)
        cells = (data, types.int32[::1], types.int32[::1])
        flags, integers = types.boolean[::1], types.int64[::1]
        match kind:
            case "integers":
                return types.int64(*cells, integers, flags)
            case "booleans":
                return types.int64(*cells, flags, flags)
            case "times":
                return types.int64(*cells, integers)
            case _:
                codes = types.int32[::1]
                return types.int64(*cells, codes, types.uint64[::1], codes, codes)

    return make


_integers_kernel = Kernel(_integers, _signature("integers"))
_booleans_kernel = Kernel(_booleans, _signature("booleans"))
_times_kernel = Kernel(_times, _signature("times"))
_distinct_kernel = Kernel(_distinct, _signature("distinct"))


class Irregular(Exception):
    """A cell that the loops cannot read: the caller takes the exact path."""


Values = tuple[NDArray[Any], NDArray[np.bool_] | None]
"""A column and where it is null (None: nowhere)."""


def integers(data: Bytes, starts: Positions, ends: Positions) -> Values:
    """JSON integers and nulls as int64; raises `Irregular`, as do the functions below."""
    values, null = np.empty(len(starts), np.int64), np.empty(len(starts), np.bool_)
    nulls = checked_count(_integers_kernel(data, starts, ends, values, null))
    return values, null if nulls else None


def booleans(data: Bytes, starts: Positions, ends: Positions) -> Values:
    """JSON booleans and nulls as bool."""
    values, null = np.empty(len(starts), np.bool_), np.empty(len(starts), np.bool_)
    nulls = checked_count(_booleans_kernel(data, starts, ends, values, null))
    return values, null if nulls else None


def times(data: Bytes, starts: Positions, ends: Positions) -> NDArray[np.int64]:
    """Quoted ISO-8601 times in UTC, as ns."""
    values = np.empty(len(starts), np.int64)
    checked_count(_times_kernel(data, starts, ends, values))
    return values


def distinct(
    data: Bytes, starts: Positions, ends: Positions
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """``codes, first``: equal cells have equal codes, numbered from 0 in order of appearance; code
    c appears first in row ``first[c]``. An empty cell has code 0 and does not count."""
    count = len(starts)
    table = np.full(1 << (2 * count).bit_length(), -1, np.int32)
    hashes = np.empty(count, np.uint64)
    codes, first = np.empty(count, np.int32), np.empty(count, np.int32)
    met = checked_count(_distinct_kernel(data, starts, ends, table, hashes, codes, first))
    return codes, first[:met]


def checked_count(found: int) -> int:
    """The return value of a loop; raises `Irregular` for ``-1``."""
    if found < 0:
        raise Irregular
    return found
