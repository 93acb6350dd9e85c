"""The matches of runs by their definition: each row begins a run, which takes rows one by one.

It reads the plan, and none of the code that evaluates one. A run binds each element to a list of
rows. What a condition reads decides when it is tested (`_Definition.is_met`).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from pattern_definition import CALCULATIONS, COMPARISONS, Match, Row, Step, Watermark

from dyknow.reasoning.patterns.plans.plan import (
    OWN,
    Aggregate,
    Arithmetic,
    Between,
    Condition,
    Constant,
    CountProbe,
    Element,
    Expression,
    Function,
    Listed,
    PatternPlan,
    Point,
    Position,
    Same,
    Selection,
    StateProbe,
    Time,
    Value,
)

Scalar = int | float | None


@dataclass(frozen=True)
class Binding:
    """The rows of each element; ``at``: of a Kleene element the number of the row that is meant."""

    rows: dict[int, tuple[Row, ...]]
    at: dict[int, int]
    own: Row | None = None

    def with_row(self, element: int, row: Row) -> Binding:
        return Binding({**self.rows, element: (*self.rows.get(element, ()), row)}, {})

    @property
    def last(self) -> Row:
        return self.rows[max(self.rows)][-1]


def run_matches(plan: PatternPlan, steps: Sequence[Step]) -> list[Match]:
    """All matches, in the order in which they are given out."""
    return Definition(plan, steps).found()


def any_matches(plan: PatternPlan, steps: Sequence[Step]) -> list[Match]:
    """All matches under skip_till_any_match, in the order in which they are given out."""
    return AnyDefinition(plan, steps).found()


class Definition:
    def __init__(self, plan: PatternPlan, steps: Sequence[Step]) -> None:
        self.plan = plan
        self.last = len(plan.elements) - 1
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
                watermark = step.end
            self.watermarks.append(watermark)

    def found(self) -> list[Match]:
        found = []
        for place, row in enumerate(self.rows):
            begun = self.taken(Binding({}, {}), 0, row)
            for match in self.of_run(begun, self.rows[place + 1 :]) if begun else ():
                found += self.given_out(match)
        return [match for _, match in sorted(found, key=lambda each: each[0])]

    # -- runs ----------------------------------------------------------------------------------

    def of_run(self, run: Binding, rest: list[Row]) -> Iterator[Binding]:
        """The matches of a run that has just taken a row."""
        e = max(run.rows)
        if e == self.last and self.is_complete(run, e):
            yield run
        if e == self.last and not self.plan.elements[e].is_kleene:
            return
        for place, row in enumerate(rest):
            take = self.taken(run, e, row) if self.plan.elements[e].is_kleene else None
            go = None
            if e < self.last and self.is_complete(run, e):
                go = self.taken(run, e + 1, row)
            for more in (take, go):
                if more is not None:
                    yield from self.of_run(more, rest[place + 1 :])
            if take or go or self.breaks(run, row):
                return

    def breaks(self, run: Binding, row: Row) -> bool:
        """Whether a row that a run does not take ends it."""
        match self.plan.selection:
            case Selection.STRICT_CONTIGUITY:
                return True
            case Selection.PARTITION_CONTIGUITY:
                return self.partition(row) == self.partition(run.last)
            case _:
                return False

    def partition(self, row: Row) -> tuple[Scalar, ...]:
        return tuple(row.values[column] for column in self.plan.partition)

    def taken(self, run: Binding, e: int, row: Row) -> Binding | None:
        """The run with one more row, if it may take it."""
        plan = self.plan
        if row.start > row.end or not self.suits(plan.elements[e], row):
            return None
        if run.rows and self.start_of(row) <= run.last.end:
            return None
        more = run.with_row(e, row)
        if plan.within is not None and row.end - self.start_of(more.rows[0][0]) > plan.within:
            return None
        if plan.selection is Selection.PARTITION_CONTIGUITY:
            own = self.partition(row)
            if None in own or own != self.partition(more.rows[0][0]):
                return None
        if not all(self.agrees(variable, more) for variable in self.variables()):
            return None
        is_first = len(more.rows[e]) == 1
        constraints = [*plan.conditions, *plan.between]
        for each in constraints:
            if self.last_of(each) != e or self.reads_whole(each, e):
                continue
            if not self.is_met(each, more, {e: len(more.rows[e]) - 1}, is_first):
                return None
        return more

    def is_complete(self, run: Binding, e: int) -> bool:
        """Whether what reads the whole of an element holds."""
        constraints = [*self.plan.conditions, *self.plan.between]
        whole = [c for c in constraints if self.last_of(c) == e and self.reads_whole(c, e)]
        return all(self.is_met(each, run, {}, False) for each in whole)

    # -- constraints ---------------------------------------------------------------------------

    def variables(self) -> list[set[tuple[int, str]]]:
        found: list[set[tuple[int, str]]] = []
        for same in self.plan.same:
            columns = {(same.first, same.first_column), (same.second, same.second_column)}
            for each in [each for each in found if each & columns]:
                columns |= each
                found.remove(each)
            found.append(columns)
        return found

    def agrees(self, variable: set[tuple[int, str]], run: Binding) -> bool:
        """Whether all rows bound so far have one value of a variable."""
        values = {row.values[column] for e, column in variable for row in run.rows.get(e, ())}
        return len(values) <= 1 and None not in values

    def last_of(self, each: Condition | Between) -> int:
        if isinstance(each, Between):
            return max(each.first.element, each.second.element)
        return max((e for side in (each.left, each.right) for e in elements_read(side)), default=0)

    def reads_whole(self, each: Condition | Between, e: int) -> bool:
        if not self.plan.elements[e].is_kleene:
            return False
        if isinstance(each, Between):
            return any(p.element == e and not p.is_start for p in (each.first, each.second))
        return any(whole_read(side, e) for side in (each.left, each.right))

    def is_met(
        self, each: Condition | Between, run: Binding, at: dict[int, int], is_first: bool
    ) -> bool:
        """Whether a constraint holds for each row of the Kleene elements that it reads row by row;
        of an element in ``at`` for that row only."""
        if isinstance(each, Between):
            distance = self.time(each.second, run) - self.time(each.first, run)
            return (each.least is None or distance >= each.least) and (
                each.most is None or distance <= each.most
            )
        if is_first and any(before_read(side) for side in (each.left, each.right)):
            return True
        sides = each.left, each.right
        read = {e for side in sides for e in each_read(side)}
        later = {e for side in sides for e in elements_read(side) if before_read(side, e)}
        read |= later
        ranges = [
            range(int(e in later), len(run.rows[e])) if e not in at else [at[e]]
            for e in sorted(read | set(at))
        ]
        for places in itertools.product(*ranges):
            places_of = dict(zip(sorted(read | set(at)), places, strict=True))
            if not self.holds(each, Binding(run.rows, places_of)):
                return False
        return True

    def suits(self, element: Element, row: Row) -> bool:
        own = Binding({}, {}, row)
        return row.kind in element.kinds and all(self.holds(c, own) for c in element.conditions)

    # -- probes and order ------------------------------------------------------------------------

    def given_out(self, match: Binding) -> list[tuple[tuple[Any, ...], Match]]:
        """The match with its place in the order, or nothing if it is never decided."""
        if not all(self.meets(probe, match) for probe in self.plan.probes):
            return []
        completed = self.step_of[match.last.number]
        decided = match.last.end
        due = max((self.known_from(probe, match) for probe in self.plan.probes), default=-math.inf)
        waits = due > self.watermarks[completed]
        step = completed
        if waits:
            decided = int(due)
            step = next((i for i, w in enumerate(self.watermarks) if w >= due), -1)
            if step < 0:
                return []
        outputs = tuple(self.output(each.value, match) for each in self.plan.outputs)
        rows = [match.rows[e] for e in range(self.last + 1)]
        order = (
            *(each[0].number for each in rows),
            *(each[-1].number for each in rows),
            *(tuple(row.number for row in each) for each in rows),
        )
        found = Match(tuple(each[0].number for each in rows), decided, step, outputs)
        return [((step, not waits, decided if waits else 0, order), found)]

    def meets(self, probe: CountProbe | StateProbe, match: Binding) -> bool:
        asked = [
            row
            for row in self.rows
            if self.suits(probe.what, row)
            and all(self.are_same(same, match, row) for same in probe.same)
        ]
        if isinstance(probe, StateProbe):
            at = self.time(probe.at.point, match) + probe.at.offset
            before = [row for row in asked if row.end <= at]
            if not before:
                return False
            own = Binding(match.rows, {}, max(before, key=lambda row: (row.end, row.number)))
            return all(self.holds(each, own) for each in probe.state)
        low, high = (self.time(each.point, match) + each.offset for each in (probe.low, probe.high))
        count = sum(
            low <= row.end <= high
            and all(self.holds(c, Binding(match.rows, {}, row)) for c in probe.conditions)
            for row in asked
        )
        return probe.least <= count and (probe.most is None or count <= probe.most)

    def are_same(self, same: Same, match: Binding, row: Row) -> bool:
        value = row.values[same.first_column]
        return value is not None and value == match.rows[same.second][0].values[same.second_column]

    def known_from(self, probe: CountProbe | StateProbe, match: Binding) -> float:
        """The watermark from which on no row changes the probe."""
        high = probe.at if isinstance(probe, StateProbe) else probe.high
        low = probe.at if isinstance(probe, StateProbe) else probe.low
        until = self.time(high.point, match) + high.offset
        return -math.inf if until < self.time(low.point, match) + low.offset else until + 1

    # -- values --------------------------------------------------------------------------------

    def start_of(self, row: Row) -> int:
        return row.start if self.plan.has_intervals else row.end

    def start(self, match: Binding) -> int:
        return self.start_of(match.rows[0][0])

    def time(self, point: Point, run: Binding) -> int:
        rows = run.rows[point.element]
        return self.start_of(rows[0]) if point.is_start else rows[-1].end

    def holds(self, condition: Condition, run: Binding) -> bool:
        left, right = self.value(condition.left, run), self.value(condition.right, run)
        if left is None or right is None:
            return False
        return COMPARISONS[condition.operator](left, right)

    def output(self, value: Expression | Listed, match: Binding) -> Any:
        if isinstance(value, Listed):
            return tuple(row.values[value.column] for row in match.rows[value.element])
        return self.value(value, match)

    def value(self, expression: Expression, run: Binding) -> Scalar:
        match expression:
            case Constant(value):
                return value
            case Value(element, column, position):
                return self.row(element, position, run).values[column]
            case Time(elements, is_start):
                if elements == (OWN,):
                    assert run.own
                    return self.start_of(run.own) if is_start else run.own.end
                times = [self.time(Point(e, is_start), run) for e in elements if e != OWN]
                if OWN in elements:
                    assert run.own
                    times.append(self.start_of(run.own) if is_start else run.own.end)
                return min(times) if is_start else max(times)
            case Arithmetic(operator_, left, right):
                sides = self.value(left, run), self.value(right, run)
                return None if None in sides else CALCULATIONS[operator_](*sides)
            case Aggregate(function, element, column, is_before):
                rows = run.rows[element]
                if is_before:
                    rows = rows[: run.at[element]]
                return aggregate(function, rows, column)
            case _:
                raise NotImplementedError(expression)

    def row(self, element: int, position: Position, run: Binding) -> Row:
        if element == OWN:
            assert run.own
            return run.own
        rows = run.rows[element]
        match position:
            case Position.FIRST:
                return rows[0]
            case Position.LAST:
                return rows[-1]
            case Position.PREVIOUS:
                return rows[run.at[element] - 1]
            case _:
                return rows[run.at[element]] if self.plan.elements[element].is_kleene else rows[0]


class AnyDefinition(Definition):
    """A match is any rows that follow each other and meet all of the plan."""

    def found(self) -> list[Match]:
        found = []
        for match in self.all_matches():
            found += self.given_out(match)
        return [match for _, match in sorted(found, key=lambda each: each[0])]

    def all_matches(self) -> list[Binding]:
        """All matches, but for probes."""
        found = []
        for place in range(len(self.rows)):
            begun = self.sequences(Binding({}, {}), 0, self.rows[place:])
            found += [match for match in begun if self.meets_plan(match)]
        return found

    def sequences(self, before: Binding, e: int, rest: list[Row]) -> Iterator[Binding]:
        """The sequences of rows of all elements that go on with the first row of the rest."""
        row = rest[0]
        if row.start > row.end or not self.suits(self.plan.elements[e], row):
            return
        if before.rows and self.start_of(row) <= before.last.end:
            return
        here = before.with_row(e, row)
        within = self.plan.within
        if within is not None and row.end - self.start(here) > within:
            return
        if e == self.last:
            yield here
        for place in range(1, len(rest)):
            if self.plan.elements[e].is_kleene:
                yield from self.sequences(here, e, rest[place:])
            if e < self.last:
                yield from self.sequences(here, e + 1, rest[place:])

    def meets_plan(self, match: Binding) -> bool:
        plan = self.plan
        return all(self.agrees(variable, match) for variable in self.variables()) and all(
            self.is_met(each, match, {}, False) for each in (*plan.conditions, *plan.between)
        )


def aggregate(function: Function, rows: Sequence[Row], column: str | None) -> Scalar:
    """An aggregate over the values that are there."""
    if column is None:
        return len(rows)
    values = [row.values[column] for row in rows if row.values[column] is not None]
    if function is Function.COUNT:
        return len(values)
    if not values:
        return None
    match function:
        case Function.SUM:
            return _sum(values)
        case Function.MIN:
            return min(values)
        case Function.MAX:
            return max(values)
        case _:
            return _sum(values) / len(values)


def _sum(values: Sequence[Any]) -> Any:
    total = values[0]
    for value in values[1:]:
        total += value
    return total


def leaves(expression: Expression) -> Iterator[Expression]:
    if isinstance(expression, Arithmetic):
        yield from leaves(expression.left)
        yield from leaves(expression.right)
    else:
        yield expression


def elements_read(side: Expression) -> Iterator[int]:
    for leaf in leaves(side):
        match leaf:
            case Value(element) | Aggregate(_, element):
                yield element
            case Time(elements):
                yield from elements


def each_read(side: Expression) -> Iterator[int]:
    """The elements of which each row is read."""
    for leaf in leaves(side):
        if isinstance(leaf, Value) and leaf.position is Position.EACH and leaf.element != OWN:
            yield leaf.element


def whole_read(side: Expression, e: int) -> bool:
    return any(
        (isinstance(leaf, Value) and leaf.position is Position.LAST and leaf.element == e)
        or (isinstance(leaf, Aggregate) and not leaf.is_before and leaf.element == e)
        or (isinstance(leaf, Time) and not leaf.is_start and e in leaf.elements)
        for leaf in leaves(side)
    )


def before_read(side: Expression, e: int | None = None) -> bool:
    """Whether a side reads ``a[i-1]`` or ``a[..i-1]``, of element e if it is given."""
    return any(
        (
            isinstance(leaf, Value)
            and leaf.position is Position.PREVIOUS
            and e in (None, leaf.element)
        )
        or (isinstance(leaf, Aggregate) and leaf.is_before and e in (None, leaf.element))
        for leaf in leaves(side)
    )
