"""Steps over the tokens of a text: what is there, what is due, and what a name means.

All that reads our clauses shares it, so that each says alike what it misses and where.
"""

from __future__ import annotations

from collections.abc import Mapping

from ..errors import LanguageError, Span
from .terms import iri_text
from .tokens import Kind, Token, tokenize


class Cursor:
    """A place in the tokens of ``source``, and the prefixes and base declared before it.

    ``prefixes`` are those that need no declaration.
    """

    def __init__(self, source: str, prefixes: Mapping[str, str]) -> None:
        self.source = source
        self.tokens = tokenize(source)
        self.index = 0
        self.prefixes: dict[str, str] = dict(prefixes)
        self.base = ""

    def error(self, message: str, at: Token | None, hint: str = "") -> LanguageError:
        """An error at a token, or at the end of the text."""
        end = len(self.source.rstrip())
        span = Span(end, end) if at is None else at.span
        return LanguageError(message, self.source, span, hint)

    def due(self, what: str, hint: str = "") -> LanguageError:
        """The error that ``what`` is not here."""
        here = self.here
        if here is None:
            return self.error(f"{what} is due, but the text ends", None, hint)
        return self.error(f"{what} is due, not `{here.text}`", here, hint)

    @property
    def here(self) -> Token | None:
        return self.tokens[self.index] if self.index < len(self.tokens) else None

    @property
    def before(self) -> Token:
        """The token that was taken last."""
        return self.tokens[self.index - 1]

    def is_word(self, *words: str) -> bool:
        here = self.here
        return here is not None and here.is_word(*words)

    def is_mark(self, *marks: str) -> bool:
        here = self.here
        return here is not None and here.is_mark(*marks)

    def take(self) -> Token:
        here = self.here
        if here is None:
            raise self.error("the text ends too early", None)
        self.index += 1
        return here

    def expect_mark(self, mark: str, hint: str) -> Token:
        if not self.is_mark(mark):
            raise self.due(f"`{mark}`", hint)
        return self.take()

    def iri(self, after: str) -> Token:
        here = self.here
        if here is None or here.kind not in (Kind.IRI, Kind.PREFIXED):
            hint = "no space may follow `<`" if self.is_mark("<") else "write `<http://…>`"
            raise self.due(f"an IRI after {after}", hint)
        return self.take()

    def variable(self, what: str, hint: str) -> Token:
        here = self.here
        if here is None or here.kind is not Kind.VARIABLE:
            raise self.due(what, hint)
        return self.take()

    def iri_of(self, token: Token) -> str:
        """What an IRI or prefixed name means by the declarations read so far."""
        return iri_text(token, self.source, self.prefixes, self.base)

    def prologue(self) -> None:
        """PREFIX and BASE (SPARQL 1.1 §4.1); they may stand on both sides of REGISTER."""
        while self.is_word("PREFIX", "BASE"):
            word = self.take()
            if word.is_word("BASE"):
                self.base = iri_text(self.iri("BASE"), self.source, {})
                continue
            name = self.here
            if name is None or name.kind is not Kind.PREFIXED or not name.text.endswith(":"):
                raise self.due("a prefix like `dyknow:`", "write `PREFIX dyknow: <http://…>`")
            self.take()
            iri = self.here
            if iri is None or iri.kind is not Kind.IRI:
                raise self.due("the IRI of the prefix", f"write `PREFIX {name.text} <http://…>`")
            self.take()
            self.prefixes[name.text[:-1]] = iri_text(iri, self.source, {}, self.base)
