"""Specifications in XML, applied: units inserted and removed in one change
([Introspection15 §3.2, Listing 1]).

A text is checked whole before anything happens (`elaboration`, `dependents`). Then what is new is
started (`insert`), and what is removed stops last, so that a failure half-way can be undone.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

from ...languages.errors import LanguageError
from ...languages.specification import (
    Removal,
    Specification,
    format_specification,
    parse_specification,
)
from ...languages.specification.ast import is_reserved
from ...ontology.ontology import Ontology
from ..catalog.transformation_library import Transformations
from ..configuration.configuration import Configuration
from ..model.errors import Refused
from ..model.status_changes import Change, ChangeKind
from ..model.views import InsertionView, SpecificationView
from ..planning.elaboration import Elaborated, Elaboration
from ..planning.explain import unit_view
from ..planning.plan_execution import Plans
from ..planning.unit_shapes import Running, Shape
from ..requests.subscriptions import Subscriptions
from ..units.base import ComputationalUnit
from .dependents import Users, leaving, needing, used_by_name
from .insert import Inserting
from .insertions import Inserted, Insertions, Lost
from .serialize import Writer, comment, told


@dataclass(frozen=True, slots=True, eq=False)
class _Change:
    """A text that was understood, and what it means for what runs.

    ``removed`` are the units that it removes, ``given_up`` the insertions that held them, ``made``
    what it inserts, inputs first, and ``gone`` the units that stop.
    """

    specification: Specification
    running: Running
    removed: dict[ComputationalUnit, list[Removal]]
    given_up: tuple[Inserted, ...]
    made: tuple[Elaborated, ...] = ()
    gone: tuple[ComputationalUnit, ...] = ()

    @property
    def kept(self) -> set[ComputationalUnit]:
        """Units that run and that the text needs."""
        shapes = [shape for one in self.made for shape in (one.shape, *one.shape.inputs)]
        units = self.running.unit_of
        return {units[s] for s in shapes if isinstance(s, Shape) and s in units}

    @property
    def named(self) -> tuple[tuple[str, Elaborated], ...]:
        """The names that the text gives."""
        pairs = ((one.element.name, one) for one in self.made)
        return tuple((name, one) for name, one in pairs if name and not is_reserved(name))

    def error(self, place: Removal | Elaborated, message: str, hint: str) -> LanguageError:
        """An error at an element of the text."""
        span = place.span if isinstance(place, Removal) else place.element.span
        return LanguageError(message, self.specification.source, span, hint)


class Specifications:
    """What specifications made of the configuration.

    ``check_name`` raises `Refused` for names that are the system's own; ``users`` names who uses a
    unit and its stream.
    """

    def __init__(
        self,
        ontology: Ontology,
        transformations: Transformations,
        configuration: Configuration,
        plans: Plans,
        subscriptions: Subscriptions,
        changed: Callable[[Change], None],
        *,
        check_name: Callable[[str], None],
        users: Users,
    ) -> None:
        self._ontology = ontology
        self._transformations = transformations
        self._configuration = configuration
        self._plans = plans
        self._subscriptions = subscriptions
        self._changed = changed
        self._check_name = check_name
        self._users = users
        self._insertions = Insertions(ontology, configuration, changed)

    # -- faces -------------------------------------------------------------------------------

    def apply(self, specification: Specification) -> SpecificationView:
        """Insert and remove what a text says, all of it or nothing.

        What is there already, the same, is not made anew. Raises `LanguageError` with the place of
        what is wrong. Cost: O(units that run + elements of the text), and what the units cost.
        """
        return self._apply(specification)

    def current(self) -> str:
        """The running configuration as a specification. Units that none can make, and those that
        have failed, are named in a comment.

        Law: applied to an engine with the same streams, transformations and ontology it gives an
        engine of which this is equal, but for invented names; here it starts and stops nothing.
        """
        running = self._running()
        names = self._insertions.names(running)
        tops = self._tops(running, names)
        elements = Writer(names, running.stream_of.__getitem__).write(tops)
        text = format_specification(Specification(elements, (), ""))
        first, _, rest = text.partition("\n")
        return f"{first}\n{comment(running, self._configuration)}{rest}"

    def __len__(self) -> int:
        """How many units are inserted."""
        return len(self._insertions.all)

    def views(self) -> tuple[InsertionView, ...]:
        """What was inserted, in order; then what an earlier run had and does not hold any more."""
        return self._insertions.views(self._running())

    def heard(self, change: Change) -> None:
        """The stream space has changed."""
        self._insertions.heard(change)

    def restore(self) -> None:
        """Insert what an earlier run had. What does not hold any more is told on the status
        stream, left out, and kept."""
        kept = self._ontology.registered.specifications()
        if not kept:
            return
        try:
            specification = parse_specification(kept)
        except LanguageError as error:
            self._not_restored(f"{error}\n{kept}")
            return
        left = list(specification.insertions)
        while left:
            try:
                self._apply(replace(specification, insertions=tuple(left)), restoring=True)
                return
            except LanguageError as error:
                # The element that is wrong, or in which something is.
                failed = [one for one in left if one.span.start <= error.span.start][-1:]
                reason = str(error)
            except Exception as error:  # noqa: BLE001  the engine starts without them, and says why
                failed, reason = left, f"{type(error).__name__}: {error}"
            left = [one for one in left if not any(one is other for other in failed)]
            for element in failed:
                self._insertions.lost.append(Lost(element, reason))
                self._not_restored(f"{reason}\n{told(element)}")

    # -- what runs ---------------------------------------------------------------------------

    def _running(self) -> Running:
        return Running(self._configuration, self._transformations)

    def _tops(
        self, running: Running, names: dict[Shape, list[str]]
    ) -> tuple[tuple[Shape, str | None], ...]:
        """The shapes that stand by themselves, with their names: those that were inserted so, and
        those that nothing reads."""
        held: dict[Shape, dict[str | None, None]] = {}
        for one in self._insertions.all:
            shape = running.shape_of.get(one.unit.output.name)
            if shape in running.unit_of:
                held.setdefault(shape, {})[one.name] = None
        said = {s for s, unit in running.unit_of.items() if unit not in running.implied} | {*held}
        read = {below for shape in said for below in shape.inputs}
        tops: list[tuple[Shape, str | None]] = []
        for shape in running.unit_of:
            if shape in held:
                tops += [(shape, name) for name in held[shape]]
            elif shape in said and shape not in read:
                tops.append((shape, next(iter(names.get(shape, ())), None)))
        return tuple(tops)

    def _not_restored(self, reason: str) -> None:
        self._changed(Change(ChangeKind.NOT_RESTORED, specification=reason))

    # -- applying ----------------------------------------------------------------------------

    def _apply(self, specification: Specification, *, restoring: bool = False) -> SpecificationView:
        lost = list(self._insertions.lost)
        try:
            change = self._understood(specification, restoring=restoring)
            return self._carry_out(change, self._free_names(change))
        except BaseException:
            self._insertions.lost = lost
            raise

    def _understood(self, specification: Specification, *, restoring: bool) -> _Change:
        """The change that a text is; raises `LanguageError`."""
        running = self._running()
        removed = self._removed(specification, running)
        running.leave_out(removed)
        given_up = tuple(one for one in self._insertions.all if self._is_given_up(one, removed))
        elaboration = Elaboration(
            specification.source,
            self._ontology.vocabulary,
            self._transformations,
            self._configuration,
            running,
            removed,
            restoring=restoring,
        )
        made = elaboration.elaborate(specification.insertions)
        change = _Change(specification, running, removed, given_up, made)
        users = Counter(dict.fromkeys(removed, 0))
        users.update(one.unit for one in given_up)
        change = replace(change, gone=leaving(self._configuration, users, change.kept))
        self._check_removed(change)
        return change

    def _carry_out(self, change: _Change, free: dict[Shape, str]) -> SpecificationView:
        inserting = Inserting(
            self._configuration,
            self._plans,
            self._subscriptions,
            self._insertions,
            change.running,
            change.removed,
        )
        given_up = set(change.given_up)
        left = [one for one in self._insertions.all if one not in given_up]
        tops = change.specification.insertions
        stopped = [(unit, unit_view(unit)) for unit in change.gone]
        try:
            inserting.start(change.made, free)
            inserting.name(change.made)
            inserting.hold(change.made, tops, left)
            self._insertions.replace_lost([name for name, _ in change.named])
            self._insertions.keep(self._running())
        except BaseException:
            inserting.undo()
            raise
        for stream in inserting.renamed:
            self._insertions.tell_aliases(stream)
        self._give_up(change)
        units = dict.fromkeys(inserting.units[one.shape] for one in change.made)
        started = inserting.started
        return SpecificationView(
            started=tuple(map(unit_view, started)),
            stopped=tuple(view for unit, view in stopped if not self._runs(unit)),
            there=tuple(unit_view(unit) for unit in units if unit not in started),
            named=tuple(
                (name, inserting.units[one.shape].output.name) for name, one in change.named
            ),
        )

    def _runs(self, unit: ComputationalUnit) -> bool:
        return self._configuration.units.get(unit.output.name) is unit

    def _give_up(self, change: _Change) -> None:
        """Stop what is removed, told by the removal."""
        for one in change.given_up:
            removal = change.removed[one.unit][0]
            with self._configuration.as_specified(None, told(removal)):
                self._configuration.release(one.unit)

    # -- removals ----------------------------------------------------------------------------

    def _removed(
        self, specification: Specification, running: Running
    ) -> dict[ComputationalUnit, list[Removal]]:
        inserted = self._insertions.units(running)
        removed: dict[ComputationalUnit, list[Removal]] = {}
        for removal in specification.removals:
            meant = [unit for unit in inserted if self._is_meant(unit, removal)]
            if not self._insertions.forget_lost(removal) and not meant:
                raise self._nothing_to_remove(specification, removal)
            for unit in meant:
                removed.setdefault(unit, []).append(removal)
        return removed

    def _is_meant(self, unit: ComputationalUnit, removal: Removal) -> bool:
        if removal.name is None:
            return unit.transformation == removal.type
        stream = self._configuration.aliases.get(removal.name, removal.name)
        return unit.output.name == stream or unit.name == removal.name

    def _is_given_up(self, one: Inserted, removed: dict[ComputationalUnit, list[Removal]]) -> bool:
        """Whether a text removes an insertion: its unit, and not by another insertion's name."""
        removals = removed.get(one.unit)
        if removals is None:
            return False
        others = {other.name for other in self._insertions.of(one.unit)} - {one.name}
        return any(removal.name is None or removal.name not in others for removal in removals)

    def _nothing_to_remove(self, specification: Specification, removal: Removal) -> LanguageError:
        there = self._configuration.units.values()
        if any(self._is_meant(unit, removal) for unit in there):
            what = f"`{removal.name}`" if removal.name else f"a unit of `{removal.type}`"
            message = f"no specification inserted {what}"
            hint = "a specification removes what one inserted"
        else:
            what = f"called `{removal.name}`" if removal.name else f"of `{removal.type}`"
            message = f"there is no unit {what}"
            hint = "GET /specifications/current shows those that there are"
        return LanguageError(message, specification.source, removal.span, hint)

    def _check_removed(self, change: _Change) -> None:
        """Nobody else needs what is removed."""
        for unit, removals in change.removed.items():
            if unit in change.gone:
                continue
            needing_it = needing(
                self._configuration,
                unit,
                change.gone,
                self._users,
                lambda one: self._labels(one, change.given_up),
            )
            raise self._needed(change, removals[0], unit, needing_it)
        for unit in change.gone:
            users = used_by_name(self._configuration, unit, self._users)
            if users:
                removals = change.removed.get(unit) or next(iter(change.removed.values()))
                raise self._needed(change, removals[0], unit, users)

    def _needed(
        self, change: _Change, removal: Removal, unit: ComputationalUnit, users: Iterable[str]
    ) -> LanguageError:
        name = removal.name or unit.output.name
        return change.error(
            removal,
            f"`{name}` is needed by {', '.join(users)}",
            "remove these in the same text, or cancel them first",
        )

    def _labels(self, unit: ComputationalUnit, given_up: Sequence[Inserted]) -> tuple[str, ...]:
        return tuple(one.label for one in self._insertions.of(unit) if one not in given_up)

    # -- names -------------------------------------------------------------------------------

    def _free_names(self, change: _Change) -> dict[Shape, str]:
        """The names that streams to be made can have as their own; raises `LanguageError` for one
        that is taken."""
        free: dict[Shape, str] = {}
        for name, one in change.named:
            if self._configuration.has(name):
                self._check_same(change, name, one)
                continue
            try:
                self._check_name(name)
            except Refused as error:
                raise change.error(one, error.detail, error.hint) from error
            free.setdefault(one.shape, name)
        return free

    def _check_same(self, change: _Change, name: str, one: Elaborated) -> None:
        """A name that there is stands for this very unit, or for one that stops."""
        stream = self._configuration.stream(name)
        unit = self._configuration.units.get(stream.name)
        if unit is not None and (unit in change.gone or unit is self._there(change, one)):
            return
        raise change.error(
            one,
            f"there is a stream called `{name}` already",
            "choose another name, or remove that one in the same text"
            if unit is not None and unit in self._insertions.units(change.running)
            else "choose another name",
        )

    def _there(self, change: _Change, one: Elaborated) -> ComputationalUnit | None:
        return change.running.unit_of.get(one.shape)
