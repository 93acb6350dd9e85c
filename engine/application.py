"""A knowledge processing application: the network of processes that KPL declares
([DyKnow10 §5.2-5.3]).

Each source, each label and each declared stream is a generator of the configuration; equal terms
share one adapted stream. Declarations may be added and removed while samples flow. What is added
begins with the kept history of the streams it reads, as Def. 5.33-5.35 speak of whole streams.
"""

from __future__ import annotations

import difflib
from collections.abc import Callable, Iterable, Sequence
from typing import assert_never

from ..languages.kpl import (
    CheckedDeclaration,
    CompunitDeclaration,
    Compute,
    FromSource,
    GeneratorDeclaration,
    JoinOf,
    Signature,
    SortDeclaration,
    SourceDeclaration,
    StreamDeclaration,
    Synchronize,
    Term,
    ValueSort,
    format_kpl,
    format_term,
)
from ..streams.fluent import Retention
from ..streams.generator import StreamGenerator
from ..streams.joining import Join
from ..streams.policy import Order
from ..streams.sample import Schema
from ..streams.synchronization import Late, Synchronization
from .changes import Change, ChangeKind, Role
from .configuration import Configuration
from .errors import AlreadyExists, Conflict, Refused, UnknownDeclaration, UnknownFeature
from .joined_unit import FunctionProcess
from .processes import Processes, SourceImplementation, UnitImplementation
from .sampled_source import SampledSource
from .stream_units import AdaptationUnit, PolicyUnit, TupleUnit
from .supervision import DIRECT, ProcessEvent, Runner
from .unit import ComputationalUnit
from .views import Since
from .violations import SUFFIX, Violations

POLICY = "policy"
"""The transformation of a subscription with a policy."""
BUILT_IN = (POLICY, "join", "sync")
"""Transformations of the language; nothing else is called so."""


class Application:
    """The processes of checked declarations, connected.

    ``processes`` implements computational units (Def. 5.28) and sampled sources, ``runner`` calls
    them. ``retention`` and ``lateness`` (ns) are those of the streams that it makes. Without
    ``reads_sources`` every source is published to, as a recording is. ``check_name`` raises
    `Refused` for names that are the system's own.

    `add` takes all of its declarations or none; `remove` likewise.
    """

    def __init__(
        self,
        configuration: Configuration,
        processes: Processes,
        *,
        runner: Runner = DIRECT,
        retention: Retention | None = None,
        lateness: int = 0,
        reads_sources: bool = True,
        check_name: Callable[[str], None] = lambda _: None,
    ) -> None:
        self.signature = Signature()
        self.sampled: dict[str, SampledSource] = {}
        """The sources that the system reads, by name."""
        self._configuration = configuration
        self._processes = processes
        self._runner = runner
        self._retention = retention
        self._lateness = lateness
        self._reads_sources = reads_sources
        self._check_name = check_name
        self._own: set[str] = set()
        self._units: dict[str, ComputationalUnit] = {}
        configuration.missing = self._missing

    # -- what there is -----------------------------------------------------------------------

    def stream_of(self, key: str) -> StreamGenerator | None:
        """The stream that a declaration makes or names; None for sorts and units."""
        declaration = self.signature.find(key)
        match declaration:
            case GeneratorDeclaration() | SourceDeclaration() | StreamDeclaration():
                return self._configuration.stream(declaration.key)
            case _:
                return None

    def unit_of(self, key: str) -> ComputationalUnit | None:
        """The unit that makes a declaration's stream."""
        return self._units.get(key)

    def producer_of(self, stream: str) -> str | None:
        """The name of the process that makes a stream, whoever asked for it; None if none does."""
        maker: ComputationalUnit | SampledSource | None = self._configuration.units.get(stream)
        maker = maker or self.sampled.get(stream)
        if maker is None and stream in self._configuration.system:
            maker = self._units.get(stream.removesuffix(SUFFIX))
        return None if maker is None else maker.name

    def uses_stream(self, name: str) -> bool:
        """Whether ``name`` is the stream of a declared source."""
        return self.signature.source(name) is not None

    def declaration(self, name: str) -> CheckedDeclaration:
        """By name, label or key; raises `UnknownDeclaration`."""
        found = self.signature.find(name)
        if found is None:
            near = difflib.get_close_matches(name, self.signature.by_key, n=3)
            raise UnknownDeclaration(
                f"nothing called {name!r} was declared in KPL",
                f"did you mean {' or '.join(near)}?" if near else "GET /kpl shows what was",
            )
        return found

    # -- change ------------------------------------------------------------------------------

    def add(self, declarations: Iterable[CheckedDeclaration]) -> None:
        """Start what the declarations ask for, in order; they were checked against `signature`.

        Raises, with nothing changed, `UnknownFeature` for a computational unit without an
        implementation, `Conflict` where an implementation or a stream is otherwise than declared,
        `AlreadyExists` for a name that another stream has, `Refused` for one of the system.
        """
        new = tuple(declarations)
        for declaration in new:
            self._check(declaration)
        for declaration in new:
            self._start(declaration)
        self.signature = self.signature.with_declarations(new)

    def remove(self, name: str, *, cascade: bool = False) -> tuple[str, ...]:
        """Stop and forget a declaration, with ``cascade`` also what cannot be without it.

        Gives the keys of what was removed, users first. Raises `UnknownDeclaration`; `Conflict`
        where other declarations need it and ``cascade`` is not said, and where something outside
        of KPL reads one of the streams.
        """
        found = self.declaration(name)
        dependents = self.signature.dependents(found.key)
        if dependents and not cascade:
            raise Conflict(
                f"{found.key} is needed by {_some(dependents)}",
                "remove these first, or all together with cascade",
            )
        keys = (*dependents, found.key)
        made = {key for key in keys if key in self._configuration.streams}
        for stream in sorted(made):
            outside = self._readers_outside(stream, made)
            if outside:
                raise Conflict(
                    f"stream {stream!r} is read by {_some(outside)}",
                    "cancel the requests that need it first",
                )
        for key in keys:
            self._stop(self.signature.by_key[key])
        self.signature = self.signature.without(keys)
        return keys

    def tick(self, now: int) -> None:
        """The time is ``now`` (ns): read the sources that are due."""
        for source in list(self.sampled.values()):
            source.tick(now)

    # -- checks ------------------------------------------------------------------------------

    def _check(self, declaration: CheckedDeclaration) -> None:
        match declaration:
            case SourceDeclaration(name, sort):
                self._check_source(name, sort)
            case GeneratorDeclaration():
                self._check_free(declaration.key)
                if isinstance(declaration.process, Compute):
                    self._implementation(declaration)
            case StreamDeclaration(name):
                self._check_free(name)
            case CompunitDeclaration(name):
                implementation = self._processes.units.get(name)
                if implementation is not None:
                    _check_sorts(declaration, implementation)
            case SortDeclaration():
                pass
            case _:
                assert_never(declaration)

    def _check_source(self, name: str, sort: ValueSort) -> None:
        implementation = self._processes.sources.get(name)
        if implementation is not None and _sort(implementation.sort) != sort.name:
            raise Conflict(
                f"source {name!r} is declared with values of sort {sort.name}, "
                f"its code gives {implementation.sort}",
                f"declare `source {_sort(implementation.sort)} {name}`, or change its decorator",
            )
        existing = self._configuration.streams.get(name)
        if existing is None:
            self._check_free(name)
            return
        if name in self._configuration.units or name in self._configuration.system:
            raise Refused(
                f"stream {name!r} is made by the system, so it is no source",
                "a source is a stream that you publish to, or a process with @dyknow.source",
            )
        if not existing.is_open and sort.schema is not None and sort.schema != existing.schema:
            raise Conflict(
                f"stream {name!r} has the fields {_fields(existing.schema)}; "
                f"the sort {sort.name} has {_fields(sort.schema)}",
                "declare a sort with the fields of the stream: "
                f"sort {sort.name} = ({_fields(existing.schema)})",
            )

    def _check_free(self, name: str) -> None:
        if name in self._configuration.streams or name in self._configuration.aliases:
            raise AlreadyExists(
                f"there is a stream called {name!r} that KPL did not declare",
                "choose another name, or declare it as a source",
            )
        self._check_name(name)

    def _implementation(self, declaration: GeneratorDeclaration) -> UnitImplementation:
        assert isinstance(declaration.process, Compute)
        name = declaration.process.unit
        found = self._processes.units.get(name)
        if found is None:
            known = ", ".join(self._processes.units) or "none"
            raise UnknownFeature(
                f"computational unit {name!r} of {declaration.key} has no implementation",
                f"write it with @dyknow.computational_unit and load its module; there are: {known}",
            )
        compunit = self.signature.compunit(name)
        if compunit is not None:
            _check_sorts(compunit, found)
        return found

    def _readers_outside(self, stream: str, ours: set[str]) -> tuple[str, ...]:
        """Who reads ``stream`` and is not itself to be removed."""
        outside: list[str] = []
        for unit in self._configuration.units.values():
            if all(source.name != stream for source in unit.inputs) or unit.output.name in ours:
                continue
            if isinstance(unit, AdaptationUnit):  # it goes with its own readers
                outside += self._readers_outside(unit.output.name, ours)
            else:
                outside.append(unit.name)
        return tuple(outside)

    # -- starting and stopping ---------------------------------------------------------------

    def _start(self, declaration: CheckedDeclaration) -> None:
        match declaration:
            case SourceDeclaration(name, sort):
                self._start_source(name, sort)
            case GeneratorDeclaration():
                self._start_generator(declaration)
            case StreamDeclaration(name, _, term):
                self._declared(name, self._adapt(term, name, declared=True))
            case CompunitDeclaration() | SortDeclaration():
                pass
            case _:
                assert_never(declaration)

    def _stop(self, declaration: CheckedDeclaration) -> None:
        key = declaration.key
        unit = self._units.pop(key, None)
        if unit is not None:
            if isinstance(unit, PolicyUnit) and unit.violations is not None:
                self._close_violations(unit.violations)
            self._configuration.remove_unit(unit)
        self._configuration.aliases.pop(key, None)
        sampled = self.sampled.pop(key, None)
        if sampled is not None:
            sampled.stop()
            self._configuration.system.discard(key)
            self._tell_source(ChangeKind.UNIT_STOPPED, sampled)
        if key in self._own:
            self._own.discard(key)
            self._configuration.remove_stream(key)

    def _start_source(self, name: str, sort: ValueSort) -> None:
        implementation = self._processes.sources.get(name)
        if name not in self._configuration.streams:
            self._own.add(name)
            output = self._stream(name, sort.schema)
            if implementation is not None and self._reads_sources:
                self._read(implementation, output)

    def _read(self, implementation: SourceImplementation, output: StreamGenerator) -> None:
        source = SampledSource(
            implementation,
            output,
            None,
            on_event=lambda source, event, text: self._tell_source(ChangeKind(event), source, text),
            runner=self._runner,
            name=self._configuration.unit_name(),
        )
        self.sampled[output.name] = source
        self._configuration.system.add(output.name)
        self._tell_source(ChangeKind.UNIT_STARTED, source, f"source {output.name}")

    def _start_generator(self, declaration: GeneratorDeclaration) -> None:
        match declaration.process:
            case FromSource(name):
                self._configuration.aliases[declaration.key] = name
            case Compute(name, terms):
                inputs = [self._term(term) for term in terms]
                output = self._stream(declaration.key, declaration.sort.schema)
                unit: ComputationalUnit = FunctionProcess(
                    *self._identity(name, inputs, output, declaration),
                    implementation=self._implementation(declaration),
                    on_event=self._told,
                    runner=self._runner,
                )
                self._declared(declaration.key, unit)
            case JoinOf(terms):
                self._tuples(declaration, terms, Join(len(terms)), None)
            case Synchronize(terms, policy):
                violations = self._violations(declaration.key)
                labels = [str(term.label) for term in terms]

                def late(samples: Late) -> None:
                    violations.late(samples, labels[samples.input])

                monotone = [term.policy.effective_order is not Order.ANY for term in terms]
                kernel = Synchronization(policy, monotone, late)
                self._tuples(declaration, terms, kernel, violations)
            case _:
                assert_never(declaration.process)

    def _tuples(
        self,
        declaration: GeneratorDeclaration,
        terms: Sequence[Term],
        kernel: Join | Synchronization,
        violations: Violations | None,
    ) -> None:
        inputs = [self._term(term) for term in terms]
        output = self._stream(declaration.key, None)
        name = "join" if isinstance(kernel, Join) else "sync"
        unit = TupleUnit(
            *self._identity(name, inputs, output, declaration),
            kernel=kernel,
            identifiers=[term.label.identifier for term in terms],
            violations=violations,
        )
        self._declared(declaration.key, unit)

    def _term(self, term: Term) -> StreamGenerator:
        """The stream of a term; the same term is the same stream."""
        if term.policy.is_default:
            return self._configuration.stream(str(term.label))
        name = self._configuration.reserved_name

        def build() -> ComputationalUnit:
            unit = self._adapt(term, name(), declared=False)
            self._configuration.start(unit, Since.START)
            return unit

        return self._configuration.share(term, build).output

    def _adapt(self, term: Term, name: str, *, declared: bool) -> AdaptationUnit:
        source = self._configuration.stream(str(term.label))
        output = self._stream(name, None if source.is_open else source.schema)
        output.stream.pools.update(source.stream.pools)
        return AdaptationUnit(
            *self._configuration.identity(POLICY, [source], output, {"term": format_term(term)}),
            policy=term.policy,
            violations=self._violations(name) if declared else None,
        )

    def _identity(
        self,
        transformation: str,
        inputs: Sequence[StreamGenerator],
        output: StreamGenerator,
        declaration: GeneratorDeclaration,
    ) -> tuple[object, ...]:
        parameters = {"kpl": format_kpl(declaration)}
        return self._configuration.identity(transformation, inputs, output, parameters)

    def _declared(self, key: str, unit: ComputationalUnit) -> None:
        """Start the unit of a declaration, which is its first user."""
        unit.users += 1
        self._units[key] = unit
        specification = unit.parameters.get("kpl") or f"stream {key} = {unit.parameters['term']}"
        self._configuration.start(unit, Since.START, specification)

    def _stream(self, name: str, schema: Schema | None) -> StreamGenerator:
        return self._configuration.add_stream(
            name, schema or Schema(()), lateness=self._lateness, retention=self._retention
        )

    # -- what is told ------------------------------------------------------------------------

    def _told(self, unit: ComputationalUnit, event: ProcessEvent, text: str) -> None:
        self._configuration.tell(ChangeKind(event), unit, text)

    def _tell_source(self, kind: ChangeKind, source: SampledSource, text: str = "") -> None:
        name = source.implementation.name
        self._configuration.told(
            Change(kind, source.output.name, source.name, name, (), text, Role.SOURCE)
        )

    def _violations(self, name: str) -> Violations:
        return Violations(lambda: self._open_violations(name + SUFFIX))

    def _open_violations(self, name: str) -> StreamGenerator:
        self._configuration.system.add(name)
        return self._configuration.add_stream(name, Schema(()), retention=self._retention)

    def _close_violations(self, violations: Violations) -> None:
        name = violations.name
        if name is not None:
            violations.end()
            self._configuration.system.discard(name)
            self._configuration.remove_stream(name)

    def _missing(self, name: str) -> StreamGenerator | None:
        """Somebody asks for the violations of a stream that has none yet."""
        unit = self._units.get(name.removesuffix(SUFFIX)) if name.endswith(SUFFIX) else None
        if not isinstance(unit, PolicyUnit) or unit.violations is None:
            return None
        return unit.violations.stream


def _check_sorts(declaration: CompunitDeclaration, implementation: UnitImplementation) -> None:
    """What KPL says of a unit's value sorts (Def. 5.16) is what its decorator says."""
    declared = (declaration.sort.name, *(sort.name for sort in declaration.inputs))
    coded = tuple(map(_sort, (implementation.output, *implementation.inputs)))
    if declared != coded:
        text = f"compunit {coded[0]} {implementation.name}({', '.join(coded[1:])})"
        raise Conflict(
            f"computational unit {implementation.name!r} is declared as "
            f"`{format_kpl(declaration)}`, its code as `{text}`",
            "make the declaration and the decorator the same",
        )


def _sort(name: str) -> str:
    """A sort's one spelling: terms of the domain go without their prefix."""
    return name.removeprefix("dyknow:")


def _fields(schema: Schema) -> str:
    return ", ".join(f"{field.name} {field.type}" for field in schema.fields)


def _some(names: Sequence[str]) -> str:
    return ", ".join(names[:8]) + (f" and {len(names) - 8} more" if len(names) > 8 else "")
