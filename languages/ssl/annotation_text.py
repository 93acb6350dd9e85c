"""Checked annotations as SSL: what JSON and Turtle say, as the text that says the same (SPEC §3).

Law (tests/laws/languages/test_annotations.py): ``check_ssl(parse_ssl(text), text, vocabulary)`` of
a text made here with ``vocabulary`` gives the annotation back. Used by the engine and by matching,
for streams of which nothing was written in SSL.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from itertools import count
from typing import Final, TypeAlias, TypeVar

from ...ontology.units import Unit
from ...ontology.vocabulary import SELF, Vocabulary
from ...rdf.namespaces import DYKNOW, shorten
from ..errors import Span
from .annotation import Argument as CheckedArgument
from .annotation import (
    CheckedAnnotation,
    PortAnnotation,
    Role,
    SourceAnnotation,
    StreamAnnotation,
    TransformationAnnotation,
)
from .ast import (
    Argument,
    CompunitDeclaration,
    Declaration,
    Entity,
    FeatureTerm,
    FieldFeature,
    SourceDeclaration,
    StreamDeclaration,
)
from .check import variable_name
from .printer import format_declaration

_HERE: Final = Span(0, 0)
_NAME: Final = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
_PREFIXED: Final = re.compile(r"[a-z-]+:[A-Za-z0-9_](-*[A-Za-z0-9_])*")
Annotation = TypeVar("Annotation", StreamAnnotation, SourceAnnotation, TransformationAnnotation)
Named: TypeAlias = tuple[str, str | None]
"""A sort or object (IRI), and the field that names it."""


def format_annotation(annotation: CheckedAnnotation, vocabulary: Vocabulary | None = None) -> str:
    """The annotation as one line of SSL. ``vocabulary`` knows the features' own units: without it
    a value without unit of a feature with one is written as if it were in that one."""
    return format_declaration(declaration_of(annotation, vocabulary))


def with_ssl_source(annotation: Annotation, vocabulary: Vocabulary | None = None) -> Annotation:
    """The annotation with that text as its source."""
    return replace(annotation, source=format_annotation(annotation, vocabulary))


def declaration_of(
    annotation: CheckedAnnotation, vocabulary: Vocabulary | None = None
) -> Declaration:
    """The declaration that means the annotation, without places."""
    match annotation:
        case StreamAnnotation():
            return _stream(annotation, vocabulary)
        case SourceAnnotation(name, output):
            return SourceDeclaration(name, _port(output, vocabulary), _HERE, _found(output))
        case TransformationAnnotation(name, inputs, output):
            taken = tuple(_port(port, vocabulary) for port in inputs)
            made = _port(output, vocabulary)
            return CompunitDeclaration(name, taken, made, _HERE, _found(output))


def term_words(iri: str) -> str:
    """A feature, sort or object as SSL writes it: ``speed``, ``rdf:value`` or ``<IRI>``."""
    local = iri.removeprefix(DYKNOW)
    if local != iri and local != "self" and _NAME.fullmatch(local):
        return local
    short = shorten(iri)
    return short if _PREFIXED.fullmatch(short) else f"<{iri}>"


def _stream(annotation: StreamAnnotation, vocabulary: Vocabulary | None) -> StreamDeclaration:
    roles = list(dict.fromkeys(role for c in annotation.contents for role in c.roles))
    aliases = _aliases(roles)
    features = tuple(
        FeatureTerm(
            term_words(content.feature),
            tuple(
                Argument(term_words(_named(role)[0]), aliases.get(_named(role)), _HERE)
                for role in content.roles
            ),
            content.field,
            _unit(content.feature, content.unit, vocabulary),
            _HERE,
            _HERE,
        )
        for content in annotation.contents
    )
    entities: dict[Named, Entity] = {}
    # Conditions first: `every` governs all that follows it.
    for role in sorted(roles, key=lambda role: role.object is None):
        if role.id_field is not None:
            words = aliases.get(_named(role)) or term_words(_named(role)[0])
            entity = Entity(words, role.id_field, _HERE, role.object is None)
            entities.setdefault(_named(role), entity)
    return StreamDeclaration(annotation.stream, features, tuple(entities.values()), _HERE)


def _named(role: Role) -> Named:
    """What a role names; a selected object is written as the condition that it is."""
    return role.object or role.sort or "", role.id_field


def _aliases(roles: Iterable[Role]) -> Mapping[Named, str]:
    """Aliases for sorts and objects that several fields name, or a field here and none there."""
    fields: dict[str, list[str | None]] = {}
    for iri, field in dict.fromkeys(map(_named, roles)):
        fields.setdefault(iri, []).append(field)
    free = _free_names({term_words(iri) for iri in fields})
    return {
        (iri, field): next(free)
        for iri, several in fields.items()
        if len(several) > 1
        for field in several
        if field is not None
    }


def _free_names(taken: set[str]) -> Iterator[str]:
    return (name for name in (f"arg{i}" for i in count(1)) if name not in taken)


def _port(port: PortAnnotation, vocabulary: Vocabulary | None) -> FieldFeature:
    arguments = tuple(
        Argument(
            words := _argument_words(argument),
            None if argument.variable == variable_name(words) else argument.variable,
            _HERE,
        )
        for argument in port.arguments
    )
    unit = _unit(port.feature, port.unit, vocabulary)
    feature = term_words(port.feature)
    return FieldFeature(port.field, feature, unit, _HERE, _HERE, None, arguments or None)


def _argument_words(argument: CheckedArgument) -> str:
    if argument.object == SELF:
        return "self"
    return term_words(argument.object or argument.sort or "")


def _found(output: PortAnnotation) -> tuple[Entity, ...]:
    """The for-part: fields that name what no input speaks of; `id` needs no words."""
    return tuple(
        Entity(
            argument.variable if _NAME.fullmatch(argument.variable) else _argument_words(argument),
            argument.id_field,
            _HERE,
            True,
        )
        for argument in output.arguments
        if argument.id_field not in (None, "id")
    )


def _unit(feature: str, unit: Unit, vocabulary: Vocabulary | None) -> Unit | None:
    """None, where the feature's own unit is meant."""
    info = None if vocabulary is None else vocabulary.feature(feature)
    own = None if info is None else info.unit
    return unit if unit or own else None
