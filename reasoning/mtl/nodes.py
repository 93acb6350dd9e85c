"""One evaluation of a formula over states: the nodes of `evaluator`, and tables of moments."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final, TypeAlias, assert_never

import numpy as np
from numpy.typing import NDArray

from ...languages.mtl.ast import Interval, Temporal
from ...languages.mtl.checked import (
    And,
    Atom,
    Calculation,
    Constant,
    Formula,
    Kind,
    Not,
    ObjectConstant,
    ObjectVariable,
    Or,
    Parameter,
    Previous,
    Quantified,
    Reading,
    Truth,
    Until,
    Value,
    Within,
)
from ...streams.sample import Mask, Times
from ...streams.time import TIME_MAX
from ...streams.time_arithmetic import earlier, later
from ..states.states import States, Term
from . import windows
from .formulas import parts_of, readings_of
from .windows import NEVER, Moments

Axes: TypeAlias = tuple[str, ...]
"""The variables that the axes of a table behind the first stand for, in order of their names."""
END: Final = TIME_MAX
"""The horizon when no further state comes."""
OPERATORS: Final[Mapping[str, Callable[[Any, Any], Any]]] = {
    "<": np.less,
    "<=": np.less_equal,
    ">": np.greater,
    ">=": np.greater_equal,
    "=": np.equal,
    "!=": np.not_equal,
}


@dataclass(frozen=True, slots=True)
class Node:
    """A table of moments in one reading; shape ``(n, objects of each axis)``."""

    axes: Axes
    true: Moments
    false: Moments


@dataclass(slots=True, eq=False)
class Pass:
    """One evaluation of the states kept."""

    states: States
    sorts: Mapping[str, str]
    is_whole: bool = True
    """Whether no state before these was dropped."""
    values: Mapping[str, NDArray[Any]] = field(default_factory=dict)
    """The value of each parameter at each state, where states have their own: of a template's
    parameter, or the object of a variable."""
    memo: dict[tuple[int, bool], Node] = field(default_factory=dict)
    atoms: dict[int, tuple[Axes, Mask, Mask | None]] = field(default_factory=dict)
    known: dict[int, bool] = field(default_factory=dict)
    """Whether all atoms of a formula are known."""
    intervals: dict[tuple[bool, Interval], tuple[Times, Times]] = field(default_factory=dict)
    """The rows in the interval of each state."""
    rows: int = field(init=False)
    at: Moments = field(init=False)
    """The row of each state."""

    def __post_init__(self) -> None:
        self.rows = len(self.states.valid)
        self.at = np.arange(self.rows)

    def node(self, formula: Formula, is_upper: bool) -> Node:
        """Evaluate ``formula`` in a reading; each part once, or once for both readings where all
        its atoms are known."""
        key = id(formula), is_upper and not self.is_known(formula)
        if key not in self.memo:
            self.memo[key] = self._node(formula, key[1])
        return self.memo[key]

    def is_known(self, formula: Formula) -> bool:
        """Whether all atoms in a formula are known at all states: its readings are then equal."""
        found = self.known.get(id(formula))
        if found is None:
            found = self.known[id(formula)] = (
                self.atom(formula)[2] is None
                if isinstance(formula, Atom)
                else all(map(self.is_known, parts_of(formula)))
            )
        return found

    def _node(self, formula: Formula, is_upper: bool) -> Node:
        match formula:
            case Truth(value):
                return self._constant(np.full(self.rows, value), ())
            case Atom():
                axes, holds, known = self.atom(formula)
                if known is not None:
                    holds = (holds | ~known) if is_upper else (holds & known)
                return self._constant(holds, axes)
            case Not(operand):
                return _negated(self.node(operand, not is_upper))
            case And(left, right):
                return _negated(
                    _disjunction(
                        _negated(self.node(left, is_upper)), _negated(self.node(right, is_upper))
                    )
                )
            case Or(left, right):
                return _disjunction(self.node(left, is_upper), self.node(right, is_upper))
            case Previous(operand):
                return self._previous(self.node(operand, is_upper))
            case Within(operator, interval, operand):
                child = self.node(operand, is_upper)
                is_dual = operator in (Temporal.ALWAYS, Temporal.HISTORICALLY)
                found = self._within(
                    operator.is_past, interval, _negated(child) if is_dual else child
                )
                return _negated(found) if is_dual else found
            case Until(is_past, interval, left, right):
                parts = self.node(left, is_upper), self.node(right, is_upper)
                return self._until(is_past, interval, *_aligned(*parts))
            case Quantified(is_universal, variable, sort, operand):
                child = self.node(operand, is_upper)
                found = self._exists(variable, sort, _negated(child) if is_universal else child)
                return _negated(found) if is_universal else found
            case _:
                assert_never(formula)

    # -- temporal operators ------------------------------------------------------------------

    def _within(self, is_past: bool, interval: Interval, child: Node) -> Node:
        """``eventually``, or ``once``."""
        first, last = self.bounds(is_past, interval)
        flat = _flat(child)
        true = windows.least(flat.true, first, last)
        false = windows.greatest(flat.false, first, last)
        # What is known of a start is not known before it; a future interval ends at it or later.
        known = self.at if is_past else self.over(interval.end)
        np.maximum(true, self.at[:, None], out=true)
        np.maximum(false, known[:, None], out=false)
        return _shaped(child, true, false)

    def _until(self, is_past: bool, interval: Interval, left: Node, right: Node) -> Node:
        first, last = self.bounds(is_past, interval)
        own, other = _flat(left), _flat(right)
        tables = own.true, own.false, other.true, other.false
        if is_past:
            true, false = windows.since(*tables, first, last)
        else:
            true, false = windows.until(*tables, first, last, self.over(interval.end))
        return _shaped(left, true, false)

    def _previous(self, child: Node) -> Node:
        """The child at the state before; false at the first state of all."""
        known = column(self.at, child.true.ndim)
        true, false = np.roll(child.true, 1, axis=0), np.roll(child.false, 1, axis=0)
        true[0], false[0] = NEVER, 0 if self.is_whole else NEVER
        return Node(child.axes, np.maximum(true, known), np.maximum(false, known))

    def bounds(self, is_past: bool, interval: Interval) -> tuple[Times, Times]:
        """The rows in the interval of each state: the first, and the one after the last."""
        found = self.intervals.get((is_past, interval))
        if found is None:
            found = self.intervals[is_past, interval] = self._bounds(is_past, interval)
        return found

    def _bounds(self, is_past: bool, interval: Interval) -> tuple[Times, Times]:
        valid = self.states.valid
        if is_past:
            last = valid.searchsorted(earlier(valid, interval.start), "right")
            if interval.end is None:
                return np.zeros(self.rows, np.int64), last
            return valid.searchsorted(earlier(valid, interval.end), "left"), last
        first = self.at
        if interval.start:
            first = valid.searchsorted(later(valid, interval.start), "left")
        if interval.end is None:
            return first, np.full(self.rows, self.rows)
        return first, valid.searchsorted(later(valid, interval.end), "right")

    def back(self, formula: Formula, rows: NDArray[np.int64]) -> NDArray[np.int64]:
        """The first row that an operator of the past looks at from each of these rows."""
        match formula:
            case Within(_, interval) | Until(_, interval):
                return np.minimum(rows, self.bounds(True, interval)[0][rows])
            case _:
                return np.maximum(rows - 1, 0)

    def over(self, reach: int | None) -> Moments:
        """From which state on no later state is valid up to ``reach`` (ns) after each state; None:
        no later state comes at all."""
        end = np.full(self.rows, END) if reach is None else later(self.states.valid, reach)
        closed = self.states.horizon.searchsorted(end, "left")
        return np.where(closed == self.rows, NEVER, np.maximum(closed, self.at))

    def _exists(self, variable: str, sort: str, child: Node) -> Node:
        """Over the objects of the sort that are there at each state."""
        present = self.states.present[sort]
        known = self.at
        if variable not in child.axes:
            some = column(np.asarray(present.any(axis=1)), child.true.ndim)
            at = column(known, child.true.ndim)
            return Node(
                child.axes, np.where(some, child.true, NEVER), np.where(some, child.false, at)
            )
        axis = 1 + child.axes.index(variable)
        shape = [1] * child.true.ndim
        shape[0], shape[axis] = present.shape
        there = present.reshape(tuple(shape))
        axes = tuple(each for each in child.axes if each != variable)
        true = np.min(np.where(there, child.true, NEVER), axis=axis, initial=NEVER)
        false = np.max(np.where(there, child.false, -1), axis=axis, initial=-1)
        at = column(known, false.ndim)
        return Node(axes, true, np.maximum(false, at))

    # -- atoms -------------------------------------------------------------------------------

    def atom(self, atom: Atom) -> tuple[Axes, Mask, Mask | None]:
        """Whether the atom holds, and whether that is known (None: it always is)."""
        if id(atom) not in self.atoms:
            self.atoms[id(atom)] = self._evaluated(atom)
        return self.atoms[id(atom)]

    def _evaluated(self, atom: Atom) -> tuple[Axes, Mask, Mask | None]:
        axes, a, b, known = self.operands(atom.left, atom.right)
        holds = compare(atom.operator, a, b, known)
        is_known = bool(known.all())
        if len(holds) != self.rows or holds.shape != known.shape:
            # An atom over objects and constants alone has one row.
            shape = (self.rows, *np.broadcast_shapes(holds.shape, known.shape)[1:])
            holds, known = np.broadcast_to(holds, shape), np.broadcast_to(known, shape)
        return axes, holds, None if is_known else known

    def _constant(self, holds: Mask, axes: Axes) -> Node:
        """A node that is determined at its own state."""
        at = column(self.at, holds.ndim)
        return Node(axes, np.where(holds, at, NEVER), np.where(holds, NEVER, at))

    def value(self, value: Value) -> tuple[Axes, NDArray[Any], Mask]:
        """The values of a term at each state, and where they are known."""
        match value:
            case Constant(constant, kind):
                made = np.asarray([constant], object if kind is Kind.TEXT else None)
                return (), made, np.ones(1, np.bool_)
            case ObjectVariable(name) if name in self.values:
                names = self.values[name].reshape(-1, 1)
                return (name,), names, np.ones(names.shape, np.bool_)
            case ObjectVariable(name):
                # Sorts overlap, so objects are compared by name and not by place.
                names = np.array([self.states.objects[self.sorts[name]]], object)
                return (name,), names, np.ones(names.shape, np.bool_)
            case ObjectConstant(iri):
                return (), np.array([iri], object), np.ones(1, np.bool_)
            case Calculation(operator, left, right):
                return self._calculation(operator, left, right)
            case Reading():
                return self._reading(value)
            case Parameter(name):
                made = self.values[name]
                return (), made, np.ones(len(made), np.bool_)
            case _:
                assert_never(value)

    def _reading(self, reading: Reading) -> tuple[Axes, NDArray[Any], Mask]:
        found = self.states.values[term_of(reading, self.sorts)]
        names = [a.name for a in reading.arguments if isinstance(a, ObjectVariable)]
        values, known = found.values, found.known
        axes = tuple(sorted(set(names)))
        if names != list(axes):
            letters = {name: chr(ord("b") + i) for i, name in enumerate(axes)}
            spec = f"a{''.join(letters[n] for n in names)}->a{''.join(letters.values())}"
            known = np.einsum(spec, known)
            places = np.einsum(spec, np.arange(values.size).reshape(values.shape))
            values = values.reshape(-1)[places]
        return axes, values, known

    def operands(self, left: Value, right: Value) -> tuple[Axes, NDArray[Any], NDArray[Any], Mask]:
        """The values of both sides over the union of their axes, and where both are known."""
        (a_axes, a, a_known), (b_axes, b, b_known) = self.value(left), self.value(right)
        axes = _union(a_axes, b_axes)
        known = spread(a_known, a_axes, axes) & spread(b_known, b_axes, axes)
        return axes, spread(a, a_axes, axes), spread(b, b_axes, axes), known

    def _calculation(
        self, operator: str, left: Value, right: Value
    ) -> tuple[Axes, NDArray[Any], Mask]:
        axes, a, b, known = self.operands(left, right)
        with np.errstate(all="ignore"):
            match operator:
                case "+":
                    return axes, a + b, known
                case "-":
                    return axes, a - b, known
                case "*":
                    return axes, a * b, known
                case _:
                    return axes, np.divide(a, b), known & (b != 0)


def term_of(reading: Reading, sorts: Mapping[str, str]) -> Term:
    """Return the term whose values a reading is; ``sorts`` has the sort of each variable."""
    return reading.feature, tuple(
        sorts[a.name] if isinstance(a, ObjectVariable) else f"<{a.iri}>" for a in reading.arguments
    )


def terms_of(formula: Formula, sorts: Mapping[str, str]) -> frozenset[Term]:
    """Return the terms whose values a formula reads."""
    return frozenset(term_of(reading, sorts) for reading in readings_of(formula))


def compare(operator: str, a: NDArray[Any], b: NDArray[Any], known: Mask) -> Mask:
    """Compare values; those of texts where they are known, as others may be of any kind."""
    if a.dtype != np.object_ and b.dtype != np.object_:
        found: Mask = OPERATORS[operator](a, b)
        return found
    a, b, known = np.broadcast_arrays(a, b, known)
    holds = np.zeros(known.shape, np.bool_)
    holds[known] = OPERATORS[operator](a[known], b[known])
    return holds


@dataclass(frozen=True, slots=True, eq=False)
class Threshold:
    """A comparison of a feature with a constant, which needs no more than one call."""

    term: Term
    operator: str
    constant: NDArray[Any]

    @classmethod
    def of_atom(cls, atom: Atom, sorts: Mapping[str, str]) -> Threshold | None:
        match atom:
            case Atom(operator, Reading() as reading, Constant(value, kind)) if (
                len(reading.arguments) < 2
            ):
                constant = np.asarray([value], object if kind is Kind.TEXT else None)
                return cls(term_of(reading, sorts), operator, constant)
            case _:
                return None

    def of(self, states: States) -> tuple[Mask, Mask | None]:
        """As `Pass.atom`, without the axes."""
        found = states.values[self.term]
        known = found.known
        holds = compare(self.operator, found.values, self.constant, known)
        return holds, None if np.count_nonzero(known) == known.size else known


# -- tables ----------------------------------------------------------------------------------


def _negated(node: Node) -> Node:
    return Node(node.axes, node.false, node.true)


def _disjunction(left: Node, right: Node) -> Node:
    left, right = _aligned(left, right)
    return Node(left.axes, np.minimum(left.true, right.true), np.maximum(left.false, right.false))


def _aligned(left: Node, right: Node) -> tuple[Node, Node]:
    """Both over the union of their axes."""
    if left.axes == right.axes:
        return left, right
    axes = _union(left.axes, right.axes)
    a_true, b_true = (spread(each.true, each.axes, axes) for each in (left, right))
    a_false, b_false = (spread(each.false, each.axes, axes) for each in (left, right))
    a_true, b_true, a_false, b_false = np.broadcast_arrays(a_true, b_true, a_false, b_false)
    return Node(axes, a_true, a_false), Node(axes, b_true, b_false)


def aligned_tables(
    left: tuple[Axes, NDArray[Any]], right: tuple[Axes, NDArray[Any]]
) -> tuple[Axes, NDArray[Any], NDArray[Any]]:
    """Both tables over the union of their axes."""
    axes = _union(left[0], right[0])
    a, b = (spread(table, own, axes) for own, table in (left, right))
    a, b = np.broadcast_arrays(a, b)
    return axes, a, b


def _union(left: Axes, right: Axes) -> Axes:
    return tuple(sorted({*left, *right}))


def spread(table: NDArray[Any], axes: Axes, target: Axes) -> NDArray[Any]:
    """Return ``table`` with an axis of length 1 for each variable of ``target`` that it lacks."""
    if axes == target:
        return table
    return table[(slice(None), *(slice(None) if name in axes else None for name in target))]


def spread_node(node: Node, axes: Axes, shape: Sequence[int]) -> Node:
    true, false = (
        np.broadcast_to(spread(part, node.axes, axes), shape) for part in (node.true, node.false)
    )
    return Node(axes, true, false)


def _flat(node: Node) -> Node:
    """The same with one axis behind the states."""
    if node.true.ndim == 2:
        return node
    rows = len(node.true)
    columns = int(np.prod(node.true.shape[1:], dtype=np.int64))
    return Node(node.axes, node.true.reshape(rows, columns), node.false.reshape(rows, columns))


def _shaped(like: Node, true: Moments, false: Moments) -> Node:
    return Node(like.axes, true.reshape(like.true.shape), false.reshape(like.true.shape))


def column(rows: NDArray[Any], dimensions: int) -> NDArray[Any]:
    return rows.reshape((-1,) + (1,) * (dimensions - 1))
