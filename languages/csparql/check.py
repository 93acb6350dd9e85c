"""Checks the variables of a query: the head and AGGREGATE use bound ones, the body uses each
parameter."""

from __future__ import annotations

from itertools import pairwise

from ...sparql.ast import Aggregate, Form, Query, variables_of, walk
from ...sparql.scope import head_variables, visible_variables
from ...sparql.tokens import Kind, Token
from ..errors import LanguageError, Span
from ..hints import did_you_mean
from .clauses import ClauseReader, Clauses


class Check:
    """Checks variables: those of the head are bound, those of AGGREGATE are consistent, parameters
    are used."""

    def __init__(self, reader: ClauseReader, found: Clauses, body: Query) -> None:
        assert body.where is not None
        self.reader = reader
        self.found = found
        self.body = body
        self.where = body.where
        self.bound = set(visible_variables(self.where))
        self.head = head_variables(body)
        self.parameters = {token.text[1:] for token in found.parameters}
        self.aliases = {aggregation.alias.value for aggregation in found.aggregations}

    def check(self) -> None:
        if self.found.aggregations:
            self.check_aggregate()
        self.check_head()
        self.check_aliases()
        self.check_parameters()

    def check_head(self) -> None:
        bound = self.bound | self.aliases | self.parameters
        bound |= {one.variable.value for one in self.body.projection or () if one.expression}
        bound |= set(variables_of(self.body.values))
        bound |= {key.alias.value for key in self.body.keys if key.alias is not None}
        for name in self.head:
            # In SPARQL an unbound variable of the head stays unbound. It is an error here if its
            # name resembles a bound one, or if the head constructs a graph.
            is_shown = self.body.form is Form.SELECT and not self.found.aggregations
            if name not in bound and not (is_shown and not did_you_mean(name, bound)):
                token = self._token(name, self.body.span)
                raise self.reader.error(
                    f"`{token.text}` is not bound in the query", token, _near(name, bound)
                )

    def check_aliases(self) -> None:
        """Check that aggregates of the head read variables of WHERE: nothing else has a value in
        each row."""
        aliases: set[str] = set()
        for one in self.body.projection or ():
            if one.expression is None:
                continue
            inside = (node for node in walk(one.expression) if isinstance(node, Aggregate))
            for name in (name for node in inside for name in variables_of(node)):
                if name in aliases - self.bound:
                    raise LanguageError(
                        f"`?{name}` is computed in the head, so it cannot be aggregated",
                        self.reader.source,
                        one.span,
                        "compute it in a sub-query",
                    )
            aliases.add(one.variable.value)

    def check_aggregate(self) -> None:
        """Check the AGGREGATE clause against head and WHERE."""
        source = self.reader.source
        body = self.body
        for word, is_present, hint in (
            ("GROUP BY", body.keys, "use one of the two"),
            ("HAVING", body.having, "use one of the two"),
            ("VALUES", body.values, "put VALUES inside WHERE"),
        ):
            if is_present:
                after_where = (t for t in self.reader.tokens if t.start >= self.where.span.end)
                first = next(t for t in after_where if t.is_word(word.split()[0]))
                raise self.reader.error(
                    f"a query cannot have both {word} and AGGREGATE", first, hint
                )
        if body.selects_all or body.is_short:
            raise self.reader.error(
                "the head must name its variables, since AGGREGATE groups by them",
                self.found.form,
                "write `SELECT ?uav ?avg` or `CONSTRUCT {?uav dyknow:speed ?avg}`",
            )
        filtered = {name for condition, _ in self.found.filters for name in variables_of(condition)}
        aliases: set[str] = set()
        for aggregation in self.found.aggregations:
            alias, argument = aggregation.alias.value, aggregation.argument.value
            if alias in aliases:
                raise LanguageError(f"`?{alias}` is aggregated twice", source, aggregation.span)
            aliases.add(alias)
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
        allowed = self.aliases | set(self.head) | self.parameters
        for condition, span in self.found.filters:
            for name in variables_of(condition):
                if name not in allowed:
                    token = self._token(name, span)
                    raise self.reader.error(
                        f"`{token.text}` is neither an aggregate nor a variable of the head",
                        token,
                        "filter on an aggregate here, on other variables inside WHERE",
                    )

    def check_parameters(self) -> None:
        tokens = [t for t in self.reader.tokens if t.start >= self.where.span.start]
        used = {token.text[1:] for token in tokens if token.kind is Kind.VARIABLE}
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
        for word, token in pairwise(self.reader.tokens):
            if word.is_word("AS") and token.text[1:] in self.parameters:
                raise self.reader.error(
                    f"the parameter `{token.text}` is assigned in the body",
                    token,
                    "a parameter comes from the request; assign another variable",
                )

    def _token(self, name: str, span: Span) -> Token:
        """Return the first token of a variable in ``span``."""
        inside = (t for t in self.reader.tokens if span.start <= t.start < span.end)
        return next(t for t in inside if t.kind is Kind.VARIABLE and t.text[1:] == name)


def _near(name: str, names: set[str]) -> str:
    meant = did_you_mean(f"?{name}", (f"?{each}" for each in names))
    return meant or (f"the body has {', '.join(f'`?{k}`' for k in sorted(names))}" if names else "")
