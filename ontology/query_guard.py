"""What a user's SPARQL text may ask for (DESIGN §4).

Checked before Oxigraph sees the text: its optimizer takes minutes over a path of a thousand steps,
its parser recurses, and SERVICE and LOAD would reach out. `dyknow.sparql` reads the text; Oxigraph
reads it again where it evaluates it, in the service a worker process with a deadline.
"""

from __future__ import annotations

from typing import Final, TypeAlias
from typing import Literal as OneOf

from pyoxigraph import NamedNode

from ..sparql.ast import Query
from ..sparql.errors import LanguageError
from ..sparql.parser import FORMS, QueryReader
from ..sparql.tokens import Limits
from .errors import QueryRefused
from .turtle import ALL_PREFIXES

LONGEST_TEXT: Final = 8 * 1024
"""Bytes of UTF-8."""
LIMITS: Final = Limits(patterns=64, operators=128)
"""64 triple patterns: each step of a property path counts as one; brackets 64 deep."""

QueryForm: TypeAlias = OneOf["select", "construct", "describe", "ask"]
Dataset: TypeAlias = tuple[tuple[NamedNode, ...], tuple[NamedNode, ...]]
"""The graphs of FROM, and those of FROM NAMED."""

_UPDATES: Final = frozenset(
    {"LOAD", "INSERT", "DELETE", "CLEAR", "DROP", "CREATE", "ADD", "MOVE", "COPY", "WITH"}
)


class _Reader(QueryReader):
    dataset: Dataset | None = None

    def clauses(self) -> None:
        while self.accept_word("FROM"):
            default, named_graphs = self.dataset or ((), ())
            is_named = self.accept_word("NAMED")
            graph = NamedNode(self.iri_of(self.iri("FROM")))
            if is_named:
                self.dataset = default, (*named_graphs, graph)
            else:
                self.dataset = (*default, graph), named_graphs

    def service(self) -> LanguageError:
        return self.error(
            "SERVICE is refused: nothing outside this service is asked",
            self.here,
            "load the data as an ontology, then ask for it here",
        )

    def unexpected(self, hint: str = "") -> LanguageError:
        here = self.here
        if here is not None and here.is_word(*_UPDATES):
            return self.error(
                f"{here.text.upper()} is refused: this is the place of queries, not of updates",
                here,
                "ontologies, templates and annotations have routes of their own",
            )
        return super().unexpected(hint)

    def read(self) -> Query:
        """The tree of the text, of which all is read."""
        self.prologue()
        if self.is_word(*_UPDATES):
            raise self.unexpected()
        if not self.is_word(*FORMS):
            raise self.error(
                "the text asks nothing: SELECT, ASK, CONSTRUCT or DESCRIBE is missing",
                self.here,
                "such as SELECT * { ?s ?p ?o } LIMIT 10",
            )
        return self.query()


def check_user_query(text: str) -> None:
    """Returns if ``text`` is a SPARQL 1.1 query that may be evaluated.

    Raises `QueryRefused` with line, column and hint for SERVICE, LOAD and every update, for texts
    over 8 KiB, 64 levels of brackets or 64 triple patterns, and for syntax errors. The shared
    prefixes and ``:`` need no declaration. Cost: linear in the text.
    """
    read_query(text)


def query_form(text: str) -> QueryForm:
    """Checks ``text`` like `check_user_query` and says what kind of answer it has."""
    return read_query(text)[0].form.lower()  # type: ignore[return-value]


def read_query(text: str) -> tuple[Query, Dataset | None]:
    """Checks ``text`` like `check_user_query`; its tree, and the graphs that its FROM clauses name,
    None if it has none."""
    if len(text.encode("utf-8", "surrogatepass")) > LONGEST_TEXT:
        raise QueryRefused(f"the query has more than {LONGEST_TEXT} bytes", 1, 1)
    reader = _Reader(text, ALL_PREFIXES, LIMITS)
    try:
        return reader.read(), reader.dataset
    except LanguageError as error:
        raise QueryRefused(error.message, error.line, error.column, error.hint) from None
