"""The texts that users registered, in graphs of the store: templates, annotations, declared
streams, transformations, continuous queries, KPL, specifications (docs/ontology.md)."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Protocol

from pyoxigraph import Literal, NamedNode, Quad, Triple

from ..rdf.namespaces import RDF_TYPE, STREAM_SPACE
from . import graphs
from .errors import OntologyError
from .quad_store import subject_of, text_of

_HAS_TEMPLATE = NamedNode(STREAM_SPACE + "hasTemplate")
_HAS_NAME = NamedNode(STREAM_SPACE + "hasName")
_HAS_TEXT = NamedNode(STREAM_SPACE + "hasText")
_EVENT = NamedNode(STREAM_SPACE + "Event")
_EVENT_TEMPLATE = NamedNode(STREAM_SPACE + "EventTemplate")
_ANNOTATION = NamedNode(STREAM_SPACE + "Annotation")
_SPECIFICATION = NamedNode(STREAM_SPACE + "Specification")


class RegistrationStore(Protocol):
    """The store behind the registrations."""

    def about(
        self, subject: NamedNode | None, predicate: NamedNode, graph: NamedNode
    ) -> Iterator[Quad]:
        """See `Ontology.about`."""

    def replace_triples(self, graph: NamedNode, subject: NamedNode, triples: set[Triple]) -> None:
        """See `Ontology.replace_triples`."""

    def replace_unread_triples(
        self, graph: NamedNode, subject: NamedNode, triples: set[Triple]
    ) -> None:
        """See `Ontology.replace_unread_triples`."""


class Registrations:
    """The registered texts by name. Each change is durable when the call returns."""

    def __init__(self, store: RegistrationStore) -> None:
        self._store = store

    def set_template(self, event: str, source: str) -> None:
        """Register a template text for ``event`` (an IRI), or replace it. The IRI becomes an event
        concept."""
        concept = _iri(event)
        triples = {
            Triple(concept, RDF_TYPE, _EVENT),
            Triple(concept, RDF_TYPE, _EVENT_TEMPLATE),
            Triple(concept, _HAS_TEMPLATE, Literal(source)),
        }
        self._store.replace_triples(graphs.TEMPLATES, concept, triples)

    def remove_template(self, event: str) -> None:
        """Remove the event concept and its template. Raises KeyError if there is none."""
        if event not in self.templates():
            raise KeyError(event)
        self._store.replace_triples(graphs.TEMPLATES, _iri(event), set())

    def templates(self) -> dict[str, str]:
        """Return event concept IRI -> template text."""
        quads = self._store.about(None, _HAS_TEMPLATE, graphs.TEMPLATES)
        return {subject_of(q): text_of(q) for q in sorted(quads, key=str)}

    def set_annotation(self, subject_name: str, source: str) -> None:
        """Store the SSL text of the stream, source or unit of this name."""
        node = graphs.annotation_node(subject_name)
        self._store.replace_triples(
            graphs.ANNOTATIONS, node, _named_text(node, _ANNOTATION, subject_name, source)
        )

    def remove_annotation(self, subject_name: str) -> None:
        """Remove the SSL text. Raises KeyError if there is none."""
        if subject_name not in self.annotations():
            raise KeyError(subject_name)
        self._store.replace_triples(graphs.ANNOTATIONS, graphs.annotation_node(subject_name), set())

    def annotations(self) -> dict[str, str]:
        """Return name of the stream, source or unit -> SSL text."""
        return self._named_texts(graphs.ANNOTATIONS)

    def set_stream(self, name: str, declaration_json: str) -> None:
        """Store the declaration of a stream."""
        node = graphs.declaration_node(name)
        triples = _named_text(node, _SPECIFICATION, name, declaration_json)
        self._store.replace_triples(graphs.DECLARATIONS, node, triples)

    def remove_stream(self, name: str) -> None:
        """Remove the declaration. Raises KeyError if there is none."""
        if name not in self.streams():
            raise KeyError(name)
        self._store.replace_triples(graphs.DECLARATIONS, graphs.declaration_node(name), set())

    def streams(self) -> dict[str, str]:
        """Return name of a declared stream -> its declaration as JSON text."""
        return self._named_texts(graphs.DECLARATIONS)

    def set_transformation(self, name: str, description_json: str) -> None:
        """Store the description of a transformation."""
        node = graphs.transformation_node(name)
        triples = _named_text(node, _SPECIFICATION, name, description_json)
        self._store.replace_triples(graphs.TRANSFORMATIONS, node, triples)

    def remove_transformation(self, name: str) -> None:
        """Remove the description. Raises KeyError if there is none."""
        if name not in self.transformations():
            raise KeyError(name)
        self._store.replace_triples(graphs.TRANSFORMATIONS, graphs.transformation_node(name), set())

    def transformations(self) -> dict[str, str]:
        """Return name of a registered transformation -> its description as JSON text."""
        return self._named_texts(graphs.TRANSFORMATIONS)

    def set_query(self, name: str, registration_json: str) -> None:
        """Store the registration of a continuous query."""
        node = graphs.query_node(name)
        self._store.replace_unread_triples(
            graphs.QUERIES, node, _named_text(node, _SPECIFICATION, name, registration_json)
        )

    def remove_query(self, name: str) -> None:
        """Remove the registration, if there is one."""
        self._store.replace_unread_triples(graphs.QUERIES, graphs.query_node(name), set())

    def queries(self) -> dict[str, str]:
        """Return name of a registered continuous query -> its registration as JSON text."""
        return self._named_texts(graphs.QUERIES)

    def set_kpl(self, text: str) -> None:
        """Store all KPL declarations as one text; an empty text removes them."""
        node = graphs.KPL
        triples = _named_text(node, _SPECIFICATION, "KPL", text) if text else set()
        self._store.replace_triples(graphs.KPL, node, triples)

    def kpl(self) -> str:
        """Return the KPL declarations; empty if there are none."""
        return self._named_texts(graphs.KPL).get("KPL", "")

    def set_specifications(self, text: str) -> None:
        """Store the units that specifications inserted as one text; an empty text removes it."""
        node = graphs.SPECIFICATIONS
        triples = _named_text(node, _SPECIFICATION, "specifications", text) if text else set()
        self._store.replace_triples(graphs.SPECIFICATIONS, node, triples)

    def specifications(self) -> str:
        """Return the units that specifications inserted; empty if there are none."""
        return self._named_texts(graphs.SPECIFICATIONS).get("specifications", "")

    def _named_texts(self, graph: NamedNode) -> dict[str, str]:
        names = self._store.about(None, _HAS_NAME, graph)
        found = {}
        for quad in sorted(names, key=str):
            node = NamedNode(subject_of(quad))
            for text in self._store.about(node, _HAS_TEXT, graph):
                found[text_of(quad)] = text_of(text)
        return found


def _iri(text: str) -> NamedNode:
    try:
        return NamedNode(text)
    except ValueError as error:
        raise OntologyError(f"{text!r} is not an IRI: {error}") from error


def _named_text(node: NamedNode, kind: NamedNode, name: str, text: str) -> set[Triple]:
    return {
        Triple(node, RDF_TYPE, kind),
        Triple(node, _HAS_NAME, Literal(name)),
        Triple(node, _HAS_TEXT, Literal(text)),
    }
