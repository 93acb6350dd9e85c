"""Checks expressions of EP-SPARQL: kinds of values, negations moved to comparisons (SPEC §8)."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import reduce
from typing import Final

from pyoxigraph import Literal, NamedNode, Variable

from ...rdf.datatypes import DURATIONS, NUMBERS
from ...rdf.namespaces import XSD, shorten
from ...sparql import ast as sparql
from ...streams.time import parse_iso_duration, parse_time
from ..errors import LanguageError, Span
from ..mtl.checked import Constant, Kind, ObjectConstant
from . import checked
from .ast import TIME_FUNCTIONS
from .checked import (
    And,
    Bound,
    Calculation,
    Comparison,
    Condition,
    Duration,
    Or,
    StaticVariable,
    TimeOf,
    Truth,
    Value,
    kind_of,
)

_NEGATED: Final = {"<": ">=", "<=": ">", ">": "<=", ">=": "<", "=": "!=", "!=": "="}
_ORDERED: Final = (Kind.NUMBER, Kind.TIME, Kind.DURATION)
_MIRRORED: Final = {"<": ">", "<=": ">=", ">": "<", ">=": "<="}
_SUMS: Final[Mapping[tuple[str, Kind, Kind], Kind]] = {
    **{(operator, Kind.NUMBER, Kind.NUMBER): Kind.NUMBER for operator in "+-*/"},
    ("+", Kind.DURATION, Kind.DURATION): Kind.DURATION,
    ("-", Kind.DURATION, Kind.DURATION): Kind.DURATION,
    ("+", Kind.TIME, Kind.DURATION): Kind.TIME,
    ("+", Kind.DURATION, Kind.TIME): Kind.TIME,
    ("-", Kind.TIME, Kind.DURATION): Kind.TIME,
    ("-", Kind.TIME, Kind.TIME): Kind.DURATION,
}
"""The kinds of calculations."""


@dataclass(frozen=True, slots=True)
class ExpressionChecker:
    """Checks expressions by the ``kinds`` of variables, ``static`` those that only static triples
    have. All methods raise `LanguageError` at the span of the condition; ``known`` raises for a
    variable that has no value there."""

    source: str
    kinds: Mapping[str, Kind]
    static: Mapping[str, Kind] = field(default_factory=dict)

    def condition(
        self,
        node: sparql.Expression,
        span: Span,
        known: Callable[[str], None],
        *,
        holds: bool = True,
    ) -> Condition:
        """Return a condition; not ``holds``: its negation."""
        match node:
            case sparql.Logical(operator, operands):
                parts = tuple(self.condition(each, span, known, holds=holds) for each in operands)
                return And(parts) if (operator == "&&") == holds else Or(parts)
            case sparql.Unary("!", operand):
                return self.condition(operand, span, known, holds=not holds)
            case sparql.Comparison(operator, left, right):
                sides = self.value(left, span, known), self.value(right, span, known)
                return self._comparison(operator if holds else _NEGATED[operator], *sides, span)
            case sparql.In(operand, options, negated):
                left_side = self.value(operand, span, known)
                operator = "!=" if negated == holds else "="
                parts = tuple(
                    self._comparison(operator, left_side, self.value(each, span, known), span)
                    for each in options
                )
                return And(parts) if operator == "!=" else Or(parts)
            case sparql.Call("BOUND", (Variable(value=name),)):
                known(name)
                return Bound(name, holds, name in self.static)
            case Literal():
                constant = self.constant(node, span)
                if isinstance(constant, Constant) and constant.kind is Kind.TRUTH:
                    return Truth(bool(constant.value) == holds)
        value = self.value(node, span, known)
        if kind_of(value) is not Kind.TRUTH:
            hint = "compare it with something, such as `?price > 100`"
            if isinstance(value, StaticVariable):
                hint = f"write `?{value.name} = true` for a truth of static triples"
            raise self.error(
                f"a condition is a truth, and this is {_article(kind_of(value))}", span, hint
            )
        return Comparison("=", value, Constant(holds, Kind.TRUTH))

    def value(self, node: sparql.Expression, span: Span, known: Callable[[str], None]) -> Value:
        """Return a value."""
        match node:
            case Variable(value=name):
                known(name)
                if name in self.static:
                    return StaticVariable(name, self.static[name])
                return checked.Variable(name, self.kinds[name])
            case NamedNode(value=iri):
                return ObjectConstant(iri)
            case Literal():
                return self.constant(node, span)
            case sparql.Arithmetic(first, rest):
                steps = [(sign, self.value(each, span, known)) for sign, each in rest]
                start = self.value(first, span, known)
                return reduce(lambda a, b: self._calculation(b[0], a, b[1], span), steps, start)
            case sparql.Unary("-" | "+" as sign, operand):
                zero = Constant(0.0, Kind.NUMBER)
                return self._calculation(sign, zero, self.value(operand, span, known), span)
            case sparql.Call(name, ()) if name in TIME_FUNCTIONS:
                return TimeOf(name)
            case sparql.Call(name) | sparql.FunctionCall(NamedNode(value=name)):
                raise self.error(
                    f"the function {shorten(name)} is not supported in a pattern",
                    span,
                    "compute it in a C-SPARQL query over the results",
                )
        raise self.error("a truth has no place here", span, "connect truths by `&&`, `||` and `!`")

    def constant(self, literal: Literal, span: Span) -> Constant | Duration:
        """Return the value of a literal."""
        datatype, text = literal.datatype.value, literal.value
        try:
            if datatype in NUMBERS:
                number = float(text)
                if not math.isfinite(number):
                    raise ValueError(f"{text} is no finite number")
                return Constant(number, Kind.NUMBER)
            if datatype == XSD + "boolean" and text in ("true", "false", "1", "0"):
                return Constant(text in ("true", "1"), Kind.TRUTH)
            if datatype == XSD + "string":
                return Constant(text, Kind.TEXT)
            if datatype == XSD + "dateTime":
                return Constant(parse_time(text), Kind.TIME)
            if datatype in DURATIONS:
                return Duration(parse_iso_duration(text))
        except ValueError as error:
            hint = 'write `"PT5S"^^xsd:duration`; years and months vary in length'
            raise self.error(str(error), span, hint if datatype in DURATIONS else "") from None
        raise self.error(
            f"{literal} is of no kind that a pattern compares",
            span,
            "kinds are numbers, texts without language, truths, dateTimes and durations",
        )

    def _comparison(self, operator: str, left: Value, right: Value, span: Span) -> Comparison:
        kind, other = kind_of(left), kind_of(right)
        both = isinstance(left, StaticVariable) and isinstance(right, StaticVariable)
        if both and operator not in _MIRRORED:
            raise self.error(
                f"`{operator}` compares two variables of static triples",
                span,
                "write one variable where they are equal; numbers may be ordered by `<`",
            )
        if kind != other:
            hint = "both sides of a comparison are of one kind"
            if Kind.DURATION in (kind, other):
                hint = 'a duration is written `"PT10M"^^xsd:duration`'
            raise self.error(f"{_article(kind)} is compared with {_article(other)}", span, hint)
        if operator in _MIRRORED and kind not in _ORDERED:
            raise self.error(
                f"`{operator}` orders no {kind}s in a pattern",
                span,
                "numbers, times and durations have an order; compare others by `=` and `!=`",
            )
        return Comparison(operator, left, right)

    def _calculation(self, operator: str, left: Value, right: Value, span: Span) -> Value:
        kinds = kind_of(left), kind_of(right)
        kind = _SUMS.get((operator, *kinds))
        if kind is None:
            raise self.error(
                f"`{operator}` of {_article(kinds[0])} and {_article(kinds[1])}",
                span,
                "arithmetic is of numbers; `+` and `-` also of times and durations",
            )
        return Calculation(operator, left, right, kind)

    def error(self, message: str, span: Span, hint: str = "") -> LanguageError:
        """Return an error at a place of the text."""
        return LanguageError(message, self.source, span, hint)


def bound_of_duration(condition: Condition) -> int | None:
    """Return d in ns of a condition ``getDURATION() <= d``, in any form of it; None: another
    condition."""
    match condition:
        case Comparison(operator, TimeOf("getDURATION"), Duration(most)):
            return _most(operator, most)
        case Comparison(operator, Duration(most), TimeOf("getDURATION")):
            return _most(_MIRRORED.get(operator, operator), most)
        case _:
            return None


def bounds_of_duration(condition: Condition) -> tuple[int, ...]:
    """Return each d in ns of the conditions ``getDURATION() <= d`` that must all hold."""
    if isinstance(condition, And):
        return tuple(d for each in condition.operands for d in bounds_of_duration(each))
    most = bound_of_duration(condition)
    return () if most is None else (most,)


def _most(operator: str, duration: int) -> int | None:
    return {"<": duration - 1, "<=": duration}.get(operator)


def _article(kind: Kind) -> str:
    return f"an {kind}" if kind is Kind.OBJECT else f"a {kind}"
