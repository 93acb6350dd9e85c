"""The AST of XML specifications ([Introspection15 §3.2, Listing 1], SPEC §6).

A specification is a change of the configuration: units to insert, with their inputs, and units to
remove. Names are as written; the engine resolves them. Spans take no part in comparisons: two
specifications that differ only in spans or source are equal.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from dataclasses import field as attribute
from typing import TypeAlias

from ..errors import Span

RESERVED = "dyknow_reserved"
"""The prefix of generated stream names (SPEC §5); none is used twice."""


@dataclass(frozen=True, slots=True)
class Parameter:
    """``<spec:parameter name="baseline" value="5s" />``: an extension. ``value`` is verbatim.

    ``span`` is that of the start tag; None if the parameter was not parsed from a text.
    """

    name: str
    value: str
    span: Span | None = attribute(default=None, compare=False)


@dataclass(frozen=True, slots=True)
class StreamReference:
    """``<spec:stream name="positions" />``: an extension. An input that is a stream, by its name.

    The stream exists already, or is the output of a unit of the same text: in this way two units
    read one unit. Any stream name is allowed, labels such as ``speed[car1]`` included.
    """

    name: str
    span: Span = attribute(compare=False)


@dataclass(frozen=True, slots=True)
class UnitSpecification:
    """``<spec:cu type="fusionRGBIR">…</spec:cu>``: a computational unit and its inputs.

    ``type`` is the label of a transformation, ``name`` the name of the output stream (None: DyKnow
    generates one). ``inputs`` are in the order of the text. ``span`` is that of the start tag.
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

    ``name`` selects the unit with this name or output stream, ``type`` all units of the
    transformation. Exactly one of the two is not None.
    """

    name: str | None
    type: str | None
    span: Span = attribute(compare=False)


@dataclass(frozen=True, slots=True)
class Specification:
    """A parsed text. ``source`` is the decoded text; spans are offsets into it."""

    insertions: tuple[UnitSpecification, ...]
    removals: tuple[Removal, ...]
    source: str = attribute(compare=False)


def elements_of(insertions: Iterable[UnitSpecification]) -> Iterator[UnitSpecification]:
    """Yield all units of a text, nested ones included."""
    todo = list(insertions)
    while todo:
        element = todo.pop()
        yield element
        todo += [given for given in element.inputs if isinstance(given, UnitSpecification)]


def is_reserved(name: str) -> bool:
    """Return whether DyKnow generates such a name. In a text such a name only links a `stream` to a
    `cu`."""
    return name.startswith(RESERVED) and name.removeprefix(RESERVED).isdigit()
