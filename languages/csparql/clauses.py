"""The clauses of C-SPARQL around a SPARQL query, read from tokens ([Events14 §III.A, §IV.B]).

REGISTER, COMPUTE EVERY, FROM, FROM STREAM with its window, WINDOW, and AGGREGATE are found
outside all brackets; `Clauses.ours` lists the spans that are not SPARQL.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

from ..errors import Span
from .aggregate import read_aggregate
from .ast import Aggregation, StreamClause, Window
from .cursor import Cursor
from .tokens import Kind, Token, closing
from .windows import EXAMPLE, read_duration, read_window

_FORMS: Final = ("SELECT", "CONSTRUCT", "ASK", "DESCRIBE")


@dataclass(slots=True)
class Clauses:
    """What the clauses say, gathered while reading. Windows are completed at the end."""

    kind: str = ""
    name: Token | None = None
    parameters: list[Token] = field(default_factory=list)
    every: int | None = None
    static: list[Token] = field(default_factory=list)
    streams: list[tuple[Token, Window | None, Span]] = field(default_factory=list)
    window: Window | None = None
    aggregations: list[Aggregation] = field(default_factory=list)
    filters: list[tuple[str, Span]] = field(default_factory=list)
    ours: list[Span] = field(default_factory=list)
    form: Token | None = None


class ClauseReader(Cursor):
    """One pass over the tokens of a registered text; raises `LanguageError` where it stops."""

    def __init__(self, source: str) -> None:
        super().__init__(source)
        self.found = Clauses()

    def mark_ours(self, first: Token) -> None:
        """What was read since ``first`` is no SPARQL."""
        self.found.ours.append(Span(first.start, self.before.end))

    # -- in the order of a text ------------------------------------------------------------

    def read(self) -> Clauses:
        """All clauses; the form keyword and what is not ours stay for SPARQL."""
        if not self.tokens:
            raise self.error(
                "the text is empty", None, "a query begins with `REGISTER STREAM name AS`"
            )
        self.prologue()
        self.register()
        self.prologue()
        here = self.here
        if here is None or not here.is_word(*_FORMS):
            raise self.due("SELECT, CONSTRUCT, ASK or DESCRIBE")
        self.found.form = self.take()
        while self.here is not None:
            self.clause()
        return self.found

    def register(self) -> None:
        first = self.here
        if not self.is_word("REGISTER"):
            raise self.due("REGISTER", "a query begins with `REGISTER STREAM name AS`")
        self.take()
        kind = self.here
        if kind is not None and kind.is_word("RSTREAM", "ISTREAM", "DSTREAM"):
            raise self.error(
                "RSP-QL is not understood yet", kind, "write it as C-SPARQL: `REGISTER STREAM`"
            )
        if kind is None or not kind.is_word("STREAM", "QUERY", "TEMPLATE"):
            raise self.due("STREAM, QUERY or TEMPLATE")
        self.take()
        self.found.kind = kind.text.upper()
        self.found.name = self.registered_name()
        if self.is_mark("("):
            self.parameters()
        if self.is_word("COMPUTE", "COMPUTED"):
            self.take()
            if not self.is_word("EVERY"):
                raise self.due("EVERY", "write `COMPUTE EVERY 1s`")
        if self.is_word("EVERY"):
            self.take()
            self.found.every = read_duration(self, "the period")
        if not self.is_word("AS"):
            raise self.due("AS", "write `… COMPUTE EVERY 1s AS` before the query")
        self.take()
        assert first is not None
        self.mark_ours(first)

    def registered_name(self) -> Token:
        name = self.here
        if name is None or name.kind not in (Kind.WORD, Kind.PREFIXED, Kind.IRI):
            raise self.due("a name")
        return self.take()

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
                raise self.due("a parameter like `?o`")
            if any(token.text[1:] == other.text[1:] for other in self.found.parameters):
                raise self.error(f"the parameter `{token.text}` is there twice", token)
            self.found.parameters.append(self.take())
            if not self.is_mark(")"):
                self.expect_mark(",", "parameters are parted by commas")
        self.take()

    def clause(self) -> None:
        """One clause of ours, or one token or bracket of SPARQL."""
        here = self.take()
        if here.is_mark("{", "(", "["):
            self.index = closing(self.tokens, self.index - 1) + 1
        elif here.is_word("FROM"):
            self.from_clause(here)
        elif here.is_word("AGGREGATE"):
            read_aggregate(self, self.found.aggregations, self.found.filters)
            self.mark_ours(here)
        elif here.is_word("WINDOW"):
            self.window_clause(here)
        elif here.is_word("REGISTER"):
            raise self.error("one text registers one query", here, "send the second on its own")

    # -- FROM, FROM STREAM, WINDOW ---------------------------------------------------------

    def from_clause(self, first: Token) -> None:
        here = self.here
        if here is not None and here.is_word("STREAM"):
            self.take()
            iri = self.iri("FROM STREAM")
            window = (
                read_window(self, "a stream's window", self.found.every)
                if self.is_mark("[")
                else None
            )
            self.mark_ours(first)
            span = Span(first.start, self.before.end)
            self.found.streams.append((iri, window, span))
        elif here is not None and here.is_word("NAMED"):
            self.take()
            if self.is_word("WINDOW"):
                raise self.error(
                    "RSP-QL windows are not understood yet",
                    self.here,
                    "write `FROM STREAM <iri> [RANGE 5s STEP 1s]`",
                )
            raise self.error(
                "FROM NAMED is not understood in a continuous query",
                here,
                "write `FROM <graph>`: static graphs are read as one",
            )
        else:
            self.found.static.append(self.iri("FROM"))
            self.mark_ours(first)

    def window_clause(self, first: Token) -> None:
        if self.found.window is not None:
            raise self.error("a second WINDOW clause", first, "one window holds for all streams")
        self.found.window = read_window(self, "WINDOW", self.found.every)
        self.mark_ours(first)

    # -- when all is read ------------------------------------------------------------------

    def stream_clauses(self) -> tuple[StreamClause, ...]:
        """FROM STREAM clauses; one without a window of its own takes the WINDOW clause."""
        clauses: list[StreamClause] = []
        for token, own, span in self.found.streams:
            window = own or self.found.window
            if window is None:
                raise self.error("the stream has no window", token, EXAMPLE)
            iri = self.iri_of(token)
            if any(clause.iri == iri for clause in clauses):
                raise self.error(f"the stream `{token.text}` is named twice", token)
            clauses.append(StreamClause(iri, window, span))
        if not clauses and self.found.window is None:
            raise self.error(
                "the query has no window",
                self.found.form,
                "write `WINDOW [RANGE 5s STEP 1s]` at the end, "
                "or `FROM STREAM <iri> [RANGE 5s STEP 1s]`",
            )
        return tuple(clauses)
