"""The error of all languages, which the room `sparql` defines."""

from ..sparql.errors import LONGEST_LINE, LanguageError, Span

__all__ = ["LONGEST_LINE", "LanguageError", "Span"]
