"""Proving a KPL specification on a recording ([DyKnow10 Def. 5.29, 5.35-5.38]).

The recording is replayed through the application that the specification declares. Then every
stream with a policy, declared or the inner term of a process, is held against the definition: it
must be in eval_fsterm of its term over the whole stream of its label. Every `join` and `sync` is
held against its definition over its inputs. The definitions (`streams.policies.satisfaction`,
`streams.synchronization.tuple_definition`) share nothing with what made the streams.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ...converters.wire import Incoming
from ...languages.kpl import (
    ForeachDeclaration,
    Signature,
    SourceDeclaration,
    StreamDeclaration,
    format_term,
)
from ...languages.ssl.annotation import StreamAnnotation, id_fields
from ...streams.generator import StreamGenerator
from ...streams.history import Retention
from ...streams.joins.join import Join
from ...streams.policies.policy import (
    Approximation,
    Constraint,
    PolicyCounters,
    PolicyError,
)
from ...streams.policies.satisfaction import (
    Counterexample,
    prove_each,
    satisfies_each,
)
from ...streams.sample import (
    Column,
    Field,
    FieldType,
    SampleBatch,
    Schema,
    concatenate,
)
from ...streams.synchronization.tuple_definition import (
    TupleInput,
    prove_join,
    prove_states,
)
from ...streams.time import TIME_MAX
from ..configuration.configuration import Configuration
from ..configuration.policy_keys import annotated_contents
from ..model.errors import Conflict
from ..model.status_changes import Change, ChangeKind
from ..processes.registry import Processes
from ..processes.supervision import DIRECT, Runner
from ..units.base import ComputationalUnit
from ..units.policy import AdaptationUnit, TupleUnit
from .application import Application
from .network import schema_text

_FAILURES = (ChangeKind.UNIT_FAILED, ChangeKind.UNIT_STOPPED_BY_RULE)


@dataclass(frozen=True, slots=True)
class Proof:
    """What was found for one declared stream, inner term, `join` or `sync`.

    ``stream`` names it: an inner term is its own name. ``refutation`` None: the stream is a maximal
    satisfying substream, as Def. 5.35 asks, or its tuples are those of Def. 5.11 or of SPEC §1.
    ``as_recorded`` is the first place where the label's own stream would have broken the policy,
    None where it holds of the recording as it is. ``failure``: a unit behind the stream failed, or
    the grid of the policy is too long; then nothing was proved.
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


@dataclass(frozen=True, slots=True)
class Rehearsal:
    """An application with a whole recording behind it.

    ``failures`` are ``(stream, reason)``; ``broken`` says of each stream that has a failed unit
    behind it why the first of these failed. ``units`` are there at the end, by their output.
    """

    application: Application
    failures: Sequence[tuple[str, str]]
    broken: Mapping[str, str]
    units: Mapping[str, ComputationalUnit]


def rehearse(
    signature: Signature,
    processes: Processes,
    samples: Iterable[tuple[str, Incoming]],
    runner: Runner = DIRECT,
    annotations: Iterable[StreamAnnotation] = (),
) -> Rehearsal:
    """Replay ``samples`` (source and batch, in any order) through a specification.

    Every sample takes its place by its available time. Samples of streams that are no source are
    passed over, and no sink is called. ``runner`` calls the processes. Policies on streams with
    ``annotations`` hold for each object by itself. Raises `UnknownFeature` for a unit without an
    implementation, `Conflict` where a source's fields are not those of its sort, or an annotation
    names objects by a field that it does not have. Memory: the whole of every stream.
    """
    failures: list[tuple[str, str]] = []

    def told(change: Change) -> None:
        if change.kind in _FAILURES:
            failures.append((change.stream, f"{change.kind}: {change.specification}"))

    configuration = Configuration(told)
    configuration.annotations = {each.stream: each for each in annotations}
    application = Application(
        configuration,
        processes,
        runner=runner,
        retention=Retention(samples=2**62),
        # What a unit makes later than it may is kept for its place, as there is time.
        lateness=TIME_MAX,
        rehearsal=True,
    )
    application.add(signature.declarations)
    sources = {
        declaration.name: configuration.stream(declaration.name)
        for declaration in signature.declarations
        if isinstance(declaration, SourceDeclaration)
    }
    for source in sources.values():
        source.lateness = 0  # they are given in order
    recorded = _recorded(samples, sources)
    for name, batch in recorded.items():
        _check_names(name, batch, id_fields(annotated_contents(configuration, name)))
    # A foreach over what another makes has to hear of its sets in time.
    configuring = [d for d in signature.declarations if isinstance(d, ForeachDeclaration)]
    for name, batch in _runs(recorded) if len(configuring) > 1 else recorded.items():
        sources[name].offer(batch)
        application.settle()
    for source in sources.values():
        source.end()
        application.settle()
    return Rehearsal(application, failures, _broken(configuration, failures), configuration.units)


def prove_specification(
    signature: Signature,
    processes: Processes,
    samples: Iterable[tuple[str, Incoming]],
    runner: Runner = DIRECT,
    annotations: Iterable[StreamAnnotation] = (),
) -> tuple[Proof, ...]:
    """Replay a recording and prove each declared stream; arguments and errors as of `rehearse`."""
    rehearsal = rehearse(signature, processes, samples, runner, annotations)
    application = rehearsal.application
    proofs: list[Proof] = []
    declared = [d for d in signature.declarations if isinstance(d, StreamDeclaration)]
    for declaration in declared:
        unit = application.process_of(declaration.name)
        assert isinstance(unit, AdaptationUnit)
        proofs.append(_proof(rehearsal, unit, declaration.name, format_term(declaration.term)))
    names = {declaration.name for declaration in declared}
    for name, other in sorted(rehearsal.units.items()):
        if isinstance(other, AdaptationUnit) and name not in names:
            term = other.parameters["term"]
            proofs.append(_proof(rehearsal, other, term, term))
        elif isinstance(other, TupleUnit):
            proofs.append(_tuple_proof(rehearsal, other))
    return tuple(proofs)


def _broken(configuration: Configuration, failures: Sequence[tuple[str, str]]) -> Mapping[str, str]:
    """Of each stream that has a failed unit behind it, why the first of these failed."""
    if not failures:
        return {}
    broken: dict[str, str] = {}
    for unit in configuration.units.values():
        parts = configuration.upstream_units(unit)
        names = {part.output.name for part in parts}
        names.update(source.name for part in parts for source in part.inputs)
        reasons = [reason for name, reason in failures if name in names]
        if reasons:
            broken[unit.output.name] = reasons[0]
    return broken


def _recorded(
    samples: Iterable[tuple[str, Incoming]], sources: Mapping[str, StreamGenerator]
) -> dict[str, SampleBatch]:
    """All samples of each source in one batch, by available time."""
    found: dict[str, list[SampleBatch]] = defaultdict(list)
    for name, incoming in samples:
        source = sources.get(name)
        if source is None or not len(incoming.batch):
            continue
        found[name].append(incoming.batch if source.is_open else _of_sort(source, incoming.batch))
    whole = {}
    for name, batches in found.items():
        batch = concatenate(batches)
        whole[name] = batch.take(np.argsort(batch.available, kind="stable"))
    return whole


def _of_sort(source: StreamGenerator, batch: SampleBatch) -> SampleBatch:
    """Recorded samples as values of the source's sort (Def. 5.31): whole numbers are floats too."""
    names = [name for name in source.schema.names if name in batch.columns]
    columns = {name: batch.columns[name] for name in dict.fromkeys([*names, *batch.columns])}
    for field in source.schema.fields:
        column = columns.get(field.name)
        if column is None:
            continue
        if (column.type, field.type) == (FieldType.INTEGER, FieldType.FLOAT):
            columns[field.name] = Column(field.type, column.values.astype(np.float64), column.null)
        elif column.type is field.type is FieldType.STRING:
            columns[field.name] = column.recoded(source.stream.pools[field.name])
    recorded = Schema(tuple(Field(name, column.type) for name, column in columns.items()))
    if recorded != source.schema:
        raise Conflict(
            f"source {source.name!r} has the fields {schema_text(source.schema)}; "
            f"recorded are {schema_text(recorded)}",
            "give the source a sort with these fields, or one that nobody has declared",
        )
    return SampleBatch(batch.available, batch.valid, columns)


def _check_names(source: str, batch: SampleBatch, keys: Sequence[str]) -> None:
    """Raises `Conflict` for id fields of an annotation that a recording does not have."""
    for key in keys:
        column = batch.columns.get(key)
        if column is None or column.type not in (FieldType.STRING, FieldType.INTEGER):
            found = "has no such field" if column is None else f"has a {column.type} there"
            raise Conflict(
                f"the annotation of {source} names objects by {key!r}, and the recording {found}",
                f"an id field is a string or an integer; there are: {', '.join(batch.columns)}",
            )


def _runs(recorded: Mapping[str, SampleBatch]) -> Iterator[tuple[str, SampleBatch]]:
    """The samples of all sources in order of available time, as long as one source goes on."""
    names, times = list(recorded), [batch.available for batch in recorded.values()]
    if not names:
        return
    owner = np.repeat(np.arange(len(names)), [len(own) for own in times])
    owner = owner[np.argsort(np.concatenate(times), kind="stable")]
    bounds = np.flatnonzero(np.diff(owner)) + 1
    done = [0] * len(names)
    for start, end in pairwise([0, *bounds.tolist(), len(owner)]):
        i = int(owner[start])
        yield names[i], recorded[names[i]].take(slice(done[i], done[i] + end - start))
        done[i] += end - start


def _proof(rehearsal: Rehearsal, unit: AdaptationUnit, name: str, term: str) -> Proof:
    """Of a stream with a policy."""
    policy, keys, (source,) = unit.policy, unit.keys, unit.inputs
    whole, made = unit.past_of(source), unit.output.stream.all()
    failure, refutation = rehearsal.broken.get(unit.output.name), None
    if failure is None:
        try:
            refutation = prove_each(made, whole, policy, keys)
        except PolicyError as error:
            failure = f"PolicyError: {error}"
    approximates = policy.approximation is Approximation.MOST_RECENT
    return Proof(
        stream=name,
        term=term,
        received=len(whole),
        counters=unit.policy_counters,
        refutation=refutation,
        as_recorded=None
        if approximates and not len(whole)
        else satisfies_each(whole, policy, keys),
        failure=failure,
    )


def _tuple_proof(rehearsal: Rehearsal, unit: TupleUnit) -> Proof:
    """Of a `join` or `sync`."""
    made, kernel = unit.output.stream.all(), unit.kernel
    pasts = [unit.past_of(source) for source in unit.inputs]
    failure = rehearsal.broken.get(unit.output.name)
    refutation: Counterexample | None = None
    if isinstance(kernel, Join):
        timed = unit.inner_times
        inputs = [
            TupleInput(past, names, inner_times=timed)
            for past, names in zip(pasts, unit.field_names, strict=True)
        ]
        counters = PolicyCounters(sent=len(made))
        if failure is None:
            refutation = prove_join(made, inputs)
    else:
        last = max((end for end in kernel.ends if end is not None), default=None)
        ends = [None if end == last else end for end in kernel.ends]
        inputs = list(map(TupleInput, pasts, unit.field_names, kernel.monotone, ends))
        counted = kernel.counters
        counters = PolicyCounters(sent=counted.states, approximated=counted.approximated)
        counters.drop(Constraint.AVAILABLE, counted.late)
        counters.drop(Constraint.ORDER, counted.dropped)
        if failure is None:
            refutation = prove_states(made, inputs, kernel.policy)
    counters.received = sum(map(len, pasts))
    return Proof(
        stream=unit.output.name,
        term=unit.parameters["kpl"],
        received=counters.received,
        counters=counters,
        refutation=refutation,
        as_recorded=None,
        failure=failure,
    )
