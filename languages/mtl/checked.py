"""Checked MTL formulas: names resolved, truth told from number, units converted (SPEC §8).

Everything is a frozen value. A plan (`reasoning`) is made of these.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Final, TypeAlias

from ...ontology.units import Unit
from ...rdf.datatypes import NUMBERS
from ...rdf.namespaces import XSD
from ...streams.policies.policy import SynchronizationPolicy
from .ast import Interval, Report, Temporal


class Kind(StrEnum):
    """The kind of a value."""

    NUMBER = "number"
    TRUTH = "truth"
    TEXT = "text"
    TIME = "time"
    OBJECT = "object"
    DURATION = "duration"
    """In ns; of a parameter or of a calculation, but of no feature."""


_KINDS: Final = {
    XSD + "boolean": Kind.TRUTH,
    XSD + "string": Kind.TEXT,
    XSD + "dateTime": Kind.TIME,
}


def kind_of(range: str) -> Kind | None:
    """The kind of the values of a range, by its IRI; None for another type of XSD."""
    if range in NUMBERS:
        return Kind.NUMBER
    return _KINDS.get(range, None if range.startswith(XSD) else Kind.OBJECT)


@dataclass(frozen=True, slots=True)
class ObjectVariable:
    """A variable of a quantifier or parameter, by its name; names are unique in a formula."""

    name: str


@dataclass(frozen=True, slots=True)
class ObjectConstant:
    """An object, by its IRI."""

    iri: str


Argument: TypeAlias = ObjectVariable | ObjectConstant


@dataclass(frozen=True, slots=True)
class Reading:
    """The value of a feature of objects at a state: what matching has to find.

    ``unit`` is that of the ontology (None: no number, or without a unit); the formula's constants
    are in it.
    """

    feature: str
    arguments: tuple[Argument, ...]
    kind: Kind
    unit: Unit | None


@dataclass(frozen=True, slots=True)
class Constant:
    """A number, truth, text, or time in ns."""

    value: float | bool | str | int
    kind: Kind


@dataclass(frozen=True, slots=True)
class Parameter:
    """A value that a request of a template gives: in a template, in place of a constant."""

    name: str
    kind: Kind


@dataclass(frozen=True, slots=True)
class Calculation:
    """``left + right`` of numbers; the operator is one of ``+ - * /``. A division by 0 is
    unknown."""

    operator: str
    left: Value
    right: Value


Value: TypeAlias = Reading | Constant | Parameter | Calculation | ObjectVariable | ObjectConstant


@dataclass(frozen=True, slots=True)
class Atom:
    """``left < right``: unknown where a value is. The operator is one of ``< <= > >= = !=``."""

    operator: str
    left: Value
    right: Value


@dataclass(frozen=True, slots=True)
class Truth:
    value: bool


@dataclass(frozen=True, slots=True)
class Not:
    operand: Formula


@dataclass(frozen=True, slots=True)
class Previous:
    operand: Formula


@dataclass(frozen=True, slots=True)
class And:
    left: Formula
    right: Formula


@dataclass(frozen=True, slots=True)
class Or:
    left: Formula
    right: Formula


@dataclass(frozen=True, slots=True)
class Within:
    """``always``, ``eventually``, ``historically`` or ``once`` in an interval."""

    operator: Temporal
    interval: Interval
    operand: Formula


@dataclass(frozen=True, slots=True)
class Until:
    """``until``; ``is_past``: ``since``."""

    is_past: bool
    interval: Interval
    left: Formula
    right: Formula


@dataclass(frozen=True, slots=True)
class Quantified:
    """``forall``; not ``is_universal``: ``exists``. ``sort`` is an IRI."""

    is_universal: bool
    variable: str
    sort: str
    operand: Formula


Formula: TypeAlias = Truth | Atom | Not | Previous | And | Or | Within | Until | Quantified


@dataclass(frozen=True, slots=True)
class CheckedMonitor:
    """A monitor: a verdict for each binding of ``parameters`` (variable, IRI of its sort) and start
    state. See `ast.Monitor` for the options.

    ``fixed``: sorts of one object: its IRI, and the IRI of the sort to which it is taken to belong.
    A request of a template gives a parameter such a sort.
    """

    name: str
    parameters: tuple[tuple[str, str], ...]
    formula: Formula
    policy: SynchronizationPolicy
    report: Report
    once: bool
    present_for: int | None
    fixed: tuple[tuple[str, str], ...] = ()
    robustness: bool = False


@dataclass(frozen=True, slots=True)
class ObjectSlot:
    """A parameter of a template that stands for objects of a sort (IRI)."""

    name: str
    sort: str


@dataclass(frozen=True, slots=True)
class CheckedTemplate:
    """A formula with parameters, in the order of requests: objects, which may be free, and values,
    which a request gives. ``monitor`` is about all objects, and has the values as `Parameter`."""

    slots: tuple[ObjectSlot | Parameter, ...]
    monitor: CheckedMonitor
