"""Random pattern plans and random rows for them."""

from __future__ import annotations

from dataclasses import replace
from random import Random

import numpy as np
from pattern_definition import Row, Step, Watermark, column_value

from dyknow.reasoning.patterns.plans.plan import (
    ARITHMETIC,
    OPERATORS,
    OWN,
    Arithmetic,
    Between,
    Bound,
    Column,
    ColumnType,
    Condition,
    Constant,
    CountProbe,
    Element,
    EqualHulls,
    Expression,
    Output,
    PatternPlan,
    Point,
    Position,
    Probe,
    Same,
    Selection,
    StateProbe,
    Time,
    Value,
)
from dyknow.reasoning.patterns.plans.rows import Rows

KINDS = ("A", "B", "C")
COLUMNS = (
    Column("x", ColumnType.KEY),
    Column("y", ColumnType.KEY),
    Column("m", ColumnType.INTEGER),
    Column("v", ColumnType.NUMBER),
)
MISSING = 0.05


class PatternDrawing:
    """A plan without repetition, and rows for it."""

    def __init__(self, seed: int, *, is_ordered: bool = True, most_elements: int = 4) -> None:
        self.random = draw = Random(seed)
        self.is_ordered = is_ordered
        self.has_intervals = draw.random() < 0.3
        self.count = draw.randint(1, most_elements)
        self.plan = PatternPlan(
            COLUMNS,
            tuple(self.element(f"e{i}") for i in range(self.count)),
            tuple(self.between() for _ in range(draw.choice([0, 0, 1, 2]))),
            tuple(self.same() for _ in range(draw.choice([0, 0, 1, 1, 2]))),
            tuple(self.condition(range(self.count)) for _ in range(draw.choice([0, 0, 0, 1, 2]))),
            tuple(self.probe() for _ in range(draw.choice([0, 0, 1, 1, 2]))) if is_ordered else (),
            within=draw.choice([None, 3, 8, 25, 25, 25, 25]),
            has_intervals=self.has_intervals,
            hulls=(self.hull(),) if draw.random() < 0.1 else (),
            is_distinct=draw.random() < 0.6,
            outputs=tuple(
                Output(f"o{i}", self.expression(range(self.count), 2))
                for i in range(draw.choice([0, 2]))
            ),
        )

    # -- the plan ------------------------------------------------------------------------------

    def element(self, name: str) -> Element:
        draw = self.random
        kinds = tuple(draw.sample(KINDS, draw.choice([1, 1, 2])))
        own = range(OWN, OWN + 1)
        conditions = (self.condition(own),) if draw.random() < 0.15 else ()
        return Element(name, kinds, conditions)

    def point(self) -> Point:
        draw = self.random
        return Point(draw.randrange(self.count), draw.random() < 0.4)

    def between(self) -> Between:
        draw = self.random
        least = draw.choice([None, draw.randint(-8, 3)])
        most = draw.choice([None, (least or 0) + draw.randint(0, 12)])
        return Between(self.point(), self.point(), least, most)

    def same(self) -> Same:
        draw = self.random
        return Same(self.some(), draw.choice("xxxy"), self.some(), draw.choice("xxxy"))

    def some(self) -> int:
        return self.random.randrange(self.count)

    def condition(self, elements: range) -> Condition:
        draw = self.random
        depth = draw.choice([0, 0, 1, 2])
        sides = self.expression(elements, depth), self.expression(elements, depth)
        return Condition(draw.choice(OPERATORS), *sides)

    def expression(self, elements: range, depth: int) -> Expression:
        draw = self.random
        if depth and draw.random() < 0.7:
            sides = self.expression(elements, depth - 1), self.expression(elements, depth - 1)
            return Arithmetic(draw.choice(ARITHMETIC), *sides)
        drawn = draw.random()
        if drawn < 0.6:
            return Value(draw.choice(elements), draw.choice("xmmvvv"))
        if drawn < 0.75:
            some = tuple(draw.sample(elements, draw.randint(1, min(2, len(elements)))))
            return Time(some, draw.random() < 0.5)
        return Constant(draw.choice([0, 1, 2, 3, 1.5, 2.0]))

    def hull(self) -> EqualHulls:
        left, right = ([self.some() for _ in range(self.random.randint(1, 2))] for _ in "lr")
        return EqualHulls(tuple(left), tuple(right))

    def bound(self) -> Bound:
        return Bound(self.point(), self.random.randint(-4, 4))

    def probe(self) -> Probe:
        draw = self.random
        what = self.element("p")
        same = tuple(
            Same(OWN, column, self.some(), draw.choice("xxy"))
            for column in draw.choice(["", "x", "x", "xy"])
        )
        reads = range(OWN, self.count)
        conditions = (self.condition(reads),) if draw.random() < 0.3 else ()
        if draw.random() < 0.25:
            return StateProbe(what, self.bound(), same, conditions or (self.condition(reads),))
        low = self.bound()
        high = draw.choice([self.bound(), Bound(low.point, low.offset + draw.randint(0, 6))])
        least = draw.choice([0, 0, 0, 0, 1, 2])
        most = draw.choice([0, 0, 1, None]) if not least else draw.choice([least, least + 1, None])
        return CountProbe(what, low, high, least, most, same, conditions)

    # -- the rows ------------------------------------------------------------------------------

    def steps(self, count: int, span: int, *, objects: int = 2) -> list[Step]:
        """Rows and watermarks, with ties and intervals; some rows are late."""
        draw = self.random
        ends = [draw.randrange(span) for _ in range(count)]
        if self.is_ordered:
            ends.sort()
            for _ in range(draw.choice([0, 0, 1])):
                i = draw.randrange(count)
                ends[i] -= draw.randint(1, 5)
        steps: list[Step] = []
        for number, end in enumerate(ends):
            start = end - draw.choice([0, 0, 1, 3, 6, -1]) if self.has_intervals else end
            values = {column.name: self.drawn_value(column, objects) for column in COLUMNS}
            steps.append(Row(number, draw.choice(KINDS), start, end, values))
            if draw.random() < 0.1:
                steps.append(Watermark(end - draw.randint(-3, 2 if self.is_ordered else span // 2)))
        return [*steps, *draw.choice([[], [Watermark(2**63 - 1)], [Watermark(2**63 - 1)]])]

    def drawn_value(self, column: Column, objects: int) -> int | float | None:
        draw = self.random
        if draw.random() < MISSING:
            return None
        match column.type:
            case ColumnType.KEY:
                return draw.randrange(objects)
            case ColumnType.INTEGER:
                return draw.randint(-2, 4)
            case ColumnType.NUMBER:
                return draw.choice([0.0, 0.5, 1.0, 2.0, 3.0])


def rows_of(steps: list[Row]) -> Rows:
    """Rows as columns."""
    return Rows(
        KINDS,
        np.array([KINDS.index(row.kind) for row in steps], np.int64),
        np.array([row.start for row in steps], np.int64),
        np.array([row.end for row in steps], np.int64),
        {
            column.name: np.array(
                [column_value(column.type, row.values[column.name]) for row in steps],
                np.float64 if column.type is ColumnType.NUMBER else np.int64,
            )
            for column in COLUMNS
        },
    )


def parted(plan: PatternPlan, column: str, output: str) -> PatternPlan:
    """The plan with ``column`` equal in all elements and probes, and as ``output``; where rows are
    contiguous, those of equal columns."""
    linked = tuple(Same(0, column, each, column) for each in range(1, len(plan.elements)))
    selection = plan.selection
    if selection is Selection.STRICT_CONTIGUITY:
        selection = Selection.PARTITION_CONTIGUITY
    is_contiguous = selection is Selection.PARTITION_CONTIGUITY
    which = Position.LAST if plan.elements[-1].is_kleene else Position.EACH
    part = Output(output, Value(len(plan.elements) - 1, column, which))
    return replace(
        plan,
        selection=selection,
        partition=(*plan.partition, column) if is_contiguous else (),
        columns=(*plan.columns, Column(column, ColumnType.KEY)),
        same=(*plan.same, *linked),
        probes=tuple(replace(p, same=(*p.same, Same(OWN, column, 0, column))) for p in plan.probes),
        outputs=(*plan.outputs, part),
    )
