"""The configuration: the existing streams and units, and their connections
([Introspection15 §3.2]).

It is the only owner of generators and units. Equal plan nodes share one unit, which stops when it
has no users any more. It reports every change to one listener.

The class is long, since a stream and the unit that makes it begin and end together.
"""

from __future__ import annotations

from collections import OrderedDict, defaultdict
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from collections.abc import Set as AbstractSet
from contextlib import contextmanager
from typing import Protocol, TypeVar

from ...languages.kpl import PROCESSES, format_policy
from ...languages.specification.ast import RESERVED, is_reserved
from ...languages.ssl.annotation import StreamAnnotation
from ...rdf.namespaces import DYKNOW
from ...streams.generator import StreamGenerator
from ...streams.history import Retention
from ...streams.sample import FieldType, Schema
from ...streams.stream_rules import Rules
from ...streams.string_pool import StringPool
from ...streams.time import HOUR, TIME_MIN
from ..model.beginning import Beginning
from ..model.errors import AlreadyExists, UnknownStream
from ..model.process_reports import Report
from ..model.status_changes import Change, ChangeKind
from ..model.status_stream import STATUS
from ..model.views import Since
from ..units.backlog import Backlog
from ..units.base import ComputationalUnit
from ..units.late_streams import LateStreams
from ..units.policy import AdaptationUnit, PolicyUnit
from ..units.violations import SUFFIX, Violations
from ..units.work_time import BusyTime

POLICY = "policy"
"""The transformation of a subscription with a policy ([DyKnow10 Def. 5.35])."""
BUILT_IN = (POLICY, *PROCESSES)
"""Transformations of KPL; users cannot take their names."""
SELECT_OBJECT = "selectObject"
"""The transformation that selects one object's samples."""
SELECT_OBJECTS = "selectObjects"
"""The transformation that selects the samples of all objects that requests ask for."""
SYNCHRONIZE = "synchronize"
"""The transformation that joins the values of an object from several streams."""
MERGE = "merge"
"""The transformation that merges several streams of one feature."""
C_SPARQL = "cSparql"
"""The transformation that evaluates a continuous query ([Events14 §V.B])."""
MTL = "mtl"
"""The transformation that evaluates a formula of metric temporal logic ([DyKnow10 §5.4])."""
PATTERN = "pattern"
"""The transformation that finds the matches of a pattern of events ([DyKnow10 §2, §7])."""
SELECT_INSTANCE = "selectInstance"
"""The transformation that selects one query's results from those of a shared evaluation."""
AnyUnit = TypeVar("AnyUnit", bound=ComputationalUnit)
RETENTION = Retention(bytes=256 << 20)
"""The retention of streams that units and annotations make: they declare none."""
_MOST_LISTED = 20
"""The number of streams that an error about an unknown one lists."""
_MOST_REMOVED = 10_000
"""The number of removed streams whose last sequence number is kept."""


class Reader(Protocol):
    """A process without an output stream: a sink, a configuration process."""

    @property
    def name(self) -> str:
        """Its name in the stream space."""

    @property
    def inputs(self) -> tuple[StreamGenerator, ...]:
        """The streams that it reads."""

    def stop(self) -> None:
        """Unsubscribe from the inputs."""


def after_reserved(names: Iterable[str]) -> int:
    """Return the first N after all ``dyknow_reserved<N>`` among ``names``."""
    numbers = (int(name.removeprefix(RESERVED)) for name in names if is_reserved(name))
    return 1 + max(numbers, default=0)


class Configuration:
    """Streams by name, units by the name of their output, readers (units without output) by name.

    ``aliases`` maps further names to streams. ``annotations`` are those of the semantics manager.
    ``namespaces`` has for each stream the namespace of the objects that its id fields name.
    ``statements`` has the streams of RDF, each with the property (IRI) that gives the times of its
    statements; an empty text for none.
    ``system`` are the streams that the system makes without a unit, ``named`` those that have
    their name from a specification.
    """

    def __init__(
        self,
        on_change: Callable[[Change], None],
        first_reserved: int = 1,
        busy_time: BusyTime | None = None,
        backlog: Backlog | None = None,
    ) -> None:
        self.rules = Rules()
        """The version of the semantics, for all streams: replay of an old log needs the old one."""
        self.streams: dict[str, StreamGenerator] = {}
        self.units: dict[str, ComputationalUnit] = {}
        self.readers: dict[str, Reader] = {}
        self.aliases: dict[str, str] = {}
        self.annotations: Mapping[str, StreamAnnotation] = {}
        self.namespaces: dict[str, str] = {}
        self.statements: dict[str, str] = {}
        self.system: set[str] = set()
        self.reports: list[tuple[str, Report]] = []
        """Pending reports of processes, with the names of their streams."""
        self.named: set[str] = set()
        self.late = LateStreams(self._get, self.units, self._add_late)
        """The streams of late samples that were requested."""
        self.before_demand: Callable[[], None] = _allow
        """Called before a stream is made on first request; may raise to refuse it."""
        self.on_opened: Callable[[str], None] = _ignore
        """Called with the name of a stream that was made on first request."""
        self._on_change = on_change
        self._busy_time = busy_time
        self._backlog = Backlog() if backlog is None else backlog
        self._next_reserved = first_reserved
        self._next_unit = 1
        self._removed: OrderedDict[str, int] = OrderedDict()
        """The last sequence numbers of removed streams: a new stream of the same name continues
        after it, so that a client's position never means other samples."""
        self._shared: dict[Hashable, ComputationalUnit] = {}
        self._keys: dict[ComputationalUnit, Hashable] = {}
        self._specified: tuple[str | None, str] = (None, "")

    def __getstate__(self) -> dict[str, object]:
        # The callbacks belong to the process, so a restored engine gets them anew.
        return {**self.__dict__, "on_opened": _ignore, "before_demand": _allow}

    def stream(self, name: str) -> StreamGenerator:
        """Return the generator of ``name``, a stream or an alias. Raises `UnknownStream`."""
        found = self.find(name)
        if found is None:
            names = sorted(self.streams)
            listed = ", ".join(names[:_MOST_LISTED]) + (", …" if len(names) > _MOST_LISTED else "")
            raise UnknownStream(
                f"there is no stream called {name!r}",
                f"declare it (PUT /streams/{name}, client.put_stream) or annotate it; "
                f"there are: {listed or 'none yet'}",
            )
        return found

    def find(self, name: str) -> StreamGenerator | None:
        """Return the generator of ``name``; None if there is none. A stream of violations or late
        samples is made on first request, unless ``before_demand`` raises."""
        found = self._get(name)
        if found is None:
            violations = self._violations_named(name)
            if violations is not None or self.late.is_name(name):
                # Any text may name such a stream, so the service applies its quota of streams here.
                self.before_demand()
            found = self.late.open(name) if violations is None else violations.stream
            if found is not None:
                # A read is no command, so only a record in the log lets a replay make this stream.
                self.on_opened(found.name)
        return found

    def _get(self, name: str) -> StreamGenerator | None:
        return self.streams.get(self.aliases.get(name, name))

    def _add_late(self, name: str, source: StreamGenerator) -> StreamGenerator:
        self.system.add(name)
        return self.add_stream(
            name,
            source.schema,
            retention=source.stream.retention,
            namespace=self.namespaces[source.name],
            pools=source.stream.pools,
        )

    def _violations_named(self, name: str) -> Violations | None:
        """Return the violations whose stream has or would have the name ``name``, if any."""
        unit = self.units.get(name.removesuffix(SUFFIX)) if name.endswith(SUFFIX) else None
        return unit.violations if isinstance(unit, PolicyUnit) else None

    def violations(self, name: str, retention: Retention | None) -> Violations:
        """Make the violations of the policy whose output is stream ``name``."""

        def open() -> StreamGenerator:
            self.system.add(name + SUFFIX)
            return self.add_stream(name + SUFFIX, Schema(()), retention=retention)

        return Violations(open)

    def add_stream(
        self,
        name: str,
        schema: Schema,
        *,
        lateness: int = 0,
        idle: int | None = None,
        ahead: int = HOUR,
        retention: Retention | None = None,
        namespace: str = DYKNOW,
        pools: dict[str, StringPool] | None = None,
        specification: str = "",
        time_property: str | None = None,
    ) -> StreamGenerator:
        """Add a stream. Raises `AlreadyExists`. String fields without a pool in ``pools`` get a new
        one. A schema without fields makes an *open* stream, whose first samples decide its fields.
        ``time_property``: it is a stream of RDF (see `statements`).
        """
        if self.has(name):
            raise AlreadyExists(f"there is a stream called {name!r}", "choose another name")
        pools = dict(pools or {})
        for field in schema.fields:
            if field.type is FieldType.STRING:
                pools.setdefault(field.name, StringPool())
        generator = StreamGenerator(
            name,
            schema,
            lateness=lateness,
            idle=idle,
            ahead=ahead,
            retention=retention or RETENTION,
            pools=pools,
            first=self._removed.pop(name, 0) + 1,
            rules=self.rules,
        )
        self.streams[name] = generator
        self.namespaces[name] = namespace
        if time_property is not None:
            self.statements[name] = time_property
        self._on_change(Change(ChangeKind.STREAM_ADDED, name, specification=specification))
        return generator

    def remove_stream(self, name: str) -> None:
        """Remove a stream that no unit makes or reads, with its streams of late samples."""
        for late in self.late.belonging_to(name):
            self.remove_stream(late)
        if name in self.late:
            self.late.forget(name)
            self.system.discard(name)
        generator = self.streams.pop(name)
        self.named.discard(name)
        del self.namespaces[name]
        self.statements.pop(name, None)
        if not generator.is_ended:
            generator.end()  # tells its followers that there are no more samples
        generator.close()
        # The system gives no reserved name twice, so no client takes its numbers for other samples.
        if generator.stream.last_number and not name.startswith(RESERVED):
            self._removed[name] = generator.stream.last_number
            if len(self._removed) > _MOST_REMOVED:
                self._removed.popitem(last=False)
        self._on_change(Change(ChangeKind.STREAM_REMOVED, name))

    def has(self, name: str) -> bool:
        """Whether there is a stream or an alias of this name."""
        return name in self.streams or name in self.aliases

    def is_made_by_system(self, name: str) -> bool:
        """Whether the system makes stream ``name``, so that users cannot publish to it."""
        return name in self.units or name in self.system or name == STATUS

    def readers_of(self, name: str) -> tuple[str, ...]:
        """Return the names of the units and readers that read stream ``name`` or its streams of
        late samples."""
        streams = {self.streams[each] for each in (name, *self.late.belonging_to(name))}
        processes = (*self.units.values(), *self.readers.values())
        return tuple(one.name for one in processes if not streams.isdisjoint(one.inputs))

    def find_outside_reader(
        self, streams: AbstractSet[str], is_inside: Callable[[ComputationalUnit], bool]
    ) -> tuple[str, str] | None:
        """Find a unit that reads one of ``streams``, makes none of them and is not ``is_inside``;
        return the stream and the unit, None if there is none. The unit of a policy belongs to its
        readers. Cost: O(units)."""
        readers: dict[StreamGenerator, list[ComputationalUnit]] = defaultdict(list)
        for unit in self.units.values():
            for source in unit.sources:
                readers[source].append(unit)
        for name in sorted(streams):
            todo = [self.streams[name]]
            while todo:
                for unit in readers.get(todo.pop(), ()):
                    if unit.output.name in streams or is_inside(unit):
                        continue
                    if unit.transformation != POLICY:
                        return name, unit.name
                    todo.append(unit.output)
        return None

    @contextmanager
    def as_specified(self, name: str | None, specification: str) -> Iterator[None]:
        """Report the changes within this context with this text. The first stream that the system
        makes within it gets ``name``, if not None."""
        self._specified = (name, specification)
        try:
            yield
        finally:
            self._specified = (None, "")

    def reserved_name(self) -> str:
        """Take the next free ``dyknow_reserved<N>``, or the name of `as_specified`."""
        specified, specification = self._specified
        if specified is not None:
            self._specified = (None, specification)
            self.named.add(specified)
            return specified
        while True:
            name = f"{RESERVED}{self._next_reserved}"
            self._next_reserved += 1
            if name not in self.streams:
                return name

    def skip_reserved(self, name: str) -> None:
        """Never return ``name`` as the next free one, since a query or request has it."""
        if self.next_reserved == name:
            self._next_reserved = int(name.removeprefix(RESERVED)) + 1

    @property
    def next_reserved(self) -> str:
        """The next free ``dyknow_reserved<N>``."""
        number = self._next_reserved
        while f"{RESERVED}{number}" in self.streams:
            number += 1
        return f"{RESERVED}{number}"

    def share(self, key: Hashable, build: Callable[[], ComputationalUnit]) -> ComputationalUnit:
        """Return the running unit for ``key``, or a new one from ``build``, which starts it.

        A unit is no longer shared when it stops or fails, or when one of its inputs is removed.
        """
        unit = self.find_shared(key)
        if unit is None:
            unit = build()
            self._shared[key] = unit
            self._keys[unit] = key
        return unit

    def unadapted(self, generator: StreamGenerator) -> StreamGenerator:
        """Return the stream before policies adapt it: the input of the first policy on its way, or
        the stream itself."""
        unit = self.units.get(generator.name)
        while unit is not None and unit.output is generator and unit.transformation == POLICY:
            generator = unit.inputs[0]
            unit = self.units.get(generator.name)
        return generator

    def has_current_inputs(self, unit: ComputationalUnit) -> bool:
        """Whether the inputs of a unit still exist and were not replaced, also the inputs of
        policies and of a shared query before it. A unit that copies its input must also have all
        fields of the input, which may have got more."""
        copies = unit.transformation in (POLICY, SELECT_OBJECT, SELECT_OBJECTS)
        for source in unit.inputs:
            if self.streams.get(source.name) is not source:
                return False
            if copies and source.is_narrow_for(unit):
                return False
            producer = self.units.get(source.name)
            selects = unit.transformation == SELECT_INSTANCE
            if producer is None or not (selects or producer.transformation == POLICY):
                continue
            if not self.has_current_inputs(producer):
                return False
        return True

    def start_query(
        self,
        schema: Schema,
        make: Callable[[StreamGenerator], AnyUnit],
        since: Beginning = Since.NOW,
        name: str | None = None,
    ) -> AnyUnit:
        """Start a unit of a continuous query with a new output stream of ``schema``, which gets
        ``name`` or the next reserved one.

        ``make`` returns the unit for the generator of the output, whose name and string pools it
        uses. The unit's parameter ``query`` is the query's text.
        """
        output = self.add_stream(name or self.reserved_name(), schema)
        try:
            unit = make(output)
        except Exception:
            self.remove_stream(output.name)
            raise
        self.start(unit, since, unit.parameters["query"])
        return unit

    def release(self, unit: ComputationalUnit) -> None:
        """Remove one user of a unit. The unit stops without users, and then releases the units of
        its inputs."""
        unit.users -= 1
        if unit.users <= 0:
            self.remove_unit(unit)

    def remove_unit(self, unit: ComputationalUnit) -> None:
        """Stop a unit even if it has readers: for these their input ends."""
        unit.users = 0
        unit.stop()
        violations = unit.violations if isinstance(unit, PolicyUnit) else None
        if violations is not None and violations.name is not None:
            self.system.discard(violations.name)
            self.remove_stream(violations.name)
        del self.units[unit.output.name]
        key = self._keys.pop(unit, None)
        # `share` may have put another unit under the key, since this one failed or lost an input.
        if key is not None and self._shared.get(key) is unit:
            del self._shared[key]
        self.report_unit(ChangeKind.UNIT_STOPPED, unit, self._specified[1])
        self.remove_stream(unit.output.name)
        self._release_inputs(unit.inputs)

    def attach(self, reader: Reader) -> None:
        """Add a process without output as a user of the units that make its inputs."""
        self.readers[reader.name] = reader
        self._use_inputs(reader.inputs)

    def detach(self, reader: Reader) -> None:
        """Stop a process without output, and release the units of its inputs."""
        reader.stop()
        del self.readers[reader.name]
        self._release_inputs(reader.inputs)

    def upstream_units(self, unit: ComputationalUnit) -> tuple[ComputationalUnit, ...]:
        """Return the units whose samples reach ``unit``, inputs first, then ``unit`` itself; each
        once."""
        found: dict[ComputationalUnit, None] = {}
        self._gather_upstream(unit, found, set())
        return tuple(found)

    def _gather_upstream(
        self,
        unit: ComputationalUnit,
        found: dict[ComputationalUnit, None],
        visited: set[ComputationalUnit],
    ) -> None:
        if unit in visited:
            return
        visited.add(unit)
        for source in unit.inputs:
            producer = self.units.get(source.name)
            if producer is not None:
                self._gather_upstream(producer, found, visited)
        found[unit] = None

    def newest_sample(self, *generators: StreamGenerator) -> int:
        """Return the greatest available time (ns) of the samples in streams and upstream of them;
        `TIME_MIN` if there is none."""
        times = (each.stream.last_available for each in self._with_upstream(generators))
        return max((time for time in times if time is not None), default=TIME_MIN)

    def lateness(self, generator: StreamGenerator) -> int:
        """Return the greatest lateness (ns) of a stream and of those upstream of it."""
        return max(each.lateness for each in self._with_upstream([generator]))

    def _with_upstream(self, generators: Iterable[StreamGenerator]) -> set[StreamGenerator]:
        read = set(generators)
        for generator in tuple(read):
            unit = self.units.get(generator.name)
            for part in () if unit is None else self.upstream_units(unit):
                read.update(part.inputs)
        return read

    def is_stamped(self, generator: StreamGenerator) -> bool | None:
        """Whether the samples, or those that they were computed from, were all stamped on arrival;
        None before the first one."""
        unit = self.units.get(generator.name)
        upstream = () if unit is None else self.upstream_units(unit)
        read = {source for part in upstream for source in part.inputs} or {generator}
        stamped = {self._is_stamped(source) for source in read if source.name not in self.units}
        return False if False in stamped else (True if True in stamped else None)

    def _is_stamped(self, generator: StreamGenerator) -> bool | None:
        if generator.name in self.system and generator.name not in self.late:
            return True
        return generator.stamped

    def is_broken(self, unit: ComputationalUnit) -> bool:
        """Whether ``unit``, or a unit whose samples reach it, has failed."""
        return any(part.failure is not None for part in self.upstream_units(unit))

    def state_of(
        self, unit: ComputationalUnit | None, answer: StreamGenerator
    ) -> tuple[str, str | None]:
        """Return the state of what a request, query or subscription asked for, and why it failed:
        ``failed``, ``ended`` as its ``answer`` has, or ``running``. ``unit`` makes the answer;
        None: it comes from outside."""
        failure = None if unit is None else self.failure_of(unit)
        if failure is not None:
            return "failed", failure
        return ("ended" if answer.is_ended else "running"), None

    def failure_of(self, unit: ComputationalUnit) -> str | None:
        """Return the name and failure of the nearest failed unit, of ``unit`` and the units whose
        samples reach it; None if there is none, so that ``unit`` may have further samples.

        Failures before a merge do not count: an adaptive subscription looks for other sources.
        Cost: O(upstream units).
        """
        todo, visited = [unit], {unit}
        # The list grows during the loop, so the loop visits near units before distant ones.
        for part in todo:
            if part.failure is not None:
                return f"{part.name}: {part.failure}"
            if part.transformation != MERGE:
                producers = (self.units.get(source.name) for source in part.inputs)
                found = [one for one in producers if one is not None and one not in visited]
                visited.update(found)
                todo += found
        return None

    def release_unused(self) -> None:
        """Stop units without users: those of a request that failed while it started."""
        for unit in list(self.units.values()):
            # A removal releases the inputs, so units of the copied list may have stopped already.
            if unit.users == 0 and self.units.get(unit.output.name) is unit:
                self.remove_unit(unit)

    def identity(
        self,
        transformation: str,
        inputs: Sequence[StreamGenerator],
        output: StreamGenerator,
        parameters: Mapping[str, str],
    ) -> tuple[object, ...]:
        """Return the first arguments of every `ComputationalUnit`, with the next free name."""
        return (self.unit_name(), transformation, inputs, output, parameters, self._report_failure)

    def unit_name(self) -> str:
        """Take the next free ``dyknow_cu<N>``."""
        name = f"dyknow_cu{self._next_unit}"
        self._next_unit += 1
        return name

    def start(
        self,
        unit: ComputationalUnit,
        since: Beginning = Since.NOW,
        specification: str = "",
        after: int | None = None,
        until: int | None = None,
    ) -> None:
        """Connect a unit to its inputs, and report it; see `ComputationalUnit.start`."""
        self.units[unit.output.name] = unit
        unit.busy_time, unit.backlog = self._busy_time, self._backlog
        self._use_inputs(unit.inputs)
        text = ", ".join(f"{key}={value}" for key, value in unit.parameters.items())
        specification = self._specified[1] or specification or f"{unit.transformation}({text})"
        # Before the start, since the unit may emit or fail at once.
        self.report_unit(ChangeKind.UNIT_STARTED, unit, specification)
        unit.start(since, after, until)

    def change_inputs(
        self,
        unit: ComputationalUnit,
        gained: Sequence[StreamGenerator],
        lost: Sequence[StreamGenerator],
        specification: str,
    ) -> None:
        """Note the changed inputs of a unit that chooses them itself ([DyKnow10 Def. 4.7])."""
        self._use_inputs(gained)
        self.report_unit(ChangeKind.INPUTS_CHANGED, unit, specification)
        self._release_inputs(lost)

    def add_report(self, stream: str, report: Report) -> None:
        """Add a report of a process to `reports`. The engine applies it later, when all effects of
        the present sample have happened."""
        self.reports.append((stream, report))

    def report_change(self, change: Change) -> None:
        """Report a change of a process that is not a unit."""
        self._on_change(change)

    def report_unit(
        self, kind: ChangeKind, unit: ComputationalUnit, specification: str = ""
    ) -> None:
        """Report a change of a unit."""
        synchronization = unit.synchronization
        self._on_change(
            Change(
                kind,
                unit.output.name,
                unit.name,
                unit.transformation,
                tuple(source.name for source in unit.inputs),
                specification,
                unit.role,
                policy=format_policy(unit.policy) if isinstance(unit, AdaptationUnit) else "",
                synchronization="" if synchronization is None else synchronization.name,
                unsynchronized=tuple(
                    source.name for source in (synchronization.inputs if synchronization else ())
                ),
            )
        )

    def _use_inputs(self, inputs: Sequence[StreamGenerator]) -> None:
        for source in inputs:
            producer = self.units.get(source.name)
            if producer is not None:
                producer.users += 1

    def _release_inputs(self, inputs: Sequence[StreamGenerator]) -> None:
        for source in inputs:
            producer = self.units.get(source.name)
            # Since `remove_unit` another unit may make a stream of this name. It has lost no user.
            if producer is not None and producer.output is source:
                self.release(producer)

    def reserved_stream(
        self, schema: Schema, namespace: str, pools: dict[str, StringPool]
    ) -> StreamGenerator:
        """Add a stream with the next free ``dyknow_reserved<N>``."""
        return self.add_stream(self.reserved_name(), schema, namespace=namespace, pools=pools)

    def is_shared(self, key: Hashable) -> bool:
        """Whether there is a running unit for ``key``; see `share`."""
        return self.find_shared(key) is not None

    def find_shared(self, key: Hashable) -> ComputationalUnit | None:
        """Return the running unit that `share` returns for ``key``, if there is one."""
        unit = self._shared.get(key)
        if unit is None or self.is_broken(unit) or not self.has_current_inputs(unit):
            return None
        return unit

    def key_of(self, unit: ComputationalUnit) -> Hashable | None:
        """Return the key of a running unit; None if it was not made by `share`."""
        return self._keys.get(unit)

    def unshare(self, unit: ComputationalUnit) -> None:
        """Make `share` start another unit for the same key from now on; `share_again` undoes it."""
        key = self._keys.get(unit)
        if key is not None and self._shared.get(key) is unit:
            del self._shared[key]

    def share_again(self, unit: ComputationalUnit) -> None:
        """Undo `unshare`. Contract: `share` has not made another unit for the key since."""
        key = self._keys.get(unit)
        if key is not None:
            self._shared.setdefault(key, unit)

    def _report_failure(self, unit: ComputationalUnit) -> None:
        # A unit that goes on after a window without result has no `failure`.
        reason = unit.failure or unit.counters.last_error or ""
        self.report_unit(ChangeKind.UNIT_FAILED, unit, reason)


def _allow() -> None:
    """Allow every stream on first request."""


def _ignore(_name: str) -> None:
    """Do nothing."""
