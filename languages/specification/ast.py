"""The AST of XML specifications ([Introspection15 §3.2, Listing 1], SPEC §6).

A specification is a change of the configuration: units to insert, with their inputs, and units to
remove. Names are as written; the engine resolves them. Spans say where a thing stands and are no
part of what it is: two specifications that differ in their spans or source only are equal.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from dataclasses import field as attribute
from typing import TypeAlias

from ..errors import Span

RESERVED = "dyknow_reserved"
"""Names of streams that the system invents begin so (SPEC §5); none is used twice."""


@dataclass(frozen=True, slots=True)
class Parameter:
    """``<spec:parameter name="baseline" value="5s" />``: ours. ``value`` is verbatim.

    ``span`` is the start tag's, None for a parameter that was not read from a text.
    """

    name: str
    value: str
    span: Span | None = attribute(default=None, compare=False)


@dataclass(frozen=True, slots=True)
class StreamReference:
    """``<spec:stream name="positions" />``: ours. An input that is a stream, by its name.

    The stream exists already, or is the output of a unit of the same text: in this way a unit is
    used twice. Any name that a stream can have is meant, so labels such as ``speed[car1]`` too.
    """

    name: str
    span: Span = attribute(compare=False)


@dataclass(frozen=True, slots=True)
class UnitSpecification:
    """``<spec:cu type="fusionRGBIR">…</spec:cu>``: a computational unit and what it reads.

    ``type`` is the label of a transformation, ``name`` the name of the output stream (None: DyKnow
    assigns one). ``inputs`` are in the order of the text. ``span`` is the start tag's.
    """

    type: str
    name: str | None
    parameters: tuple[Parameter, ...]
    inputs: tuple[Input, ...]
    span: Span = attribute(compare=False)


Input: TypeAlias = UnitSpecification | StreamReference


@dataclass(frozen=True, slots=True)
class Removal:
    """``<spec:cu name="result" />`` or ``<spec:cu type="gps" />`` in `removals`.

    By ``name``: the unit of that name, or whose output stream has it. By ``type``: all units of
    that transformation. Exactly one of the two is not None.
    """

    name: str | None
    type: str | None
    span: Span = attribute(compare=False)


@dataclass(frozen=True, slots=True)
class Specification:
    """One text. ``source`` is what was read, decoded; spans are offsets into it."""

    insertions: tuple[UnitSpecification, ...]
    removals: tuple[Removal, ...]
    source: str = attribute(compare=False)


def elements_of(insertions: Iterable[UnitSpecification]) -> Iterator[UnitSpecification]:
    """All units of a text, those that are read by others among them."""
    todo = list(insertions)
    while todo:
        element = todo.pop()
        yield element
        todo += [given for given in element.inputs if isinstance(given, UnitSpecification)]


def is_reserved(name: str) -> bool:
    """Whether a name is one that DyKnow assigns. In a text it only ties `stream` to `cu`."""
    return name.startswith(RESERVED) and name.removeprefix(RESERVED).isdigit()
