"""Parses text to `ContinuousQuery` and `Template` ([Events14 Listings 3 and 4], SPEC §5).

`clauses` implements the grammar; then names and variables are checked. Each text is parsed once:
the last ones are cached.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Final

from pyoxigraph import Variable

from ...rdf.namespaces import DYKNOW
from ...sparql.ast import Query
from ...sparql.scope import visible_variables
from ...sparql.tokens import Kind
from ...streams.sample import LONGEST_NAME
from ..text_cache import TextCache
from .ast import ContinuousQuery, Dialect, StreamOperator, Template
from .body import body_tree
from .check import Check
from .clauses import ClauseReader, Clauses
from .dataset import Source
from .groups import NamedGroup, check_groups

_LONGEST_IRI: Final = 1_000
_PLAIN_NAME: Final = re.compile(r"[A-Za-z_]\w*")


def parse_query(source: str) -> ContinuousQuery:
    """Parse a ``REGISTER STREAM|QUERY|RSTREAM … name AS`` text, or one without REGISTER.

    Raises `LanguageError` with the place for a wrong clause, malformed SPARQL, an undeclared
    prefix, an unbound variable, or a missing window.
    """
    reader, found, _ = read(source)
    if found.kind == "TEMPLATE":
        raise reader.error(
            "this text registers a template, not a query",
            found.name,
            "write `REGISTER STREAM name AS` for a query without parameters",
        )
    return _query(source)


def parse_template(source: str) -> Template:
    """Parse a ``REGISTER TEMPLATE name(?parameters) … AS`` text ([Events14 §IV.B]). A
    parameter may have a default: ``?limit = 100``.

    Raises the errors of `parse_query`, and `LanguageError` for a parameter that the body does not
    use or assigns itself.
    """
    reader, found, _ = read(source)
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
    return Template(query.name, parameters, query, source, tuple(found.defaults))


def required_parameters(template: Template) -> tuple[Variable, ...]:
    """Return the parameters that no pattern of WHERE binds (a threshold): they must be given as
    terms.

    A variable would leave them unbound, and a condition over them would never be true.
    """
    where = template.query.body.where
    bound = {} if where is None else visible_variables(where)
    return tuple(p for p in template.parameters if p.value not in bound)


@TextCache
def read(source: str) -> tuple[ClauseReader, Clauses, Query]:
    """Parse a text to its tokens, clauses and SPARQL query. Names are not checked."""
    reader = ClauseReader(source)
    return reader, *reader.read()


@TextCache
def _query(source: str) -> ContinuousQuery:
    reader, found, body = read(source)
    assert found.form is not None
    if body.where is None:
        raise reader.error("the query has no WHERE", found.form, "write `WHERE { … }`")
    streams = reader.stream_clauses()
    check_groups(reader, found.groups, found.dataset)
    Check(reader, found, body).check()
    query = ContinuousQuery(
        name=name_of(found, reader),
        produces_stream=found.kind in ("STREAM", "TEMPLATE"),
        every=found.every,
        form=body.form,
        prefixes=used_prefixes(reader),
        static=tuple(reader.iri_of(t) for t in found.dataset.static),
        streams=streams,
        window=found.window,
        aggregations=tuple(found.aggregations),
        aggregate_filters=tuple(found.filters),
        body=body,
        source=source,
        dialect=_dialect(found, found.groups),
        operator=found.register_operator or found.head_operator or StreamOperator.RSTREAM,
        static_named=tuple(reader.iri_of(t) for t in found.dataset.static_named),
        window_variables=frozenset(
            group.variable
            for group in found.groups
            if group.is_window and group.variable is not None
        ),
    )
    try:
        body_tree(query)
    except ValueError as error:
        raise reader.error(str(error), found.form, "ask with several queries") from None
    return query


def name_of(found: Clauses, reader: ClauseReader) -> str:
    """Return the registered name. A query keeps a plain name; a template gets the IRI of its event
    concept.

    RSP-QL's engines name an output ``<out>``. Without a base that is a plain name too.
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
    """Return RSP-QL if the text uses a feature that only RSP-QL has."""
    windows = found.dataset.has_windows or any(group.is_window for group in groups)
    return Dialect.RSP_QL if found.register_operator or windows else Dialect.C_SPARQL


def used_prefixes(reader: ClauseReader) -> dict[str, str]:
    """Return the declared prefixes, and the shared ones that the text uses."""
    used = {t.text.partition(":")[0] for t in reader.tokens if t.kind is Kind.PREFIXED}
    return {name: iri for name, iri in reader.prefixes.items() if name in used}
