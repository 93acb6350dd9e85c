"""Text to `ContinuousQuery` and `Template` ([Events14 Listings 3 and 4], SPEC §5).

The clauses of ours are read first (`clauses`), blanked out, WINDOW groups become GRAPH (`groups`),
and what is left is SPARQL 1.1 with the same offsets (`syntax`). Then names, functions and variables
are checked. A text is read once; the last ones are remembered.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Final

from pyoxigraph import Variable

from ...rdf.namespaces import DYKNOW
from ...streams.sample import LONGEST_NAME
from ..remembered import remembered
from .ast import ContinuousQuery, Dialect, Form, StreamOperator, Template
from .body import bind_names
from .check import Check
from .clauses import ClauseReader, Clauses
from .dataset import Source
from .functions import check_functions
from .groups import NamedGroup, as_graphs, check_groups, check_places, named_groups
from .limits import check_patterns
from .shape import bound_variables, query_shape
from .syntax import check_meaning, check_syntax
from .terms import suggest_prefix
from .tokens import Kind, blanked

_ASK_FILTER: Final = "ASK{FILTER "
_LONGEST_IRI: Final = 1_000
_PLAIN_NAME: Final = re.compile(r"[A-Za-z_]\w*")


def parse_query(source: str) -> ContinuousQuery:
    """The query of a ``REGISTER STREAM|QUERY|RSTREAM … name AS`` text, or of one without REGISTER.

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
        registered = f"registers a {found.kind.lower()}" if found.kind else "registers nothing"
        raise reader.error(
            f"this text {registered}, not a template",
            found.name or found.form,
            "write `REGISTER TEMPLATE name(?parameters) AS`",
        )
    for window in found.dataset.of(Source.NAMED_WINDOW):
        # Its streams are found anew for each request, and a name says which stream is meant.
        raise reader.error(
            "a template names no windows: its streams are inferred",
            window.name,
            "write the patterns without WINDOW, and `WINDOW [RANGE 5s STEP 1s]` at the end",
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


@remembered
def _read(source: str) -> tuple[ClauseReader, Clauses]:
    reader = ClauseReader(source)
    return reader, reader.read()


@remembered
def _query(source: str) -> ContinuousQuery:
    reader, found = _read(source)
    assert found.form is not None
    _check_prefixes(reader)
    _check_no_service(reader)
    groups = named_groups(reader, found.ours)
    sparql = as_graphs(blanked(source, found.ours), groups)
    check_patterns(sparql, source)
    shape = query_shape(sparql)
    if shape is not None:
        check_places(reader, groups, shape)
    check_syntax(sparql, source)
    for text, span in found.filters:
        check_patterns(" " * span.start + text, source)
        check_syntax(f"{_ASK_FILTER}{text}}}", source, span.start - len(_ASK_FILTER))
    if shape is None or not shape.has_where:
        raise reader.error("the query has no WHERE", found.form, "write `WHERE { … }`")
    streams = reader.stream_clauses()
    check_groups(reader, groups, found.dataset)
    for text, shift in [(sparql, 0), *((text, span.start) for text, span in found.filters)]:
        check_functions(text, reader.prefixes, reader.base, source, shift)
    query = ContinuousQuery(
        name=_name(found, reader),
        produces_stream=found.kind in ("STREAM", "TEMPLATE"),
        every=found.every,
        form=Form(found.form.text.upper()),
        prefixes=_used_prefixes(reader),
        static=tuple(reader.iri_of(t) for t in found.dataset.static),
        streams=streams,
        window=found.window,
        aggregations=tuple(found.aggregations),
        aggregate_filters=tuple(found.filters),
        sparql=sparql,
        source=source,
        dialect=_dialect(found, groups),
        operator=found.registered or found.written or StreamOperator.RSTREAM,
        static_named=tuple(reader.iri_of(t) for t in found.dataset.static_named),
        window_variables=frozenset(
            group.variable for group in groups if group.is_window and group.variable is not None
        ),
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
    """A plain name stays one for a query; a template's is the IRI of the event concept.

    RSP-QL's engines name an output ``<out>``: relative to nothing, it is a plain name too.
    """
    token = found.name
    if token is None:
        return ""
    is_relative = token.kind is Kind.IRI and not reader.base
    plain = token.text[1:-1] if is_relative else token.text
    is_plain = _PLAIN_NAME.fullmatch(plain) is not None
    name = plain if is_plain else reader.iri_of(token)
    longest = LONGEST_NAME if is_plain else _LONGEST_IRI
    if len(name) > longest:
        what = "name" if is_plain else "IRI"
        raise reader.error(f"the {what} has more than {longest} characters", token, "shorten it")
    return DYKNOW + name if is_plain and found.kind == "TEMPLATE" else name


def _dialect(found: Clauses, groups: Sequence[NamedGroup]) -> Dialect:
    """RSP-QL where anything is said that only RSP-QL has."""
    windows = found.dataset.has_windows or any(group.is_window for group in groups)
    return Dialect.RSP_QL if found.registered or windows else Dialect.C_SPARQL


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
