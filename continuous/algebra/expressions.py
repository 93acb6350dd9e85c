"""SPARQL expressions (SPARQL 1.1 §17): variables, constants and calls, as values."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, TypeAlias

from ...rdf.dictionary import Term


@dataclass(frozen=True, slots=True)
class Var:
    name: str

    def __str__(self) -> str:
        return f"?{self.name}"


@dataclass(frozen=True, slots=True)
class Const:
    term: Term

    def __str__(self) -> str:
        return str(self.term)


@dataclass(frozen=True, slots=True, weakref_slot=True)
class Call:
    """An operator or function, by its SPARQL name in upper case, on its arguments."""

    name: str
    arguments: tuple[Expression, ...]

    def __str__(self) -> str:
        if self.name in INFIX and len(self.arguments) == 2:
            return f"({self.arguments[0]} {self.name} {self.arguments[1]})"
        return f"{self.name}({', '.join(map(str, self.arguments))})"


Expression: TypeAlias = Var | Const | Call

COMPARISONS: Final = ("=", "!=", "<", "<=", ">", ">=")
ARITHMETIC: Final = ("+", "-", "*", "/")
INFIX: Final = frozenset({*COMPARISONS, *ARITHMETIC, "&&", "||"})


def postorder(expression: Expression) -> list[Expression]:
    """Return ``expression`` and all its parts, arguments before their call, from left to right."""
    found, left = [], [expression]
    while left:
        one = left.pop()
        found.append(one)
        if isinstance(one, Call):
            left.extend(one.arguments)
    found.reverse()
    return found


def variables(expression: Expression) -> frozenset[str]:
    """Return the variables in ``expression``."""
    return frozenset([one.name for one in postorder(expression) if isinstance(one, Var)])


def conjuncts(expression: Expression) -> tuple[Expression, ...]:
    """Return the parts of a conjunction: a FILTER of it equals a FILTER per part."""
    if isinstance(expression, Call) and expression.name == "&&":
        return tuple(part for side in expression.arguments for part in conjuncts(side))
    return (expression,)
