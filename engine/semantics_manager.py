"""The semantics manager: keeps the ontology equal to the running system
([Introspection15 §4.2]).

It is told each `Change` of the configuration and mirrors it into the stream-space graph. What it
asserts is exactly what `assertions` gives for the current configuration: a test compares.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from urllib.parse import quote

from pyoxigraph import Literal, NamedNode, Triple

from ..languages.ssl.annotation import Content, PortAnnotation, StreamAnnotation
from ..ontology.ontology import Ontology
from ..ontology.units import format_unit
from ..rdf.namespaces import RDF_TYPE, STREAM_SPACE
from .changes import Change, ChangeKind
from .transformations import Transformation


def term(name: str) -> NamedNode:
    """A term of the stream space: of the ontology, or an individual by its name, of which what an
    IRI cannot have is percent-encoded (``speed%5Bcar1%5D``)."""
    return NamedNode(STREAM_SPACE + quote(name, safe=""))


class SemanticsManager:
    """Mirrors the stream space into the ontology.

    ``annotation_of`` and ``transformation`` answer for the present.
    """

    def __init__(
        self,
        ontology: Ontology,
        annotation_of: Callable[[str], StreamAnnotation | None],
        transformations: Mapping[str, Transformation],
    ) -> None:
        self._ontology = ontology
        self._annotation_of = annotation_of
        self._transformations = transformations
        self._asserted: dict[tuple[str, str], frozenset[Triple]] = {}
        # Several units may say the same of their transformation: a triple goes with its last one.
        self._supported: Counter[Triple] = Counter()
        self._held: dict[Triple, bool] | None = None
        self._subscribers: dict[str, int] = {}

    @contextmanager
    def together(self) -> Iterator[None]:
        """Changes told meanwhile are mirrored in one piece at the end: it is cheaper."""
        if self._held is not None:
            yield
            return
        held = self._held = {}
        try:
            yield
        finally:
            self._held = None
            if held:
                self._ontology.mirror(
                    {triple for triple, there in held.items() if there},
                    {triple for triple, there in held.items() if not there},
                )

    def changed(self, change: Change) -> None:
        """Mirror one change."""
        match change.kind:
            case ChangeKind.STREAM_ADDED | ChangeKind.STREAM_ANNOTATED:
                annotation = self._annotation_of(change.stream)
                self._assert(("stream", change.stream), stream_triples(change.stream, annotation))
            case ChangeKind.STREAM_REMOVED:
                self._assert(("stream", change.stream), ())
                self._subscribers.pop(change.stream, None)
                self._assert(("subscribers", change.stream), ())
            case ChangeKind.UNIT_STARTED | ChangeKind.INPUTS_CHANGED:
                self._assert(("unit", change.unit), unit_triples(change))
            case ChangeKind.UNIT_STOPPED:
                self._assert(("unit", change.unit), ())
            case ChangeKind.TRANSFORMATION_ANNOTATED:
                described = self._transformations[change.transformation]
                self._assert(
                    ("transformation", change.transformation), transformation_triples(described)
                )
            case (
                ChangeKind.STREAM_ENDED
                | ChangeKind.UNIT_FAILED
                | ChangeKind.UNIT_RESTARTED
                | ChangeKind.UNIT_STOPPED_BY_RULE
                | ChangeKind.NOT_RESTORED
            ):
                pass  # the structure of the stream space is as it was

    def count_subscribers(self, counts: Iterable[tuple[str, int]]) -> None:
        """Mirror how many subscribers each stream has. Cost: a look at each, and what changed."""
        changed = [(n, count) for n, count in counts if self._subscribers.get(n) != count]
        with self.together():
            for name, count in changed:
                self._subscribers[name] = count
                counted = Triple(term(name), term("hasSubscriberCount"), Literal(count))
                self._assert(("subscribers", name), (counted,))

    def assertions(self) -> frozenset[Triple]:
        """All that is asserted now."""
        return frozenset(self._supported)

    def _assert(self, key: tuple[str, str], triples: Iterable[Triple]) -> None:
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
        if self._held is None:
            self._ontology.mirror(added, removed)
        else:
            self._held.update(dict.fromkeys(removed, False) | dict.fromkeys(added, True))


def stream_triples(name: str, annotation: StreamAnnotation | None) -> Iterable[Triple]:
    """A stream and its annotation, in the shape of [Introspection15 Listing 3]."""
    stream = term(name)
    yield Triple(stream, RDF_TYPE, term("Stream"))
    yield Triple(stream, term("hasName"), Literal(name))
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


def unit_triples(change: Change) -> Iterable[Triple]:
    """A computational unit, in the shape of [Introspection15 Listing 2]."""
    unit = term(change.unit)
    yield Triple(unit, RDF_TYPE, term(change.role))
    yield Triple(unit, term("hasName"), Literal(change.unit))
    for source in change.inputs:
        yield Triple(unit, term("hasInput"), term(source))
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


def transformation_triples(described: Transformation) -> Iterable[Triple]:
    """A transformation with its annotation, in the shape of [Introspection15 Listing 3]."""
    name = described.name
    label = term(name)
    yield Triple(label, RDF_TYPE, term("Transformation"))
    yield Triple(label, term("hasName"), Literal(name))
    yield Triple(label, term("hasCost"), Literal(described.cost))
    yield Triple(label, term("hasQuality"), Literal(described.quality))
    node = term(f"{name}_annotation")
    yield Triple(label, term("hasAnnotation"), node)
    yield Triple(node, RDF_TYPE, term("Annotation"))
    output = term(f"{name}_annotation_output")
    yield Triple(node, term("hasOutputAnnotation"), output)
    yield from _port(output, "OutputAnnotation", described.annotation.output)
    holder, link = node, term("hasInputAnnotation")
    for i, port in enumerate(described.annotation.inputs, start=1):
        # The order of inputs is kept by a chain of segments.
        segment = term(f"{name}_annotation_input{i}")
        yield Triple(holder, link, segment)
        yield from _port(segment, "InputAnnotation", port)
        holder = term(f"{name}_annotation_segment{i}")
        if i < len(described.annotation.inputs):
            yield Triple(segment, term("nextSegment"), holder)


def _port(node: NamedNode, kind: str, port: PortAnnotation) -> Iterable[Triple]:
    yield Triple(node, RDF_TYPE, term(kind))
    yield from _describes(node, port.feature, format_unit(port.unit))
    yield Triple(node, term("describesSort"), NamedNode("http://www.ida.liu.se/dyknow/Thing"))


def _describes(node: NamedNode, feature: str, unit: str) -> Iterable[Triple]:
    yield Triple(node, term("describesFeature"), NamedNode(feature))
    yield Triple(node, term("hasUnit"), Literal(unit))


def _roles(node: NamedNode, content: Content) -> Iterable[Triple]:
    for role in content.roles:
        if role.sort is not None:
            yield Triple(node, term("describesSort"), NamedNode(role.sort))
        if role.object is not None:
            yield Triple(node, term("describesObject"), NamedNode(role.object))
