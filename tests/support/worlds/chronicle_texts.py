"""Random chronicles as ASTs: whatever the grammar admits, also what has no meaning."""

from __future__ import annotations

import random

from default_drawing import with_defaults

from dyknow.languages.chronicle import ast
from dyknow.languages.errors import Span
from dyknow.languages.mtl.ast import (
    Binding,
    Measured,
    Number,
    Slot,
    Symbol,
    Text,
    TimePoint,
    Truth,
    Variable,
)
from dyknow.ontology.units import NO_UNIT, UnitPower

NOWHERE = Span(0, 0)
SYMBOLS = ["P", "event", "in", "dyknow:speed", "<http://example.org/a#b>", "uav1"]
UNITS = [None, NO_UNIT, (UnitPower("m"), UnitPower("s", -1))]


class ChronicleTexts:
    """Random ASTs, from one seed."""

    def __init__(self, seed: int) -> None:
        self.random = random.Random(seed)

    def chronicle(self) -> ast.Chronicle:
        draw = self.random
        names = draw.sample(["a", "b", "x_1"], draw.randint(0, 3))
        clauses = tuple(self.clause() for _ in range(draw.randint(0, 6)))
        emitted = draw.choice([None, self.point()])
        stream = draw.choice([None, "found"])
        delay = draw.choice([None, None, 0, 5 * 10**9])
        return ast.Chronicle("N", self.slots(names), clauses, emitted, stream, delay, NOWHERE)

    def template(self) -> ast.ChronicleTemplate:
        parameters = self.slots(["a"])
        chronicle = ast.Chronicle("N", parameters, (self.clause(),), None, None, None, NOWHERE)
        slots = with_defaults(self.slots(["a", "b"]), self.random)
        return ast.ChronicleTemplate("http://example.org/N", slots, chronicle, "")

    def slots(self, names: list[str]) -> tuple[Slot, ...]:
        variables = (Variable(name, NOWHERE) for name in names)
        return tuple(
            Slot(each, self.random.choice([None, self.symbol()]), NOWHERE) for each in variables
        )

    def clause(self) -> ast.Clause:
        draw = self.random
        match draw.randrange(6):
            case 0:
                return ast.Event(self.message(), self.point(), NOWHERE)
            case 1:
                least = draw.randint(0, 3)
                most = draw.choice([None, least + draw.randint(0, 3)])
                times = self.moment(), self.moment()
                return ast.Occurs(least, most, self.message(), *times, NOWHERE)
            case 2:
                state = ast.Message(self.symbol(), self.arguments(), None, self.test(), NOWHERE)
                return ast.Hold(state, self.moment(), self.moment(), NOWHERE)
            case 3:
                low, high = sorted([self.offset(), self.offset()])
                given = ast.Given(self.variable(), draw.choice([-1, 1]), self.offset())
                bounds = [(low, None), (None, high), (None, None), (low, high)]
                bounds += [(given, high), (low, given), (None, given), (given, None)]
                least, most = draw.choice(bounds)
                return ast.Distance(self.point(), self.point(), least, most, NOWHERE)
            case 4:
                operator = draw.choice(["<", "<=", ">", ">=", "=", "!="])
                return ast.Comparison(self.variable(), operator, self.operand(), NOWHERE)
            case _:
                return Binding(self.variable(), self.symbol(), NOWHERE)

    def message(self) -> ast.Message:
        before, value = self.random.choice([(None, None), (self.test(), self.test())])
        return ast.Message(self.symbol(), self.arguments(), before, value, NOWHERE)

    def arguments(self) -> tuple[ast.Argument, ...]:
        draw = self.random
        options = [None, self.variable(), self.symbol(), self.text()]
        return tuple(draw.choice(options) for _ in range(draw.randint(0, 3)))

    def test(self) -> ast.Test | None:
        operator = self.random.choice(["=", "=", "!=", "<", "<=", ">", ">="])
        return self.random.choice([None, ast.Test(operator, self.operand(), NOWHERE)])

    def operand(self) -> ast.Operand:
        draw = self.random
        value = draw.choice([0.0, 1.0, -2.5, 1e300, 1e-9, -3e17])
        return draw.choice(
            [
                Truth(draw.random() < 0.5, NOWHERE),
                Number(value, draw.choice(UNITS), NOWHERE),
                self.text(),
                TimePoint(draw.randint(-(10**18), 10**18), NOWHERE),
                self.symbol(),
                self.variable(),
                Measured(self.variable(), draw.choice(UNITS[1:]), NOWHERE),
            ]
        )

    def symbol(self) -> Symbol:
        return Symbol(self.random.choice(SYMBOLS), NOWHERE)

    def variable(self) -> Variable:
        return Variable(self.random.choice("abcd"), NOWHERE)

    def text(self) -> Text:
        return Text(self.random.choice(["", 'a "b"', "é\n\\", "// no comment"]), NOWHERE)

    def point(self) -> ast.Point:
        return ast.Point(self.random.choice(["t1", "t2", "end", "now_2"]), NOWHERE)

    def moment(self) -> ast.Moment:
        given = ast.Given(self.variable(), self.random.choice([-1, 1]))
        offset = self.random.choice([self.offset(), self.offset(), given])
        return ast.Moment(self.point(), offset, NOWHERE)

    def offset(self) -> int:
        return self.random.choice([0, 0, 1, -1, 5 * 10**9, -(36 * 10**11), 10**18])
