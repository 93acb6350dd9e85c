"""Execution of plans: starts a unit for each plan node and annotates its stream
([Introspection15 §4.3]: the result of matching is a specification that is executed).

Equal nodes share one unit, which stops when its last user leaves. The stream of a unit is annotated
like any other stream, so matching finds it.

The file is long because each kind of plan node has its own way to start.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import replace
from typing import assert_never

from ...continuous.columns.budget import UNLIMITED, Budget
from ...converters.objects import ObjectTable
from ...converters.values import field_type
from ...languages.csparql.ast import ContinuousQuery
from ...languages.ssl.annotation import TransformationAnnotation
from ...matching.match import Match, match_all
from ...matching.plan import (
    Compute,
    Detect,
    Edge,
    Node,
    SelectObject,
    SelectObjects,
    Supply,
    Synchronize,
    UseStream,
    annotation_of,
    expanded,
    is_for_some_objects,
    nodes_of,
)
from ...matching.space import StreamSpace
from ...matching.want import Want
from ...ontology.ontology import Ontology
from ...rdf.dictionary import TermDictionary
from ...rdf.namespaces import DYKNOW, shorten
from ...streams.generator import StreamGenerator
from ...streams.past_queries import Moment
from ...streams.sample import Field, FieldType, Schema
from ...streams.string_pool import StringPool
from ...streams.time import TIME_MIN
from ...templates.transformations import EventTransformation
from ..catalog.transformation_library import (
    BuiltIn,
    Transformation,
    Transformations,
)
from ..configuration.configuration import (
    SELECT_OBJECT,
    SELECT_OBJECTS,
    SYNCHRONIZE,
    Configuration,
)
from ..model.beginning import (
    Beginning,
    check_retained,
    existing_streams,
    last_before,
    resolve_duration,
)
from ..model.status_changes import Change, ChangeKind
from ..model.views import Since
from ..processes.registry import SourceImplementation, UnitImplementation
from ..processes.supervision import DIRECT, ProcessEvent, Runner
from ..units.base import ComputationalUnit
from ..units.function import FunctionUnit, InputPort
from ..units.selection import SelectionUnit
from ..units.source import SourceUnit
from ..units.synchronization import SynchronizationUnit, TakenField, schema_of
from ..units.user_transformation import TransformationUnit
from .query_units import Queries
from .reasoning_start import ReasoningStarter
from .unit_shapes import is_implied


class Plans:
    """Starts the units of plans in a configuration. ``runner`` calls user-written code."""

    def __init__(
        self,
        ontology: Ontology,
        dictionary: TermDictionary,
        transformations: Transformations,
        configuration: Configuration,
        space: StreamSpace,
        changed: Callable[[Change], None],
        runner: Runner = DIRECT,
        budget: Budget = UNLIMITED,
    ) -> None:
        self._space = space
        self._ontology = ontology
        self._dictionary = dictionary
        self._transformations = transformations
        self._configuration = configuration
        self._report = changed
        self._runner = runner
        self.queries = Queries(ontology, dictionary, configuration, self.obtain, budget)
        """Starts continuous queries over plans."""
        self.reasoning = ReasoningStarter(ontology, dictionary, configuration, self.obtain)
        """Starts formulas and patterns over plans."""
        self._begins_after: dict[str, int] = {}
        """The last available time before the first sample, for streams of units that began with
        new samples or at a moment."""
        self._may_be_future: set[str] = set()
        """Streams of units that began at a moment which may be in the future."""
        self._complete_since: dict[str, int] = {}
        """The available time from which on nothing was evicted, for streams of units that began
        with the history of their inputs."""
        self._broken: set[str] = set()
        """Streams of units that failed or depend on a failed unit."""
        self._synchronized: set[str] = set()
        """Streams of synchronization units, which matching does not use (`match`)."""
        self._nodes: dict[str, tuple[Node, Beginning]] = {}
        """The node and beginning of each stream that a unit of a plan makes."""
        self._sources: dict[str, SourceUnit] = {}

    def obtain(self, node: Node, since: Beginning = Since.NOW) -> StreamGenerator:
        """Return the stream of a plan node, and start its unit unless an equal one runs.

        The unit runs until each unit that reads it has been released. A unit that began with the
        past is not shared with one that began with new samples. Raises `Forgotten` if the stream
        has evicted samples since the moment ``since``.
        """
        if isinstance(node, UseStream):
            stream = self._configuration.stream(node.stream)
        else:
            begin = _unit_beginning(node, since)
            unit = self._configuration.share((node, begin), lambda: self._build(node, begin))
            stream = unit.output
        check_retained(since, stream.stream)
        return stream

    def tick(self, now: int) -> None:
        """Read the sources that are due at ``now`` (ns)."""
        for source in list(self._sources.values()):
            source.tick(now)

    def makes(self, stream: str) -> bool:
        """Whether a unit of a plan makes the stream."""
        return stream in self._nodes

    def is_running(self, node: Node) -> bool:
        """Whether a unit for ``node`` runs."""
        return any(self._configuration.is_shared((node, since)) for since in Since)

    def is_shared(self, node: Node, since: Beginning) -> bool:
        """Whether a plan that begins with ``since`` would find a unit for ``node``."""
        return self._configuration.is_shared((node, _unit_beginning(node, since)))

    def find_shared(self, key: Hashable) -> ComputationalUnit | None:
        """Return the running unit for ``key`` (`Configuration.share`), if there is one."""
        return self._configuration.find_shared(key)

    def match(
        self,
        wants: Sequence[Want],
        strategy: str,
        without: AbstractSet[str] = frozenset(),
        *,
        explained: bool = False,
    ) -> tuple[Match, ...]:
        """Match ``wants`` with the streams and transformations that exist (`match_all`).

        Streams of synchronization units are left out: they repeat the value of one input when
        another input gets a sample.
        """
        return match_all(
            wants,
            self._space,
            self._ontology.vocabulary,
            strategy,
            without=without | self._synchronized,
            is_running=self.is_running,
            explained=explained,
        )

    def match_from(
        self,
        wants: Sequence[Want],
        strategy: str,
        since: Beginning,
        *,
        explained: bool = False,
    ) -> tuple[Match, ...]:
        """Match ``wants`` (`match`) for a request that begins with ``since``.

        A request that begins now reads streams that have ended only where nothing else gives as
        much: it would get no sample of them, but of a constant stream.
        """
        unusable = self.unusable_streams(since)
        found = self.match(wants, strategy, unusable, explained=explained)
        used = existing_streams(match.supply for match in found if match.supply is not None)
        if since is not Since.NOW or not any(map(self._is_over, used)):
            return found
        over = {name for name in self._space.streams if self._is_over(name)}
        others = self.match(wants, strategy, unusable | over, explained=explained)
        as_much = all(
            other.supply is not None and (other.supply.complete or not one.supply.complete)
            for one, other in zip(found, others, strict=True)
            if one.supply is not None
        )
        return others if as_much else found

    def _is_over(self, stream: str) -> bool:
        generator = self._configuration.stream(stream)
        return generator.is_ended and not generator.is_constant

    def unusable_streams(self, since: Beginning) -> AbstractSet[str]:
        """Streams of plans that another request cannot use: they failed, or began later than
        ``since``."""
        if since is Since.NOW:
            self._may_be_future = {
                name for name in self._may_be_future if self._is_still_to_begin(name)
            }
            return self._broken | self._may_be_future
        late = {name for name, begun in self._begins_after.items() if begun > last_before(since)}
        if isinstance(since, Moment):
            late |= {name for name, time in self._complete_since.items() if time > since.time}
        return self._broken | late

    def resolve_duration(self, since: Beginning, supplies: Iterable[Supply]) -> Beginning:
        """Replace a duration in ``since`` by a time, for a request with the plans ``supplies``."""
        names = existing_streams(supplies) if isinstance(since, Moment) else ()
        return resolve_duration(since, [self._configuration.stream(name).stream for name in names])

    @property
    def streams(self) -> AbstractSet[str]:
        """The streams that units of plans make."""
        return self._nodes.keys()

    def shareable_nodes(self, since: Beginning) -> Mapping[str, Node]:
        """The streams that a plan with this beginning may share, with their nodes. Units with
        parameters of their own are left out, since matching would not choose them."""
        return {
            name: node
            for name, (node, begun) in self._nodes.items()
            if begun == _unit_beginning(node, since)
            and name not in self._broken
            and not any(map(self._is_customized, nodes_of(node)))
        }

    def expand_supplies(self, matches: Sequence[Match]) -> tuple[Supply, ...]:
        """The supplies of the matches, with each stream of a running unit replaced by its node.
        Two requests thus compare equal whether or not an earlier request started the unit."""
        nodes = self.shareable_nodes(Since.NOW)
        supplies = (match.supply for match in matches if match.supply is not None)
        return tuple(expanded(supply, nodes) for supply in supplies)

    def _is_customized(self, node: Node) -> bool:
        """Whether matching would not construct this node by itself."""
        match node:
            case UseStream(stream):
                return stream in self._nodes
            case Compute():
                return bool(node.parameters)
            case _:
                return False

    def on_change(self, change: Change) -> None:
        """Update the records after a change of the stream space. A failed unit makes all units that
        read it unusable."""
        match change.kind:
            case ChangeKind.UNIT_FAILED | ChangeKind.UNIT_STOPPED_BY_RULE:
                units = self._configuration.units
                self._broken = {
                    n for n, unit in units.items() if self._configuration.is_broken(unit)
                }
            case ChangeKind.STREAM_REMOVED:
                self._broken.discard(change.stream)
                self._begins_after.pop(change.stream, None)
                self._may_be_future.discard(change.stream)
                self._complete_since.pop(change.stream, None)
                self._nodes.pop(change.stream, None)
                self._synchronized.discard(change.stream)
                self._sources.pop(change.stream, None)

    def _build(
        self,
        node: SelectObject | SelectObjects | Synchronize | Compute | Detect,
        since: Beginning,
    ) -> ComputationalUnit:
        # A query or formula starts and reports its unit itself.
        if isinstance(node, Detect):
            return self._detect(node, since)
        unit: ComputationalUnit
        match node:
            case SelectObject(source, id_field, object):
                parameters = {"field": id_field, "object": shorten(object)}
                one = self._select(source, since, id_field, SELECT_OBJECT, parameters)
                one.add(object)
                unit = one
            case SelectObjects(source, id_field):
                unit = self._select(source, since, id_field, SELECT_OBJECTS, {"field": id_field})
            case Synchronize():
                unit = self._synchronize(node, since)
            case Compute():
                unit = self._compute(node, since)
            case _:
                assert_never(node)
        self._configuration.start(unit, since)
        # Matching finds the objects of a selection in its source stream. It must not find a stream
        # that lacks objects.
        if not isinstance(node, SelectObject) and not is_for_some_objects(node):
            self._annotate(node, unit, since)
        return unit

    def _detect(self, node: Detect, since: Beginning) -> ComputationalUnit:
        """Start the query of an event template over the streams of its plan."""
        event = self._space.transformations[node.event]
        assert isinstance(event, EventTransformation)
        supplies = [
            Supply(want, (source,), complete=True)
            for want, source in zip(node.wants, node.sources, strict=True)
        ]
        query = event.query(node.subject)
        unit: ComputationalUnit = (
            self.queries.start(query, supplies, since).unit
            if isinstance(query, ContinuousQuery)
            else self.reasoning.start(query, supplies, since)
        )
        self._annotate(node, unit, since)
        return unit

    def _annotate(self, node: Node, unit: ComputationalUnit, since: Beginning) -> None:
        name = unit.output.name
        annotation = annotation_of(node, name)
        self._nodes[name] = (node, since)
        if isinstance(node, Synchronize):
            self._synchronized.add(name)
        if isinstance(unit, SourceUnit):
            self._sources[name] = unit
        match since:
            case Moment():
                self._begins_after[name] = last_before(since)
                self._may_be_future.add(name)
            case Since.NOW:
                lasts = (source.stream.last_available for source in unit.inputs)
                times = (last for last in lasts if last is not None)
                self._begins_after[name] = max(times, default=TIME_MIN)
            case Since.START:
                self._complete_since[name] = max(
                    map(self._history_start, unit.inputs), default=TIME_MIN
                )
        self._report(
            Change(
                ChangeKind.STREAM_ANNOTATED,
                name,
                specification=annotation.source,
                annotation=annotation,
            )
        )

    def _is_still_to_begin(self, name: str) -> bool:
        """Whether all samples of its inputs are before the moment at which the unit begins."""
        unit = self._configuration.units.get(name)
        lasts = () if unit is None else (source.stream.last_available for source in unit.inputs)
        return all(last is None or last <= self._begins_after[name] for last in lasts)

    def _history_start(self, source: StreamGenerator) -> int:
        """The available time (ns) from which on a unit that starts now with the history of
        ``source`` lacks no samples."""
        return max(self._complete_since.get(source.name, TIME_MIN), source.stream.complete_since)

    def _select(
        self,
        node: Node,
        since: Beginning,
        id_field: str,
        transformation: str,
        parameters: Mapping[str, str],
    ) -> SelectionUnit:
        """Make a unit that selects samples of ``node`` by the object that ``id_field`` names."""
        source = self.obtain(node, since)
        namespace = self._configuration.namespaces[source.name]
        # With the pools of its source the output takes samples without encoding their texts again.
        output = self._configuration.reserved_stream(
            source.schema, namespace, dict(source.stream.pools)
        )
        return SelectionUnit(
            *self._configuration.identity(transformation, [source], output, parameters),
            id_field=id_field,
            objects=ObjectTable(self._dictionary, namespace),
            dictionary=self._dictionary,
        )

    def _synchronize(self, node: Synchronize, since: Beginning) -> ComputationalUnit:
        inputs = [self.obtain(edge.node, since) for edge in node.inputs]
        ports = [
            [
                TakenField(port.source_field, port.target_field, port.conversion)
                for port in edge.ports
            ]
            for edge in node.inputs
        ]
        # An input about a single object has no key: its value goes with every object of the others.
        keys = [
            tuple(role.id_field or "" for role in edge.roles if role.object is None)
            for edge in node.inputs
        ]
        first = next((place for place, own in enumerate(keys) if own), None)
        names = () if first is None else keys[first]
        id_fields = tuple(
            (name, role.id_field or "") for name, role in zip(names, node.roles, strict=True)
        )
        schema, pools = schema_of(inputs, ports, keys, id_fields)
        namespaces = self._configuration.namespaces
        namespace = DYKNOW if first is None else namespaces[inputs[first].name]
        output = self._configuration.reserved_stream(schema, namespace, dict(pools))
        return SynchronizationUnit(
            *self._configuration.identity(SYNCHRONIZE, inputs, output, {}),
            ports=ports,
            keys=keys,
            id_fields=id_fields,
            objects=lambda source: ObjectTable(
                self._dictionary, namespaces[source.name], keeps=True
            ),
        )

    # -- computing ---------------------------------------------------------------------------

    def _compute(self, node: Compute, since: Beginning) -> ComputationalUnit:
        registered = self._transformations[node.transformation]
        transformation = replace(
            registered, parameters={**registered.parameters, **dict(node.parameters)}
        )
        source = None
        for edge in node.inputs:
            # There is one edge at most: several streams come as one, from their synchronization.
            source = self.obtain(edge.node, since)
        schema, pools = self._fields_of(node, source)
        namespace = DYKNOW if source is None else self._configuration.namespaces[source.name]
        output = self._configuration.reserved_stream(schema, namespace, pools)
        parameters = dict(self._transformations.parameters_of(transformation))
        inputs = [] if source is None else [source]
        identity = self._configuration.identity(transformation.name, inputs, output, parameters)
        unit = self._unit(node, transformation, identity, parameters)
        if source is not None and isinstance(registered.annotation, TransformationAnnotation):
            fields = [port.field for port in registered.annotation.inputs]
            if is_implied(node.inputs[0], fields):
                unit.synchronization = self._configuration.units[source.name]
        return unit

    def _unit(
        self,
        node: Compute,
        transformation: Transformation,
        identity: tuple[object, ...],
        parameters: dict[str, str],
    ) -> ComputationalUnit:
        implementation = self._transformations.implementation(transformation.implementation)

        def report_event(event: ProcessEvent, text: str) -> None:
            self._configuration.report_unit(ChangeKind(event), unit, text)

        unit: ComputationalUnit
        match implementation:
            case BuiltIn():
                (edge,) = node.inputs
                unit = FunctionUnit(
                    *identity,
                    function=implementation.make(parameters),
                    ports=[port for _, port in self._ports(edge, transformation)],
                    id_fields=edge.id_fields,
                    carried=node.carried,
                    output_field=node.output.field,
                )
            case UnitImplementation():
                (edge,) = node.inputs
                unit = TransformationUnit(
                    *identity,
                    implementation=implementation,
                    parameters=transformation.parameters,
                    ports=self._ports(edge, transformation),
                    id_fields=edge.id_fields,
                    carried=node.carried,
                    on_event=report_event,
                    on_report=self._configuration.add_report,
                    runner=self._runner,
                )
            case SourceImplementation():
                unit = SourceUnit(
                    *identity,
                    implementation=implementation,
                    parameters=dict(transformation.parameters),
                    on_event=report_event,
                    on_report=self._configuration.add_report,
                    runner=self._runner,
                )
            case _:
                assert_never(implementation)
        return unit

    def _ports(self, edge: Edge, transformation: Transformation) -> list[tuple[str, InputPort]]:
        """The port of each input, in the order of the annotation."""
        inputs = getattr(transformation.annotation, "inputs", ())
        ports = {port.target_field: port for port in edge.ports}
        return [
            (port.field, InputPort(ports[port.field].source_field, ports[port.field].conversion))
            for port in inputs
        ]

    def _fields_of(
        self, node: Compute, source: StreamGenerator | None
    ) -> tuple[Schema, dict[str, StringPool]]:
        """The fields of a unit's output: objects of the input, objects that the unit names itself,
        and the value."""
        fields: list[Field] = []
        pools: dict[str, StringPool] = {}
        carried = {output: field for field, output in node.carried}
        for role in node.roles:
            name = role.id_field
            if name is None or name in (field.name for field in fields):
                continue
            if name in carried and source is not None:
                own = source.schema.get(carried[name])
                assert own is not None
                fields.append(Field(name, own.type))
                if own.type is FieldType.STRING:
                    pools[name] = source.stream.pools[own.name]
            else:
                fields.append(Field(name, FieldType.STRING))
        fields.append(Field(node.output.field, self._type_of(node)))
        return Schema(tuple(fields)), pools

    def _type_of(self, node: Compute) -> FieldType:
        implementation = self._transformations[node.transformation].implementation
        if isinstance(self._transformations.implementation(implementation), BuiltIn):
            return FieldType.FLOAT
        info = self._ontology.vocabulary.feature(node.output.feature)
        return field_type(None if info is None else info.range)


def _unit_beginning(node: Node, since: Beginning) -> Beginning:
    """The beginning of a unit for ``node`` in a plan that begins with ``since``."""
    if isinstance(node, Compute) and not node.inputs:
        return Since.NOW  # a source has no past, and one unit reads the sensor for all plans
    return since
