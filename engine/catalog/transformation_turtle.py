"""Reads annotations and transformations in Turtle, in the form of [Introspection15 Listing 3]."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence

from pyoxigraph import BlankNode, Literal, NamedNode, Triple

from ...languages.ssl.check import variable_name
from ...ontology.reasoning import DIRECT, Reasoning
from ...rdf.namespaces import RDF, STREAM_SPACE, shorten
from ..model.errors import BadArguments
from .iri_annotations import (
    DescribedArgument,
    DescribedPort,
    DescribedStream,
    DescribedTransformation,
)

_TYPE = RDF + "type"
_NIL = NamedNode(RDF + "nil")
_LISTING = (
    ":name a :Transformation ; :hasAnnotation [ :hasInputAnnotation [ :describesFeature … ; "
    ":describesSort … ] ; :hasOutputAnnotation [ … ] ]"
)


def read_transformations(
    text: str, reasoning: Reasoning = DIRECT
) -> tuple[DescribedTransformation, ...]:
    """Return each ``:Transformation`` of a Turtle text, in the order of their nodes.

    Inputs are in the order of ``:nextSegment``. The name of a field is its ``:hasName``, or that of
    its feature. ``reasoning`` parses the text. Raises `OntologyError` with line and column, and
    `BadArguments` for an incomplete description.
    """
    graph = _Graph(reasoning.read(text, "turtle", NamedNode(STREAM_SPACE.rstrip("#"))))
    found = graph.subjects(_TYPE, STREAM_SPACE + "Transformation")
    if not found:
        raise BadArguments("the text describes no :Transformation", f"write {_LISTING}")
    return tuple(graph.transformation(node) for node in sorted(found, key=str))


def read_annotations(
    text: str, reasoning: Reasoning = DIRECT
) -> tuple[DescribedStream | DescribedTransformation, ...]:
    """Return each ``:Stream`` with an annotation and each ``:Transformation`` of a Turtle text, by
    name; see `read_transformations`. A stream's contents are in the order of ``:nextSegment``."""
    graph = _Graph(reasoning.read(text, "turtle", NamedNode(STREAM_SPACE.rstrip("#"))))
    streams = [
        graph.stream(node)
        for node in graph.subjects(_TYPE, STREAM_SPACE + "Stream")
        if graph.is_annotated(node)
    ]
    others = graph.subjects(_TYPE, STREAM_SPACE + "Transformation")
    transformations = [graph.transformation(node) for node in others]
    if not streams and not transformations:
        raise BadArguments(
            "the text annotates no :Stream and no :Transformation",
            ":s5 a :Stream ; :hasAnnotation [ :hasOutputAnnotation [ :describesFeature … ] ]",
        )
    streams.sort(key=lambda each: each.stream)
    return (*streams, *sorted(transformations, key=lambda each: each.name))


class _Graph:
    """The triples of a text, indexed for look-ups from a node along a predicate."""

    def __init__(self, triples: Sequence[Triple] | frozenset[Triple]) -> None:
        self._objects: dict[tuple[object, str], list[NamedNode | BlankNode | Literal]]
        self._objects = defaultdict(list)
        self._typed: dict[tuple[str, str], list[NamedNode | BlankNode]] = defaultdict(list)
        for triple in sorted(triples, key=str):
            subject, object = triple.subject, triple.object
            if not isinstance(object, NamedNode | BlankNode | Literal):
                continue
            self._objects[subject, triple.predicate.value].append(object)
            if isinstance(object, NamedNode) and isinstance(subject, NamedNode | BlankNode):
                self._typed[triple.predicate.value, object.value].append(subject)

    def subjects(self, predicate: str, object: str) -> list[NamedNode | BlankNode]:
        return self._typed[predicate, object]

    def is_annotated(self, node: NamedNode | BlankNode) -> bool:
        return bool(self._objects[node, STREAM_SPACE + "hasAnnotation"])

    def stream(self, node: NamedNode | BlankNode) -> DescribedStream:
        name = self._name(node, "Stream")
        annotation = self._one(node, "hasAnnotation", name)
        contents = self._sequence(annotation, "hasOutputAnnotation", name)
        return DescribedStream(name, tuple(contents))

    def _name(self, node: NamedNode | BlankNode, kind: str) -> str:
        name = self._text(node, "hasName") or (variable_name(node.value) if _is_named(node) else "")
        if not name:
            raise BadArguments(f"a :{kind} has no name", 'give it an IRI, or :hasName "…"')
        return name

    def transformation(self, node: NamedNode | BlankNode) -> DescribedTransformation:
        name = self._name(node, "Transformation")
        annotation = self._one(node, "hasAnnotation", name)
        output = None if annotation is None else self._one(annotation, "hasOutputAnnotation", name)
        if annotation is None or output is None:
            raise BadArguments(f"{name} has no :hasOutputAnnotation", f"write {_LISTING}")
        inputs = self._sequence(annotation, "hasInputAnnotation", name)
        code = self._one(node, "hasImplementation", name)
        implementation = None
        if code is not None:
            implementation = self._text(code, "hasName") or variable_name(code.value)
        return DescribedTransformation(
            name,
            tuple(inputs),
            self._port(output, name),
            implementation,
            self._parameters(node, name),
            self._number(node, "hasCost", name),
            self._number(node, "hasQuality", name),
        )

    def _sequence(
        self, holder: NamedNode | BlankNode | None, link: str, name: str
    ) -> list[DescribedPort]:
        """Return the ports of a description, in the order of ``:nextSegment``."""
        ports: list[DescribedPort] = []
        visited = set()
        while holder is not None:
            if holder in visited:
                raise BadArguments(
                    f"the :nextSegment of {name} forms a cycle",
                    "leave out the :nextSegment of the last segment",
                )
            visited.add(holder)
            segment = self._one(holder, link, name)
            if segment is None:
                break
            ports.append(self._port(segment, name))
            holder = self._one(segment, "nextSegment", name)
        return ports

    def _arguments(self, node: NamedNode | BlankNode, name: str) -> Iterator[DescribedArgument]:
        """Return the arguments of an RDF list, in order."""
        cell = self._one(node, "hasArguments", name)
        visited = set()
        while cell is not None and cell not in visited and cell != _NIL:
            visited.add(cell)
            argument = next(iter(self._objects[cell, RDF + "first"]), None)
            described = [
                (is_sort, found)
                for is_sort, link in ((True, "describesSort"), (False, "describesObject"))
                for found in self._objects[argument, STREAM_SPACE + link]
            ]
            if len(described) != 1 or not isinstance(described[0][1], NamedNode):
                raise BadArguments(
                    f"an argument of {name} does not describe exactly one sort or object",
                    'write for example [ :describesSort dyknow:UAV ; :hasIdField "id" ]',
                )
            is_sort, iri = described[0][0], described[0][1].value
            is_self = iri == STREAM_SPACE + "self"
            yield DescribedArgument(
                "self" if is_self else shorten(iri),
                self._text(argument, "hasName") or None,
                self._text(argument, "hasIdField") or None,
                is_sort and not is_self,
                True,
            )
            rest = next(iter(self._objects[cell, RDF + "rest"]), None)
            cell = None if isinstance(rest, Literal) else rest

    def _port(self, node: NamedNode | BlankNode, name: str) -> DescribedPort:
        feature = self._one(node, "describesFeature", name)
        if not isinstance(feature, NamedNode):
            raise BadArguments(f"an annotation of {name} describes no feature", f"write {_LISTING}")
        if self._objects[node, STREAM_SPACE + "hasArguments"]:
            arguments = tuple(self._arguments(node, name))
        else:
            arguments = tuple(self._unordered_arguments(node))
        return DescribedPort(
            shorten(feature.value),
            self._text(node, "hasName") or None,
            self._text(node, "hasUnit") or None,
            arguments,
        )

    def _unordered_arguments(self, node: NamedNode | BlankNode) -> Iterator[DescribedArgument]:
        """Return the arguments in the paper's form, which has no list."""
        for link in ("describesSort", "describesObject"):
            for found in self._objects[node, STREAM_SPACE + link]:
                if isinstance(found, NamedNode):
                    is_self = found.value == STREAM_SPACE + "self"
                    name = "self" if is_self else shorten(found.value)
                    yield DescribedArgument(name, id=self._text(node, "hasIdField") or None)

    def _parameters(self, node: NamedNode | BlankNode, name: str) -> dict[str, str]:
        parameters = {}
        for parameter in self._objects[node, STREAM_SPACE + "hasParameter"]:
            key, value = self._text(parameter, "hasName"), self._text(parameter, "hasText")
            if not key:
                raise BadArguments(
                    f"a parameter of {name} has no name",
                    ':hasParameter [ :hasName "baseline" ; :hasText "5s" ]',
                )
            parameters[key] = value
        return parameters

    def _one(self, node: object, link: str, name: str) -> NamedNode | BlankNode | None:
        found = self._objects[node, STREAM_SPACE + link]
        if len(found) > 1:
            raise BadArguments(f"{name} has {len(found)} :{link}, but may have one", "")
        if found and isinstance(found[0], Literal):
            raise BadArguments(f":{link} of {name} is a literal, not a node", f"write {_LISTING}")
        return found[0] if found else None  # type: ignore[return-value]

    def _text(self, node: object, link: str) -> str:
        found = self._objects[node, STREAM_SPACE + link]
        return found[0].value if found else ""

    def _number(self, node: object, link: str, name: str) -> float:
        text = self._text(node, link)
        try:
            return float(text) if text else 1.0
        except ValueError as error:
            raise BadArguments(f":{link} of {name} must be a number, not {text!r}") from error


def _is_named(node: NamedNode | BlankNode) -> bool:
    return isinstance(node, NamedNode)
