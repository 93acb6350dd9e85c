"""Parses text to SSL declarations ([Events14 Listing 1], SPEC §3). The grammar is `ssl.lark`.

Names are not resolved here; `check` does that.
"""

from __future__ import annotations

from collections.abc import Set as AbstractSet
from typing import Final

from lark import Token, Tree
from lark.exceptions import UnexpectedInput

from ...ontology.units import PERCENT, POWERS
from ..errors import LanguageError, Span
from ..syntax import (
    check_names,
    expected_hint,
    grammar,
    span_of,
    syntax_error,
    tokens,
    trees,
)
from ..text_cache import TextCache
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

_DECLARATION_WORDS: Final = frozenset({"STREAM", "SOURCE", "COMPUNIT"})


@TextCache
def parse_ssl(source: str) -> tuple[Declaration, ...]:
    """Parse the declarations of an SSL text, in order; `#` starts a comment.

    Raises `LanguageError` for a text that the grammar of Listing 1 refuses; the caret marks the
    first wrong token. The last texts are cached: the service parses a text in another thread first,
    then the engine finds it.
    """
    try:
        tree = grammar("ssl/ssl.lark", "start").parse(source)
    except UnexpectedInput as error:
        raise syntax_error(error, source, _syntax_hint) from None
    check_names(tree, source)
    return tuple(_declaration(node, source) for node in trees(tree))


def _syntax_hint(found: str, expected: AbstractSet[str]) -> str:
    if found.isalpha() and expected >= {"LSQB", "NO_UNIT"}:
        return f"put a unit in brackets: write `[{found}]`"
    if "UNIT_NAME" in expected and found == "%":
        return f"a unit is a name: write `{PERCENT}`"
    if found == "/" and "RSQB" in expected:
        return POWERS
    if expected >= _DECLARATION_WORDS and expected <= {*_DECLARATION_WORDS, "$END"}:
        return "a declaration begins with `stream`, `source` or `compunit`"
    return expected_hint(expected)


def _declaration(tree: Tree[Token], source: str) -> Declaration:
    name = str(tokens(tree, "NAME")[0])
    parts = trees(tree)
    match tree.data:
        case "stream_decl":
            features = tuple(_feature(part, source) for part in parts if part.data == "feature")
            for_part = next((part for part in parts if part.data == "for_part"), None)
            entities = () if for_part is None else _for_part(for_part)
            return StreamDeclaration(name, features, entities, span_of(tree))
        case "source_decl":
            output, *rest = parts
            made = _field_feature(output, source)
            return SourceDeclaration(name, made, span_of(tree), _entities(rest, source))
        case _:
            first, output, *rest = parts
            inputs = tuple(_field_feature(part, source) for part in trees(first))
            made = _field_feature(output, source)
            return CompunitDeclaration(name, inputs, made, span_of(tree), _entities(rest, source))


def _entities(for_part: list[Tree[Token]], source: str) -> tuple[Entity, ...]:
    """Return the objects that a source or unit names itself, if it has a for-part."""
    if not for_part:
        return ()
    entities = _for_part(for_part[0])
    for entity in entities:
        if not entity.every:
            raise LanguageError(
                "a source or unit names every object of a sort, so this needs `every`",
                source,
                span_of(for_part[0]),
                f"write `for every {entity.name} = {entity.field}`",
            )
    return entities


def _for_part(tree: Tree[Token]) -> tuple[Entity, ...]:
    """Read the for-part. `every` applies to all entities after it; an entity before it is a
    condition."""
    every = False
    entities = []
    for node in trees(tree):
        every = every or len(node.children) == 3
        # The word `every` may be the name itself, so the order decides.
        *_, name, field = tokens(node)
        span = Span(span_of(name).start, span_of(field).end)
        entities.append(Entity(str(name), _field(field), span, every))
    return tuple(entities)


def _feature(tree: Tree[Token], source: str) -> FeatureTerm:
    name, field = tokens(tree)
    arguments_node, *rest = trees(tree)
    arguments = _arguments(arguments_node)
    unit = _unit_list(rest[0], source) if rest else None
    unit_span = span_of(rest[0]) if rest else None
    return FeatureTerm(
        str(name), arguments, _field(field), unit, span_of(tree), span_of(field), unit_span
    )


def _arguments(tree: Tree[Token]) -> tuple[Argument, ...]:
    arguments = []
    for node in trees(tree):
        sort, *alias = tokens(node, "NAME", "PREFIXED", "IRI")
        arguments.append(Argument(str(sort), str(alias[0]) if alias else None, span_of(node)))
    return tuple(arguments)


def _field_feature(tree: Tree[Token], source: str) -> FieldFeature:
    field, feature = tokens(tree)
    arguments = next((_arguments(n) for n in trees(tree) if n.data == "arguments"), None)
    units = [node for node in trees(tree) if node.data == "unit_list"]
    unit = _unit_list(units[0], source) if units else None
    unit_span = span_of(units[0]) if units else None
    return FieldFeature(
        _field(field), str(feature), unit, span_of(tree), span_of(feature), unit_span, arguments
    )


def _field(token: Token) -> str:
    return token[1:-1] if token.type == "TEXT" else str(token)


def _unit_list(tree: Tree[Token], source: str) -> Unit:
    return tuple(_unit(node, source) for node in trees(tree))


def _unit(tree: Tree[Token], source: str) -> UnitPower:
    name, *power = (child for child in tree.children if isinstance(child, Token))
    if not power:
        return UnitPower(str(name))
    # Rejects long digit strings before int(), whose cost is quadratic in the digits.
    if len(power[0]) > 3 or int(power[0]) == 0:
        raise LanguageError(
            f"`{power[0]}` is not a power of a unit",
            source,
            span_of(power[0]),
            "a power is a small whole number other than 0: `m2`, `h-1`",
        )
    return UnitPower(str(name), int(power[0]))
