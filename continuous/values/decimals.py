"""Exact arithmetic of xsd:decimal and xsd:integer in columns (SPARQL 1.1 §17.3, XPath F&O §4).

A float64 in a DECIMAL column is a *code*: it stands for the shortest decimal that parses to it. So
codes are equal if the decimals are, and have the same order: columns can compare and sort them as
floats. For arithmetic, codes become int64 *mantissas* of a common power of ten, because float
arithmetic would give 0.1 + 0.2 ≠ 0.3. Numbers of more than 15 digits are computed as `Decimal`;
such a number has no code unless it is the shortest decimal of its float64.

A quotient is exact if it has up to 15 significant digits, or up to 18 after the point. Any other is
rounded, half to even, to 15 significant digits, or to an integer if that keeps more.
"""

from __future__ import annotations

import decimal
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from decimal import Decimal
from fractions import Fraction
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

LONGEST: Final = 1000
"""The digits of the longest number with a value: arithmetic beyond is an error."""
EXACT: Final = decimal.Context(
    prec=LONGEST,
    rounding=decimal.ROUND_HALF_EVEN,
    traps=[decimal.Inexact, decimal.InvalidOperation, decimal.DivisionByZero],
)
SCALES: Final = (0, 3, 6, 9, 12, 15, 18)
"""The exponents of mantissas. There are few, since each has a sum of its own."""
DIGITS: Final = 15
LIMIT: Final = 10**DIGITS
"""A mantissa up to here has a code: a decimal of 15 digits is the shortest of its float64."""
_BLOCK: Final = 4096
_PLACES: Final = 18
_SAFE: Final = 2.0**62
_TENS: Final = 10 ** np.arange(19, dtype=np.int64)
POWERS: Final = np.array([float(f"1e{exponent}") for exponent in range(-22, 23)])
"""10**-22 … 10**22. From 10**0 on they are exact floats, so a division by one rounds only once."""
_SMALL: Final = 4096
"""10**15 times a divisor up to here fits int64, so one step divides."""


@dataclass(frozen=True, slots=True, eq=False)
class Mantissas:
    """Decimals as ``values``, int64 of shape ``(n,)``, times ``10**-scale``."""

    values: NDArray[np.int64]
    scale: int


def mantissas(codes: NDArray[np.float64]) -> Mantissas | None:
    """Return the mantissas of a column of codes at the least of `SCALES`; None if there is none.

    Cost: some numpy passes over the column for the right scale, over eight rows for the others.
    """
    for scale in SCALES:
        if not _at_scale(codes[:8], scale)[1].all():
            continue
        values = np.empty(len(codes), np.int64)
        # Work in blocks, so that temporary arrays stay in the processor's cache.
        for first in range(0, len(codes), _BLOCK):
            found, fits = _at_scale(codes[first : first + _BLOCK], scale)
            if not fits.all():
                break
            values[first : first + _BLOCK] = found
        else:
            return Mantissas(values, scale)
    return None


def mantissas_of(integers: NDArray[np.int64]) -> Mantissas | None:
    """Return integers as mantissas; None if one has more than 15 digits."""
    if len(integers) and not -LIMIT <= integers.min() <= integers.max() <= LIMIT:
        return None
    return Mantissas(integers, 0)


def fit_scale(codes: NDArray[np.float64], scale: int) -> tuple[NDArray[np.bool_], Mantissas]:
    """Return which codes have a mantissa at ``scale``, and these mantissas (0 for the others)."""
    found, fits = _at_scale(codes, scale)
    return fits, Mantissas(np.where(fits, found, 0.0).astype(np.int64), scale)


def _at_scale(codes: Any, scale: int) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    power = 10.0**scale
    with np.errstate(all="ignore"):
        found = np.rint(codes * power)
        return found, (np.abs(found) <= LIMIT) & (found / power == codes)


def encode(found: Mantissas) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return the codes of mantissas, and which are valid: the others have over 15 digits."""
    values = found.values
    valid = (values >= -LIMIT) & (values <= LIMIT)
    return values / 10.0**found.scale, valid & (found.scale <= 22)


def combine(name: str, a: Mantissas, b: Mantissas) -> tuple[Any, NDArray[np.bool_]] | None:
    """Return the codes of ``a name b``, and which are valid; None: none is.

    For ``/`` no divisor may be 0.
    """
    if name == "*":
        small = np.abs(a.values.astype(np.float64) * b.values) <= LIMIT
        codes, valid = encode(Mantissas(a.values * b.values, a.scale + b.scale))
        return codes, valid & small
    if name == "/":
        dividend = _shifted(a, max(0, b.scale - a.scale))
        divisor = _shifted(b, max(0, a.scale - b.scale))
        return None if dividend is None or divisor is None else quotients(dividend, 0, divisor)
    left, right = _shifted(a, max(0, b.scale - a.scale)), _shifted(b, max(0, a.scale - b.scale))
    if left is None or right is None:
        return None
    total = left + right if name == "+" else left - right
    return encode(Mantissas(total, max(a.scale, b.scale)))


def _shifted(found: Mantissas, by: int) -> NDArray[np.int64] | None:
    """Return the values times ``10**by``, or None if they could overflow int64."""
    if not by:
        return found.values
    greatest = np.abs(found.values).max(initial=0)
    return None if by > 18 or float(greatest) * 10.0**by >= _SAFE / 2 else found.values * 10**by


def quotients(
    dividend: NDArray[np.int64], scale: int, divisor: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return the codes of ``dividend * 10**-scale / divisor``, and which are valid. No divisor may
    be 0."""
    above, below = np.abs(dividend), np.abs(divisor)
    approximate = above / below / 10.0**scale
    exponent = np.searchsorted(POWERS, approximate, "right") - 23
    places = np.where(above == 0, scale, DIGITS - 1 - exponent)
    valid = (places >= scale) & (places <= 22) & (above >= 0) & (below > 0)
    left = np.where(valid, places - scale, 0)
    if below.max(initial=1) <= _SMALL:
        numerator = above * _TENS[np.minimum(left, 18)]
        valid &= left <= 18
        digits = np.rint(numerator / below).astype(np.int64)
        rest = numerator - digits * below
    else:
        valid &= (left == 0) | (below.max() < _SAFE / 10)
        digits, rest = _long_division(above, below, left)
    twice = 2 * rest
    more = (twice > below) | ((twice == below) & (digits & 1 == 1))
    less = (twice < -below) | ((twice == -below) & (digits & 1 == 1))
    digits = digits + more - less
    inexact = valid & (rest != 0)
    if inexact.any():
        # If the expansion ends after the 15th digit, the quotient is exact and has no code.
        valid &= ~(inexact & _ends(above, below))
    codes = digits / POWERS[np.clip(places, 0, 22) + 22]
    return np.where((dividend < 0) != (divisor < 0), 0.0 - codes, codes), valid


def _long_division(
    dividend: NDArray[np.int64], divisor: NDArray[np.int64], places: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return quotient and rest of ``dividend * 10**places``, by as many digits at a time as fit."""
    room = min(18, int(np.log10(_SAFE / float(divisor.max()))))
    digits, rest = np.divmod(dividend, divisor)
    while room and places.any():
        step = np.minimum(places, room)
        more, rest = np.divmod(rest * _TENS[step], divisor)
        digits = digits * _TENS[step] + more
        places = places - step
    return digits, rest


def _ends(dividend: NDArray[np.int64], divisor: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Whether the decimal expansion of a quotient is finite."""
    small = divisor.max(initial=1) <= _SMALL
    rest = _OTHER_FACTORS[divisor] if small else _without_twos_and_fives(divisor)
    return np.asarray(dividend % rest == 0)


def _without_twos_and_fives(numbers: NDArray[np.int64]) -> NDArray[np.int64]:
    for factor in (2, 5):
        while (even := (numbers % factor == 0) & (numbers > 0)).any():
            numbers = np.where(even, numbers // factor, numbers)
    return numbers


_OTHER_FACTORS: Final = _without_twos_and_fives(np.arange(_SMALL + 1))


# -- one by one, of any size ---------------------------------------------------------------


def of_code(code: float) -> Decimal:
    """Return the decimal that a code stands for."""
    return Decimal(repr(code))


def text(number: Decimal) -> str:
    """Return the canonical text: no exponent, no trailing zero after the point, no -0."""
    shown = format(number, "f")
    if "." in shown:
        shown = shown.rstrip("0").removesuffix(".")
    return "0" if shown == "-0" else shown


def parse(lexical: str) -> Decimal | None:
    """Return the value of a decimal or integer text; None if it has too many digits."""
    return _within_limit(Decimal(lexical)) if len(lexical) <= 2 * LONGEST + 3 else None


def _within_limit(number: Decimal) -> Decimal | None:
    """Return the number if it has up to `LONGEST` digits, before the point and after it."""
    exponent = number.as_tuple().exponent
    assert isinstance(exponent, int)
    fits = len(number.as_tuple().digits) <= LONGEST and exponent >= -LONGEST
    return number if fits and number.adjusted() < LONGEST else None


def compute(name: str, a: Decimal, b: Decimal) -> Decimal | None:
    """Return ``a name b``; None if that is an error."""
    try:
        if name == "/":
            return _within_limit(quotient(Fraction(a), Fraction(b)))
        return _within_limit(_OPERATIONS[name](a, b))
    except (decimal.DecimalException, ZeroDivisionError):
        return None


_OPERATIONS: Final[dict[str, Callable[[Decimal, Decimal], Decimal]]] = {
    "+": EXACT.add,
    "-": EXACT.subtract,
    "*": EXACT.multiply,
}


def total(numbers: Sequence[tuple[Decimal, int]]) -> Decimal:
    """Return the sum of numbers, each times its count. Raises `decimal.Inexact` if it is too
    long."""
    found = Decimal(0)
    for number, times in numbers:
        found = EXACT.add(found, EXACT.multiply(number, Decimal(times)))
    return found


def scaled(value: int, scale: int) -> Decimal:
    """Return ``value * 10**-scale``."""
    return EXACT.scaleb(Decimal(value), -scale)


def quotient(a: Fraction, b: Fraction) -> Decimal:
    """Return ``a / b`` by the rule of this module. Raises ``ZeroDivisionError`` and
    `decimal.Inexact`."""
    found = a / b
    twos, fives = _power(found.denominator, 2), _power(found.denominator, 5)
    after = max(twos, fives)
    if 2**twos * 5**fives == found.denominator:
        digits = found.numerator * 10**after // found.denominator
        if after <= _PLACES or abs(digits) < LIMIT:
            return scaled(digits, after)
    places = _places(abs(found))
    return scaled(round(found * 10**places), places)


def _places(number: Fraction) -> int:
    """Return the number of digits after the point that round a number to 15 significant digits; 0
    if it has more before the point."""
    if number >= LIMIT // 10:
        return 0
    bits_below = number.denominator.bit_length() - number.numerator.bit_length()
    places = max(0, int(bits_below * 0.30102) + DIGITS - 3)
    while number * 10**places < LIMIT // 10:
        places += 1
    return places


def _power(number: int, factor: int) -> int:
    found = 0
    while number % factor == 0:
        number //= factor
        found += 1
    return found


def round_number(name: str, number: Decimal) -> Decimal:
    """NEGATE, ABS, CEIL, FLOOR or ROUND (a half towards positive infinity)."""
    match name:
        case "NEGATE":
            return EXACT.copy_negate(number)
        case "ABS":
            return EXACT.copy_abs(number)
        case "CEIL":
            return number.to_integral_value(decimal.ROUND_CEILING)
        case "FLOOR":
            return number.to_integral_value(decimal.ROUND_FLOOR)
    half = Decimal("0.5")
    return EXACT.add(number, half).to_integral_value(decimal.ROUND_FLOOR)
