"""A cursor over the tokens of a text, with the prefixes and errors that all readers share.

The readers of queries, clauses and requests extend or use it, so that they report errors in the
same words.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from pyoxigraph import Literal, NamedNode, Variable

from ..rdf.dictionary import Term
from .errors import LanguageError, Span
from .terms import iri_text, number, string_text
from .tokens import UNLIMITED, Kind, Lexer, Limits, Token

_TERMS: Final = frozenset({Kind.IRI, Kind.PREFIXED, Kind.VARIABLE, Kind.STRING, Kind.NUMBER})
_DATATYPE: Final = 'write `"100"^^xsd:integer`'


class Cursor:
    """A position in the tokens of ``source``, with the prefixes and base declared before it.

    ``tokens`` are the tokens read so far. ``prefixes`` initially contains those that need no
    declaration.
    """

    def __init__(
        self, source: str, prefixes: Mapping[str, str], limits: Limits = UNLIMITED
    ) -> None:
        self.source = source
        self.limits = limits
        self.lexer = Lexer(source, limits)
        self.tokens: list[Token] = []
        self.index = 0
        self.prefixes: dict[str, str] = dict(prefixes)
        self.base = ""
        self.here = self._read()
        """The next token; None at the end."""

    def _read(self) -> Token | None:
        if self.index == len(self.tokens):
            token = self.lexer.next()
            if token is None:
                return None
            self.tokens.append(token)
        return self.tokens[self.index]

    # -- errors ----------------------------------------------------------------------------

    def error(self, message: str, at: Token | None, hint: str = "") -> LanguageError:
        """Return an error at a token, or at the end of the text."""
        end = len(self.source.rstrip())
        span = Span(end, end) if at is None else at.span
        return LanguageError(message, self.source, span, hint)

    def expected(self, what: str, hint: str = "") -> LanguageError:
        """Return the error for a missing ``what``."""
        here = self.here
        if here is None:
            return self.error(f"expected {what}, but the text ends", None, hint)
        return self.error(f"expected {what}, found `{self.text_of(here)}`", here, hint)

    def unexpected(self, hint: str = "") -> LanguageError:
        """Return the error for a token that fits no rule. It reads the rest of the text first,
        since an error of the tokenizer, such as an unmatched bracket, explains more."""
        here = self.here
        while self.lexer.next() is not None:
            pass
        if here is None:
            end = self.last_token.end if self.index else 0
            advice = hint or "complete its last part, or remove that"
            return LanguageError("the query ends too early", self.source, Span(end, end), advice)
        before = self.tokens[self.index - 1] if self.index else None
        if not hint:
            hint = "the text before it is understood; look at what should follow there"
            if before is not None and {here.kind, before.kind} <= _TERMS:
                hint = "is a `.` missing before it, to end the triple?"
            elif here.is_mark("}"):
                hint = "something is missing before the `}`: is a triple incomplete?"
        return self.error(f"`{_abbreviate(self.text_of(here))}` is not allowed here", here, hint)

    def text_of(self, token: Token) -> str:
        """Return a token as written, with its escapes."""
        return self.source[token.start : token.end]

    # -- steps -----------------------------------------------------------------------------

    @property
    def at_end(self) -> bool:
        return self.here is None

    @property
    def last_token(self) -> Token:
        """The token taken last."""
        return self.tokens[self.index - 1]

    def is_word(self, *words: str) -> bool:
        here = self.here
        return here is not None and here.is_word(*words)

    def is_mark(self, *marks: str) -> bool:
        here = self.here
        return here is not None and here.kind is Kind.MARK and here.text in marks

    def take(self) -> Token:
        here = self.here
        if here is None:
            raise self.error("the text ends too early", None)
        self.index += 1
        self.here = self._read()
        return here

    def operator(self) -> Token | None:
        """Return the next token where an operator may follow: ``<`` is less-than there and begins
        no IRI."""
        here = self.here
        if here is not None and here.kind is Kind.IRI:
            here = self.here = self.tokens[self.index] = self.lexer.operator_at(here)
        return here

    def accept_word(self, *words: str) -> bool:
        """Take the next token if it is one of these words."""
        found = self.is_word(*words)
        if found:
            self.take()
        return found

    def accept_mark(self, *marks: str) -> bool:
        found = self.is_mark(*marks)
        if found:
            self.take()
        return found

    def expect_mark(self, mark: str, hint: str) -> Token:
        if not self.is_mark(mark):
            raise self.expected(f"`{mark}`", hint)
        return self.take()

    # -- names and terms -------------------------------------------------------------------

    def iri(self, after: str) -> Token:
        here = self.here
        if here is None or here.kind not in (Kind.IRI, Kind.PREFIXED):
            hint = "no space may follow `<`" if self.is_mark("<") else "write `<http://…>`"
            raise self.expected(f"an IRI after {after}", hint)
        return self.take()

    def variable(self, what: str, hint: str) -> Token:
        here = self.here
        if here is None or here.kind is not Kind.VARIABLE:
            raise self.expected(what, hint)
        return self.take()

    def iri_of(self, token: Token) -> str:
        """Resolve an IRI or prefixed name by the declarations read so far."""
        return iri_text(token, self.source, self.prefixes, self.base)

    def term(self) -> Term | Variable:
        """Read a term or variable; a blank node raises `LanguageError`.

        A sign belongs to the number directly after it.
        """
        token = self.here
        if token is None:
            raise self.expected("a term", "write an IRI, a number, a text in quotes, or a variable")
        match token.kind:
            case Kind.VARIABLE:
                return Variable(self.take().text[1:])
            case Kind.IRI | Kind.PREFIXED:
                return NamedNode(self.iri_of(self.take()))
            case Kind.STRING:
                return self._literal()
            case Kind.NUMBER:
                return number(self.take().text)
            case Kind.WORD if token.is_word("TRUE", "FALSE"):
                return Literal(self.take().text.lower() == "true")
            # The tokenizer separates the sign, since `?v-1` is a subtraction.
            case Kind.MARK if self.is_signed_number():
                return number(self.take().text + self.take().text)
            case Kind.BLANK:
                raise self.error(
                    "a blank node names nothing outside its own text",
                    token,
                    "give an IRI, or leave it a variable: `?o`",
                )
            case _:
                pass
        hint = "write an IRI, a prefixed name, a number, a string, true, false, or a variable"
        if token.kind is Kind.WORD:
            hint = f'write `dyknow:{token.text}` for a name, `"{token.text}"` for a text'
        raise self.error(f"`{token.text}` is not a term", token, hint)

    def is_signed_number(self) -> bool:
        """Return whether the next token is the sign of a number ([150]-[155])."""
        here = self.here
        if here is None or not here.is_mark("+", "-"):
            return False
        after = self.source[here.end : here.end + 2]
        return after[:1].isdecimal() or (after[:1] == "." and after[1:].isdecimal())

    def _literal(self) -> Literal:
        """[129] RDFLiteral."""
        text = string_text(self.take(), self.source)
        after = self.here
        if after is None:
            return Literal(text)
        if after.kind is Kind.LANGUAGE:
            self.take()
            try:
                return Literal(text, language=after.text[1:])
            except ValueError as error:
                raise self.error(f"not a language tag: {error}", after) from None
        if after.is_mark("^"):
            raise self.error("a datatype is joined with `^^`", after, _DATATYPE)
        if not after.is_mark("^^"):
            return Literal(text)
        self.take()
        name = self.here
        if name is None or name.kind not in (Kind.IRI, Kind.PREFIXED):
            raise self.error("expected a datatype after `^^`", after, _DATATYPE)
        datatype = NamedNode(self.iri_of(self.take()))
        try:
            return Literal(text, datatype=datatype)
        except ValueError as error:
            raise self.error(f"not a literal: {error}", name) from None

    def prologue(self) -> None:
        """Read PREFIX and BASE ([4]-[6]), which may stand before and after REGISTER."""
        while self.is_word("PREFIX", "BASE"):
            word = self.take()
            if word.is_word("BASE"):
                self.base = iri_text(self.iri("BASE"), self.source, {}, self.base)
                continue
            name = self.here
            if (
                name is None
                or name.kind is not Kind.PREFIXED
                or name.text.find(":") < len(name.text) - 1
            ):
                raise self.expected("a prefix like `dyknow:`", "write `PREFIX dyknow: <http://…>`")
            self.take()
            iri = self.here
            if iri is None or iri.kind is not Kind.IRI:
                raise self.expected(
                    "the IRI of the prefix", f"write `PREFIX {name.text} <http://…>`"
                )
            self.take()
            self.prefixes[name.text[:-1]] = iri_text(iri, self.source, {}, self.base)


def _abbreviate(word: str) -> str:
    return word if len(word) <= 40 else word[:40] + "…"
