"""Plans: the streams and units that give a wanted feature ([Introspection15 §4.3]).

A plan is a value: a tree of frozen nodes that says which streams are used, whose samples are
selected, and which units compute what from which fields. Equal nodes stand for one unit, so two
plans that hold equal nodes share it. `match` makes plans, the engine carries them out.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TypeAlias, assert_never

from ..languages.ssl.annotation import Content, PortAnnotation, Role, StreamAnnotation
from ..ontology.units import Conversion, Unit, format_unit
from .want import Want


@dataclass(frozen=True, slots=True)
class UseStream:
    """A stream that exists, with all that one annotation says it contains.

    All contents are kept, used or not, so that nodes over the same stream are equal.
    """

    stream: str
    contents: tuple[Content, ...]


@dataclass(frozen=True, slots=True)
class SelectObject:
    """The samples of ``source`` whose ``id_field`` names ``object`` (an IRI).

    Same fields, same order: a filter. [Events14 §V.C]: "filters this stream for coordinate
    information on uav1".
    """

    source: Node
    id_field: str
    object: str


@dataclass(frozen=True, slots=True)
class Port:
    """A field of a node's stream feeds a field of the consumer, with the change of unit.

    ``feature`` is what the stream says the field holds; it is, or is a sub-feature of, what the
    consumer asked for. ``conversion`` turns ``source`` units into ``target`` units.
    """

    source_field: str
    target_field: str
    feature: str
    source: Unit
    target: Unit
    conversion: Conversion


@dataclass(frozen=True, slots=True)
class Edge:
    """What a unit takes from one node's stream."""

    node: Node
    ports: tuple[Port, ...]


@dataclass(frozen=True, slots=True)
class Compute:
    """A unit made from ``transformation``. It keeps apart the objects that its inputs speak of.

    ``roles`` are those of its inputs: the objects pass through. Its stream has their id fields
    (none where the object is constant) and ``output.field``.
    """

    transformation: str
    inputs: tuple[Edge, ...]
    output: PortAnnotation
    roles: tuple[Role, ...]


Node: TypeAlias = UseStream | SelectObject | Compute


@dataclass(frozen=True, slots=True)
class SupplySource:
    """One stream in which a wanted feature stands.

    ``port.source_field`` of ``node``'s stream holds it, in ``port.source`` units;
    ``port.conversion`` gives the feature's own unit (``port.target``). ``port.target_field`` is
    the same name. ``roles`` say whose feature it is (one role but for n-ary features); a selected
    object keeps the sort of the stream it was selected from, so that ``?o a S`` holds for it.
    """

    node: Node
    port: Port
    roles: tuple[Role, ...]


@dataclass(frozen=True, slots=True)
class Supply:
    """The streams that together give ``want``: at least one.

    ``complete`` False: there is no stream for every wanted object, and the sources are those
    there are for some of them.
    """

    want: Want
    sources: tuple[SupplySource, ...]
    complete: bool


def contents_of(node: Node) -> tuple[Content, ...]:
    """What the stream of ``node`` contains: features, fields, units, roles.

    A selection keeps fields and units, and its object stands in each role that its id field
    names: such a role has sort, object and id field, and means "this object, which is of this
    sort, named by this field". A unit's stream has one content, whose roles are its input's: the
    same id field over ``every S = id``, a constant object over a constant object.
    """
    match node:
        case UseStream(_, contents):
            return contents
        case SelectObject(source, id_field, object):
            return tuple(
                replace(content, roles=_select(content.roles, id_field, object))
                for content in contents_of(source)
            )
        case Compute(_, _, output, roles):
            return (Content(output.feature, output.field, output.unit, roles),)
        case _:
            assert_never(node)


def _select(roles: tuple[Role, ...], id_field: str, object: str) -> tuple[Role, ...]:
    return tuple(
        replace(role, object=object) if role.id_field == id_field else role for role in roles
    )


def id_field_of(node: Node) -> str | None:
    """The field of ``node``'s stream that names the object; None where the object is constant."""
    for content in contents_of(node):
        for role in content.roles:
            if role.id_field is not None:
                return role.id_field
    return None


def annotation_of(node: Node, stream: str = "") -> StreamAnnotation:
    """The annotation of ``node``'s stream, under the name it was given.

    A stream that exists keeps its own name. ``source`` is SSL as far as SSL can say it: an object
    whose name is no SSL name (``dyknow:398564``) is printed all the same.
    """
    name = node.stream if isinstance(node, UseStream) else stream
    contents = contents_of(node)
    return StreamAnnotation(name, contents, _ssl(name, contents))


def wanted_annotation(supply: Supply, source: SupplySource, stream: str = "") -> StreamAnnotation:
    """What a consumer of ``source`` is to read: one content, under the *wanted* feature's name.

    A stream of a sub-feature is a stream of the feature, so the triples made from it have the
    predicate that the query asks for. The unit is still the stream's (``source.port.source``).
    """
    name = source.node.stream if isinstance(source.node, UseStream) else stream
    port = source.port
    contents = (Content(supply.want.feature, port.source_field, port.source, source.roles),)
    return StreamAnnotation(name, contents, _ssl(name, contents))


def nodes_of(node: Node) -> Iterator[Node]:
    """``node`` and all below it, inputs first (the order in which units can be started)."""
    match node:
        case UseStream():
            pass
        case SelectObject(source):
            yield from nodes_of(source)
        case Compute(_, inputs):
            for edge in inputs:
                yield from nodes_of(edge.node)
        case _:
            assert_never(node)
    yield node


def streams_of(supply: Supply) -> tuple[str, ...]:
    """Names of the existing streams that the supply rests on, each once, in order of use."""
    names = (
        node.stream
        for source in supply.sources
        for node in nodes_of(source.node)
        if isinstance(node, UseStream)
    )
    return tuple(dict.fromkeys(names))


def local_name(iri: str) -> str:
    """The last part of an IRI: ``UAV`` of ``dyknow:UAV``."""
    return re.split(r"[/#]", iri)[-1]


def _ssl(stream: str, contents: tuple[Content, ...]) -> str:
    features = []
    entities: dict[str, str] = {}
    every = False
    for content in contents:
        names = []
        for role in content.roles:
            # A selected object is written as the condition that it is.
            name = local_name(role.object or role.sort or "")
            every = every or role.object is None
            names.append(name)
            if role.id_field is not None:
                entities[name] = role.id_field
        unit = f" [{format_unit(content.unit)}]" if content.unit else ""
        arguments = ", ".join(names)
        features.append(f"{local_name(content.feature)}({arguments}) = {content.field}{unit}")
    text = f"stream {stream} contains {', '.join(features)}"
    if entities:
        pairs = ", ".join(f"{name} = {field}" for name, field in entities.items())
        text += f" for {'every ' if every else ''}{pairs}"
    return text
