"""Serializes answers to SPARQL as tables and as bytes."""

from __future__ import annotations

from collections.abc import Iterable

from pyoxigraph import (
    BlankNode,
    Literal,
    NamedNode,
    QueryResultsFormat,
    QuerySolutions,
    QueryTriples,
    RdfFormat,
    serialize,
)

from ..rdf.dictionary import Term
from .closure_queries import QueryResults
from .errors import QueryRefused

_TABLES = {
    "json": QueryResultsFormat.JSON,
    "xml": QueryResultsFormat.XML,
    "csv": QueryResultsFormat.CSV,
    "tsv": QueryResultsFormat.TSV,
}
_GRAPHS = {
    "turtle": RdfFormat.TURTLE,
    "ntriples": RdfFormat.N_TRIPLES,
    "jsonld": RdfFormat.JSON_LD,
    "rdfxml": RdfFormat.RDF_XML,
}


def rows_of(results: QueryResults) -> tuple[tuple[str, ...], list[tuple[Term | None, ...]]]:
    """Return the variables and rows of a SELECT; None is unbound. Raises `QueryRefused` for other
    forms."""
    if not isinstance(results, QuerySolutions):
        raise QueryRefused("a table needs a SELECT query", 1, 1)
    variables = tuple(variable.value for variable in results.variables)
    return variables, [tuple(_rdf11(term) for term in solution) for solution in results]


def serialized(results: QueryResults, accept_format: str) -> bytes:
    """Return the answer as bytes. Formats: json, xml, csv, tsv for SELECT and ASK; turtle,
    ntriples, jsonld, rdfxml for CONSTRUCT and DESCRIBE. Raises `QueryRefused` for any other
    combination."""
    formats: Iterable[str]
    if isinstance(results, QueryTriples):
        formats = _GRAPHS
        if accept_format in _GRAPHS:
            return _bytes(serialize(results, format=_GRAPHS[accept_format]))
    else:
        formats = _TABLES
        if accept_format in _TABLES:
            return _bytes(results.serialize(format=_TABLES[accept_format]))
    raise QueryRefused(
        f"the answer to this query cannot be given as {accept_format}",
        1,
        1,
        f"request {', '.join(formats)}",
    )


def _rdf11(term: object) -> Term | None:
    assert term is None or isinstance(term, NamedNode | BlankNode | Literal)
    return term


def _bytes(data: bytes | None) -> bytes:
    assert data is not None  # None only with an output file
    return data
