"""Applies specifications in XML: inserts and removes units in one change
([Introspection15 §3.2, Listing 1]).

The whole text is checked before any change (`elaboration`, `dependents`). Then new units start
(`insertion_transaction`), and removed units stop last, so that a failure in between can be undone.
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
from ..planning.elaboration import ElaboratedUnit, Elaboration
from ..planning.explanations import unit_view
from ..planning.plan_execution import Plans
from ..planning.unit_shapes import RunningShapes, Shape
from ..requests.subscriptions import Subscriptions
from ..units.base import ComputationalUnit
from .dependents import Users, remaining_users, stopping_units, uncounted_users
from .insertion_transaction import InsertionTransaction
from .insertions import Insertion, Insertions, LostInsertion
from .writer import Writer, comment_text, element_text


@dataclass(frozen=True, slots=True, eq=False)
class _Change:
    """A checked text and its effect on the running units.

    ``removed``: the units that the text removes; ``ended``: the insertions that held them;
    ``elaborated``: the inserted units, inputs first; ``stopping``: the units that stop.
    """

    specification: Specification
    running: RunningShapes
    removed: dict[ComputationalUnit, list[Removal]]
    ended: tuple[Insertion, ...]
    elaborated: tuple[ElaboratedUnit, ...] = ()
    stopping: tuple[ComputationalUnit, ...] = ()

    @property
    def used(self) -> set[ComputationalUnit]:
        """The running units that the text uses."""
        shapes = [shape for one in self.elaborated for shape in (one.shape, *one.shape.inputs)]
        units = self.running.unit_of
        return {units[s] for s in shapes if isinstance(s, Shape) and s in units}

    @property
    def named(self) -> tuple[tuple[str, ElaboratedUnit], ...]:
        """The names in the text, with their units."""
        pairs = ((one.element.name, one) for one in self.elaborated)
        return tuple((name, one) for name, one in pairs if name and not is_reserved(name))

    def error(self, place: Removal | ElaboratedUnit, message: str, hint: str) -> LanguageError:
        """Make an error at an element of the text."""
        span = place.span if isinstance(place, Removal) else place.element.span
        return LanguageError(message, self.specification.source, span, hint)


class Specifications:
    """Applies specifications to the configuration.

    ``check_name`` raises `Refused` for reserved names; ``users`` returns the users of a unit and of
    its stream.
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
        self._report = changed
        self._check_name = check_name
        self._users = users
        self._insertions = Insertions(ontology, configuration, changed)

    # -- public methods ----------------------------------------------------------------------

    def apply(self, specification: Specification) -> SpecificationView:
        """Insert and remove all units of a text, or none.

        Units of the same shape that run already are shared. Raises `LanguageError` with the place
        of the error. Cost: O(running units + elements of the text), and starting the units.
        """
        return self._apply(specification)

    def current(self) -> str:
        """Write the running configuration as a specification. A comment lists failed units and
        units that no specification can express.

        Law: applied to another engine with the same streams, transformations and ontology, it
        yields an engine with the same text except for reserved names. Applied to this engine it
        starts and stops nothing.
        """
        running = self._running_shapes()
        names = self._insertions.names(running)
        tops = self._tops(running, names)
        elements = Writer(names, running.stream_of.__getitem__).write(tops)
        text = format_specification(Specification(elements, (), ""))
        first, _, rest = text.partition("\n")
        return f"{first}\n{comment_text(running, self._configuration)}{rest}"

    def __len__(self) -> int:
        """The number of insertions."""
        return len(self._insertions.all)

    def views(self) -> tuple[InsertionView, ...]:
        """The insertions in order, then those that were not restored."""
        return self._insertions.views(self._running_shapes())

    def on_change(self, change: Change) -> None:
        """Drop the names of a removed stream."""
        self._insertions.on_change(change)

    def restore(self) -> None:
        """Insert the stored insertions again. Those that are not valid any more are reported on
        the status stream and stay stored."""
        kept = self._ontology.registered.specifications()
        if not kept:
            return
        try:
            specification = parse_specification(kept)
        except LanguageError as error:
            self._report_not_restored(f"{error}\n{kept}")
            return
        left = list(specification.insertions)
        while left:
            try:
                self._apply(replace(specification, insertions=tuple(left)), restoring=True)
                return
            except LanguageError as error:
                # The insertion that contains the error: the last one that starts before it.
                failed = [one for one in left if one.span.start <= error.span.start][-1:]
                reason = str(error)
            except Exception as error:  # noqa: BLE001  the engine starts without, and reports it
                failed, reason = left, f"{type(error).__name__}: {error}"
            left = [one for one in left if not any(one is other for other in failed)]
            for element in failed:
                self._insertions.lost.append(LostInsertion(element, reason))
                self._report_not_restored(f"{reason}\n{element_text(element)}")

    # -- running units -----------------------------------------------------------------------

    def _running_shapes(self) -> RunningShapes:
        return RunningShapes(self._configuration, self._transformations)

    def _tops(
        self, running: RunningShapes, names: dict[Shape, list[str]]
    ) -> tuple[tuple[Shape, str | None], ...]:
        """The shapes that are top elements of the text, with their names: those that were inserted
        so, and those without readers."""
        inserted_names: dict[Shape, dict[str | None, None]] = {}
        for one in self._insertions.all:
            shape = running.shape_of.get(one.unit.output.name)
            if shape in running.unit_of:
                inserted_names.setdefault(shape, {})[one.name] = None
        expressed = {s for s, unit in running.unit_of.items() if unit not in running.implied}
        expressed |= inserted_names.keys()
        read = {below for shape in expressed for below in shape.inputs}
        tops: list[tuple[Shape, str | None]] = []
        for shape in running.unit_of:
            if shape in inserted_names:
                tops += [(shape, name) for name in inserted_names[shape]]
            elif shape in expressed and shape not in read:
                tops.append((shape, next(iter(names.get(shape, ())), None)))
        return tuple(tops)

    def _report_not_restored(self, reason: str) -> None:
        self._report(Change(ChangeKind.NOT_RESTORED, specification=reason))

    # -- applying ----------------------------------------------------------------------------

    def _apply(self, specification: Specification, *, restoring: bool = False) -> SpecificationView:
        # The check already drops the lost insertions that the text removes, and may fail later.
        lost = list(self._insertions.lost)
        try:
            change = self._check(specification, restoring=restoring)
            return self._execute(change, self._free_names(change))
        except BaseException:
            self._insertions.lost = lost
            raise

    def _check(self, specification: Specification, *, restoring: bool) -> _Change:
        """Check a text and return its change. Raises `LanguageError`."""
        running = self._running_shapes()
        removed = self._units_to_remove(specification, running)
        # The same text may insert a unit of this shape, and then a new one starts.
        running.exclude(removed)
        ended = tuple(one for one in self._insertions.all if self._is_removed(one, removed))
        elaboration = Elaboration(
            specification.source,
            self._ontology.vocabulary,
            self._transformations,
            self._configuration,
            running,
            removed,
            restoring=restoring,
        )
        elaborated = elaboration.elaborate(specification.insertions)
        change = _Change(specification, running, removed, ended, elaborated)
        users = Counter(dict.fromkeys(removed, 0))
        users.update(one.unit for one in ended)
        change = replace(change, stopping=stopping_units(self._configuration, users, change.used))
        self._check_removed(change)
        return change

    def _execute(self, change: _Change, free: dict[Shape, str]) -> SpecificationView:
        transaction = InsertionTransaction(
            self._configuration,
            self._plans,
            self._subscriptions,
            self._insertions,
            change.running,
            change.removed,
        )
        ended = set(change.ended)
        left = [one for one in self._insertions.all if one not in ended]
        tops = change.specification.insertions
        stopped = [(unit, unit_view(unit)) for unit in change.stopping]
        try:
            transaction.start(change.elaborated, free)
            transaction.name(change.elaborated)
            transaction.replace_insertions(change.elaborated, tops, left)
            self._insertions.replace_lost([name for name, _ in change.named])
            self._insertions.store(self._running_shapes())
        except BaseException:
            transaction.undo()
            raise
        for stream in transaction.renamed:
            self._insertions.report_aliases(stream)
        self._stop_removed(change)
        units = dict.fromkeys(transaction.units[one.shape] for one in change.elaborated)
        started, running = transaction.started, self._configuration.units
        return SpecificationView(
            started=tuple(map(unit_view, started)),
            stopped=tuple(
                view for unit, view in stopped if running.get(unit.output.name) is not unit
            ),
            there=tuple(unit_view(unit) for unit in units if unit not in started),
            named=tuple(
                (name, transaction.units[one.shape].output.name) for name, one in change.named
            ),
        )

    def _stop_removed(self, change: _Change) -> None:
        """Stop the removed units; the status stream reports the removal as the cause."""
        for one in change.ended:
            removal = change.removed[one.unit][0]
            with self._configuration.as_specified(None, element_text(removal)):
                self._configuration.release(one.unit)

    # -- removals ----------------------------------------------------------------------------

    def _units_to_remove(
        self, specification: Specification, running: RunningShapes
    ) -> dict[ComputationalUnit, list[Removal]]:
        inserted = self._insertions.units(running)
        removed: dict[ComputationalUnit, list[Removal]] = {}
        for removal in specification.removals:
            meant = [unit for unit in inserted if self._is_named_by(unit, removal)]
            if not self._insertions.forget_lost(removal) and not meant:
                raise self._nothing_to_remove(specification, removal)
            for unit in meant:
                removed.setdefault(unit, []).append(removal)
        return removed

    def _is_named_by(self, unit: ComputationalUnit, removal: Removal) -> bool:
        if removal.name is None:
            return unit.transformation == removal.type
        stream = self._configuration.aliases.get(removal.name, removal.name)
        return unit.output.name == stream or unit.name == removal.name

    def _is_removed(self, one: Insertion, removed: dict[ComputationalUnit, list[Removal]]) -> bool:
        """Whether a text removes an insertion. A removal by the name of another insertion of the
        same unit does not."""
        removals = removed.get(one.unit)
        if removals is None:
            return False
        others = {other.name for other in self._insertions.of(one.unit)} - {one.name}
        return any(removal.name is None or removal.name not in others for removal in removals)

    def _nothing_to_remove(self, specification: Specification, removal: Removal) -> LanguageError:
        there = self._configuration.units.values()
        if any(self._is_named_by(unit, removal) for unit in there):
            what = f"`{removal.name}`" if removal.name else f"a unit of `{removal.type}`"
            message = f"no specification inserted {what}"
            hint = "a specification can remove only units that one inserted"
        else:
            what = f"called `{removal.name}`" if removal.name else f"of `{removal.type}`"
            message = f"there is no unit {what}"
            hint = "GET /specifications/current lists the units"
        return LanguageError(message, specification.source, removal.span, hint)

    def users_of(self, readers: Iterable[str]) -> tuple[str, ...]:
        """Return the requests, queries, subscriptions and so on that need the units and readers of
        these names; a unit itself that nothing else needs."""
        units = {unit.name: unit for unit in self._configuration.units.values()}
        found: dict[str, None] = {}
        for name in readers:
            users = self._users(name, "")
            if name in units:
                users = remaining_users(
                    self._configuration,
                    units[name],
                    (),
                    self._users,
                    lambda one: self._labels(one, ()),
                )
            found.update(dict.fromkeys(users or (name,)))
        return tuple(found)

    def _check_removed(self, change: _Change) -> None:
        """Raise `LanguageError` if a removed unit has other users."""
        for unit, removals in change.removed.items():
            if unit in change.stopping:
                continue
            needed_by = remaining_users(
                self._configuration,
                unit,
                change.stopping,
                self._users,
                lambda one: self._labels(one, change.ended),
            )
            raise self._needed_error(change, removals[0], unit, needed_by)
        for unit in change.stopping:
            users = uncounted_users(self._configuration, unit, self._users)
            if users:
                removals = change.removed.get(unit) or next(iter(change.removed.values()))
                raise self._needed_error(change, removals[0], unit, users)

    def _needed_error(
        self, change: _Change, removal: Removal, unit: ComputationalUnit, users: Iterable[str]
    ) -> LanguageError:
        name = removal.name or unit.output.name
        return change.error(
            removal,
            f"`{name}` is needed by {', '.join(users)}",
            "remove these in the same text, or cancel them first",
        )

    def _labels(self, unit: ComputationalUnit, ended: Sequence[Insertion]) -> tuple[str, ...]:
        return tuple(one.label for one in self._insertions.of(unit) if one not in ended)

    # -- names -------------------------------------------------------------------------------

    def _free_names(self, change: _Change) -> dict[Shape, str]:
        """Return the names that new streams can have. Raises `LanguageError` for a name in use."""
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

    def _check_same(self, change: _Change, name: str, one: ElaboratedUnit) -> None:
        """Raise `LanguageError` unless an existing name belongs to this unit, or to one that
        stops."""
        stream = self._configuration.stream(name)
        unit = self._configuration.units.get(stream.name)
        if unit is not None and (
            unit in change.stopping or unit is change.running.unit_of.get(one.shape)
        ):
            return
        raise change.error(
            one,
            f"there is a stream called `{name}` already",
            "choose another name, or remove that one in the same text"
            if unit is not None and unit in self._insertions.units(change.running)
            else "choose another name",
        )
