"""Random SASE+ texts, as the parser gives them."""

from __future__ import annotations

from dataclasses import replace
from random import Random

from default_drawing import with_defaults

from dyknow.languages.errors import Span
from dyknow.languages.mtl.ast import (
    Measured,
    Number,
    Slot,
    Symbol,
    Text,
    TimePoint,
    Truth,
    Variable,
)
from dyknow.languages.sase import ast
from dyknow.ontology.units import parse_unit

HERE = Span(0, 0)
NAMES = ["a", "b", "i", "seq", "any", "within", "from", "count", "true", "len", "prefix", "Stock_1"]
UNITS = [None, None, parse_unit("km.h-1"), parse_unit("no_unit")]


class TextDrawing:
    """Any text that the grammar admits; names need not mean anything."""

    def __init__(self, seed: int) -> None:
        self.random = Random(seed)

    def name(self) -> str:
        return self.random.choice(NAMES)

    def symbol(self) -> Symbol:
        text = self.random.choice([self.name(), "dyknow:speed", "<http://example.org/x#y>"])
        return Symbol(text, HERE)

    def some(self, make, most: int, least: int = 0) -> tuple:
        return tuple(make() for _ in range(self.random.randint(least, most)))

    def pattern(self) -> ast.Pattern:
        draw = self.random
        return ast.Pattern(
            draw.choice(["", "stocks", "as", "http://example.org/out"]),
            draw.choice([None, None, self.symbol()]),
            self.some(self.part, 3, 1),
            draw.choice([None, *ast.Strategy]),
            self.some(self.condition, 3),
            draw.choice([None, 0, 1, 1500, 12 * 3600 * 10**9, Variable("x", HERE)]),
            self.some(self.condition, 2),
            self.some(self.item, 3),
            draw.choice([None, 1, 1000]),
            draw.choice([None, None, 0, 5 * 10**9]),
            HERE,
        )

    def template(self) -> ast.PatternTemplate:
        names = self.random.sample(["x", "limit", "in"], self.random.randint(0, 3))
        slots = tuple(
            Slot(Variable(name, HERE), self.random.choice([None, self.symbol()]), HERE)
            for name in names
        )
        pattern = replace(self.pattern(), name="e")
        slots = with_defaults(slots, self.random)
        return ast.PatternTemplate("http://example.org/e", slots, pattern, "")

    def part(self) -> ast.Part:
        draw = self.random
        is_negated = draw.random() < 0.3
        is_kleene = not is_negated and draw.random() < 0.4
        return ast.Part(self.some(self.symbol, 2, 1), self.name(), is_negated, is_kleene, HERE)

    def condition(self) -> ast.Condition:
        draw = self.random
        if draw.random() < 0.3:
            return ast.Equivalence(self.name(), draw.choice([None, self.term(2)]), HERE)
        operator = draw.choice(["<", "<=", ">", ">=", "=", "!="])
        return ast.Comparison(operator, self.term(3), self.term(3), HERE)

    def item(self) -> ast.Item:
        return ast.Item(self.term(2), self.random.choice([None, self.name()]), HERE)

    def term(self, depth: int) -> ast.Term:
        draw = self.random
        if depth and draw.random() < 0.4:
            if draw.random() < 0.2:
                return ast.Negative(self.term(depth - 1), HERE)
            sides = self.term(depth - 1), self.term(depth - 1)
            return ast.Arithmetic(draw.choice("+-*/%"), *sides, HERE)
        match draw.randrange(11):
            case 0:
                return Number(draw.choice([0.0, 1.0, 0.8, 1e20, 2.5e-7]), draw.choice(UNITS), HERE)
            case 1:
                return Text(draw.choice(["", "it's", 'say "x"', "ä\n"]), HERE)
            case 2:
                return draw.choice([Truth(True, HERE), Truth(False, HERE), TimePoint(10**18, HERE)])
            case 3:
                return ast.Duration(draw.choice([0, 1, 90 * 10**9]), HERE)
            case 4:
                return Symbol(draw.choice(["car1", "dyknow:uav1", "<http://x.org/y>"]), HERE)
            case 5:
                variable = Variable(draw.choice(["x", "limit"]), HERE)
                unit = draw.choice(UNITS)
                return variable if unit is None else Measured(variable, unit, HERE)
            case 6:
                return ast.CountMatches(HERE)
            case 7:
                index = draw.choice([ast.Index.ONE, ast.Index.ALL, ast.Index.BEFORE])
                function = draw.choice(["count", "sum", "min", "max", "avg"])
                name = None if function == "count" else self.name()
                return ast.Aggregate(function, self.name(), index, name, HERE)
            case _:
                return ast.Attribute(self.name(), draw.choice([*ast.Index][:6]), self.name(), HERE)
