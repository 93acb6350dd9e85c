"""Arguments of requests for templates whose parameters have kinds: formulas and chronicles."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from pyoxigraph import BlankNode, Literal, NamedNode, Variable

from ..languages.chronicle import ChronicleTemplate
from ..languages.mtl import FormulaTemplate
from ..languages.mtl.checked import Constant, Kind, ObjectConstant, ObjectSlot, Parameter
from ..rdf.dictionary import Term
from ..rdf.namespaces import XSD, shorten
from ..streams.time import parse_time
from .instantiate import argument_error, check_count, number_problem


@dataclass(frozen=True, slots=True)
class BoundSlots:
    """The values of a template's parameters, and the objects (IRIs) that a request names."""

    values: Mapping[str, Constant | ObjectConstant]
    objects: Mapping[str, str]


def bind_slots(
    template: FormulaTemplate | ChronicleTemplate,
    slots: Sequence[ObjectSlot | Parameter],
    arguments: Sequence[Term | Variable],
) -> BoundSlots:
    """Bind the slots of a template to ``arguments``, one for each. A variable leaves the objects of
    a slot free. Raises `ArgumentError`."""
    check_count(template, arguments)
    values: dict[str, Constant | ObjectConstant] = {}
    objects: dict[str, str] = {}
    for index, (slot, argument) in enumerate(zip(slots, arguments, strict=True)):
        parameter = template.parameters[index]
        match slot, argument:
            case Parameter(), Variable():
                raise argument_error(
                    "it must be given: the template finds no value for it",
                    index,
                    parameter,
                    f"give {_EXAMPLES[slot.kind]} instead of {argument}",
                )
            case Parameter(), NamedNode() | BlankNode() | Literal():
                values[slot.name] = _constant(argument, slot.kind, index, parameter)
            case ObjectSlot(name), NamedNode(value=iri):
                objects[name] = iri
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
    return BoundSlots(values, objects)


_EXAMPLES: Final = {
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
        f"it is {article} {kind} in the template, and {shown} is none",
        index,
        parameter,
        f"give {_EXAMPLES[kind].rstrip(',')}",
    )
