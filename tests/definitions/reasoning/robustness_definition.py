"""The definition of robustness (SPEC §8): least and greatest margins over the states of intervals.

Slow on purpose. It works on the checked formula, with objects substituted for variables.
"""

from __future__ import annotations

from math import inf

from progression_definition import Trace, bound

from dyknow.languages.mtl.ast import Temporal
from dyknow.languages.mtl.checked import (
    And,
    Atom,
    Calculation,
    Constant,
    Not,
    ObjectConstant,
    Or,
    Previous,
    Quantified,
    Reading,
    Truth,
    Until,
    Within,
)


class Robustness:
    """Margins over a trace, whose ``value`` gives numbers, truths or None, in one reading."""

    def __init__(self, trace: Trace) -> None:
        self.trace = trace

    def of(self, f, i: int, upper: bool) -> float:
        match f:
            case Truth(value):
                return inf if value else -inf
            case Atom(operator, left, right):
                return self.atom(operator, self.value(left, i), self.value(right, i), upper)
            case Not(g):
                return -self.of(g, i, not upper)
            case And(g, h):
                return min(self.of(g, i, upper), self.of(h, i, upper))
            case Or(g, h):
                return max(self.of(g, i, upper), self.of(h, i, upper))
            case Previous(g):
                return self.of(g, i - 1, upper) if i else -inf
            case Within(operator, interval, g):
                found = [self.of(g, j, upper) for j in self.interval(i, interval, operator.is_past)]
                if operator in (Temporal.ALWAYS, Temporal.HISTORICALLY):
                    return min(found, default=inf)
                return max(found, default=-inf)
            case Until(is_past, interval, g, h):
                found = []
                for j in self.interval(i, interval, is_past):
                    before = range(j + 1, i + 1) if is_past else range(i, j)
                    held = [self.of(g, k, upper) for k in before]
                    found.append(min([self.of(h, j, upper), *held]))
                return max(found, default=-inf)
            case Quantified(is_universal, variable, sort, g):
                objects = self.trace.present[i][sort]
                found = [self.of(bound(g, variable, iri), i, upper) for iri in objects]
                return min(found, default=inf) if is_universal else max(found, default=-inf)
        raise TypeError(f)

    def interval(self, i: int, interval, is_past: bool) -> list[int]:
        valid = self.trace.valid
        ages = [(valid[i] - valid[j]) * (1 if is_past else -1) for j in range(len(valid))]
        end = inf if interval.end is None else interval.end
        return [
            j
            for j, age in enumerate(ages)
            if interval.start <= age <= end and (j <= i if is_past else j >= i)
        ]

    def value(self, value, i: int):
        match value:
            case Constant(constant, _):
                return constant
            case ObjectConstant(iri):
                return iri
            case Reading():
                return self.trace.value(value, i)
            case Calculation(operator, left, right):
                a, b = self.value(left, i), self.value(right, i)
                if a is None or b is None:
                    return None
                return {"+": a + b, "-": a - b, "*": a * b}[operator]
        raise TypeError(value)

    def atom(self, operator: str, a, b, upper: bool) -> float:
        if a is None or b is None:
            return inf if upper else -inf
        if isinstance(a, str | bool):
            return inf if (a == b) is (operator == "=") else -inf
        if a == b and abs(a) == inf:
            return inf if operator in ("=", "<=", ">=") else -inf
        match operator:
            case ">" | ">=":
                return a - b
            case "<" | "<=":
                return b - a
            case "=":
                return -abs(a - b)
            case "!=":
                return abs(a - b)
        raise ValueError(operator)
