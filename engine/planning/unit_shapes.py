"""The shapes of units: what a specification can say of the running system ([Introspection15 §3.2]).

A shape is a transformation with its parameters, and the shapes or the names of the streams that it
reads. Units of the same shape are the same to a specification, whoever started them: `Running`
reads the shapes of the units that run, `elaboration` makes those that a text speaks of.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import TypeAlias

from ...languages.kpl import format_policy
from ...languages.ssl.annotation import TransformationAnnotation
from ...matching.plan import Compute, Edge, SelectObject, Synchronize
from ...rdf.namespaces import shorten
from ...streams.generator import StreamGenerator
from ...streams.past_queries import Moment
from ...streams.policies.policy import Policy
from ..catalog.transformation_library import Transformation
from ..configuration.configuration import (
    POLICY,
    SELECT_OBJECT,
    SYNCHRONIZE,
    Configuration,
)
from ..configuration.policy_keys import policy_keys
from ..model.views import Since
from ..units.base import ComputationalUnit

LONGEST_ROW = 90
"""So many units may read each other in a row: a text that nests them can still be read."""

Parameters: TypeAlias = tuple[tuple[str, str], ...]


@dataclass(frozen=True, slots=True, eq=False)
class Shape:
    """A unit of ``type``. ``parameters`` are those that differ from the transformation's, by name;
    ``inputs`` are other shapes, or names of streams that no specification can make.

    Shapes of one `Shapes` are equal only if they are the same object: a shape that stands in many
    places would else be compared along every path.
    """

    type: str
    parameters: Parameters
    inputs: tuple[Shape | str, ...]
    row: int
    """How many units read each other in a row, itself included."""
    number: int
    """Of the shapes of one `Shapes`, from 1."""


class Shapes:
    """Makes shapes, each once. Cost: O(inputs) a look-up."""

    def __init__(self) -> None:
        self._made: dict[tuple[str, Parameters, tuple[Shape | str, ...]], Shape] = {}

    def of(self, type: str, parameters: Parameters, inputs: tuple[Shape | str, ...]) -> Shape:
        """The shape; ``parameters`` in any order."""
        key = (type, tuple(sorted(parameters)), inputs)
        found = self._made.get(key)
        if found is None:
            row = 1 + max((one.row for one in inputs if isinstance(one, Shape)), default=0)
            found = self._made[key] = Shape(*key, row, len(self._made) + 1)
        return found


class Running:
    """The shapes of the units that run, as they are now.

    ``shape_of`` has them by the stream that they make, in the order in which they started, and
    those that failed too, and ``stream_of`` the first stream of each; ``unit_of`` has a unit of
    each shape that works. ``implied`` are units that a specification makes without saying so,
    ``unsaid`` those that none can make. Cost: O(units).
    """

    def __init__(
        self, configuration: Configuration, transformations: Mapping[str, Transformation]
    ) -> None:
        self.shapes = Shapes()
        self.shape_of: dict[str, Shape] = {}
        self.stream_of: dict[Shape, str] = {}
        self.unit_of: dict[Shape, ComputationalUnit] = {}
        self.implied: set[ComputationalUnit] = set()
        self.unsaid: list[ComputationalUnit] = []
        self._configuration = configuration
        self._transformations = transformations
        self._broken: set[StreamGenerator] = set()
        said: set[ComputationalUnit] = set()
        for unit in configuration.units.values():
            self._add(unit, said)
        self.implied -= said

    def leave_out(self, units: Iterable[ComputationalUnit]) -> None:
        """Nothing is to be made with ``units``, which are about to stop."""
        for unit in units:
            shape = self.shape_of.get(unit.output.name)
            if shape is not None and self.unit_of.get(shape) is unit:
                del self.unit_of[shape]

    def is_broken(self, unit: ComputationalUnit) -> bool:
        """Whether nothing more comes of a unit."""
        return unit.output in self._broken

    def producer(self, stream: StreamGenerator) -> ComputationalUnit | None:
        """The unit that makes a stream, if a specification can make it."""
        unit = self._configuration.units.get(stream.name)
        known = unit is not None and unit.output is stream and stream.name in self.shape_of
        return unit if known else None

    def behind(self, unit: ComputationalUnit) -> Iterator[ComputationalUnit]:
        """The units that ``unit`` is made from, as far as a specification can make them, and
        itself; each once."""
        seen = {unit}
        todo = [unit]
        while todo:
            last = todo.pop()
            yield last
            for source in last.sources:
                producer = self.producer(source)
                if producer is not None and producer not in seen:
                    seen.add(producer)
                    todo.append(producer)

    def _add(self, unit: ComputationalUnit, said: set[ComputationalUnit]) -> None:
        is_there = all(self._is_there(source) for source in unit.sources)
        if unit.failure is not None or not is_there or not self._broken.isdisjoint(unit.sources):
            self._broken.add(unit.output)
        key = self._configuration.key_of(unit)
        shape = self._shape(unit, key, said) if is_there else None
        if shape is None or shape.row > LONGEST_ROW:
            self.unsaid.append(unit)
            said.update(filter(None, map(self.producer, unit.sources)))
            return
        self.shape_of[unit.output.name] = shape
        self.stream_of.setdefault(shape, unit.output.name)
        if unit.output not in self._broken:
            others = self.unit_of.get(shape)
            if others is None or _since(self._configuration.key_of(others)) is not Since.NOW:
                self.unit_of[shape] = unit

    def _is_there(self, source: StreamGenerator) -> bool:
        return self._configuration.streams.get(source.name) is source

    def _shape(
        self, unit: ComputationalUnit, key: object, said: set[ComputationalUnit]
    ) -> Shape | None:
        match key:
            case (
                StreamGenerator() as source,
                Policy() as policy,
                tuple() as keys,
                Since() | Moment(),
            ):
                if keys != policy_keys(self._configuration, source):
                    # It was made by another annotation or by other rules: a text makes another.
                    return None
                return self._over(unit, POLICY, (("policy", format_policy(policy)),), said)
            case (SelectObject(_, field, object), Since() | Moment()):
                given = (("field", field), ("object", shorten(object)))
                return self._over(unit, SELECT_OBJECT, given, said)
            case (Synchronize(), Since() | Moment()):
                return self._over(unit, SYNCHRONIZE, (), said)
            case (Compute() as node, Since() | Moment()):
                inputs = self._implied_inputs(unit, node)
                if inputs is None:
                    return self._over(unit, node.transformation, node.parameters, said)
                return self.shapes.of(node.transformation, node.parameters, inputs)
            case _:
                return None

    def _over(
        self,
        unit: ComputationalUnit,
        type: str,
        parameters: Parameters,
        said: set[ComputationalUnit],
    ) -> Shape:
        said.update(filter(None, map(self.producer, unit.sources)))
        inputs = tuple(self._input(source) for source in unit.inputs)
        return self.shapes.of(type, parameters, inputs)

    def _input(self, source: StreamGenerator) -> Shape | str:
        return self.shape_of.get(source.name, source.name)

    def _implied_inputs(
        self, unit: ComputationalUnit, node: Compute
    ) -> tuple[Shape | str, ...] | None:
        """What feeds each input of a unit whose inputs are synchronized as a matter of course; None
        for another unit."""
        known = self._transformations.get(node.transformation)
        if known is None or not isinstance(known.annotation, TransformationAnnotation):
            return None
        fields = [port.field for port in known.annotation.inputs]
        if not node.inputs or not is_implied(node.inputs[0], fields):
            return None
        synchronizing = self.producer(unit.inputs[0])
        if synchronizing is None:
            return None
        together = node.inputs[0].node
        assert isinstance(together, Synchronize)
        feeding = {
            port.target_field: self._input(source)
            for edge, source in zip(together.inputs, synchronizing.inputs, strict=True)
            for port in edge.ports
        }
        read = {port.target_field: port.source_field for port in node.inputs[0].ports}
        self.implied.add(synchronizing)
        return tuple(feeding[read[field]] for field in fields)


def is_implied(edge: Edge, fields: list[str]) -> bool:
    """Whether a unit of inputs ``fields`` that takes ``edge`` reads several streams, which are
    brought together for it alone."""
    if not isinstance(edge.node, Synchronize):
        return False
    made = {port.target_field for feed in edge.node.inputs for port in feed.ports}
    read = {port.target_field: port.source_field for port in edge.ports}
    return read.keys() == set(fields) and made == set(read.values()) and made <= set(fields)


def _since(key: object) -> object:
    return key[-1] if isinstance(key, tuple) else None
