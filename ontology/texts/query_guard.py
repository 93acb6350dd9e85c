"""Checks users' SPARQL queries before Oxigraph evaluates them (DESIGN §4).

Oxigraph's optimizer takes minutes over a path of a thousand steps, its parser recurses, and SERVICE
and LOAD contact other servers. `dyknow.sparql` parses the text here. Oxigraph parses it again where
it evaluates it; in the service that is a worker process with a deadline.
"""

from __future__ import annotations

from typing import Final, TypeAlias

from pyoxigraph import NamedNode

from ...sparql.ast import Query
from ...sparql.errors import LanguageError
from ...sparql.parser import FORMS, QueryReader
from ...sparql.tokens import Limits
from ..errors import QueryRefused
from .turtle import ALL_PREFIXES

LONGEST_TEXT: Final = 8 * 1024
"""The greatest size of a query, in bytes of UTF-8."""
LIMITS: Final = Limits(patterns=64, operators=128)
"""At most 64 triple patterns, where each step of a path counts as one, and brackets at most 64
deep."""

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
            "SERVICE is refused: this service contacts no other",
            self.here,
            "load the data as an ontology, then query it here",
        )

    def unexpected(self, hint: str = "") -> LanguageError:
        here = self.here
        if here is not None and here.is_word(*_UPDATES):
            return self.error(
                f"{here.text.upper()} is refused: only queries are allowed here, no updates",
                here,
                "ontologies, templates and annotations have routes of their own",
            )
        return super().unexpected(hint)

    def read(self) -> Query:
        """Parse the whole text."""
        self.prologue()
        if self.is_word(*_UPDATES):
            raise self.unexpected()
        if not self.is_word(*FORMS):
            raise self.error(
                "the text is not a query: SELECT, ASK, CONSTRUCT or DESCRIBE is missing",
                self.here,
                "write for example SELECT * { ?s ?p ?o } LIMIT 10",
            )
        return self.query()


def check_user_query(text: str, base: str = "") -> None:
    """Return normally if ``text`` is a SPARQL 1.1 query that the service may evaluate.

    Raises `QueryRefused` with line, column and hint for SERVICE, for LOAD and every update, for
    syntax errors, and for texts over 8 KiB, 64 levels of brackets or 64 triple patterns. The shared
    prefixes and ``:`` need no declaration. Relative IRIs are resolved against ``base``; without one
    they are errors. Cost: linear in the text.
    """
    read_query(text, base)


def read_query(text: str, base: str = "") -> tuple[Query, Dataset | None]:
    """Check ``text`` like `check_user_query`. Returns its tree and the graphs of its FROM clauses,
    None if it has none."""
    if len(text.encode("utf-8", "surrogatepass")) > LONGEST_TEXT:
        raise QueryRefused(f"the query has more than {LONGEST_TEXT} bytes", 1, 1)
    reader = _Reader(text, ALL_PREFIXES, LIMITS)
    reader.base = base
    try:
        return reader.read(), reader.dataset
    except LanguageError as error:
        raise QueryRefused(error.message, error.line, error.column, error.hint) from None
