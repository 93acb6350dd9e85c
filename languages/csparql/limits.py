"""How large a query text may be: what is larger would keep the engine busy for seconds."""

from __future__ import annotations

from typing import Final

from ...sparql.tokens import Limits
from ..errors import LanguageError, Span

LONGEST: Final = 64 * 1024
"""Characters of a text."""
MOST_TOKENS: Final = 4096
MOST_PATTERNS: Final = 128
"""Triple patterns; each step and each alternative of a property path is one."""
MOST_OPERATORS: Final = 128
"""Operators that stand in each other: readers of an expression recurse."""
MOST_PARTS: Final = 160
"""Groups in braces, FILTER, BIND and VALUES: each stands in the plan on top of those before it."""
_HINT: Final = "load what it lists as an ontology, or ask with several queries"
LIMITS: Final = Limits(
    tokens=MOST_TOKENS,
    patterns=MOST_PATTERNS,
    operators=MOST_OPERATORS,
    parts=MOST_PARTS,
    hint=_HINT,
)
"""Those of continuous queries and templates."""


def check_length(source: str) -> None:
    """Raises `LanguageError` for a text that is not even to be split into tokens."""
    if len(source) > LONGEST:
        raise LanguageError(
            f"the text has more than {LONGEST} characters", source[:1000], Span(0, 0), _HINT
        )
