"""Random formulas of MTL, as the checker gives them."""

from __future__ import annotations

import dataclasses
import random
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from dyknow.languages.mtl.ast import Interval, Temporal
from dyknow.languages.mtl.checked import (
    And,
    Atom,
    Constant,
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
    Within,
)

SORT = "urn:S"
TERMS = [("p", 1), ("q", 1), ("r", 0), ("near", 2)]
OBJECTS = ["urn:a", "urn:b", "urn:c"]


class FormulaDrawing:
    """Random formulas, from one seed."""

    def __init__(self, seed: int) -> None:
        self.random = random.Random(seed)
        self.variables = 0

    def interval(self) -> Interval:
        start = self.random.choice([0, 0, 0, 1, 2, 5])
        end = None if self.random.random() < 0.1 else start + self.random.choice([0, 1, 3, 6, 12])
        return Interval(start, end)

    def atom(self, scope: list[str]):
        if scope and self.random.random() < 0.1:
            # Rigid atoms: the same object, whatever the state.
            sides = [ObjectVariable(self.random.choice(scope)), ObjectConstant(OBJECTS[1])]
            other = self.random.choice([ObjectVariable(self.random.choice(scope)), sides[1]])
            return Atom(self.random.choice(["=", "!="]), sides[0], other)
        name, arity = self.random.choice([t for t in TERMS if scope or not t[1]])
        arguments = tuple(ObjectVariable(self.random.choice(scope)) for _ in range(arity))
        reading = Reading(f"urn:{name}", arguments, Kind.TRUTH, None)
        return Atom("=", reading, Constant(True, Kind.TRUTH))

    def formula(self, depth: int, scope: list[str]):
        if not depth or self.random.random() < 0.1:
            return (
                Truth(self.random.random() < 0.5)
                if self.random.random() < 0.05
                else (self.atom(scope))
            )

        def part(more=()):
            return self.formula(depth - 1, [*scope, *more])

        match self.random.randrange(12):
            case 0:
                return Not(part())
            case 1:
                return And(part(), part())
            case 2 | 3:
                return Or(part(), part())
            case 4:
                return Previous(part())
            case 5 | 6 | 7 | 8:
                operator = self.random.choice([*Temporal])
                return Within(operator, self.interval(), part())
            case 9 | 10:
                return Until(self.random.random() < 0.4, self.interval(), part(), part())
            case _:
                self.variables += 1
                name = f"v{self.variables}"
                return Quantified(self.random.random() < 0.5, name, self.sort(), part([name]))

    def sort(self) -> str:
        """That of the next quantifier."""
        return SORT


X = ObjectVariable("x")


def filled(node: Any, values: Mapping[str, Any]) -> Any:
    """The formula with values in place of parameters."""
    if isinstance(node, Parameter):
        return values[node.name]
    if not dataclasses.is_dataclass(node):
        return node
    fields = [field.name for field in dataclasses.fields(node)]
    return replace(node, **{name: filled(getattr(node, name), values) for name in fields})


class OneObjectDrawing(FormulaDrawing):
    """Formulas of one object, ``x``, of which requests give a truth and an object."""

    def atom(self, scope: list[str]) -> Atom:
        draw = self.random
        if draw.random() < 0.1:
            return Atom(
                "=", X, draw.choice([ObjectConstant(OBJECTS[0]), Parameter("o", Kind.OBJECT)])
            )
        reading = Reading(f"urn:{draw.choice('pq')}", (X,), Kind.TRUTH, None)
        wanted = draw.choice([Constant(True, Kind.TRUTH), Parameter("wanted", Kind.TRUTH)])
        return Atom("=", reading, wanted)
