"""Shapes as a specification in XML: the running configuration, and what is kept over a restart
([Introspection15 §3.2]).

A unit that is read once stands where it is read; one that is read more often stands there once,
one that was inserted by itself by itself, and others say `stream`.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace

from ...languages.errors import Span
from ...languages.specification import (
    Input,
    Parameter,
    Removal,
    StreamReference,
    UnitSpecification,
    format_element,
)
from ..configuration.configuration import Configuration
from ..planning.unit_shapes import Running, Shape

_NOWHERE = Span(0, 0)
_COPIES = 10_000
"""So many elements may units be written as that have no name and are read more than once."""
_SHOWN = 4_096
"""So long, in characters, is the text with which the start of a unit is told."""


class Writer:
    """Writes shapes as elements.

    ``names`` are those that people gave a shape, ``invented`` gives one to a shape that needs one.
    Without ``invented`` units that have no name are written in full wherever they are read: then
    each insertion says the same without the others. Cost: O(elements written).
    """

    def __init__(
        self,
        names: Mapping[Shape, Sequence[str]],
        invented: Callable[[Shape], str] | None = None,
    ) -> None:
        self._names = names
        self._invented = invented
        self._tops: set[Shape] = set()
        self._labels: dict[Shape, str] = {}
        self._inner: dict[Shape, str] = {}
        """Names that are given where the unit is read for the first time."""
        self._written: set[Shape] = set()

    def write(self, tops: Sequence[tuple[Shape, str | None]]) -> tuple[UnitSpecification, ...]:
        """The insertions: ``tops``, each under its name, with all that they read.

        In order, but that a stream's own name comes before its others, for it is the first that a
        text gives it.
        """
        self._tops = {shape for shape, _ in tops}
        shapes = list(_behind(shape for shape, _ in tops))
        read = Counter(below for shape in shapes for below in _inputs(shape))
        given: dict[Shape, set[str | None]] = {}
        for shape, name in tops:
            given.setdefault(shape, set()).add(name)
        for shape in shapes:
            self._label(shape, given.get(shape, set()), read[shape])
        ordered = self._own_names_first(tops, shapes)
        return tuple(self._element(shape, name or self._needed(shape)) for shape, name in ordered)

    def _own_names_first(
        self, tops: Sequence[tuple[Shape, str | None]], shapes: Sequence[Shape]
    ) -> list[tuple[Shape, str | None]]:
        """``tops`` reordered; ``shapes`` has all shapes behind those that they read."""
        own_first = sorted(tops, key=lambda top: top[1] != self._own_name(top[0]))
        names: dict[Shape, list[str | None]] = {}
        for shape, name in reversed(own_first):
            names.setdefault(shape, []).append(name)
        ordered = [(shape, names[shape].pop()) for shape, _ in tops]
        # A name that is given where the unit is read stands with its readers: these come first.
        inside = {s: i for i, s in enumerate(shapes) if self._own_name(s) == self._inner.get(s, "")}
        return [top for top in ordered if top[0] not in inside] + sorted(
            (top for top in ordered if top[0] in inside), key=lambda top: -inside[top[0]]
        )

    def _own_name(self, shape: Shape) -> str | None:
        return next(iter(self._names.get(shape, ())), None)

    def _label(self, shape: Shape, given: set[str | None], read: int) -> None:
        """By which name a shape is read."""
        names = self._names.get(shape, ())
        others = [name for name in names if name not in given]
        if others and read:
            self._inner[shape] = self._labels[shape] = others[0]
        elif names:
            self._labels[shape] = next((name for name in names if name in given), names[0])
        elif self._invented is not None and read > (shape not in self._tops):
            self._labels[shape] = self._invented(shape)

    def _needed(self, shape: Shape) -> str | None:
        """The invented name of an insertion that others read."""
        return None if self._names.get(shape) else self._labels.get(shape)

    def _element(self, shape: Shape, name: str | None) -> UnitSpecification:
        self._written.add(shape)
        parameters = tuple(Parameter(*pair) for pair in shape.parameters)
        inputs = tuple(self._input(one) for one in shape.inputs)
        return UnitSpecification(shape.type, name, parameters, inputs, _NOWHERE)

    def _input(self, one: Shape | str) -> Input:
        if isinstance(one, str):
            return StreamReference(one, _NOWHERE)
        inner = self._inner.pop(one, None)
        if inner is not None:
            return self._element(one, inner)
        label = self._labels.get(one)
        if label is not None and (one in self._tops or one in self._written):
            return StreamReference(label, _NOWHERE)
        return self._element(one, label)


def size_of(tops: Sequence[Shape], names: Mapping[Shape, Sequence[str]]) -> int:
    """How many elements the shapes are if those without a name are written wherever they are
    read."""
    sizes: dict[Shape, int] = {}
    for shape in _behind(tops):
        sizes[shape] = 1 + sum(1 if names.get(one) else sizes[one] for one in _inputs(shape))
    alone = set(tops)
    return sum(sizes[shape] for shape in sizes if names.get(shape) or shape in alone)


def can_be_copied(tops: Sequence[Shape], names: Mapping[Shape, Sequence[str]]) -> bool:
    """Whether units without a name may be written in full wherever they are read."""
    return size_of(tops, names) <= _COPIES


def told(element: UnitSpecification | Removal) -> str:
    """An element as the status stream tells it: with what is in it, unless that is long."""
    text = format_element(element)
    if isinstance(element, Removal) or len(text) <= _SHOWN:
        return text
    inputs = tuple(
        one if isinstance(one, StreamReference) else replace(one, parameters=(), inputs=())
        for one in element.inputs
    )
    return format_element(replace(element, inputs=inputs))


def comment(running: Running, configuration: Configuration) -> str:
    """What runs and does not stand in the text, as a comment with its line end; empty if nothing
    does."""
    failed = [unit for unit in configuration.units.values() if running.is_broken(unit)]
    unsaid = [unit for unit in running.unsaid if unit not in failed]
    lines = [f"{unit.name} ({unit.transformation}) makes {unit.output.name}" for unit in unsaid]
    lines += [f"{unit.name} ({unit.transformation}) has failed" for unit in failed]
    lines += [f"{name} makes no stream" for name in configuration.readers]
    if not lines:
        return ""
    text = "\n  ".join(["<!-- What a specification cannot make, and what has failed:", *lines])
    # XML allows no two hyphens in a comment.
    return text.replace("<!--", "<!").replace("--", "- -").replace("<!", "<!--", 1) + " -->\n"


def _inputs(shape: Shape) -> Iterable[Shape]:
    return (one for one in shape.inputs if isinstance(one, Shape))


def _behind(tops: Iterable[Shape]) -> Iterable[Shape]:
    """All shapes, each once, behind those that it reads."""
    done: set[Shape] = set()
    stack = list(reversed(list(tops)))
    while stack:
        shape = stack[-1]
        missing = [one for one in _inputs(shape) if one not in done]
        if missing:
            stack += reversed(missing)
            continue
        stack.pop()
        if shape not in done:
            done.add(shape)
            yield shape
