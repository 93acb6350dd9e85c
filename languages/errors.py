"""One error for all languages; SPARQL's room, which lies below, has it."""

from ..sparql.errors import LONGEST_LINE, LanguageError, Span

__all__ = ["LONGEST_LINE", "LanguageError", "Span"]
