"""Rows that the operators of a plan give, estimated as in textbooks.

Selinger et al., *Access Path Selection in a Relational Database Management System* (SIGMOD 1979);
for joins |L||R| / max(V(L,a), V(R,a)). A relation is its rows and V(a), the distinct values of each
variable; it assumes that values are spread evenly and variables are independent.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from math import prod
from typing import assert_never

from ..algebra.expressions import Call, Const, Expression, Var, variables
from ..algebra.plan import (
    START,
    STOP,
    Aggregate,
    AnyScan,
    Closure,
    Distinct,
    Exists,
    Extend,
    Filter,
    Given,
    Join,
    LeftJoin,
    Minus,
    Order,
    Plan,
    Project,
    Scan,
    Slice,
    TypeScan,
    Union,
    Values,
    outputs,
)
from .pattern_sizes import Known, PatternSizes, Size, either, named_in

EQUAL, RANGE, OTHER = 1 / 10, 1 / 3, 1 / 2
"""The share of rows that passes ``=`` between computed values, ``<`` and its like, other tests."""
REACH = 2.0
"""Pairs of ``p+`` for each pair of ``p``: a guess, since it depends on the graph."""
MOST = 1e18
"""The greatest estimate, so that all are finite."""


class Sizes:
    """The estimated sizes of plans; it computes each plan once, by identity."""

    def __init__(self, known: Known) -> None:
        self.patterns = PatternSizes(known)
        self._sizes: dict[int, tuple[Plan, Size]] = {}

    def of(self, plan: Plan) -> Size:
        found = self._sizes.get(id(plan))
        if found is None:
            size = self._of(plan)
            rows = min(max(size.rows, 0.0), MOST)
            distinct = {name: min(v, rows) for name, v in size.distinct.items()}
            found = self._sizes[id(plan)] = plan, Size(rows, distinct)
        return found[1]

    def _of(self, plan: Plan) -> Size:
        match plan:
            case Scan() | TypeScan() | AnyScan():
                return self.patterns.of(plan)
            case Closure():
                return _closed(plan, self.of(plan.step))
            case Values(names, rows):
                columns = zip(*rows, strict=True)
                counts = (float(len({*column} - {None})) for column in columns)
                return Size(float(len(rows)), dict(zip(names, counts, strict=False)))
            case Given():
                return Size(1.0, {})
            case Join(parts):
                return joined_all([self.of(part) for part in parts])
            case LeftJoin(child, optional, condition):
                left = self.of(child)
                both = _joined(left, self.of(optional))
                share = 1.0 if condition is None else passing(condition, both)
                return Size(max(left.rows, both.rows * share), {**both.distinct, **left.distinct})
            case Union(parts):
                return either([self.of(part) for part in parts])
            case Minus(child, removed):
                left = self.of(child)
                if outputs(child).isdisjoint(outputs(removed)):
                    return left
                return _scaled(left, 1 - _semijoin(left, self.of(removed)))
            case Exists(variable, _, child):
                below = self.of(child)
                return Size(below.rows, {**below.distinct, variable: 2.0})
            case Filter(condition, child):
                return _filtered(condition, self.of(child))
            case Extend(variable, expression, child):
                below = self.of(child)
                values = combinations(below, variables(expression))
                return Size(below.rows, {**below.distinct, variable: values})
            case Aggregate(keys, aggregations, child, implicit):
                below = self.of(child)
                groups = combinations(below, keys) if keys else min(1.0, below.rows)
                groups = max(groups, 1.0) if implicit else groups
                made = {one.variable: groups for one in aggregations}
                return Size(groups, {key: below.v(key) for key in keys} | made)
            case Project(names, child):
                below = self.of(child)
                return Size(below.rows, {n: below.v(n) for n in names if n in below.distinct})
            case Distinct(child):
                below = self.of(child)
                return Size(combinations(below, below.distinct), below.distinct)
            case Order(_, child):
                return self.of(child)
            case Slice(start, length, child):
                below = self.of(child)
                left_over = max(below.rows - start, 0.0)
                shown = left_over if length is None else min(left_over, length)
                return Size(shown, below.distinct)
            case _:
                assert_never(plan)


def combinations(size: Size, names: Iterable[str]) -> float:
    """The distinct combinations of values of these variables."""
    return min(size.rows, prod((max(size.v(name), 1.0) for name in names), start=1.0))


def _scaled(size: Size, share: float) -> Size:
    return Size(size.rows * share, size.distinct)


def _joined(left: Size, right: Size) -> Size:
    """The join of textbooks: each value of the side with fewer values has a partner."""
    shared = left.distinct.keys() & right.distinct.keys()
    v = {**left.distinct, **right.distinct}
    v |= {name: min(left.v(name), right.v(name)) for name in shared}
    rows = left.rows * right.rows
    for name in sorted(shared):
        rows /= max(left.v(name), right.v(name), 1.0)
    return Size(rows, {name: min(value, rows) for name, value in v.items()})


def joined_all(parts: Sequence[Size]) -> Size:
    """In the order of `joins.join_all`."""
    if not parts:
        return Size(1.0, {})
    waiting = sorted(parts, key=lambda part: part.rows)
    joined = waiting.pop(0)
    while waiting:
        linked = [
            i for i, p in enumerate(waiting) if not p.distinct.keys().isdisjoint(joined.distinct)
        ]
        joined = _joined(joined, waiting.pop(linked[0] if linked else 0))
    return joined


def _semijoin(left: Size, right: Size) -> float:
    """The share of ``left`` that has a partner."""
    if not right.rows:
        return 0.0
    shared = left.distinct.keys() & right.distinct.keys()
    return prod(min(1.0, right.v(name) / max(left.v(name), 1.0)) for name in shared)


def _closed(plan: Closure, step: Size) -> Size:
    starts, stops = max(step.v(START), 1.0), max(step.v(STOP), 1.0)
    rows = min(step.rows * (REACH if plan.more else 1.0), starts * stops)
    if plan.zero:
        nodes = step.v(START) + step.v(STOP)
        rows, starts, stops = rows + nodes, max(nodes, 1.0), max(nodes, 1.0)
    if isinstance(plan.subject, Const):
        rows /= starts
    if isinstance(plan.object, Const):
        rows /= stops
    return Size(rows, {**named_in(plan.subject, starts), **named_in(plan.object, stops)})


# -- selectivities -------------------------------------------------------------------------


def _filtered(condition: Expression, below: Size) -> Size:
    rows = below.rows * passing(condition, below)
    match condition:
        case Call("=", (Var(name), Const())) | Call("=", (Const(), Var(name))):
            return Size(rows, {**below.distinct, name: 1.0})
        case _:
            return Size(rows, below.distinct)


def passing(condition: Expression, below: Size) -> float:
    """The share of rows for which ``condition`` is true, from 0 to 1."""
    match condition:
        case Const(term):
            return 0.0 if getattr(term, "value", "") in ("false", "0", "") else 1.0
        case Call("&&", (left, right)):
            return passing(left, below) * passing(right, below)
        case Call("||", (left, right)):
            one, other = passing(left, below), passing(right, below)
            return one + other - one * other
        case Call("!", (one,)):
            return 1 - passing(one, below)
        case Call("!=", sides):
            return 1 - passing(Call("=", sides), below)
        case Call("=", sides):
            v = [
                below.distinct[s.name]
                for s in sides
                if isinstance(s, Var) and s.name in below.distinct
            ]
            return 1 / max(*v, 1.0) if len(v) else EQUAL
        case Call("<" | "<=" | ">" | ">=", _):
            return RANGE
        case _:
            return OTHER
