"""What languages with a Lark grammar share: placed errors for syntax, and the reading of trees."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from collections.abc import Set as AbstractSet
from typing import Final, TypeAlias

from lark import Token, Tree
from lark.exceptions import UnexpectedCharacters, UnexpectedInput, UnexpectedToken

from ..streams.sample import LONGEST_NAME
from .errors import LanguageError, Span

_NAMES: Final = ("NAME", "UNIT_NAME", "PREFIXED", "IRI", "TEXT", "OBJECT_ID", "STRING")
SyntaxHint: TypeAlias = Callable[[str, AbstractSet[str]], str]
"""From what was found (empty at the end of the text) and the terminals that could stand there."""


def syntax_error(error: UnexpectedInput, source: str, hint: SyntaxHint) -> LanguageError:
    """The same error for a bad character and a bad token: what is there, what could be."""
    start = len(source) if error.pos_in_stream is None else error.pos_in_stream
    expected: set[str] = set()
    found = ""
    match error:
        case UnexpectedToken():
            token = error.token
            expected = set(error.accepts or error.expected)
            if token.type == "$END":
                # The end is reported at the last token; the caret belongs behind it.
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
    message = f"`{found}` cannot stand here" if found else "the text ends too early"
    return LanguageError(message, source, Span(start, start + len(found)), hint(found, expected))


def check_names(tree: Tree[Token], source: str) -> None:
    """Raise `LanguageError` for a name that is too long: names are kept, in many places, for a time
    after what they name is gone."""
    named = (token for part in tree.iter_subtrees() for token in tokens(part, *_NAMES))
    long = [token for token in named if len(token) > LONGEST_NAME]
    if long:
        first = min(long, key=lambda token: span_of(token).start)
        raise LanguageError(
            f"a name has at most {LONGEST_NAME} characters, and this one {len(first)}",
            source,
            span_of(first),
            "shorten it",
        )


def expected_hint(expected: AbstractSet[str], names: Mapping[str, str]) -> str:
    """``expected `=`, `(` or a name``; a terminal that ``names`` lacks is a keyword."""
    words = sorted({names.get(name, f"`{name.lower()}`") for name in expected})
    if not words:
        return ""
    return "expected " + (
        words[0] if len(words) == 1 else f"{', '.join(words[:-1])} or {words[-1]}"
    )


def trees(tree: Tree[Token]) -> list[Tree[Token]]:
    """The nodes directly under a node, in order."""
    return [child for child in tree.children if isinstance(child, Tree)]


def tokens(tree: Tree[Token], *types: str) -> list[Token]:
    """The tokens of these types (of any, if none is given) directly under a node, in order."""
    found = [child for child in tree.children if isinstance(child, Token)]
    return [token for token in found if token.type in types] if types else found


def span_of(thing: Tree[Token] | Token) -> Span:
    """Where a node or token stands in the source."""
    if isinstance(thing, Token):
        start, end = thing.start_pos, thing.end_pos
    else:
        start, end = thing.meta.start_pos, thing.meta.end_pos
    assert start is not None
    assert end is not None
    return Span(start, end)


def _word_at(source: str, start: int) -> str:
    end = start
    while end < len(source) and (source[end].isalnum() or source[end] == "_"):
        end += 1
    return source[start : max(end, start + 1)]
