"""Writes shapes as a specification in XML, for the running configuration and for storage
([Introspection15 §3.2]).

A unit with one reader is written inside its reader, and one with several readers inside the first;
the others refer to it by `stream`. A top insertion is written as a top element.
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
from ..planning.unit_shapes import RunningShapes, Shape

_NOWHERE = Span(0, 0)
_MAX_COPIES = 10_000
"""The most elements of a text that repeats units without a name inside each reader."""
_MAX_SHOWN = 4_096
"""The length, in characters, up to which the status stream has an element's inputs in full."""


class Writer:
    """Writes shapes as elements. Cost: O(elements written).

    ``names`` are the names that texts gave to a shape; ``new_name`` returns one for a shape that
    needs one. Without ``new_name`` a unit without a name is repeated inside each reader, so that
    each insertion is complete without the others.
    """

    def __init__(
        self,
        names: Mapping[Shape, Sequence[str]],
        new_name: Callable[[Shape], str] | None = None,
    ) -> None:
        self._names = names
        self._new_name = new_name
        self._tops: set[Shape] = set()
        self._labels: dict[Shape, str] = {}
        self._inner: dict[Shape, str] = {}
        """Names of units that are written inside their first reader."""
        self._written: set[Shape] = set()

    def write(self, tops: Sequence[tuple[Shape, str | None]]) -> tuple[UnitSpecification, ...]:
        """Write ``tops``, each with its name, and their inputs.

        The order stays, except that a stream's own name comes before its aliases: applying a text
        makes the first name of a stream its own.
        """
        self._tops = {shape for shape, _ in tops}
        shapes = list(_inputs_first(shape for shape, _ in tops))
        read = Counter(below for shape in shapes for below in _inputs(shape))
        top_names: dict[Shape, set[str | None]] = {}
        for shape, name in tops:
            top_names.setdefault(shape, set()).add(name)
        for shape in shapes:
            self._label(shape, top_names.get(shape, set()), read[shape])
        ordered = self._own_names_first(tops, shapes)
        return tuple(
            self._element(shape, name or self._reference_name(shape)) for shape, name in ordered
        )

    def _own_names_first(
        self, tops: Sequence[tuple[Shape, str | None]], shapes: Sequence[Shape]
    ) -> list[tuple[Shape, str | None]]:
        """Reorder ``tops``; ``shapes`` has all shapes, inputs first."""
        own_first = sorted(tops, key=lambda top: top[1] != self._own_name(top[0]))
        names: dict[Shape, list[str | None]] = {}
        for shape, name in reversed(own_first):
            names.setdefault(shape, []).append(name)
        # Shapes keep their places, and only the names of one shape change theirs.
        ordered = [(shape, names[shape].pop()) for shape, _ in tops]
        # The own name of these is written inside a reader, so the readers come first.
        inside = {s: i for i, s in enumerate(shapes) if self._own_name(s) == self._inner.get(s, "")}
        return [top for top in ordered if top[0] not in inside] + sorted(
            (top for top in ordered if top[0] in inside), key=lambda top: -inside[top[0]]
        )

    def _own_name(self, shape: Shape) -> str | None:
        return next(iter(self._names.get(shape, ())), None)

    def _label(self, shape: Shape, top_names: set[str | None], read: int) -> None:
        """Choose the name by which the readers of a shape refer to it."""
        names = self._names.get(shape, ())
        others = [name for name in names if name not in top_names]
        if others and read:
            self._inner[shape] = self._labels[shape] = others[0]
        elif names:
            self._labels[shape] = next((name for name in names if name in top_names), names[0])
        elif self._new_name is not None and read > (shape not in self._tops):
            self._labels[shape] = self._new_name(shape)

    def _reference_name(self, shape: Shape) -> str | None:
        """The new_name name of an insertion that others read."""
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
    """Count the elements of a text that repeats units without a name inside each reader."""
    sizes: dict[Shape, int] = {}
    for shape in _inputs_first(tops):
        sizes[shape] = 1 + sum(1 if names.get(one) else sizes[one] for one in _inputs(shape))
    alone = set(tops)
    return sum(sizes[shape] for shape in sizes if names.get(shape) or shape in alone)


def can_be_copied(tops: Sequence[Shape], names: Mapping[Shape, Sequence[str]]) -> bool:
    """Whether a text that repeats units without a name is short enough."""
    return size_of(tops, names) <= _MAX_COPIES


def element_text(element: UnitSpecification | Removal) -> str:
    """Write an element for the status stream, with its inputs in full unless they are long."""
    text = format_element(element)
    if isinstance(element, Removal) or len(text) <= _MAX_SHOWN:
        return text
    inputs = tuple(
        one if isinstance(one, StreamReference) else replace(one, parameters=(), inputs=())
        for one in element.inputs
    )
    return format_element(replace(element, inputs=inputs))


def comment_text(running: RunningShapes, configuration: Configuration) -> str:
    """Write a comment about running processes that the text lacks, with a line end; empty if there
    are none."""
    failed = [unit for unit in configuration.units.values() if running.is_broken(unit)]
    inexpressible = [unit for unit in running.inexpressible if unit not in failed]
    lines = [
        f"{unit.name} ({unit.transformation}) makes {unit.output.name}" for unit in inexpressible
    ]
    lines += [f"{unit.name} ({unit.transformation}) has failed" for unit in failed]
    lines += [f"{name} makes no stream" for name in configuration.readers]
    if not lines:
        return ""
    text = "\n  ".join(["<!-- Not expressible in a specification, or failed:", *lines])
    # XML allows no two hyphens in a comment.
    return text.replace("<!--", "<!").replace("--", "- -").replace("<!", "<!--", 1) + " -->\n"


def _inputs(shape: Shape) -> Iterable[Shape]:
    return (one for one in shape.inputs if isinstance(one, Shape))


def _inputs_first(tops: Iterable[Shape]) -> Iterable[Shape]:
    """Yield all shapes, each once, inputs first."""
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
