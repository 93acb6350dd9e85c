"""Arguments of templates whose bodies are formulas or patterns: objects and values by kind."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeAlias

from pyoxigraph import BlankNode, Literal, NamedNode, Variable

from ..languages.arguments import Argument
from ..languages.mtl.checked import Constant, Kind, ObjectConstant, ObjectSlot, Parameter
from ..languages.sase.checked import ValueSlot
from ..languages.templates import AnyTemplate
from ..rdf.dictionary import Term
from ..rdf.namespaces import XSD, shorten
from ..streams.time import parse_duration, parse_time
from .instantiate import argument_error, check_count, number_problem, used_twice

Values: TypeAlias = dict[str, Constant | ObjectConstant]
Slot: TypeAlias = ObjectSlot | Parameter | ValueSlot
"""What a parameter stands for: objects, a value of a kind, or a value of any kind."""


def given_arguments(
    template: AnyTemplate,
    slots: Sequence[Slot],
    arguments: Sequence[Argument],
) -> tuple[Values, dict[str, str]]:
    """Return the values that the ``arguments`` give, and the objects (IRIs), by the names of the
    parameters; ``slots``: what each of these stands for. A variable leaves an object free. Raises
    `ArgumentError`."""
    check_count(template, arguments)
    values: Values = {}
    objects: dict[str, str] = {}
    for index, (slot, argument) in enumerate(zip(slots, arguments, strict=True)):
        parameter = template.parameters[index]
        match given_argument(slot, argument, index, parameter):
            case None:
                if argument in arguments[:index]:
                    raise used_twice(argument, index, parameter)
            case str(iri):
                objects[slot.name] = iri
            case value:
                values[slot.name] = value
    return values, objects


def given_argument(
    slot: Slot, argument: Argument, index: int, parameter: Variable
) -> Constant | ObjectConstant | str | None:
    """Return the value or the object (IRI) that an argument gives; None: it leaves an object free.
    Raises `ArgumentError`."""
    match slot, argument:
        case Parameter() | ValueSlot(), Variable():
            raise argument_error(
                "it must be given: nothing else gives its value",
                index,
                parameter,
                f"give {_example(slot.kind)} instead of {argument}",
            )
        case Parameter() | ValueSlot(), NamedNode() | BlankNode() | Literal():
            return _constant(argument, slot.kind or _kind_of(argument), index, parameter)
        case ObjectSlot(), NamedNode(value=iri):
            return iri
        case ObjectSlot(), Variable():
            return None
        case _:
            raise argument_error(
                f"it stands for an object: expected an IRI, found {argument}",
                index,
                parameter,
                "write a name such as dyknow:uav1",
            )


_DURATIONS = ("duration", "dayTimeDuration")
_LONGEST = 1 << 60
"""Durations are shorter (36 years), so that sums of times stay within 64 bits."""
_EXAMPLES = {
    Kind.NUMBER: "a number, for example 100,",
    Kind.TRUTH: "true or false",
    Kind.TEXT: 'a text, for example "red",',
    Kind.TIME: 'a time, for example "2026-01-01T00:00:00Z"^^xsd:dateTime,',
    Kind.OBJECT: "an object, for example dyknow:uav1,",
    Kind.DURATION: 'a duration, for example "PT5S"^^xsd:duration,',
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
        case Kind.DURATION if datatype in (*_DURATIONS, "string"):
            try:
                # 5s is no xsd:duration, but a text that patterns have.
                if datatype == "string" or term.value.startswith("P"):
                    duration = parse_duration(term.value)
                    if duration >= _LONGEST:
                        raise ValueError(f"{term.value} exceeds 36 years")
                    return Constant(duration, Kind.DURATION)
            except ValueError as error:
                hint = "years and months vary in length"
                raise argument_error(str(error), index, parameter, hint) from None
        case _:
            pass
    shown = shorten(term.value) if isinstance(term, NamedNode) else f'"{term.value}"'
    article = "an" if kind is Kind.OBJECT else "a"
    raise argument_error(
        f"it is {article} {kind} in the template, and {shown} is none",
        index,
        parameter,
        f"give {_example(kind).rstrip(',')}",
    )


def _example(kind: Kind | None) -> str:
    return "a value, for example 100," if kind is None else _EXAMPLES[kind]


def _kind_of(term: Term) -> Kind:
    """The kind of a value that may be of any."""
    if not isinstance(term, Literal):
        return Kind.OBJECT
    kinds = {"boolean": Kind.TRUTH, "string": Kind.TEXT, "dateTime": Kind.TIME}
    kinds |= dict.fromkeys(_DURATIONS, Kind.DURATION)
    return kinds.get(term.datatype.value.removeprefix(XSD), Kind.NUMBER)
