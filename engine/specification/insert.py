"""Starting what a specification inserts, so that it can be undone ([Introspection15 §3.2])."""

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
from ..planning.elaboration import Elaborated
from ..planning.plan_execution import Plans
from ..planning.unit_shapes import Running, Shape
from ..planning.wiring import bound
from ..requests.subscriptions import Subscriptions
from ..units.base import ComputationalUnit
from .insertions import Inserted, Insertions
from .serialize import told


class Inserting:
    """The insertions of one text on their way. ``units`` has a unit of each shape that runs.

    Contract: everything was checked. Whoever finds that something fails all the same calls `undo`.
    """

    def __init__(
        self,
        configuration: Configuration,
        plans: Plans,
        subscriptions: Subscriptions,
        insertions: Insertions,
        running: Running,
        removed: Collection[ComputationalUnit],
    ) -> None:
        self.units: dict[Shape, ComputationalUnit] = dict(running.unit_of)
        self._configuration = configuration
        self._plans = plans
        self._subscriptions = subscriptions
        self._insertions = insertions
        self._removed = tuple(removed)
        self._before = list(insertions.all)
        self._there = set(configuration.units.values())
        self._added: list[ComputationalUnit] = []
        self._aliases: list[tuple[str, str | None]] = []
        self._further: list[UnitSpecification] = []

    @property
    def started(self) -> tuple[ComputationalUnit, ...]:
        """The units that were started, inputs first."""
        units = self._configuration.units.values()
        return tuple(unit for unit in units if unit not in self._there)

    @property
    def renamed(self) -> tuple[str, ...]:
        """The streams that were given a further name."""
        streams = (self._configuration.aliases[alias] for alias, _ in self._aliases)
        return tuple(dict.fromkeys(streams))

    def start(self, made: Sequence[Elaborated], free: Mapping[Shape, str]) -> None:
        """Start what does not run, inputs first, and nothing with what is removed. ``free`` are
        names that streams can have."""
        for unit in self._removed:
            self._configuration.unshare(unit)
        for one in made:
            if one.shape not in self.units:
                text = told(one.element)
                stream = self._stream(one, free.get(one.shape), text)
                self.units[one.shape] = self._configuration.units[stream.name]

    def name(self, made: Sequence[Elaborated]) -> None:
        """Give the streams their names; those that have another one a further one."""
        for one in made:
            name = one.element.name
            stream = self.units[one.shape].output.name
            if name is None or is_reserved(name) or name == stream:
                continue
            before = self._configuration.aliases.get(name)
            if before != stream:
                if not is_reserved(stream) or self._insertions.has_alias(stream):
                    self._further.append(one.element)
                self._insertions.give_alias(name, stream)
                self._aliases.append((name, before))

    def hold(
        self,
        made: Sequence[Elaborated],
        tops: Sequence[UnitSpecification],
        left: Sequence[Inserted],
    ) -> None:
        """The insertions from now on: those that are ``left``, ``tops``, and what gave a unit a
        further name. One that is there already, under the same name or without one, is the
        same."""
        shapes = {id(one.element): one.shape for one in made}
        now = list(left)
        of_unit: dict[ComputationalUnit, list[Inserted]] = {}
        for one in left:
            of_unit.setdefault(one.unit, []).append(one)
        inner = [one for one in self._further if not any(one is top for top in tops)]
        for element in (*tops, *inner):
            unit = self.units[shapes[id(element)]]
            named = element.name is not None and not is_reserved(element.name)
            one = Inserted(element.name if named else None, unit, element)
            there = of_unit.setdefault(unit, [])
            if any(known.name == one.name for known in there) or (there and not named):
                continue
            nameless = next((known for known in there if known.name is None), None)
            if nameless is not None:
                now[now.index(nameless)] = there[there.index(nameless)] = one
                continue
            unit.users += 1
            self._added.append(unit)
            there.append(one)
            now.append(one)
        self._insertions.all = now

    def undo(self) -> None:
        """Everything as it was."""
        self._insertions.all = self._before
        for alias, before in reversed(self._aliases):
            self._insertions.take_alias(alias, before)
        for unit in self._added:
            unit.users -= 1
        self._configuration.release_unused()
        for unit in self._removed:
            self._configuration.share_again(unit)

    def _stream(self, one: Elaborated, name: str | None, text: str) -> StreamGenerator:
        recipe = one.piece.recipe
        configuration = self._configuration
        if isinstance(recipe, Policy):
            (source,) = one.shape.inputs
            with configuration.as_specified(name, text):
                generator = self._generator(source)
                keys = policy_keys(configuration, generator)
                return self._subscriptions.obtain(generator, recipe, Since.NOW, keys).output
        assert recipe is not None
        shapes = {
            f"#{below.number}": below for below in one.shape.inputs if not isinstance(below, str)
        }
        node = bound(recipe, lambda stand_in: self._node(stand_in, shapes))
        if isinstance(node, Compute):
            for edge in node.inputs:
                # What brings several inputs together has no name; it is told by the same text.
                if isinstance(edge.node, Synchronize):
                    with configuration.as_specified(None, text):
                        self._plans.obtain(edge.node)
        with configuration.as_specified(name, text):
            return self._plans.obtain(node)

    def _generator(self, source: Shape | str) -> StreamGenerator:
        if isinstance(source, str):
            return self._configuration.stream(source)
        return self.units[source].output

    def _node(self, stand_in: UseStream, shapes: Mapping[str, Shape]) -> Node:
        """The node of a unit that runs, which matching would have, too; of another stream, and of
        what somebody brought together by name, the stream."""
        shape = shapes.get(stand_in.stream)
        if shape is None:
            return stand_in
        unit = self.units[shape]
        match self._configuration.key_of(unit):
            case (Compute() | SelectObject() as node, Since.NOW):
                return node
            case _:
                return UseStream(unit.output.name, stand_in.contents)
