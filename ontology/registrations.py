"""The texts that users registered, in graphs of the store: templates, annotations, declared
streams, transformations, continuous queries, KPL, specifications (docs/reference/ontology.md)."""

from __future__ import annotations

from collections.abc import Iterator, MutableMapping
from typing import Protocol
from urllib.parse import quote

from pyoxigraph import Literal, NamedNode, Quad, Triple

from ..rdf.namespaces import RDF_TYPE, STREAM_SPACE
from . import graphs
from .errors import OntologyError
from .quad_store import subject_of, text_of

_NODES = "http://www.dyknow.eu/"
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


class RegisteredTexts(MutableMapping[str, str]):
    """Name -> text, in one graph: a node of type ``kind`` for each name. A change is durable when
    the call returns."""

    _text = _HAS_TEXT

    def __init__(
        self, store: RegistrationStore, graph: NamedNode, kind: NamedNode = _SPECIFICATION
    ) -> None:
        self._store = store
        self._graph = graph
        self._kind = kind
        self._replace = store.replace_triples

    def _node(self, name: str) -> NamedNode:
        folder = self._graph.value.rpartition("/")[2]
        return NamedNode(f"{_NODES}{folder}/{quote(name, safe='')}")

    def _triples(self, node: NamedNode, name: str, text: str) -> set[Triple]:
        return _named_text(node, self._kind, name, text)

    def __getitem__(self, name: str) -> str:
        for quad in self._store.about(self._node(name), self._text, self._graph):
            return text_of(quad)
        raise KeyError(name)

    def __setitem__(self, name: str, text: str) -> None:
        node = self._node(name)
        self._replace(self._graph, node, self._triples(node, name, text))

    def __delitem__(self, name: str) -> None:
        if name not in self:
            raise KeyError(name)
        self._replace(self._graph, self._node(name), set())

    def __iter__(self) -> Iterator[str]:
        return map(text_of, sorted(self._store.about(None, _HAS_NAME, self._graph), key=str))

    def __len__(self) -> int:
        return sum(1 for _ in self)


class RegisteredTemplates(RegisteredTexts):
    """IRI of an event -> template text. Registering a text makes the IRI an event concept."""

    _text = _HAS_TEMPLATE

    def _node(self, name: str) -> NamedNode:
        try:
            return NamedNode(name)
        except ValueError as error:
            raise OntologyError(f"{name!r} is not an IRI: {error}") from error

    def _triples(self, node: NamedNode, name: str, text: str) -> set[Triple]:
        return {
            Triple(node, RDF_TYPE, _EVENT),
            Triple(node, RDF_TYPE, _EVENT_TEMPLATE),
            Triple(node, _HAS_TEMPLATE, Literal(text)),
        }

    def __iter__(self) -> Iterator[str]:
        quads = self._store.about(None, _HAS_TEMPLATE, self._graph)
        return map(subject_of, sorted(quads, key=str))


class RegisteredQueries(RegisteredTexts):
    """Name of a continuous query -> its registration as JSON text. No rule or query reads these."""

    def __init__(self, store: RegistrationStore) -> None:
        super().__init__(store, graphs.QUERIES)
        self._replace = store.replace_unread_triples


class Registrations:
    """All registered texts."""

    def __init__(self, store: RegistrationStore) -> None:
        self._store = store
        self.templates = RegisteredTemplates(store, graphs.TEMPLATES)
        self.annotations = RegisteredTexts(store, graphs.ANNOTATIONS, _ANNOTATION)
        """Name of a stream, source or unit -> its SSL text."""
        self.streams = RegisteredTexts(store, graphs.DECLARATIONS)
        """Name of a declared stream -> its declaration as JSON text."""
        self.transformations = RegisteredTexts(store, graphs.TRANSFORMATIONS)
        """Name of a transformation -> its description as JSON text."""
        self.queries = RegisteredQueries(store)

    def kpl(self) -> str:
        """Return all KPL declarations; empty if there are none."""
        return self._single(graphs.KPL)

    def set_kpl(self, text: str) -> None:
        """Store all KPL declarations as one text; an empty text removes them."""
        self._set_single(graphs.KPL, "KPL", text)

    def specifications(self) -> str:
        """Return the units that specifications inserted; empty if there are none."""
        return self._single(graphs.SPECIFICATIONS)

    def set_specifications(self, text: str) -> None:
        """Store the units that specifications inserted as one text; an empty text removes it."""
        self._set_single(graphs.SPECIFICATIONS, "specifications", text)

    def _single(self, graph: NamedNode) -> str:
        return next(map(text_of, self._store.about(graph, _HAS_TEXT, graph)), "")

    def _set_single(self, graph: NamedNode, name: str, text: str) -> None:
        triples = _named_text(graph, _SPECIFICATION, name, text) if text else set()
        self._store.replace_triples(graph, graph, triples)


def _named_text(node: NamedNode, kind: NamedNode, name: str, text: str) -> set[Triple]:
    return {
        Triple(node, RDF_TYPE, kind),
        Triple(node, _HAS_NAME, Literal(name)),
        Triple(node, _HAS_TEXT, Literal(text)),
    }
