"""Checked EP-SPARQL: features told from static terms, kinds known, conditions without negation
(SPEC §8).

Everything is a frozen value. `reasoning.patterns.compilation.epsparql_plans` makes plans of these.
"""

from __future__ import annotations

from dataclasses import dataclass
from dataclasses import field as attribute
from typing import TypeAlias

from ...sparql.ast import Form, Triple
from ..errors import Span
from ..mtl.checked import Constant, Kind, ObjectConstant, ObjectSlot, Parameter
from .ast import Operator


@dataclass(frozen=True, slots=True)
class Variable:
    """A variable, or a blank node (`triples.BLANK`)."""

    name: str
    kind: Kind


@dataclass(frozen=True, slots=True)
class Duration:
    """A constant duration in ns."""

    value: int


@dataclass(frozen=True, slots=True)
class TimeOf:
    """``getDURATION()``, ``getSTARTTIME()`` or ``getENDTIME()`` of the enclosing group."""

    function: str


@dataclass(frozen=True, slots=True)
class Calculation:
    """``left + right``; the operator is one of ``+ - * /``. A division by 0 has no value."""

    operator: str
    left: Value
    right: Value
    kind: Kind


@dataclass(frozen=True, slots=True)
class StaticVariable:
    """A variable that only static triples have. In the head its value is a text: the name of an
    object, or that of a literal. In a condition it is of the kind that it is compared with, or has
    no value."""

    name: str
    kind: Kind = Kind.TEXT


Place: TypeAlias = Variable | ObjectConstant | Constant
Value: TypeAlias = Place | Duration | TimeOf | Calculation | StaticVariable


@dataclass(frozen=True, slots=True)
class Comparison:
    """``left < right`` of one kind. It does not hold where a side has no value."""

    operator: str
    left: Value
    right: Value


@dataclass(frozen=True, slots=True)
class Bound:
    """``BOUND(?x)``; not ``is_bound``: ``!BOUND(?x)``. ``is_static``: of a variable that only
    static triples have."""

    variable: str
    is_bound: bool
    is_static: bool = False


@dataclass(frozen=True, slots=True)
class Truth:
    value: bool


@dataclass(frozen=True, slots=True)
class And:
    operands: tuple[Condition, ...]


@dataclass(frozen=True, slots=True)
class Or:
    operands: tuple[Condition, ...]


Condition: TypeAlias = Comparison | Bound | Truth | And | Or
"""A negation is moved to the comparisons: where a value is missing neither form holds."""


@dataclass(frozen=True, slots=True)
class Sample:
    """One sample of a feature or event: ``?c dyknow:price ?p``. ``arguments`` are its objects, each
    with the IRI of its sort. ``is_event``: of an event, whose samples may last."""

    feature: str
    arguments: tuple[tuple[Place, str], ...]
    value: Place
    kind: Kind
    is_event: bool
    span: Span = attribute(compare=False)


@dataclass(frozen=True, slots=True)
class Static:
    """A triple of static graphs; ``graph`` None: those of FROM, or the ontology."""

    triple: Triple
    graph: str | None
    span: Span = attribute(compare=False)


@dataclass(frozen=True, slots=True)
class Filter:
    condition: Condition
    span: Span = attribute(compare=False)


@dataclass(frozen=True, slots=True)
class Bind:
    variable: Variable
    value: Value
    span: Span = attribute(compare=False)


@dataclass(frozen=True, slots=True)
class Operation:
    operator: Operator
    left: Operation | Group
    right: Group
    span: Span = attribute(compare=False)


@dataclass(frozen=True, slots=True)
class Group:
    parts: tuple[Part, ...]
    span: Span = attribute(compare=False)


Part: TypeAlias = Sample | Static | Filter | Bind | Operation | Group


@dataclass(frozen=True, slots=True)
class Item:
    """A field of the results. ``predicate``: that of a triple of CONSTRUCT (an IRI)."""

    name: str
    value: Value
    kind: Kind
    span: Span = attribute(compare=False)
    predicate: str | None = None


@dataclass(frozen=True)
class CheckedPattern:
    """An EP-SPARQL query. ``slots``: the parameters of a template in the order of requests; those
    of objects may stay free. ``within``: that of WITHIN; the conditions of the whole may bound a
    solution, too (`binding.horizon`). ``max_delay`` in ns."""

    name: str
    form: Form
    slots: tuple[ObjectSlot | Parameter, ...]
    items: tuple[Item, ...]
    where: Group
    within: Duration | Variable | None
    max_delay: int | None
    graphs: tuple[tuple[str, ...], tuple[str, ...]]
    source: str = attribute(compare=False)


def kind_of(value: Value) -> Kind:
    """Return the kind of a value."""
    match value:
        case (
            Variable(_, kind)
            | StaticVariable(_, kind)
            | Calculation(_, _, _, kind)
            | Constant(_, kind)
        ):
            return kind
        case ObjectConstant():
            return Kind.OBJECT
        case Duration():
            return Kind.DURATION
        case TimeOf(function):
            return Kind.DURATION if function == "getDURATION" else Kind.TIME
