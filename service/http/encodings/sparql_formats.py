"""The media types of SPARQL results, Oxigraph's names for them, and how graphs are written."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from functools import lru_cache
from typing import Final, Protocol

from pyoxigraph import (
    BlankNode,
    Literal,
    QueryResultsFormat,
    RdfFormat,
    Triple,
    serialize,
)

from ....sparql.tokens import NAME_NEXT, NAME_START
from ...config.media_types import (
    CSV,
    JSON,
    JSON_LD,
    NQUADS,
    NTRIPLES,
    RDF_XML,
    SPARQL_JSON,
    SPARQL_XML,
    TRIG,
    TSV,
    TURTLE,
)

TABLES = {
    SPARQL_JSON: QueryResultsFormat.JSON,
    JSON: QueryResultsFormat.JSON,
    SPARQL_XML: QueryResultsFormat.XML,
    CSV: QueryResultsFormat.CSV,
    TSV: QueryResultsFormat.TSV,
}
GRAPHS = {
    TURTLE: RdfFormat.TURTLE,
    NTRIPLES: RdfFormat.N_TRIPLES,
    JSON_LD: RdfFormat.JSON_LD,
    RDF_XML: RdfFormat.RDF_XML,
    TRIG: RdfFormat.TRIG,
    NQUADS: RdfFormat.N_QUADS,
}
"""TriG and N-Quads have a graph as the default graph of a dataset."""
_NO_NAME: Final = re.compile(f"[^{NAME_NEXT}.]")
_START: Final = re.compile(f"[{NAME_START}]")
_NOT_IN_XML: Final = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
"""What XML 1.0 has no character for, not even escaped (its Char [2])."""


class NotWritable(ValueError):
    """RDF/XML cannot express a triple."""


class Output(Protocol):
    """A file-like object for bytes."""

    def write(self, data: bytes, /) -> int: ...
    def flush(self) -> None: ...


def write_graph(
    triples: Iterable[Triple],
    output: Output,
    kind: str,
    prefixes: Mapping[str, str] | None = None,
) -> None:
    """Write triples in the format ``kind``, one of `GRAPHS`.

    Raises `NotWritable` for a graph that RDF/XML cannot express: not every IRI is the name of an
    element, and not every character is one of XML. Oxigraph would write a text that is no XML.
    """
    if kind == RDF_XML:
        triples, output = map(_for_xml, triples), _XmlOutput(output)
    known = {} if kind in (NTRIPLES, NQUADS) else dict(prefixes or {})
    serialize(triples, output, format=GRAPHS[kind], prefixes=known)  # type: ignore[arg-type]


def _for_xml(triple: Triple) -> Triple:
    subject, predicate, object = triple.subject, triple.predicate, triple.object
    if not _is_element(predicate.value):
        raise NotWritable(
            f"RDF/XML has no element for the property <{predicate.value}>; ask for another format, "
            "such as text/turtle"
        )
    if isinstance(object, Literal) and (bad := _NOT_IN_XML.search(object.value)):
        raise NotWritable(
            f"XML has no character U+{ord(bad[0]):04X}, which a value of <{predicate.value}> "
            "contains; ask for another format, such as text/turtle"
        )
    # The name of a blank node may begin with a digit, a name in XML may not.
    return Triple(
        BlankNode(f"b{subject.value}") if isinstance(subject, BlankNode) else subject,
        predicate,
        BlankNode(f"b{object.value}") if isinstance(object, BlankNode) else object,
    )


@lru_cache(maxsize=1024)
def _is_element(iri: str) -> bool:
    """Return whether ``iri`` ends with an XML name without a colon."""
    return _START.search(_NO_NAME.split(iri)[-1]) is not None


class _XmlOutput:
    """Escapes carriage returns: a parser of XML reads a plain one as a line feed."""

    def __init__(self, output: Output) -> None:
        self._output = output

    def write(self, data: bytes) -> int:
        self._output.write(bytes(data).replace(b"\r", b"&#13;"))
        return len(data)

    def flush(self) -> None:
        self._output.flush()
