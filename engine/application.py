"""A knowledge processing application: the network of processes that KPL declares
([DyKnow10 §5.2-5.3]).

Each source, each label and each declared stream is a generator; equal terms share one adapted
stream. Samples go in at the sources and come out at every stream. Time comes with the samples.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import assert_never

from ..languages.kpl import (
    CheckedDeclaration,
    CompunitDeclaration,
    Compute,
    FromSource,
    GeneratorDeclaration,
    JoinOf,
    SortDeclaration,
    SourceDeclaration,
    StreamDeclaration,
    Synchronize,
    Term,
    format_kpl,
    format_term,
)
from ..streams.fluent import Retention
from ..streams.generator import StreamGenerator
from ..streams.joining import Join
from ..streams.policy import Order
from ..streams.sample import FieldType, Schema
from ..streams.strings import StringPool
from ..streams.synchronization import Synchronization
from .errors import UnknownFeature
from .joined_unit import FunctionProcess
from .processes import Processes
from .stream_units import AdaptationUnit, TupleUnit
from .unit import ComputationalUnit
from .views import Since


class Application:
    """The processes of checked declarations, connected.

    ``processes`` implements the computational units (Def. 5.28); ``retention`` is how much every
    stream keeps, ``lateness`` (ns) how late a source's samples may be. ``failures`` lists what
    went wrong in units, as ``(label, reason)``.
    """

    def __init__(
        self, processes: Processes, retention: Retention | None = None, lateness: int = 0
    ) -> None:
        self._processes = processes
        self._lateness = lateness
        self._retention = retention
        self.sources: dict[str, StreamGenerator] = {}
        self.labels: dict[str, StreamGenerator] = {}
        self.streams: dict[str, StreamGenerator] = {}
        self.adaptations: dict[str, AdaptationUnit] = {}
        """By the declared stream that each makes."""
        self.failures: list[tuple[str, str]] = []
        self._terms: dict[Term, StreamGenerator] = {}
        self._declared: dict[str, CheckedDeclaration] = {}
        self._count = 0

    def add(self, declarations: Iterable[CheckedDeclaration]) -> None:
        """Start what the declarations ask for, in order; they were checked against what is here.

        Raises `UnknownFeature` for a computational unit without an implementation.
        """
        for declaration in declarations:
            match declaration:
                case SourceDeclaration(name, sort):
                    self.sources[name] = self._generator(name, sort.schema, self._lateness)
                case GeneratorDeclaration():
                    self.labels[declaration.key] = self._start(declaration)
                case StreamDeclaration(name, _, term):
                    self.streams[name] = self._adapt(term, name)
                case CompunitDeclaration() | SortDeclaration():
                    pass
                case _:
                    assert_never(declaration)
            self._declared[declaration.key] = declaration

    def end(self) -> None:
        """All sources have come to their end."""
        for generator in self.sources.values():
            generator.end()

    def _start(self, declaration: GeneratorDeclaration) -> StreamGenerator:
        match declaration.process:
            case FromSource(name):
                return self.sources[name]
            case Compute(name, terms):
                implementation = self._processes.units.get(name)
                if implementation is None:
                    known = ", ".join(self._processes.units) or "none"
                    raise UnknownFeature(
                        f"computational unit {name!r} of {declaration.key} has no implementation",
                        f"write it with @dyknow.computational_unit; there are: {known}",
                    )
                output = self._generator(declaration.key, declaration.sort.schema)
                self._run(
                    FunctionProcess(
                        *self._identity(name, terms, output, declaration),
                        implementation=implementation,
                        on_event=lambda unit, event, text: self.failures.append(
                            (unit.output.name, f"{event}: {text}")
                        ),
                    )
                )
                return output
            case JoinOf(terms):
                return self._tuples(declaration, terms, Join(len(terms)))
            case Synchronize(terms, policy):
                monotone = [term.policy.effective_order is not Order.ANY for term in terms]
                return self._tuples(declaration, terms, Synchronization(policy, monotone))
            case _:
                assert_never(declaration.process)

    def _tuples(
        self,
        declaration: GeneratorDeclaration,
        terms: Sequence[Term],
        kernel: Join | Synchronization,
    ) -> StreamGenerator:
        output = self._generator(declaration.key, None)
        name = "join" if isinstance(kernel, Join) else "sync"
        self._run(
            TupleUnit(
                *self._identity(name, terms, output, declaration),
                kernel=kernel,
                identifiers=[term.label.identifier for term in terms],
            )
        )
        return output

    def _term(self, term: Term) -> StreamGenerator:
        """The stream of a term; the same term is the same stream."""
        if term.policy.is_default:
            return self.labels[str(term.label)]
        found = self._terms.get(term)
        if found is None:
            found = self._terms[term] = self._adapt(term, format_term(term))
        return found

    def _adapt(self, term: Term, name: str) -> StreamGenerator:
        source = self.labels[str(term.label)]
        output = self._generator(name, None if source.is_open else source.schema)
        output.stream.pools.update(source.stream.pools)
        unit = AdaptationUnit(
            *self._named("policy", [source], output, {"term": format_term(term)}),
            policy=term.policy,
        )
        self.adaptations[name] = unit
        self._run(unit)
        return output

    def _identity(
        self,
        transformation: str,
        terms: Sequence[Term],
        output: StreamGenerator,
        declaration: GeneratorDeclaration,
    ) -> tuple[object, ...]:
        inputs = [self._term(term) for term in terms]
        return self._named(transformation, inputs, output, {"kpl": format_kpl(declaration)})

    def _named(
        self,
        transformation: str,
        inputs: Sequence[StreamGenerator],
        output: StreamGenerator,
        parameters: dict[str, str],
    ) -> tuple[object, ...]:
        self._count += 1
        return (f"unit{self._count}", transformation, inputs, output, parameters, self._failed)

    def _run(self, unit: ComputationalUnit) -> None:
        unit.start(Since.START)

    def _generator(self, name: str, schema: Schema | None, lateness: int = 0) -> StreamGenerator:
        schema = schema or Schema(())
        texts = [field.name for field in schema.fields if field.type is FieldType.STRING]
        return StreamGenerator(
            name,
            schema,
            lateness=lateness,
            retention=self._retention,
            pools={text: StringPool() for text in texts},
        )

    def _failed(self, unit: ComputationalUnit) -> None:
        self.failures.append((unit.output.name, unit.failure or "failed"))
