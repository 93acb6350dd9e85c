"""The AST of SSL, the Stream Semantics Language ([Events14 Listing 1], SPEC §3).

Names are as written (``speed``, ``dyknow:speed``, ``<IRI>``); `check` resolves them against the
ontology. Spans take no part in comparisons: two declarations that differ only in spans are equal.
"""

from __future__ import annotations

from dataclasses import dataclass
from dataclasses import field as attribute
from typing import TypeAlias

from ...ontology.units import Unit, UnitPower
from ..errors import Span

__all__ = [
    "Argument",
    "CompunitDeclaration",
    "Declaration",
    "Entity",
    "FeatureTerm",
    "FieldFeature",
    "SourceDeclaration",
    "StreamDeclaration",
    "Unit",
    "UnitPower",
]


@dataclass(frozen=True, slots=True)
class Argument:
    """A sort or object as a feature's argument: ``UAV``, ``dyknow:uav1``, ``UAV as arg1``."""

    name: str
    alias: str | None
    span: Span = attribute(compare=False)


@dataclass(frozen=True, slots=True)
class FeatureTerm:
    """``speed(UAV) = spd [mi.h-1]``: the feature, its arguments, and the field with its value.

    ``unit`` is None if none was written: then the feature's own unit applies.
    """

    feature: str
    arguments: tuple[Argument, ...]
    field: str
    unit: Unit | None
    span: Span = attribute(compare=False)
    field_span: Span = attribute(compare=False)
    unit_span: Span | None = attribute(default=None, compare=False)


@dataclass(frozen=True, slots=True)
class Entity:
    """``UAV = id``: the field ``id`` names the object of this sort or alias, or this object.

    After ``every`` the field names any object of a sort. Without it the entity is a condition: only
    samples whose id field names the object carry the features.
    """

    name: str
    field: str
    span: Span = attribute(compare=False)
    every: bool = False


@dataclass(frozen=True, slots=True)
class StreamDeclaration:
    """``stream NAME contains features [for conditions, every entities]``.

    The word `every` applies to all entities after it. Without entities every sample carries the
    features.
    """

    name: str
    features: tuple[FeatureTerm, ...]
    entities: tuple[Entity, ...]
    span: Span = attribute(compare=False)


@dataclass(frozen=True, slots=True)
class FieldFeature:
    """``field:feature(arguments) [unit]`` of a source or computational unit.

    ``arguments`` is None if none were written, not even ``()``.
    """

    field: str
    feature: str
    unit: Unit | None
    span: Span = attribute(compare=False)
    feature_span: Span = attribute(compare=False)
    unit_span: Span | None = attribute(default=None, compare=False)
    arguments: tuple[Argument, ...] | None = None


@dataclass(frozen=True, slots=True)
class SourceDeclaration:
    """``source NAME provides field:feature [for every entities]``."""

    name: str
    output: FieldFeature
    span: Span = attribute(compare=False)
    entities: tuple[Entity, ...] = ()


@dataclass(frozen=True, slots=True)
class CompunitDeclaration:
    """``compunit NAME transforms inputs to output [for every entities]``.

    The entities are the objects that the unit itself detects and names in its output.
    """

    name: str
    inputs: tuple[FieldFeature, ...]
    output: FieldFeature
    span: Span = attribute(compare=False)
    entities: tuple[Entity, ...] = ()


Declaration: TypeAlias = StreamDeclaration | SourceDeclaration | CompunitDeclaration
