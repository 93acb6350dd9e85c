"""Carrying out plans: the units of plan nodes, and what their streams mean
([Introspection15 §4.3]: the result of matching is a specification that is executed).

Equal nodes are one unit: whoever needs it next shares it, and it stops when the last user leaves.
What a unit computes is annotated like any other stream, so that matching finds it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import replace
from typing import assert_never

from pyoxigraph import NamedNode

from ...continuous.columns.budget import UNLIMITED, Budget
from ...converters.objects import ObjectTable
from ...converters.values import field_type
from ...languages.ssl.annotation import TransformationAnnotation
from ...matching.match import Match, match_all
from ...matching.plan import (
    Compute,
    Detect,
    Edge,
    Node,
    SelectObject,
    Supply,
    Synchronize,
    UseStream,
    annotation_of,
    expanded,
    nodes_of,
)
from ...matching.space import StreamSpace
from ...matching.want import Want
from ...ontology.ontology import Ontology
from ...rdf.dictionary import Named, TermDictionary
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
    SYNCHRONIZE,
    Configuration,
)
from ..model.beginning import (
    Beginning,
    check_kept,
    last_before,
    names_read,
    settled,
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
from .unit_shapes import is_implied


class Plans:
    """Starts the units that plans ask for, in a configuration.

    ``runner`` calls user-written code.
    """

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
        self._changed = changed
        self._runner = runner
        self.queries = Queries(ontology, dictionary, configuration, self.obtain, budget)
        """Starts continuous queries over plans."""
        self._begun: dict[str, int] = {}
        """Streams of units that began with what came or at a moment, and the last available time
        before."""
        self._future: set[str] = set()
        """Streams of units that began at a moment which may be still to come."""
        self._complete: dict[str, int] = {}
        """Streams of units that began with all that was kept, and the available time from which
        nothing of that had been forgotten."""
        self._broken: set[str] = set()
        self._tuples: set[str] = set()
        """The streams of inputs that were synchronized."""
        self._made: dict[str, tuple[Node, Beginning]] = {}
        """The streams that units of plans make, and of which nodes they were made."""
        self._sources: dict[str, SourceUnit] = {}

    def obtain(self, node: Node, since: Beginning = Since.NOW) -> StreamGenerator:
        """The stream of a plan node: found if the same is made already, else built.

        What was built runs until `release` has been called for each unit started on it. A unit
        that began with the past is another than one that began with what comes. Raises `Forgotten`
        where the stream does not keep all from the moment ``since`` on.
        """
        found = self._obtained(node, _begun(node, since))
        check_kept(since, found.stream)
        return found

    def _obtained(self, node: Node, since: Beginning) -> StreamGenerator:
        if isinstance(node, UseStream):
            return self._configuration.stream(node.stream)
        return self._configuration.share((node, since), lambda: self._build(node, since)).output

    def tick(self, now: int) -> None:
        """The time is ``now`` (ns): read the sources that are due."""
        for source in list(self._sources.values()):
            source.tick(now)

    def makes(self, stream: str) -> bool:
        """Whether a unit of a plan makes the stream."""
        return stream in self._made

    def is_running(self, node: Node) -> bool:
        """Whether there is a unit for ``node`` already."""
        return any(self._configuration.is_shared((node, since)) for since in Since)

    def is_shared(self, node: Node, since: Beginning) -> bool:
        """Whether a plan that begins with ``since`` would find a unit for ``node``."""
        return self._configuration.is_shared((node, _begun(node, since)))

    def match(
        self,
        wants: Sequence[Want],
        strategy: str,
        without: AbstractSet[str] = frozenset(),
        *,
        explained: bool = False,
    ) -> tuple[Match, ...]:
        """Semantic matching over what there is; see `match_all`. Not over the tuples of inputs
        that were synchronized: they say again what one input said when another one speaks."""
        return match_all(
            wants,
            self._space,
            self._ontology.vocabulary,
            strategy,
            without=without | self._tuples,
            is_running=self.is_running,
            explained=explained,
        )

    def unusable(self, since: Beginning) -> AbstractSet[str]:
        """Streams of plans that answer no other request: no more comes of them, or they began later
        than ``since``."""
        if since is Since.NOW:
            self._future = {name for name in self._future if self._is_to_begin(name)}
            return self._broken | self._future
        late = {name for name, begun in self._begun.items() if begun > last_before(since)}
        if isinstance(since, Moment):
            late |= {name for name, time in self._complete.items() if time > since.time}
        return self._broken | late

    def settled(self, since: Beginning, supplies: Iterable[Supply]) -> Beginning:
        """``since`` for a request with the plans ``supplies``, with a time for a duration."""
        names = names_read(supplies) if isinstance(since, Moment) else ()
        return settled(since, [self._configuration.stream(name).stream for name in names])

    @property
    def made(self) -> AbstractSet[str]:
        """The streams that units of plans make."""
        return self._made.keys()

    def shared(self, since: Beginning) -> Mapping[str, Node]:
        """The streams of units that a plan may share which begins with ``since``, and what they
        are made from: streams from outside and sources, by nothing else than transformations as
        they were registered."""
        return {
            name: node
            for name, (node, begun) in self._made.items()
            if begun == _begun(node, since)
            and name not in self._broken
            and not any(map(self._is_particular, nodes_of(node)))
        }

    def made_from(self, matches: Sequence[Match]) -> tuple[Supply, ...]:
        """What the matches found, with what makes a stream instead of the stream: whether it has
        been made for somebody already is no difference between those who ask."""
        made = self.shared(Since.NOW)
        found = (match.supply for match in matches if match.supply is not None)
        return tuple(expanded(supply, made) for supply in found)

    def _is_particular(self, node: Node) -> bool:
        """Whether matching would not come to it by itself, with all that it is made from."""
        match node:
            case UseStream(stream):
                return stream in self._made
            case Compute():
                return bool(node.parameters)
            case _:
                return False

    def heard(self, change: Change) -> None:
        """The stream space has changed: a unit that fails takes those with it that read it."""
        match change.kind:
            case ChangeKind.UNIT_FAILED | ChangeKind.UNIT_STOPPED_BY_RULE:
                units = self._configuration.units
                self._broken = {
                    n for n, unit in units.items() if self._configuration.is_broken(unit)
                }
            case ChangeKind.STREAM_REMOVED:
                self._broken.discard(change.stream)
                self._begun.pop(change.stream, None)
                self._future.discard(change.stream)
                self._complete.pop(change.stream, None)
                self._made.pop(change.stream, None)
                self._tuples.discard(change.stream)
                self._sources.pop(change.stream, None)

    def _build(
        self, node: SelectObject | Synchronize | Compute | Detect, since: Beginning
    ) -> ComputationalUnit:
        if isinstance(node, Detect):
            return self._detect(node, since)
        unit: ComputationalUnit
        match node:
            case SelectObject(source, id_field, object):
                unit = self._select(self.obtain(source, since), id_field, object)
            case Synchronize():
                unit = self._synchronize(node, since)
            case Compute():
                unit = self._compute(node, since)
            case _:
                assert_never(node)
        self._configuration.start(unit, since)
        if not isinstance(node, SelectObject):  # its objects stand in the stream it is made of
            self._tell_meaning(node, unit, since)
        return unit

    def _detect(self, node: Detect, since: Beginning) -> ComputationalUnit:
        """The query of an event template, over what its plan says."""
        event = self._space.transformations[node.event]
        assert isinstance(event, EventTransformation)
        supplies = [
            Supply(want, (source,), complete=True)
            for want, source in zip(node.wants, node.sources, strict=True)
        ]
        unit = self.queries.start(event.query(node.subject), supplies, since).unit
        self._tell_meaning(node, unit, since)
        return unit

    def _tell_meaning(self, node: Node, unit: ComputationalUnit, since: Beginning) -> None:
        name = unit.output.name
        annotation = annotation_of(node, name)
        self._made[name] = (node, since)
        if isinstance(node, Synchronize):
            self._tuples.add(name)
        if isinstance(unit, SourceUnit):
            self._sources[name] = unit
        match since:
            case Moment():
                self._begun[name] = last_before(since)
                self._future.add(name)
            case Since.NOW:
                lasts = (source.stream.last_available for source in unit.inputs)
                known = (last for last in lasts if last is not None)
                self._begun[name] = max(known, default=TIME_MIN)
            case Since.START:
                self._complete[name] = max(map(self._complete_from, unit.inputs), default=TIME_MIN)
        self._changed(
            Change(
                ChangeKind.STREAM_ANNOTATED,
                name,
                specification=annotation.source,
                annotation=annotation,
            )
        )

    def _is_to_begin(self, name: str) -> bool:
        """Whether all that its inputs have said is before the moment at which a unit begins."""
        unit = self._configuration.units.get(name)
        lasts = () if unit is None else (source.stream.last_available for source in unit.inputs)
        return all(last is None or last <= self._begun[name] for last in lasts)

    def _complete_from(self, source: StreamGenerator) -> int:
        """The available time (ns) from which a unit that begins with the past of ``source`` now
        lacks nothing."""
        oldest = source.stream.first_available
        if oldest is None or source.stream.forgotten_valid is None:
            oldest = TIME_MIN
        return max(self._complete.get(source.name, TIME_MIN), oldest)

    def _select(self, source: StreamGenerator, id_field: str, object: str) -> ComputationalUnit:
        namespace = self._configuration.namespaces[source.name]
        output = self._configuration.reserved_stream(
            source.schema, namespace, dict(source.stream.pools)
        )
        parameters = {"field": id_field, "object": shorten(object)}
        return SelectionUnit(
            *self._configuration.identity(SELECT_OBJECT, [source], output, parameters),
            id_field=id_field,
            object=Named(self._dictionary, [NamedNode(object)]),
            objects=ObjectTable(self._dictionary, namespace),
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
        # What an input holds of a single object stands for every object of the others.
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
        known = self._transformations[node.transformation]
        transformation = replace(known, parameters={**known.parameters, **dict(node.parameters)})
        source = None
        for edge in node.inputs:
            source = self.obtain(edge.node, since)
        schema, pools = self._fields_of(node, source)
        namespace = DYKNOW if source is None else self._configuration.namespaces[source.name]
        output = self._configuration.reserved_stream(schema, namespace, pools)
        parameters = dict(self._transformations.parameters_of(transformation))
        inputs = [] if source is None else [source]
        identity = self._configuration.identity(transformation.name, inputs, output, parameters)
        unit = self._unit(node, transformation, identity, parameters)
        if source is not None and isinstance(known.annotation, TransformationAnnotation):
            fields = [port.field for port in known.annotation.inputs]
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

        def told(event: ProcessEvent, text: str) -> None:
            self._configuration.tell(ChangeKind(event), unit, text)

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
                    on_event=told,
                    on_report=self._configuration.report,
                    runner=self._runner,
                )
            case SourceImplementation():
                unit = SourceUnit(
                    *identity,
                    implementation=implementation,
                    parameters=dict(transformation.parameters),
                    on_event=told,
                    on_report=self._configuration.report,
                    runner=self._runner,
                )
            case _:
                assert_never(implementation)
        return unit

    def _ports(self, edge: Edge, transformation: Transformation) -> list[tuple[str, InputPort]]:
        """What feeds each input, in the order of the annotation."""
        inputs = getattr(transformation.annotation, "inputs", ())
        ports = {port.target_field: port for port in edge.ports}
        return [
            (port.field, InputPort(ports[port.field].source_field, ports[port.field].conversion))
            for port in inputs
        ]

    def _fields_of(
        self, node: Compute, source: StreamGenerator | None
    ) -> tuple[Schema, dict[str, StringPool]]:
        """The fields of a unit's output: the objects that pass through, those that it names
        itself, and the value."""
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


def _begun(node: Node, since: Beginning) -> Beginning:
    """What a unit for ``node`` begins with, where its plan begins with ``since``."""
    if isinstance(node, Compute) and not node.inputs:
        return Since.NOW  # it has no past to begin with, and a sensor is read once
    return since
