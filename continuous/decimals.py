"""Decimals in float64: what is computed keeps 15 significant digits.

A decimal of up to 15 digits is the float64 nearest to it, and comes back from it. Sums and products
of such floats are off in the 17th digit; rounded to 15 they are the decimal again that exact
arithmetic gives, as long as that has no more digits: 2.2 * 3 is 6.6.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

POWERS: Final = np.array([float(f"1e{exponent}") for exponent in range(-22, 23)])
"""10**-22 … 10**22; from 10**0 on they are exact, so that dividing by one rounds only once."""
DIGITS: Final = 15


def rounded(
    values: NDArray[np.float64], size: NDArray[np.float64] | None = None
) -> NDArray[np.float64]:
    """``values`` with 15 significant digits, or as many places as a number of ``size`` has then (a
    difference is as exact as the greater operand). What is beyond 1e-8 … 1e21 stays as it is."""
    size = np.abs(values if size is None else size)
    # By comparison, not by a logarithm: those of numpy and of compiled code may differ.
    exponent = np.searchsorted(POWERS, size, "right") - 23
    digits = DIGITS - 1 - exponent
    scale = POWERS[np.clip(np.abs(digits), 0, 22) + 22]
    with np.errstate(all="ignore"):
        finer = np.rint(values * scale) / scale
        coarser = np.rint(values / scale) * scale
    known = (size > 0) & (exponent >= -8) & (exponent <= 21)
    return np.where(known, np.where(digits >= 0, finer, coarser), values)
