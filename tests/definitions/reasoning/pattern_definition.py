"""The matches of a pattern plan by their definition: enumerate all tuples of rows.

It reads the plan, and none of the code that evaluates one. Time is a list of *steps* in order of
arrival: a row, or a watermark. It covers plans without repetition.
"""

from __future__ import annotations

import itertools
import math
import operator
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from dyknow.reasoning.patterns.plans.plan import (
    NO_VALUE,
    OWN,
    Arithmetic,
    ColumnType,
    Condition,
    Constant,
    CountProbe,
    Element,
    Expression,
    PatternPlan,
    Point,
    Same,
    StateProbe,
    Time,
    Value,
)
from dyknow.reasoning.patterns.plans.plan import Bound as TimeBound

COMPARISONS: dict[str, Callable[[Any, Any], bool]] = {
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
    "=": operator.eq,
    "!=": operator.ne,
}
CALCULATIONS: dict[str, Callable[[Any, Any], Any]] = {
    "+": operator.add,
    "-": operator.sub,
    "*": operator.mul,
    "/": lambda a, b: a / b if b else None,
    "%": lambda a, b: math.fmod(a, b) if b else None,
}


@dataclass(frozen=True)
class Row:
    """One row; ``number`` counts arrivals. A value that is missing is None."""

    number: int
    kind: str
    start: int
    end: int
    values: dict[str, int | float | None]


@dataclass(frozen=True)
class Watermark:
    """No later row ends before ``time``."""

    time: int


@dataclass(frozen=True)
class Match:
    """``step``: when it is given out, as the place of a step."""

    rows: tuple[int, ...]
    decided: int
    step: int
    outputs: tuple[int | float | None, ...]


Step = Row | Watermark
Bound = dict[int, Row]


def matches(plan: PatternPlan, steps: Sequence[Step], *, is_ordered: bool = True) -> list[Match]:
    """All matches, in the order in which they are given out."""
    definition = _Definition(plan, steps, is_ordered)
    return definition.found()


class _Definition:
    def __init__(self, plan: PatternPlan, steps: Sequence[Step], is_ordered: bool) -> None:
        self.plan = plan
        self.is_ordered = is_ordered
        self.watermarks: list[float] = []
        """After each step."""
        self.rows: list[Row] = []
        """Those that are not late."""
        self.step_of: dict[int, int] = {}
        watermark = -math.inf
        for place, step in enumerate(steps):
            if isinstance(step, Watermark):
                watermark = max(watermark, step.time)
            elif step.end >= watermark:
                self.rows.append(step)
                self.step_of[step.number] = place
                if is_ordered:
                    watermark = step.end
            self.watermarks.append(watermark)

    def found(self) -> list[Match]:
        candidates = [
            [row for row in self.rows if self.suits(element, row)] for element in self.plan.elements
        ]
        found = []
        for rows in itertools.product(*candidates):
            bound = dict(enumerate(rows))
            if self.is_match(bound):
                found += self.given_out(bound)
        return [match for _, match in sorted(found, key=lambda each: each[0])]

    def given_out(self, bound: Bound) -> list[tuple[tuple[Any, ...], Match]]:
        """The match with its place in the order, or nothing if it is never decided."""
        rows = tuple(bound.values())
        completed = max(self.step_of[row.number] for row in rows)
        decided = max(row.end for row in rows)
        due = max((self.known_from(probe, bound) for probe in self.plan.probes), default=-math.inf)
        by_element = tuple((row.end, row.number) for row in rows)
        waits = due > self.watermarks[completed]
        step = completed
        if waits:
            decided = int(due)
            step = next((i for i, w in enumerate(self.watermarks) if w >= due), -1)
            if step < 0:
                return []
        outputs = tuple(self.value(each.value, bound) for each in self.plan.outputs)
        match = Match(tuple(row.number for row in rows), decided, step, outputs)
        return [((step, not waits, decided if waits else 0, by_element), match)]

    # -- what a match must meet ----------------------------------------------------------------

    def suits(self, element: Element, row: Row) -> bool:
        own = {OWN: row}
        return row.kind in element.kinds and all(self.holds(c, own) for c in element.conditions)

    def is_match(self, bound: Bound) -> bool:
        plan = self.plan
        numbers = [row.number for row in bound.values()]
        if plan.is_distinct and len(set(numbers)) < len(numbers):
            return False
        if plan.within is not None and self.end(bound) - self.start(bound) > plan.within:
            return False
        if any(self.time(Point(e, True), bound) > row.end for e, row in bound.items()):
            return False
        for each in plan.between:
            distance = self.time(each.second, bound) - self.time(each.first, bound)
            if each.least is not None and distance < each.least:
                return False
            if each.most is not None and distance > each.most:
                return False
        for hull in plan.hulls:
            sides = [{e: bound[e] for e in side} for side in (hull.left, hull.right)]
            if len({(self.start(side), self.end(side)) for side in sides}) > 1:
                return False
        return (
            all(self.are_same(each, bound) for each in plan.same)
            and all(self.holds(each, bound) for each in plan.conditions)
            and all(self.meets(probe, bound) for probe in plan.probes)
        )

    def meets(self, probe: CountProbe | StateProbe, bound: Bound) -> bool:
        asked = [row for row in self.rows if self.suits(probe.what, row)]
        asked = [
            row for row in asked if all(self.are_same(s, {**bound, OWN: row}) for s in probe.same)
        ]
        if isinstance(probe, StateProbe):
            at = self.bound_time(probe.at, bound)
            before = [row for row in asked if row.end <= at]
            if not before:
                return False
            last = max(before, key=lambda row: (row.end, row.number))
            return all(self.holds(each, {**bound, OWN: last}) for each in probe.state)
        low, high = self.bound_time(probe.low, bound), self.bound_time(probe.high, bound)
        count = sum(
            low <= row.end <= high
            and all(self.holds(each, {**bound, OWN: row}) for each in probe.conditions)
            for row in asked
        )
        return probe.least <= count and (probe.most is None or count <= probe.most)

    def known_from(self, probe: CountProbe | StateProbe, bound: Bound) -> float:
        """The watermark from which on no row changes the probe."""
        until = self.bound_time(probe.at if isinstance(probe, StateProbe) else probe.high, bound)
        low = until if isinstance(probe, StateProbe) else self.bound_time(probe.low, bound)
        return -math.inf if until < low else until + 1

    # -- values --------------------------------------------------------------------------------

    def time(self, point: Point, bound: Bound) -> int:
        row = bound[point.element]
        return row.start if point.is_start and self.plan.has_intervals else row.end

    def bound_time(self, at: TimeBound, bound: Bound) -> int:
        return self.time(at.point, bound) + at.offset

    def start(self, bound: Bound) -> int:
        return min(self.time(Point(e, True), bound) for e in bound)

    def end(self, bound: Bound) -> int:
        return max(row.end for row in bound.values())

    def are_same(self, same: Same, bound: Bound) -> bool:
        first = bound[same.first].values[same.first_column]
        second = bound[same.second].values[same.second_column]
        return first is not None and first == second

    def holds(self, condition: Condition, bound: Bound) -> bool:
        left, right = self.value(condition.left, bound), self.value(condition.right, bound)
        if left is None or right is None:
            return False
        return COMPARISONS[condition.operator](left, right)

    def value(self, expression: Expression, bound: Bound) -> int | float | None:
        match expression:
            case Constant(value):
                return value
            case Value(element, column):
                return bound[element].values[column]
            case Time(elements, is_start):
                rows = {e: bound[e] for e in elements}
                return self.start(rows) if is_start else self.end(rows)
            case Arithmetic(operator_, left, right):
                sides = self.value(left, bound), self.value(right, bound)
                return None if None in sides else CALCULATIONS[operator_](*sides)
            case _:
                raise NotImplementedError(expression)


def column_value(type_: ColumnType, value: float | None) -> int | float:
    """A value as it stands in a column."""
    if value is None:
        return math.nan if type_ is ColumnType.NUMBER else NO_VALUE
    return value
