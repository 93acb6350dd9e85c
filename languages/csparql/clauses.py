"""The grammar of continuous queries: SPARQL with additional clauses ([Events14 §III.A, §IV.B], SPEC
§5).

REGISTER, COMPUTE EVERY, all forms of FROM, WINDOW, AGGREGATE and RSP-QL's stream operators stand
outside all brackets; only ``WINDOW name {…}`` is a part of a group. `Clauses.ours` lists the spans
that are not SPARQL.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

from pyoxigraph import NamedNode, Variable

from ...sparql.ast import Expression, FunctionCall, Graph, Group, Query
from ...sparql.parser import FORMS, QueryReader
from ...sparql.tokens import Kind, Token
from ..arguments import DEFAULT_HINT, Default, check_order, default_at
from ..errors import LanguageError, Span
from .aggregate import read_aggregate
from .ast import Aggregation, StreamClause, StreamOperator, Window
from .dataset import Dataset, read_from, stream_clauses
from .durations import read_duration
from .functions import QUERY_PREFIXES, check_call
from .groups import NamedGroup
from .limits import LIMITS, check_length
from .windows import read_window

_OPERATORS: Final = tuple(StreamOperator)
_BEGINNING: Final = (
    "a query begins with `REGISTER STREAM name AS` or with `SELECT`, a formula with `monitor`, "
    "and a chronicle with `chronicle`"
)


@dataclass(slots=True)
class Clauses:
    """The contents of the clauses, collected while reading.

    ``kind`` is STREAM, QUERY or TEMPLATE, or "" without REGISTER. ``register_operator`` and
    ``head_operator`` are the stream operators of REGISTER and of the head. A stream without a
    window gets that of the WINDOW clause at the end (`ClauseReader.stream_clauses`).
    """

    kind: str = ""
    name: Token | None = None
    parameters: list[Token] = field(default_factory=list)
    defaults: list[Default | None] = field(default_factory=list)
    every: int | None = None
    dataset: Dataset = field(default_factory=Dataset)
    window: Window | None = None
    aggregations: list[Aggregation] = field(default_factory=list)
    filters: list[tuple[Expression, Span]] = field(default_factory=list)
    groups: list[NamedGroup] = field(default_factory=list)
    ours: list[Span] = field(default_factory=list)
    form: Token | None = None
    register_operator: StreamOperator | None = None
    head_operator: StreamOperator | None = None


class ClauseReader(QueryReader):
    """Reads a text in one pass. Raises `LanguageError` at the first error."""

    def __init__(self, source: str) -> None:
        check_length(source)
        super().__init__(source, QUERY_PREFIXES, LIMITS)
        self.found = Clauses()

    def mark_ours(self, first: Token) -> None:
        """Mark the tokens since ``first`` as not SPARQL."""
        self.found.ours.append(Span(first.start, self.last_token.end))

    # -- in the order of the text ----------------------------------------------------------

    def read(self) -> tuple[Clauses, Query]:
        """Read the whole text: the clauses, and the SPARQL query among them."""
        if self.here is None:
            raise self.error("the text is empty", None, _BEGINNING)
        self.prologue()
        if self.is_word("REGISTER"):
            self.register()
            self.prologue()
        elif not self.is_word(*FORMS):
            raise self.expected("REGISTER, SELECT, CONSTRUCT, ASK or DESCRIBE", _BEGINNING)
        self.found.form = self.here
        return self.found, self.query()

    def register(self) -> None:
        first = self.take()
        kind = self.here
        if kind is None or not kind.is_word("STREAM", "QUERY", "TEMPLATE", *_OPERATORS):
            raise self.expected("STREAM, QUERY, TEMPLATE, RSTREAM, ISTREAM or DSTREAM")
        self.take()
        if kind.is_word(*_OPERATORS):
            self.found.kind = "STREAM"
            self.found.register_operator = StreamOperator(kind.text.upper())
        else:
            self.found.kind = kind.text.upper()
        self.found.name = self.registered_name()
        if self.is_mark("("):
            self.parameters()
        self.period()
        if not self.is_word("AS"):
            raise self.expected("AS", "write `… COMPUTE EVERY 1s AS` before the query")
        self.take()
        self.mark_ours(first)

    def registered_name(self) -> Token:
        name = self.here
        if name is None or name.kind not in (Kind.WORD, Kind.PREFIXED, Kind.IRI):
            raise self.expected("a name")
        return self.take()

    def period(self) -> None:
        """Read ``COMPUTE EVERY 1s``, ``COMPUTED EVERY 1s``, ``EVERY 1s``, or nothing."""
        if self.is_word("COMPUTE", "COMPUTED"):
            self.take()
            if not self.is_word("EVERY"):
                raise self.expected("EVERY", "write `COMPUTE EVERY 1s`")
        if self.is_word("EVERY"):
            self.take()
            self.found.every = read_duration(self, "the period")

    def parameters(self) -> None:
        open_bracket = self.take()
        if self.found.kind != "TEMPLATE":
            raise self.error(
                f"a {self.found.kind.lower()} has no parameters",
                open_bracket,
                "write `REGISTER TEMPLATE` for a text with parameters",
            )
        while not self.is_mark(")"):
            token = self.here
            if token is None or token.kind is not Kind.VARIABLE:
                raise self.expected("a parameter like `?o`")
            if any(token.text[1:] == other.text[1:] for other in self.found.parameters):
                raise self.error(f"the parameter `{token.text}` occurs twice", token)
            self.found.parameters.append(self.take())
            self.found.defaults.append(default_at(self) if self.accept_mark("=") else None)
            if not self.is_mark(")"):
                hint = DEFAULT_HINT if self.found.defaults[-1] else "separate parameters by commas"
                self.expect_mark(",", hint)
        self.take()
        named = [(token.text[1:], token.span) for token in self.found.parameters]
        check_order(named, tuple(self.found.defaults), self.source)
        self.group_parameters = frozenset(token.text[1:] for token in self.found.parameters)

    def after_form(self) -> None:
        """Read the stream operator of the head: ``SELECT ISTREAM``, ``SELECT DISTINCT ISTREAM``."""
        if self.is_word(*_OPERATORS):
            self.check_operator(self.take())

    def check_operator(self, word: Token) -> None:
        written = StreamOperator(word.text.upper())
        registered = self.found.register_operator
        if registered not in (None, written):
            raise self.error(
                f"`{word.text}`, but the query is registered as {registered}",
                word,
                "state it in one place",
            )
        self.found.head_operator = written
        self.mark_ours(word)

    def clauses(self) -> None:
        """Read the additional clauses, at the place of FROM and after WHERE."""
        while self.is_word("FROM", "AGGREGATE", "WINDOW", "REGISTER"):
            first = self.take()
            if first.is_word("FROM"):
                read_from(self, self.found.dataset, self.found.every)
                self.mark_ours(first)
            elif first.is_word("AGGREGATE"):
                read_aggregate(self, self.found.aggregations, self.found.filters)
                self.mark_ours(first)
            elif first.is_word("WINDOW"):
                self.window_clause(first)
            else:
                raise self.error(
                    "one text registers one query", first, "send the second one separately"
                )

    def more_clauses(self) -> None:
        self.clauses()

    def window_clause(self, first: Token) -> None:
        here = self.here
        if here is not None and here.kind in (Kind.IRI, Kind.PREFIXED, Kind.VARIABLE):
            raise self.error(
                f"`WINDOW {here.text}` outside WHERE",
                first,
                f"write `WHERE {{ WINDOW {here.text} {{ … }} }}`",
            )
        if self.found.window is not None:
            raise self.error("a second WINDOW clause", first, "one window applies to all streams")
        self.found.window = read_window(self, "WINDOW", self.found.every)
        self.mark_ours(first)

    # -- in WHERE --------------------------------------------------------------------------

    def where(self) -> Group:
        if not self.is_word("WHERE") and not self.is_mark("{"):
            if self.here is None:
                raise self.error("the query has no WHERE", self.found.form, "write `WHERE { … }`")
            raise self.unexpected()
        return super().where()

    def extension_part(self) -> Graph | None:
        """Read ``WINDOW name {…}``: a graph with the triples of a named window."""
        if not self.is_word("WINDOW"):
            return None
        word = self.take()
        if self.is_mark("["):
            raise self.error(
                "the WINDOW clause is inside a group", word, "write it after the last `}`"
            )
        name = self.here
        if name is None or name.kind not in (Kind.IRI, Kind.PREFIXED, Kind.VARIABLE):
            raise self.error(
                "expected the name of a window after WINDOW", name, "write `WINDOW :w { … }`"
            )
        return Graph(self.graph_name(), self.group(), is_window=True)

    def graph_name(self) -> NamedNode | Variable:
        word, name = self.last_token, self.here
        found = super().graph_name()
        if name is not None and word.is_word("GRAPH", "WINDOW"):
            self.found.groups.append(NamedGroup(word, name))
        return found

    def begins_part(self, token: Token) -> bool:
        return super().begins_part(token) or token.is_word("WINDOW")

    def check_call(self, call: FunctionCall) -> None:
        check_call(call, self.source)

    def service(self) -> LanguageError:
        return self.error(
            "SERVICE is not allowed in a continuous query",
            self.here,
            "load the data into the ontology and name it with FROM",
        )

    def unexpected(self, hint: str = "") -> LanguageError:
        if self.in_template and self.is_word("WINDOW"):
            word = self.take()
            name = "" if self.here is None else f" {self.here.text}"
            return self.error(
                f"`WINDOW{name}` in the constructed triples",
                word,
                "constructed triples have no window: write it inside WHERE",
            )
        if self.is_word("STREAM", "ON"):
            hint = (
                "name streams with `FROM STREAM <iri> […]` or `FROM NAMED WINDOW :w ON <iri> […]`"
            )
        return super().unexpected(hint)

    # -- at the end ------------------------------------------------------------------------

    def stream_clauses(self) -> tuple[StreamClause, ...]:
        """Return the streams with their windows. Without streams a WINDOW clause must give the
        window of those that matching finds."""
        clauses = stream_clauses(self, self.found.dataset, self.found.window)
        if not clauses and self.found.window is None:
            raise self.error(
                "the query has no window",
                self.found.form,
                "write `WINDOW [RANGE 5s STEP 1s]` at the end, "
                "or `FROM STREAM <iri> [RANGE 5s STEP 1s]`",
            )
        return tuple(clauses)
