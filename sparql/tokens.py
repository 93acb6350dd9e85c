"""The tokenizer of SPARQL 1.1 (§19.8), with offsets. It reads a token when the parser asks for it.

The parser decides the meaning of ``<``: it begins an IRI unless an operator may follow
(`Lexer.operator_at`). So each text has one reading and is read once. White space and comments yield
no tokens. The tokenizer resolves code point escapes (``\\u0041``, §19.2) in names; `terms` resolves
those in IRIs and strings.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

from .errors import LanguageError, Span


class Kind(StrEnum):
    """The kind of a token, named as in SPARQL's grammar."""

    IRI = "IRI"
    STRING = "string"
    VARIABLE = "variable"
    BLANK = "blank node"
    LANGUAGE = "language tag"
    PREFIXED = "prefixed name"
    NUMBER = "number"
    WORD = "word"
    MARK = "mark"


@dataclass(frozen=True, slots=True)
class Token:
    """A token and its place. ``text`` is as written, except for resolved escapes in names."""

    kind: Kind
    text: str
    start: int
    end: int

    @property
    def span(self) -> Span:
        return Span(self.start, self.end)

    def is_word(self, *words: str) -> bool:
        """Return whether it is one of these keywords (given in upper case), in any case."""
        return self.kind is Kind.WORD and self.text.upper() in words

    def is_mark(self, *marks: str) -> bool:
        return self.kind is Kind.MARK and self.text in marks


@dataclass(frozen=True, slots=True)
class Limits:
    """Bounds of a text. A larger one would keep later passes busy or nest too deeply.

    ``patterns`` counts triple patterns and each step and alternative of a path. ``operators``
    bounds the height of an expression's tree. ``parts`` counts groups in braces, FILTER, BIND and
    VALUES. ``hint`` tells the user an alternative.
    """

    tokens: int = 1 << 20
    patterns: int = 1 << 20
    operators: int = 1 << 20
    parts: int = 1 << 20
    hint: str = ""


UNLIMITED: Final = Limits()
"""For texts that a bound on characters limits already."""
DEEPEST: Final = 64
"""The greatest depth of nested brackets: later passes recurse."""

# [164] PN_CHARS_BASE, [165] PN_CHARS_U, [167] PN_CHARS, and what VARNAME [166] has besides.
_BASE: Final = (
    r"A-Za-z\u00c0-\u00d6\u00d8-\u00f6\u00f8-\u02ff\u0370-\u037d\u037f-\u1fff\u200c-\u200d"
    r"\u2070-\u218f\u2c00-\u2fef\u3001-\ud7ff\uf900-\ufdcf\ufdf0-\ufffd\U00010000-\U000effff"
)
_MORE: Final = r"0-9\u00b7\u0300-\u036f\u203f-\u2040"
NAME_START: Final = f"{_BASE}_"
"""The characters of [165] PN_CHARS_U: those with which an XML name without a colon begins."""
NAME_NEXT: Final = rf"{_BASE}_{_MORE}\-"
"""The characters of [167] PN_CHARS: with the full stop those of such a name."""
_UNICODE: Final = r"\\u[0-9A-Fa-f]{4}|\\U[0-9A-Fa-f]{8}"
_FIRST: Final = rf"(?:[{_BASE}_0-9]|{_UNICODE})"
_NEXT: Final = rf"(?:[{_BASE}_{_MORE}\-]|{_UNICODE})"
_PLX: Final = r"(?:%[0-9A-Fa-f]{2}|\\[_~.\-!$&'()*+,;=/?#@%])"  # [169]-[173]
_PREFIX: Final = rf"(?:[{_BASE}]|{_UNICODE})(?:{_NEXT}|\.+(?={_NEXT}))*"  # [168] PN_PREFIX
_LOCAL: Final = (  # [169] PN_LOCAL
    rf"(?:{_FIRST}|:|{_PLX})(?:{_NEXT}|:|{_PLX}|\.+(?={_NEXT}|:|{_PLX}))*"
)
IRI: Final = rf'<(?:[^<>"{{}}|^`\\\x00-\x20]|{_UNICODE})*>'  # [139] IRIREF
STRING: Final = r"""(?:\"\"\"(?:"{0,2}(?:[^"\\]|\\.))*\"\"\"  # [159] long strings
      |'''(?:'{0,2}(?:[^'\\]|\\.))*'''                # [158]
      |"(?:[^"\\\r\n]|\\[^\r\n])*"                    # [157]
      |'(?:[^'\\\r\n]|\\[^\r\n])*')                   # [156]
"""
_TOKEN: Final = re.compile(
    rf"""
    (?P<skip>[\ \t\r\n\f\ufeff]+|\#[^\r\n]*)
  | (?P<IRI>{IRI})
  | (?P<STRING>{STRING})
  | (?P<VARIABLE>[?$]{_FIRST}(?:[{_BASE}_{_MORE}]|{_UNICODE})*)          # [143] VAR1, VAR2
  | (?P<BLANK>_:{_FIRST}(?:{_NEXT}|\.+(?={_NEXT}))*)                     # [142] BLANK_NODE_LABEL
  | (?P<LANGUAGE>@[A-Za-z]+(?:-[A-Za-z0-9]+)*)                           # [145] LANGTAG
  | (?P<PREFIXED>(?:{_PREFIX})?:(?:{_LOCAL})?)                           # [140], [141]
  | (?P<NUMBER>[0-9]+\.[0-9]*[eE][+-]?[0-9]+                             # [146]-[148]
      |[0-9]*\.[0-9]+(?:[eE][+-]?[0-9]+)?
      |[0-9]+[eE][+-]?[0-9]+|[0-9]+)
  | (?P<WORD>[A-Za-z_]\w*)
  | (?P<MARK>\^\^|&&|\|\||!=|<=|>=|[{{}}()\[\].,;=<>!+\-*/|^?])
    """,
    re.VERBOSE | re.DOTALL,
)
_NAMES: Final = frozenset({Kind.VARIABLE, Kind.BLANK, Kind.PREFIXED})
_ESCAPES: Final = re.compile(r"\\u([0-9A-Fa-f]{4})|\\U([0-9A-Fa-f]{8})")
_CLOSING: Final = {"{": "}", "(": ")", "[": "]"}
_PARTS: Final = ("FILTER", "BIND", "VALUES")


class Lexer:
    """The tokens of ``source``, read one at a time.

    Brackets must match, at most `DEEPEST` deep. Raises `LanguageError` for a character that
    begins no token, an open string, unmatched brackets, and too many tokens. Cost: linear.
    """

    def __init__(self, source: str, limits: Limits) -> None:
        self.source = source
        self.limits = limits
        self.position = 0
        self.brackets: list[Token] = []
        self.number = 0
        self.parts = 0

    def next(self) -> Token | None:
        """Return the next token; None at the end of the text."""
        source = self.source
        while self.position < len(source):
            match = _TOKEN.match(source, self.position)
            if match is None:
                raise self._no_token(self.position)
            self.position = match.end()
            group = str(match.lastgroup)
            if group == "skip":
                continue
            kind = Kind[group]
            token = Token(kind, match[0], match.start(), match.end())
            if kind in _NAMES and "\\" in token.text:
                token = self._resolve_escapes(token)
            self._count(token)
            return token
        if self.brackets:
            token = self.brackets[-1]
            closing = _CLOSING[token.text]
            raise self._error(
                f"`{token.text}` is not closed", token, f"write `{closing}` where it ends"
            )
        return None

    def operator_at(self, token: Token) -> Token:
        """Reread ``token``, the last one, where an operator may follow: ``<`` is a mark there."""
        if token.kind is not Kind.IRI:
            return token
        mark = "<=" if self.source.startswith("<=", token.start) else "<"
        self.position = token.start + len(mark)
        return Token(Kind.MARK, mark, token.start, self.position)

    def _count(self, token: Token) -> None:
        limits = self.limits
        self.number += 1
        if self.number > limits.tokens:
            message = f"the text has more than {limits.tokens} words and signs"
            raise LanguageError(message, self.source, Span(0, 0), limits.hint)
        if token.is_mark("{") or token.is_word(*_PARTS):
            self.parts += 1
            if self.parts > limits.parts:
                message = f"more than {limits.parts} groups, FILTER, BIND and VALUES"
                raise self._error(message, token, "ask with several queries")
        if token.kind is not Kind.MARK:
            return
        if token.text in _CLOSING:
            self.brackets.append(token)
            if len(self.brackets) > DEEPEST:
                raise self._error(f"brackets are nested more than {DEEPEST} deep", token)
        elif token.text in "})]":
            if not self.brackets or _CLOSING[self.brackets[-1].text] != token.text:
                raise self._no_match(token)
            self.brackets.pop()

    def _resolve_escapes(self, token: Token) -> Token:
        """Return a name with its code point escapes resolved. Each must stand for a character that
        names allow."""
        text = _ESCAPES.sub(lambda m: _character(m[1] or m[2]), token.text)
        match = _TOKEN.fullmatch(text)
        if match is None or match.lastgroup != token.kind.name or _ESCAPES.search(text):
            raise self._error(
                f"`{token.text}` is not a name",
                token,
                "an escape in a name must stand for a character that names allow",
            )
        return Token(token.kind, text, token.start, token.end)

    def _error(self, message: str, token: Token, hint: str = "") -> LanguageError:
        return LanguageError(message, self.source, token.span, hint)

    def _no_token(self, position: int) -> LanguageError:
        source = self.source
        character = source[position]
        span = Span(position, position + 1)
        if character in "\"'":
            end = source.find("\n", position)
            span = Span(position, len(source) if end < 0 else end)
            hint = f"end it with `{character}`"
            return LanguageError("the string is not closed", source, span, hint)
        printable = character.isprintable()
        message = f"`{character}` has no meaning here" if printable else "a stray character"
        return LanguageError(message, source, span)

    def _no_match(self, token: Token) -> LanguageError:
        if not self.brackets:
            return self._error(
                f"`{token.text}` closes nothing", token, "remove it, or open it before"
            )
        opened = self.brackets[-1]
        line = self.source.count("\n", 0, opened.start) + 1
        closing = _CLOSING[opened.text]
        hint = f"the `{opened.text}` of line {line} is still open"
        return self._error(f"expected `{closing}`, found `{token.text}`", token, hint)


def _character(digits: str) -> str:
    """Return the character of an escape, or a space, which no name allows, if there is none."""
    code = int(digits, 16)
    is_none = code > 0x10FFFF or 0xD800 <= code <= 0xDFFF or code == 0x5C
    return " " if is_none else chr(code)
