"""Binds the parameters of SASE+ templates (SPEC §8)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from ..errors import Span
from ..mtl.ast import Measured, Number, Symbol, Text, TimePoint, Truth, Variable
from ..mtl.checked import Constant, Kind, ObjectConstant
from ..rewriting import rewritten
from . import ast
from .checked import CheckedPattern, CheckedTemplate, ValueSlot
from .parts import check_within


def bound_sase(
    template: CheckedTemplate, arguments: Mapping[str, Constant | ObjectConstant]
) -> CheckedPattern:
    """Return the pattern of a template with these arguments, by the names of parameters. A
    parameter for objects without an argument is free; one for a value must have one. Raises
    `LanguageError` for a duration that does not fit."""
    pattern = template.pattern
    objects = []
    for each in pattern.objects:
        given = arguments.get(each.name)
        iri = given.iri if isinstance(given, ObjectConstant) else None
        objects.append(replace(each, object=iri))
    values = {
        slot.name: arguments[slot.name] for slot in template.slots if isinstance(slot, ValueSlot)
    }

    def bind(node: Any) -> Any:
        if isinstance(node, Variable | Measured):
            variable = node if isinstance(node, Variable) else node.variable
            if variable.name in values:
                unit = None if isinstance(node, Variable) else node.unit
                return _written(values[variable.name], unit, node.span)
        return node

    text = pattern.text
    if isinstance(text.within, Variable):
        within = _duration(values[text.within.name])
        check_within(within, text, pattern.source)
        text = replace(text, within=within)
    return replace(pattern, text=rewritten(text, bind), objects=tuple(objects))


def _duration(value: Constant | ObjectConstant) -> int:
    assert isinstance(value, Constant)
    return int(value.value)


def _written(value: Constant | ObjectConstant, unit: Any, span: Span) -> ast.Constant:
    """A value as a text would have it."""
    if isinstance(value, ObjectConstant):
        return Symbol(f"<{value.iri}>", span)
    match value.kind:
        case Kind.NUMBER:
            return Number(float(value.value), unit, span)
        case Kind.TRUTH:
            return Truth(bool(value.value), span)
        case Kind.TIME:
            return TimePoint(int(value.value), span)
        case Kind.DURATION:
            return ast.Duration(int(value.value), span)
        case _:
            return Text(str(value.value), span)
