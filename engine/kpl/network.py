"""Creates and connects the processes of KPL declarations ([DyKnow10 Def. 5.33-5.35])."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import assert_never

from ...languages.kpl import (
    OBJECT_FIELD,
    Aggregate,
    Compute,
    FromSource,
    GeneratorDeclaration,
    JoinOf,
    Select,
    SelectObject,
    StreamDeclaration,
    Synchronize,
    Term,
    ValueSort,
    format_kpl,
    format_term,
)
from ...streams.generator import StreamGenerator
from ...streams.history import Retention
from ...streams.joins.join import Join
from ...streams.joins.mediation import Mediation
from ...streams.policies.policy import Order, Policy
from ...streams.policies.select_adaptation import adapt
from ...streams.sample import Schema
from ...streams.synchronization.synchronization import Late, Synchronization
from ..configuration.configuration import POLICY, Configuration
from ..configuration.policy_keys import policy_keys
from ..model.errors import UnknownFeature
from ..model.status_changes import ChangeKind
from ..model.views import Since
from ..processes.registry import Processes, UnitImplementation
from ..processes.supervision import ProcessEvent, Runner
from ..units.base import ComputationalUnit
from ..units.join import FunctionProcess
from ..units.mediation import MediationUnit, Past
from ..units.policy import AdaptationUnit, ObjectSelectionUnit, TupleUnit
from ..units.violations import Violations


class Network:
    """Starts the units of generators and declared streams over a configuration's streams.

    Each unit belongs to one declaration. Equal terms share one adapted stream, which exists while
    it has readers. ``on_news`` is called for mediations that have work. ``promised(feature)``
    returns the available time up to which future generators of a feature have no samples.
    """

    def __init__(
        self,
        configuration: Configuration,
        processes: Processes,
        runner: Runner,
        retention: Retention | None,
        lateness: int,
        on_news: Callable[[MediationUnit], None],
        promised: Callable[[str], int],
    ) -> None:
        self._configuration = configuration
        self._processes = processes
        self._runner = runner
        self._retention = retention
        self._lateness = lateness
        self._on_news = on_news
        self._promised = promised
        self.past: dict[str, dict[str, list[StreamGenerator]]] = {}
        """The streams of labels in past lives, by feature and label, for mediations that have not
        processed them yet."""

    def stream(self, name: str, schema: Schema | None) -> StreamGenerator:
        """Create a stream; without ``schema`` an open one."""
        return self._configuration.add_stream(
            name, schema or Schema(()), lateness=self._lateness, retention=self._retention
        )

    def missing(self, declaration: GeneratorDeclaration) -> str | None:
        """The first label that a generator reads and that does not exist; None if all do."""
        labels = (str(term.label) for term in _required_terms(declaration))
        return next((label for label in labels if not self._configuration.has(label)), None)

    def implementation(self, name: str, key: str) -> UnitImplementation:
        """The code of a computational unit. Raises `UnknownFeature`."""
        code = self._processes.units.get(name)
        if code is None:
            names = ", ".join(self._processes.units) or "none"
            raise UnknownFeature(
                f"computational unit {name!r} of {key} has no implementation",
                f"write it with @dyknow.computational_unit and load its module; there are: {names}",
            )
        return code

    def start_generator(
        self,
        declaration: GeneratorDeclaration,
        after: int | None = None,
        until: int | None = None,
    ) -> ComputationalUnit | None:
        """Start the unit of a label; None for the label of a source, which is an alias.

        It reads samples available later than ``after`` (ns), and not later than ``until`` (ns).
        """
        unit: ComputationalUnit
        key, process = declaration.key, declaration.process
        match process:
            case FromSource(name):
                self._configuration.aliases[key] = name
                return None
            case Compute(name, terms):
                unit = FunctionProcess(
                    *self._identity(name, terms, declaration, declaration.sort.schema, after),
                    implementation=self.implementation(name, key),
                    on_event=self._report_event,
                    on_report=self._configuration.add_report,
                    runner=self._runner,
                )
            case JoinOf(terms):
                unit = TupleUnit(
                    *self._identity("join", terms, declaration, None, after),
                    kernel=Join(len(terms)),
                    identifiers=process.identifiers,
                    inner_times=process.inner_times,
                )
            case Synchronize(terms):
                unit = self._synchronization(declaration, process, after)
            case SelectObject(term):
                unit = ObjectSelectionUnit(
                    *self._identity(
                        "selectObject", (term,), declaration, declaration.sort.schema, after
                    ),
                    object=declaration.label.objects[0],
                )
                # With the pools of its input the output does not encode the texts of samples again.
                unit.output.stream.pools.update(unit.inputs[0].stream.pools)
            case Aggregate() | Select():
                unit = self._mediation(declaration, process, after)
            case _:
                assert_never(process)
        self._start(unit, unit.parameters["kpl"], after, until)
        return unit

    def start_stream(self, declaration: StreamDeclaration) -> AdaptationUnit:
        """Start the adaptation unit of a declared stream."""
        violations = self._configuration.violations(declaration.name, self._retention)
        unit = self._adaptation(declaration.term, declaration.name, violations)
        self._start(unit, format_kpl(declaration))
        return unit

    def term(self, term: Term, after: int | None = None) -> StreamGenerator:
        """Return the stream of a term. Equal terms share a stream, unless the keys of their policy
        differ because the annotation changed in between."""
        if term.policy.is_default:
            return self._configuration.stream(str(term.label))

        def build() -> ComputationalUnit:
            unit = self._adaptation(term, self._configuration.reserved_name(), None)
            self._configuration.start(unit, Since.START, after=after)
            return unit

        # The key has ``after``: streams that begin at different times have different samples.
        return self._configuration.share((term, self._keys(term), after), build).output

    def _start(
        self,
        unit: ComputationalUnit,
        specification: str,
        after: int | None = None,
        until: int | None = None,
    ) -> None:
        # The declaration is a user, so the unit also runs without readers.
        unit.users += 1
        self._configuration.start(unit, Since.START, specification, after, until)

    def _keys(self, term: Term) -> tuple[str, ...]:
        """The key fields by which the policy of a term applies to each object separately."""
        return policy_keys(self._configuration, self._configuration.stream(str(term.label)))

    def _adaptation(self, term: Term, name: str, violations: Violations | None) -> AdaptationUnit:
        source = self._configuration.stream(str(term.label))
        output = self.stream(name, None if source.is_open else source.schema)
        output.stream.pools.update(source.stream.pools)
        return AdaptationUnit(
            *self._configuration.identity(POLICY, [source], output, {"term": format_term(term)}),
            policy=term.policy,
            keys=self._keys(term),
            violations=violations,
        )

    def _synchronization(
        self, declaration: GeneratorDeclaration, process: Synchronize, after: int | None
    ) -> TupleUnit:
        violations = self._configuration.violations(declaration.key, self._retention)
        labels = [str(term.label) for term in process.terms]

        def late(samples: Late) -> None:
            violations.add_late(samples, labels[samples.input])

        # If the order holds for each object separately, the whole stream may be out of order.
        monotone = [
            term.policy.effective_order is not Order.ANY and not self._keys(term)
            for term in process.terms
        ]
        return TupleUnit(
            *self._identity("sync", process.terms, declaration, None, after),
            kernel=Synchronization(process.policy, monotone, late),
            identifiers=process.identifiers,
            violations=violations,
        )

    def _mediation(
        self, declaration: GeneratorDeclaration, process: Aggregate | Select, after: int | None
    ) -> MediationUnit:
        specification = format_kpl(declaration)

        def stream_of(object: str) -> StreamGenerator | None:
            term = process.pattern.bound(process.variable, object)
            return self.term(term) if self._configuration.has(str(term.label)) else None

        def past_of(object: str, after: int) -> list[Past]:
            term = process.pattern.bound(process.variable, object)
            lives = self.past.get(term.label.feature, {}).get(str(term.label), ())
            return [_past(life, term.policy) for life in lives if is_needed(life, after)]

        def changed(
            unit: MediationUnit,
            gained: Sequence[StreamGenerator],
            lost: Sequence[StreamGenerator],
        ) -> None:
            self._configuration.change_inputs(unit, gained, lost, specification)

        is_aggregate = isinstance(process, Aggregate)
        name = "aggregate" if is_aggregate else "select"
        schema = declaration.sort.schema
        identity = self._identity(name, (process.members,), declaration, schema, after)
        pools = self._configuration.stream(declaration.key).stream.pools
        return MediationUnit(
            *identity,
            kernel=Mediation(
                OBJECT_FIELD if is_aggregate else None, pools, self._configuration.rules
            ),
            feature=process.pattern.label.feature,
            select=not is_aggregate,
            stream_of=stream_of,
            promised=lambda: self._promised(process.pattern.label.feature),
            past_of=past_of,
            unadapted=self._configuration.unadapted,
            on_inputs=changed,
            on_news=self._on_news,
            on_event=self._report_event,
        )

    def _report_event(self, unit: ComputationalUnit, event: ProcessEvent, text: str) -> None:
        self._configuration.report_unit(ChangeKind(event), unit, text)

    def _identity(
        self,
        transformation: str,
        terms: Sequence[Term],
        declaration: GeneratorDeclaration,
        schema: Schema | None,
        after: int | None,
    ) -> tuple[object, ...]:
        inputs = [self.term(term, after) for term in terms]
        output = self.stream(declaration.key, schema)
        parameters = {"kpl": format_kpl(declaration)}
        return self._configuration.identity(transformation, inputs, output, parameters)


def is_needed(life: StreamGenerator, after: int) -> bool:
    """Whether a past life may have samples available later than ``after`` (ns)."""
    return life.ends_at is not None and life.ends_at > after


def _past(life: StreamGenerator, policy: Policy) -> Past:
    """Return the samples that a mediation would have read of a past stream. The policy applies to
    the whole stream, since a label has no annotation when its life begins."""
    assert life.ends_at is not None
    segments = life.stream.since(0)
    if policy.is_default:
        return Past(life, [segment.batch for segment in segments], life.ends_at)
    adaptation = adapt(policy, rules=life.rules)
    batches = [batch for segment in segments for batch in adaptation.push(segment.batch)]
    return Past(life, [*batches, *adaptation.end()], life.ends_at)


def _required_terms(declaration: GeneratorDeclaration) -> Sequence[Term]:
    """Return the terms whose streams a generator needs to start. A mediation connects the others
    later."""
    match declaration.process:
        case Aggregate(_, _, members) | Select(_, _, members):
            return (members,)
        case _:
            return declaration.terms


def sort_name(name: str) -> str:
    """Return the canonical spelling of a sort, without the prefix of the domain."""
    return name.removeprefix("dyknow:")


def schema_text(sort: ValueSort | Schema) -> str:
    """Write fields as in KPL."""
    return ", ".join(f"{field.name} {field.type}" for field in sort.fields or ())
