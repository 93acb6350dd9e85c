"""The AST of SASE+ (SPEC §8): the text as written, with unresolved names.

Spans take no part in comparisons. `check` resolves names; what an attribute is, is known once
streams are found.
"""

from __future__ import annotations

from dataclasses import dataclass
from dataclasses import field as attribute
from enum import StrEnum
from typing import TypeAlias

from pyoxigraph import Variable as RdfVariable

from ..arguments import Defaults
from ..errors import Span
from ..mtl.ast import Measured, Number, Slot, Symbol, Text, TimePoint, Truth, Variable


class Strategy(StrEnum):
    """Which events follow each other in a match."""

    ANY_MATCH = "skip_till_any_match"
    NEXT_MATCH = "skip_till_next_match"
    PARTITION_CONTIGUITY = "partition_contiguity"
    STRICT_CONTIGUITY = "strict_contiguity"


class Index(StrEnum):
    """Which events of a part are meant."""

    ONE = ""
    """``a``: a part that is one event; in an aggregate, the events of all matches."""
    FIRST = "[1]"
    EACH = "[i]"
    PREVIOUS = "[i-1]"
    LAST = "[LEN]"
    """``a[a.LEN]``."""
    ALL = "[]"
    BEFORE = "[..i-1]"


@dataclass(frozen=True, slots=True)
class Attribute:
    """``a.price``, ``a[i].price``: an attribute of the event or events of a part."""

    part: str
    index: Index
    name: str
    span: Span = attribute(compare=False)


@dataclass(frozen=True, slots=True)
class Aggregate:
    """``avg(a[..i-1].price)``, ``count(a[])``; the function is in lower case. ``name`` None:
    the events are counted."""

    function: str
    part: str
    index: Index
    name: str | None
    span: Span = attribute(compare=False)


@dataclass(frozen=True, slots=True)
class CountMatches:
    """``COUNT(*)``: the number of matches that end with an event."""

    span: Span = attribute(compare=False)


@dataclass(frozen=True, slots=True)
class Duration:
    """``5 minutes``, in ns."""

    value: int
    span: Span = attribute(compare=False)


@dataclass(frozen=True, slots=True)
class Arithmetic:
    """``left + right``; the operator is one of ``+ - * / %``."""

    operator: str
    left: Term
    right: Term
    span: Span = attribute(compare=False)


@dataclass(frozen=True, slots=True)
class Negative:
    """``- operand``."""

    operand: Term
    span: Span = attribute(compare=False)


Constant: TypeAlias = Number | Text | TimePoint | Truth | Duration | Symbol
"""A value of a text; a symbol is an object."""
Term: TypeAlias = (
    Constant | Variable | Measured | Attribute | Aggregate | CountMatches | Arithmetic | Negative
)


@dataclass(frozen=True, slots=True)
class Comparison:
    """``left < right``; the operator is one of ``< <= > >= = !=``."""

    operator: str
    left: Term
    right: Term
    span: Span = attribute(compare=False)


@dataclass(frozen=True, slots=True)
class Equivalence:
    """``[tag]``: all events have one value of an attribute; ``[tag = 7]``: this one."""

    name: str
    value: Term | None
    span: Span = attribute(compare=False)


Condition: TypeAlias = Comparison | Equivalence


@dataclass(frozen=True, slots=True)
class Part:
    """``Stock+ a[]``, ``~Checkout b``, ``ANY(Shelf, Exit) c``: events of one of the types."""

    types: tuple[Symbol, ...]
    name: str
    is_negated: bool
    is_kleene: bool
    span: Span = attribute(compare=False)


@dataclass(frozen=True, slots=True)
class Item:
    """``term AS name`` of RETURN; ``name`` None: none is written."""

    term: Term
    name: str | None
    span: Span = attribute(compare=False)


@dataclass(frozen=True, slots=True)
class Pattern:
    """A query of SASE+. ``name`` is that of its stream, or empty. ``within`` in ns, or a parameter
    of a template; None stands for a clause that is not written. ``limit``: of the matches that one
    event completes. ``max_delay`` in ns."""

    name: str
    stream: Symbol | None
    parts: tuple[Part, ...]
    strategy: Strategy | None
    where: tuple[Condition, ...]
    within: int | Variable | None
    having: tuple[Condition, ...]
    items: tuple[Item, ...]
    limit: int | None
    max_delay: int | None
    span: Span = attribute(compare=False)


@dataclass(frozen=True)
class PatternTemplate:
    """``REGISTER TEMPLATE name(?x, ?limit) AS PATTERN …``: an abstract event. ``name`` is the IRI
    of the event concept."""

    name: str
    slots: tuple[Slot, ...]
    pattern: Pattern
    source: str = attribute(compare=False)

    @property
    def parameters(self) -> tuple[RdfVariable, ...]:
        """The parameters, as those of a C-SPARQL template."""
        return tuple(RdfVariable(slot.variable.name) for slot in self.slots)

    @property
    def defaults(self) -> Defaults:
        """The defaults of the parameters."""
        return tuple(slot.default for slot in self.slots)
