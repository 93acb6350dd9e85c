"""Parses text to EP-SPARQL queries (SPEC §8). Names of the ontology are not resolved here.

```text
query   : prologue [REGISTER … AS] prologue (SELECT items | CONSTRUCT {triples} | ASK)
          (FROM graph)* [WHERE] chain FILTER* [WITHIN duration] [WITH MAX DELAY duration]
chain   : group ((SEQ | EQUALS | OPTIONALSEQ | EQUALSOPTIONAL | UNION) group)*
group   : "{" (triples | FILTER | BIND | GRAPH iri {triples} | chain)* "}"
```

REGISTER, FROM, triples and expressions are read as in C-SPARQL (`languages.csparql`).
"""

from __future__ import annotations

from typing import Final

from pyoxigraph import NamedNode, Variable

from ...sparql.ast import Call, Expression, Form, SelectItem, Triple, Triples
from ...sparql.ast import Group as SparqlGroup
from ...sparql.expressions import AGGREGATES
from ...sparql.tokens import Kind, Lexer, Token
from ..csparql.clauses import ClauseReader
from ..csparql.dataset import read_from
from ..csparql.durations import read_duration
from ..csparql.limits import LIMITS, LONGEST
from ..csparql.parser import name_of, used_prefixes
from ..errors import LanguageError, Span
from ..hints import did_you_mean
from ..text_cache import TextCache
from .ast import (
    TIME_FUNCTIONS,
    Bind,
    EpSparqlQuery,
    Filter,
    Graph,
    Group,
    Operation,
    Operator,
    Part,
)

_OPERATORS: Final = tuple(Operator)
_FUNCTIONS: Final = {name.upper(): name for name in TIME_FUNCTIONS}
_OWN_WORDS: Final = frozenset({*_OPERATORS, *_FUNCTIONS, "WITHIN"} - {Operator.UNION})
"""Words that no other form of query has."""
_FORMS: Final = (Form.SELECT.value, Form.CONSTRUCT.value, Form.ASK.value)
_MODIFIERS: Final = ("GROUP", "HAVING", "ORDER", "LIMIT", "OFFSET", "VALUES", "AGGREGATE", "WINDOW")
_OVER_RESULTS: Final = (
    "register this query, and read its results with a C-SPARQL query, whose window says which of "
    "them belong together"
)
_REFUSED_PARTS: Final = {
    "OPTIONAL": "write `{…} OPTIONALSEQ {…}` (the first may be missing) or "
    "`{…} EQUALSOPTIONAL {…}` (the second may)",
    "MINUS": "absence is `{what is absent} OPTIONALSEQ {…}` and `FILTER (!BOUND(?x))`",
    "VALUES": "compare with `FILTER (?x IN (…))`",
}


@TextCache
def parse_epsparql(source: str) -> EpSparqlQuery:
    """Parse an EP-SPARQL query or template. Raises `LanguageError` with the place of the first
    wrong token. Cost: linear."""
    return _Reader(source).pattern_query()


def is_epsparql(source: str) -> bool:
    """Whether a text is EP-SPARQL rather than C-SPARQL, RSP-QL or a text of another kind: a SELECT,
    CONSTRUCT or ASK with an operator or function of EP-SPARQL, or with WITHIN. Cost: linear, up to
    the first such word."""
    if len(source) > LONGEST:
        return False
    lexer = Lexer(source, LIMITS)
    try:
        return _has_form(lexer) and _has_own_word(lexer)
    except LanguageError:
        # The parser of the other languages says what is wrong.
        return False


def _has_form(lexer: Lexer) -> bool:
    """Read up to the word SELECT, CONSTRUCT or ASK after the prologue and REGISTER."""
    token = lexer.next()
    while token is not None and token.is_word("PREFIX", "BASE", "REGISTER"):
        if token.is_word("REGISTER"):
            while token is not None and not (token.is_word("AS") and not lexer.brackets):
                token = lexer.next()
        while (token := lexer.next()) is not None and token.kind in (Kind.PREFIXED, Kind.IRI):
            pass
    return token is not None and token.is_word(*_FORMS)


def _has_own_word(lexer: Lexer) -> bool:
    before: Token | None = None
    while (token := lexer.next()) is not None:
        in_parentheses = bool(lexer.brackets) and lexer.brackets[-1].text == "("
        if in_parentheses and before is not None and _ends_operand(before):
            token = lexer.operator_at(token)
        if token.is_word(*_OWN_WORDS):
            return True
        before = token
    return False


def _ends_operand(token: Token) -> bool:
    return token.kind in (Kind.VARIABLE, Kind.NUMBER, Kind.STRING) or token.is_mark(")")


class _Reader(ClauseReader):
    """Reads a text in one pass. Raises `LanguageError` at the first error."""

    def pattern_query(self) -> EpSparqlQuery:
        """Read the whole text."""
        self.prologue()
        if self.is_word("REGISTER"):
            self.register()
            self._check_registration()
            self.prologue()
        form = self.here
        if form is None or not form.is_word(*_FORMS):
            raise self.expected("SELECT, CONSTRUCT or ASK")
        self.take()
        projection: tuple[SelectItem, ...] | None = None
        template: tuple[Triple, ...] | None = None
        match Form(form.text.upper()):
            case Form.SELECT:
                projection = self._items()
            case Form.CONSTRUCT:
                self.in_template = True
                template = self.template()
                self.in_template = False
        head = Span(form.start, self.last_token.end)
        graphs = self._graphs()
        self.accept_word("WHERE")
        where = self._where()
        within = self._within()
        max_delay = self._max_delay()
        self._check_end()
        return EpSparqlQuery(
            name_of(self.found, self),
            self.found.kind,
            tuple(Variable(token.text[1:]) for token in self.found.parameters),
            tuple(self.found.defaults),
            Form(form.text.upper()),
            projection,
            template,
            graphs,
            where,
            within,
            max_delay,
            used_prefixes(self),
            head,
            self.source,
        )

    # -- the clauses -----------------------------------------------------------------------

    def _check_registration(self) -> None:
        if self.found.every is not None:
            raise self.error(
                "a pattern has no period",
                self.found.name,
                "leave EVERY out: a result comes as soon as it is decided",
            )
        if self.found.register_operator is not None:
            raise self.error(
                f"a pattern has no {self.found.register_operator}",
                self.found.name,
                "write `REGISTER STREAM name AS`: each result is given once",
            )

    def _items(self) -> tuple[SelectItem, ...] | None:
        """[9] SelectClause."""
        if self.is_word("DISTINCT", "REDUCED"):
            raise self.error(
                f"`SELECT {self.text_of(self.take())}` would keep all results for ever",
                self.last_token,
                _OVER_RESULTS,
            )
        if self.accept_mark("*"):
            return None
        items: list[SelectItem] = []
        while True:
            here = self.here
            if here is not None and here.kind is Kind.VARIABLE:
                items.append(SelectItem(self.named_variable(), None, here.span))
            elif self.is_mark("("):
                expression, variable, span = self.alias()
                items.append(SelectItem(variable, expression, span))
            elif self.is_word("AS") or (here is not None and here.text.upper() in _FUNCTIONS):
                raise self.unexpected("write `(getDURATION() AS ?d)`, expression first")
            elif items:
                return tuple(items)
            else:
                raise self.unexpected("write the variables after SELECT, or `*`")

    def _graphs(self) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """Read the static graphs of FROM."""
        dataset = self.found.dataset
        while self.is_word("FROM"):
            word = self.take()
            read_from(self, dataset, None)
            if dataset.streams:
                raise self.error(
                    "a pattern names no streams: its features and sorts say which are meant",
                    word,
                    "leave the clause out",
                )
        static, named = dataset.static, dataset.static_named
        return tuple(map(self.iri_of, static)), tuple(map(self.iri_of, named))

    def _where(self) -> Group:
        chain = self._operations()
        parts: list[Part] = [chain]
        while self.is_word("FILTER"):
            parts.append(self._filter())
        if len(parts) == 1 and isinstance(chain, Group):
            return chain
        return Group(tuple(parts), Span(chain.span.start, self.last_token.end))

    def _within(self) -> int | Variable | None:
        if not self.accept_word("WITHIN"):
            return None
        if self.here is not None and self.here.kind is Kind.VARIABLE:
            return self.named_variable()
        return read_duration(self, "the time of WITHIN", spelled_out=True)

    def _max_delay(self) -> int | None:
        if not self.accept_word("WITH"):
            return None
        for word in ("MAX", "DELAY"):
            if not self.accept_word(word):
                raise self.unexpected("write `WITH MAX DELAY 5s`")
        return read_duration(self, "the delay", spelled_out=True, least=0)

    def _check_end(self) -> None:
        here = self.here
        if here is None:
            return
        if here.is_word(*_MODIFIERS):
            raise self.error(
                f"`{here.text}` needs all results, and a pattern's never end", here, _OVER_RESULTS
            )
        if here.is_word("WITHIN", "FILTER"):
            raise self.unexpected("the conditions come first, and then one WITHIN")
        if here.is_word("REGISTER"):
            raise self.error("one text registers one query", here, "send the second one separately")
        raise self.unexpected()

    # -- groups ----------------------------------------------------------------------------

    def group(self) -> SparqlGroup:
        """Refuse EXISTS, the only place of a group in an expression."""
        raise self.error(
            "EXISTS is not supported in a pattern",
            self.last_token,
            "absence is `{what is absent} OPTIONALSEQ {…}` and `FILTER (!BOUND(?x))`",
        )

    def _operations(self) -> Operation | Group:
        left: Operation | Group = self._own_group()
        while self.is_word(*_OPERATORS):
            operator = Operator(self.take().text.upper())
            right = self._own_group()
            left = Operation(operator, left, right, Span(left.span.start, right.span.end))
        return left

    def _own_group(self) -> Group:
        before = self.last_token
        if not self.is_mark("{"):
            if before.is_word(*_OPERATORS):
                raise self.unexpected(f"{before.text} stands between groups in braces: `{{…}}`")
            raise self.unexpected("the pattern is in braces: `WHERE {…} SEQ {…}`")
        opened = self.take()
        block = self.block
        self._next_block()
        if self.is_word("SELECT"):
            raise self.error(
                "a sub-query is not supported in a pattern",
                self.here,
                "register it as a query of its own: its results are a stream that patterns read",
            )
        parts: list[Part] = []
        while not self.is_mark("}"):
            part = self._part_of_group()
            if isinstance(part, Group | Operation):
                self._next_block()
            parts.append(part)
            if not isinstance(part, Triples):
                self.accept_mark(".")
        closed = self.take()
        self.block = block
        return Group(tuple(parts), Span(opened.start, closed.end))

    def _part_of_group(self) -> Part:
        here = self.here
        if here is None:
            raise self.unexpected()
        if here.is_mark("{"):
            return self._operations()
        if here.kind is not Kind.WORD:
            return Triples(self._triples_block())
        word = here.text.upper()
        match word:
            case "FILTER":
                return self._filter()
            case "BIND":
                bind = self._bind({})
                return Bind(bind.expression, bind.variable, Span(here.start, self.last_token.end))
            case "GRAPH":
                return self._graph()
            case "SERVICE":
                raise self.service()
            case "WITHIN":
                raise self.unexpected("WITHIN is of the whole pattern: write it after the last `}`")
        if word in _REFUSED_PARTS:
            message = f"{word} is not supported in a pattern"
            raise self.error(message, here, _REFUSED_PARTS[word])
        if word in _OPERATORS:
            raise self.unexpected(f"{word} stands between groups in braces: `{{…}} {word} {{…}}`")
        return Triples(self._triples_block())

    def _filter(self) -> Filter:
        self.take()
        start = len(self.source) if self.here is None else self.here.start
        condition = self.constraint()
        return Filter(condition, Span(start, self.last_token.end))

    def _graph(self) -> Graph:
        self.take()
        name = self.graph_name()
        if not isinstance(name, NamedNode):
            raise self.error(
                "GRAPH names one static graph in a pattern", self.last_token, "write its IRI"
            )
        self.expect("{")
        self._next_block()
        triples = () if self.is_mark("}") else self._triples_block()
        self.expect("}")
        return Graph(name, triples)

    def begins_part(self, token: Token) -> bool:
        return super().begins_part(token) or token.is_word(*_OPERATORS, "WITHIN", "WITH")

    def _collection(self) -> tuple[NamedNode, bool]:
        raise self.error(
            "a list is not supported in a pattern",
            self.here,
            "a triple is of one sample: write its object as a variable or a constant",
        )

    # -- expressions -----------------------------------------------------------------------

    def built_in(self) -> Expression:
        """Read a function: `TIME_FUNCTIONS` have no arguments."""
        here = self.here
        word = "" if here is None or here.kind is not Kind.WORD else here.text.upper()
        if word in AGGREGATES:
            raise self.error(
                f"{word} needs many results, and a pattern's are single", here, _OVER_RESULTS
            )
        if word.startswith("GET") and word not in _FUNCTIONS:
            known = ", ".join(TIME_FUNCTIONS)
            written = "" if here is None else here.text
            raise self.unexpected(did_you_mean(written, TIME_FUNCTIONS) or f"known are {known}")
        if word not in _FUNCTIONS:
            return super().built_in()
        self.take()
        self.expect("(")
        if not self.accept_mark(")"):
            raise self.unexpected(f"{_FUNCTIONS[word]} has no arguments: it is of its group")
        self.height = 0
        return Call(_FUNCTIONS[word], ())
