"""Exact sums: subtracting a value that was added restores the previous sum to the last bit.

A sliding window subtracts the values that leave it. With float64 sums the rounding errors would
stay and grow: (1e16 + 1) - 1e16 is 0, not 1. A result would also depend on the order of rows, hence
on the cut into batches. So sums are integers here, since integers form a group under addition.

A float64 is an integer times a power of two. A sum consists of *digits*: int64 counts of the
*grains* 2^28, 2^-12, 2^-52 … (one digit per 40 bits, as many digits as the values need). Adding or
subtracting a value changes its two or three digits, exactly. Only `values` rounds, once. This is a
variant of Kulisch's long accumulator.

Integers are summed the same way, in digits of 32 bits.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from copy import copy
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from ...streams.jit import JIT
from .fold_kernels import NO_SKIP, Groups
from .pane_runs import PaneRuns
from .sum_kernels import BITS, HALF, add, fold_pane, read, round_sums

At = NDArray[np.int32] | NDArray[np.int64] | None
"""The group of each row; None: the groups 0, 1, 2 … in order."""

_LOWEST, _HIGHEST = -26, 24
"""Digits for float64: from 2^988 down to 2^-1012. Bits of values below that are cut off."""
_TERMS = 2**21
"""The number of terms after which carries must be propagated. Each adds less than 2^40 to a digit,
so 2^21 of them fit 63 bits with room to spare."""


def _grain(digit: int) -> float:
    return 2.0 ** (BITS * digit + 28)


_NO_NUMBERS = np.zeros(0, np.float64)
_NO_GROUPS = np.zeros(0, np.int32)


class Totals(ABC):
    """Sums and counts by group, of one kind of number.

    Law: ``add(…, 1)`` and ``add(…, -1)`` of the same rows restore the state to the last bit, and
    the order of calls does not matter. Cost: a few nanoseconds per added row and per group read.
    Memory: per group 8 bytes for the count and 8 per digit.
    """

    def __init__(self, depth: int) -> None:
        self.digits: NDArray[np.int64] = np.zeros((depth, 0), np.int64)
        self.counts: NDArray[np.int64] = np.zeros(0, np.int64)

    def reserve(self, groups: int) -> None:
        """Allocate space for ``groups`` groups."""
        if len(self.counts) < groups:
            capacity = max(groups, 2 * len(self.counts), 64)
            self.digits = _wider(self.digits, (len(self.digits), capacity))
            counts = np.zeros(capacity, np.int64)
            counts[: len(self.counts)] = self.counts
            self.counts = counts

    def keep(self, kept: NDArray[np.int64]) -> None:
        """Drop all groups except ``kept`` (ascending), which become 0, 1, 2 …"""
        self.reserve(int(kept.max(initial=-1)) + 1)
        self.digits = np.ascontiguousarray(self.digits[:, kept])
        self.counts = self.counts[kept]

    def of_runs(self, runs: PaneRuns, wanted: NDArray[np.bool_]) -> Self:
        """Return the totals of groups over runs of panes, if the groups of this object are cells
        (`PaneRuns`): those ``wanted``, of shape ``(runs, groups)``, run by run."""
        found = copy(self)
        found.digits = runs.differences(self.digits, wanted)
        found.counts = runs.differences(self.counts[np.newaxis], wanted)[0]
        return found

    @abstractmethod
    def add(self, at: At, values: NDArray[Any], numbers: NDArray[Any] | None, sign: int) -> None:
        """Add ``sign`` times (value, number) to each row's group; a group may have several rows.

        ``numbers``: the number of rows that a value stands for; None: 1, if ``at`` is given.
        """

    @abstractmethod
    def values(self, rows: NDArray[np.int64]) -> NDArray[Any]:
        """Return the sums of the groups ``rows``."""


class FloatTotals(Totals):
    """Sums of float64, rounded once (within one unit of the last place).

    Infinities and NaNs have counts of their own. A finite sum beyond float64 is infinite.
    """

    def __init__(self) -> None:
        super().__init__(2)
        self._top = -1
        self._nonfinite: NDArray[np.int64] | None = None
        self._terms = 0
        self._state: NDArray[np.float64] = np.zeros((0, 2), np.float64)
        """`RowFold.state` while a pane is folded; else that of no rows."""
        self._update_grains()

    def fold_pane(
        self,
        subjects: NDArray[np.int32],
        values: NDArray[np.float64],
        great: float,
        groups: Groups,
        *,
        extremes: bool = False,
    ) -> tuple[NDArray[np.int32], NDArray[np.float64]] | None:
        """Fold a pane of few rows and add it; return its groups, ascending, and the columns of
        `RowFold.take`, shape ``(2 or 4, n)``. None, and no change: a value is not below ``great``,
        or loops are not compiled. Contract: ``extremes`` is the same in all calls.

        Law: this is `RowFold.add`, `RowFold.take` and `add`, in one call.
        """
        if not JIT:
            return None
        rows, capacity = len(subjects), groups.used + len(subjects)
        groups.reserve(capacity)
        self.reserve(capacity)
        width = 4 if extremes else 2
        if len(self._state) < len(self.counts):
            self._state = np.zeros((len(self.counts), width), np.float64)
            self._state[:, 2:] = np.inf
        # The pane adds one term at most to each group.
        self._carry(1)
        at, columns = np.empty(rows, np.int32), np.empty((width, rows), np.float64)
        groups.used, touched, fits = fold_pane(
            np.ascontiguousarray(subjects),
            np.ascontiguousarray(values),
            great,
            groups.group_of,
            groups.members,
            groups.used,
            self._state,
            self.digits,
            self.counts,
            self._grains,
            self._inverse,
            at,
            columns,
        )
        if touched < 0:
            return None
        at, columns = at[:touched], columns[:, :touched]
        if not fits:
            self.add(at, columns[0], columns[1], 1)
        return at, columns

    def present(
        self, used: int, of: NDArray[np.bool_] | None
    ) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.int64]]:
        """Return those of the first ``used`` groups that have rows, and are in ``of`` if that is
        given, with their sums and counts."""
        self.reserve(used)
        if not JIT or self._nonfinite is not None:
            some = self.counts[:used] > 0
            rows = np.flatnonzero(some if of is None else some & of)
            return rows, self.values(rows), self.counts[rows]
        rows, sums = np.empty(used, np.int64), np.empty(used, np.float64)
        numbers = np.empty(used, np.int64)
        mask = NO_SKIP if of is None else of
        n = read(self.digits, self.counts, mask, used, self._grains, rows, sums, numbers)
        return rows[:n], sums[:n], numbers[:n]

    def add(self, at: At, values: NDArray[Any], numbers: NDArray[Any] | None, sign: int) -> None:
        if at is not None and len(values) > _TERMS:
            for first in range(0, len(values), _TERMS):
                part = slice(first, first + _TERMS)
                self.add(at[part], values[part], None if numbers is None else numbers[part], sign)
            return
        # All rows may be of one group if groups are given.
        self._carry(1 if at is None else len(values))
        start = 0
        while True:
            start = self._try_add(at, values, numbers, start, sign)
            if start == len(values):
                return
            finite = np.isfinite(values)
            if not finite.all():
                self._count_nonfinite(at, values, ~finite, sign)
                values = np.where(finite, values, 0.0)
            elif not self._deepen(values):
                # The digits are at their limit: cut off the bits below the last one.
                tiny = np.abs(values) < 2.0**-900
                values = values.copy()
                values[tiny] = np.trunc(values[tiny] * 2.0**1012) * 2.0**-1012

    def values(self, rows: NDArray[np.int64]) -> NDArray[Any]:
        if JIT:
            out = np.empty(len(rows), np.float64)
            round_sums(self.digits, rows, self._grains, out)
        else:
            digits = self.digits[:, rows]
            carry: NDArray[np.int64] = np.zeros(len(rows), np.int64)
            out = np.zeros(len(rows), np.float64)
            for k in reversed(range(len(digits))):
                digit = digits[k] + carry
                carry = (digit + HALF) >> BITS
                out += (digit - (carry << BITS)) * self._grains[k]
            out[carry != 0] += carry[carry != 0] * self._limit
        if self._nonfinite is not None:
            nan, above, below = self._nonfinite[:, rows]
            out[above > 0] = np.inf
            out[below > 0] = -np.inf
            out[(nan > 0) | ((above > 0) & (below > 0))] = np.nan
        return out

    def reserve(self, groups: int) -> None:
        super().reserve(groups)
        if self._nonfinite is not None:
            self._nonfinite = _wider(self._nonfinite, (3, len(self.counts)))

    def keep(self, kept: NDArray[np.int64]) -> None:
        super().keep(kept)
        if self._nonfinite is not None:
            nonfinite = self._nonfinite[:, kept]
            self._nonfinite = np.ascontiguousarray(nonfinite) if nonfinite.any() else None
        # Drop digits that only dropped groups needed: one outlier must not cost time for good.
        wanted = np.flatnonzero(self.digits.any(axis=1))
        if len(wanted) and len(wanted) < len(self.digits) > 2:
            first, last = int(wanted[0]), max(int(wanted[-1]), int(wanted[0]) + 1)
            self.digits = np.ascontiguousarray(self.digits[first : last + 1])
            self._top -= first
            self._update_grains()

    def _try_add(
        self, at: At, values: NDArray[Any], numbers: NDArray[Any] | None, start: int, sign: int
    ) -> int:
        if JIT:
            where = _NO_GROUPS if at is None else np.ascontiguousarray(at, np.int32)
            columns = (values, _NO_NUMBERS if numbers is None else numbers)
            stop: int = add(
                self.digits,
                self.counts,
                where,
                *map(np.ascontiguousarray, columns),
                start,
                float(sign),
                self._grains,
                self._inverse,
            )
            return stop
        if not np.all(np.abs(values) < self._limit):
            return start
        rest, parts = values.copy(), []
        for grain in self._grains:
            part = np.trunc(rest / grain)
            rest -= part * grain
            parts.append(part.astype(np.int64))
        if rest.any():
            return start
        for row, part in zip(self.digits, parts, strict=True):
            _add_at(row, at, sign * part)
        more = np.ones(len(values), np.int64) if numbers is None else numbers.astype(np.int64)
        _add_at(self.counts, at, sign * more)
        return len(values)

    def _count_nonfinite(
        self, at: At, values: NDArray[Any], which: NDArray[np.bool_], sign: int
    ) -> None:
        if self._nonfinite is None:
            self._nonfinite = np.zeros((3, len(self.counts)), np.int64)
        groups = np.flatnonzero(which) if at is None else at[which]
        odd = values[which]
        for row, hit in zip(self._nonfinite, (np.isnan(odd), odd > 0, odd < 0), strict=True):
            np.add.at(row, groups[hit], sign)

    def _deepen(self, values: NDArray[Any]) -> bool:
        """Add digits for the greatest value and for the last bit of each; return False if there are
        none to add."""
        _, exponents = np.frexp(values[values != 0])
        mantissa = np.abs(np.frexp(values[values != 0])[0] * 2.0**53).astype(np.int64)
        lowest_bit = np.frexp((mantissa & -mantissa).astype(np.float64))[1] - 1
        top = -((-(int(exponents.max()) - 28 - BITS)) // BITS)
        bottom = (int((exponents - 53 + lowest_bit).min()) - 28) // BITS
        top = min(max(top, self._top), _HIGHEST)
        bottom = max(min(bottom, self._top - len(self.digits) + 1), _LOWEST)
        if top - bottom + 1 == len(self.digits):
            return False
        digits = np.zeros((top - bottom + 1, self.digits.shape[1]), np.int64)
        first = top - self._top
        digits[first : first + len(self.digits)] = self.digits
        self.digits, self._top = digits, top
        self._update_grains()
        return True

    def _update_grains(self) -> None:
        self._grains = np.array([_grain(self._top - k) for k in range(len(self.digits))])
        self._inverse = 1 / self._grains
        self._limit = _grain(self._top + 1) if self._top < _HIGHEST else np.inf

    def _carry(self, terms: int) -> None:
        """Propagate carries before ``terms`` further terms could overflow a digit."""
        self._terms += terms
        if self._terms < _TERMS:
            return
        self._terms = terms + 1
        if self._top < _HIGHEST:
            self.digits = np.concatenate([np.zeros_like(self.digits[:1]), self.digits])
            self._top += 1
            self._update_grains()
        for k in range(len(self.digits) - 1, 0, -1):
            carry = (self.digits[k] + HALF) >> BITS
            self.digits[k] -= carry << BITS
            self.digits[k - 1] += carry
        if not self.digits[0].any() and len(self.digits) > 2:
            self.digits = np.ascontiguousarray(self.digits[1:])
            self._top -= 1
            self._update_grains()


class IntegerTotals(Totals):
    """Sums of int64, exact at any size, in two digits of 32 bits.

    ``values`` returns int64, or Python integers if one does not fit.
    """

    def __init__(self) -> None:
        super().__init__(2)

    def add(self, at: At, values: NDArray[Any], numbers: NDArray[Any] | None, sign: int) -> None:
        _add_at(self.digits[0], at, sign * (values >> 32))
        _add_at(self.digits[1], at, sign * (values & 0xFFFFFFFF))
        more = np.ones(len(values), np.int64) if numbers is None else numbers
        _add_at(self.counts, at, sign * more)

    def add_high(self, at: At, values: NDArray[np.int64], sign: int) -> None:
        """Add 2^32 times each value, without counting."""
        _add_at(self.digits[0], at, sign * values)

    def values(self, rows: NDArray[np.int64]) -> NDArray[Any]:
        high, low = self.digits[:, rows]
        high += low >> 32
        if np.all((high >= -(2**31)) & (high < 2**31)):
            return np.asarray((high << 32) + (low & 0xFFFFFFFF))
        return np.asarray(high.astype(object) * 2**32 + (low & 0xFFFFFFFF).astype(object))


def _add_at(state: NDArray[np.int64], at: At, values: NDArray[np.int64]) -> None:
    if at is None:
        state[: len(values)] += values
    else:
        np.add.at(state, at, values)


def _wider(digits: NDArray[np.int64], shape: tuple[int, int]) -> NDArray[np.int64]:
    wider = np.zeros(shape, np.int64)
    wider[:, : digits.shape[1]] = digits
    return wider
