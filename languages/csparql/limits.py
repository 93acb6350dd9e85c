"""How large a query text may be: what is larger would keep its parsers busy for seconds, or
overflow their stack.

Called by `clauses` for every text, and by `parser` for the SPARQL in it. Brackets are bounded by
`tokens.MAX_DEPTH`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from ...ontology.errors import QueryRefused
from ...ontology.query_guard import check_size
from ..errors import LanguageError, Span
from .tokens import Token

LONGEST: Final = 64 * 1024
"""Characters of a text."""
MOST_TOKENS: Final = 4096
"""rdflib's parser takes a millisecond for each of an expression."""
MOST_PATTERNS: Final = 128
"""Triple patterns, and steps of property paths."""
MOST_OPERATORS: Final = 128
"""Operators that stand in each other: whoever reads an expression recurses. Not those of
which many are halved: `||` and IN."""
MOST_PARTS: Final = 160
"""Groups in braces, FILTER, BIND and VALUES: each stands in the plan on top of those before it."""
_OPERATORS: Final = ("+", "-", "*", "/", "!", "&&")
_HINT: Final = "load what it lists as an ontology, or ask with several queries"


def check_length(source: str) -> None:
    """Raises `LanguageError` for a text that is not even to be split into tokens."""
    if len(source) > LONGEST:
        raise LanguageError(
            f"the text has more than {LONGEST} characters", source[:1000], Span(0, 0), _HINT
        )


def check_tokens(tokens: Sequence[Token], source: str) -> None:
    """Raises `LanguageError` for more than `MOST_TOKENS` tokens, for more than `MOST_PARTS` parts
    of patterns, and for expressions with more than `MOST_OPERATORS` in each other."""
    if len(tokens) > MOST_TOKENS:
        raise LanguageError(
            f"the text has more than {MOST_TOKENS} words and signs", source, Span(0, 0), _HINT
        )
    parts = 0
    for token in tokens:
        parts += token.is_mark("{") or token.is_word("FILTER", "BIND", "VALUES")
        if parts > MOST_PARTS:
            message = f"more than {MOST_PARTS} groups, FILTER, BIND and VALUES"
            raise LanguageError(message, source, token.span, "ask with several queries")
    _check_operators(tokens, source)


@dataclass(slots=True)
class _Brackets:
    """What stands between two brackets: how deep its expressions are, the one that is read by the
    operators of its own and by those in brackets in it."""

    has_patterns: bool
    """Its operators are those of paths and signs of numbers: patterns are bounded."""
    own: int = 0
    inner: int = 0
    deepest: int = 0

    def hold(self, depth: int) -> None:
        """Of what stands in it, something is so deep."""
        if self.has_patterns:
            self.deepest = max(self.deepest, depth)
        else:
            self.inner = max(self.inner, depth)

    def end(self) -> int:
        """An expression ends here; how deep the deepest is."""
        self.deepest = max(self.deepest, self.own + self.inner)
        self.own = self.inner = 0
        return self.deepest


def _check_operators(tokens: Sequence[Token], source: str) -> None:
    """Raises `LanguageError` with the place. Cost: one pass. Operators in a row stand in each
    other, too: ``a + b + c`` is ``(a + b) + c``."""
    opened = [_Brackets(has_patterns=True)]
    for token in tokens:
        within = opened[-1]
        if token.is_mark("(", "[", "{"):
            opened.append(_Brackets(has_patterns=token.text == "{"))
        elif token.is_mark(")", "]", "}"):
            opened.pop()
            opened[-1].hold(within.end())
        elif token.is_mark(","):
            within.end()
        elif token.is_mark(*_OPERATORS) and not within.has_patterns:
            within.own += 1
        if opened[-1].own + opened[-1].inner > MOST_OPERATORS:
            raise LanguageError(
                f"more than {MOST_OPERATORS} operators stand in each other",
                source,
                token.span,
                "ask with several queries, one after the other",
            )


def check_patterns(sparql: str, source: str) -> None:
    """Raises `LanguageError` with the place for more than `MOST_PATTERNS` triple patterns.

    ``sparql`` has the same offsets as ``source``.
    """
    try:
        check_size(sparql, MOST_PATTERNS)
    except QueryRefused as error:
        lines = source.split("\n")[: error.line - 1]
        place = min(sum(map(len, lines)) + len(lines) + error.column - 1, len(source))
        raise LanguageError(error.message, source, Span(place, place), _HINT) from None
