"""Prints MTL formulas. Law: ``parse_formula(format_formula(f)) == f``, up to spans."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Final

from ...ontology.units import format_unit
from ...streams.time import format_duration, format_time
from ..kpl.printer import format_policy
from . import ast

_IMPLIES, _OR, _AND, _BINARY, _UNARY, _COMPARISON, _SUM, _PRODUCT, _FACTOR = range(9)
_INTERVAL: Final = ast.Interval()


def format_monitor(monitor: ast.Monitor) -> str:
    """Return the monitor as text, on one line. Law: `parse_monitor` reads it back."""
    parameters = ", ".join(map(_binding, monitor.parameters))
    head = f"monitor {monitor.name}{f'({parameters})' if parameters else ''}"
    return f"{head} = {_body(monitor)}"


def format_formula_template(template: ast.FormulaTemplate) -> str:
    """Return the template as text, on one line. Law: `parse_formula_template` reads it back."""
    slots = ", ".join(map(format_slot, template.slots))
    return f"REGISTER TEMPLATE <{template.name}>({slots}) AS {_body(template.monitor)}"


def format_slot(slot: ast.Slot) -> str:
    """Return a parameter of a template as text."""
    sort = f" in {slot.sort.text}" if slot.sort else ""
    return f"?{slot.variable.name}{sort}{f' = {slot.default}' if slot.default else ''}"


def _body(monitor: ast.Monitor) -> str:
    options = [format_policy(monitor.policy)]
    if monitor.present_for is not None:
        options.append(f"present for {format_duration(monitor.present_for)}")
    if monitor.once:
        options.append("once")
    if monitor.robustness:
        options.append("robustness")
    options.append(f"report {monitor.report}")
    return f"{format_formula(monitor.formula)} with {', '.join(options)}"


def format_formula(formula: ast.Formula, strength: int = _IMPLIES) -> str:
    """Return the formula as text, in parentheses if it binds less than ``strength``."""
    own, text = _format(formula)
    return text if own >= strength else f"({text})"


def _format(formula: ast.Formula) -> tuple[int, str]:
    """Return how strongly the formula binds, and its text."""
    match formula:
        case ast.Implies(left, right):
            return _IMPLIES, f"{format_formula(left, _OR)} -> {format_formula(right, _IMPLIES)}"
        case ast.Or(left, right):
            return _OR, f"{format_formula(left, _OR)} or {format_formula(right, _AND)}"
        case ast.And(left, right):
            return _AND, f"{format_formula(left, _AND)} and {format_formula(right, _BINARY)}"
        case ast.Until(is_past, interval, left, right):
            word = "since" if is_past else "until"
            operator = word + _interval(interval)
            texts = format_formula(left, _UNARY), format_formula(right, _BINARY)
            return _BINARY, f"{texts[0]} {operator} {texts[1]}"
        case ast.Not(operand):
            return _UNARY, f"not {format_formula(operand, _UNARY)}"
        case ast.Previous(operand):
            return _UNARY, f"previous {format_formula(operand, _UNARY)}"
        case ast.Within(operator, interval, operand):
            return _UNARY, f"{operator}{_interval(interval)} {format_formula(operand, _UNARY)}"
        case ast.Quantified(is_universal, binding, operand):
            word = "forall" if is_universal else "exists"
            return _UNARY, f"{word} {_binding(binding)} {format_formula(operand, _UNARY)}"
        case ast.Comparison(operator, left, right):
            texts = format_formula(left, _SUM), format_formula(right, _SUM)
            return _COMPARISON, f"{texts[0]} {operator} {texts[1]}"
        case ast.Arithmetic(operator, left, right):
            own = _SUM if operator in "+-" else _PRODUCT
            return own, f"{format_formula(left, own)} {operator} {format_formula(right, own + 1)}"
        case ast.Negative(operand):
            return _FACTOR, f"-{format_formula(operand, _FACTOR)}"
        case ast.Number(value, unit):
            shown = "" if unit is None else f" {_unit(format_unit(unit))}"
            return _FACTOR, f"{_number(value)}{shown}"
        case ast.Measured(variable, unit):
            return _FACTOR, f"?{variable.name} {_unit(format_unit(unit))}"
        case ast.Truth(value):
            return _FACTOR, "true" if value else "false"
        case ast.TimePoint(value):
            return _FACTOR, format_time(value)
        case ast.FeatureTerm(feature, arguments):
            return _FACTOR, f"{feature.text}{_arguments(arguments)}"
        case _:
            return _FACTOR, _argument(formula)


def _arguments(arguments: Sequence[ast.Variable | ast.Symbol | ast.Text]) -> str:
    return f"({', '.join(map(_argument, arguments))})" if arguments else ""


def _argument(argument: ast.Variable | ast.Symbol | ast.Text) -> str:
    match argument:
        case ast.Variable(name):
            return f"?{name}"
        case ast.Symbol(text):
            return text
        case ast.Text(value):
            return json.dumps(value, ensure_ascii=False)


def _binding(binding: ast.Binding) -> str:
    return f"?{binding.variable.name} in {binding.sort.text}"


def _interval(interval: ast.Interval) -> str:
    if interval == _INTERVAL:
        return ""
    end = "oo" if interval.end is None else _duration(interval.end)
    return f" [{_duration(interval.start)}, {end}]"


def _duration(duration: int) -> str:
    return format_duration(duration) if duration else "0s"


def _number(value: float) -> str:
    return str(int(value)) if value.is_integer() and value < 1e16 else repr(value)


def _unit(text: str) -> str:
    return text if text == "no_unit" else f"[{text}]"
