"""A knowledge processing application: the network of processes that KPL declares
([DyKnow10 §5.2-5.3]).

Each source, label and declared stream is a generator of the configuration; equal terms share one
adapted stream. Declarations can be added and removed while samples arrive. A new process begins
with the kept history of its inputs, since Def. 5.33-5.35 are about whole streams.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import assert_never

from ...languages.hints import did_you_mean
from ...languages.kpl import (
    CheckedDeclaration,
    CompunitDeclaration,
    ForeachDeclaration,
    GeneratorDeclaration,
    Signature,
    SinkDeclaration,
    SortDeclaration,
    SourceDeclaration,
    StreamDeclaration,
    ValueSort,
    format_kpl,
)
from ...streams.generator import StreamGenerator
from ...streams.history import Retention
from ...streams.sample import SampleBatch
from ...streams.time import TIME_MAX
from ..configuration.configuration import Configuration
from ..model.errors import Conflict, UnknownDeclaration
from ..model.status_changes import Change, ChangeKind, Role
from ..processes.external_io import Outcome
from ..processes.registry import Processes, SourceImplementation
from ..processes.supervision import DIRECT, Runner
from ..units.base import ComputationalUnit
from ..units.foreach import ConfigurationProcess
from ..units.mediation import MediationUnit
from ..units.sampled_source import SampledSource
from ..units.sink import Sink
from ..units.violations import SUFFIX
from .admission import Admission
from .network import Network, is_needed

Process = ComputationalUnit | SampledSource | Sink | ConfigurationProcess
"""The objects that run for a declaration."""


class Application:
    """The connected processes of checked declarations.

    ``processes`` has the code of computational units (Def. 5.28), sampled sources and sinks;
    ``runner`` calls it. ``retention`` and ``lateness`` (ns) apply to the streams that it makes. In
    a ``rehearsal`` a recording is published to every source, and no sink is called. ``check_name``
    raises `Refused` for reserved names; ``forget`` is called for removed streams.

    `add` starts all of its declarations or none, and `remove` stops all or none. The caller
    publishes samples and then calls `settle`: only then configuration and mediation processes act.
    """

    def __init__(
        self,
        configuration: Configuration,
        processes: Processes,
        *,
        runner: Runner = DIRECT,
        retention: Retention | None = None,
        lateness: int = 0,
        rehearsal: bool = False,
        check_name: Callable[[str], None] = lambda _: None,
        forget: Callable[[str], None] = lambda _: None,
    ) -> None:
        self.signature = Signature()
        self.sampled: dict[str, SampledSource] = {}
        """The sources that the system reads, by name."""
        self._configuration = configuration
        self._processes = processes
        self._runner = runner
        self._rehearsal = rehearsal
        self._forget = forget
        self._network = Network(
            configuration,
            processes,
            runner,
            retention,
            lateness,
            self._has_news,
            self._promised,
        )
        self._admission = Admission(
            configuration, processes, self._network, check_name, rehearsal=rehearsal
        )
        self._own_streams: set[str] = set()
        self._units: dict[str, ComputationalUnit] = {}
        self._readers: dict[str, Sink | ConfigurationProcess] = {}
        self._news: dict[MediationUnit | ConfigurationProcess, None] = {}
        self._has_stream_changes = False

    # -- look-ups ----------------------------------------------------------------------------

    def stream_of(self, key: str) -> StreamGenerator | None:
        """The stream that a declaration makes or names; None for sorts and computational units."""
        declaration = self.signature.find(key)
        match declaration:
            case GeneratorDeclaration() | SourceDeclaration() | StreamDeclaration():
                return self._configuration.stream(declaration.key)
            case _:
                return None

    def samples_of(self, name: str) -> SampleBatch:
        """All kept samples of a declared stream, label or source. Raises `UnknownStream`."""
        return self._configuration.stream(name).stream.all()

    def process_of(self, key: str) -> Process | None:
        """The process of a declaration; None if it has none."""
        return self._units.get(key) or self.sampled.get(key) or self._readers.get(key)

    def producer_of(self, stream: str) -> str | None:
        """The name of the process that makes a stream, also of one outside KPL; None if there is
        none."""
        maker: ComputationalUnit | SampledSource | None = self._configuration.units.get(stream)
        maker = maker or self.sampled.get(stream)
        if maker is None and stream in self._configuration.system:
            maker = self._configuration.late.maker_of(stream)
            maker = maker or self._configuration.units.get(stream.removesuffix(SUFFIX))
        return None if maker is None else maker.name

    def uses_stream(self, name: str) -> bool:
        """Whether ``name`` is the stream of a declared source."""
        return self.signature.source(name) is not None

    def release(self, name: str) -> None:
        """Keep the stream of a source, which a client declared, when the source is removed."""
        self._own_streams.discard(name)

    def declaration(self, name: str) -> CheckedDeclaration:
        """A declaration by name, label or key. Raises `UnknownDeclaration`."""
        found = self.signature.find(name)
        if found is None:
            raise UnknownDeclaration(
                f"there is no KPL declaration called {name!r}",
                did_you_mean(name, self.signature.by_key) or "GET /kpl lists all",
            )
        return found

    # -- change ------------------------------------------------------------------------------

    def add(
        self,
        declarations: Iterable[CheckedDeclaration],
        started: Callable[[str], None] = lambda _: None,
    ) -> None:
        """Start the processes of declarations, in order; they were checked against `signature`.
        Calls ``started`` with the key of each.

        Raises the errors of `Admission.check`, and changes nothing then.
        """
        new = tuple(declarations)
        for declaration in new:
            self._admission.check(declaration, self.signature)
        self.signature = self.signature.with_declarations(new)
        for declaration in new:
            self._start(declaration)
            started(declaration.key)
        self._has_stream_changes = True
        self.settle()

    def remove(self, name: str, *, cascade: bool = False) -> tuple[str, ...]:
        """Stop and remove a declaration, with ``cascade`` also its dependents.

        Returns the keys of the removed declarations, dependents first. Raises `UnknownDeclaration`;
        `Conflict` for one with dependents without ``cascade``, and where a process outside KPL
        reads one of the streams.
        """
        found = self.declaration(name)
        dependents = self.signature.dependents(found.key)
        if dependents and not cascade:
            raise Conflict(
                f"{found.key} is needed by {_some(dependents)}",
                "remove these first, or all together with cascade",
            )
        keys = (*dependents, found.key)
        streams = {key for key in keys if key in self._units or key in self._own_streams}
        outside = self._configuration.find_outside_reader(streams, self._is_ours)
        if outside:
            stream, reader = outside
            raise Conflict(
                f"stream {stream!r} is read by {reader}", "cancel the requests that read it first"
            )
        for key in keys:
            self.stop(self.signature.by_key[key])
        self.signature = self.signature.without(keys)
        self._has_stream_changes = True
        self.settle()
        return keys

    def _is_ours(self, unit: ComputationalUnit) -> bool:
        """Whether KPL started a unit, so that it does not keep a stream from being removed."""
        return unit.output.name in self._units

    def settle(self) -> None:
        """Let configuration and mediation processes act on the samples that arrived.

        It works in rounds until no process has work. In each round finished generators are removed,
        every ``foreach`` processes one set, and mediations connect new streams. When no set is
        left, mediations emit the decided samples. This terminates, because the processes have no
        cyclic inputs and none reads the status stream, to which their actions are reported.
        """
        while True:
            has_acted = self._remove_finished()
            configuring = [p for p in self._news if isinstance(p, ConfigurationProcess)]
            if configuring or has_acted:  # mediations may wait for streams that these make
                self._news.update(dict.fromkeys(self._mediations))
            for process in configuring:
                if process.step():
                    has_acted = self._has_stream_changes = True
                else:
                    self._news.pop(process, None)
            self._reconnect()
            mediations = [
                p
                for p in self._news
                if isinstance(p, MediationUnit) and self._units.get(p.output.name) is p
            ]
            for unit in mediations:
                unit.connect_inputs()
            if has_acted:
                continue
            if not mediations:
                self._news.clear()
                # A mediation that has not emitted yet may need the samples of past lives.
                self._drop_past_lives()
                return
            for unit in mediations:
                self._news.pop(unit, None)
                unit.pass_on()

    def _drop_past_lives(self) -> None:
        """Drop past lives of streams that every running mediation has processed."""
        past = self._network.past
        for feature in list(past):
            behind = [
                unit.done
                for unit in self._mediations
                if unit.feature == feature and unit.failure is None and not unit.output.is_ended
            ]
            done = min(behind, default=TIME_MAX)
            kept = {
                key: needed
                for key, lives in past[feature].items()
                if (needed := [life for life in lives if is_needed(life, done)])
            }
            past[feature] = kept
            if not kept:
                del past[feature]

    def _remove_finished(self) -> bool:
        """Remove generators of objects that have left, once they have read their last samples."""
        has_acted = False
        for process in self._configuring:
            if process.leaving and process.reap():
                has_acted = self._has_stream_changes = True
        return has_acted

    def _reconnect(self) -> None:
        """Let processes look for streams that were added or removed, until nothing changes."""
        while self._has_stream_changes:
            self._has_stream_changes = False
            for process in self._configuring:
                if process.review():
                    self._has_stream_changes = True
            for unit in self._mediations:
                if unit.may_find:
                    unit.look_again()

    def _promised(self, feature: str) -> int:
        """The available time (ns) up to which generators that configuration processes will still
        make of a feature have no samples. It follows from their sets and those of their inputs."""
        promised, todo, seen = TIME_MAX, [feature], {feature}
        while todo:
            wanted = todo.pop()
            for process in self._configuring:
                if wanted in process.makes:
                    promised = min(promised, process.promised)
                    read = process.reads - seen
                    todo += read
                    seen |= read
        return promised

    @property
    def _mediations(self) -> list[MediationUnit]:
        return [unit for unit in self._units.values() if isinstance(unit, MediationUnit)]

    @property
    def _configuring(self) -> list[ConfigurationProcess]:
        return [p for p in self._readers.values() if isinstance(p, ConfigurationProcess)]

    def _has_news(self, process: MediationUnit | ConfigurationProcess) -> None:
        self._news[process] = None

    def tick(self, now: int) -> None:
        """Read the sources that are due at ``now`` (ns)."""
        for source in list(self.sampled.values()):
            source.tick(now)

    # -- starting and stopping ---------------------------------------------------------------

    def _start(self, declaration: CheckedDeclaration) -> None:
        match declaration:
            case SourceDeclaration(name, sort):
                self._start_source(name, sort)
            case GeneratorDeclaration():
                unit = self._network.start_generator(declaration)
                if unit is not None:
                    self._units[declaration.key] = unit
            case StreamDeclaration(name):
                self._units[name] = self._network.start_stream(declaration)
            case ForeachDeclaration():
                self._start_foreach(declaration)
            case SinkDeclaration():
                self._start_sink(declaration)
            case CompunitDeclaration() | SortDeclaration():
                pass
            case _:
                assert_never(declaration)

    def _start_source(self, name: str, sort: ValueSort) -> None:
        implementation = self._processes.sources.get(name)
        # A client may have declared the stream, and then it does not belong to KPL.
        if name not in self._configuration.streams:
            self._own_streams.add(name)
            output = self._network.stream(name, sort.schema)
            if implementation is not None and not self._rehearsal:
                self._read(implementation, output)

    def _read(self, implementation: SourceImplementation, output: StreamGenerator) -> None:
        source = SampledSource(
            implementation,
            output,
            None,
            on_event=lambda source, event, text: self._report_source(
                ChangeKind(event), source, text
            ),
            runner=self._runner,
            name=self._configuration.unit_name(),
            on_report=self._configuration.add_report,
        )
        self.sampled[output.name] = source
        self._configuration.system.add(output.name)
        self._report_source(ChangeKind.UNIT_STARTED, source, f"source {output.name}")

    def _start_foreach(self, declaration: ForeachDeclaration) -> None:
        process = ConfigurationProcess(
            self._configuration.unit_name(),
            declaration,
            self._network.term(declaration.members),
            self,
            on_event=lambda process, event, text: self._report_reader(
                ChangeKind(event), process, text
            ),
            on_news=self._has_news,
        )
        self._attach(declaration.key, process, format_kpl(declaration))
        process.begin()

    # The protocol `Generators`, which configuration processes call.

    def start(self, declaration: GeneratorDeclaration, after: int, until: int | None) -> str | None:
        """Start the generator of one object; return why it cannot start, or None."""
        key = declaration.key
        missing = self._network.missing(declaration)
        if missing is not None:
            return f"there is no {missing}"
        if self._configuration.has(key):
            return f"there is another {key}"
        unit = self._network.start_generator(declaration, after, until)
        assert unit is not None, "a foreach has no generators of sources"
        self._units[key] = unit
        self._has_stream_changes = True
        return None

    def end(self, declaration: GeneratorDeclaration, until: int) -> None:
        """Let a generator read no samples available later than ``until``."""
        self._units[declaration.key].end_after(until)

    def last_processed(self, declaration: GeneratorDeclaration) -> int:
        """The available time up to which a generator has read samples."""
        return self._units[declaration.key].last_processed

    def void(self, declaration: GeneratorDeclaration) -> None:
        """Remove a generator that another one replaces from its beginning on."""
        self._units[declaration.key].output.is_void = True
        self.stop(declaration)

    def is_over(self, declaration: GeneratorDeclaration) -> bool:
        """Whether a generator has read all of its samples, or failed."""
        unit = self._units[declaration.key]
        return unit.output.is_ended or unit.failure is not None

    def has_inputs(self, declaration: GeneratorDeclaration) -> bool:
        """Whether the streams that a generator reads still exist."""
        return self._configuration.has_current_inputs(self._units[declaration.key])

    def stop(self, declaration: CheckedDeclaration) -> None:
        """Stop the process of a declaration, and remove its stream."""
        key = declaration.key
        unit = self._units.pop(key, None)
        if unit is not None:
            output = unit.output
            read = [self._configuration.unadapted(source) for source in unit.inputs]
            # Another generator repeats the results that come from voided samples.
            if any(life.is_void for life in read):
                output.is_void = True
            if output.ends_at is None:  # it ends with the first of its inputs that has ended
                ends = [life.ends_at for life in read if life.ends_at is not None]
                output.ends_at = min(ends, default=None)
            is_over = output.ends_at is not None and not output.is_void
            if is_over and isinstance(declaration, GeneratorDeclaration):
                lives = self._network.past.setdefault(declaration.label.feature, {})
                lives.setdefault(key, []).append(output)
            self._configuration.remove_unit(unit)
            if isinstance(unit, MediationUnit):
                self._news.pop(unit, None)
        self._configuration.aliases.pop(key, None)
        sampled = self.sampled.pop(key, None)
        if sampled is not None:
            sampled.stop()
            self._configuration.system.discard(key)
            self._report_source(ChangeKind.UNIT_STOPPED, sampled)
        reader = self._readers.pop(key, None)
        if reader is not None:
            self._configuration.detach(reader)
            self._report_reader(ChangeKind.UNIT_STOPPED, reader)
            if isinstance(reader, ConfigurationProcess):
                self._news.pop(reader, None)
        if key in self._own_streams:
            self._own_streams.discard(key)
            self._configuration.remove_stream(key)
        # The stream of a source may stay (`release`), and then it keeps its annotation.
        if not self._configuration.has(key):
            self._forget(key)

    def _start_sink(self, declaration: SinkDeclaration) -> None:
        implementation = self._admission.sink_implementation(declaration)
        if implementation is None:
            return
        sink = Sink(
            implementation,
            [self._network.term(term) for term in declaration.terms],
            on_event=lambda sink, event, text: self._report_reader(ChangeKind(event), sink, text),
            runner=self._runner,
            name=self._configuration.unit_name(),
        )
        self._attach(declaration.key, sink, format_kpl(declaration))
        sink.start()

    def record_outcome(self, outcome: Outcome) -> None:
        """Pass the outcome of a call to its sink, unless the sink was removed meanwhile."""
        for reader in tuple(self._readers.values()):
            if isinstance(reader, Sink) and reader.name == outcome.sink:
                reader.apply_outcome(outcome)

    def _attach(self, key: str, reader: Sink | ConfigurationProcess, specification: str) -> None:
        self._readers[key] = reader
        self._configuration.attach(reader)
        self._report_reader(ChangeKind.UNIT_STARTED, reader, specification)

    # -- reports -----------------------------------------------------------------------------

    def _report_source(self, kind: ChangeKind, source: SampledSource, text: str = "") -> None:
        name = source.implementation.name
        self._configuration.report_change(
            Change(kind, source.output.name, source.name, name, (), text, Role.SOURCE)
        )

    def _report_reader(
        self, kind: ChangeKind, reader: Sink | ConfigurationProcess, text: str = ""
    ) -> None:
        name = reader.implementation.name if isinstance(reader, Sink) else "foreach"
        self._configuration.report_change(
            Change(
                kind,
                "",
                reader.name,
                name,
                tuple(source.name for source in reader.inputs),
                text,
                Role.SINK,
            )
        )


def _some(names: Sequence[str]) -> str:
    return ", ".join(names[:8]) + (f" and {len(names) - 8} more" if len(names) > 8 else "")
