"""What a plan says of single rows, for answers to people; `conditions` has the compiled form."""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final, TypeAlias, assert_never

from .plan import (
    Aggregate,
    Arithmetic,
    Condition,
    Constant,
    Expression,
    Key,
    PatternPlan,
    PlanError,
    Point,
    Same,
    Time,
    Value,
)

Number: TypeAlias = int | float
_COMPARISONS: Final[dict[str, Callable[[Any, Any], bool]]] = {
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
    "=": operator.eq,
    "!=": operator.ne,
}
_CALCULATIONS: Final[dict[str, Callable[[Any, Any], Any]]] = {
    "+": operator.add,
    "-": operator.sub,
    "*": operator.mul,
    "/": lambda a, b: a / b if b else None,
    "%": lambda a, b: math.fmod(a, b) if b else None,
}


@dataclass(frozen=True, slots=True)
class Row:
    """A row; ``number`` counts arrivals. A missing value is None."""

    number: int
    start: int
    end: int
    values: Mapping[str, Number | None]


Bound: TypeAlias = dict[int, Row]
"""The row of each element that has one; `OWN` is that of a probe."""


def time_of(plan: PatternPlan, point: Point, bound: Bound) -> int:
    """The time (ns) of a point whose element is bound."""
    row = bound[point.element]
    return row.start if point.is_start and plan.has_intervals else row.end


def are_same(same: Same, bound: Bound) -> bool:
    """Whether two keys are equal; missing ones are not."""
    first = bound[same.first].values[same.first_column]
    return first is not None and first == bound[same.second].values[same.second_column]


def holds(plan: PatternPlan, condition: Condition, bound: Bound) -> bool:
    """Whether a condition holds, all of whose elements are bound to one row."""
    left = value_of(plan, condition.left, bound)
    right = value_of(plan, condition.right, bound)
    if left is None or right is None:
        return False
    return _COMPARISONS[condition.operator](left, right)


def value_of(plan: PatternPlan, expression: Expression, bound: Bound) -> Number | None:
    """The value of an expression, or None where one is missing."""
    match expression:
        case Constant(value):
            return value
        case Value(element, column):
            return bound[element].values[column]
        case Time(elements, is_start):
            times = [time_of(plan, Point(each, is_start), bound) for each in elements]
            return min(times) if is_start else max(times)
        case Arithmetic(symbol, left, right):
            sides = value_of(plan, left, bound), value_of(plan, right, bound)
            return None if None in sides else _CALCULATIONS[symbol](*sides)
        case Key() | Aggregate():
            raise PlanError("it has no value of single rows")
        case _:
            assert_never(expression)
