"""Parses ontology texts: Turtle, RDF/XML, JSON-LD, N-Triples. It fetches nothing."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Final, TypeAlias, TypeVar
from typing import Literal as OneOf

from pyoxigraph import BlankNode, Literal, NamedNode, Quad, RdfFormat, Triple, parse

from ..errors import OntologyError
from .document_guard import check_document
from .turtle import HEADER_LINES, to_standard_turtle

T = TypeVar("T")
TextFormat: TypeAlias = OneOf["turtle", "rdfxml", "jsonld", "ntriples"]

LARGEST_TEXT: Final = 16 * 1024 * 1024
"""The greatest size of an ontology text, in characters."""

_FORMATS: Final[dict[str, RdfFormat]] = {
    "turtle": RdfFormat.TURTLE,
    "rdfxml": RdfFormat.RDF_XML,
    "jsonld": RdfFormat.JSON_LD,
    "ntriples": RdfFormat.N_TRIPLES,
}
_PLACE: Final = re.compile(
    r"^(?:Parser )?error(?: at line \d+(?: between)? columns?(?: \d+(?: and(?: column)? \d+)?)?)?: "
)


def read_triples(text: str, format: TextFormat, base: NamedNode) -> frozenset[Triple]:
    """Parse an ontology text; relative IRIs are resolved against ``base``.

    Turtle may be in the papers' form (`turtle.to_standard_turtle`). Blank nodes get fresh names.
    Raises `OntologyError`, with line and column if the parser reports them, for a text that is
    malformed, too large, or needs a fetch.
    """
    if format not in _FORMATS:
        raise OntologyError(f"unknown format {format!r}; known are {', '.join(_FORMATS)}")
    if len(text) > LARGEST_TEXT:
        raise OntologyError(f"the text has more than {LARGEST_TEXT} characters")
    check_document(text, format)
    header = HEADER_LINES if format == "turtle" else 0
    source = to_standard_turtle(text) if format == "turtle" else text
    try:
        quads = parse(source, _FORMATS[format], base_iri=base.value, rename_blank_nodes=True)
        triples = frozenset(quad.triple for quad in quads)
    except SyntaxError as error:
        raise _refusal(error, header) from error
    for triple in triples:
        if not isinstance(triple.object, NamedNode | BlankNode | Literal):
            raise OntologyError("triples about triples (RDF 1.2) are not supported")
    return triples


def nquads_of_json_ld(text: bytes) -> Iterator[bytes]:
    """Yield the statements of JSON-LD as lines of N-Quads, with blank nodes by order of appearance.

    Raises `OntologyError` as `read_triples`. The parser may take long, and may overflow its stack:
    call it in a worker for texts of strangers.
    """
    check_document(text.decode(errors="replace"), "jsonld")
    names: dict[BlankNode, BlankNode] = {}

    def named(term: T) -> T | BlankNode:
        if not isinstance(term, BlankNode):
            return term
        return names.setdefault(term, BlankNode(f"b{len(names)}"))

    try:
        for quad in parse(text, RdfFormat.JSON_LD):
            graph, subject = named(quad.graph_name), named(quad.subject)
            found = Quad(subject, quad.predicate, named(quad.object), graph)
            yield f"{found} .\n".encode()
    except SyntaxError as error:
        raise _refusal(error, 0) from error


def _refusal(error: SyntaxError, header: int) -> OntologyError:
    if "LoadDocumentCallback" in str(error):
        return OntologyError(
            "the document names a remote JSON-LD context, and contexts are never fetched",
            hint="put the context into the document itself",
        )
    line = None if error.lineno is None else max(1, error.lineno - header)
    message = _PLACE.sub("", str(error.msg if error.msg else error))
    return OntologyError(message, line, error.offset)
