"""Proving a KPL specification on a recording ([DyKnow10 Def. 5.29, 5.35-5.38]).

The recording is replayed through the application that the specification declares. Then every
declared stream is held against the definition: it must be in eval_fsterm of its term over the
whole stream of its label. The definitions (`streams.satisfaction`) share nothing with what made
the streams.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from ..converters.wire import Incoming
from ..languages.kpl import Signature, SourceDeclaration, StreamDeclaration, format_term
from ..rdf.dictionary import TermDictionary
from ..streams.fluent import Retention
from ..streams.policy import Approximation, PolicyCounters
from ..streams.satisfaction import Counterexample, prove, satisfies
from ..streams.time import TIME_MAX
from .application import Application
from .changes import Change, ChangeKind
from .configuration import Configuration
from .errors import Conflict
from .processes import Processes
from .stream_units import AdaptationUnit
from .supervision import DIRECT, Runner

_FAILURES = (ChangeKind.UNIT_FAILED, ChangeKind.UNIT_STOPPED_BY_RULE)


@dataclass(frozen=True, slots=True)
class Proof:
    """What was found for one declared stream.

    ``refutation`` None: the stream is a maximal satisfying substream, as Def. 5.35 asks.
    ``as_recorded`` is the first place where the label's own stream would have broken the policy,
    None where it holds of the recording as it is. ``failure``: a unit behind the stream failed.
    """

    stream: str
    term: str
    received: int
    counters: PolicyCounters
    refutation: Counterexample | None
    as_recorded: Counterexample | None
    failure: str | None

    @property
    def holds(self) -> bool:
        return self.refutation is None and self.failure is None


def prove_specification(
    signature: Signature,
    processes: Processes,
    samples: Iterable[tuple[str, Incoming]],
    runner: Runner = DIRECT,
) -> tuple[Proof, ...]:
    """Replay ``samples`` (source and batch, in order of available time) and prove each stream.

    Samples of streams that are no source are passed over. ``runner`` calls the processes. Raises
    `UnknownFeature` for a unit without an implementation, `Conflict` where a source's fields are
    not those of its sort, or two of its samples have one available time.
    Memory: the whole of every stream.
    """
    # However late a sample stands in the recording, it takes its place by its available time.
    failures: list[tuple[str, str]] = []

    def told(change: Change) -> None:
        if change.kind in _FAILURES:
            failures.append((change.stream, f"{change.kind}: {change.specification}"))

    configuration = Configuration(TermDictionary(), {}, told)
    application = Application(
        configuration,
        processes,
        runner=runner,
        retention=Retention(samples=2**62),
        lateness=TIME_MAX,
        rehearsal=True,
    )
    application.add(signature.declarations)
    sources = {
        declaration.name: configuration.stream(declaration.name)
        for declaration in signature.declarations
        if isinstance(declaration, SourceDeclaration)
    }
    for name, incoming in samples:
        source = sources.get(name)
        if source is None:
            continue
        recorded = tuple(incoming.batch.columns)
        if not source.is_open and recorded != source.schema.names:
            raise Conflict(
                f"source {name!r} has the fields {', '.join(source.schema.names)}; "
                f"recorded are {', '.join(recorded)}",
                "give the source a sort with these fields, or one that nobody has declared",
            )
        source.offer(incoming.batch)
        application.settle()
    for source in sources.values():
        source.end()
        application.settle()
        lost = source.counters.duplicate + source.counters.late
        if lost:
            raise Conflict(
                f"source {source.name!r}: {lost} of {source.counters.accepted} recorded samples "
                "have the available time of another one",
                "available times are unique within a stream (Def. 5.4): mend the recording, or "
                "leave its available times out to have them made from the valid times",
            )
    return tuple(
        _proof(application, failures, declaration)
        for declaration in signature.declarations
        if isinstance(declaration, StreamDeclaration)
    )


def _proof(
    application: Application, failures: list[tuple[str, str]], declaration: StreamDeclaration
) -> Proof:
    policy = declaration.term.policy
    label = str(declaration.term.label)
    source, output = application.stream_of(label), application.stream_of(declaration.name)
    unit = application.process_of(declaration.name)
    assert source is not None
    assert output is not None
    assert isinstance(unit, AdaptationUnit)
    whole, made = source.stream.all(), output.stream.all()
    failed = [reason for name, reason in failures if name in (source.name, output.name)]
    approximates = policy.approximation is Approximation.MOST_RECENT
    return Proof(
        stream=declaration.name,
        term=format_term(declaration.term),
        received=len(whole),
        counters=unit.policy_counters,
        refutation=prove(made, whole, policy),
        as_recorded=None if approximates and not len(whole) else satisfies(whole, policy),
        failure=failed[0] if failed else None,
    )
