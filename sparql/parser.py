"""The parser of SPARQL 1.1 queries ([1]-[28]).

Contract: it reads a text in one pass in linear time. `tokens.Limits` bounds the depth to which
later passes over the tree recurse. It also checks the scope rules outside of the grammar, since it
knows the places: scopes of variables and of blank node labels.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Final

from pyoxigraph import NamedNode, Variable

from .ast import Expression, Form, Group, Key, Order, Query, SelectItem, Triples
from .errors import LanguageError, Span
from .expressions import AGGREGATES, FUNCTIONS
from .patterns import PatternReader
from .scope import ungrouped_variables, visible_variables
from .tokens import UNLIMITED, Kind, Limits

FORMS: Final = tuple(form.value for form in Form)


class QueryReader(PatternReader):
    """Reads a query. A language that extends SPARQL overrides the hooks (`languages.csparql`)."""

    group_parameters: frozenset[str] = frozenset()
    """Variables that are implicit keys of every group: the parameters of a template, each bound to
    one term."""

    # -- hooks -----------------------------------------------------------------------------

    def after_form(self) -> None:
        """Read an extension after SELECT, DISTINCT, CONSTRUCT, ASK or DESCRIBE."""

    def clauses(self) -> None:
        """Read [13] DatasetClause, at the place of FROM and after WHERE."""
        while self.accept_word("FROM"):
            self.accept_word("NAMED")
            self.iri_of(self.iri("FROM"))

    def more_clauses(self) -> None:
        """Read extensions after WHERE and after each modifier."""

    # -- queries ---------------------------------------------------------------------------

    def query(self) -> Query:
        """[1] QueryUnit without its prologue."""
        here = self.here
        if here is None or not here.is_word(*FORMS):
            raise self.expected("SELECT, CONSTRUCT, ASK or DESCRIBE")
        form = Form(self.take().text.upper())
        self.after_form()
        match form:
            case Form.SELECT:
                found = self._select(here.start, is_top=True)
            case Form.CONSTRUCT:
                found = self._construct(here.start)
            case Form.ASK:
                self.clauses()
                found = self._add_modifiers(Query(form, self.where()), here.start, is_top=True)
            case Form.DESCRIBE:
                found = self._describe(here.start)
        if self.here is not None:
            raise self.unexpected()
        return found

    def sub_select(self) -> Query:
        """[8] SubSelect."""
        start = self.take().start
        return self._select(start, is_top=False)

    def _select(self, start: int, *, is_top: bool) -> Query:
        """[7] SelectQuery, [9] SelectClause, after the word SELECT."""
        modifier = ""
        if self.is_word("DISTINCT", "REDUCED"):
            modifier = self.take().text.upper()
            if is_top:
                self.after_form()
        projection: list[SelectItem] | None = None
        if not self.accept_mark("*"):
            projection = []
            while self.is_mark("(") or (self.here and self.here.kind is Kind.VARIABLE):
                projection.append(self._select_item())
            if not projection:
                raise self.unexpected()
        if is_top:
            self.clauses()
        where = self.where()
        shown = None if projection is None else tuple(projection)
        query = Query(Form.SELECT, where, modifier, shown)
        query = self._add_modifiers(query, start, is_top=is_top)
        self._check_projection(query)
        return query

    def _select_item(self) -> SelectItem:
        token = self.here
        assert token is not None
        if token.kind is Kind.VARIABLE:
            return SelectItem(self.named_variable(), None, token.span)
        self.aggregates = True
        expression, variable, span = self.alias()
        self.aggregates = False
        return SelectItem(variable, expression, span)

    def _construct(self, start: int) -> Query:
        """[10] ConstructQuery."""
        if self.is_mark("{"):
            self.in_template = True
            template = self.template()
            self.in_template = False
            self.clauses()
            query = Query(Form.CONSTRUCT, self.where(), template=template)
            return self._add_modifiers(query, start, is_top=True)
        self.clauses()
        self.accept_word("WHERE")
        opened = self.here
        self.in_template = True
        template = self.template()
        self.in_template = False
        assert opened is not None
        where = Group((Triples(template),), Span(opened.start, self.last_token.end))
        query = Query(Form.CONSTRUCT, where, template=template, is_short=True)
        return self._add_modifiers(query, start, is_top=True)

    def _describe(self, start: int) -> Query:
        """[11] DescribeQuery."""
        described: list[NamedNode | Variable] = []
        if not self.accept_mark("*"):
            while self.here and self.here.kind in (Kind.VARIABLE, Kind.IRI, Kind.PREFIXED):
                described.append(self.graph_name())
            if not described:
                raise self.unexpected()
        self.clauses()
        where = None
        if self.is_word("WHERE") or self.is_mark("{"):
            where = self.where()
        query = Query(Form.DESCRIBE, where, described=tuple(described))
        return self._add_modifiers(query, start, is_top=True)

    def where(self) -> Group:
        """[17] WhereClause."""
        self.accept_word("WHERE")
        return self.group()

    # -- what follows WHERE ----------------------------------------------------------------

    def _add_modifiers(self, query: Query, start: int, *, is_top: bool) -> Query:
        """Read [18] SolutionModifier and [28] ValuesClause, and add them to the query."""

        def between() -> None:
            if is_top:
                self.more_clauses()

        between()
        grouped, keys = self._group_by()
        between()
        having: list[Expression] = []
        if self.accept_word("HAVING"):
            self.aggregates = True
            having.append(self.constraint())
            while self._begins_constraint():
                having.append(self.constraint())
            self.aggregates = False
            between()
        order = self._order_by()
        between()
        limit = offset = None
        while self.is_word("LIMIT", "OFFSET"):
            if self.take().is_word("LIMIT"):
                limit = self._count_of(limit)
            else:
                offset = self._count_of(offset)
            between()
        values = self.data_block() if self.accept_word("VALUES") else None
        between()
        return replace(
            query,
            keys=keys,
            having=tuple(having),
            order=order,
            limit=limit,
            offset=offset,
            values=values,
            base=self.base if is_top else "",
            span=Span(start, self.last_token.end),
            grouped=grouped,
        )

    def _group_by(self) -> tuple[Span | None, tuple[Key, ...]]:
        """[19] GroupClause, [20] GroupCondition."""
        if not self.is_word("GROUP"):
            return None, ()
        start = self.take().start
        self._by()
        keys: list[Key] = []
        while True:
            here = self.here
            if here is not None and here.kind is Kind.VARIABLE:
                keys.append(Key(self.named_variable()))
            elif self.is_mark("("):
                self.take()
                expression = self.expression()
                alias = self.named_variable() if self.accept_word("AS") else None
                self.expect(")")
                keys.append(Key(expression, alias))
            elif self._begins_constraint():
                keys.append(Key(self.constraint()))
            elif keys:
                return Span(start, self.last_token.end), tuple(keys)
            else:
                raise self.unexpected()

    def _order_by(self) -> tuple[Order, ...]:
        """[23] OrderClause, [24] OrderCondition."""
        if not self.accept_word("ORDER"):
            return ()
        self._by()
        found: list[Order] = []
        self.aggregates = True
        while True:
            here = self.here
            if here is not None and here.kind is Kind.VARIABLE:
                found.append(Order(self.named_variable()))
            elif self.is_word("ASC", "DESC"):
                descending = self.take().is_word("DESC")
                found.append(Order(self.bracketted(), descending))
            elif self._begins_constraint():
                found.append(Order(self.constraint()))
            elif found:
                break
            else:
                raise self.unexpected()
        self.aggregates = False
        return tuple(found)

    def _by(self) -> None:
        if not self.accept_word("BY"):
            raise self.unexpected()

    def _begins_constraint(self) -> bool:
        here = self.here
        if here is None:
            return False
        if here.kind is Kind.WORD:
            words = (*FUNCTIONS, "EXISTS", "NOT", *(AGGREGATES if self.aggregates else ()))
            return here.is_word(*words)
        return here.is_mark("(") or here.kind in (Kind.IRI, Kind.PREFIXED)

    def _count_of(self, earlier: int | None) -> int:
        """[26] LimitClause, [27] OffsetClause: an INTEGER, once."""
        here = self.here
        if earlier is not None or here is None or not here.text.isdecimal():
            raise self.unexpected()
        if len(here.text) > 18:
            raise self.error("the number is too large", here, "it has 18 digits at most")
        return int(self.take().text)

    # -- scope rules ---------------------------------------------------------------------------

    def _check_projection(self, query: Query) -> None:
        """SPARQL 1.1 §18.2.1, §18.2.4.1, §19.8 notes 12 to 14."""
        bound = visible_variables(query.where) if query.where is not None else {}
        is_grouped = query.is_aggregated
        if query.projection is None:
            if query.keys:
                raise LanguageError(
                    "`SELECT *` is not allowed with GROUP BY",
                    self.source,
                    Span(query.span.start, query.span.start + len("SELECT")),
                    "name the keys and the aggregates",
                )
            return
        allowed = set(self.group_parameters)
        for key in query.keys:
            if key.alias is not None:
                allowed.add(key.alias.value)
            elif isinstance(key.expression, Variable):
                allowed.add(key.expression.value)
        aliases: set[str] = set()
        for one in query.projection:
            name = one.variable.value
            if one.expression is None:
                used = {name: None}
            else:
                used = ungrouped_variables(one.expression)
                if name in bound or name in aliases:
                    raise LanguageError(
                        f"`?{name}` is bound already",
                        self.source,
                        one.span,
                        "give the computed value another name",
                    )
            for free in used if is_grouped else ():
                if free not in allowed:
                    raise LanguageError(
                        f"`?{free}` is neither grouped nor aggregated",
                        self.source,
                        one.span,
                        f"write `?{free}` after GROUP BY, or aggregate it",
                    )
            if one.expression is not None:
                aliases.add(name)
                allowed.add(name)


def parse_sparql(text: str, prefixes: Mapping[str, str], limits: Limits = UNLIMITED) -> Query:
    """Parse a SPARQL 1.1 query. ``prefixes`` need no declaration.

    Raises `LanguageError` with the place. Cost: linear, some 5 µs for each token.
    """
    reader = QueryReader(text, prefixes, limits)
    reader.prologue()
    return reader.query()
