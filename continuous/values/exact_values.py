"""Numbers that are aggregated one by one, as no sum of 64 bits takes them (SPARQL 1.1 §18.5.1).

They are integers beyond int64, decimals of too many digits, and doubles so great that a sum of some
may overflow before others bring it back. `partial_aggregates` puts them apart.
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
    """How often each group has each number. Cost and memory: Python a number."""

    groups: dict[int, _Counted] = field(default_factory=dict)

    def add(self, at: NDArray[Any], kind: Kind, values: Iterable[Number], sign: int) -> None:
        """Add (1) or take away (-1) a number a row."""
        for group, value in zip(at.tolist(), values, strict=True):
            counted = self.groups.setdefault(group, Counter())
            counted[kind, value] += sign
            if not counted[kind, value]:
                del counted[kind, value]
            if not counted:
                del self.groups[group]

    def of(self, rows: NDArray[np.int64]) -> Singles:
        """Those of the groups ``rows``, as groups 0, 1, 2 …"""
        if not self.groups:
            return Singles()
        known = np.flatnonzero(np.isin(rows, list(self.groups))).tolist()
        return Singles({row: self.groups[int(rows[row])] for row in known})

    def merged(self, groups: NDArray[np.int64], rows: NDArray[np.int64]) -> Singles:
        """Where group ``groups[i]`` takes in our ``rows[i]``."""
        made = Singles()
        if self.groups:
            for at in np.flatnonzero(np.isin(rows, list(self.groups))).tolist():
                made.groups.setdefault(int(groups[at]), Counter()).update(
                    self.groups[int(rows[at])]
                )
        return made

    def keep(self, new: NDArray[np.int32]) -> None:
        """Group g becomes ``new[g]``, -1 is forgotten."""
        self.groups = {int(new[g]): counted for g, counted in self.groups.items() if new[g] >= 0}

    def numbers(self, group: int) -> Iterator[tuple[Kind, Number, int]]:
        """The numbers of a group, and how often it has each."""
        counted: Mapping[tuple[Kind, Number], int] = self.groups.get(group, Counter())
        for (kind, value), times in counted.items():
            yield kind, value, times


def summed(numbers: Iterable[tuple[Kind, Number, int]], count: int | None) -> Literal | None:
    """The sum of numbers, each so many times, rounded once; divided by ``count`` if it is given.

    None: an error, as the result is too long.
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
    odd = [float(value) for _, value, _ in parts if not math.isfinite(value)]
    # Infinities of two signs, or a NaN, have no sum.
    found = sum(odd) if odd else _nearest(sum(Fraction(value) * times for _, value, times in parts))
    return make_literal(kind, found if count is None else found / count)


def _nearest(exact: Fraction | int) -> float:
    try:
        return float(exact)
    except OverflowError:
        return math.inf if exact > 0 else -math.inf


def extreme(numbers: Iterable[tuple[Kind, Number]], least: bool) -> Literal:
    """MIN or MAX: NaN where a number is; of equal numbers the one of the first kind."""
    parts = sorted(numbers, key=lambda part: part[0])
    nans = [kind for kind, value in parts if value != value]
    if nans:
        return make_literal(max(nans), math.nan)
    choose = min if least else max
    exact = [part for part in parts if part[0] <= Kind.DECIMAL]
    floats = [part for part in parts if part[0] > Kind.DECIMAL]
    # Two exact numbers are compared exactly, any others as floats (§17.3).
    best = [choose(some, key=lambda part: part[1]) for some in (exact, floats) if some]
    kind, value = choose(best, key=lambda part: float(part[1]))
    if isinstance(value, Decimal):
        return exact_literal(kind, value)
    return make_literal(kind, value)
