"""Decimal texts to the nearest float64, in a compiled loop; see `cells`.

It multiplies the digits by 64 bits of a power of five, after Eisel and Lemire. In the rare cases
where the product does not decide the rounding, Python's ``float`` reads the number.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..streams.jit import Kernel
from .cells import (
    MINUS,
    NINE,
    PLUS,
    POINT,
    ZERO,
    Bytes,
    Irregular,
    Positions,
    Values,
    checked_count,
)

_LEAST_POWER, _GREATEST_POWER = -342, 308


@cache
def _powers() -> tuple[NDArray[np.uint64], NDArray[np.int64]]:
    """The first 64 bits of ``5**q`` (cut, not rounded), their binary exponent, by ``q + 342``."""
    bits, exponents = [], []
    for q in range(_LEAST_POWER, _GREATEST_POWER + 1):
        if q >= 0:
            power, shift = 5**q, 0
        else:
            shift = (5**-q).bit_length() + 64
            power = (1 << shift) // 5**-q
        excess = power.bit_length() - 64
        bits.append(power >> excess if excess >= 0 else power << -excess)
        exponents.append(excess - shift)
    return np.array(bits, np.uint64), np.array(exponents, np.int64)


def _floats(
    data: Any,
    starts: Any,
    ends: Any,
    powers: Any,
    exponents: Any,
    bits: Any,
    null: Any,
    unsure: Any,
) -> tuple[int, int]:
    """Read JSON numbers as the bits of the nearest float64, and mark ``null`` cells.

    ``unsure`` gets the rows whose rounding 128 bits do not decide, and those outside the normal
    numbers or with more than 19 digits. Returns the numbers of nulls and of unsure rows; ``-1`` for
    other cells.

    Law (tests/laws): the bits are those of Python's ``float``. Why: with w the digits' integer,
    shifted to 64 bits, and T <= 5**q·2**k < T + 1, the product lies in [w·T, w·T + w), so that its
    first 64 bits can be greater by at most 1 than those of w·T. That decides the rounding unless
    what is cut off is within 1 of a half.
    """
    nulls = 0
    doubts = 0
    low32 = np.uint64(0xFFFFFFFF)
    half = np.uint64(32)
    one = np.uint64(1)
    for row in range(starts.shape[0]):
        i = starts[row]
        end = ends[row]
        null[row] = False
        if data[i] == 110:  # null
            if end - i != 4 or data[i + 1] != 117 or data[i + 2] != 108 or data[i + 3] != 108:
                return -1, 0
            null[row] = True
            bits[row] = 0
            nulls += 1
            continue
        negative = data[i] == MINUS
        if negative:
            i += 1
        first = i
        digits = 0
        mantissa = np.uint64(0)
        power = 0
        while i < end and ZERO <= data[i] <= NINE:
            mantissa = mantissa * np.uint64(10) + np.uint64(data[i] - ZERO)
            digits += mantissa != 0
            i += 1
        if i == first or (data[first] == ZERO and i > first + 1):
            return -1, 0  # no digit, or a leading zero
        if negative and mantissa == 0 and i == end:
            return -1, 0  # -0: an integer, or a float64 with a sign
        if i < end and data[i] == POINT:
            i += 1
            fraction = i
            while i < end and ZERO <= data[i] <= NINE:
                mantissa = mantissa * np.uint64(10) + np.uint64(data[i] - ZERO)
                digits += mantissa != 0
                i += 1
            if i == fraction:
                return -1, 0
            power = fraction - i
        if i < end and (data[i] == 101 or data[i] == 69):
            i += 1
            lowered = i < end and data[i] == MINUS
            if i < end and (data[i] == MINUS or data[i] == PLUS):
                i += 1
            if i == end or end - i > 4:
                return -1, 0
            exponent = 0
            while i < end and ZERO <= data[i] <= NINE:
                exponent = exponent * 10 + int(data[i] - ZERO)
                i += 1
            power += -exponent if lowered else exponent
        if i != end:
            return -1, 0
        sign = np.int64(-(2**63)) if negative else np.int64(0)
        if digits <= 19 and mantissa == 0:
            bits[row] = sign
            continue
        sure = digits <= 19 and -342 <= power <= 308
        if sure:
            shift = 0
            while mantissa < np.uint64(1 << 48):
                mantissa <<= np.uint64(16)
                shift += 16
            while mantissa < np.uint64(1 << 63):
                mantissa <<= one
                shift += 1
            # 64 x 64 bits, by halves of 32.
            ten = powers[power + 342]
            a, b = mantissa >> half, mantissa & low32
            c, d = ten >> half, ten & low32
            low = b * d
            middle = a * d + (low >> half)
            other = b * c + (middle & low32)
            high = a * c + (middle >> half) + (other >> half)
            cut = np.uint64(10) + (high >> np.uint64(63))
            rest = high & ((one << cut) - one)
            middle_of_rest = one << (cut - one)
            binary = np.int64(64) + exponents[power + 342] + power - shift + np.int64(cut)
            # A normal number, and neither a tie nor so close below that a carry makes it one.
            sure = rest != middle_of_rest and rest != middle_of_rest - one and -1070 < binary < 970
            if sure:
                significand = (high >> cut) + np.uint64(rest > middle_of_rest)
                bits[row] = (
                    ((binary + 1074) << 52) + np.int64(significand)
                ) | sign  # the leading bit adds one to the exponent, a carry another one
        if not sure:
            unsure[doubts] = row
            doubts += 1
    return nulls, doubts


def _signature() -> Any:
    from numba import types

    data = types.Array(types.uint8, 1, "C", readonly=True)
    cells = (data, types.int32[::1], types.int32[::1])
    integers = types.int64[::1]
    pair: Any = types.UniTuple
    return pair(types.int64, 2)(
        *cells, types.uint64[::1], integers, integers, types.boolean[::1], integers
    )


_floats_kernel = Kernel(_floats, _signature)


def floats(data: Bytes, starts: Positions, ends: Positions) -> Values:
    """JSON numbers and nulls as float64; raises `Irregular`."""
    count = len(starts)
    bits, null = np.empty(count, np.int64), np.empty(count, np.bool_)
    unsure = np.empty(count, np.int64)
    found = _floats_kernel(data, starts, ends, *_powers(), bits, null, unsure)
    nulls, doubts = checked_count(found[0]), found[1]
    values = bits.view(np.float64)
    for row in unsure[:doubts].tolist():
        values[row] = float(data[starts[row] : ends[row]].tobytes())
        if not 1e-300 < abs(values[row]) < 1e300:  # the exact path decides about these
            raise Irregular
    return values, null if nulls else None
