"""Chooses the stream fields that feed the inputs of a unit ([Introspection15 §3.2, §4.3]).

A specification names the streams that a unit reads; their annotations determine the fields. The
plan nodes equal those of semantic matching over the same streams, so both share units. This module
starts nothing and knows no places in texts; `elaboration` adds them to `WiringError`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

from ...languages.ssl.annotation import Content, PortAnnotation
from ...matching.plan import (
    Compute,
    Edge,
    Node,
    Port,
    SelectObject,
    Synchronize,
    UseStream,
)
from ...matching.plan_builder import (
    computed,
    gathered,
    many_roles,
    numbered,
    synchronized,
)
from ...matching.space import TransformationDescription
from ...matching.subject import Roles, Sorts
from ...ontology.units import IDENTITY, Conversion, Unit, UnitError, conversion
from ...ontology.vocabulary import Vocabulary
from ...rdf.namespaces import shorten
from ...streams.policies.policy import Policy
from ...streams.sample import FieldType
from .unit_shapes import Shape

Fields = Mapping[str, FieldType | None]
"""The fields of a stream with their types; None: not known yet."""


class WiringError(Exception):
    """Inputs that a unit cannot read. ``input``: the index of the one at fault, if it is one."""

    def __init__(self, message: str, hint: str, input: int | None = None) -> None:
        super().__init__(message)
        self.message = message
        self.hint = hint
        self.input = input


@dataclass(frozen=True, slots=True, eq=False)
class InputStream:
    """A stream that a unit reads: an existing one, by name, or the output of a unit with the shape
    ``what``.

    ``recipe`` is the plan node of that unit, with `stand_in` nodes as inputs; None for an existing
    stream.
    """

    what: Shape | str
    contents: tuple[Content, ...]
    fields: Fields
    recipe: Compute | SelectObject | Synchronize | Policy | None = None

    @property
    def stand_in(self) -> UseStream:
        """A placeholder for the real node, which is known when the unit runs (`bind_recipe`)."""
        name = self.what if isinstance(self.what, str) else f"#{self.what.number}"
        return UseStream(name, self.contents)


class _Option(NamedTuple):
    """A way to feed an input. ``roles`` None: no annotation says whose feature the field is."""

    port: Port
    roles: Roles | None


def compute_node(
    unit: TransformationDescription, pieces: Sequence[InputStream], vocabulary: Vocabulary
) -> Compute:
    """Make the node of a transformation over ``pieces``: one for each input, in order, or a single
    one for all. Raises `WiringError`."""
    ports = unit.inputs
    _check_number(unit, len(pieces))
    if len(pieces) == 1 and len(ports) > 1:
        fed = _feed_from_one(ports, pieces[0], vocabulary)
    else:
        fed = [
            _feed(_options(port, piece, vocabulary, number)[0], piece)
            for number, (port, piece) in enumerate(zip(ports, pieces, strict=True))
        ]
    edges, places = gathered(fed)
    _check_arities(edges)
    return computed(unit, edges, places, Sorts(vocabulary))


def select_node(piece: InputStream, field: str, object: str) -> SelectObject:
    """Make the node that selects samples whose ``field`` is ``object`` (an IRI). Raises
    `WiringError`."""
    if field not in piece.fields:
        raise WiringError(f"its input has no field `{field}`", _field_list(piece))
    type = piece.fields[field]
    if type not in (None, FieldType.STRING, FieldType.INTEGER):
        raise WiringError(
            f"field `{field}` is a {type} and cannot name objects",
            "an id field is a string or an integer",
        )
    return SelectObject(piece.stand_in, field, object)


def synchronize_node(pieces: Sequence[InputStream]) -> Synchronize:
    """Make the node that synchronizes the pieces, object by object. Raises `WiringError`."""
    taken: set[str] = set()
    edges: list[Edge] = []
    for number, piece in enumerate(pieces):
        if any(piece.what == other.what for other in pieces[:number]):
            continue
        if not piece.contents:
            raise WiringError(
                "this input has no annotation, so its contents are unknown",
                "annotate it in SSL: only features of objects can be synchronized",
                number,
            )
        by_roles: dict[Roles, list[Port]] = {}
        for content in piece.contents:
            target = numbered(content.field, taken)
            taken.add(target)
            unit = content.unit
            port = Port(content.field, target, content.feature, unit, unit, IDENTITY)
            by_roles.setdefault(content.roles, []).append(port)
        edges += [Edge(piece.stand_in, tuple(own), roles) for roles, own in by_roles.items()]
    if len(edges) < 2:
        raise WiringError(
            "`synchronize` has fewer than two different inputs here",
            "write two or more inputs that are different streams",
        )
    _check_arities(edges)
    node = synchronized(edges).node
    assert isinstance(node, Synchronize)
    return node


def fields_of(node: Compute | SelectObject | Synchronize, pieces: Sequence[InputStream]) -> Fields:
    """Return the fields of a node's stream over the inputs ``pieces``."""
    if isinstance(node, SelectObject):
        return pieces[0].fields
    fields: dict[str, FieldType | None] = {
        role.id_field: None for role in node.roles if role.id_field is not None
    }
    if isinstance(node, Compute):
        return {**fields, node.output.field: None}
    return fields | {port.target_field: None for edge in node.inputs for port in edge.ports}


def bind_recipe(
    recipe: Compute | SelectObject | Synchronize, real: Callable[[UseStream], Node]
) -> Compute | SelectObject | Synchronize:
    """Replace the stand-ins in a recipe by the nodes that ``real`` returns for them."""
    match recipe:
        case SelectObject(UseStream() as source, field, object):
            return SelectObject(real(source), field, object)
        case Synchronize(inputs, roles):
            return Synchronize(tuple(_bind_edge(edge, real) for edge in inputs), roles)
        case Compute(inputs=inputs):
            return replace(recipe, inputs=tuple(_bind_edge(edge, real) for edge in inputs))
        case _:
            raise AssertionError(recipe)


def _bind_edge(edge: Edge, real: Callable[[UseStream], Node]) -> Edge:
    match edge.node:
        case UseStream() as source:
            return Edge(real(source), edge.ports, edge.roles)
        case Synchronize() as several:
            return Edge(bind_recipe(several, real), edge.ports, edge.roles)
        case _:
            raise AssertionError(edge.node)


# -- which field ------------------------------------------------------------------------------


def _check_number(unit: TransformationDescription, number: int) -> None:
    takes = len(unit.inputs)
    if number == takes or (number == 1 and takes > 1):
        return
    if not takes:
        raise WiringError(f"`{unit.name}` is a source and has no inputs", "leave its inputs out")
    wanted = ", ".join(f"{port.field} ({shorten(port.feature)})" for port in unit.inputs)
    count = "1 input" if takes == 1 else f"{takes} inputs"
    raise WiringError(
        f"`{unit.name}` takes {count}, and has {number or 'none'} here",
        f"write one `cu` or `stream` for {'it' if takes == 1 else 'each, in order'}: {wanted}"
        + ("; or a single one that contains them all" if takes > 1 else ""),
    )


def _feed_from_one(
    ports: Sequence[PortAnnotation], piece: InputStream, vocabulary: Vocabulary
) -> list[tuple[Node, Roles, Port]]:
    """Feed all ports from one stream, by fields about the same objects."""
    options = [_options(port, piece, vocabulary, 0) for port in ports]
    candidates = [option.roles for own in options for option in own if option.roles is not None]
    for roles in candidates or [_roles(piece)]:
        fitting = [[o for o in own if o.roles is None or o.roles == roles] for own in options]
        if all(fitting):
            return [(piece.stand_in, roles, own[0].port) for own in fitting]
    names = ", ".join(shorten(port.feature) for port in ports)
    raise WiringError(
        f"it contains {names} of different objects",
        "write an input for each of them: they are synchronized object by object",
        0,
    )


def _feed(option: _Option, piece: InputStream) -> tuple[Node, Roles, Port]:
    roles = _roles(piece) if option.roles is None else option.roles
    return piece.stand_in, roles, option.port


def _options(
    port: PortAnnotation, piece: InputStream, vocabulary: Vocabulary, number: int
) -> list[_Option]:
    """Return the ways in which ``piece`` can feed a port, best first: the feature itself, a
    sub-feature, a field of the port's name. Raises `WiringError` if there is none."""
    narrower = vocabulary.subfeatures(port.feature)
    contents = [c for c in piece.contents if c.feature == port.feature]
    contents += [c for c in piece.contents if c.feature != port.feature and c.feature in narrower]
    options: list[_Option] = []
    contradiction = ""
    for content in contents:
        try:
            change = _conversion(content.unit, port.unit)
        except UnitError as error:
            contradiction = contradiction or str(error)
            continue
        fed_port = Port(content.field, port.field, content.feature, content.unit, port.unit, change)
        options.append(_Option(fed_port, content.roles))
    if contents and not options:
        raise WiringError(
            f"input `{port.field}` cannot be fed by `{contents[0].field}`: {contradiction}",
            "annotate the stream or the transformation with its actual unit",
            number,
        )
    if not options:
        options.append(_Option(_port_by_name(port, piece, number), None))
    return [_check_type(option, piece, number) for option in options]


def _port_by_name(port: PortAnnotation, piece: InputStream, number: int) -> Port:
    if port.field not in piece.fields:
        held = ", ".join(shorten(content.feature) for content in piece.contents)
        raise WiringError(
            f"it contains no {shorten(port.feature)}, which input `{port.field}` needs",
            (f"it contains {held}" if held else "it has no annotation: write one in SSL")
            + f"; {_field_list(piece)}",
            number,
        )
    return Port(port.field, port.field, port.feature, port.unit, port.unit, IDENTITY)


def _check_type(option: _Option, piece: InputStream, number: int) -> _Option:
    type = piece.fields.get(option.port.source_field)
    if option.port.target and type in (FieldType.STRING, FieldType.BOOLEAN):
        raise WiringError(
            f"field `{option.port.source_field}` is a {type}, and "
            f"`{option.port.target_field}` is a number with a unit",
            _field_list(piece),
            number,
        )
    return option


def _conversion(source: Unit, target: Unit) -> Conversion:
    """Return the conversion where both units are known, else identity. Raises `UnitError`."""
    return conversion(source, target) if source and target and source != target else IDENTITY


def _roles(piece: InputStream) -> Roles:
    """Return the roles that all contents of a stream share; empty if they differ."""
    roles = {content.roles for content in piece.contents}
    return roles.pop() if len(roles) == 1 else ()


def _check_arities(edges: Sequence[Edge]) -> None:
    """Raise `WiringError` unless all edges have keys of one length: synchronization compares the
    key of each sample, an object or a tuple of objects."""
    arities = {len(many_roles(edge)) for edge in edges} - {0}
    if len(arities) > 1:
        raise WiringError(
            "samples of some inputs are about one object, those of others about several",
            "synchronize streams about the same objects",
        )


def _field_list(piece: InputStream) -> str:
    return f"its fields are {', '.join(piece.fields)}" if piece.fields else "it has no fields yet"
