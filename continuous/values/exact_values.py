"""Numbers that are aggregated one by one, because no 64-bit sum can represent them (SPARQL 1.1
§18.5.1).

They are integers beyond int64, decimals of too many digits, and doubles so great that a partial sum
may overflow although the total does not. `partial_aggregates` separates them.
"""

from __future__ import annotations

import decimal
import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from decimal import Decimal
from fractions import Fraction
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
from pyoxigraph import Literal

from ...rdf.timed import Kind, make_literal
from . import decimals
from .literals import exact_literal

Number: TypeAlias = Decimal | float
"""An INTEGER or DECIMAL, a FLOAT or DOUBLE."""
_Counted: TypeAlias = Counter[tuple[Kind, Number]]


@dataclass(slots=True)
class Singles:
    """The count of each number in each group. Cost and memory: Python per number."""

    groups: dict[int, _Counted] = field(default_factory=dict)

    def add(self, at: NDArray[Any], kind: Kind, values: Iterable[Number], sign: int) -> None:
        """Add (1) or subtract (-1) a number per row."""
        for group, value in zip(at.tolist(), values, strict=True):
            counted = self.groups.setdefault(group, Counter())
            counted[kind, value] += sign
            if not counted[kind, value]:
                del counted[kind, value]
            if not counted:
                del self.groups[group]

    def of(self, rows: NDArray[np.int64]) -> Singles:
        """Return the numbers of the groups ``rows``, as groups 0, 1, 2 …"""
        if not self.groups:
            return Singles()
        present = np.flatnonzero(np.isin(rows, list(self.groups))).tolist()
        return Singles({row: self.groups[int(rows[row])] for row in present})

    def merged(self, groups: NDArray[np.int64], rows: NDArray[np.int64]) -> Singles:
        """Return the numbers of groups where group ``groups[i]`` absorbs ``rows[i]``."""
        singles = Singles()
        if self.groups:
            for at in np.flatnonzero(np.isin(rows, list(self.groups))).tolist():
                singles.groups.setdefault(int(groups[at]), Counter()).update(
                    self.groups[int(rows[at])]
                )
        return singles

    def keep(self, new: NDArray[np.int32]) -> None:
        """Rename group g to ``new[g]``; drop it if that is -1."""
        self.groups = {int(new[g]): counted for g, counted in self.groups.items() if new[g] >= 0}

    def numbers(self, group: int) -> Iterator[tuple[Kind, Number, int]]:
        """Yield the numbers of a group with their counts."""
        counted: Mapping[tuple[Kind, Number], int] = self.groups.get(group, Counter())
        for (kind, value), times in counted.items():
            yield kind, value, times


def summed(numbers: Iterable[tuple[Kind, Number, int]], count: int | None) -> Literal | None:
    """Return the sum of numbers, each times its count, rounded once; divided by ``count`` if given.

    None: an error, since the result is too long.
    """
    parts = list(numbers)
    kind = max(kind for kind, _, _ in parts)
    if kind <= Kind.DECIMAL:
        try:
            total = decimals.total([(Decimal(value), times) for _, value, times in parts])
            if count is not None:
                kind, total = Kind.DECIMAL, decimals.quotient(Fraction(total), Fraction(count))
        except decimal.DecimalException:
            return None
        return exact_literal(kind, total)
    nonfinite = [float(value) for _, value, _ in parts if not math.isfinite(value)]
    # The sum of infinities of both signs, or with a NaN, is NaN.
    if nonfinite:
        found = sum(nonfinite)
    else:
        found = _nearest(sum(Fraction(value) * times for _, value, times in parts))
    return make_literal(kind, found if count is None else found / count)


def _nearest(exact: Fraction | int) -> float:
    try:
        return float(exact)
    except OverflowError:
        return math.inf if exact > 0 else -math.inf


def extreme(numbers: Iterable[tuple[Kind, Number]], least: bool) -> Literal:
    """Return MIN or MAX: NaN if there is one; of equal numbers that of the first kind."""
    parts = sorted(numbers, key=lambda part: part[0])
    nans = [kind for kind, value in parts if value != value]
    if nans:
        return make_literal(max(nans), math.nan)
    choose = min if least else max
    exact = [part for part in parts if part[0] <= Kind.DECIMAL]
    floats = [part for part in parts if part[0] > Kind.DECIMAL]
    # Exact numbers are compared exactly, others as floats (§17.3).
    best = [choose(some, key=lambda part: part[1]) for some in (exact, floats) if some]
    kind, value = choose(best, key=lambda part: float(part[1]))
    if isinstance(value, Decimal):
        return exact_literal(kind, value)
    return make_literal(kind, value)
