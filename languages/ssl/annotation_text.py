"""Prints checked annotations as SSL: the text for annotations that came as JSON or Turtle (SPEC
§3).

Law (tests/laws/languages/test_annotations.py): ``check_ssl(parse_ssl(text), text, vocabulary)`` of
a text made with ``vocabulary`` returns the annotation. The engine and matching use it for streams
without an SSL text.
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
    """Return the annotation as one line of SSL. ``vocabulary`` knows the features' own units.
    Without it, a value without unit reads as one in its feature's unit."""
    return format_declaration(declaration_of(annotation, vocabulary))


def with_ssl_source(annotation: Annotation, vocabulary: Vocabulary | None = None) -> Annotation:
    """Return the annotation with this text as its source."""
    return replace(annotation, source=format_annotation(annotation, vocabulary))


def declaration_of(
    annotation: CheckedAnnotation, vocabulary: Vocabulary | None = None
) -> Declaration:
    """Return the declaration with the meaning of the annotation, without spans."""
    match annotation:
        case StreamAnnotation():
            return _stream(annotation, vocabulary)
        case SourceAnnotation(name, output):
            return SourceDeclaration(name, _port(output, vocabulary), _HERE, _entities(output))
        case TransformationAnnotation(name, inputs, output):
            inputs_text = tuple(_port(port, vocabulary) for port in inputs)
            made = _port(output, vocabulary)
            return CompunitDeclaration(name, inputs_text, made, _HERE, _entities(output))


def term_words(iri: str) -> str:
    """Return a feature, sort or object as SSL text: ``speed``, ``rdf:value`` or ``<IRI>``."""
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
                Argument(term_words(_role_key(role)[0]), aliases.get(_role_key(role)), _HERE)
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
    # Conditions first: `every` applies to all entities after it.
    for role in sorted(roles, key=lambda role: role.object is None):
        if role.id_field is not None:
            words = aliases.get(_role_key(role)) or term_words(_role_key(role)[0])
            entity = Entity(words, role.id_field, _HERE, role.object is None)
            entities.setdefault(_role_key(role), entity)
    return StreamDeclaration(annotation.stream, features, tuple(entities.values()), _HERE)


def _role_key(role: Role) -> Named:
    """Return the sort or object of a role, and its field."""
    return role.object or role.sort or "", role.id_field


def _aliases(roles: Iterable[Role]) -> Mapping[Named, str]:
    """Return aliases for sorts and objects that several fields name, or that have a field in one
    role only."""
    fields: dict[str, list[str | None]] = {}
    for iri, field in dict.fromkeys(map(_role_key, roles)):
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


def _entities(output: PortAnnotation) -> tuple[Entity, ...]:
    """Return the for-part: fields that name objects which no input contains. The field `id` is the
    default and needs no text."""
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
    """Return the unit; None if the feature's own unit applies."""
    info = None if vocabulary is None else vocabulary.feature(feature)
    own = None if info is None else info.unit
    return unit if unit or own else None
