"""The configuration: which streams and units there are, and how they are connected
([Introspection15 §3.2]).

The one owner of generators and units. Equal plan nodes are one unit: whoever needs it next
shares it, and it stops when the last user leaves. Every change is told to one listener.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import assert_never

from pyoxigraph import NamedNode

from ..continuous.evaluator import ContinuousEvaluator
from ..converters.objects import ObjectTable
from ..converters.to_samples import ResultConverter
from ..converters.to_triples import SampleConverter
from ..matching.plan import Compute, Node, SelectObject, UseStream, id_field_of
from ..rdf.dictionary import TermDictionary
from ..rdf.namespaces import DYKNOW, shorten
from ..streams.fluent import Retention
from ..streams.generator import StreamGenerator
from ..streams.sample import Field, FieldType, Schema
from ..streams.strings import StringPool
from .errors import AlreadyExists, UnknownStream
from .transformations import Transformation
from .unit import ComputationalUnit, FunctionUnit, InputPort, QueryUnit, SelectionUnit
from .views import Since

SELECT_OBJECT = "selectObject"
"""The transformation that selects one object's samples."""
C_SPARQL = "cSparql"
"""The transformation that evaluates a continuous query ([Events14 §V.B])."""
STATUS = "status"
"""The stream of changes of the stream space ([Introspection15 §3.2])."""
RESERVED = "dyknow_reserved"
"""Names of streams that the system invents begin so (SPEC §5)."""


class ChangeKind(StrEnum):
    """What happened to the stream space."""

    STREAM_ADDED = "stream added"
    STREAM_REMOVED = "stream removed"
    STREAM_ANNOTATED = "stream annotated"
    STREAM_ENDED = "stream ended"
    TRANSFORMATION_ANNOTATED = "transformation annotated"
    UNIT_STARTED = "unit started"
    UNIT_STOPPED = "unit stopped"
    UNIT_FAILED = "unit failed"
    NOT_RESTORED = "not restored"


@dataclass(frozen=True, slots=True)
class Change:
    """One change of the stream space; fields that do not apply are empty.

    ``specification`` is the text by which the change was made: SSL, C-SPARQL, or a
    transformation with its parameters; of a failure, the reason, and so of an annotation kept by
    an earlier run that does not hold any more.
    """

    kind: ChangeKind
    stream: str = ""
    unit: str = ""
    transformation: str = ""
    inputs: tuple[str, ...] = ()
    specification: str = ""


class Configuration:
    """Streams by name, units by the stream they make.

    ``namespaces`` says for a stream in which namespace its id fields name objects.
    """

    def __init__(
        self,
        dictionary: TermDictionary,
        transformations: Mapping[str, Transformation],
        on_change: Callable[[Change], None],
        first_reserved: int = 1,
    ) -> None:
        self.streams: dict[str, StreamGenerator] = {}
        self.units: dict[str, ComputationalUnit] = {}
        self.namespaces: dict[str, str] = {}
        self._dictionary = dictionary
        self._transformations = transformations
        self._on_change = on_change
        self._next_reserved = first_reserved
        self._next_unit = 1
        self._made: dict[tuple[Node, Since], ComputationalUnit] = {}

    def stream(self, name: str) -> StreamGenerator:
        """The generator of stream ``name``; raises `UnknownStream`."""
        found = self.streams.get(name)
        if found is None:
            known = ", ".join(sorted(self.streams)) or "none yet"
            raise UnknownStream(
                f"there is no stream called {name!r}",
                f"declare it with PUT /streams/{name} or annotate it; there are: {known}",
            )
        return found

    def add_stream(
        self,
        name: str,
        schema: Schema,
        *,
        lateness: int = 0,
        retention: Retention | None = None,
        namespace: str = DYKNOW,
        pools: dict[str, StringPool] | None = None,
        specification: str = "",
    ) -> StreamGenerator:
        """A new stream; raises `AlreadyExists`. Text fields get string pools of their own."""
        if name in self.streams:
            raise AlreadyExists(f"there is a stream called {name!r}", "choose another name")
        pools = dict(pools or {})
        for field in schema.fields:
            if field.type is FieldType.STRING:
                pools.setdefault(field.name, StringPool())
        generator = StreamGenerator(
            name, schema, lateness=lateness, retention=retention, pools=pools
        )
        self.streams[name] = generator
        self.namespaces[name] = namespace
        self._on_change(Change(ChangeKind.STREAM_ADDED, name, specification=specification))
        return generator

    def remove_stream(self, name: str) -> None:
        """Forget a stream that no unit makes and none reads."""
        generator = self.streams.pop(name)
        del self.namespaces[name]
        generator.close()
        self._on_change(Change(ChangeKind.STREAM_REMOVED, name))

    def readers(self, name: str) -> tuple[ComputationalUnit, ...]:
        """The units that read stream ``name``."""
        return tuple(
            unit
            for unit in self.units.values()
            if any(source.name == name for source in unit.inputs)
        )

    def reserved_name(self) -> str:
        """The next free ``dyknow_reserved<N>``."""
        while True:
            name = f"{RESERVED}{self._next_reserved}"
            self._next_reserved += 1
            if name not in self.streams:
                return name

    def obtain(self, node: Node, since: Since = Since.NOW) -> StreamGenerator:
        """The stream of a plan node: found if the same is made already, else built.

        What was built runs until `release` has been called for each unit started on it. A unit
        that began with the past is another than one that began with what comes.
        """
        if isinstance(node, UseStream):
            return self.stream(node.stream)
        unit = self._made.get((node, since))
        if unit is None or self.is_broken(unit):
            unit = self._build(node, since)
            self._made[node, since] = unit
        return unit.output

    def start_query(
        self,
        inputs: Sequence[StreamGenerator],
        schema: Schema,
        make: Callable[[StreamGenerator], tuple[ContinuousEvaluator, ResultConverter, str]],
        converters: Mapping[str, Sequence[SampleConverter]],
        since: Since = Since.NOW,
    ) -> QueryUnit:
        """A C-SPARQL unit over ``inputs`` with a new reserved output stream of ``schema``.

        ``make`` is called with the output's generator, for its name and string pools; it gives
        the evaluator, the converter of results, and the query's text.
        """
        output = self._output(schema, DYKNOW, {})
        evaluator, results, text = make(output)
        unit = QueryUnit(
            *self._identity(C_SPARQL, inputs, output, {"query": text}),
            evaluator=evaluator,
            converters=converters,
            results=results,
        )
        self._start(unit, since, text)
        return unit

    def release(self, unit: ComputationalUnit) -> None:
        """One user less; the unit stops with its last one, and so do its inputs in turn."""
        unit.users -= 1
        if unit.users > 0:
            return
        unit.stop()
        del self.units[unit.output.name]
        for key in [key for key, made in self._made.items() if made is unit]:
            del self._made[key]
        self._tell(ChangeKind.UNIT_STOPPED, unit)
        self.remove_stream(unit.output.name)
        for source in unit.inputs:
            producer = self.units.get(source.name)
            if producer is not None and producer.output is source:
                self.release(producer)

    def units_behind(self, unit: ComputationalUnit) -> tuple[ComputationalUnit, ...]:
        """The units whose samples reach ``unit``, inputs first, and ``unit`` itself, each once."""
        found: dict[ComputationalUnit, None] = {}
        for source in unit.inputs:
            producer = self.units.get(source.name)
            if producer is not None:
                found.update(dict.fromkeys(self.units_behind(producer)))
        found[unit] = None
        return tuple(found)

    def is_stamped(self, generator: StreamGenerator) -> bool | None:
        """Whether the samples were stamped on arrival, here or where they come from; None before
        the first one."""
        unit = self.units.get(generator.name)
        if unit is None:
            return generator.stamped
        known = {self.is_stamped(source) for source in unit.inputs}
        return False if False in known else (True if True in known else None)

    def is_broken(self, unit: ComputationalUnit) -> bool:
        """``unit``, or one whose samples reach it, has failed: nothing more comes of it."""
        return any(part.failure is not None for part in self.units_behind(unit))

    def release_unused(self) -> None:
        """Stop units that were built for a request that then failed."""
        for unit in list(self.units.values()):
            if unit.users == 0 and self.units.get(unit.output.name) is unit:
                unit.users = 1
                self.release(unit)

    def _build(self, node: SelectObject | Compute, since: Since) -> ComputationalUnit:
        match node:
            case SelectObject(source_node, id_field, object):
                return self._select(self.obtain(source_node, since), id_field, object, since)
            case Compute():
                return self._compute(node, since)
            case _:
                assert_never(node)

    def _select(
        self, source: StreamGenerator, id_field: str, object: str, since: Since
    ) -> SelectionUnit:
        namespace = self.namespaces[source.name]
        output = self._output(source.schema, namespace, source.stream.pools)
        parameters = {"field": id_field, "object": shorten(object)}
        objects = ObjectTable(self._dictionary, namespace)
        unit = SelectionUnit(
            *self._identity(SELECT_OBJECT, [source], output, parameters),
            id_field=id_field,
            object_id=self._dictionary.id(NamedNode(object)),
            objects=objects,
        )
        self._start(unit, since)
        return unit

    def _compute(self, node: Compute, since: Since) -> FunctionUnit:
        transformation = self._transformations[node.transformation]
        (edge,) = node.inputs
        source = self.obtain(edge.node, since)
        id_field = id_field_of(edge.node)
        fields = [Field(node.output.field, FieldType.FLOAT)]
        pools = {}
        if id_field is not None:
            id_type = source.schema.get(id_field)
            assert id_type is not None
            fields.insert(0, id_type)
            if id_type.type is FieldType.STRING:
                pools[id_field] = source.stream.pools[id_field]
        output = self._output(Schema(tuple(fields)), self.namespaces[source.name], pools)
        ports = {port.target_field: port for port in edge.ports}
        unit = FunctionUnit(
            *self._identity(transformation.name, [source], output, transformation.parameters),
            function=transformation.implementation.make(transformation.parameters),
            ports=[
                InputPort(ports[port.field].source_field, ports[port.field].conversion)
                for port in transformation.annotation.inputs
            ],
            id_field=id_field,
            output_field=node.output.field,
        )
        self._start(unit, since)
        return unit

    def _output(
        self, schema: Schema, namespace: str, pools: dict[str, StringPool]
    ) -> StreamGenerator:
        return self.add_stream(self.reserved_name(), schema, namespace=namespace, pools=pools)

    def _identity(
        self,
        transformation: str,
        inputs: Sequence[StreamGenerator],
        output: StreamGenerator,
        parameters: Mapping[str, str],
    ) -> tuple[object, ...]:
        name = f"dyknow_cu{self._next_unit}"
        self._next_unit += 1
        return (name, transformation, inputs, output, parameters, self._failed)

    def _start(self, unit: ComputationalUnit, since: Since, specification: str = "") -> None:
        self.units[unit.output.name] = unit
        for source in unit.inputs:
            producer = self.units.get(source.name)
            if producer is not None:
                producer.users += 1
        text = ", ".join(f"{key}={value}" for key, value in unit.parameters.items())
        self._tell(ChangeKind.UNIT_STARTED, unit, specification or f"{unit.transformation}({text})")
        unit.start(since)

    def _failed(self, unit: ComputationalUnit) -> None:
        self._tell(ChangeKind.UNIT_FAILED, unit, unit.failure or "")

    def _tell(self, kind: ChangeKind, unit: ComputationalUnit, specification: str = "") -> None:
        self._on_change(
            Change(
                kind,
                unit.output.name,
                unit.name,
                unit.transformation,
                tuple(source.name for source in unit.inputs),
                specification,
            )
        )
