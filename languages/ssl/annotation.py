"""Checked SSL: what a stream, source or transformation means, in IRIs ([Events14 §IV.A], SPEC §3).

`check.check_ssl` makes these; converters and matching read them.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

from .ast import Unit


class Role(NamedTuple):
    """One thing a feature speaks of; IRIs.

    ``sort`` set: every object of the sort, and ``id_field`` names the one meant (s3, s4, s5).
    ``object`` set and ``id_field`` None: always this object (s1, s7); with ``id_field``: only
    samples whose field names this object carry the feature (s2, s6).
    """

    sort: str | None
    object: str | None
    id_field: str | None


@dataclass(frozen=True, slots=True)
class Content:
    """A feature (IRI) that a stream carries in ``field``.

    ``unit`` is the one written, else the feature's own; ``()`` where there is none.
    """

    feature: str
    field: str
    unit: Unit
    roles: tuple[Role, ...]


def id_fields(contents: Iterable[Content]) -> tuple[str, ...]:
    """The fields that name the objects of a stream's samples, each once."""
    fields = (role.id_field for content in contents for role in content.roles)
    return tuple(dict.fromkeys(field for field in fields if field is not None))


@dataclass(frozen=True, slots=True)
class StreamAnnotation:
    """What stream ``stream`` contains. ``source`` is the SSL text of this declaration."""

    stream: str
    contents: tuple[Content, ...]
    source: str


@dataclass(frozen=True, slots=True)
class Argument:
    """What an input or output speaks of: any object of ``sort``, or always ``object``; IRIs.

    ``variable`` names it within one annotation: what has the same name is the same object, as in
    ``humanDetector : RGB[RMAX], IR[RMAX] ⇒ PixelLocation[Human]`` ([Introspection15 §4.3]). It is
    the sort's name where no alias was given. ``id_field`` is the field of an output that names
    objects which are in none of the inputs. ``self`` is the object `SELF`.
    """

    variable: str
    sort: str | None
    object: str | None = None
    id_field: str | None = None


@dataclass(frozen=True, slots=True)
class PortAnnotation:
    """An input or output: the field, the feature (IRI) in it, its unit, and whose feature it is.

    Without ``arguments`` it speaks of whatever the other ports speak of; a source's of ``self``.
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
