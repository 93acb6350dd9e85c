"""Bounds of query texts. A larger text would keep the engine busy for seconds."""

from __future__ import annotations

from typing import Final

from ...sparql.tokens import Limits
from ..errors import LanguageError, Span

LONGEST: Final = 64 * 1024
"""The greatest number of characters."""
_HINT: Final = "load its data as an ontology, or ask with several queries"
LIMITS: Final = Limits(tokens=4096, patterns=128, operators=128, parts=160, hint=_HINT)
"""The bounds of continuous queries and templates (`Limits` explains them). Later passes recurse
over the height of an expression; each part adds a level to the plan."""


def check_length(source: str) -> None:
    """Raise `LanguageError` for a text that is too long to be tokenized."""
    if len(source) > LONGEST:
        raise LanguageError(
            f"the text has more than {LONGEST} characters", source[:1000], Span(0, 0), _HINT
        )
