"""Splits a specification into parts within bounds, to be applied one after the other
([Introspection15 §3.2]).

A configuration may be larger than a text may be (docs/explanation/isolation.md). The parts have the
same effect together: each comes after those whose streams it reads. The client calls this.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

from .ast import Input, Specification, StreamReference, UnitSpecification, elements_of, is_reserved
from .printer import format_specification

_AROUND = 256
"""Bytes of a text without its units."""


@dataclass(frozen=True, slots=True)
class Bounds:
    """The bounds of one text: inserted units, elements in all, bytes."""

    units: int
    elements: int
    bytes: int


@dataclass(frozen=True, slots=True)
class _Size:
    units: int = 0
    elements: int = 0
    bytes: int = 0

    def __add__(self, other: _Size) -> _Size:
        return _Size(
            self.units + other.units, self.elements + other.elements, self.bytes + other.bytes
        )

    def fits(self, bounds: Bounds) -> bool:
        units, elements, size = bounds.units, bounds.elements, bounds.bytes
        return self.units <= units and self.elements <= elements and self.bytes <= size


@dataclass(slots=True)
class _Part:
    units: list[UnitSpecification] = field(default_factory=list)
    names: set[str] = field(default_factory=set)
    size: _Size = _Size(bytes=_AROUND)


def is_within(specification: Specification, text: str | bytes, bounds: Bounds) -> bool:
    """Return whether ``text``, the source of ``specification``, is within the bounds."""
    length = len(text.encode() if isinstance(text, str) else text)
    size = sum(map(_size_without_bytes, specification.insertions), _Size(bytes=length))
    removed = len(specification.removals)
    return (size + _Size(elements=removed)).fits(bounds) and removed <= bounds.units


def parts_of(specification: Specification, bounds: Bounds) -> tuple[str, ...] | None:
    """Return texts that together insert what ``specification`` does, to be applied in order. None
    if there are none: it removes units, which may depend on each other, or a single insertion is
    too large.

    A generated name is valid within one text only. A part therefore writes a unit of an earlier
    part out in full where it reads it by such a name; the engine shares it. Cost: O(elements
    written).
    """
    if specification.removals:
        return None
    by_name = {one.name: one for one in elements_of(specification.insertions) if one.name}
    parts = [_Part()]
    earlier: set[str] = set()
    for top in _in_order(specification.insertions, by_name):
        for _ in range(2):
            part = parts[-1]
            written = _Copying(by_name, earlier, bounds.units).element(top)
            size = None if written is None else part.size + _size_of(written)
            if written is not None and size is not None and size.fits(bounds):
                part.units.append(written)
                part.names.update(one.name for one in elements_of([top]) if one.name)
                part.size = size
                break
            earlier |= part.names
            parts.append(_Part())
        else:
            return None
    return tuple(
        format_specification(Specification(tuple(part.units), (), ""))
        for part in parts
        if part.units
    )


class _Copying:
    """Copies an insertion into a part after the names ``earlier``, with at most ``most`` units."""

    def __init__(
        self, by_name: Mapping[str, UnitSpecification], earlier: set[str], most: int
    ) -> None:
        self._named = by_name
        self._earlier = earlier
        self._left = most

    def element(self, one: UnitSpecification) -> UnitSpecification | None:
        """Return a copy of ``one``; None if it has too many units."""
        self._left -= 1
        if self._left < 0:
            return None
        inputs: list[Input] = []
        for source in one.inputs:
            read = self._input(source)
            if read is None:
                return None
            inputs.append(read)
        return replace(one, inputs=tuple(inputs))

    def _input(self, source: Input) -> Input | None:
        if isinstance(source, StreamReference):
            if source.name not in self._earlier or not is_reserved(source.name):
                return source
            source = self._named[source.name]
        if source.name in self._earlier:
            assert source.name is not None
            # A name that a user gave still exists; a generated one was valid in the other text
            # only.
            if not is_reserved(source.name):
                return StreamReference(source.name, source.span)
            source = replace(source, name=None)
        return self.element(source)


def _size_of(one: UnitSpecification) -> _Size:
    text = format_specification(Specification((one,), (), ""))
    return _size_without_bytes(one) + _Size(bytes=len(text.encode()))


def _size_without_bytes(one: UnitSpecification) -> _Size:
    """Return the size without the bytes."""
    units = list(elements_of([one]))
    references = sum(
        isinstance(source, StreamReference) for each in units for source in each.inputs
    )
    elements = len(units) + references + sum(len(each.parameters) for each in units)
    return _Size(len(units), elements)


def _in_order(
    tops: Sequence[UnitSpecification], by_name: Mapping[str, UnitSpecification]
) -> Iterator[UnitSpecification]:
    """Yield the insertions, each after those that define a name that it reads. Insertions that read
    each other in a circle keep the order of the text: the engine reports the circle."""
    place = {one.name: top for top in tops for one in elements_of([top]) if one.name}
    done: set[int] = set()
    for first in tops:
        stack = [(first, iter(_read(first, place)))]
        if id(first) in done:
            continue
        done.add(id(first))
        while stack:
            top, rest = stack[-1]
            below = next((one for one in rest if id(one) not in done), None)
            if below is None:
                stack.pop()
                yield top
            else:
                done.add(id(below))
                stack.append((below, iter(_read(below, place))))


def _read(
    top: UnitSpecification, place: Mapping[str, UnitSpecification]
) -> list[UnitSpecification]:
    found = [
        place[source.name]
        for one in elements_of([top])
        for source in one.inputs
        if isinstance(source, StreamReference) and source.name in place
    ]
    return [one for one in found if one is not top]
