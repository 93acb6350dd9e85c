"""Lines of N-Triples and N-Quads, cut into terms by compiled loops; see `cells` and `ntriples`.

The loops only find the begin and end of each term. pyoxigraph's parser checks each distinct
spelling once; the loops read plain numbers only.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...rdf.timed import Kind
from ...streams.jit import Kernel
from ..cells import (
    AT,
    BACKSLASH,
    CARET,
    CR,
    GREATER,
    HASH,
    LESS,
    LF,
    MINUS,
    NINE,
    POINT,
    QUOTE,
    SPACE,
    TAB,
    UNDERSCORE,
    ZERO,
    Bytes,
    Irregular,
    Positions,
)

DATATYPES = (
    (b"integer", Kind.INTEGER),
    (b"decimal", Kind.DECIMAL),
    (b"float", Kind.FLOAT),
    (b"double", Kind.DOUBLE),
    (b"boolean", Kind.BOOLEAN),
)
_XSD = b'"^^<http://www.w3.org/2001/XMLSchema#'
SURE, LOOK = 0, 1
"""Of a number: its spelling is canonical (`rdf.timed.make_term`), or the caller must compare."""


def _statements(data: Any, starts: Any, ends: Any, lines: Any, quads: bool) -> int:
    """Find the bytes of terms: ``starts[k, row]`` to ``ends[k, row]``, k = 0 to 3 for subject,
    predicate, object and graph (empty if absent), and the line. Returns the number of rows; ``-1``
    for lines that it cannot read."""
    size = data.shape[0]
    rows = 0
    line = 1
    i = 0
    while True:
        # Between statements: blanks, ends of lines, comments.
        while i < size:
            byte = data[i]
            if byte == LF:
                line += 1
            elif byte == HASH:
                while i < size and data[i] != LF and data[i] != CR:
                    i += 1
                continue
            elif byte != SPACE and byte != TAB and byte != CR:
                break
            i += 1
        if i == size:
            return rows
        if rows == starts.shape[1]:
            return -1
        lines[rows] = line
        place = 0
        starts[3, rows] = 0
        ends[3, rows] = 0
        while True:
            while i < size and (data[i] == SPACE or data[i] == TAB):
                i += 1
            if i == size:
                return -1
            byte = data[i]
            if byte == POINT and place >= 3:
                i += 1
                break
            if place == 4 or (place == 3 and not quads):
                return -1
            starts[place, rows] = i
            if byte == QUOTE and place == 2:
                i += 1
                while i < size and data[i] != QUOTE and data[i] != LF and data[i] != CR:
                    # An escaped quote does not end the text.
                    i += 1 + (data[i] == BACKSLASH and i + 1 < size and data[i + 1] > 31)
                if i >= size or data[i] != QUOTE:
                    return -1
                i += 1
                if i < size and data[i] == AT:
                    i += 1
                    while i < size and (
                        97 <= data[i] <= 122
                        or 65 <= data[i] <= 90
                        or ZERO <= data[i] <= NINE
                        or data[i] == MINUS
                    ):
                        i += 1
                elif i + 2 < size and data[i] == CARET:
                    if data[i + 1] != CARET or data[i + 2] != LESS:
                        return -1
                    i += 3
                    while i < size and data[i] != GREATER and data[i] > SPACE:
                        i += 1
                    if i == size or data[i] != GREATER:
                        return -1
                    i += 1
            elif byte == LESS:
                while i < size and data[i] != GREATER and data[i] > SPACE:
                    i += 1
                if i == size or data[i] != GREATER:
                    return -1
                i += 1
            elif byte == UNDERSCORE and place != 1:
                # A label may contain dots but not end in one: a blank must follow.
                while i < size and data[i] > SPACE:
                    if data[i] == HASH:
                        return -1  # the statement ends before a comment
                    i += 1
            else:
                return -1
            ends[place, rows] = i
            place += 1
        # One statement a line.
        while i < size and (data[i] == SPACE or data[i] == TAB):
            i += 1
        if i < size and data[i] != LF and data[i] != CR and data[i] != HASH:
            return -1
        rows += 1


def _numbers(
    data: Any,
    starts: Any,
    ends: Any,
    xsd: Any,
    names: Any,
    offsets: Any,
    kinds: Any,
    ends_of_text: Any,
    sure: Any,
) -> int:
    """Find the objects that are plain numbers or booleans: ``kinds[row]`` (else 0), and the end of
    their text.

    A plain number has no plus sign, no leading zero, no zero at the end of a fraction, no exponent.
    With up to 15 digits and from 0.0001 on that is the canonical spelling, because no two such
    texts have the same float64. With 16 or 17 digits the caller must compare.
    """
    count = 0
    prefix = xsd.shape[0]
    for row in range(starts.shape[0]):
        kinds[row] = 0
        start = starts[row]
        end = ends[row]
        if data[start] != QUOTE or end - start < prefix + 6 or data[end - 1] != GREATER:
            continue
        # A plain number has its closing quote within 32 bytes; its datatype follows.
        quote = start + 1
        while quote < end and data[quote] != QUOTE and quote - start < 32:
            quote += 1
        if end - quote < prefix + 6:
            continue
        k = 0
        while k < prefix and data[quote + k] == xsd[k]:
            k += 1
        if k < prefix:
            continue
        name = quote + prefix
        kind = 0
        for j in range(offsets.shape[0] - 1):
            length = offsets[j + 1] - offsets[j]
            if end - 1 - name == length:
                k = 0
                while k < length and data[name + k] == names[offsets[j] + k]:
                    k += 1
                if k == length:
                    kind = j + 1
        i = start + 1
        if kind == 0:
            continue
        if kind == 5:
            length = quote - i
            truth = length == 4 and data[i] == 116 and data[i + 1] == 114
            truth = truth and data[i + 2] == 117 and data[i + 3] == 101
            lie = length == 5 and data[i] == 102 and data[i + 1] == 97 and data[i + 2] == 108
            lie = lie and data[i + 3] == 115 and data[i + 4] == 101
            if not (truth or lie):
                continue
            kinds[row] = kind
            ends_of_text[row] = quote
            count += 1
            continue
        if data[i] == MINUS:
            i += 1
        first = i
        digits = 0
        while i < quote and ZERO <= data[i] <= NINE:
            digits += digits > 0 or data[i] != ZERO
            i += 1
        if i == first or (data[first] == ZERO and i > first + 1):
            continue
        small = False
        if i < quote:
            if kind == 1 or data[i] != POINT:
                continue
            i += 1
            point = i
            while i < quote and ZERO <= data[i] <= NINE:
                digits += digits > 0 or data[i] != ZERO
                i += 1
            if i < quote or i == point or data[i - 1] == ZERO:
                continue
            k = point
            while data[k] == ZERO:
                k += 1
            small = data[first] == ZERO and k - point > 3
        if digits == 0 and data[start + 1] == MINUS:
            continue
        if digits > 17 or small:
            continue
        kinds[row] = kind
        ends_of_text[row] = quote
        sure[row] = 0 if digits <= 15 or kind == 1 else 1
        count += 1
    return count


def _statements_signature() -> Any:
    from numba import types

    data = types.Array(types.uint8, 1, "C", readonly=True)
    places = types.int32[:, ::1]
    return types.int64(data, places, places, types.int32[::1], types.boolean)


def _numbers_signature() -> Any:
    from numba import types

    data = types.Array(types.uint8, 1, "C", readonly=True)
    places, flags = types.int32[::1], types.int8[::1]
    return types.int64(data, places, places, data, data, types.int64[::1], flags, places, flags)


_statements_kernel = Kernel(_statements, _statements_signature)
_numbers_kernel = Kernel(_numbers, _numbers_signature)
_NAMES = np.frombuffer(b"".join(name for name, _ in DATATYPES), np.uint8)
_OFFSETS = np.cumsum([0, *(len(name) for name, _ in DATATYPES)], dtype=np.int64)


def statements(
    data: Bytes, most: int, *, quads: bool
) -> tuple[NDArray[np.int32], NDArray[np.int32], Positions]:
    """``starts, ends`` of shape ``(4, n)`` and the line of each statement, at most ``most``; raises
    `Irregular`."""
    starts, ends = np.empty((4, most), np.int32), np.empty((4, most), np.int32)
    lines = np.empty(most, np.int32)
    rows = _statements_kernel(data, starts, ends, lines, quads)
    if rows < 0:
        raise Irregular
    # The loops take contiguous columns only.
    return starts[:, :rows].copy(), ends[:, :rows].copy(), lines[:rows]


def numbers(
    data: Bytes, starts: Positions, ends: Positions
) -> tuple[NDArray[np.int8], Positions, NDArray[np.int8]]:
    """For each object: the place in `DATATYPES` counted from 1 (0: no plain number), the end of the
    text between the quotes, and `SURE` or `LOOK`."""
    count = len(starts)
    kinds, sure = np.empty(count, np.int8), np.zeros(count, np.int8)
    until = np.empty(count, np.int32)
    xsd = np.frombuffer(_XSD, np.uint8)
    _numbers_kernel(data, starts, ends, xsd, _NAMES, _OFFSETS, kinds, until, sure)
    return kinds, until, sure
