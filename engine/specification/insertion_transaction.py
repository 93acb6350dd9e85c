"""Starts the units of a specification, with undo ([Introspection15 §3.2])."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

from ...languages.specification import UnitSpecification
from ...languages.specification.ast import is_reserved
from ...matching.plan import Compute, Node, SelectObject, Synchronize, UseStream
from ...streams.generator import StreamGenerator
from ...streams.policies.policy import Policy
from ..configuration.configuration import Configuration
from ..configuration.policy_keys import policy_keys
from ..model.views import Since
from ..planning.elaboration import ElaboratedUnit
from ..planning.plan_execution import Plans
from ..planning.unit_shapes import RunningShapes, Shape
from ..planning.wiring import bind_recipe
from ..requests.subscriptions import Subscriptions
from ..units.base import ComputationalUnit
from .insertions import Insertion, Insertions
from .writer import element_text


class InsertionTransaction:
    """The insertion of one text. ``units`` has a unit of each shape that runs.

    Contract: the text was checked. If a step fails all the same, the caller calls `undo`.
    """

    def __init__(
        self,
        configuration: Configuration,
        plans: Plans,
        subscriptions: Subscriptions,
        insertions: Insertions,
        running: RunningShapes,
        removed: Collection[ComputationalUnit],
    ) -> None:
        self.units: dict[Shape, ComputationalUnit] = dict(running.unit_of)
        self._configuration = configuration
        self._plans = plans
        self._subscriptions = subscriptions
        self._insertions = insertions
        self._removed = tuple(removed)
        self._before = list(insertions.all)
        self._running_before = set(configuration.units.values())
        self._added: list[ComputationalUnit] = []
        self._aliases: list[tuple[str, str | None]] = []
        self._alias_elements: list[UnitSpecification] = []

    @property
    def started(self) -> tuple[ComputationalUnit, ...]:
        """The units that it started, inputs first."""
        units = self._configuration.units.values()
        return tuple(unit for unit in units if unit not in self._running_before)

    @property
    def renamed(self) -> tuple[str, ...]:
        """The streams that got an alias."""
        streams = (self._configuration.aliases[alias] for alias, _ in self._aliases)
        return tuple(dict.fromkeys(streams))

    def start(self, elaborated: Sequence[ElaboratedUnit], free: Mapping[Shape, str]) -> None:
        """Start the units that do not run, inputs first, without sharing removed units. ``free``:
        the names for new streams."""
        for unit in self._removed:
            self._configuration.unshare(unit)
        for one in elaborated:
            if one.shape not in self.units:
                text = element_text(one.element)
                stream = self._stream(one, free.get(one.shape), text)
                self.units[one.shape] = self._configuration.units[stream.name]

    def name(self, elaborated: Sequence[ElaboratedUnit]) -> None:
        """Name the streams; a stream with another name gets an alias."""
        for one in elaborated:
            name = one.element.name
            stream = self.units[one.shape].output.name
            if name is None or is_reserved(name) or name == stream:
                continue
            before = self._configuration.aliases.get(name)
            if before != stream:
                if not is_reserved(stream) or self._insertions.has_alias(stream):
                    self._alias_elements.append(one.element)
                self._insertions.give_alias(name, stream)
                self._aliases.append((name, before))

    def replace_insertions(
        self,
        elaborated: Sequence[ElaboratedUnit],
        tops: Sequence[UnitSpecification],
        left: Sequence[Insertion],
    ) -> None:
        """Replace the insertions by those ``left``, the ``tops``, and the elements that gave an
        alias. An element equal to an existing insertion, by unit and name, adds none; an unnamed
        one adds none to a unit that has an insertion."""
        shapes = {id(one.element): one.shape for one in elaborated}
        now = list(left)
        of_unit: dict[ComputationalUnit, list[Insertion]] = {}
        for one in left:
            of_unit.setdefault(one.unit, []).append(one)
        inner = [one for one in self._alias_elements if not any(one is top for top in tops)]
        for element in (*tops, *inner):
            unit = self.units[shapes[id(element)]]
            named = element.name is not None and not is_reserved(element.name)
            one = Insertion(element.name if named else None, unit, element)
            there = of_unit.setdefault(unit, [])
            if any(other.name == one.name for other in there) or (there and not named):
                continue
            nameless = next((other for other in there if other.name is None), None)
            # The text only adds a name, so the unit gets no further user.
            if nameless is not None:
                now[now.index(nameless)] = there[there.index(nameless)] = one
                continue
            unit.users += 1
            self._added.append(unit)
            there.append(one)
            now.append(one)
        self._insertions.all = now

    def undo(self) -> None:
        """Restore the insertions, names and units from before."""
        self._insertions.all = self._before
        # An alias may change twice, and its first entry has the stream from before the text.
        for alias, before in reversed(self._aliases):
            self._insertions.take_alias(alias, before)
        for unit in self._added:
            unit.users -= 1
        self._configuration.release_unused()
        for unit in self._removed:
            self._configuration.share_again(unit)

    def _stream(self, one: ElaboratedUnit, name: str | None, text: str) -> StreamGenerator:
        recipe = one.piece.recipe
        configuration = self._configuration
        if isinstance(recipe, Policy):
            (source,) = one.shape.inputs
            with configuration.as_specified(name, text):
                generator = (
                    configuration.stream(source)
                    if isinstance(source, str)
                    else self.units[source].output
                )
                keys = policy_keys(configuration, generator)
                return self._subscriptions.obtain(generator, recipe, Since.NOW, keys).output
        assert recipe is not None
        shapes = {
            f"#{below.number}": below for below in one.shape.inputs if not isinstance(below, str)
        }
        node = bind_recipe(recipe, lambda stand_in: self._node(stand_in, shapes))
        if isinstance(node, Compute):
            for edge in node.inputs:
                # The implied synchronization has no name; its start is reported with this text.
                if isinstance(edge.node, Synchronize):
                    with configuration.as_specified(None, text):
                        self._plans.obtain(edge.node)
        with configuration.as_specified(name, text):
            return self._plans.obtain(node)

    def _node(self, stand_in: UseStream, shapes: Mapping[str, Shape]) -> Node:
        """Return the node of a running unit, so that matching shares it. For an explicit
        synchronization, and for streams without a unit, return the stream: matching makes neither.
        """
        shape = shapes.get(stand_in.stream)
        if shape is None:
            return stand_in
        unit = self.units[shape]
        match self._configuration.key_of(unit):
            case (Compute() | SelectObject() as node, Since.NOW):
                return node
            case _:
                return UseStream(unit.output.name, stand_in.contents)
