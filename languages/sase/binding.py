"""Binds the parameters of SASE+ templates (SPEC §8)."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from ..errors import Span
from ..mtl.ast import Measured, Number, Symbol, Text, TimePoint, Truth, Variable
from ..mtl.checked import Constant, Kind, ObjectConstant
from . import ast
from .checked import CheckedPattern, CheckedTemplate, ValueSlot


def bound_sase(
    template: CheckedTemplate, arguments: Mapping[str, Constant | ObjectConstant]
) -> CheckedPattern:
    """Return the pattern of a template with these arguments, by the names of parameters. A
    parameter for objects without an argument is free; one for a value must have one."""
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

    text = rewritten(pattern.text, bind)
    return replace(pattern, text=text, objects=tuple(objects))


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
        case _:
            return Text(str(value.value), span)


def rewritten(node: Any, change: Callable[[Any], Any]) -> Any:
    """A tree with other nodes for those that ``change`` replaces."""
    if isinstance(node, tuple):
        return tuple(rewritten(each, change) for each in node)
    if isinstance(node, Span) or not dataclasses.is_dataclass(node):
        return node
    if (changed := change(node)) is not node:
        return changed
    fields = {f.name: getattr(node, f.name) for f in dataclasses.fields(node)}
    new = {name: rewritten(old, change) for name, old in fields.items()}
    return replace(node, **new)
