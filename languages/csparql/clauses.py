"""The clauses of C-SPARQL around a SPARQL query, read from tokens ([Events14 §III.A, §IV.B]).

REGISTER, COMPUTE EVERY, FROM, FROM STREAM with its window, WINDOW, and AGGREGATE are found
outside all brackets; `Clauses.ours` lists the spans that are not SPARQL.
"""

from __future__ import annotations

import difflib
from dataclasses import dataclass, field
from typing import Final

from pyoxigraph import Variable

from ...rdf.namespaces import PREFIXES
from ..errors import LanguageError, Span
from .ast import Aggregation, StreamClause, TimeWindow
from .shape import constraint_end
from .terms import iri_text
from .tokens import Kind, Token, closing, tokenize

FUNCTIONS: Final = ("AVG", "SUM", "COUNT", "MIN", "MAX")
_UNITS: Final = {
    "ns": 1,
    "us": 1_000,
    "ms": 1_000_000,
    "s": 1_000_000_000,
    "m": 60_000_000_000,
    "h": 3_600_000_000_000,
    "d": 86_400_000_000_000,
}
_LONGEST: Final = 2**62
_WINDOW_EXAMPLE: Final = "write `[RANGE 5s STEP 1s]`"
_FORMS: Final = ("SELECT", "CONSTRUCT", "ASK", "DESCRIBE")


@dataclass(slots=True)
class Clauses:
    """What the clauses say, gathered while reading. Windows are completed at the end."""

    kind: str = ""
    name: Token | None = None
    parameters: list[Token] = field(default_factory=list)
    every: int | None = None
    prefixes: dict[str, str] = field(default_factory=lambda: dict(PREFIXES))
    base: str = ""
    static: list[Token] = field(default_factory=list)
    streams: list[tuple[Token, TimeWindow | None, Span]] = field(default_factory=list)
    window: TimeWindow | None = None
    aggregations: list[Aggregation] = field(default_factory=list)
    filters: list[tuple[str, Span]] = field(default_factory=list)
    ours: list[Span] = field(default_factory=list)
    form: Token | None = None


class ClauseReader:
    """One pass over the tokens of a registered text; raises `LanguageError` where it stops."""

    def __init__(self, source: str) -> None:
        self.source = source
        self.tokens = tokenize(source)
        self.index = 0
        self.found = Clauses()

    def error(self, message: str, at: Token | None, hint: str = "") -> LanguageError:
        """An error at a token, or at the end of the text."""
        end = len(self.source.rstrip())
        span = Span(end, end) if at is None else at.span
        return LanguageError(message, self.source, span, hint)

    @property
    def here(self) -> Token | None:
        return self.tokens[self.index] if self.index < len(self.tokens) else None

    def is_word(self, *words: str) -> bool:
        here = self.here
        return here is not None and here.is_word(*words)

    def is_mark(self, *marks: str) -> bool:
        here = self.here
        return here is not None and here.is_mark(*marks)

    def take(self) -> Token:
        here = self.here
        if here is None:
            raise self.error("the text ends too early", None)
        self.index += 1
        return here

    def expect_mark(self, mark: str, hint: str) -> Token:
        if not self.is_mark(mark):
            raise self.due(f"`{mark}`", hint)
        return self.take()

    def due(self, what: str, hint: str = "") -> LanguageError:
        here = self.here
        if here is None:
            return self.error(f"{what} is due, but the text ends", None, hint)
        return self.error(f"{what} is due, not `{here.text}`", here, hint)

    def mark_ours(self, first: Token) -> None:
        """What was read since ``first`` is no SPARQL."""
        self.found.ours.append(Span(first.start, self.tokens[self.index - 1].end))

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

    def prologue(self) -> None:
        """PREFIX and BASE (SPARQL 1.1 §4.1); they may stand on both sides of REGISTER."""
        while self.is_word("PREFIX", "BASE"):
            word = self.take()
            if word.is_word("BASE"):
                self.found.base = iri_text(self.iri("BASE"), self.source, {})
                continue
            name = self.here
            if name is None or name.kind is not Kind.PREFIXED or not name.text.endswith(":"):
                raise self.due("a prefix like `dyknow:`", "write `PREFIX dyknow: <http://…>`")
            self.take()
            iri = self.here
            if iri is None or iri.kind is not Kind.IRI:
                raise self.due("the IRI of the prefix", f"write `PREFIX {name.text} <http://…>`")
            self.take()
            self.found.prefixes[name.text[:-1]] = iri_text(iri, self.source, {}, self.found.base)

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
            self.found.every = self.duration("the period")
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
            self.aggregate(here)
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
            window = self.window("a stream's window") if self.is_mark("[") else None
            self.mark_ours(first)
            span = Span(first.start, self.tokens[self.index - 1].end)
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

    def iri(self, after: str) -> Token:
        here = self.here
        if here is None or here.kind not in (Kind.IRI, Kind.PREFIXED):
            hint = "no space may follow `<`" if self.is_mark("<") else "write `<http://…>`"
            raise self.due(f"an IRI after {after}", hint)
        return self.take()

    def window_clause(self, first: Token) -> None:
        if self.found.window is not None:
            raise self.error("a second WINDOW clause", first, "one window holds for all streams")
        self.found.window = self.window("WINDOW")
        self.mark_ours(first)

    def window(self, what: str) -> TimeWindow:
        """``[RANGE 5s STEP 1s]``, ``[RANGE 5s TUMBLING]``; no STEP: the COMPUTE EVERY period."""
        open_bracket = self.expect_mark("[", _WINDOW_EXAMPLE)
        if self.is_word("TRIPLES"):
            raise self.error(
                "windows of a number of triples are not understood yet",
                self.here,
                "write a window of time: `[RANGE 5s STEP 1s]`",
            )
        if not self.is_word("RANGE"):
            raise self.due("RANGE", _WINDOW_EXAMPLE)
        self.take()
        length = self.duration(f"the RANGE of {what}")
        if self.is_word("TUMBLING"):
            self.take()
            step = length
        elif self.is_word("STEP", "SLIDE"):
            self.take()
            step = self.duration(f"the STEP of {what}")
        elif self.found.every is not None:
            step = self.found.every
        else:
            raise self.error(
                "the window has no STEP, and the query no COMPUTE EVERY to take it from",
                open_bracket,
                _WINDOW_EXAMPLE,
            )
        self.expect_mark("]", _WINDOW_EXAMPLE)
        return TimeWindow(length, step)

    def duration(self, what: str) -> int:
        """``5s``, ``500ms``: a whole number and a unit, in ns."""
        hint = "write a whole number and a unit (ns us ms s m h d): `5s`"
        number = self.here
        if number is None or number.kind is not Kind.NUMBER or not number.text.isdigit():
            raise self.due(what, hint)
        self.take()
        unit = self.here
        # Units are lower case; the engines of C-SPARQL accept both.
        factor = None
        if unit is not None and unit.kind is Kind.WORD:
            factor = _UNITS.get(unit.text.lower())
        if factor is None:
            raise self.due(f"the unit of {what}", hint)
        self.take()
        # A longer text than any length of time is not handed to int().
        value = int(number.text) * factor if len(number.text) <= 20 else _LONGEST
        if not 0 < value < _LONGEST:
            raise self.error(f"{what} is out of range", number, "it is more than 0 and < 146 years")
        return value

    # -- AGGREGATE -------------------------------------------------------------------------

    def aggregate(self, first: Token) -> None:
        """``AGGREGATE {(?a, AVG, {?x}) FILTER (…)}``: aggregations and filters in any order."""
        hint = "write `AGGREGATE {(?avg, AVG, {?x}) FILTER (?avg > 100)}`"
        self.expect_mark("{", hint)
        before = len(self.found.aggregations)
        while not self.is_mark("}"):
            if self.is_word("FILTER"):
                self.filter()
            elif self.is_mark("("):
                self.aggregation(hint)
            elif self.is_mark(".", ",", ";"):
                self.take()
            else:
                raise self.due("`(` or FILTER", hint)
        close = self.take()
        if len(self.found.aggregations) == before and not self.found.aggregations:
            raise self.error("the AGGREGATE clause aggregates nothing", close, hint)
        self.mark_ours(first)

    def filter(self) -> None:
        self.take()
        start = self.here
        if start is None or self.is_mark("}", ")", "]"):
            raise self.due("a condition", "write `FILTER (?avg > 100)`")
        self.index = constraint_end(self.tokens, self.index)
        end = self.tokens[self.index - 1].end
        self.found.filters.append((self.source[start.start : end], Span(start.start, end)))

    def aggregation(self, hint: str) -> None:
        first = self.take()
        alias = self.variable("the name of the aggregate, like `?avg`,", hint)
        self.expect_mark(",", hint)
        function = self.here
        if function is None or function.kind is not Kind.WORD:
            raise self.due("a function", f"known are {', '.join(FUNCTIONS)}")
        name = function.text.upper()
        if name not in FUNCTIONS:
            near = difflib.get_close_matches(name, FUNCTIONS, n=1)
            ending = f"did you mean {near[0]}?" if near else f"known are {', '.join(FUNCTIONS)}"
            raise self.error(f"`{function.text}` is no aggregate function", function, ending)
        self.take()
        self.expect_mark(",", hint)
        self.expect_mark("{", hint)
        argument = self.variable("a variable of WHERE", hint)
        if self.is_mark(","):
            raise self.error("an aggregate is taken over one variable", self.here, hint)
        self.expect_mark("}", hint)
        close = self.expect_mark(")", hint)
        self.found.aggregations.append(
            Aggregation(
                Variable(alias.text[1:]),
                name,
                Variable(argument.text[1:]),
                Span(first.start, close.end),
            )
        )

    def variable(self, what: str, hint: str) -> Token:
        here = self.here
        if here is None or here.kind is not Kind.VARIABLE:
            raise self.due(what, hint)
        return self.take()

    # -- when all is read ------------------------------------------------------------------

    def stream_clauses(self) -> tuple[StreamClause, ...]:
        """FROM STREAM clauses; one without a window of its own takes the WINDOW clause."""
        clauses: list[StreamClause] = []
        for token, own, span in self.found.streams:
            window = own or self.found.window
            if window is None:
                raise self.error("the stream has no window", token, _WINDOW_EXAMPLE)
            iri = iri_text(token, self.source, self.found.prefixes, self.found.base)
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
