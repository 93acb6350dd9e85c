"""Checked SSL: the meaning of a stream, source or transformation, in IRIs ([Events14 §IV.A], SPEC
§3).

`check.check_ssl` makes these values; converters and matching read them.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

from .ast import Unit


class Role(NamedTuple):
    """An argument of a feature; all values are IRIs.

    | case | meaning | listings |
    |---|---|---|
    | ``sort`` | any object of the sort; the field ``id_field`` names it | s3, s4, s5 |
    | ``object``, no ``id_field`` | always this object | s1, s7 |
    | ``object`` and ``id_field`` | only samples whose field names this object | s2, s6 |
    """

    sort: str | None
    object: str | None
    id_field: str | None


@dataclass(frozen=True, slots=True)
class Content:
    """A feature (IRI) that a stream carries in ``field``.

    ``unit`` is the one written, else the feature's own; ``()`` if there is none.
    """

    feature: str
    field: str
    unit: Unit
    roles: tuple[Role, ...]


def id_fields(contents: Iterable[Content]) -> tuple[str, ...]:
    """Return the fields that name the objects of a stream's samples, each once."""
    fields = (role.id_field for content in contents for role in content.roles)
    return tuple(dict.fromkeys(field for field in fields if field is not None))


@dataclass(frozen=True, slots=True)
class StreamAnnotation:
    """The contents of stream ``stream``. ``source`` is the SSL text of this declaration."""

    stream: str
    contents: tuple[Content, ...]
    source: str


@dataclass(frozen=True, slots=True)
class Argument:
    """An argument of an input or output: any object of ``sort``, or always ``object``; IRIs.

    ``variable`` names it within one annotation. Equal names mean the same object, as in
    ``humanDetector : RGB[RMAX], IR[RMAX] ⇒ PixelLocation[Human]`` ([Introspection15 §4.3]). Without
    an alias it is the name of the sort. ``id_field`` is the output's field that names objects which
    no input contains. ``self`` is the object `SELF`.
    """

    variable: str
    sort: str | None
    object: str | None = None
    id_field: str | None = None


@dataclass(frozen=True, slots=True)
class PortAnnotation:
    """An input or output: its field, its feature (IRI), its unit, and the feature's arguments.

    Without ``arguments`` it concerns the objects of the other ports; that of a source concerns
    ``self``.
    """

    field: str
    feature: str
    unit: Unit
    arguments: tuple[Argument, ...] = ()


@dataclass(frozen=True, slots=True)
class SourceAnnotation:
    """``source NAME provides output``."""

    name: str
    output: PortAnnotation
    source: str


@dataclass(frozen=True, slots=True)
class TransformationAnnotation:
    """``compunit NAME transforms inputs to output``."""

    name: str
    inputs: tuple[PortAnnotation, ...]
    output: PortAnnotation
    source: str


CheckedAnnotation: TypeAlias = StreamAnnotation | SourceAnnotation | TransformationAnnotation
