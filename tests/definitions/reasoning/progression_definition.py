"""The definition of MTL verdicts (SPEC §8): literal progression, slow and obviously right.

A formula is progressed through the states one by one, in two readings. Only constants are folded.
It works on the checked formula, with objects substituted for variables.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from math import inf
from typing import Any

from dyknow.languages.mtl.ast import Interval, Temporal
from dyknow.languages.mtl.checked import (
    And,
    Atom,
    Calculation,
    Not,
    ObjectConstant,
    ObjectVariable,
    Or,
    Previous,
    Quantified,
    Reading,
    Truth,
    Until,
    Within,
)

TRUE, FALSE = Truth(True), Truth(False)


@dataclass
class Trace:
    """States in order. ``value(reading, state)``: the truth of a reading of objects, None for
    unknown. ``horizon`` of each state: every later one is known to be valid after it."""

    valid: list[int]
    horizon: list[int]
    value: Any
    present: list[dict[str, list[str]]]
    """Of each state by sort: the objects that are there."""


def neg(f):
    match f:
        case Truth(value):
            return Truth(not value)
        case _:
            return Not(f)


def conj(f, g):
    if FALSE in (f, g):
        return FALSE
    return g if f == TRUE else f if g == TRUE else And(f, g)


def disj(f, g):
    if TRUE in (f, g):
        return TRUE
    return g if f == FALSE else f if g == FALSE else Or(f, g)


def bound(f, variable, iri):
    """``f`` with an object in place of a variable, whose name is unique in it."""
    match f:
        case Reading():
            named = (
                ObjectConstant(iri) if a == ObjectVariable(variable) else a for a in f.arguments
            )
            return replace(f, arguments=tuple(named))
        case ObjectVariable(name):
            return ObjectConstant(iri) if name == variable else f
        case Atom(operator, left, right):
            return Atom(operator, bound(left, variable, iri), bound(right, variable, iri))
        case Calculation(operator, left, right):
            return Calculation(operator, bound(left, variable, iri), bound(right, variable, iri))
        case Not(g):
            return Not(bound(g, variable, iri))
        case Previous(g):
            return Previous(bound(g, variable, iri))
        case And(g, h):
            return And(bound(g, variable, iri), bound(h, variable, iri))
        case Or(g, h):
            return Or(bound(g, variable, iri), bound(h, variable, iri))
        case Within(operator, interval, g):
            return Within(operator, interval, bound(g, variable, iri))
        case Until(is_past, interval, g, h):
            return Until(is_past, interval, bound(g, variable, iri), bound(h, variable, iri))
        case Quantified(is_universal, own, sort, g):
            return Quantified(is_universal, own, sort, bound(g, variable, iri))
        case _:
            return f


def bound_all(f, parameters, objects):
    """``f`` with the objects in place of the variables of the parameters, (name, sort) each."""
    for (name, _), iri in zip(parameters, objects, strict=True):
        f = bound(f, name, iri)
    return f


def bindings(present, parameters):
    """The objects that are there, for each parameter; ``present`` is that of a state."""
    return itertools.product(*(present[sort] for _, sort in parameters))


class TooLarge(Exception):
    """A progressed formula grows beyond what a test can wait for."""


class Progression:
    """Progresses formulas through a trace, in the upper reading or the lower one. Raises `TooLarge`
    after ``most`` steps."""

    def __init__(self, trace: Trace, most: float = inf) -> None:
        self.trace = trace
        self.most = most

    def at(self, f, i, upper):
        """What must hold from state i + 1 on for ``f`` to hold at i; the gap to it is not
        subtracted yet."""
        self.most -= 1
        if self.most < 0:
            raise TooLarge
        go = self.at
        match f:
            case Truth():
                return f
            case Atom(operator, ObjectConstant(left), ObjectConstant(right)):
                return Truth((left == right) is (operator == "="))
            case Atom(_, left, _):
                value = self.trace.value(left, i)
                return Truth(upper) if value is None else Truth(value)
            case Not(g):
                return neg(go(g, i, not upper))
            case And(g, h):
                return conj(go(g, i, upper), go(h, i, upper))
            case Or(g, h):
                return disj(go(g, i, upper), go(h, i, upper))
            case Within(operator, interval, g) if not operator.is_past:
                is_always = operator is Temporal.ALWAYS
                if interval.end is not None and interval.end < 0:
                    return Truth(is_always)
                if interval.start > 0:
                    return f
                return (conj if is_always else disj)(go(g, i, upper), f)
            case Within(operator, interval, g):
                found = Truth(operator is Temporal.HISTORICALLY)
                join = conj if operator is Temporal.HISTORICALLY else disj
                for j in self.past(i, interval):
                    found = join(found, self.from_to(g, j, i, upper))
                return found
            case Until(False, interval, g, h):
                if interval.end is not None and interval.end < 0:
                    return FALSE
                rest = conj(go(g, i, upper), f)
                return rest if interval.start > 0 else disj(go(h, i, upper), rest)
            case Until(True, interval, g, h):
                found = FALSE
                for j in self.past(i, interval):
                    each = self.from_to(h, j, i, upper)
                    for k in range(j + 1, i + 1):
                        each = conj(each, self.from_to(g, k, i, upper))
                    found = disj(found, each)
                return found
            case Previous(g):
                return self.from_to(g, i - 1, i, upper) if i else FALSE
            case Quantified(is_universal, variable, sort, g):
                found = Truth(is_universal)
                for iri in self.trace.present[i][sort]:
                    part = go(bound(g, variable, iri), i, upper)
                    found = (conj if is_universal else disj)(found, part)
                return found
        raise TypeError(f)

    def past(self, i, interval):
        valid = self.trace.valid
        end = interval.end
        return [
            j
            for j in range(i + 1)
            if valid[i] - valid[j] >= interval.start and (end is None or valid[i] - valid[j] <= end)
        ]

    def from_to(self, f, j, i, upper):
        """``f`` at state j, progressed through j..i."""
        f = self.closed(self.at(f, j, upper), j)
        for k in range(j + 1, i + 1):
            if isinstance(f, Truth):  # stays as it is
                break
            f = self.next(f, k, upper)
        return f

    def next(self, f, k, upper):
        """``f`` progressed through state k, when it was progressed through k - 1."""
        aged = self.aged(f, self.trace.valid[k] - self.trace.valid[k - 1])
        return self.closed(self.at(aged, k, upper), k)

    def aged(self, f, gap):
        """``f`` with ``gap`` subtracted from the outermost intervals."""

        def less(interval):
            end = None if interval.end is None else interval.end - gap
            return Interval(max(0, interval.start - gap), end)

        match f:
            case Within(operator, interval, g) if not operator.is_past:
                return Within(operator, less(interval), g)
            case Until(False, interval, g, h):
                return Until(False, less(interval), g, h)
            case Not(g):
                return Not(self.aged(g, gap))
            case And(g, h):
                return And(self.aged(g, gap), self.aged(h, gap))
            case Or(g, h):
                return Or(self.aged(g, gap), self.aged(h, gap))
        return f

    def closed(self, f, i):
        """``f`` after state i with what the horizon closes folded."""
        horizon, valid = self.trace.horizon[i], self.trace.valid[i]

        def is_closed(interval):
            # The outermost intervals are relative to state i here.
            if interval.end is None:
                return horizon == END
            return horizon == END or interval.end <= horizon - valid

        def fold(f):
            match f:
                case Within(operator, interval, _) if not operator.is_past and is_closed(interval):
                    return Truth(operator is Temporal.ALWAYS)
                case Until(False, interval, _, _) if is_closed(interval):
                    return FALSE
                case Not(g):
                    return neg(fold(g))
                case And(g, h):
                    return conj(fold(g), fold(h))
                case Or(g, h):
                    return disj(fold(g), fold(h))
            return f

        return fold(f)

    def verdict(self, f, start):
        """The verdict (1, 0, -1) and the deciding state; None while it is open."""
        lower, upper = (self.closed(self.at(f, start, each), start) for each in (False, True))
        i = start
        while True:
            if lower == TRUE:
                return 1, i
            if upper == FALSE:
                return 0, i
            if lower == FALSE and upper == TRUE:
                return -1, i
            i += 1
            if i == len(self.trace.valid):
                return None
            lower, upper = self.next(lower, i, False), self.next(upper, i, True)


END = 2**63 - 1
"""The horizon when no further state comes."""
