"""Text to `ContinuousQuery` and `Template` ([Events14 Listings 3 and 4], SPEC §5).

The clauses of ours are read first (`clauses`), blanked out, and what is left is SPARQL 1.1 with
the same offsets (`syntax`). Then names and variables are checked. A text is read once; the last
ones are remembered.
"""

from __future__ import annotations

import difflib
from collections.abc import Sequence
from functools import lru_cache
from itertools import pairwise
from typing import Final

from pyoxigraph import Variable

from ...rdf.namespaces import DYKNOW
from ..errors import LanguageError, Span
from .ast import ContinuousQuery, Form, Template
from .body import bind_names
from .clauses import ClauseReader, Clauses
from .shape import Shape, bound_variables, query_shape
from .syntax import check_meaning, check_syntax
from .terms import iri_text, suggest_prefix
from .tokens import Kind, Token, blanked, tokenize

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
    _check_prefixes(reader, found)
    _check_no_service(reader)
    sparql = blanked(source, found.ours)
    check_syntax(sparql, source)
    for text, span in found.filters:
        check_syntax(f"{_ASK_FILTER}{text}}}", source, span.start - len(_ASK_FILTER))
    shape = query_shape(sparql)
    if shape is None or not shape.has_where:
        raise reader.error("the query has no WHERE", found.form, "write `WHERE { … }`")
    query = ContinuousQuery(
        name=_name(found, source),
        produces_stream=found.kind != "QUERY",
        every=found.every,
        form=Form(found.form.text.upper()),
        prefixes=_used_prefixes(reader, found),
        static=tuple(iri_text(t, source, found.prefixes, found.base) for t in found.static),
        streams=reader.stream_clauses(),
        window=found.window,
        aggregations=tuple(found.aggregations),
        aggregate_filters=tuple(found.filters),
        sparql=sparql,
        source=source,
    )
    _Check(reader, found, shape).check()
    # With every parameter a group key, as it will be evaluated once they are bound.
    check_meaning(
        bind_names(query, [token.text[1:] for token in found.parameters]),
        source,
        found.form.span,
        found.prefixes,
    )
    return query


def _name(found: Clauses, source: str) -> str:
    """A plain name stays one for a query; a template's is the IRI of the event concept."""
    token = found.name
    assert token is not None
    if token.kind is not Kind.WORD:
        return iri_text(token, source, found.prefixes, found.base)
    return DYKNOW + token.text if found.kind == "TEMPLATE" else token.text


def _check_prefixes(reader: ClauseReader, found: Clauses) -> None:
    for index, token in enumerate(reader.tokens):
        if token.kind is Kind.PREFIXED and not reader.tokens[index - 1].is_word("PREFIX"):
            prefix = token.text.partition(":")[0]
            if prefix not in found.prefixes:
                raise suggest_prefix(reader.source, token, prefix)


def _used_prefixes(reader: ClauseReader, found: Clauses) -> dict[str, str]:
    """Declared prefixes, and of the shared ones those that the text uses."""
    used = {t.text.partition(":")[0] for t in reader.tokens if t.kind is Kind.PREFIXED}
    return {name: iri for name, iri in found.prefixes.items() if name in used}


def _check_no_service(reader: ClauseReader) -> None:
    for token in reader.tokens:
        if token.is_word("SERVICE"):
            raise reader.error(
                "SERVICE is not allowed in a continuous query",
                token,
                "load the data into the ontology and name it with FROM",
            )


class _Check:
    """Variables: the head's are bound, AGGREGATE's fit in, a template's parameters are used."""

    def __init__(self, reader: ClauseReader, found: Clauses, shape: Shape) -> None:
        self.reader = reader
        self.found = found
        self.shape = shape
        self.bound = bound_variables(shape.tokens, shape.where_open)
        self.head = shape.head_variables()
        self.parameters = {token.text[1:] for token in found.parameters}
        self.aliases = {aggregation.alias.value for aggregation in found.aggregations}

    def check(self) -> None:
        if self.found.aggregations:
            self.check_aggregate()
        self.check_head()
        self.check_parameters()

    def check_head(self) -> None:
        known = self.bound | self.aliases | self.parameters
        known |= set(self.shape.aliases())
        known |= {t.text[1:] for t in self.shape.modifier("VALUES") if t.kind is Kind.VARIABLE}
        group_by = self.shape.modifier("GROUP")
        known |= {name.text[1:] for word, name in pairwise(group_by) if word.is_word("AS")}
        for name, token in self.head.items():
            if name not in known:
                raise self.reader.error(
                    f"`{token.text}` is not bound in the query", token, _near(name, known)
                )

    def check_aggregate(self) -> None:
        """The AGGREGATE clause against head and WHERE."""
        source = self.reader.source
        for word in ("GROUP", "HAVING", "VALUES"):
            tokens = self.shape.modifier(word)
            if tokens:
                raise self.reader.error(
                    f"{'GROUP BY' if word == 'GROUP' else word} and AGGREGATE in one query",
                    tokens[0],
                    "put VALUES inside WHERE"
                    if word == "VALUES"
                    else "say it one way or the other",
                )
        if self.shape.selects_all or self.shape.is_short_construct:
            raise self.reader.error(
                "the head must name its variables, since AGGREGATE groups by them",
                self.found.form,
                "write `SELECT ?uav ?avg` or `CONSTRUCT {?uav dyknow:speed ?avg}`",
            )
        filtered = {token.text[1:] for text, _ in self.found.filters for token in _variables(text)}
        seen: set[str] = set()
        for aggregation in self.found.aggregations:
            alias, argument = aggregation.alias.value, aggregation.argument.value
            if alias in seen:
                raise LanguageError(f"`?{alias}` is aggregated twice", source, aggregation.span)
            seen.add(alias)
            if alias in self.bound:
                raise LanguageError(
                    f"`?{alias}` is bound in WHERE already",
                    source,
                    aggregation.span,
                    "give the aggregate a name of its own",
                )
            if argument not in self.bound:
                raise LanguageError(
                    f"`?{argument}` is not bound in WHERE",
                    source,
                    aggregation.span,
                    _near(argument, self.bound),
                )
            if alias not in self.head and alias not in filtered:
                raise LanguageError(
                    f"the aggregate `?{alias}` is used neither in the head nor in a FILTER",
                    source,
                    aggregation.span,
                    f"write `?{alias}` in the head, or leave the aggregate out",
                )
        self.check_filters()

    def check_filters(self) -> None:
        known = self.aliases | set(self.head) | self.parameters
        for text, span in self.found.filters:
            for token in _variables(text):
                if token.text[1:] not in known:
                    start = span.start + token.start
                    raise LanguageError(
                        f"`{token.text}` is no aggregate and no variable of the head",
                        self.reader.source,
                        Span(start, start + len(token.text)),
                        "filter on an aggregate here, on other variables inside WHERE",
                    )

    def check_parameters(self) -> None:
        tokens = self.shape.tokens[self.shape.where_open :]
        used = {token.text[1:] for token in tokens if token.kind is Kind.VARIABLE}
        used |= {token.text[1:] for text, _ in self.found.filters for token in _variables(text)}
        for parameter in self.found.parameters:
            if parameter.text[1:] not in used:
                raise self.reader.error(
                    f"the parameter `{parameter.text}` is not used in the body",
                    parameter,
                    _near(parameter.text[1:], used - self.parameters),
                )
        for aggregation in self.found.aggregations:
            if aggregation.alias.value in self.parameters:
                raise LanguageError(
                    f"the parameter `?{aggregation.alias.value}` is assigned in the body",
                    self.reader.source,
                    aggregation.span,
                    "give the aggregate another name",
                )
        everything = self.shape.tokens
        for word, token in pairwise(everything):
            if word.is_word("AS") and token.text[1:] in self.parameters:
                raise self.reader.error(
                    f"the parameter `{token.text}` is assigned in the body",
                    token,
                    "a parameter comes from the request; assign another variable",
                )


def _variables(text: str) -> Sequence[Token]:
    return [token for token in tokenize(text) if token.kind is Kind.VARIABLE]


def _near(name: str, known: set[str]) -> str:
    near = difflib.get_close_matches(name, sorted(known), n=1)
    if near:
        return f"did you mean `?{near[0]}`?"
    return f"the body has {', '.join(f'`?{k}`' for k in sorted(known))}" if known else ""
