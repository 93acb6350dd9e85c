"""Checked chronicles: names resolved, kinds of values known, units converted (SPEC §8).

Everything is a frozen value. `reasoning.patterns.compilation` makes plans of these. Spans take no
part in comparisons.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from dataclasses import field as attribute
from typing import TypeAlias

from ...ontology.units import Unit
from ..errors import Span
from ..mtl.checked import Calculation, Constant, Kind, ObjectConstant, ObjectSlot, Parameter


@dataclass(frozen=True, slots=True)
class Variable:
    """A variable by its name: of an object, or of a value."""

    name: str


Argument: TypeAlias = Variable | ObjectConstant | None
"""An object; None: any."""
Operand: TypeAlias = Variable | Constant | Parameter | Calculation | ObjectConstant
"""What a value is compared with, in its unit. A `Calculation` converts a parameter."""


@dataclass(frozen=True, slots=True)
class Test:
    """A value compared with the operand; the operator is one of ``< <= > >= = !=``."""

    operator: str
    operand: Operand


@dataclass(frozen=True, slots=True)
class Message:
    """Samples of a feature or event (IRI) of these objects, with tests of the value of the sample
    before and of the sample (None: any). ``kind``: of the values; None: they are not read."""

    concept: str
    arguments: tuple[Argument, ...]
    before: Test | None
    value: Test | None
    kind: Kind | None
    span: Span = attribute(compare=False)


@dataclass(frozen=True, slots=True)
class Event:
    """A sample that must be there; its time is the ``point``."""

    message: Message
    point: str
    span: Span = attribute(compare=False)


@dataclass(frozen=True, slots=True)
class Given:
    """``sign * duration + offset``, in ns, of the duration that a parameter of a template has."""

    name: str
    sign: int
    offset: int


Duration: TypeAlias = int | Given
"""In ns."""


@dataclass(frozen=True, slots=True)
class Moment:
    """A time relative to a point."""

    point: str
    offset: Duration


@dataclass(frozen=True, slots=True)
class Occurs:
    """From ``least`` to ``most`` (None: any number of) samples lie between two times, of which
    neither counts."""

    least: int
    most: int | None
    message: Message
    start: Moment
    end: Moment
    span: Span = attribute(compare=False)


@dataclass(frozen=True, slots=True)
class Hold:
    """The last sample at the start or before it passes the test of the value, and so does each one
    after it, up to the end, which counts."""

    message: Message
    start: Moment
    end: Moment
    span: Span = attribute(compare=False)


@dataclass(frozen=True, slots=True)
class Distance:
    """``second - first in [least, most]``; None: no bound."""

    first: str
    second: str
    least: Duration | None
    most: Duration | None


@dataclass(frozen=True, slots=True)
class Comparison:
    """A variable compared with an operand of its kind and unit."""

    left: Variable
    operator: str
    right: Operand


@dataclass(frozen=True, slots=True)
class Meaning:
    """What a variable stands for: an object of a ``sort`` (IRI), or a value of a ``kind``, whose
    sort is None. ``span``: where the text says the sort, or first names the variable."""

    kind: Kind
    sort: str | None
    unit: Unit | None
    span: Span = attribute(compare=False)


@dataclass(frozen=True)
class CheckedChronicle:
    """A match binds each event to a sample of its own, and each variable to one object or value.

    ``head``: the variables that a match tells of. ``emitted``: the point that is the time of a
    match; None: that of the last event. ``max_delay`` in ns. ``fixed``: the objects (IRIs) of
    variables that a request of a template gives; each is taken to belong to the sort of its
    variable.
    """

    name: str
    head: tuple[str, ...]
    variables: Mapping[str, Meaning]
    events: tuple[Event, ...]
    probes: tuple[Occurs | Hold, ...]
    distances: tuple[Distance, ...]
    comparisons: tuple[Comparison, ...]
    emitted: str | None
    span: Span = attribute(compare=False)
    fixed: tuple[tuple[str, str], ...] = ()
    max_delay: int | None = None

    def messages(self) -> tuple[Message, ...]:
        """The messages of all events, then of the other clauses."""
        return tuple(each.message for each in (*self.events, *self.probes))


@dataclass(frozen=True, slots=True)
class CheckedTemplate:
    """A chronicle with parameters, in the order of requests: objects, which may be free, and
    values, which a request gives. ``chronicle`` is about all objects, and has the values as
    `Parameter`."""

    slots: tuple[ObjectSlot | Parameter, ...]
    chronicle: CheckedChronicle


def with_arguments(
    chronicle: CheckedChronicle,
    values: Mapping[str, Constant | ObjectConstant],
    objects: Mapping[str, str],
) -> CheckedChronicle:
    """Return the chronicle of a template for a request: ``values`` in place of its parameters, and
    the objects (IRIs) that some variables stand for."""

    def operand(old: Operand) -> Operand:
        match old:
            case Parameter(name):
                return values[name]
            case Calculation(operator, left, right):
                # The checker makes these of parameters and constants only.
                return Calculation(operator, operand(left), operand(right))  # type: ignore[arg-type]
            case _:
                return old

    def test(old: Test | None) -> Test | None:
        return None if old is None else Test(old.operator, operand(old.operand))

    def message(old: Message) -> Message:
        return replace(old, before=test(old.before), value=test(old.value))

    def duration(old: Duration) -> int:
        if isinstance(old, int):
            return old
        value = values[old.name]
        assert isinstance(value, Constant)
        return old.sign * int(value.value) + old.offset

    def moment(old: Moment) -> Moment:
        return replace(old, offset=duration(old.offset))

    def bound(old: Duration | None) -> int | None:
        return None if old is None else duration(old)

    return replace(
        chronicle,
        events=tuple(replace(each, message=message(each.message)) for each in chronicle.events),
        probes=tuple(
            replace(
                each,
                message=message(each.message),
                start=moment(each.start),
                end=moment(each.end),
            )
            for each in chronicle.probes
        ),
        distances=tuple(
            replace(each, least=bound(each.least), most=bound(each.most))
            for each in chronicle.distances
        ),
        comparisons=tuple(
            replace(each, right=operand(each.right)) for each in chronicle.comparisons
        ),
        fixed=tuple(objects.items()),
    )
