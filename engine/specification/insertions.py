"""The insertions of specifications, their names, and their text for a restart
([Introspection15 §3.2]).

An insertion that is not the input of another `cu` is a user of its unit; a unit is a user of its
inputs. A `cu` that gives an alias to a named unit is an insertion too, also as an input.
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
from ..planning.unit_shapes import RunningShapes, Shape
from ..units.base import ComputationalUnit
from .writer import Writer, can_be_copied


@dataclass(frozen=True, slots=True, eq=False)
class Insertion:
    """A running insertion: the name that it gave to its output stream, if any, and its element."""

    name: str | None
    unit: ComputationalUnit
    element: UnitSpecification

    @property
    def label(self) -> str:
        """Its description in errors."""
        return f"insertion `{self.name or self.unit.output.name}`"


@dataclass(frozen=True, slots=True)
class LostInsertion:
    """An insertion of an earlier run that could not be restored, and the reason."""

    element: UnitSpecification
    reason: str


class Insertions:
    """The insertions, in order, and the aliases that they gave to streams."""

    def __init__(
        self, ontology: Ontology, configuration: Configuration, changed: Callable[[Change], None]
    ) -> None:
        self.all: list[Insertion] = []
        self.lost: list[LostInsertion] = []
        self._ontology = ontology
        self._configuration = configuration
        self._report = changed
        self._aliases: dict[str, str] = {}

    # -- look-ups ----------------------------------------------------------------------------

    def of(self, unit: ComputationalUnit) -> tuple[Insertion, ...]:
        """The insertions that hold a unit."""
        return tuple(one for one in self.all if one.unit is unit)

    def units(self, running: RunningShapes) -> tuple[ComputationalUnit, ...]:
        """The units that specifications inserted: those of insertions and the units behind them;
        each once."""
        held = {one.unit: None for one in self.all}
        found = dict(held)
        for unit in held:
            for part in running.upstream(unit):
                if part in held or part not in running.implied:
                    found[part] = None
        return tuple(found)

    def names(self, running: RunningShapes) -> dict[Shape, list[str]]:
        """The names that texts gave to the streams of each shape, a stream's own name first."""
        found: dict[Shape, list[str]] = {}
        for stream, shape in running.shape_of.items():
            if not is_reserved(stream):
                found.setdefault(shape, []).append(stream)
        for alias, stream in self._aliases.items():
            if stream in running.shape_of:
                found.setdefault(running.shape_of[stream], []).append(alias)
        return found

    def views(self, running: RunningShapes) -> tuple[InsertionView, ...]:
        """The insertions in order, then those that were not restored."""
        views = [
            InsertionView(
                name=one.name,
                transformation=one.unit.transformation,
                text=format_element(one.element),
                stream=one.unit.output.name,
                unit=one.unit.name,
                failure=one.unit.failure
                or (
                    "a unit that it depends on has failed" if running.is_broken(one.unit) else None
                ),
            )
            for one in self.all
        ]
        return (*views, *(_lost_view(lost) for lost in self.lost))

    # -- change ------------------------------------------------------------------------------

    def give_alias(self, alias: str, stream: str) -> None:
        """Give a stream an alias. Contract: no stream that stays has this name."""
        self._aliases[alias] = stream
        self._configuration.aliases[alias] = stream

    def take_alias(self, alias: str, before: str | None) -> None:
        """Undo `give_alias`; ``before`` is the stream that had the alias before."""
        del self._aliases[alias]
        del self._configuration.aliases[alias]
        if before is not None:
            self.give_alias(alias, before)

    def has_alias(self, stream: str) -> bool:
        """Whether a stream has an alias."""
        return stream in self._aliases.values()

    def report_aliases(self, stream: str) -> None:
        """Report the aliases of a stream after a change."""
        names = tuple(alias for alias, of in self._aliases.items() if of == stream)
        text = ", ".join(names)
        self._report(Change(ChangeKind.STREAM_NAMED, stream, specification=text, aliases=names))

    def on_change(self, change: Change) -> None:
        """Drop the aliases of a removed stream."""
        if change.kind is ChangeKind.STREAM_REMOVED:
            for alias in [a for a, stream in self._aliases.items() if stream == change.stream]:
                del self._aliases[alias]
                self._configuration.aliases.pop(alias, None)

    # -- storage -----------------------------------------------------------------------------

    def store(self, running: RunningShapes) -> None:
        """Store the insertions, and those that were not restored, for the next run."""
        text = self._text(running)
        if text != self._ontology.registered.specifications():
            self._ontology.registered.set_specifications(text)

    def forget_lost(self, removal: Removal) -> bool:
        """Remove insertions that were not restored; return whether there was one."""
        kept = [lost for lost in self.lost if not _is_named_by(lost.element, removal)]
        found = len(kept) < len(self.lost)
        self.lost = kept
        return found

    def replace_lost(self, names: Collection[str]) -> None:
        """Drop insertions that were not restored and whose names are inserted again."""
        self.lost = [
            LostInsertion(_with_references(lost.element, names), lost.reason)
            for lost in self.lost
            if lost.element.name not in names
        ]

    def _text(self, running: RunningShapes) -> str:
        names = self.names(running)
        with_shape = [one for one in self.all if one.unit.output.name in running.shape_of]
        tops = [(running.shape_of[one.unit.output.name], one.name) for one in with_shape]
        shapes = [shape for shape, _ in tops]
        # Copies make insertions independent, so one that fails at a restart fails alone.
        new_name = None if can_be_copied(shapes, names) else running.stream_of.__getitem__
        writer = Writer(names, new_name)
        # A unit that has lost an input has no shape: store its element as it was written.
        written = set(with_shape)
        others = [one.element for one in self.all if one not in written]
        elements = (*writer.write(tops), *others, *(lost.element for lost in self.lost))
        return format_specification(Specification(elements, (), "")) if elements else ""


def _is_named_by(element: UnitSpecification, removal: Removal) -> bool:
    return element.type == removal.type if removal.name is None else element.name == removal.name


def _with_references(element: UnitSpecification, names: Collection[str]) -> UnitSpecification:
    """Replace the inputs with these names by references."""

    def read(source: Input) -> Input:
        if isinstance(source, StreamReference):
            return source
        if source.name in names:
            assert source.name is not None
            return StreamReference(source.name, source.span)
        return _with_references(source, names)

    return replace(element, inputs=tuple(map(read, element.inputs)))


def _lost_view(lost: LostInsertion) -> InsertionView:
    return InsertionView(
        name=lost.element.name,
        transformation=lost.element.type,
        text=format_element(lost.element),
        stream=None,
        unit=None,
        failure=lost.reason,
    )
