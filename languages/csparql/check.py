"""Names and variables of a query: what the head and AGGREGATE use is bound, parameters are used."""

from __future__ import annotations

import difflib
from collections.abc import Sequence
from itertools import pairwise

from ..errors import LanguageError, Span
from ..hints import did_you_mean
from .ast import Form
from .clauses import ClauseReader, Clauses
from .shape import Shape, bound_variables
from .tokens import Kind, Token, tokenize


class Check:
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
            # SPARQL shows a variable that nothing binds as unbound; where the name is nearly that
            # of another one, or a graph is to be made of it, it is a mistake.
            shown = self.shape.form is Form.SELECT and not self.found.aggregations
            if name not in known and not (shown and not did_you_mean(name, known)):
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
