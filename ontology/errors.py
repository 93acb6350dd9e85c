"""The errors of this room."""

from __future__ import annotations


class OntologyError(ValueError):
    """The room refused an ontology, a template or a store. Nothing took effect.

    ``line`` and ``column`` count from 1; they are None if the error has no place in the text.
    """

    def __init__(
        self, message: str, line: int | None = None, column: int | None = None, hint: str = ""
    ) -> None:
        super().__init__(_with_place(message, line, column))
        self.message = message
        self.line = line
        self.column = column
        self.hint = hint


class QueryRefused(ValueError):
    """A SPARQL text is malformed, too large, or uses a forbidden feature."""

    def __init__(self, message: str, line: int, column: int, hint: str = "") -> None:
        super().__init__(_with_place(message, line, column))
        self.message = message
        self.line = line
        self.column = column
        self.hint = hint


def _with_place(message: str, line: int | None, column: int | None) -> str:
    if line is None:
        return message
    return f"line {line}, column {column}: {message}" if column else f"line {line}: {message}"
