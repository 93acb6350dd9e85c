"""Formulas as continuous queries: what they need from streams, and their templates (SPEC §8)."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from pyoxigraph import Variable

from ..languages.mtl import (
    CheckedMonitor,
    FormulaTemplate,
    Monitor,
    check_formula_template,
    check_mtl,
)
from ..languages.mtl.checked import (
    ObjectConstant,
    ObjectVariable,
    Parameter,
    Reading,
)
from ..matching.subject import Subject
from ..matching.want import Want
from ..ontology.vocabulary import Vocabulary
from ..rdf.dictionary import Term
from ..rdf.namespaces import shorten
from ..reasoning.mtl.formulas import readings_of, sorts_of
from ..reasoning.mtl.monitoring import RESULT_FIELDS
from ..streams.sample import TIME_FIELDS
from .needs import Needs, NeedsError
from .slots import Values, given_arguments


@dataclass(frozen=True, slots=True)
class BoundFormula:
    """A formula whose parameters are objects, as a query. ``text``: as written, for explanations;
    ``source``: all of the text. ``readings``: for each want the features that it serves. ``open``:
    the monitor before the ``values`` of a request stand in it."""

    monitor: CheckedMonitor
    text: Monitor
    source: str
    readings: dict[Want, list[Reading]]
    open: CheckedMonitor
    values: Values

    @property
    def needs(self) -> Needs:
        return Needs(tuple(self.readings), None)


def bound_monitor(monitor: Monitor, source: str, vocabulary: Vocabulary) -> BoundFormula:
    """Return a monitor as a query. Raises `LanguageError`; `NeedsError` for a feature without an
    object, and for a parameter whose objects no feature gives."""
    checked = check_mtl(monitor, source, vocabulary)
    return _bound(checked, monitor, source, checked, {})


def bound_formula_template(
    template: FormulaTemplate, arguments: Sequence[Term | Variable], vocabulary: Vocabulary
) -> BoundFormula:
    """Return the formula of a template with ``arguments``, one for each parameter.

    A variable leaves the objects of a parameter free. Raises `ArgumentError`, and the errors of
    `bound_monitor` where the ontology has changed since the template was registered.
    """
    checked = check_formula_template(template, vocabulary)
    values, objects = given_arguments(template, checked.slots, arguments)
    sorts = dict(checked.monitor.parameters)
    fixed: dict[str, str] = {}
    for name, iri in objects.items():
        # A sort of its own, so that quantifiers over the sort go on to mean all objects.
        sorts[name], fixed[iri] = iri, sorts[name]
    open = replace(checked.monitor, parameters=tuple(sorts.items()), fixed=tuple(fixed.items()))
    monitor = replace(open, formula=_with_values(open.formula, values))
    return _bound(monitor, template.monitor, template.source, open, values)


def formula_template_wants(template: FormulaTemplate, vocabulary: Vocabulary) -> tuple[Want, ...]:
    """Return what a template needs for all objects. Raises `LanguageError` and `NeedsError`."""
    checked = check_formula_template(template, vocabulary)
    monitor = checked.monitor
    return tuple(_bound(monitor, template.monitor, template.source, monitor, {}).readings)


def _bound(
    checked: CheckedMonitor, text: Monitor, source: str, open: CheckedMonitor, values: Values
) -> BoundFormula:
    sorts, objects = sorts_of(checked), dict(checked.fixed)
    readings: dict[Want, list[Reading]] = {}
    for reading in dict.fromkeys(readings_of(checked.formula)):
        if not reading.arguments:
            name = shorten(reading.feature).removeprefix("dyknow:")
            raise NeedsError(
                f"`{name}` names no object, and matching finds features of objects",
                f"write `{name}(self)` for the one that speaks, or `{name}(uav1)`",
            )
        readings.setdefault(_want(reading, sorts, objects), []).append(reading)
    arguments = (a for reading in readings_of(checked.formula) for a in reading.arguments)
    named = {argument.name for argument in arguments if isinstance(argument, ObjectVariable)}
    for name, sort in sorts.items():
        if name not in named:
            raise NeedsError(
                f"no feature of `?{name}` is in the formula, so its objects are not known",
                f"read a feature of it, such as `speed(?{name})`, or leave `?{name} in "
                f"{shorten(sort)}` out",
            )
    for name, _ in checked.parameters:
        if name in (*RESULT_FIELDS, *TIME_FIELDS):
            raise NeedsError(
                f"`?{name}` cannot be a parameter: the verdicts have a field {name!r}",
                "give the variable another name",
            )
    return BoundFormula(checked, text, source, readings, open, values)


def _want(reading: Reading, sorts: dict[str, str], objects: dict[str, str]) -> Want:
    def subject(argument: ObjectConstant | ObjectVariable) -> Subject:
        if isinstance(argument, ObjectConstant):
            return Subject(None, argument.iri)
        sort = sorts[argument.name]
        return Subject(objects[sort], sort) if sort in objects else Subject(sort, None)

    first, *others = map(subject, reading.arguments)
    return Want(reading.feature, first.sort, first.object, tuple(others))


def _with_values(node: Any, values: Values) -> Any:
    """The formula with values in place of parameters."""
    if isinstance(node, Parameter):
        return values[node.name]
    if not dataclasses.is_dataclass(node) or not values:
        return node
    changed = {
        field.name: _with_values(getattr(node, field.name), values)
        for field in dataclasses.fields(node)
    }
    return replace(node, **changed)  # type: ignore[type-var]
