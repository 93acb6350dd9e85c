"""Text to `ContinuousQuery` and `Template` ([Events14 Listings 3 and 4], SPEC §5).

The clauses of ours are read first (`clauses`), blanked out, and what is left is SPARQL 1.1 with
the same offsets (`syntax`). Then names and variables are checked. A text is read once; the last
ones are remembered.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Final

from pyoxigraph import Variable

from ...rdf.namespaces import DYKNOW
from .ast import ContinuousQuery, Form, Template
from .body import bind_names
from .check import Check
from .clauses import ClauseReader, Clauses
from .shape import bound_variables, query_shape
from .syntax import check_meaning, check_syntax
from .terms import suggest_prefix
from .tokens import Kind, blanked

_ASK_FILTER: Final = "ASK{FILTER "


def parse_query(source: str) -> ContinuousQuery:
    """The query of a ``REGISTER STREAM|QUERY name … AS`` text.

    Raises `LanguageError` with the place for a wrong clause, SPARQL that is none, a prefix that
    is not declared, a variable that nothing binds, or a missing window.
    """
    reader, found = _read(source)
    if found.kind == "TEMPLATE":
        raise reader.error(
            "this text registers a template, not a query",
            found.name,
            "write `REGISTER STREAM name AS` for a query that runs as it stands",
        )
    return _query(source)


def parse_template(source: str) -> Template:
    """The template of a ``REGISTER TEMPLATE name(?parameters) … AS`` text ([Events14 §IV.B]).

    Raises `LanguageError` as `parse_query`, and for a parameter that the body does not use or
    assigns itself.
    """
    reader, found = _read(source)
    if found.kind != "TEMPLATE":
        raise reader.error(
            f"this text registers a {found.kind.lower()}, not a template",
            found.name,
            "write `REGISTER TEMPLATE name(?parameters) AS`",
        )
    query = _query(source)
    parameters = tuple(Variable(token.text[1:]) for token in found.parameters)
    return Template(query.name, parameters, query, source)


def required_parameters(template: Template) -> tuple[Variable, ...]:
    """Parameters that no pattern of WHERE binds (a threshold): they must be given a term.

    Left a variable they would be unbound, and a condition over them would never hold.
    """
    shape = query_shape(template.query.sparql)
    bound = set() if shape is None else bound_variables(shape.tokens, shape.where_open)
    return tuple(p for p in template.parameters if p.value not in bound)


@lru_cache(maxsize=512)
def _read(source: str) -> tuple[ClauseReader, Clauses]:
    reader = ClauseReader(source)
    return reader, reader.read()


@lru_cache(maxsize=512)
def _query(source: str) -> ContinuousQuery:
    reader, found = _read(source)
    assert found.name is not None
    assert found.form is not None
    _check_prefixes(reader)
    _check_no_service(reader)
    sparql = blanked(source, found.ours)
    check_syntax(sparql, source)
    for text, span in found.filters:
        check_syntax(f"{_ASK_FILTER}{text}}}", source, span.start - len(_ASK_FILTER))
    shape = query_shape(sparql)
    if shape is None or not shape.has_where:
        raise reader.error("the query has no WHERE", found.form, "write `WHERE { … }`")
    query = ContinuousQuery(
        name=_name(found, reader),
        produces_stream=found.kind != "QUERY",
        every=found.every,
        form=Form(found.form.text.upper()),
        prefixes=_used_prefixes(reader),
        static=tuple(reader.iri_of(t) for t in found.static),
        streams=reader.stream_clauses(),
        window=found.window,
        aggregations=tuple(found.aggregations),
        aggregate_filters=tuple(found.filters),
        sparql=sparql,
        source=source,
    )
    Check(reader, found, shape).check()
    # With every parameter a group key, as it will be evaluated once they are bound.
    check_meaning(
        bind_names(query, [token.text[1:] for token in found.parameters]),
        source,
        found.form.span,
        reader.prefixes,
    )
    return query


def _name(found: Clauses, reader: ClauseReader) -> str:
    """A plain name stays one for a query; a template's is the IRI of the event concept."""
    token = found.name
    assert token is not None
    if token.kind is not Kind.WORD:
        return reader.iri_of(token)
    return DYKNOW + token.text if found.kind == "TEMPLATE" else token.text


def _check_prefixes(reader: ClauseReader) -> None:
    for index, token in enumerate(reader.tokens):
        if token.kind is Kind.PREFIXED and not reader.tokens[index - 1].is_word("PREFIX"):
            prefix = token.text.partition(":")[0]
            if prefix not in reader.prefixes:
                raise suggest_prefix(reader.source, token, prefix)


def _used_prefixes(reader: ClauseReader) -> dict[str, str]:
    """Declared prefixes, and of the shared ones those that the text uses."""
    used = {t.text.partition(":")[0] for t in reader.tokens if t.kind is Kind.PREFIXED}
    return {name: iri for name, iri in reader.prefixes.items() if name in used}


def _check_no_service(reader: ClauseReader) -> None:
    for token in reader.tokens:
        if token.is_word("SERVICE"):
            raise reader.error(
                "SERVICE is not allowed in a continuous query",
                token,
                "load the data into the ontology and name it with FROM",
            )
