"""Verifies a KPL specification on a recording ([DyKnow10 Def. 5.29, 5.35-5.38]).

The recording is replayed through the application of the specification. Then every stream with a
policy, declared or the inner term of a process, is compared with the definition: it has to be in
eval_fsterm of its term over the whole stream of its label. Every `join` and `sync` is compared with
its definition over its inputs. The definitions (`streams.policies.satisfaction`,
`streams.synchronization.tuple_definition`) share no code with the units that made the streams.
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
    """The result for one declared stream, inner term, `join` or `sync`.

    ``stream`` is its name; an inner term is its own name. ``refutation`` None: the stream is a
    maximal satisfying substream (Def. 5.35), or its tuples are those of Def. 5.11 or SPEC §1.
    ``as_recorded``: the first place where the recording itself violates the policy; None if it
    satisfies it. ``failure``: a unit behind the stream failed, or the grid of the policy is too
    long, so nothing was proved.
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
    """An application after the replay of a whole recording.

    ``failures`` are ``(stream, reason)``; ``broken`` has the first of these reasons for each stream
    that depends on a failed unit. ``units`` are those at the end, by output.
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

    Samples are ordered by available time. Those of streams that are no source are ignored, and no
    sink is called. ``runner`` calls the processes. Policies on streams with ``annotations`` apply
    to each object separately. Raises `UnknownFeature` for a unit without code, `Conflict` where the
    fields of a source differ from its sort, or lack an id field of its annotation. Memory: all
    samples of every stream.
    """
    failures: list[tuple[str, str]] = []

    def on_change(change: Change) -> None:
        if change.kind in _FAILURES:
            failures.append((change.stream, f"{change.kind}: {change.specification}"))

    configuration = Configuration(on_change)
    configuration.annotations = {each.stream: each for each in annotations}
    application = Application(
        configuration,
        processes,
        runner=runner,
        # The proofs compare whole streams, so no sample may be evicted.
        retention=Retention(samples=2**62),
        # Units may emit late samples: a rehearsal can wait for all, so each gets its place.
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
        source.lateness = 0  # their samples are in order
    recorded = _collect_samples(samples, sources)
    for name, batch in recorded.items():
        _check_names(name, batch, id_fields(annotated_contents(configuration, name)))
    # A foreach over streams of another foreach has to get its sets in order of time.
    configuring = [d for d in signature.declarations if isinstance(d, ForeachDeclaration)]
    for name, batch in _interleave(recorded) if len(configuring) > 1 else recorded.items():
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
    """Replay a recording and prove each declared stream. Arguments and errors: see `rehearse`."""
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
    """Return the first failure that each stream depends on."""
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


def _collect_samples(
    samples: Iterable[tuple[str, Incoming]], sources: Mapping[str, StreamGenerator]
) -> dict[str, SampleBatch]:
    """Collect the samples of each source in one batch, ordered by available time."""
    found: dict[str, list[SampleBatch]] = defaultdict(list)
    for name, incoming in samples:
        source = sources.get(name)
        if source is None or not len(incoming.batch):
            continue
        found[name].append(incoming.batch if source.is_open else _of_sort(source, incoming.batch))
    collected = {}
    for name, batches in found.items():
        batch = concatenate(batches)
        collected[name] = batch.take(np.argsort(batch.available, kind="stable"))
    return collected


def _of_sort(source: StreamGenerator, batch: SampleBatch) -> SampleBatch:
    """Convert recorded samples to the source's sort (Def. 5.31): integers to floats if needed."""
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
            "declare the source with a sort of these fields, or with an undeclared sort",
        )
    return SampleBatch(batch.available, batch.valid, columns)


def _check_names(source: str, batch: SampleBatch, keys: Sequence[str]) -> None:
    """Raise `Conflict` for id fields of an annotation that the recording lacks."""
    for key in keys:
        column = batch.columns.get(key)
        if column is None or column.type not in (FieldType.STRING, FieldType.INTEGER):
            found = "has no such field" if column is None else f"has a {column.type} there"
            raise Conflict(
                f"the annotation of {source} names objects by {key!r}, and the recording {found}",
                f"an id field is a string or an integer; there are: {', '.join(batch.columns)}",
            )


def _interleave(recorded: Mapping[str, SampleBatch]) -> Iterator[tuple[str, SampleBatch]]:
    """Yield the samples of all sources in order of available time, consecutive samples of one
    source as one batch."""
    names, times = list(recorded), [batch.available for batch in recorded.values()]
    if not names:
        return
    owner = np.repeat(np.arange(len(names)), [len(own) for own in times])
    owner = owner[np.argsort(np.concatenate(times), kind="stable")]
    bounds = np.flatnonzero(np.diff(owner)) + 1
    taken = [0] * len(names)
    for start, end in pairwise([0, *bounds.tolist(), len(owner)]):
        i = int(owner[start])
        yield names[i], recorded[names[i]].take(slice(taken[i], taken[i] + end - start))
        taken[i] += end - start


def _proof(rehearsal: Rehearsal, unit: AdaptationUnit, name: str, term: str) -> Proof:
    """Prove a stream with a policy."""
    policy, keys, (source,) = unit.policy, unit.keys, unit.inputs
    whole, output = unit.past_of(source), unit.output.stream.all()
    failure, refutation = rehearsal.broken.get(unit.output.name), None
    if failure is None:
        try:
            refutation = prove_each(output, whole, policy, keys)
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
    """Prove the stream of a `join` or `sync`."""
    output, kernel = unit.output.stream.all(), unit.kernel
    pasts = [unit.past_of(source) for source in unit.inputs]
    failure = rehearsal.broken.get(unit.output.name)
    refutation: Counterexample | None = None
    if isinstance(kernel, Join):
        inner_times = unit.inner_times
        inputs = [
            TupleInput(past, names, inner_times=inner_times)
            for past, names in zip(pasts, unit.field_names, strict=True)
        ]
        counters = PolicyCounters(sent=len(output))
        if failure is None:
            refutation = prove_join(output, inputs)
    else:
        last = max((end for end in kernel.ends if end is not None), default=None)
        ends = [None if end == last else end for end in kernel.ends]
        inputs = list(map(TupleInput, pasts, unit.field_names, kernel.monotone, ends))
        counted = kernel.counters
        counters = PolicyCounters(sent=counted.states, approximated=counted.approximated)
        counters.drop(Constraint.AVAILABLE, counted.late)
        counters.drop(Constraint.ORDER, counted.dropped)
        if failure is None:
            refutation = prove_states(output, inputs, kernel.policy)
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
