"""Bounds of query texts. A larger text would keep the engine busy for seconds."""

from __future__ import annotations

from typing import Final

from ...sparql.tokens import Limits
from ..errors import LanguageError, Span

LONGEST: Final = 64 * 1024
"""The greatest number of characters."""
MOST_TOKENS: Final = 4096
MOST_PATTERNS: Final = 128
"""Triple patterns; each step and each alternative of a property path counts as one."""
MOST_OPERATORS: Final = 128
"""The height of an expression: later passes recurse over it."""
MOST_PARTS: Final = 160
"""Groups in braces, FILTER, BIND and VALUES: each adds a level to the plan."""
_HINT: Final = "load its data as an ontology, or ask with several queries"
LIMITS: Final = Limits(
    tokens=MOST_TOKENS,
    patterns=MOST_PATTERNS,
    operators=MOST_OPERATORS,
    parts=MOST_PARTS,
    hint=_HINT,
)
"""The bounds of continuous queries and templates."""


def check_length(source: str) -> None:
    """Raise `LanguageError` for a text that is too long to be tokenized."""
    if len(source) > LONGEST:
        raise LanguageError(
            f"the text has more than {LONGEST} characters", source[:1000], Span(0, 0), _HINT
        )
