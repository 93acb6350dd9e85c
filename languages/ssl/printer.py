"""Prints SSL declarations. Law: ``parse_ssl(format_declaration(d)) == (d,)``, up to spans."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import assert_never

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
)

_NAME = re.compile("[A-Za-z][A-Za-z0-9_]*")


def format_declaration(declaration: Declaration) -> str:
    """Return the declaration as one line of SSL: ``stream s3 contains speed(UAV) = spd [mi.h-1]
    …``."""
    match declaration:
        case StreamDeclaration(name, features, entities):
            text = f"stream {name} contains {', '.join(map(_feature, features))}"
            return text + _for_part(entities)
        case SourceDeclaration(name, output):
            made = _field_feature(output) + _for_part(declaration.entities)
            return f"source {name} provides {made}"
        case CompunitDeclaration(name, inputs, output):
            text = ", ".join(map(_field_feature, inputs))
            made = _field_feature(output) + _for_part(declaration.entities)
            return f"compunit {name} transforms {text} to {made}"
        case _:
            assert_never(declaration)


def _for_part(entities: Sequence[Entity]) -> str:
    """Return the for-part; `every` stands once, before the first entity that it applies to."""
    words = []
    governed = False
    for entity in entities:
        every = "every " if entity.every and not governed else ""
        governed = governed or entity.every
        words.append(f"{every}{entity.name} = {field_words(entity.field)}")
    return f" for {', '.join(words)}" if words else ""


def field_words(field: str) -> str:
    """Return a field as SSL text: in quotes unless it is a name."""
    return field if _NAME.fullmatch(field) else f'"{field}"'


def _arguments(arguments: Sequence[Argument]) -> str:
    texts = (a.name if a.alias is None else f"{a.name} as {a.alias}" for a in arguments)
    return f"({', '.join(texts)})"


def _feature(term: FeatureTerm) -> str:
    return (
        f"{term.feature}{_arguments(term.arguments)} = {field_words(term.field)}{_unit(term.unit)}"
    )


def _field_feature(port: FieldFeature) -> str:
    arguments = "" if port.arguments is None else _arguments(port.arguments)
    return f"{field_words(port.field)}:{port.feature}{arguments}{_unit(port.unit)}"


def _unit(unit: Unit | None) -> str:
    if unit is None:
        return ""
    if not unit:
        return " no_unit"
    return f" [{'.'.join(p.name if p.power == 1 else f'{p.name}{p.power}' for p in unit)}]"
