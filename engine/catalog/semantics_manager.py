"""The semantics manager: keeps the ontology equal to the running system
([Introspection15 §4.2]).

It listens to the status stream. It mirrors each `Change` to the stream-space graph of the ontology
and to the `StreamSpace` of semantic matching; no other code writes to either. A test compares
`assertions` with the configuration.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from functools import lru_cache
from urllib.parse import quote

from pyoxigraph import Literal, NamedNode, Triple

from ...languages.ssl.annotation import (
    Argument,
    Content,
    PortAnnotation,
    StreamAnnotation,
)
from ...matching.space import StreamDescription, StreamSpace
from ...ontology.ontology import Ontology
from ...ontology.units import format_unit
from ...ontology.vocabulary import SELF, THING
from ...rdf.namespaces import RDF_TYPE, STREAM_SPACE, XSD
from ...streams.generator import StreamGenerator
from ...streams.time import format_time
from ..model.status_changes import Change, ChangeKind, KnownTransformation
from ..model.status_stream import STATUS


# Bounded, since names come without end; large enough for the ontology and the present changes.
@lru_cache(maxsize=4096)
def term(name: str) -> NamedNode:
    """Return a term of the stream space: a term of its ontology, or an individual by its name.
    Characters that an IRI cannot have are percent-encoded (``speed%5Bcar1%5D``)."""
    return NamedNode(STREAM_SPACE + quote(name, safe=""))


_DATE_TIME = NamedNode(XSD + "dateTime")
_HAS_RATE = term("hasRate")
_HAS_SUBSCRIBER_COUNT = term("hasSubscriberCount")


class SemanticsManager:
    """Mirrors the stream space into the ontology, and into ``space``.

    ``annotations`` has the annotations of streams by name. ``subscribers`` returns the present
    number of a stream's readers for `space`.
    """

    def __init__(self, ontology: Ontology, subscribers: Callable[[str], int]) -> None:
        self.space = StreamSpace(subscribers=subscribers)
        self.annotations: dict[str, StreamAnnotation] = {}
        self._ontology = ontology
        self._makers: dict[str, str] = {}
        self._qualities: dict[str, float] = {}
        self._asserted: dict[tuple[str, str], frozenset[Triple]] = {}
        # Several units may assert the same triple of their transformation. Its count says when the
        # last of them is gone.
        self._supported: Counter[Triple] = Counter()
        self._deferred: dict[Triple, bool] | None = None
        self._subscribers: dict[str, int] = {}
        self._rates: dict[str, float] = {}
        self._sampled: dict[str, tuple[bool, bool]] = {}

    @contextmanager
    def together(self) -> Iterator[None]:
        """Mirror the changes within this context in one write at its end, which is cheaper."""
        if self._deferred is not None:
            yield
            return
        deferred = self._deferred = {}
        try:
            yield
        finally:
            # Changes before an error have happened, so they are mirrored as well.
            self._deferred = None
            if deferred:
                self._ontology.mirror(
                    {triple for triple, is_added in deferred.items() if is_added},
                    {triple for triple, is_added in deferred.items() if not is_added},
                )

    def mirror(self, change: Change) -> None:
        """Mirror one change."""
        match change.kind:
            case ChangeKind.STREAM_ADDED:
                self._mirror_stream(change.stream)
                if change.stream == STATUS:
                    self._assert(("engine", STATUS), engine_triples())
            case ChangeKind.STREAM_ANNOTATED:
                self._annotate(change)
            case ChangeKind.QUALITY_CHANGED if change.stream:
                assert change.quality is not None
                self._qualities[change.stream] = change.quality
                self._mirror_stream(change.stream)
            case ChangeKind.STREAM_NAMED:
                self._assert(("aliases", change.stream), alias_triples(change))
            case ChangeKind.STREAM_REMOVED:
                self._forget_stream(change.stream)
            case ChangeKind.UNIT_STARTED | ChangeKind.INPUTS_CHANGED:
                self._makers[change.stream] = change.transformation
                self._assert(("unit", change.unit), unit_triples(change))
            case ChangeKind.UNIT_STOPPED:
                self._assert(("unit", change.unit), ())
            case ChangeKind.TRANSFORMATION_ANNOTATED | ChangeKind.QUALITY_CHANGED:
                assert change.described is not None
                self.space.put_transformation(change.described.description)
                self._assert(
                    ("transformation", change.transformation),
                    transformation_triples(change.described),
                )
            case ChangeKind.TRANSFORMATION_REMOVED:
                self.space.discard_transformation(change.transformation)
                self._assert(("transformation", change.transformation), ())
            case (
                ChangeKind.STREAM_ENDED
                | ChangeKind.UNIT_FAILED
                | ChangeKind.UNIT_RESTARTED
                | ChangeKind.LIMIT_REACHED
                | ChangeKind.UNIT_STOPPED_BY_RULE
                | ChangeKind.NOT_RESTORED
                | ChangeKind.STATE_LOST
                | ChangeKind.REFUSED
            ):
                pass  # these do not change the structure of the stream space

    def _annotate(self, change: Change) -> None:
        if change.annotation is None:
            self.annotations.pop(change.stream, None)
        else:
            self.annotations[change.stream] = change.annotation
        self._mirror_stream(change.stream)

    def _mirror_stream(self, stream: str) -> None:
        """Mirror a stream with its annotation and quality."""
        annotation = self.annotations.get(stream)
        quality = self._qualities.get(stream)
        if annotation is None:
            self.space.discard_stream(stream)
        else:
            description = StreamDescription(
                stream,
                annotation.contents,
                1.0 if quality is None else quality,
                maker=self._makers.get(stream, ""),
            )
            self.space.put_stream(description)
        self._assert(("stream", stream), stream_triples(stream, annotation, quality))

    def _forget_stream(self, stream: str) -> None:
        self.annotations.pop(stream, None)
        self._qualities.pop(stream, None)
        self._makers.pop(stream, None)
        self._subscribers.pop(stream, None)
        self.space.forget_stream(stream)
        self._assert(("stream", stream), ())
        self._assert(("aliases", stream), ())
        self._assert(("subscribers", stream), ())
        self._rates.pop(stream, None)
        self._assert(("rate", stream), ())
        self._sampled.pop(stream, None)
        self._assert(("sample", stream), ())

    def measure_rates(self, rates: Iterable[tuple[str, float]]) -> None:
        """Mirror the rate of each stream, in samples a second, to two digits.

        A change by less than a twentieth is ignored. Otherwise chance alone would cause writes all
        the time.
        """
        changed = [(name, rate) for name, rate in rates if self._has_changed(name, rate)]
        with self.together():
            for name, rate in changed:
                self._rates[name] = rate
                triple = Triple(term(name), _HAS_RATE, Literal(float(f"{rate:.2g}")))
                self._assert(("rate", name), (triple,))

    def mirror_samples(self, streams: Iterable[tuple[str, StreamGenerator]]) -> None:
        """Mirror whether each stream has a sample, and the sample of each constant stream: one that
        ended with a single sample ([Introspection15 §3.1]). Cost: O(streams), and the changes."""
        with self.together():
            for name, generator in streams:
                state = generator.counters.used > 0, generator.is_constant
                if self._sampled.get(name, (False, False)) != state:
                    self._sampled[name] = state
                    triples = sample_triples(name, generator, generator.is_constant)
                    self._assert(("sample", name), triples)

    def _has_changed(self, stream: str, rate: float) -> bool:
        before = self._rates.get(stream)
        return before is None or abs(rate - before) > before / 20

    def count_subscribers(self, counts: Iterable[tuple[str, int]]) -> None:
        """Mirror the number of each stream's subscribers. Cost: O(streams), and the changes."""
        changed = [(n, count) for n, count in counts if self._subscribers.get(n) != count]
        with self.together():
            for name, count in changed:
                self._subscribers[name] = count
                triple = Triple(term(name), _HAS_SUBSCRIBER_COUNT, Literal(count))
                self._assert(("subscribers", name), (triple,))

    def assertions(self) -> frozenset[Triple]:
        """Return all triples that it asserts now."""
        return frozenset(self._supported)

    def _assert(self, key: tuple[str, str], triples: Iterable[Triple]) -> None:
        """Replace the triples asserted under ``key``."""
        before = self._asserted.pop(key, frozenset())
        after = frozenset(triples)
        if after:
            self._asserted[key] = after
        added = {triple for triple in after - before if not self._supported[triple]}
        self._supported.update(after - before)
        self._supported.subtract(before - after)
        removed = {triple for triple in before - after if not self._supported[triple]}
        for triple in removed:
            del self._supported[triple]
        if self._deferred is None:
            self._ontology.mirror(added, removed)
        else:
            # The last change of a triple within the context counts.
            self._deferred.update(dict.fromkeys(removed, False) | dict.fromkeys(added, True))


def stream_triples(
    name: str, annotation: StreamAnnotation | None, quality: float | None = None
) -> Iterable[Triple]:
    """Return a stream and its annotation, in the shape of [Introspection15 Listing 3]."""
    stream = term(name)
    yield Triple(stream, RDF_TYPE, term("Stream"))
    yield Triple(stream, term("hasName"), Literal(name))
    if quality is not None:
        yield Triple(stream, term("hasQuality"), Literal(quality))
    if annotation is None:
        return
    node = term(f"{name}_annotation")
    yield Triple(stream, term("hasAnnotation"), node)
    yield Triple(node, RDF_TYPE, term("Annotation"))
    for i, content in enumerate(annotation.contents, start=1):
        segment = term(f"{name}_annotation_output{i}")
        yield Triple(node, term("hasOutputAnnotation"), segment)
        yield Triple(segment, RDF_TYPE, term("OutputAnnotation"))
        yield from _describes(segment, content.feature, format_unit(content.unit))
        yield from _roles(segment, content)


def engine_triples() -> Iterable[Triple]:
    """Return the stream processing engine, the first computational unit
    ([Introspection15 §4.2])."""
    engine = term("dyknow_engine")
    yield Triple(engine, RDF_TYPE, term("StreamProcessingEngine"))
    yield Triple(engine, term("hasName"), Literal("dyknow_engine"))
    yield Triple(engine, term("hasOutput"), term(STATUS))


def sample_triples(name: str, generator: StreamGenerator, is_constant: bool) -> Iterable[Triple]:
    """Return that a stream has a sample; for a constant stream with the sample's times."""
    if not generator.counters.used:
        return
    stream, sample = term(name), term(f"{name}_sample")
    yield Triple(stream, term("hasSample"), sample)
    yield Triple(sample, RDF_TYPE, term("Sample"))
    samples = generator.stream.all()
    if not is_constant or not len(samples):
        return
    yield Triple(stream, RDF_TYPE, term("ConstantStream"))
    for link, times in (("hasAvailableTime", samples.available), ("hasValidTime", samples.valid)):
        time = Literal(format_time(int(times[0])), datatype=_DATE_TIME)
        yield Triple(sample, term(link), time)


def alias_triples(change: Change) -> Iterable[Triple]:
    """Return the further names of a stream."""
    for alias in change.aliases:
        yield Triple(term(change.stream), term("hasAlias"), Literal(alias))


def unit_triples(change: Change) -> Iterable[Triple]:
    """Return a computational unit, in the shape of [Introspection15 Listing 2]."""
    unit = term(change.unit)
    yield Triple(unit, RDF_TYPE, term(change.role))
    yield Triple(unit, term("hasName"), Literal(change.unit))
    # The transformation has these inputs; their synchronization is an addition of the engine.
    for source in change.unsynchronized or change.inputs:
        yield Triple(unit, term("hasInput"), term(source))
    if change.synchronization:
        yield Triple(unit, term("hasSynchronization"), term(change.synchronization))
    if change.stream:
        yield Triple(unit, term("hasOutput"), term(change.stream))
    yield Triple(unit, term("instantiationOf"), term(change.transformation))
    yield Triple(term(change.transformation), RDF_TYPE, term("Transformation"))
    if change.policy:
        policy = term(f"{change.stream}_policy")
        yield Triple(term(change.stream), term("hasPolicy"), policy)
        yield Triple(policy, RDF_TYPE, term("Policy"))
        yield Triple(policy, term("hasText"), Literal(change.policy))
    specification = term(f"{change.unit}_specification")
    yield Triple(unit, term("hasSpecification"), specification)
    yield Triple(specification, RDF_TYPE, term("Specification"))
    yield Triple(specification, term("hasName"), Literal(change.specification))


def transformation_triples(described: KnownTransformation) -> Iterable[Triple]:
    """Return a transformation and its annotation, in the shape of [Introspection15 Listing 3]."""
    description = described.description
    name = description.name
    label = term(name)
    yield Triple(label, RDF_TYPE, term("Transformation"))
    yield Triple(label, term("hasName"), Literal(name))
    yield Triple(label, term("hasCost"), Literal(description.cost))
    yield Triple(label, term("hasQuality"), Literal(description.quality))
    yield from _implementation(label, described)
    node = term(f"{name}_annotation")
    yield Triple(label, term("hasAnnotation"), node)
    yield Triple(node, RDF_TYPE, term("Annotation"))
    output = term(f"{name}_annotation_output")
    yield Triple(node, term("hasOutputAnnotation"), output)
    yield from _port(output, "OutputAnnotation", description.output, description.arguments)
    holder, link = node, term("hasInputAnnotation")
    for i, port in enumerate(description.inputs, start=1):
        # Triples have no order, so a chain of segments keeps that of the inputs.
        segment = term(f"{name}_annotation_input{i}")
        yield Triple(holder, link, segment)
        yield from _port(segment, "InputAnnotation", port, port.arguments)
        holder = term(f"{name}_annotation_segment{i}")
        if i < len(description.inputs):
            yield Triple(segment, term("nextSegment"), holder)


def _implementation(label: NamedNode, described: KnownTransformation) -> Iterable[Triple]:
    code = term(f"{described.implementation}_implementation")
    yield Triple(label, term("hasImplementation"), code)
    yield Triple(code, RDF_TYPE, term("Implementation"))
    yield Triple(code, term("hasName"), Literal(described.implementation))
    for name, value in described.parameters:
        parameter = term(f"{label.value.removeprefix(STREAM_SPACE)}_parameter_{name}")
        yield Triple(label, term("hasParameter"), parameter)
        yield Triple(parameter, RDF_TYPE, term("Parameter"))
        yield Triple(parameter, term("hasName"), Literal(name))
        yield Triple(parameter, term("hasText"), Literal(value))


def _port(
    node: NamedNode, kind: str, port: PortAnnotation, arguments: Sequence[Argument]
) -> Iterable[Triple]:
    yield Triple(node, RDF_TYPE, term(kind))
    yield from _describes(node, port.feature, format_unit(port.unit))
    for argument in arguments:
        # Listing 3 writes `:describesSort :self`.
        iri = argument.object or argument.sort or THING
        is_object = argument.object is not None and argument.object != SELF
        link = "describesObject" if is_object else "describesSort"
        yield Triple(node, term(link), NamedNode(iri))
    if not arguments:
        yield Triple(node, term("describesSort"), NamedNode(THING))


def _describes(node: NamedNode, feature: str, unit: str) -> Iterable[Triple]:
    yield Triple(node, term("describesFeature"), NamedNode(feature))
    yield Triple(node, term("hasUnit"), Literal(unit))


def _roles(node: NamedNode, content: Content) -> Iterable[Triple]:
    for role in content.roles:
        if role.sort is not None:
            yield Triple(node, term("describesSort"), NamedNode(role.sort))
        if role.object is not None:
            yield Triple(node, term("describesObject"), NamedNode(role.object))
