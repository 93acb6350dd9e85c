"""The shapes of units, by which a specification identifies running units ([Introspection15 §3.2]).

A shape is a transformation with its parameters and the shapes, or names, of its input streams. To a
specification units of one shape are equal, whether a request or a text started them.
`RunningShapes` has the shapes of the units that run; `elaboration` makes those of a text.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import TypeAlias

from ...languages.kpl import format_policy
from ...languages.ssl.annotation import TransformationAnnotation
from ...matching.plan import Compute, Edge, SelectObject, Synchronize, is_for_some_objects
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

MAX_CHAIN = 90
"""The longest chain of units that read each other. A text that nests them can still be parsed."""

Parameters: TypeAlias = tuple[tuple[str, str], ...]


@dataclass(frozen=True, slots=True, eq=False)
class Shape:
    """The shape of a unit of transformation ``type``. ``parameters`` are those that differ from the
    transformation's own; ``inputs`` are shapes, or names of streams that no specification can make.

    Shapes of one `Shapes` compare by identity: a comparison by value would follow every path to a
    shape that several units share.
    """

    type: str
    parameters: Parameters
    inputs: tuple[Shape | str, ...]
    chain: int
    """The length of the longest chain of units that ends with it."""
    number: int
    """Its number in its `Shapes`, from 1."""


class Shapes:
    """Makes each shape once. Cost: O(inputs) a look-up."""

    def __init__(self) -> None:
        self._made: dict[tuple[str, Parameters, tuple[Shape | str, ...]], Shape] = {}

    def of(self, type: str, parameters: Parameters, inputs: tuple[Shape | str, ...]) -> Shape:
        """Return the shape; ``parameters`` may be in any order."""
        key = (type, tuple(sorted(parameters)), inputs)
        shape = self._made.get(key)
        if shape is None:
            chain = 1 + max((one.chain for one in inputs if isinstance(one, Shape)), default=0)
            shape = self._made[key] = Shape(*key, chain, len(self._made) + 1)
        return shape


class RunningShapes:
    """The shapes of the units that run, as they are now. Cost: O(units).

    ``shape_of`` has the shapes by output stream in the order of starting, failed units included;
    ``stream_of`` has the first stream of each shape; ``unit_of`` has a working unit of each.
    ``implied`` are units that a specification starts without naming them (synchronization before a
    unit of several inputs); ``inexpressible`` are units that no specification can start.
    """

    def __init__(
        self, configuration: Configuration, transformations: Mapping[str, Transformation]
    ) -> None:
        self.shapes = Shapes()
        self.shape_of: dict[str, Shape] = {}
        self.stream_of: dict[Shape, str] = {}
        self.unit_of: dict[Shape, ComputationalUnit] = {}
        self.implied: set[ComputationalUnit] = set()
        self.inexpressible: list[ComputationalUnit] = []
        self._configuration = configuration
        self._transformations = transformations
        self._broken: set[StreamGenerator] = set()
        named: set[ComputationalUnit] = set()
        # Units are in the order of starting, so an input has its shape before its readers.
        for unit in configuration.units.values():
            self._add(unit, named)
        # A unit that some reader names has to be in a text, even if another reader implies it.
        self.implied -= named

    def exclude(self, units: Iterable[ComputationalUnit]) -> None:
        """Remove ``units``, which are about to stop, from ``unit_of``."""
        for unit in units:
            shape = self.shape_of.get(unit.output.name)
            if shape is not None and self.unit_of.get(shape) is unit:
                del self.unit_of[shape]

    def is_broken(self, unit: ComputationalUnit) -> bool:
        """Whether a unit, or one that it depends on, has failed or lost an input."""
        return unit.output in self._broken

    def producer(self, stream: StreamGenerator) -> ComputationalUnit | None:
        """Return the unit that makes a stream, if a specification can express it."""
        unit = self._configuration.units.get(stream.name)
        is_expressible = unit is not None and unit.output is stream and stream.name in self.shape_of
        return unit if is_expressible else None

    def upstream(self, unit: ComputationalUnit) -> Iterator[ComputationalUnit]:
        """Yield ``unit`` and the units that it depends on and a specification can express; each
        once."""
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

    def _add(self, unit: ComputationalUnit, named: set[ComputationalUnit]) -> None:
        streams = self._configuration.streams
        exists = all(streams.get(source.name) is source for source in unit.sources)
        if unit.failure is not None or not exists or not self._broken.isdisjoint(unit.sources):
            self._broken.add(unit.output)
        key = self._configuration.key_of(unit)
        shape = self._shape(unit, key, named) if exists else None
        if shape is None or shape.chain > MAX_CHAIN:
            self.inexpressible.append(unit)
            named.update(filter(None, map(self.producer, unit.sources)))
            return
        self.shape_of[unit.output.name] = shape
        self.stream_of.setdefault(shape, unit.output.name)
        if unit.output not in self._broken:
            other = self.unit_of.get(shape)
            key = None if other is None else self._configuration.key_of(other)
            # A unit that began with new samples is the one that a text would start.
            if not isinstance(key, tuple) or key[-1] is not Since.NOW:
                self.unit_of[shape] = unit

    def _shape(
        self, unit: ComputationalUnit, key: object, named: set[ComputationalUnit]
    ) -> Shape | None:
        match key:
            case (
                StreamGenerator() as source,
                Policy() as policy,
                tuple() as keys,
                Since() | Moment(),
            ):
                if keys != policy_keys(self._configuration, source):
                    # The annotation or the rules have changed since: a text would start another.
                    return None
                return self._shape_over(unit, POLICY, (("policy", format_policy(policy)),), named)
            case (SelectObject(_, field, object), Since() | Moment()):
                parameters = (("field", field), ("object", shorten(object)))
                return self._shape_over(unit, SELECT_OBJECT, parameters, named)
            # A specification cannot write a selection whose objects come and go with requests.
            case (Compute() | Synchronize() as node, _) if is_for_some_objects(node):
                return None
            case (Synchronize(), Since() | Moment()):
                return self._shape_over(unit, SYNCHRONIZE, (), named)
            case (Compute() as node, Since() | Moment()):
                inputs = self._implied_inputs(unit, node)
                if inputs is None:
                    return self._shape_over(unit, node.transformation, node.parameters, named)
                return self.shapes.of(node.transformation, node.parameters, inputs)
            case _:
                return None

    def _shape_over(
        self,
        unit: ComputationalUnit,
        type: str,
        parameters: Parameters,
        named: set[ComputationalUnit],
    ) -> Shape:
        named.update(filter(None, map(self.producer, unit.sources)))
        inputs = tuple(self._input(source) for source in unit.inputs)
        return self.shapes.of(type, parameters, inputs)

    def _input(self, source: StreamGenerator) -> Shape | str:
        return self.shape_of.get(source.name, source.name)

    def _implied_inputs(
        self, unit: ComputationalUnit, node: Compute
    ) -> tuple[Shape | str, ...] | None:
        """Return the streams behind the implied synchronization of a unit's inputs, one for each
        input; None for a unit without one."""
        transformation = self._transformations.get(node.transformation)
        if transformation is None or not isinstance(
            transformation.annotation, TransformationAnnotation
        ):
            return None
        fields = [port.field for port in transformation.annotation.inputs]
        if not node.inputs or not is_implied(node.inputs[0], fields):
            return None
        synchronizing = self.producer(unit.inputs[0])
        if synchronizing is None:
            return None
        synchronize = node.inputs[0].node
        assert isinstance(synchronize, Synchronize)
        feeding = {
            port.target_field: self._input(source)
            for edge, source in zip(synchronize.inputs, synchronizing.inputs, strict=True)
            for port in edge.ports
        }
        read = {port.target_field: port.source_field for port in node.inputs[0].ports}
        self.implied.add(synchronizing)
        return tuple(feeding[read[field]] for field in fields)


def is_implied(edge: Edge, fields: list[str]) -> bool:
    """Whether ``edge`` synchronizes several streams for the one unit with inputs ``fields``."""
    if not isinstance(edge.node, Synchronize):
        return False
    synchronized = {port.target_field for feed in edge.node.inputs for port in feed.ports}
    read = {port.target_field: port.source_field for port in edge.ports}
    return (
        read.keys() == set(fields)
        and synchronized == set(read.values())
        and synchronized <= set(fields)
    )
