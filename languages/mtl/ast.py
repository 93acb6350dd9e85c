"""The AST of MTL formulas (SPEC §8): the text as written, with unresolved names.

Spans take no part in comparisons. `check` resolves names and tells truth from number.
"""

from __future__ import annotations

from dataclasses import dataclass
from dataclasses import field as attribute
from enum import StrEnum
from typing import TypeAlias

from pyoxigraph import Variable as RdfVariable

from ...ontology.units import Unit
from ...streams.policies.policy import SynchronizationPolicy
from ..arguments import Default, Defaults
from ..errors import Span


class Temporal(StrEnum):
    """The temporal operators of one operand with an interval."""

    ALWAYS = "always"
    EVENTUALLY = "eventually"
    HISTORICALLY = "historically"
    ONCE = "once"

    @property
    def is_past(self) -> bool:
        """Whether the interval reaches back from the state."""
        return self in (Temporal.HISTORICALLY, Temporal.ONCE)


class Report(StrEnum):
    """The verdicts that the verdict stream contains."""

    VIOLATIONS = "violations"
    CHANGES = "changes"
    VERDICTS = "verdicts"


@dataclass(frozen=True, slots=True)
class Interval:
    """A closed interval ``[start, end]`` of ns; ``end`` None stands for ``oo``."""

    start: int = 0
    end: int | None = None


@dataclass(frozen=True, slots=True)
class Symbol:
    """A name of the ontology as written: ``speed``, ``dyknow:speed``, ``<http://…>``."""

    text: str
    span: Span = attribute(compare=False)


@dataclass(frozen=True, slots=True)
class Variable:
    """``?x``, without its question mark."""

    name: str
    span: Span = attribute(compare=False)


@dataclass(frozen=True, slots=True)
class Text:
    """A text without its quotes; as an argument, the id or name of an object."""

    value: str
    span: Span = attribute(compare=False)


@dataclass(frozen=True, slots=True)
class Number:
    """A number; ``unit`` None: that of the feature it meets."""

    value: float
    unit: Unit | None
    span: Span = attribute(compare=False)


@dataclass(frozen=True, slots=True)
class Measured:
    """``?limit [km.h-1]``: a parameter of a template, and the unit of its value."""

    variable: Variable
    unit: Unit
    span: Span = attribute(compare=False)


@dataclass(frozen=True, slots=True)
class TimePoint:
    """A time in ns since 1970."""

    value: int
    span: Span = attribute(compare=False)


@dataclass(frozen=True, slots=True)
class Truth:
    """``true`` or ``false``."""

    value: bool
    span: Span = attribute(compare=False)


@dataclass(frozen=True, slots=True)
class FeatureTerm:
    """``speed(?x)``; without arguments a feature that is no object's."""

    feature: Symbol
    arguments: tuple[Variable | Symbol | Text, ...]
    span: Span = attribute(compare=False)


@dataclass(frozen=True, slots=True)
class Arithmetic:
    """``left + right``; the operator is one of ``+ - * /``."""

    operator: str
    left: Formula
    right: Formula
    span: Span = attribute(compare=False)


@dataclass(frozen=True, slots=True)
class Negative:
    """``- operand``."""

    operand: Formula
    span: Span = attribute(compare=False)


@dataclass(frozen=True, slots=True)
class Comparison:
    """``left < right``; the operator is one of ``< <= > >= = !=``."""

    operator: str
    left: Formula
    right: Formula
    span: Span = attribute(compare=False)


@dataclass(frozen=True, slots=True)
class Not:
    operand: Formula
    span: Span = attribute(compare=False)


@dataclass(frozen=True, slots=True)
class Previous:
    """``previous f``: f at the state before; false at the first state."""

    operand: Formula
    span: Span = attribute(compare=False)


@dataclass(frozen=True, slots=True)
class And:
    left: Formula
    right: Formula
    span: Span = attribute(compare=False)


@dataclass(frozen=True, slots=True)
class Or:
    left: Formula
    right: Formula
    span: Span = attribute(compare=False)


@dataclass(frozen=True, slots=True)
class Implies:
    left: Formula
    right: Formula
    span: Span = attribute(compare=False)


@dataclass(frozen=True, slots=True)
class Within:
    """``always [a, b] f`` and the other temporal operators of one operand."""

    operator: Temporal
    interval: Interval
    operand: Formula
    span: Span = attribute(compare=False)


@dataclass(frozen=True, slots=True)
class Until:
    """``left until [a, b] right``; ``is_past``: ``left since [a, b] right``."""

    is_past: bool
    interval: Interval
    left: Formula
    right: Formula
    span: Span = attribute(compare=False)


@dataclass(frozen=True, slots=True)
class Binding:
    """``?x in Car``."""

    variable: Variable
    sort: Symbol
    span: Span = attribute(compare=False)


@dataclass(frozen=True, slots=True)
class Quantified:
    """``forall ?x in Car f``; not ``is_universal``: ``exists``. Several bindings nest."""

    is_universal: bool
    binding: Binding
    operand: Formula
    span: Span = attribute(compare=False)


Formula: TypeAlias = (
    Truth
    | FeatureTerm
    | Variable
    | Symbol
    | Text
    | Number
    | Measured
    | TimePoint
    | Arithmetic
    | Negative
    | Comparison
    | Not
    | Previous
    | And
    | Or
    | Implies
    | Within
    | Until
    | Quantified
)
"""Everything that the grammar admits as a formula; `check` refuses a number in place of a truth."""


@dataclass(frozen=True, slots=True)
class Monitor:
    """``monitor NAME(?x in Car, …) = formula with options``.

    ``policy`` says when there are states; without an option for that, at any change.
    ``present_for``: ns that an object stays present after its last sample; None: the default of
    SPEC §8. ``once``: a single start, the first state. ``robustness``: whether verdicts say by how
    much they hold.
    """

    name: str
    parameters: tuple[Binding, ...]
    formula: Formula
    policy: SynchronizationPolicy
    report: Report
    once: bool
    present_for: int | None
    robustness: bool
    span: Span = attribute(compare=False)


@dataclass(frozen=True, slots=True)
class Slot:
    """``?x``, ``?x in Car`` or ``?limit = 100``: a parameter of a template."""

    variable: Variable
    sort: Symbol | None
    span: Span = attribute(compare=False)
    default: Default | None = None


@dataclass(frozen=True)
class FormulaTemplate:
    """``REGISTER TEMPLATE name(?x, ?limit) AS formula with options``: an abstract event.

    ``name`` is the IRI of the event concept. ``monitor`` has the formula and the options; its
    parameters are those of a request.
    """

    name: str
    slots: tuple[Slot, ...]
    monitor: Monitor
    source: str = attribute(compare=False)

    @property
    def parameters(self) -> tuple[RdfVariable, ...]:
        """The parameters, as those of a C-SPARQL template."""
        return tuple(RdfVariable(slot.variable.name) for slot in self.slots)

    @property
    def defaults(self) -> Defaults:
        """The defaults of the parameters."""
        return tuple(slot.default for slot in self.slots)
