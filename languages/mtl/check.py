"""Checks MTL monitors against the ontology: resolves names, tells truth from number, and converts
constants into the units of the features that they meet (SPEC §8).

A constant without a unit has that of the feature. The ontology's range says what a feature is:
numbers, texts, truths or times; without a range the other side of the comparison decides, else it
is a number.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import Any, Final, assert_never

from ...ontology.units import Unit, UnitError, conversion, dimension, format_unit
from ...ontology.vocabulary import THING, Vocabulary
from ...rdf.datatypes import NUMBERS
from ...rdf.namespaces import XSD
from ..errors import LanguageError, Span
from ..object_cache import ObjectCache
from ..ontology_names import OntologyNames
from . import ast
from .checked import (
    And,
    Argument,
    Atom,
    Calculation,
    CheckedMonitor,
    CheckedTemplate,
    Constant,
    Formula,
    Kind,
    Not,
    ObjectConstant,
    ObjectSlot,
    ObjectVariable,
    Or,
    Parameter,
    Previous,
    Quantified,
    Reading,
    Truth,
    Until,
    Value,
    Within,
)

_KINDS: Final = {
    XSD + "boolean": Kind.TRUTH,
    XSD + "string": Kind.TEXT,
    XSD + "dateTime": Kind.TIME,
}
_ORDERED: Final = frozenset({"<", "<=", ">", ">="})


def check_mtl(monitor: ast.Monitor, source: str, vocabulary: Vocabulary) -> CheckedMonitor:
    """Return the meaning of ``parse_monitor(source)``. Raises `LanguageError` with the place of the
    first name, kind or unit that is wrong."""
    checker = _Checker(OntologyNames(source, vocabulary))
    scope: dict[str, _Bound] = {}
    for binding in monitor.parameters:
        scope = checker.bind(binding, scope)
    formula = checker.formula(monitor.formula, scope)
    return CheckedMonitor(
        monitor.name,
        tuple((bound.variable, bound.sort) for bound in scope.values()),
        formula,
        monitor.policy,
        monitor.report,
        monitor.once,
        monitor.present_for,
        robustness=monitor.robustness,
    )


@ObjectCache
def check_formula_template(
    template: ast.FormulaTemplate, vocabulary: Vocabulary
) -> CheckedTemplate:
    """Return the meaning of a template. A parameter with a sort, or one that is an argument of a
    feature, stands for objects; another one stands for a value. Raises `LanguageError`."""
    monitor = template.monitor
    used, arguments = _variables(monitor.formula)
    values = []
    checker = _Checker(OntologyNames(template.source, vocabulary))
    scope: dict[str, _Bound] = {}
    for slot in template.slots:
        name = slot.variable.name
        if slot.sort is not None:
            scope = checker.bind(ast.Binding(slot.variable, slot.sort, slot.span), scope)
        elif name in arguments:
            scope = {**scope, name: checker.bound(name, THING)}
        elif name in used:
            values.append(name)
        else:
            raise checker.error(
                f"the formula does not use `?{name}`",
                slot.span,
                "use it, as in `speed(?x) > ?limit`, or leave it out",
            )
    checker.values = frozenset(values)
    formula = checker.formula(monitor.formula, scope)
    kinds = checker.kinds_of(formula)
    slots = tuple(
        Parameter(name, kinds[name][0]) if name in kinds else ObjectSlot(name, scope[name].sort)
        for name in (slot.variable.name for slot in template.slots)
    )
    for name, found in kinds.items():
        if len(found) > 1:
            raise checker.error(
                f"`?{name}` is compared as {' and as '.join(map(_article, found))}",
                next(slot.span for slot in template.slots if slot.variable.name == name),
                "a parameter is of one kind: use two",
            )
    return CheckedTemplate(
        slots,
        CheckedMonitor(
            monitor.name,
            tuple((slot.name, slot.sort) for slot in slots if isinstance(slot, ObjectSlot)),
            formula,
            monitor.policy,
            monitor.report,
            monitor.once,
            monitor.present_for,
            robustness=monitor.robustness,
        ),
    )


def _variables(formula: ast.Formula) -> tuple[set[str], set[str]]:
    """Return the names of the variables in a formula as written, and of those among them that are
    arguments of features."""
    used: set[str] = set()
    arguments: set[str] = set()
    waiting: list[Any] = [formula]
    for node in waiting:
        match node:
            case ast.Variable(name):
                used.add(name)
            case ast.FeatureTerm():
                arguments |= {a.name for a in node.arguments if isinstance(a, ast.Variable)}
            case _ if is_dataclass(node):
                waiting += [getattr(node, field.name) for field in fields(node)]
    return used, arguments


@dataclass(frozen=True, slots=True)
class _Bound:
    """A variable in scope: its unique name in the checked formula, and the IRI of its sort."""

    variable: str
    sort: str


_Scope = Mapping[str, _Bound]


@dataclass(frozen=True, slots=True)
class _Typed:
    """A checked value, its kind (None: the ontology states no range) and its unit."""

    value: Value
    kind: Kind | None
    unit: Unit | None
    """None: a constant without a unit, or no number."""


class _Checker:
    def __init__(self, names: OntologyNames) -> None:
        self._names = names
        self._used: set[str] = set()
        self.values: frozenset[str] = frozenset()
        """Parameters of a template that stand for values."""

    def error(self, message: str, span: Span, hint: str = "") -> LanguageError:
        return LanguageError(message, self._names.source, span, hint)

    def bind(self, binding: ast.Binding, scope: _Scope) -> dict[str, _Bound]:
        """Return ``scope`` with a variable more, whose name in the checked formula is new."""
        name = binding.variable.name
        if name in scope or name in self.values:
            raise self.error(
                f"`?{name}` is bound twice",
                binding.variable.span,
                "give the inner variable another name",
            )
        sort = self._names.sort(binding.sort.text, binding.sort.span)
        return {**scope, name: self.bound(name, sort)}

    def bound(self, name: str, sort: str) -> _Bound:
        """Return a variable whose name in the checked formula is new."""
        unique, number = name, 2
        while unique in self._used:
            unique, number = f"{name}_{number}", number + 1
        self._used.add(unique)
        return _Bound(unique, sort)

    def kinds_of(self, checked: Any) -> dict[str, tuple[Kind, ...]]:
        """Return the kinds as which each parameter is compared."""
        if isinstance(checked, Parameter):
            return {checked.name: (checked.kind,)}
        found: dict[str, tuple[Kind, ...]] = {}
        for field in fields(checked) if is_dataclass(checked) else ():
            for name, kinds in self.kinds_of(getattr(checked, field.name)).items():
                found[name] = tuple(dict.fromkeys((*found.get(name, ()), *kinds)))
        return found

    # -- formulas ----------------------------------------------------------------------------

    def formula(self, node: ast.Formula, scope: _Scope) -> Formula:
        match node:
            case ast.Truth(value):
                return Truth(value)
            case ast.Not(operand):
                return Not(self.formula(operand, scope))
            case ast.Previous(operand):
                return Previous(self.formula(operand, scope))
            case ast.And(left, right):
                return And(self.formula(left, scope), self.formula(right, scope))
            case ast.Or(left, right):
                return Or(self.formula(left, scope), self.formula(right, scope))
            case ast.Implies(left, right):
                return Or(Not(self.formula(left, scope)), self.formula(right, scope))
            case ast.Within(operator, interval, operand):
                return Within(operator, interval, self.formula(operand, scope))
            case ast.Until(is_past, interval, left, right):
                parts = self.formula(left, scope), self.formula(right, scope)
                return Until(is_past, interval, *parts)
            case ast.Quantified(is_universal, binding, operand):
                inner = self.bind(binding, scope)
                bound = inner[binding.variable.name]
                checked = self.formula(operand, inner)
                return Quantified(is_universal, bound.variable, bound.sort, checked)
            case ast.Comparison():
                return self.comparison(node, scope)
            case ast.FeatureTerm():
                return self.boolean_feature(node, scope)
            case _:
                raise self.error(
                    "this is no truth value",
                    node.span,
                    "compare it with something, such as `speed(?x) > 100`",
                )

    def boolean_feature(self, node: ast.FeatureTerm, scope: _Scope) -> Atom:
        """Return the atom of a feature that stands alone and is true or false."""
        found = self.reading(node, scope)
        assert isinstance(found.value, Reading)
        if found.kind not in (None, Kind.TRUTH):
            raise self.error(
                f"`{node.feature.text}` is {_article(found.kind)}, no truth value",
                node.span,
                f"compare it with something: `{self.words(node)} > 100`",
            )
        return Atom("=", replace(found.value, kind=Kind.TRUTH), Constant(True, Kind.TRUTH))

    def comparison(self, node: ast.Comparison, scope: _Scope) -> Atom:
        left, right = self.sides(node, scope)
        kind = left.kind or right.kind or Kind.NUMBER
        left, right = _as(left, kind), _as(right, kind)
        if left.kind is not right.kind:
            raise self.error(
                f"{_article(left.kind)} is compared with {_article(right.kind)}",
                node.span,
                "both sides of a comparison are of one kind",
            )
        if node.operator in _ORDERED and kind not in (Kind.NUMBER, Kind.TIME, Kind.TEXT):
            raise self.error(
                f"`{node.operator}` orders no {kind}s",
                node.span,
                "a truth or an object is compared by `=` and `!=`",
            )
        if kind is Kind.NUMBER:
            left, right, _ = self.in_one_unit(left, right, node.span)
        return Atom(node.operator, left.value, right.value)

    def sides(self, node: ast.Comparison, scope: _Scope) -> tuple[_Typed, _Typed]:
        """Return the sides of a comparison. A name beside a variable is an object, also of one that
        the ontology does not know."""
        variables = [
            isinstance(side, ast.Variable) and side.name not in self.values
            for side in (node.left, node.right)
        ]
        found = []
        for side, is_beside in zip((node.left, node.right), reversed(variables), strict=True):
            if is_beside and isinstance(side, ast.FeatureTerm) and self.is_new(side):
                iri = self._names.object(side.feature.text, side.feature.span)
                found.append(_Typed(ObjectConstant(iri), Kind.OBJECT, None))
            else:
                found.append(self.value(side, scope))
        return found[0], found[1]

    def is_new(self, node: ast.FeatureTerm) -> bool:
        """Whether this is a name that the ontology does not know."""
        vocabulary = self._names.vocabulary
        iris = self._names.iris(node.feature.text, node.feature.span)
        known = (vocabulary.is_feature, vocabulary.is_event, vocabulary.is_object)
        return not node.arguments and not any(is_it(iri) for is_it in known for iri in iris)

    # -- values ------------------------------------------------------------------------------

    def value(self, node: ast.Formula, scope: _Scope) -> _Typed:
        match node:
            case ast.Number(value, unit):
                if unit is not None:
                    self.check_unit(unit, node.span)
                return _Typed(Constant(value, Kind.NUMBER), Kind.NUMBER, unit)
            case ast.Text(value):
                return _Typed(Constant(value, Kind.TEXT), Kind.TEXT, None)
            case ast.TimePoint(value):
                return _Typed(Constant(value, Kind.TIME), Kind.TIME, None)
            case ast.Truth(value):
                return _Typed(Constant(value, Kind.TRUTH), Kind.TRUTH, None)
            case ast.Measured(variable, unit):
                self.check_unit(unit, node.span)
                if variable.name not in self.values:
                    raise self.error(
                        f"`?{variable.name}` is no number, so it has no unit",
                        node.span,
                        "a unit follows a number, or a parameter of a template that is one",
                    )
                return _Typed(Parameter(variable.name, Kind.NUMBER), Kind.NUMBER, unit)
            case ast.Variable(name) if name in self.values:
                return _Typed(Parameter(name, Kind.NUMBER), None, None)
            case ast.Variable():
                return _Typed(self.variable(node, scope), Kind.OBJECT, None)
            case ast.FeatureTerm():
                return self.term(node, scope)
            case ast.Negative(operand):
                zero = _Typed(Constant(0.0, Kind.NUMBER), Kind.NUMBER, None)
                return self.calculation("-", zero, self.number(operand, scope), node.span)
            case ast.Arithmetic(operator, left, right):
                parts = self.number(left, scope), self.number(right, scope)
                return self.calculation(operator, *parts, node.span)
            case _:
                raise self.error(
                    "this is a truth value, not a number, text, time or object",
                    node.span,
                    "connect truth values by `and`, `or`, `->`",
                )

    def term(self, node: ast.FeatureTerm, scope: _Scope) -> _Typed:
        """Return a feature's value, or the object that a name without arguments denotes."""
        if not node.arguments:
            iris = self._names.iris(node.feature.text, node.feature.span)
            vocabulary = self._names.vocabulary
            if not any(vocabulary.is_feature(iri) or vocabulary.is_event(iri) for iri in iris):
                found = next((iri for iri in iris if vocabulary.is_object(iri)), None)
                if found is not None or node.feature.text == "self":
                    iri = self._names.object(node.feature.text, node.feature.span)
                    return _Typed(ObjectConstant(iri), Kind.OBJECT, None)
        return self.reading(node, scope)

    def reading(self, node: ast.FeatureTerm, scope: _Scope) -> _Typed:
        name = node.feature.text
        feature = self._names.feature(name, node.feature.span)
        self._names.check_arity(feature, name, len(node.arguments), node.span)
        arguments = tuple(self.argument(each, scope) for each in node.arguments)
        info = self._names.vocabulary.feature(feature)
        range = None if info is None else info.range
        unit = None if info is None else info.unit
        kind = None if range is None else kind_of_range(range)
        if kind is None and unit is not None:
            kind = Kind.NUMBER
        return _Typed(Reading(feature, arguments, kind or Kind.NUMBER, unit), kind, unit or ())

    def argument(self, node: ast.Variable | ast.Symbol | ast.Text, scope: _Scope) -> Argument:
        match node:
            case ast.Variable():
                return self.variable(node, scope)
            case ast.Symbol(text, span):
                if self._names.find_sort(text, span) is not None:
                    raise self.error(
                        f"`{text}` is a sort, not an object",
                        span,
                        f"bind a variable: `forall ?x in {text} …`, or `monitor m(?x in {text})`",
                    )
                return ObjectConstant(self._names.object(text, span))
            case ast.Text(value):
                return ObjectConstant(self._names.namespace + value)
            case _:
                assert_never(node)

    def variable(self, node: ast.Variable, scope: _Scope) -> ObjectVariable:
        if node.name not in scope:
            bind = f"bind it: `forall ?{node.name} in Car …`, or `monitor m(?{node.name} in Car)`"
            known = ", ".join(f"?{name}" for name in scope)
            hint = f"known are {known}; {bind}" if known else bind
            raise self.error(f"`?{node.name}` is not bound", node.span, hint)
        return ObjectVariable(scope[node.name].variable)

    def number(self, node: ast.Formula, scope: _Scope) -> _Typed:
        found = _as(self.value(node, scope), Kind.NUMBER)
        if found.kind is not Kind.NUMBER:
            raise self.error(
                f"arithmetic needs numbers, and this is {_article(found.kind)}", node.span
            )
        return found

    # -- units -------------------------------------------------------------------------------

    def calculation(self, operator: str, left: _Typed, right: _Typed, span: Span) -> _Typed:
        if operator in "+-":
            left, right, unit = self.in_one_unit(left, right, span)
        else:
            # A constant without a unit scales; two units make a product, which no feature has.
            units = [each.unit for each in (left, right) if each.unit]
            if len(units) == 2 or (operator == "/" and right.unit):
                raise self.error(
                    f"`{operator}` of two quantities with units is not supported",
                    span,
                    "multiply or divide by a number without a unit",
                )
            unit = units[0] if units else _neither(left, right)
        value = Calculation(operator, left.value, right.value)
        return _Typed(value, Kind.NUMBER, unit)

    def in_one_unit(
        self, left: _Typed, right: _Typed, span: Span
    ) -> tuple[_Typed, _Typed, Unit | None]:
        """Return both in one unit: that of the left, or of the right if the left is a constant."""
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
            assert isinstance(other.value.value, float)
            value: Value = Constant(other.value.value * change.factor + change.offset, Kind.NUMBER)
        else:
            factor = Constant(change.factor, Kind.NUMBER)
            value = Calculation("*", other.value, factor)
            if change.offset:
                value = Calculation("+", value, Constant(change.offset, Kind.NUMBER))
        converted = _Typed(value, Kind.NUMBER, target.unit)
        pair = (converted, target) if target is right else (target, converted)
        return *pair, target.unit

    def check_unit(self, unit: Unit, span: Span) -> None:
        try:
            dimension(unit)
        except UnitError as error:
            raise self.error(str(error), span) from None

    def words(self, node: ast.Formula) -> str:
        """Return the text of a node."""
        return self._names.source[node.span.start : node.span.end]


def _article(kind: Kind | None) -> str:
    return f"an {kind}" if kind is Kind.OBJECT else f"a {kind}"


def _as(found: _Typed, kind: Kind) -> _Typed:
    """Return a value of unknown kind as one of ``kind``."""
    if found.kind is not None or not isinstance(found.value, Reading | Parameter):
        return found
    return _Typed(replace(found.value, kind=kind), kind, found.unit)


def kind_of_range(range: str) -> Kind | None:
    """Return the kind of a feature's values by its range in the ontology; None: of no kind."""
    if range in NUMBERS:
        return Kind.NUMBER
    return _KINDS.get(range, None if range.startswith(XSD) else Kind.OBJECT)


def _neither(left: _Typed, right: _Typed) -> Unit | None:
    """Return the unit of a product without units: none stated if both are constants."""
    return None if left.unit is None and right.unit is None else ()


def _words(unit: Unit) -> str:
    return f"[{format_unit(unit)}]" if unit else "a number without a unit"
