"""SSL declarations to text. Law: ``parse_ssl(format_declaration(d)) == (d,)``, up to spans."""

from __future__ import annotations

from typing import assert_never

from .ast import (
    CompunitDeclaration,
    Declaration,
    FeatureTerm,
    FieldFeature,
    SourceDeclaration,
    StreamDeclaration,
    Unit,
)


def format_declaration(declaration: Declaration) -> str:
    """The declaration as SSL text, one line: ``stream s3 contains speed(UAV) = spd [mi.h-1] …``."""
    match declaration:
        case StreamDeclaration(name, features, every, entities):
            text = f"stream {name} contains {', '.join(map(_feature, features))}"
            if not entities:
                return text
            word = "for every" if every else "for"
            return f"{text} {word} {', '.join(f'{e.name} = {e.field}' for e in entities)}"
        case SourceDeclaration(name, output):
            return f"source {name} provides {_field_feature(output)}"
        case CompunitDeclaration(name, inputs, output):
            text = ", ".join(map(_field_feature, inputs))
            return f"compunit {name} transforms {text} to {_field_feature(output)}"
        case _:
            assert_never(declaration)


def _feature(term: FeatureTerm) -> str:
    arguments = ", ".join(
        argument.name if argument.alias is None else f"{argument.name} as {argument.alias}"
        for argument in term.arguments
    )
    return f"{term.feature}({arguments}) = {term.field}{_unit(term.unit)}"


def _field_feature(port: FieldFeature) -> str:
    return f"{port.field}:{port.feature}{_unit(port.unit)}"


def _unit(unit: Unit | None) -> str:
    if unit is None:
        return ""
    if not unit:
        return " no_unit"
    return f" [{'.'.join(p.name if p.power == 1 else f'{p.name}{p.power}' for p in unit)}]"
