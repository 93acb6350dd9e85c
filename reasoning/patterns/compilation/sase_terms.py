"""Conditions and values of SASE+ as expressions of a plan: kinds agree, units are those of the
ontology (SPEC §8)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final, TypeAlias

from ....languages.errors import LanguageError, Span
from ....languages.mtl.ast import Number, Symbol, Text, TimePoint, Truth, Variable
from ....languages.mtl.checked import Kind
from ....languages.sase import ast
from ....languages.sase.checked import TIME
from ....ontology.units import Unit, UnitError, UnitPower, conversion, dimension, format_unit
from ....rdf.namespaces import DYKNOW
from ..plans.plan import (
    OWN,
    Aggregate,
    Arithmetic,
    Condition,
    Constant,
    Expression,
    Function,
    Key,
    Position,
    Time,
    Value,
    leaves_of,
)
from ..plans.query import object_key, text_key
from .sase_sources import Attributes

NS: Final[Unit] = (UnitPower("ns"),)
"""The unit of differences of times."""
_POSITIONS: Final = {
    ast.Index.FIRST: Position.FIRST,
    ast.Index.PREVIOUS: Position.PREVIOUS,
    ast.Index.LAST: Position.LAST,
}
_ORDERED: Final = frozenset({"<", "<=", ">", ">="})
Parts: TypeAlias = Mapping[str, tuple[int, bool]]
"""The element of each part that happens, and whether it is repeated."""


@dataclass(frozen=True, slots=True)
class Typed:
    """An expression, its kind and its unit (None: a constant without one, a field, or no
    number)."""

    value: Expression
    kind: Kind
    unit: Unit | None = None


class Terms:
    """Makes expressions. In its methods ``own`` is the part whose event is `OWN`, if any."""

    def __init__(self, attributes: Attributes, parts: Parts) -> None:
        self._attributes = attributes
        self._parts = parts

    def error(self, message: str, span: Span, hint: str = "") -> LanguageError:
        return self._attributes.error(message, span, hint)

    def condition(self, node: ast.Comparison, own: str | None = None) -> Condition:
        """Return a comparison as a condition. Raises `LanguageError`."""
        left, right = self.term(node.left, own), self.term(node.right, own)
        left, right = _as_object(left, node.left, right), _as_object(right, node.right, left)
        if left.kind is not right.kind:
            raise self.error(
                f"{_article(left.kind)} is compared with {_article(right.kind)}",
                node.span,
                "both sides of a comparison are of one kind",
            )
        if node.operator in _ORDERED and left.kind not in (Kind.NUMBER, Kind.TIME):
            raise self.error(
                f"`{node.operator}` orders no {left.kind}s",
                node.span,
                "a text, a truth or an object is compared by `=` and `!=`",
            )
        if left.kind is Kind.NUMBER:
            left, right, _ = self.in_one_unit(left, right, node.span)
        return Condition(node.operator, left.value, right.value)

    # -- terms -------------------------------------------------------------------------------

    def term(self, node: ast.Term, own: str | None = None) -> Typed:
        """Return a value. Raises `LanguageError`."""
        match node:
            case Number(value, unit):
                if unit is not None:
                    self.check_unit(unit, node.span)
                return Typed(Constant(value), Kind.NUMBER, unit)
            case Text(value):
                return Typed(Key(text_key(value)), Kind.TEXT)
            case TimePoint(value):
                return Typed(Constant(value), Kind.TIME)
            case Truth(value):
                return Typed(Constant(int(value)), Kind.TRUTH)
            case ast.Duration(value):
                return Typed(Constant(value), Kind.NUMBER, NS)
            case Symbol(text):
                return Typed(Key(text), Kind.OBJECT)
            case ast.Attribute():
                return self.attribute(node, own)
            case ast.Aggregate():
                return self.aggregate(node, own)
            case ast.Negative(operand):
                found = self.term(operand, own)
                if isinstance(found.value, Constant) and found.kind is Kind.NUMBER:
                    return replace(found, value=Constant(-found.value.value))
                zero = Typed(Constant(0), Kind.NUMBER, found.unit)
                return self.calculation("-", zero, found, node.span)
            case ast.Arithmetic(operator, left, right):
                sides = self.term(left, own), self.term(right, own)
                return self.calculation(operator, *sides, node.span)
            case _:
                assert not isinstance(node, Variable), node
                raise self.error("this is a result, not a value", node.span)

    def attribute(self, node: ast.Attribute, own: str | None) -> Typed:
        element, is_kleene = self._place(node.part, own)
        if node.name == TIME:
            return Typed(self.time(node, element, is_kleene=is_kleene), Kind.TIME)
        found = self._attributes.attribute(node.part, node.name, node.span)
        position = _POSITIONS.get(node.index, Position.EACH) if is_kleene else Position.EACH
        return Typed(Value(element, found.column, position), found.kind, found.unit)

    def time(self, node: ast.Attribute, element: int, *, is_kleene: bool) -> Time:
        match node.index:
            case ast.Index.FIRST if is_kleene:
                return Time((element,), is_start=True)
            case ast.Index.LAST if is_kleene:
                return Time((element,))
            case _ if is_kleene:
                raise self.error(
                    f"the time of `{node.part}{node.index}` has no place here",
                    node.span,
                    f"write `{node.part}[1].{TIME}` or `{node.part}[{node.part}.LEN].{TIME}`",
                )
        return Time((element,))

    def aggregate(self, node: ast.Aggregate, own: str | None) -> Typed:
        element, is_kleene = self._place(node.part, own)
        function = Function(node.function)
        if node.name is None:
            is_before = node.index is ast.Index.BEFORE
            one = Constant(1)
            count = Aggregate(function, element, None, is_before) if is_kleene else one
            return Typed(count, Kind.NUMBER, ())
        found = self.numbers(node)
        if not is_kleene:
            return replace(found, value=Value(element, self.column(node)))
        is_before = node.index is ast.Index.BEFORE
        return replace(found, value=Aggregate(function, element, self.column(node), is_before))

    def column(self, node: ast.Aggregate) -> str:
        """The column that an aggregate reads."""
        assert node.name is not None
        return self._attributes.attribute(node.part, node.name, node.span).column

    def numbers(self, node: ast.Aggregate) -> Typed:
        """The kind and unit of an aggregate's values, which are numbers."""
        if node.name == TIME:
            raise self.error("times are not added up", node.span, f"write `{node.part}[1].{TIME}`")
        assert node.name is not None
        found = self._attributes.attribute(node.part, node.name, node.span)
        if found.kind is not Kind.NUMBER:
            raise self.error(
                f"`{node.function}` needs numbers, and `{node.name}` is {_article(found.kind)}",
                node.span,
                f"count its events: `count({node.part}[])`",
            )
        return Typed(Constant(0.0), Kind.NUMBER, found.unit)

    def _place(self, part: str, own: str | None) -> tuple[int, bool]:
        return (OWN, False) if part == own else self._parts[part]

    # -- units -------------------------------------------------------------------------------

    def calculation(self, operator: str, left: Typed, right: Typed, span: Span) -> Typed:
        kinds = left.kind, right.kind
        value = Arithmetic(operator, left.value, right.value)
        if kinds == (Kind.TIME, Kind.TIME) and operator == "-":
            return Typed(value, Kind.NUMBER, NS)
        if kinds == (Kind.TIME, Kind.NUMBER) and right.unit == NS and operator in "+-":
            return Typed(value, Kind.TIME)
        wrong = next((kind for kind in kinds if kind is not Kind.NUMBER), None)
        if wrong is not None:
            raise self.error(
                f"`{operator}` calculates with numbers, and this is {_article(wrong)}",
                span,
                f"of times only a difference is one: `b.{TIME} - a.{TIME} < 5s`",
            )
        if operator in "+-":
            left, right, unit = self.in_one_unit(left, right, span)
            return Typed(Arithmetic(operator, left.value, right.value), Kind.NUMBER, unit)
        # A number without a unit scales; two units make a product, which nothing here has.
        units = [each.unit for each in (left, right) if each.unit]
        if len(units) == 2 or (operator == "/" and right.unit):
            raise self.error(
                f"`{operator}` of two quantities with units is not supported",
                span,
                "multiply or divide by a number without a unit",
            )
        neither = None if left.unit is None and right.unit is None else ()
        return Typed(value, Kind.NUMBER, units[0] if units else neither)

    def in_one_unit(
        self, left: Typed, right: Typed, span: Span
    ) -> tuple[Typed, Typed, Unit | None]:
        """Return both in one unit: that of the left, or of the right if the left is a constant."""
        if NS in (left.unit, right.unit) and None in (left.unit, right.unit):
            raise self.error(
                "a duration is compared with a number",
                span,
                f"write its unit: `b.{TIME} - a.{TIME} < 5s`",
            )
        for one, other in ((left, right), (right, left)):
            if one.unit is None and _reads(one) and other.unit and not _reads(other):
                raise self.error(
                    f"the unit of a field is not known here, so {_words(other.unit)} means nothing",
                    span,
                    "write the number in the unit of the field, without naming it",
                )
        if left.unit is None or right.unit is None or left.unit == right.unit:
            return left, right, right.unit if left.unit is None else left.unit
        target = right if isinstance(left.value, Constant) else left
        other = left if target is right else right
        assert target.unit is not None
        assert other.unit is not None
        try:
            change = conversion(other.unit, target.unit)
        except UnitError:
            raise self.error(
                f"{_words(left.unit)} and {_words(right.unit)} do not fit together",
                span,
                f"{_words(left.unit)} measures {dimension(left.unit)}, {_words(right.unit)} "
                f"measures {dimension(right.unit)}",
            ) from None
        if isinstance(other.value, Constant):
            value: Expression = Constant(other.value.value * change.factor + change.offset)
        else:
            value = Arithmetic("*", other.value, Constant(change.factor))
            if change.offset:
                value = Arithmetic("+", value, Constant(change.offset))
        converted = Typed(value, Kind.NUMBER, target.unit)
        pair = (converted, target) if target is right else (target, converted)
        return *pair, target.unit

    def check_unit(self, unit: Unit, span: Span) -> None:
        try:
            dimension(unit)
        except UnitError as error:
            raise self.error(str(error), span) from None


def _reads(typed: Typed) -> bool:
    """Whether an expression reads a row."""
    return not all(isinstance(leaf, Constant) for leaf in leaves_of(typed.value))


def _as_object(side: Typed, node: ast.Term, other: Typed) -> Typed:
    """A text beside an object as the object's name."""
    if isinstance(node, Text) and other.kind is Kind.OBJECT:
        return Typed(Key(object_key(DYKNOW + node.value)), Kind.OBJECT)
    return side


def _article(kind: Kind) -> str:
    return f"an {kind}" if kind is Kind.OBJECT else f"a {kind}"


def _words(unit: Unit) -> str:
    return f"[{format_unit(unit)}]" if unit else "a number without a unit"
