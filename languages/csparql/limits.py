"""How large a query text may be: what is larger would keep its parsers busy for seconds, or
overflow their stack.

Called by `clauses` for every text, and by `parser` for the SPARQL in it. Brackets are bounded by
`tokens.MAX_DEPTH`.
"""

from __future__ import annotations

from collections.abc import Sized
from typing import Final

from ...ontology.errors import QueryRefused
from ...ontology.query_guard import check_size
from ..errors import LanguageError, Span

LONGEST: Final = 64 * 1024
"""Characters of a text."""
MOST_TOKENS: Final = 4096
"""rdflib's parser takes a millisecond for each of an expression."""
MOST_PATTERNS: Final = 128
"""Triple patterns, and steps of property paths."""
_HINT: Final = "load what it lists as an ontology, or ask with several queries"


def check_length(source: str) -> None:
    """Raises `LanguageError` for a text that is not even to be split into tokens."""
    if len(source) > LONGEST:
        raise LanguageError(
            f"the text has more than {LONGEST} characters", source[:1000], Span(0, 0), _HINT
        )


def check_tokens(tokens: Sized, source: str) -> None:
    """Raises `LanguageError` for more than `MOST_TOKENS` tokens."""
    if len(tokens) > MOST_TOKENS:
        raise LanguageError(
            f"the text has more than {MOST_TOKENS} words and signs", source, Span(0, 0), _HINT
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
