"""Robustness: how far values are from another verdict (quantitative semantics, SPEC §8).

The margin of ``f > c`` is ``f - c``. `and` and `always` have the least margin of their parts, `or`
and `eventually` the greatest, `not` the opposite.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, TypeAlias, assert_never

import numpy as np
from numpy.typing import NDArray

from ...languages.mtl.ast import Interval, Temporal
from ...languages.mtl.checked import (
    And,
    Atom,
    Formula,
    Not,
    Or,
    Previous,
    Quantified,
    Truth,
    Until,
    Within,
)
from ...streams.sample import Mask
from ...streams.time import SECOND
from . import windows
from .nodes import OPERATORS, Axes, Pass, aligned_tables, compare

Table: TypeAlias = NDArray[np.float64]
"""Margins; shape ``(n, objects of each axis)``."""


@dataclass(slots=True, eq=False)
class Margins:
    """The margins of formulas at the states of one evaluation."""

    once: Pass
    memo: dict[tuple[int, bool], tuple[Axes, Table]] = field(default_factory=dict)

    def of(self, formula: Formula, is_upper: bool) -> tuple[Axes, Table]:
        """Return the margin of ``formula`` at each state.

        It is not below 0 where the formula holds, and not above 0 where it fails. An unknown atom
        has the margin -oo in the lower reading and oo in the upper one, a comparison of texts,
        truths or objects one of the two. Times are compared in seconds. Contract: every state that
        the intervals reach is there. Cost: that of the nodes.
        """
        key = id(formula), is_upper and not self.once.is_known(formula)
        if key not in self.memo:
            self.memo[key] = self._of(formula, key[1])
        return self.memo[key]

    def _of(self, formula: Formula, is_upper: bool) -> tuple[Axes, Table]:
        match formula:
            case Truth(value):
                return (), np.full(self.once.rows, np.inf if value else -np.inf)
            case Atom():
                return self._atom(formula, is_upper)
            case Not(operand):
                axes, table = self.of(operand, not is_upper)
                return axes, -table
            case And(left, right):
                axes, a, b = aligned_tables(self.of(left, is_upper), self.of(right, is_upper))
                return axes, np.minimum(a, b)
            case Or(left, right):
                axes, a, b = aligned_tables(self.of(left, is_upper), self.of(right, is_upper))
                return axes, np.maximum(a, b)
            case Previous(operand):
                axes, table = self.of(operand, is_upper)
                found = np.roll(table, 1, axis=0)
                found[0] = -np.inf
                return axes, found
            case Within(operator, interval, operand):
                axes, table = self.of(operand, is_upper)
                first, last = self.once.bounds(operator.is_past, interval)
                is_least = operator in (Temporal.ALWAYS, Temporal.HISTORICALLY)
                fold = windows.least if is_least else windows.greatest
                return axes, fold(_flat(table), first, last).reshape(table.shape)
            case Until(is_past, interval, left, right):
                axes, a, b = aligned_tables(self.of(left, is_upper), self.of(right, is_upper))
                return axes, self._until(is_past, interval, a, b)
            case Quantified(is_universal, variable, sort, operand):
                return self._over_objects(is_universal, variable, sort, *self.of(operand, is_upper))
            case _:
                assert_never(formula)

    def _atom(self, atom: Atom, is_upper: bool) -> tuple[Axes, Table]:
        axes, table, known = margin_of_atom(self.once, atom)
        shape = (self.once.rows, *np.broadcast_shapes(table.shape, known.shape)[1:])
        known = np.broadcast_to(known, shape)
        return axes, np.where(known, table, np.inf if is_upper else -np.inf)

    def _until(self, is_past: bool, interval: Interval, left: Table, right: Table) -> Table:
        first, last = self.once.bounds(is_past, interval)
        work = windows.since_of_margins if is_past else windows.until_of_margins
        return work(_flat(left), _flat(right), first, last).reshape(left.shape)

    def _over_objects(
        self, is_universal: bool, variable: str, sort: str, axes: Axes, table: Table
    ) -> tuple[Axes, Table]:
        """Over the objects of the sort that are there at each state."""
        present = self.once.states.present[sort]
        empty = np.inf if is_universal else -np.inf
        if variable not in axes:
            some = present.any(axis=1).reshape((-1,) + (1,) * (table.ndim - 1))
            return axes, np.where(some, table, empty)
        axis = 1 + axes.index(variable)
        shape = [1] * table.ndim
        shape[0], shape[axis] = present.shape
        there = np.where(present.reshape(tuple(shape)), table, empty)
        rest = tuple(each for each in axes if each != variable)
        fold = np.min if is_universal else np.max
        return rest, np.asarray(fold(there, axis=axis, initial=empty))


def _flat(table: Table) -> Table:
    """The same with one axis behind the states."""
    return table.reshape(len(table), int(np.prod(table.shape[1:], dtype=np.int64)))


def margin_of_atom(once: Pass, atom: Atom) -> tuple[Axes, Table, Mask]:
    """Return the margin of an atom at each state, and where it is known."""
    axes, a, b, known = once.operands(atom.left, atom.right)
    with np.errstate(all="ignore"):
        return axes, _margin(atom.operator, a, b, known), known


def _margin(operator: str, a: NDArray[Any], b: NDArray[Any], known: Mask) -> Table:
    """How far ``a operator b`` is from the opposite."""
    kinds = {part.dtype.kind for part in (a, b)}
    if not kinds <= {"f", "i"}:
        return np.where(compare(operator, a, b, known), np.inf, -np.inf)
    if kinds == {"i"}:
        # Times more than 292 years apart: their difference wraps around, that of floats does not.
        exact = np.asarray(a - b)
        wraps = (a > b) != (exact > 0)
        difference = np.where(wraps, a.astype(np.float64) - b, exact) / SECOND
    else:
        difference = a - b
    match operator:
        case ">" | ">=":
            found = difference
        case "<" | "<=":
            found = -difference
        case "=":
            found = -np.abs(difference)
        case _:
            found = np.abs(difference)
    # Infinite numbers, after an overflow, have no distance.
    undefined = np.isnan(found)
    if undefined.any():
        return np.where(undefined, np.where(OPERATORS[operator](a, b), np.inf, -np.inf), found)
    return found
