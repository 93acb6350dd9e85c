"""The normal form of a formula: what was checked, as a formula that one can read.

Features have their prefixes, constants the units of the features that they meet, and an implication
is a disjunction.
"""

from __future__ import annotations

from typing import Final, assert_never

from ...ontology.units import Unit
from ...rdf.namespaces import shorten
from ..errors import Span
from . import ast
from .checked import (
    And,
    Argument,
    Atom,
    Calculation,
    Constant,
    Formula,
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
    Value,
    Within,
)
from .printer import format_formula

_NOWHERE: Final = Span(0, 0)


def normal_form(formula: Formula) -> str:
    """Return a checked formula as text. Law (tests/languages/test_formulas_page.py): read again
    and checked it is the same."""
    return format_formula(_formula(formula))


def _formula(formula: Formula) -> ast.Formula:
    match formula:
        case Truth(value):
            return ast.Truth(value, _NOWHERE)
        case Atom(operator, left, right):
            units = [each.unit for each in (left, right) if isinstance(each, Reading)]
            unit = units[0] if units else None
            return ast.Comparison(operator, _value(left, unit), _value(right, unit), _NOWHERE)
        case Not(operand):
            return ast.Not(_formula(operand), _NOWHERE)
        case Previous(operand):
            return ast.Previous(_formula(operand), _NOWHERE)
        case And(left, right):
            return ast.And(_formula(left), _formula(right), _NOWHERE)
        case Or(left, right):
            return ast.Or(_formula(left), _formula(right), _NOWHERE)
        case Within(operator, interval, operand):
            return ast.Within(operator, interval, _formula(operand), _NOWHERE)
        case Until(is_past, interval, left, right):
            return ast.Until(is_past, interval, _formula(left), _formula(right), _NOWHERE)
        case Quantified(is_universal, variable, sort, operand):
            binding = ast.Binding(ast.Variable(variable, _NOWHERE), _symbol(sort), _NOWHERE)
            return ast.Quantified(is_universal, binding, _formula(operand), _NOWHERE)
        case _:
            assert_never(formula)


def _value(value: Value, unit: Unit | None) -> ast.Formula:
    """A value; ``unit``: that of the feature that it meets."""
    match value:
        case Reading(feature, arguments):
            terms = tuple(map(_argument, arguments))
            return ast.FeatureTerm(_symbol(feature), terms, _NOWHERE)
        case Constant(number, Kind.NUMBER):
            return ast.Number(float(number), unit, _NOWHERE)
        case Constant(bool(truth)):
            return ast.Truth(truth, _NOWHERE)
        case Constant(str(text)):
            return ast.Text(text, _NOWHERE)
        case Constant(time):
            return ast.TimePoint(int(time), _NOWHERE)
        case Parameter(name):
            return ast.Variable(name, _NOWHERE)
        case Calculation(operator, left, right):
            return ast.Arithmetic(operator, _value(left, None), _value(right, None), _NOWHERE)
        case _:
            return _argument(value)


def _argument(argument: Argument) -> ast.Variable | ast.Symbol:
    match argument:
        case ObjectVariable(name):
            return ast.Variable(name, _NOWHERE)
        case ObjectConstant(iri):
            return _symbol(iri)


def _symbol(iri: str) -> ast.Symbol:
    return ast.Symbol(shorten(iri), _NOWHERE)
