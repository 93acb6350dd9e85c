"""The AST of chronicles (SPEC §8, [DyKnow10 §2, §7]): the text as written, with unresolved names.

Spans take no part in comparisons. `check` resolves names and finds the kinds of values.
"""

from __future__ import annotations

from dataclasses import dataclass
from dataclasses import field as attribute
from typing import TypeAlias

from pyoxigraph import Variable as RdfVariable

from ..arguments import Defaults
from ..errors import Span
from ..mtl.ast import Binding, Measured, Number, Slot, Symbol, Text, TimePoint, Truth, Variable

Argument: TypeAlias = Variable | Symbol | Text | None
"""An object; None stands for ``?``, any object."""
Operand: TypeAlias = Truth | Number | Text | TimePoint | Symbol | Variable | Measured


@dataclass(frozen=True, slots=True)
class Test:
    """``> 3 [m.s-1]``: a value compared with the operand; ``true`` alone has the operator ``=``."""

    operator: str
    operand: Operand
    span: Span = attribute(compare=False)


@dataclass(frozen=True, slots=True)
class Message:
    """``P[?x, uav1]:(before, value)``: samples of a feature or event.

    ``before`` and ``value`` are tests of the values of the sample before and of the sample; None
    stands for ``?``, any. A message without a change, such as ``E[?x]``, has neither.
    """

    concept: Symbol
    arguments: tuple[Argument, ...]
    before: Test | None
    value: Test | None
    span: Span = attribute(compare=False)


@dataclass(frozen=True, slots=True)
class Point:
    """``t1``: the name of a time point."""

    name: str
    span: Span = attribute(compare=False)


@dataclass(frozen=True, slots=True)
class Given:
    """``sign * ?d + offset`` of a parameter ``?d`` of a template, in ns."""

    variable: Variable
    sign: int = 1
    offset: int = 0


Duration: TypeAlias = int | Given
"""In ns."""


@dataclass(frozen=True, slots=True)
class Moment:
    """``t1 + 3s``: a time relative to a point."""

    point: Point
    offset: Duration
    span: Span = attribute(compare=False)


@dataclass(frozen=True, slots=True)
class Event:
    """``event(P[?x]:(false, true), t1)``."""

    message: Message
    point: Point
    span: Span = attribute(compare=False)


@dataclass(frozen=True, slots=True)
class Occurs:
    """``occurs((least, most), E[?x], (t1, t2))``; ``most`` None stands for ``oo``.
    ``noevent(E[?x], (t1, t2))`` is the same with 0 and 0."""

    least: int
    most: int | None
    message: Message
    start: Moment
    end: Moment
    span: Span = attribute(compare=False)


@dataclass(frozen=True, slots=True)
class Hold:
    """``hold(P[?x]:true, (t1, t2))``; the message tests the value alone."""

    message: Message
    start: Moment
    end: Moment
    span: Span = attribute(compare=False)


@dataclass(frozen=True, slots=True)
class Distance:
    """``second - first in [least, most]``; None: no bound."""

    first: Point
    second: Point
    least: Duration | None
    most: Duration | None
    span: Span = attribute(compare=False)


@dataclass(frozen=True, slots=True)
class Comparison:
    """``?x != ?y``; the operator is one of ``< <= > >= = !=``."""

    left: Variable
    operator: str
    right: Operand
    span: Span = attribute(compare=False)


Clause: TypeAlias = Event | Occurs | Hold | Distance | Comparison | Binding


@dataclass(frozen=True)
class Chronicle:
    """``chronicle name(?x, ?y) { clauses when recognized { emit event(name[?x, ?y], t); } }``.

    ``emitted``: the point that is the time of a match; None: that of its last event. ``stream``:
    the name in ``REGISTER STREAM stream AS``. ``max_delay`` in ns: of ``with max delay 5s``.
    """

    name: str
    parameters: tuple[Slot, ...]
    clauses: tuple[Clause, ...]
    emitted: Point | None
    stream: str | None
    max_delay: int | None
    span: Span = attribute(compare=False)


@dataclass(frozen=True)
class ChronicleTemplate:
    """``REGISTER TEMPLATE name(?x, ?limit) AS chronicle …``: an abstract event. ``name`` is the IRI
    of the event concept."""

    name: str
    slots: tuple[Slot, ...]
    chronicle: Chronicle
    source: str = attribute(compare=False)

    @property
    def parameters(self) -> tuple[RdfVariable, ...]:
        """The parameters, as those of a C-SPARQL template."""
        return tuple(RdfVariable(slot.variable.name) for slot in self.slots)

    @property
    def defaults(self) -> Defaults:
        """The defaults of the parameters."""
        return tuple(slot.default for slot in self.slots)
