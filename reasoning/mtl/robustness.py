"""Robustness: how far values are from another verdict (quantitative semantics, SPEC §8).

The margin of ``f > c`` is ``f - c``. `and` and `always` have the least margin of their parts, `or`
and `eventually` the greatest, `not` the opposite. The operators compare margins and never calculate
with them. So they work on *ranks* among all margins, with the loops that work on moments.
"""

from __future__ import annotations

from collections.abc import Iterator
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
from ...streams.time import SECOND
from . import windows
from .formulas import parts_of
from .nodes import OPERATORS, Axes, Pass, aligned_tables

Ranks: TypeAlias = NDArray[np.int64]
"""Places in the order of all margins, shape ``(n, objects of each axis)``: greater is better, and
the rank of the opposite margin is ``top - rank``."""


def margins(once: Pass, formula: Formula, *, is_upper: bool) -> tuple[Axes, NDArray[np.float64]]:
    """Return the margin of ``formula`` at each state, shape ``(n, objects of each axis)``.

    It is above 0 where the formula holds and below 0 where it fails. An unknown atom has the margin
    -oo in the lower reading and oo in the upper one, a comparison of texts, truths or objects one
    of the two. Times are compared in seconds. Contract: every state that the intervals reach is in
    ``once``. Cost: a sort of the atoms' margins, and that of the nodes.
    """
    found = _Margins(once)
    axes, ranks = found.of(formula, is_upper)
    return axes, found.levels(formula)[ranks]


@dataclass(slots=True, eq=False)
class _Margins:
    once: Pass
    atoms: dict[tuple[int, bool], tuple[Axes, NDArray[np.float64]]] = field(default_factory=dict)
    sorted: NDArray[np.float64] | None = None

    def levels(self, formula: Formula) -> NDArray[np.float64]:
        """All margins of a formula and their opposites, in order."""
        if self.sorted is None:
            parts = [self.atom(atom, is_upper)[1] for atom, is_upper in _atoms(formula)]
            every = np.concatenate([np.array([0.0, np.inf]), *(part.reshape(-1) for part in parts)])
            self.sorted = np.unique(np.concatenate([every, -every]))
        return self.sorted

    @property
    def top(self) -> int:
        assert self.sorted is not None
        return len(self.sorted) - 1

    def of(self, formula: Formula, is_upper: bool) -> tuple[Axes, Ranks]:
        levels = self.levels(formula)
        match formula:
            case Truth(value):
                return (), np.full(self.once.rows, self.top if value else 0)
            case Atom():
                axes, table = self.atom(formula, is_upper)
                return axes, np.searchsorted(levels, table)
            case Not(operand):
                axes, ranks = self.of(operand, not is_upper)
                return axes, self.top - ranks
            case And(left, right):
                axes, a, b = aligned_tables(self.of(left, is_upper), self.of(right, is_upper))
                return axes, np.minimum(a, b)
            case Or(left, right):
                axes, a, b = aligned_tables(self.of(left, is_upper), self.of(right, is_upper))
                return axes, np.maximum(a, b)
            case Previous(operand):
                axes, ranks = self.of(operand, is_upper)
                return axes, np.concatenate([np.zeros_like(ranks[:1]), ranks[:-1]])
            case Within(operator, interval, operand):
                axes, ranks = self.of(operand, is_upper)
                return axes, self.within(operator, interval, ranks)
            case Until(is_past, interval, left, right):
                axes, a, b = aligned_tables(self.of(left, is_upper), self.of(right, is_upper))
                return axes, self.until(is_past, interval, a, b)
            case Quantified(is_universal, variable, sort, operand):
                return self.over_objects(is_universal, variable, sort, *self.of(operand, is_upper))
            case _:
                assert_never(formula)

    def atom(self, atom: Atom, is_upper: bool) -> tuple[Axes, NDArray[np.float64]]:
        key = id(atom), is_upper
        if key not in self.atoms:
            axes, a, b, known = self.once.operands(atom.left, atom.right)
            with np.errstate(all="ignore"):
                table = _margin(atom.operator, a, b)
            shape = (self.once.rows, *np.broadcast_shapes(table.shape, known.shape)[1:])
            known = np.broadcast_to(known, shape) & ~np.isnan(table)
            self.atoms[key] = axes, np.where(known, table, np.inf if is_upper else -np.inf)
        return self.atoms[key]

    def within(self, operator: Temporal, interval: Interval, ranks: Ranks) -> Ranks:
        first, last = self.once.bounds(operator.is_past, interval)
        flat = ranks.reshape(len(ranks), -1)
        if operator in (Temporal.ALWAYS, Temporal.HISTORICALLY):
            found = np.minimum(windows.least(flat, first, last), self.top)
        else:
            found = np.maximum(windows.greatest(flat, first, last), 0)
        return found.reshape(ranks.shape)

    def until(self, is_past: bool, interval: Interval, left: Ranks, right: Ranks) -> Ranks:
        """The loops look for the least of the greatest moments: a margin is a moment that is the
        later the smaller it is, and later than all states, since nothing is known before its
        start."""
        first, last = self.once.bounds(is_past, interval)
        latest = self.top + self.once.rows
        own, other = (latest - part.reshape(len(part), -1) for part in (left, right))
        tables = own, own, other, other
        if is_past:
            moments, _ = windows.since(*tables, first, last)
        else:
            moments, _ = windows.until(*tables, first, last, last)
        return np.maximum(latest - moments, 0).reshape(left.shape)

    def over_objects(
        self, is_universal: bool, variable: str, sort: str, axes: Axes, ranks: Ranks
    ) -> tuple[Axes, Ranks]:
        """Over the objects of the sort that are there at each state."""
        present = self.once.states.present[sort]
        empty = self.top if is_universal else 0
        if variable not in axes:
            some = present.any(axis=1).reshape((-1,) + (1,) * (ranks.ndim - 1))
            return axes, np.where(some, ranks, empty)
        axis = 1 + axes.index(variable)
        shape = [1] * ranks.ndim
        shape[0], shape[axis] = present.shape
        there = np.where(present.reshape(tuple(shape)), ranks, empty)
        rest = tuple(each for each in axes if each != variable)
        fold = np.min if is_universal else np.max
        return rest, np.asarray(fold(there, axis=axis, initial=empty))


def _margin(operator: str, a: NDArray[Any], b: NDArray[Any]) -> NDArray[np.float64]:
    """How far ``a operator b`` is from the opposite."""
    kinds = {part.dtype.kind for part in (a, b)}
    if not kinds <= {"f", "i"}:
        return np.where(OPERATORS[operator](a, b), np.inf, -np.inf)
    difference = np.asarray(a - b, np.float64)
    if kinds == {"i"}:
        difference = difference / SECOND
    match operator:
        case ">" | ">=":
            return difference
        case "<" | "<=":
            return -difference
        case "=":
            return -np.abs(difference)
        case _:
            return np.abs(difference)


def _atoms(formula: Any) -> Iterator[tuple[Atom, bool]]:
    """The atoms of a formula, in both readings."""
    if isinstance(formula, Atom):
        yield formula, False
        yield formula, True
        return
    for part in parts_of(formula):
        yield from _atoms(part)
