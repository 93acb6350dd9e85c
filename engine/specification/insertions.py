"""What specifications inserted, under which names, and what of it is kept over a restart
([Introspection15 §3.2]).

An insertion that is no input of another `cu` holds its unit: it is one of its users. What the unit
reads is held by the unit. A name for a unit that has one already is an insertion by itself,
wherever it stands.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass, replace

from ...languages.specification import (
    Input,
    Removal,
    Specification,
    StreamReference,
    UnitSpecification,
    format_element,
    format_specification,
)
from ...languages.specification.ast import is_reserved
from ...ontology.ontology import Ontology
from ..configuration.configuration import Configuration
from ..model.status_changes import Change, ChangeKind
from ..model.views import InsertionView
from ..planning.unit_shapes import Running, Shape
from ..units.base import ComputationalUnit
from .serialize import Writer, can_be_copied


@dataclass(frozen=True, slots=True, eq=False)
class Inserted:
    """An insertion at work. ``name`` is what its output stream was called, if it was;
    ``element`` as it was written."""

    name: str | None
    unit: ComputationalUnit
    element: UnitSpecification

    @property
    def label(self) -> str:
        """What to call it in an error."""
        return f"insertion `{self.name or self.unit.output.name}`"


@dataclass(frozen=True, slots=True)
class Lost:
    """An insertion of an earlier run that does not hold any more, and why."""

    element: UnitSpecification
    reason: str


class Insertions:
    """The insertions, in order, with the names that they gave to streams that have another."""

    def __init__(
        self, ontology: Ontology, configuration: Configuration, changed: Callable[[Change], None]
    ) -> None:
        self.all: list[Inserted] = []
        self.lost: list[Lost] = []
        self._ontology = ontology
        self._configuration = configuration
        self._changed = changed
        self._aliases: dict[str, str] = {}

    # -- what there is -----------------------------------------------------------------------

    def of(self, unit: ComputationalUnit) -> tuple[Inserted, ...]:
        """The insertions that hold a unit."""
        return tuple(one for one in self.all if one.unit is unit)

    def units(self, running: Running) -> tuple[ComputationalUnit, ...]:
        """The units that specifications inserted: those that insertions hold, and what these are
        made from; each once."""
        held = {one.unit: None for one in self.all}
        found = dict(held)
        for unit in held:
            for part in running.behind(unit):
                if part in held or part not in running.implied:
                    found[part] = None
        return tuple(found)

    def names(self, running: Running) -> dict[Shape, list[str]]:
        """The names that people gave to the streams of a shape, its own name first."""
        found: dict[Shape, list[str]] = {}
        for stream, shape in running.shape_of.items():
            if not is_reserved(stream):
                found.setdefault(shape, []).append(stream)
        for alias, stream in self._aliases.items():
            if stream in running.shape_of:
                found.setdefault(running.shape_of[stream], []).append(alias)
        return found

    def views(self, running: Running) -> tuple[InsertionView, ...]:
        """The insertions in order, then those of an earlier run that do not hold any more."""
        views = [
            InsertionView(
                name=one.name,
                transformation=one.unit.transformation,
                text=format_element(one.element),
                stream=one.unit.output.name,
                unit=one.unit.name,
                failure=one.unit.failure
                or ("a unit behind it has failed" if running.is_broken(one.unit) else None),
            )
            for one in self.all
        ]
        return (*views, *(_lost_view(lost) for lost in self.lost))

    # -- change ------------------------------------------------------------------------------

    def give_alias(self, alias: str, stream: str) -> None:
        """A stream has a further name, which no stream keeps that stays."""
        self._aliases[alias] = stream
        self._configuration.aliases[alias] = stream

    def take_alias(self, alias: str, before: str | None) -> None:
        """Undo `give_alias`; ``before`` is what the name stood for."""
        del self._aliases[alias]
        del self._configuration.aliases[alias]
        if before is not None:
            self.give_alias(alias, before)

    def has_alias(self, stream: str) -> bool:
        """Whether a stream was given a further name."""
        return stream in self._aliases.values()

    def tell_aliases(self, stream: str) -> None:
        """The further names of a stream have changed."""
        names = tuple(alias for alias, of in self._aliases.items() if of == stream)
        text = ", ".join(names)
        self._changed(Change(ChangeKind.STREAM_NAMED, stream, specification=text, aliases=names))

    def heard(self, change: Change) -> None:
        """A stream that is no more has no names."""
        if change.kind is ChangeKind.STREAM_REMOVED:
            for alias in [a for a, stream in self._aliases.items() if stream == change.stream]:
                del self._aliases[alias]
                self._configuration.aliases.pop(alias, None)

    # -- what is kept ------------------------------------------------------------------------

    def keep(self, running: Running) -> None:
        """Keep what was inserted for the next run, and what an earlier one had."""
        text = self._text(running)
        if text != self._ontology.registered.specifications():
            self._ontology.registered.set_specifications(text)

    def forget_lost(self, removal: Removal) -> bool:
        """Forget what an earlier run inserted and is removed; whether there was anything."""
        kept = [lost for lost in self.lost if not _is_meant(lost.element, removal)]
        found = len(kept) < len(self.lost)
        self.lost = kept
        return found

    def replace_lost(self, names: Collection[str]) -> None:
        """What an earlier run called so is inserted anew."""
        self.lost = [
            Lost(_without(lost.element, names), lost.reason)
            for lost in self.lost
            if lost.element.name not in names
        ]

    def _text(self, running: Running) -> str:
        names = self.names(running)
        known = [one for one in self.all if one.unit.output.name in running.shape_of]
        tops = [(running.shape_of[one.unit.output.name], one.name) for one in known]
        shapes = [shape for shape, _ in tops]
        invented = None if can_be_copied(shapes, names) else running.stream_of.__getitem__
        writer = Writer(names, invented)
        # What has lost an input is kept as it was written.
        there = set(known)
        others = [one.element for one in self.all if one not in there]
        elements = (*writer.write(tops), *others, *(lost.element for lost in self.lost))
        return format_specification(Specification(elements, (), "")) if elements else ""


def _is_meant(element: UnitSpecification, removal: Removal) -> bool:
    return element.type == removal.type if removal.name is None else element.name == removal.name


def _without(element: UnitSpecification, names: Collection[str]) -> UnitSpecification:
    """The element, whose inputs of these names are read by name."""

    def read(given: Input) -> Input:
        if isinstance(given, StreamReference):
            return given
        if given.name in names:
            assert given.name is not None
            return StreamReference(given.name, given.span)
        return _without(given, names)

    return replace(element, inputs=tuple(map(read, element.inputs)))


def _lost_view(lost: Lost) -> InsertionView:
    return InsertionView(
        name=lost.element.name,
        transformation=lost.element.type,
        text=format_element(lost.element),
        stream=None,
        unit=None,
        failure=lost.reason,
    )
