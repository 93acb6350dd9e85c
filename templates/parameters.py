"""What the parameters of an event template stand for, so that interfaces can offer a form for it.

Nothing in [Events14] declares this: the positions of a parameter in the body tell its role, and a
comparison tells the feature and the unit of a number.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any

from pyoxigraph import NamedNode, Variable

from ..languages.arguments import argument_text
from ..languages.csparql import body_tree
from ..languages.csparql.ast import Template
from ..languages.errors import LanguageError
from ..languages.mtl import FormulaTemplate, check_formula_template
from ..languages.mtl.checked import Atom, Kind, ObjectSlot, Reading
from ..languages.mtl.checked import Parameter as Slot
from ..languages.patterns import PatternTemplate
from ..languages.templates import AnyTemplate
from ..ontology.units import format_unit
from ..ontology.vocabulary import Vocabulary
from ..reasoning.mtl.formulas import parts_of
from ..sparql import ast
from .event_patterns import pattern_slots
from .patterns import patterns
from .places import Place, places


class Role(StrEnum):
    """What an argument for a parameter is."""

    OBJECT = "object"
    SORT = "sort"
    FEATURE = "feature"
    NUMBER = "number"
    TEXT = "text"
    DURATION = "duration"


_ROLES = {
    Place.SORT: Role.SORT,
    Place.PREDICATE: Role.FEATURE,
    Place.NUMBER: Role.NUMBER,
    Place.SUBJECT: Role.OBJECT,
}
"""The role by the place of a parameter, the one that restricts most first."""
_VALUES: Mapping[Kind | None, Role] = {
    Kind.NUMBER: Role.NUMBER,
    Kind.DURATION: Role.DURATION,
}
"""The role of a parameter for values, by its kind; any other is a text."""
_MIRRORED = {"<": ">", "<=": ">=", ">": "<", ">=": "<=", "=": "=", "!=": "!="}


@dataclass(frozen=True, slots=True)
class ParameterUse:
    """A parameter and its role. Of a number that is compared with a ``feature`` (IRI): its
    ``unit``, the ``comparison`` of the feature with the number, and the ``aggregate`` of the
    feature's values that is compared. ``sort``: the sort (IRI) of an object, where one is stated.
    ``default``: the argument that a request may leave out, as text.
    """

    name: str
    role: Role
    feature: str | None = None
    unit: str | None = None
    comparison: str | None = None
    aggregate: str | None = None
    sort: str | None = None
    default: str | None = None


def parameter_uses(template: AnyTemplate, vocabulary: Vocabulary) -> tuple[ParameterUse, ...]:
    """Return the use of each parameter, in order."""
    return tuple(
        replace(use, default=None if default is None else argument_text(default.value))
        for use, default in zip(_uses(template, vocabulary), template.defaults, strict=True)
    )


def _uses(template: AnyTemplate, vocabulary: Vocabulary) -> tuple[ParameterUse, ...]:
    if isinstance(template, FormulaTemplate):
        return _of_formula(template, vocabulary)
    if not isinstance(template, Template):
        return _of_pattern(template, vocabulary)
    tree = body_tree(template.query)
    found = places(tree, vocabulary)
    reader = _Comparisons(tree)
    uses = []
    for parameter in template.parameters:
        kinds = found.get(parameter.value, frozenset())
        role = next((role for place, role in _ROLES.items() if place in kinds), Role.TEXT)
        compared = reader.compared(parameter)
        if role in (Role.TEXT, Role.NUMBER) and compared is not None:
            sign, feature, aggregate = compared
            uses.append(_number(parameter.value, sign, feature, aggregate, vocabulary))
        else:
            uses.append(ParameterUse(parameter.value, role))
    return tuple(uses)


def _number(
    name: str, sign: str, feature: str, aggregate: str | None, vocabulary: Vocabulary
) -> ParameterUse:
    info = vocabulary.feature(feature)
    unit = None if info is None or info.unit is None else format_unit(info.unit)
    is_number = unit is not None or (info is not None and sign not in ("=", "!="))
    role = Role.NUMBER if is_number else Role.TEXT
    return ParameterUse(name, role, feature, unit or None, sign, aggregate)


class _Comparisons:
    """The comparisons of a body, and the features behind their operands."""

    def __init__(self, tree: ast.Query) -> None:
        nodes = list(ast.walk(tree))
        self._comparisons = [node for node in nodes if isinstance(node, ast.Comparison)]
        self._named: dict[Variable, ast.Expression] = {}
        for node in nodes:
            if isinstance(node, ast.Bind | ast.SelectItem) and node.expression is not None:
                self._named[node.variable] = node.expression
        self._features = {
            pattern.object: pattern.predicate.value
            for pattern in patterns(tree)
            if isinstance(pattern.predicate, NamedNode) and isinstance(pattern.object, Variable)
        }

    def compared(self, parameter: Variable) -> tuple[str, str, str | None] | None:
        """The first comparison of a feature with the parameter: sign, feature, aggregate."""
        for node in self._comparisons:
            for sign, value, other in (
                (node.operator, node.left, node.right),
                (_MIRRORED[node.operator], node.right, node.left),
            ):
                if other == parameter and (origin := self._origin(value, None)) is not None:
                    return sign, *origin
        return None

    def _origin(
        self, value: ast.Expression, aggregate: str | None
    ) -> tuple[str, str | None] | None:
        """The feature that a value is of, and the aggregate on the way to it."""
        seen: set[Variable] = set()
        while True:
            match value:
                case ast.Aggregate(function, argument) if argument is not None:
                    value, aggregate = argument, function
                case Variable() if value in self._features:
                    return self._features[value], aggregate
                case Variable() if value in self._named and value not in seen:
                    seen.add(value)
                    value = self._named[value]
                case _:
                    return None


def _of_formula(template: FormulaTemplate, vocabulary: Vocabulary) -> tuple[ParameterUse, ...]:
    try:
        checked = check_formula_template(template, vocabulary)
    except LanguageError:  # the ontology has changed since the template was registered
        return tuple(ParameterUse(each.value, Role.TEXT) for each in template.parameters)
    signs = dict(_signs(checked.monitor.formula))
    uses = []
    for slot in checked.slots:
        if isinstance(slot, ObjectSlot):
            uses.append(ParameterUse(slot.name, Role.OBJECT, sort=slot.sort))
        elif slot.kind is Kind.NUMBER and slot.name in signs:
            sign, feature = signs[slot.name]
            uses.append(_number(slot.name, sign, feature, None, vocabulary))
        else:
            role = Role.NUMBER if slot.kind is Kind.NUMBER else Role.TEXT
            uses.append(ParameterUse(slot.name, role))
    return tuple(uses)


def _of_pattern(template: PatternTemplate, vocabulary: Vocabulary) -> tuple[ParameterUse, ...]:
    try:
        slots = pattern_slots(template, vocabulary)
    except LanguageError:
        return tuple(ParameterUse(each.value, Role.TEXT) for each in template.parameters)
    return tuple(
        ParameterUse(slot.name, Role.OBJECT, sort=slot.sort)
        if isinstance(slot, ObjectSlot)
        else ParameterUse(slot.name, _VALUES.get(slot.kind, Role.TEXT))
        for slot in slots
    )


def _signs(node: Any) -> Iterator[tuple[str, tuple[str, str]]]:
    """The parameters that are compared with a feature, with sign and feature."""
    match node:
        case Atom(operator, Reading(feature), Slot(name)):
            yield name, (operator, feature)
        case Atom(operator, Slot(name), Reading(feature)):
            yield name, (_MIRRORED[operator], feature)
        case _:
            for part in parts_of(node):
                yield from _signs(part)
