"""Text to SSL declarations ([Events14 Listing 1], SPEC §3). The grammar is `ssl.lark`.

Names are not resolved here; `check` does that.
"""

from __future__ import annotations

from functools import cache
from importlib import resources
from typing import Final

from lark import Lark, Token, Tree
from lark.exceptions import UnexpectedCharacters, UnexpectedInput, UnexpectedToken

from ..errors import LanguageError, Span
from .ast import (
    Argument,
    CompunitDeclaration,
    Declaration,
    Entity,
    FeatureTerm,
    FieldFeature,
    SourceDeclaration,
    StreamDeclaration,
    Unit,
    UnitPower,
)

_EXPECTED: Final = {
    "NAME": "a name",
    "UNIT_NAME": "a unit (letters only)",
    "POWER": "a power",
    "EQUAL": "`=`",
    "LPAR": "`(`",
    "RPAR": "`)`",
    "LSQB": "`[`",
    "RSQB": "`]`",
    "COMMA": "`,`",
    "COLON": "`:`",
    "DOT": "`.`",
    "$END": "the end",
}
_DECLARATION_WORDS: Final = frozenset({"STREAM", "SOURCE", "COMPUNIT"})


@cache
def _grammar() -> Lark:
    text = resources.files(__package__).joinpath("ssl.lark").read_text(encoding="utf-8")
    return Lark(text, parser="lalr", lexer="contextual", propagate_positions=True)


def parse_ssl(source: str) -> tuple[Declaration, ...]:
    """The declarations of an SSL text, in order; `#` starts a comment.

    Raises `LanguageError` for a text that Listing 1's grammar refuses; the caret stands under
    the first thing that cannot be there.
    """
    try:
        tree = _grammar().parse(source)
    except UnexpectedInput as error:
        raise _syntax_error(error, source) from None
    return tuple(_declaration(node, source) for node in _trees(tree))


def _syntax_error(error: UnexpectedInput, source: str) -> LanguageError:
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
    return LanguageError(
        message, source, Span(start, start + len(found)), _syntax_hint(found, expected, source)
    )


def _word_at(source: str, start: int) -> str:
    end = start
    while end < len(source) and (source[end].isalnum() or source[end] == "_"):
        end += 1
    return source[start : max(end, start + 1)]


def _syntax_hint(found: str, expected: set[str], source: str) -> str:
    if found.isalpha() and {"LSQB", "NO_UNIT"} <= expected:
        return f"a unit stands in brackets: write `[{found}]`"
    if expected >= _DECLARATION_WORDS and expected <= {*_DECLARATION_WORDS, "$END"}:
        return "a declaration begins with `stream`, `source` or `compunit`"
    names = sorted(_EXPECTED.get(name, f"`{name.lower()}`") for name in expected)
    if not names:
        return ""
    return "expected " + (
        names[0] if len(names) == 1 else f"{', '.join(names[:-1])} or {names[-1]}"
    )


def _trees(tree: Tree[Token]) -> list[Tree[Token]]:
    return [child for child in tree.children if isinstance(child, Tree)]


def _names(tree: Tree[Token]) -> list[Token]:
    """The NAME tokens directly under a node, in order."""
    return [c for c in tree.children if isinstance(c, Token) and c.type == "NAME"]


def _span(thing: Tree[Token] | Token) -> Span:
    if isinstance(thing, Token):
        start, end = thing.start_pos, thing.end_pos
    else:
        start, end = thing.meta.start_pos, thing.meta.end_pos
    assert start is not None
    assert end is not None
    return Span(start, end)


def _declaration(tree: Tree[Token], source: str) -> Declaration:
    name = str(_names(tree)[0])
    parts = _trees(tree)
    match tree.data:
        case "stream_decl":
            features = tuple(_feature(part, source) for part in parts if part.data == "feature")
            for_part = next((part for part in parts if part.data == "for_part"), None)
            every, entities = (False, ()) if for_part is None else _for_part(for_part, source)
            return StreamDeclaration(name, features, every, entities, _span(tree))
        case "source_decl":
            return SourceDeclaration(name, _field_feature(parts[0], source), _span(tree))
        case _:
            inputs = tuple(_field_feature(part, source) for part in _trees(parts[0]))
            output = _field_feature(parts[1], source)
            return CompunitDeclaration(name, inputs, output, _span(tree))


def _for_part(tree: Tree[Token], source: str) -> tuple[bool, tuple[Entity, ...]]:
    """`every` governs all that follows it, so it stands before the first entity or nowhere."""
    nodes = _trees(tree)
    every = len(nodes[0].children) == 3
    for node in nodes:
        if len(node.children) == 3 and not every:
            raise LanguageError(
                "`every` governs the whole list, so it stands first",
                source,
                _span(node),
                f"write `for every {nodes[0].children[0]} = …`",
            )
    entities = []
    for node in nodes:
        # The word `every` may be the name itself, so tokens are taken by place.
        *_, name, field = (child for child in node.children if isinstance(child, Token))
        entities.append(Entity(str(name), str(field), Span(_span(name).start, _span(field).end)))
    return every, tuple(entities)


def _feature(tree: Tree[Token], source: str) -> FeatureTerm:
    name, field = _names(tree)
    arguments_node, *rest = _trees(tree)
    arguments = []
    for node in _trees(arguments_node):
        sort, *alias = _names(node)
        arguments.append(Argument(str(sort), str(alias[0]) if alias else None, _span(node)))
    unit = _unit_list(rest[0], source) if rest else None
    unit_span = _span(rest[0]) if rest else None
    return FeatureTerm(
        str(name), tuple(arguments), str(field), unit, _span(tree), _span(field), unit_span
    )


def _field_feature(tree: Tree[Token], source: str) -> FieldFeature:
    field, feature = _names(tree)
    units = _trees(tree)
    unit = _unit_list(units[0], source) if units else None
    unit_span = _span(units[0]) if units else None
    return FieldFeature(str(field), str(feature), unit, _span(tree), _span(feature), unit_span)


def _unit_list(tree: Tree[Token], source: str) -> Unit:
    return tuple(_unit(node, source) for node in _trees(tree))


def _unit(tree: Tree[Token], source: str) -> UnitPower:
    name, *power = (child for child in tree.children if isinstance(child, Token))
    if not power:
        return UnitPower(str(name))
    # More digits than a power can have are refused before int() meets them.
    if len(power[0]) > 3 or int(power[0]) == 0:
        raise LanguageError(
            f"`{power[0]}` is no power of a unit",
            source,
            _span(power[0]),
            "a power is a small whole number other than 0: `m2`, `h-1`",
        )
    return UnitPower(str(name), int(power[0]))
