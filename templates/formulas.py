"""Formulas as continuous queries: what they need from streams, and their templates (SPEC §8)."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from pyoxigraph import BlankNode, Literal, NamedNode, Variable

from ..languages.mtl import (
    CheckedMonitor,
    FormulaTemplate,
    Monitor,
    check_formula_template,
    check_mtl,
)
from ..languages.mtl.checked import (
    Constant,
    Kind,
    ObjectConstant,
    ObjectSlot,
    ObjectVariable,
    Parameter,
    Reading,
)
from ..matching.subject import Subject
from ..matching.want import Want
from ..ontology.vocabulary import Vocabulary
from ..rdf.dictionary import Term
from ..rdf.namespaces import XSD, shorten
from ..reasoning.mtl.evaluator import sorts_of
from ..reasoning.mtl.formulas import readings_of
from ..reasoning.mtl.monitoring import RESULT_FIELDS
from ..streams.sample import TIME_FIELDS
from ..streams.time import parse_time
from .instantiate import argument_error, check_count, number_problem
from .needs import Needs, NeedsError


@dataclass(frozen=True, slots=True)
class BoundFormula:
    """A formula whose parameters are objects, as a query. ``text``: as written, for explanations;
    ``source``: all of the text. ``readings``: for each want the features that it serves."""

    monitor: CheckedMonitor
    text: Monitor
    source: str
    readings: dict[Want, list[Reading]]

    @property
    def needs(self) -> Needs:
        return Needs(tuple(self.readings), None)


def bound_monitor(monitor: Monitor, source: str, vocabulary: Vocabulary) -> BoundFormula:
    """Return a monitor as a query. Raises `LanguageError`; `NeedsError` for a feature without an
    object, and for a parameter whose objects no feature gives."""
    return _bound(check_mtl(monitor, source, vocabulary), monitor, source)


def bound_template(
    template: FormulaTemplate, arguments: Sequence[Term | Variable], vocabulary: Vocabulary
) -> BoundFormula:
    """Return the formula of a template with ``arguments``, one for each parameter.

    A variable leaves the objects of a parameter free. Raises `ArgumentError`, and the errors of
    `bound_monitor` where the ontology has changed since the template was registered.
    """
    check_count(template, arguments)
    checked = check_formula_template(template, vocabulary)
    values: dict[str, Constant | ObjectConstant] = {}
    sorts = dict(checked.monitor.parameters)
    fixed: dict[str, str] = {}
    for index, (slot, argument) in enumerate(zip(checked.slots, arguments, strict=True)):
        parameter = template.parameters[index]
        match slot, argument:
            case Parameter(), Variable():
                raise argument_error(
                    "it must be given: the formula finds no value for it",
                    index,
                    parameter,
                    f"give {_EXAMPLES[slot.kind]} instead of {argument}",
                )
            case Parameter(), NamedNode() | BlankNode() | Literal():
                values[slot.name] = _constant(argument, slot.kind, index, parameter)
            case ObjectSlot(name, sort), NamedNode(value=iri):
                # A sort of its own, so that quantifiers over the sort go on to mean all objects.
                sorts[name], fixed[iri] = iri, sort
            case ObjectSlot(), Variable():
                if argument in arguments[:index]:
                    raise argument_error(
                        f"{argument} is used for two arguments",
                        index,
                        parameter,
                        f"leave the second free under a name of its own: ?{slot.name}",
                    )
            case _:
                raise argument_error(
                    f"it stands for an object: expected an IRI, found {argument}",
                    index,
                    parameter,
                    "write a name such as dyknow:uav1",
                )
    monitor = replace(
        checked.monitor,
        parameters=tuple(sorts.items()),
        formula=_with_values(checked.monitor.formula, values),
        fixed=tuple(fixed.items()),
    )
    return _bound(monitor, template.monitor, template.source)


def template_wants(template: FormulaTemplate, vocabulary: Vocabulary) -> tuple[Want, ...]:
    """Return what a template needs for all objects. Raises `LanguageError` and `NeedsError`."""
    checked = check_formula_template(template, vocabulary)
    return tuple(_bound(checked.monitor, template.monitor, template.source).readings)


def _bound(checked: CheckedMonitor, text: Monitor, source: str) -> BoundFormula:
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
    return BoundFormula(checked, text, source, readings)


def _want(reading: Reading, sorts: dict[str, str], objects: dict[str, str]) -> Want:
    def subject(argument: ObjectConstant | ObjectVariable) -> Subject:
        if isinstance(argument, ObjectConstant):
            return Subject(None, argument.iri)
        sort = sorts[argument.name]
        return Subject(objects[sort], sort) if sort in objects else Subject(sort, None)

    first, *others = map(subject, reading.arguments)
    return Want(reading.feature, first.sort, first.object, tuple(others))


_EXAMPLES = {
    Kind.NUMBER: "a number, for example 100,",
    Kind.TRUTH: "true or false",
    Kind.TEXT: 'a text, for example "red",',
    Kind.TIME: 'a time, for example "2026-01-01T00:00:00Z"^^xsd:dateTime,',
    Kind.OBJECT: "an object, for example dyknow:uav1,",
}


def _constant(term: Term, kind: Kind, index: int, parameter: Variable) -> Constant | ObjectConstant:
    """The value of an argument. Raises `ArgumentError` for another kind."""
    problem = number_problem(term)
    datatype = term.datatype.value.removeprefix(XSD) if isinstance(term, Literal) else ""
    match kind:
        case Kind.OBJECT if isinstance(term, NamedNode):
            return ObjectConstant(term.value)
        case Kind.NUMBER if not problem:
            return Constant(float(term.value), Kind.NUMBER)
        case Kind.NUMBER if isinstance(term, Literal):
            raise argument_error(problem, index, parameter, "give a finite number, such as 100")
        case Kind.TRUTH if datatype == "boolean" and term.value in ("true", "false", "1", "0"):
            return Constant(term.value in ("true", "1"), Kind.TRUTH)
        case Kind.TEXT if datatype == "string":
            return Constant(term.value, Kind.TEXT)
        case Kind.TIME if datatype == "dateTime":
            try:
                return Constant(parse_time(term.value), Kind.TIME)
            except ValueError as error:
                raise argument_error(str(error), index, parameter) from None
        case _:
            pass
    shown = shorten(term.value) if isinstance(term, NamedNode) else f'"{term.value}"'
    article = "an" if kind is Kind.OBJECT else "a"
    raise argument_error(
        f"it is {article} {kind} in the formula, and {shown} is none",
        index,
        parameter,
        f"give {_EXAMPLES[kind].rstrip(',')}",
    )


def _with_values(node: Any, values: dict[str, Constant | ObjectConstant]) -> Any:
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
