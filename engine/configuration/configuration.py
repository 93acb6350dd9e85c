"""The configuration: which streams and units there are, and how they are connected
([Introspection15 §3.2]).

The one owner of generators and units. Equal plan nodes are one unit: whoever needs it next
shares it, and it stops when the last user leaves. Every change is told to one listener.
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
from ...streams.time import HOUR
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
"""Transformations of KPL; nothing else is called so."""
SELECT_OBJECT = "selectObject"
"""The transformation that selects one object's samples."""
SYNCHRONIZE = "synchronize"
"""The transformation that brings several streams' values of an object together."""
MERGE = "merge"
"""The transformation that brings what several streams hold of a feature into one."""
C_SPARQL = "cSparql"
"""The transformation that evaluates a continuous query ([Events14 §V.B])."""
SELECT_INSTANCE = "selectInstance"
"""The transformation that selects a query's results from those of the queries that share one."""
AnyUnit = TypeVar("AnyUnit", bound=ComputationalUnit)
RETENTION = Retention(bytes=256 << 20)
"""What a stream keeps of which nobody has said how much: units and annotations made it."""
_NAMED = 20
"""So many streams are listed when an unknown one is asked for."""
_REMEMBERED = 10_000
"""Of so many removed streams it is known how far their numbers went."""


class Reader(Protocol):
    """A process that reads streams and makes none: a sink, a configuration process."""

    @property
    def name(self) -> str:
        """What it is called in the stream space."""

    @property
    def inputs(self) -> tuple[StreamGenerator, ...]:
        """The streams that it reads."""

    def stop(self) -> None:
        """Leave the inputs."""


def after_reserved(names: Iterable[str]) -> int:
    """The first N after all ``dyknow_reserved<N>`` among ``names``."""
    numbers = (int(name.removeprefix(RESERVED)) for name in names if is_reserved(name))
    return 1 + max(numbers, default=0)


class Configuration:
    """Streams by name, units by the stream they make, readers (units without output) by name.

    ``aliases`` are further names of streams. ``annotations`` say what streams contain; the
    semantics manager keeps them. ``namespaces`` says for a stream in which namespace its id fields
    name objects. ``system`` names streams that the system makes without a unit, ``named`` those
    that were specified by name.
    """

    def __init__(
        self,
        on_change: Callable[[Change], None],
        first_reserved: int = 1,
        busy_time: BusyTime | None = None,
        backlog: Backlog | None = None,
    ) -> None:
        self.rules = Rules()
        """Those of all its streams."""
        self.streams: dict[str, StreamGenerator] = {}
        self.units: dict[str, ComputationalUnit] = {}
        self.readers: dict[str, Reader] = {}
        self.aliases: dict[str, str] = {}
        self.annotations: Mapping[str, StreamAnnotation] = {}
        self.namespaces: dict[str, str] = {}
        self.system: set[str] = set()
        self.reports: list[tuple[str, Report]] = []
        """What processes have said of their streams, and nobody has read yet."""
        self.named: set[str] = set()
        self.late = LateStreams(self._there, self.units, self._add_late)
        """The streams of late samples that somebody asked for."""
        self.before_demand: Callable[[], None] = _no_objection
        """Called before a stream is made because somebody asks for it; may raise."""
        self.on_opened: Callable[[str], None] = _unheard
        """Told of a stream that came into being by being asked for."""
        self._on_change = on_change
        self._busy_time = busy_time
        self._backlog = Backlog() if backlog is None else backlog
        self._next_reserved = first_reserved
        self._next_unit = 1
        self._removed: OrderedDict[str, int] = OrderedDict()
        """The last numbers of streams that were removed: one of the same name continues there."""
        self._shared: dict[Hashable, ComputationalUnit] = {}
        self._keys: dict[ComputationalUnit, Hashable] = {}
        self._specified: tuple[str | None, str] = (None, "")

    def __getstate__(self) -> dict[str, object]:
        return {**self.__dict__, "on_opened": _unheard, "before_demand": _no_objection}

    def stream(self, name: str) -> StreamGenerator:
        """The generator of ``name``, a stream or an alias of one; raises `UnknownStream`."""
        found = self.find(name)
        if found is None:
            names = sorted(self.streams)
            known = ", ".join(names[:_NAMED]) + (", …" if len(names) > _NAMED else "")
            known = known or "none yet"
            raise UnknownStream(
                f"there is no stream called {name!r}",
                f"declare it with PUT /streams/{name} or annotate it; there are: {known}",
            )
        return found

    def find(self, name: str) -> StreamGenerator | None:
        """The same; None if there is no such stream. One of violations or of late samples comes
        into being by being asked for, if ``before_demand`` does not object."""
        found = self._there(name)
        if found is None:
            if self._violating(name) is not None or self.late.is_name(name):
                self.before_demand()
            found = self._violations_of(name) or self.late.open(name)
            if found is not None:
                self.on_opened(found.name)
        return found

    def _there(self, name: str) -> StreamGenerator | None:
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

    def _violations_of(self, name: str) -> StreamGenerator | None:
        """Somebody asks for the violations of a policy that has none yet."""
        violations = self._violating(name)
        return None if violations is None else violations.stream

    def _violating(self, name: str) -> Violations | None:
        """Whose stream would be called ``name``, if that of violations is meant."""
        unit = self.units.get(name.removesuffix(SUFFIX)) if name.endswith(SUFFIX) else None
        return unit.violations if isinstance(unit, PolicyUnit) else None

    def violations(self, name: str, retention: Retention | None) -> Violations:
        """Where the unit that makes stream ``name`` tells what its policy refused."""

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
    ) -> StreamGenerator:
        """A new stream; raises `AlreadyExists`. Text fields get string pools of their own. A
        schema without fields makes an *open* stream, whose first samples decide its fields."""
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
        self._on_change(Change(ChangeKind.STREAM_ADDED, name, specification=specification))
        return generator

    def remove_stream(self, name: str) -> None:
        """Forget a stream that no unit makes and none reads, and what came too late for it."""
        for late in self.late.belonging_to(name):
            self.remove_stream(late)
        if name in self.late:
            self.late.forget(name)
            self.system.discard(name)
        generator = self.streams.pop(name)
        self.named.discard(name)
        del self.namespaces[name]
        if not generator.is_ended:
            generator.end()  # whoever follows it hears that nothing more comes
        generator.close()
        if generator.stream.last_number and not name.startswith(RESERVED):
            self._removed[name] = generator.stream.last_number
            if len(self._removed) > _REMEMBERED:
                self._removed.popitem(last=False)
        self._on_change(Change(ChangeKind.STREAM_REMOVED, name))

    def has(self, name: str) -> bool:
        """Whether there is a stream of this name, or an alias."""
        return name in self.streams or name in self.aliases

    def is_made(self, name: str) -> bool:
        """Whether the system makes stream ``name``: nobody publishes to it."""
        return name in self.units or name in self.system or name == STATUS

    def readers_of(self, name: str) -> tuple[str, ...]:
        """The names of the units and readers that read stream ``name``, or what came too late for
        it."""
        streams = {self.streams[each] for each in (name, *self.late.belonging_to(name))}
        everybody = (*self.units.values(), *self.readers.values())
        return tuple(one.name for one in everybody if not streams.isdisjoint(one.inputs))

    def readers_outside(
        self, streams: AbstractSet[str], are_ours: Callable[[ComputationalUnit], bool]
    ) -> tuple[str, str] | None:
        """A unit that reads one of ``streams``, makes none of them and is not ours, after the
        stream; None if there is none. A policy's unit is its readers'. Cost: O(units)."""
        readers: dict[StreamGenerator, list[ComputationalUnit]] = defaultdict(list)
        for unit in self.units.values():
            for source in unit.sources:
                readers[source].append(unit)
        for name in sorted(streams):
            todo = [self.streams[name]]
            while todo:
                for unit in readers.get(todo.pop(), ()):
                    if unit.output.name in streams or are_ours(unit):
                        continue
                    if unit.transformation != POLICY:
                        return name, unit.name
                    todo.append(unit.output)
        return None

    @contextmanager
    def as_specified(self, name: str | None, specification: str) -> Iterator[None]:
        """What starts or stops meanwhile does so by this text; the first stream that the system
        makes is called ``name``, if it is given."""
        self._specified = (name, specification)
        try:
            yield
        finally:
            self._specified = (None, "")

    def reserved_name(self) -> str:
        """The next free ``dyknow_reserved<N>``, or the name that somebody specified."""
        given, specification = self._specified
        if given is not None:
            self._specified = (None, specification)
            self.named.add(given)
            return given
        while True:
            name = f"{RESERVED}{self._next_reserved}"
            self._next_reserved += 1
            if name not in self.streams:
                return name

    def pass_over(self, name: str) -> None:
        """``name`` is given to somebody: if it is the next free one, another is from now on."""
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
        """The running unit that was built for ``key``, or a new one: who wants the same shares it.

        ``build`` starts the unit; it is forgotten when it stops, and not shared once it failed or
        one of its inputs was removed.
        """
        unit = self.shared(key)
        if unit is None:
            unit = build()
            self._shared[key] = unit
            self._keys[unit] = key
        return unit

    def life_of(self, generator: StreamGenerator) -> StreamGenerator:
        """The stream itself, or the one behind a policy."""
        unit = self.units.get(generator.name)
        while unit is not None and unit.output is generator and unit.transformation == POLICY:
            generator = unit.inputs[0]
            unit = self.units.get(generator.name)
        return generator

    def reads_what_is_there(self, unit: ComputationalUnit) -> bool:
        """Whether its inputs are the streams of their names still, behind policies too, and behind
        a query that it shares; and a unit that copies its input has all of its fields."""
        copies = unit.transformation in (POLICY, SELECT_OBJECT)
        for source in unit.inputs:
            if self.streams.get(source.name) is not source:
                return False
            if copies and source.is_narrow_for(unit):
                return False
            producer = self.units.get(source.name)
            is_part = unit.transformation == SELECT_INSTANCE
            if producer is None or not (is_part or producer.transformation == POLICY):
                continue
            if not self.reads_what_is_there(producer):
                return False
        return True

    def start_query(
        self,
        schema: Schema,
        make: Callable[[StreamGenerator], AnyUnit],
        since: Beginning = Since.NOW,
        name: str | None = None,
    ) -> AnyUnit:
        """A unit of a continuous query with a new output stream of ``schema``, called ``name`` or
        by the next reserved one.

        ``make`` is called with the output's generator, for its name and string pools; it gives the
        unit, whose parameter ``query`` is the query's text.
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
        """One user less; the unit stops with its last one, and so do its inputs in turn."""
        unit.users -= 1
        if unit.users <= 0:
            self.remove_unit(unit)

    def remove_unit(self, unit: ComputationalUnit) -> None:
        """Stop a unit, whoever reads it: its readers are told that their input has ended."""
        unit.users = 0
        unit.stop()
        violations = unit.violations if isinstance(unit, PolicyUnit) else None
        if violations is not None and violations.name is not None:
            self.system.discard(violations.name)
            self.remove_stream(violations.name)
        del self.units[unit.output.name]
        key = self._keys.pop(unit, None)
        if key is not None and self._shared.get(key) is unit:
            del self._shared[key]
        self.tell(ChangeKind.UNIT_STOPPED, unit, self._specified[1])
        self.remove_stream(unit.output.name)
        self._leave(unit.inputs)

    def attach(self, reader: Reader) -> None:
        """A process without output begins: the units that make its inputs have one user more."""
        self.readers[reader.name] = reader
        self._use(reader.inputs)

    def detach(self, reader: Reader) -> None:
        """A process without output ends, and with it what nobody else needs."""
        reader.stop()
        del self.readers[reader.name]
        self._leave(reader.inputs)

    def units_behind(self, unit: ComputationalUnit) -> tuple[ComputationalUnit, ...]:
        """The units whose samples reach ``unit``, inputs first, and ``unit`` itself, each once."""
        found: dict[ComputationalUnit, None] = {}
        self._gather(unit, found, set())
        return tuple(found)

    def _gather(
        self,
        unit: ComputationalUnit,
        found: dict[ComputationalUnit, None],
        seen: set[ComputationalUnit],
    ) -> None:
        if unit in seen:
            return
        seen.add(unit)
        for source in unit.inputs:
            producer = self.units.get(source.name)
            if producer is not None:
                self._gather(producer, found, seen)
        found[unit] = None

    def is_stamped(self, generator: StreamGenerator) -> bool | None:
        """Whether the samples were stamped on arrival, here or where they come from; None before
        the first one."""
        unit = self.units.get(generator.name)
        made = () if unit is None else self.units_behind(unit)
        read = {source for part in made for source in part.inputs} or {generator}
        known = {self._is_stamped(source) for source in read if source.name not in self.units}
        return False if False in known else (True if True in known else None)

    def _is_stamped(self, generator: StreamGenerator) -> bool | None:
        if generator.name in self.system and generator.name not in self.late:
            return True
        return generator.stamped

    def is_broken(self, unit: ComputationalUnit) -> bool:
        """``unit``, or one whose samples reach it, has failed: nothing more comes of it."""
        return any(part.failure is not None for part in self.units_behind(unit))

    def failure_of(self, unit: ComputationalUnit) -> str | None:
        """Why nothing more comes of ``unit``: the name and the failure of the nearest unit that has
        failed, itself or one whose samples reach it; None while something may come.

        An adaptive subscription does not fail with its sources: it looks for others. Cost: O(units
        behind it).
        """
        todo, seen = [unit], {unit}
        for part in todo:
            if part.failure is not None:
                return f"{part.name}: {part.failure}"
            if part.transformation != MERGE:
                made = (self.units.get(source.name) for source in part.inputs)
                found = [one for one in made if one is not None and one not in seen]
                seen.update(found)
                todo += found
        return None

    def release_unused(self) -> None:
        """Stop units that were built for a request that then failed."""
        for unit in list(self.units.values()):
            if unit.users == 0 and self.units.get(unit.output.name) is unit:
                self.remove_unit(unit)

    def identity(
        self,
        transformation: str,
        inputs: Sequence[StreamGenerator],
        output: StreamGenerator,
        parameters: Mapping[str, str],
    ) -> tuple[object, ...]:
        """What every `ComputationalUnit` begins with; it gets the next free name."""
        return (self.unit_name(), transformation, inputs, output, parameters, self._failed)

    def unit_name(self) -> str:
        """The next free ``dyknow_cu<N>``."""
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
        """Connect a unit to its inputs, and tell; see `ComputationalUnit.start`."""
        self.units[unit.output.name] = unit
        unit.busy_time, unit.backlog = self._busy_time, self._backlog
        self._use(unit.inputs)
        text = ", ".join(f"{key}={value}" for key, value in unit.parameters.items())
        specification = self._specified[1] or specification or f"{unit.transformation}({text})"
        self.tell(ChangeKind.UNIT_STARTED, unit, specification)
        unit.start(since, after, until)

    def change_inputs(
        self,
        unit: ComputationalUnit,
        gained: Sequence[StreamGenerator],
        lost: Sequence[StreamGenerator],
        specification: str,
    ) -> None:
        """A unit that chooses its inputs itself has changed them ([DyKnow10 Def. 4.7])."""
        self._use(gained)
        self.tell(ChangeKind.INPUTS_CHANGED, unit, specification)
        self._leave(lost)

    def report(self, stream: str, report: Report) -> None:
        """A process has said something of the stream that it makes; acted upon later, when all
        that the sample causes has happened."""
        self.reports.append((stream, report))

    def told(self, change: Change) -> None:
        """Pass on a change of a process that is no unit."""
        self._on_change(change)

    def tell(self, kind: ChangeKind, unit: ComputationalUnit, specification: str = "") -> None:
        """Tell a change of a unit."""
        together = unit.synchronization
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
                synchronization="" if together is None else together.name,
                fed=() if together is None else tuple(one.name for one in together.inputs),
            )
        )

    def _use(self, inputs: Sequence[StreamGenerator]) -> None:
        for source in inputs:
            producer = self.units.get(source.name)
            if producer is not None:
                producer.users += 1

    def _leave(self, inputs: Sequence[StreamGenerator]) -> None:
        for source in inputs:
            producer = self.units.get(source.name)
            if producer is not None and producer.output is source:
                self.release(producer)

    def reserved_stream(
        self, schema: Schema, namespace: str, pools: dict[str, StringPool]
    ) -> StreamGenerator:
        """A new stream with the next free ``dyknow_reserved<N>``."""
        return self.add_stream(self.reserved_name(), schema, namespace=namespace, pools=pools)

    def is_shared(self, key: Hashable) -> bool:
        """Whether there is a running unit for ``key``; see `share`."""
        return self.shared(key) is not None

    def shared(self, key: Hashable) -> ComputationalUnit | None:
        """The running unit that whoever wants ``key`` gets, if there is one; see `share`."""
        unit = self._shared.get(key)
        if unit is None or self.is_broken(unit) or not self.reads_what_is_there(unit):
            return None
        return unit

    def key_of(self, unit: ComputationalUnit) -> Hashable | None:
        """What a running unit was built for; None if it is not shared. See `share`."""
        return self._keys.get(unit)

    def unshare(self, unit: ComputationalUnit) -> None:
        """Whoever wants the same from now on gets another unit; `share_again` undoes it."""
        key = self._keys.get(unit)
        if key is not None and self._shared.get(key) is unit:
            del self._shared[key]

    def share_again(self, unit: ComputationalUnit) -> None:
        """Undo `unshare`. Contract: nobody has got another unit since."""
        key = self._keys.get(unit)
        if key is not None:
            self._shared.setdefault(key, unit)

    def _failed(self, unit: ComputationalUnit) -> None:
        # What goes on has no `failure`: a single window was not evaluated.
        reason = unit.failure or unit.counters.last_error or ""
        self.tell(ChangeKind.UNIT_FAILED, unit, reason)


def _no_objection() -> None:
    """Streams come into being whenever they are asked for."""


def _unheard(_name: str) -> None:
    """Nobody wants to know."""
