"""The lexical structure of SPARQL 1.1 (its §19.8), with offsets.

Our clauses are found on tokens, so a keyword inside a name, an IRI, a comment or a literal is
never taken for one. White space and comments are no tokens; what stands between two tokens is
found again by their offsets.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

from ..errors import LanguageError, Span
from ..remembered import remembered

MAX_DEPTH: Final = 64
"""Deepest nesting of brackets; the parsers behind us recurse."""


class Kind(StrEnum):
    """What a token is; the names are those of SPARQL's grammar where it has one."""

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
    """A token and where it stands; ``text`` is as written."""

    kind: Kind
    text: str
    start: int

    @property
    def end(self) -> int:
        return self.start + len(self.text)

    @property
    def span(self) -> Span:
        return Span(self.start, self.end)

    def is_word(self, *words: str) -> bool:
        """True for one of these keywords (given in upper case), in any case."""
        return self.kind is Kind.WORD and self.text.upper() in words

    def is_mark(self, *marks: str) -> bool:
        return self.kind is Kind.MARK and self.text in marks


_ESCAPE = r"(?:%[0-9A-Fa-f]{2}|\\[_~.\-!$&'()*+,;=/?#@%])"
_UNICODE = r"\\u[0-9A-Fa-f]{4}|\\U[0-9A-Fa-f]{8}"
_IRI = rf'<(?:[^<>"{{}}|^`\\\x00-\x20]|{_UNICODE})*>'  # [139] IRIREF
_STRING = r"""(?:\"\"\"(?:"{0,2}(?:[^"\\]|\\.))*\"\"\"  # [159] long strings
      |'''(?:'{0,2}(?:[^'\\]|\\.))*'''                # [158]
      |"(?:[^"\\\r\n]|\\[^\r\n])*"                    # [157]
      |'(?:[^'\\\r\n]|\\[^\r\n])*')                   # [156]
"""
_TOKEN: Final = re.compile(
    rf"""
    (?P<skip>[\ \t\r\n\f\ufeff]+|\#[^\r\n]*)
  | (?P<iri>{_IRI})
  | (?P<string>{_STRING})
  | (?P<variable>[?$]\w+)                                               # [143] VAR1, VAR2
  | (?P<blank>_:\w(?:[\w\-]|\.+(?=[\w\-]))*)                            # [142] BLANK_NODE_LABEL
  | (?P<language>@[A-Za-z]+(?:-[A-Za-z0-9]+)*)                          # [145] LANGTAG
  | (?P<prefixed>(?:[^\W\d_](?:[\w\-]|\.+(?=[\w\-]))*)?:                # [141] PNAME_LN, PNAME_NS
      (?:(?:[\w:]|{_ESCAPE})(?:[\w:\-]|{_ESCAPE}|\.+(?=[\w:\-%\\]))*)?)
  | (?P<number>[0-9]*\.[0-9]+(?:[eE][+-]?[0-9]+)?                       # [146]-[148]
      |[0-9]+\.?[eE][+-]?[0-9]+|[0-9]+)
  | (?P<word>[A-Za-z_]\w*)
  | (?P<mark>\^\^|&&|\|\||!=|<=|>=|[{{}}()\[\].,;=<>!+\-*/|^?])
    """,
    re.VERBOSE | re.DOTALL,
)
_KINDS: Final = {
    "iri": Kind.IRI,
    "string": Kind.STRING,
    "variable": Kind.VARIABLE,
    "blank": Kind.BLANK,
    "language": Kind.LANGUAGE,
    "prefixed": Kind.PREFIXED,
    "number": Kind.NUMBER,
    "word": Kind.WORD,
    "mark": Kind.MARK,
}
# It begins where white space does: from within a long line of it, it would be looked for in vain
# again and again.
_BLANK_LINES: Final = r"(?<![ \t])[ \t]*(?:\r?\n[ \t]*)*\r?\n"
_LINES: Final = re.compile(
    rf"""
    (?P<lines>{_BLANK_LINES})
  | \#(?:[^\r\n\ \t]|[\ \t]+(?=[^\r\n\ \t]))*    # without the white space at its end
  | {_STRING} | {_IRI}
  | \\.                                         # in a name: a quote or # that begins nothing
    """,
    re.VERBOSE | re.DOTALL,
)
_CLOSING: Final = {"{": "}", "(": ")", "[": "]"}


@remembered
def tokenize(source: str) -> tuple[Token, ...]:
    """The tokens of a text. Brackets are balanced and at most `MAX_DEPTH` deep.

    Raises `LanguageError` for a character that begins no token, a string or IRI that is not
    closed, and brackets that do not match. Cost: linear; the last texts are remembered.
    """
    tokens: list[Token] = []
    open_brackets: list[Token] = []
    position = 0
    while position < len(source):
        match = _TOKEN.match(source, position)
        if match is None:
            raise _no_token(source, position)
        position = match.end()
        group = str(match.lastgroup)
        if group == "skip":
            continue
        token = Token(_KINDS[group], match[0], match.start())
        tokens.append(token)
        if token.kind is not Kind.MARK:
            continue
        if token.text in _CLOSING:
            open_brackets.append(token)
            if len(open_brackets) > MAX_DEPTH:
                raise LanguageError(
                    f"brackets are nested more than {MAX_DEPTH} deep", source, token.span
                )
        elif token.text in _CLOSING.values():
            if not open_brackets or _CLOSING[open_brackets[-1].text] != token.text:
                raise _no_match(source, token, open_brackets)
            open_brackets.pop()
    if open_brackets:
        token = open_brackets[-1]
        raise LanguageError(
            f"`{token.text}` is not closed",
            source,
            token.span,
            f"a `{_CLOSING[token.text]}` is missing",
        )
    return tuple(tokens)


def _no_token(source: str, position: int) -> LanguageError:
    character = source[position]
    span = Span(position, position + 1)
    if character in "\"'":
        end = source.find("\n", position)
        span = Span(position, len(source) if end < 0 else end)
        return LanguageError("the string is not closed", source, span, f"end it with `{character}`")
    return LanguageError(
        f"`{character}` has no meaning here" if character.isprintable() else "a stray character",
        source,
        span,
    )


def _no_match(source: str, token: Token, open_brackets: Sequence[Token]) -> LanguageError:
    if not open_brackets:
        return LanguageError(
            f"`{token.text}` closes nothing", source, token.span, "remove it, or open it before"
        )
    opened = open_brackets[-1]
    line = source.count("\n", 0, opened.start) + 1
    return LanguageError(
        f"`{token.text}` where `{_CLOSING[opened.text]}` is due",
        source,
        token.span,
        f"the `{opened.text}` of line {line} is still open",
    )


def closing(tokens: Sequence[Token], index: int) -> int:
    """The index of the bracket that closes the one at ``index`` (brackets are balanced)."""
    depth = 0
    for position in range(index, len(tokens)):
        token = tokens[position]
        if token.is_mark("{", "(", "["):
            depth += 1
        elif token.is_mark("}", ")", "]"):
            depth -= 1
            if depth == 0:
                return position
    raise AssertionError("tokenize lets balanced brackets through only")


def blanked(source: str, spans: Sequence[Span]) -> str:
    """The text with spaces for every character in ``spans``; line ends and offsets stay."""
    parts: list[str] = []
    position = 0
    for span in sorted(spans, key=lambda span: span.start):
        parts.append(source[position : span.start])
        parts.append(re.sub(r"[^\r\n]", " ", source[span.start : span.end]))
        position = span.end
    parts.append(source[position:])
    return "".join(parts)


def compact(text: str) -> str:
    """The text without the blank lines that blanked clauses leave; literals are not touched.

    The text is one that `tokenize` takes. Cost: linear, and a part of that of tokens.
    """
    return _LINES.sub(lambda found: found[0] if found["lines"] is None else "\n", text).strip()
