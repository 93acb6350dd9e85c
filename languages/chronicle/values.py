"""Kinds and units of the values in a chronicle, and what they are compared with (SPEC §8)."""

from __future__ import annotations

from collections.abc import Mapping, Set
from dataclasses import replace
from typing import Final, assert_never

from ...ontology.units import Unit, UnitError, conversion, dimension, format_unit
from ..errors import LanguageError, Span
from ..mtl.ast import Measured, Number, Symbol, Text, TimePoint, Truth
from ..mtl.ast import Variable as WrittenVariable
from ..mtl.checked import Calculation, Constant, Kind, ObjectConstant, Parameter
from ..ontology_names import OntologyNames
from . import ast
from .checked import Meaning, Operand, Variable

_ORDERED: Final = frozenset({"<", "<=", ">", ">="})


class Values:
    """The values of features, variables and parameters. ``kinds``: of each feature or event whose
    kind is known; ``parameters``: the names of those that stand for values."""

    def __init__(
        self, names: OntologyNames, kinds: Mapping[str, Kind], parameters: Set[str]
    ) -> None:
        self._names = names
        self._kinds = kinds
        self._parameters = parameters
        self.parameter_kinds: dict[str, Kind] = {}
        """The kind as which each parameter is compared."""
        self.variables: dict[str, Meaning] = {}
        """The variables that events bind."""

    def error(self, message: str, span: Span, hint: str = "") -> LanguageError:
        return LanguageError(message, self._names.source, span, hint)

    def kind(self, feature: str) -> Kind:
        return self._kinds.get(feature, Kind.NUMBER)

    def unit(self, feature: str) -> Unit | None:
        if self.kind(feature) is not Kind.NUMBER:
            return None
        info = self._names.vocabulary.feature(feature)
        return () if info is None or info.unit is None else info.unit

    def meaning(self, name: str, span: Span) -> Meaning:
        found = self.variables.get(name)
        if found is None:
            raise self.error(
                f"no event binds `?{name}`",
                span,
                f"name it in one, `event(E[?{name}], t)`, or write `?` for any object",
            )
        return found

    def compared(
        self, operator: str, operand: ast.Operand, kind: Kind, unit: Unit | None, span: Span
    ) -> Operand:
        """Return what a value of this kind and unit is compared with."""
        found, own, unit_of_it = self.operand(operand, kind)
        if own is not kind:
            raise self.error(
                f"{article(kind)} is compared with {article(own)}",
                span,
                "both sides of a comparison are of one kind",
            )
        if operator in _ORDERED and kind not in (Kind.NUMBER, Kind.TIME):
            raise self.error(
                f"`{operator}` orders no {kind}s",
                span,
                "truths, texts and objects are compared by `=` and `!=`",
            )
        if unit_of_it is None or unit is None or unit_of_it == unit:
            return found
        return self.converted(found, unit_of_it, unit, span)

    def operand(self, operand: ast.Operand, kind: Kind) -> tuple[Operand, Kind, Unit | None]:
        """Return an operand with its kind, and its unit if it states one."""
        match operand:
            case Truth(value):
                return Constant(value, Kind.TRUTH), Kind.TRUTH, None
            case Number(value, unit, span):
                self.check_unit(unit, span)
                return Constant(value, Kind.NUMBER), Kind.NUMBER, unit
            case Text(value):
                return Constant(value, Kind.TEXT), Kind.TEXT, None
            case TimePoint(value):
                return Constant(value, Kind.TIME), Kind.TIME, None
            case Symbol(text, span):
                if kind is not Kind.OBJECT:
                    return ObjectConstant(""), Kind.OBJECT, None
                return ObjectConstant(self._names.object(text, span)), Kind.OBJECT, None
            case WrittenVariable(name) if name in self._parameters:
                return self.parameter(operand, kind), kind, None
            case WrittenVariable(name, span):
                meaning = self.meaning(name, span)
                return Variable(name), meaning.kind, meaning.unit
            case Measured(variable, unit, span):
                self.check_unit(unit, span)
                if variable.name not in self._parameters:
                    raise self.error(
                        f"`?{variable.name}` has the unit of its feature",
                        span,
                        "a unit follows a number, or a parameter of a template that is one",
                    )
                return self.parameter(variable, Kind.NUMBER), Kind.NUMBER, unit
            case _:
                assert_never(operand)

    def parameter(self, variable: WrittenVariable, kind: Kind) -> Parameter:
        before = self.parameter_kinds.setdefault(variable.name, kind)
        if before is not kind:
            raise self.error(
                f"`?{variable.name}` is compared as {article(before)} and as {article(kind)}",
                variable.span,
                "a parameter is of one kind: use two",
            )
        return Parameter(variable.name, kind)

    def check_unit(self, unit: Unit | None, span: Span) -> None:
        try:
            dimension(unit or ())
        except UnitError as error:
            raise self.error(str(error), span) from None

    def converted(self, operand: Operand, unit: Unit, target: Unit, span: Span) -> Operand:
        try:
            change = conversion(unit, target)
        except UnitError:
            raise self.error(
                f"{_words(unit)} and {_words(target)} do not fit together",
                span,
                f"{_words(unit)} measures {dimension(unit)}, {_words(target)} measures "
                f"{dimension(target)}",
            ) from None
        match operand:
            case Constant(value):
                return replace(operand, value=float(value) * change.factor + change.offset)
            case Parameter():
                factor = Constant(change.factor, Kind.NUMBER)
                scaled = Calculation("*", operand, factor)
                return Calculation("+", scaled, Constant(change.offset, Kind.NUMBER))
            case _:
                raise self.error(
                    f"a value in {_words(target)} is compared with one in {_words(unit)}",
                    span,
                    "compare values of one unit",
                )


def article(kind: Kind) -> str:
    return f"an {kind}" if kind is Kind.OBJECT else f"a {kind}"


def _words(unit: Unit) -> str:
    return f"[{format_unit(unit)}]" if unit else "a number without a unit"
