"""Shared by the languages with a Lark grammar: syntax errors with a place, and access to trees."""

from __future__ import annotations

import json
from collections.abc import Callable
from collections.abc import Set as AbstractSet
from functools import cache
from importlib import resources
from typing import Final, TypeAlias

from lark import Lark, Token, Tree
from lark.exceptions import UnexpectedCharacters, UnexpectedInput, UnexpectedToken

from ..streams.sample import LONGEST_NAME
from .errors import LanguageError, Span
from .hints import or_list

_NAMES: Final = ("NAME", "UNIT_NAME", "PREFIXED", "IRI", "TEXT", "OBJECT_ID", "STRING")
TERMINALS: Final = {
    **dict.fromkeys(("NAME", "PREFIXED", "IRI", "TEXT", "OBJECT_ID"), "a name"),
    **dict.fromkeys(("NUMBER", "TIME_POINT"), "a time"),
    "STRING": "a name in quotes",
    "QUOTED": "a text",
    "DECIMAL": "a number",
    "DURATION": "a duration",
    "VARIABLE": "a variable",
    "COMPARISON": "a comparison",
    "SIGN": "`+` or `-`",
    "FACTOR": "`*` or `/`",
    "PLUS": "`+`",
    "STAR": "`*`",
    "ARROW": "`->`",
    "UNIT_NAME": "a unit (letters only)",
    "POWER": "a power",
    "EQUAL": "`=`",
    "LPAR": "`(`",
    "RPAR": "`)`",
    "LSQB": "`[`",
    "RSQB": "`]`",
    "LBRACE": "`{`",
    "RBRACE": "`}`",
    "COMMA": "`,`",
    "COLON": "`:`",
    "SEMICOLON": "`;`",
    "DOT": "`.`",
    "$END": "the end",
}
"""The terminals in hints, except keywords."""
SyntaxHint: TypeAlias = Callable[[str, AbstractSet[str]], str]
"""Makes a hint from the text found (empty at the end of the source) and the terminals that are
possible there."""


@cache
def grammar(file: str, *starts: str) -> Lark:
    """Load a grammar of this room, such as ``ssl/ssl.lark``, with its start rules."""
    text = resources.files(__package__).joinpath(file).read_text(encoding="utf-8")
    lexer = "contextual"  # a keyword is a keyword only where the grammar expects one
    return Lark(text, start=list(starts), parser="lalr", lexer=lexer, propagate_positions=True)


def syntax_error(error: UnexpectedInput, source: str, hint: SyntaxHint) -> LanguageError:
    """Convert an error of Lark's lexer or parser: the text found, and a hint at what is
    possible."""
    start = len(source) if error.pos_in_stream is None else error.pos_in_stream
    expected: set[str] = set()
    found = ""
    match error:
        case UnexpectedToken():
            token = error.token
            expected = set(error.accepts or error.expected)
            if token.type == "$END":
                # Lark reports the end at the last token; the caret belongs after it.
                start = len(source.rstrip())
            else:
                found = str(token)
                start = start if token.start_pos is None else token.start_pos
        case UnexpectedCharacters():
            expected = set(error.allowed or ())
            found = _word_at(source, start)
        case _:
            pass
    start = min(max(start, 0), len(source))
    expected -= {"COMMENT", "WS"}
    message = f"`{found}` is not allowed here" if found else "the text ends too early"
    return LanguageError(message, source, Span(start, start + len(found)), hint(found, expected))


def check_names(tree: Tree[Token], source: str) -> None:
    """Raise `LanguageError` for a name that is too long. Names stay in memory in many places, even
    after their owners are removed."""
    named = (token for part in tree.iter_subtrees() for token in tokens(part, *_NAMES))
    long = [token for token in named if len(token) > LONGEST_NAME]
    if long:
        first = min(long, key=lambda token: span_of(token).start)
        raise LanguageError(
            f"a name has at most {LONGEST_NAME} characters, and this one has {len(first)}",
            source,
            span_of(first),
            "shorten it",
        )


def expected_hint(expected: AbstractSet[str]) -> str:
    """Return ``expected `=`, `(` or a name``."""
    words = sorted({TERMINALS.get(name, f"`{name.lower()}`") for name in expected})
    return f"expected {or_list(words)}" if words else ""


def trees(tree: Tree[Token]) -> list[Tree[Token]]:
    """Return the nodes directly under a node, in order."""
    return [child for child in tree.children if isinstance(child, Tree)]


def tokens(tree: Tree[Token], *types: str) -> list[Token]:
    """Return the tokens of these types (of any if none is given) directly under a node,
    in order."""
    found = [child for child in tree.children if isinstance(child, Token)]
    return [token for token in found if token.type in types] if types else found


def span_of(thing: Tree[Token] | Token) -> Span:
    """Return the place of a node or token in the source."""
    if isinstance(thing, Token):
        start, end = thing.start_pos, thing.end_pos
    else:
        start, end = thing.meta.start_pos, thing.meta.end_pos
    assert start is not None
    assert end is not None
    return Span(start, end)


def unquoted(token: Token, source: str) -> str:
    """Return the text of a token in quotes, with the escapes of JSON. Raises `LanguageError`."""
    try:
        text: str = json.loads(token, strict=False)
        # JSON allows half a surrogate pair, which is no text.
        text.encode()
    except ValueError:
        raise LanguageError(
            f"{token} is not a text",
            source,
            span_of(token),
            'escapes are those of JSON: `\\"`, `\\\\`, `\\n`, `\\u00e9`',
        ) from None
    return text


def _word_at(source: str, start: int) -> str:
    end = start
    while end < len(source) and (source[end].isalnum() or source[end] == "_"):
        end += 1
    return source[start : max(end, start + 1)]
