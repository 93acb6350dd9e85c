"""Which field of which stream feeds which input of a unit ([Introspection15 §3.2, §4.3]).

A specification says what a unit reads; which fields these are follows from what the streams are
annotated to contain. The plan nodes are those that semantic matching makes of the same streams, so
what one inserts the other shares. Nothing is started here, and no place of a text is known:
`elaboration` turns `Unfit` into an error that has one.
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
"""The fields of a stream, with their types as far as they are known."""


class Unfit(Exception):
    """Inputs that a unit cannot take. ``input`` is the number (from 0) of the one, if it is one."""

    def __init__(self, message: str, hint: str, input: int | None = None) -> None:
        super().__init__(message)
        self.message = message
        self.hint = hint
        self.input = input


@dataclass(frozen=True, slots=True, eq=False)
class Piece:
    """A stream that a unit reads: one that there is, by name, or the output of a unit of ``what``.

    ``recipe`` is how that unit is made, over nodes that stand for its inputs (`stand_in`); None of
    what there is.
    """

    what: Shape | str
    contents: tuple[Content, ...]
    fields: Fields
    recipe: Compute | SelectObject | Synchronize | Policy | None = None

    @property
    def stand_in(self) -> UseStream:
        """A node in the place of the real one, which is known when the unit runs."""
        name = self.what if isinstance(self.what, str) else f"#{self.what.number}"
        return UseStream(name, self.contents)


class _Option(NamedTuple):
    """A way to feed an input. ``roles`` None: nobody says whose the field is."""

    port: Port
    roles: Roles | None


def transformed(
    unit: TransformationDescription, pieces: Sequence[Piece], vocabulary: Vocabulary
) -> Compute:
    """The unit of a transformation over ``pieces``: one for each input, in order, or one for all
    together. Raises `Unfit`."""
    ports = unit.inputs
    _check_number(unit, len(pieces))
    if len(pieces) == 1 and len(ports) > 1:
        fed = _together(ports, pieces[0], vocabulary)
    else:
        fed = [
            _fed(_options(port, piece, vocabulary, number)[0], piece)
            for number, (port, piece) in enumerate(zip(ports, pieces, strict=True))
        ]
    edges, places = gathered(fed)
    _check_many(edges)
    return computed(unit, edges, places, Sorts(vocabulary))


def selected(piece: Piece, field: str, object: str) -> SelectObject:
    """The samples of ``piece`` whose ``field`` names ``object`` (an IRI). Raises `Unfit`."""
    if field not in piece.fields:
        raise Unfit(f"its input has no field `{field}`", _known_fields(piece))
    type = piece.fields[field]
    if type not in (None, FieldType.STRING, FieldType.INTEGER):
        raise Unfit(
            f"field `{field}` is a {type}, it cannot name objects",
            "an id field is a string or an integer",
        )
    return SelectObject(piece.stand_in, field, object)


def together(pieces: Sequence[Piece]) -> Synchronize:
    """All that the pieces hold, object by object. Raises `Unfit`."""
    taken: set[str] = set()
    edges: list[Edge] = []
    for number, piece in enumerate(pieces):
        if any(piece.what == other.what for other in pieces[:number]):
            continue
        if not piece.contents:
            raise Unfit(
                "nobody has said what this input contains",
                "annotate it in SSL: only what belongs to an object can be synchronized",
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
        raise Unfit(
            "there is nothing to bring together",
            "`synchronize` has two or more inputs that are different streams",
        )
    _check_many(edges)
    node = synchronized(edges).node
    assert isinstance(node, Synchronize)
    return node


def fields_of(node: Compute | SelectObject | Synchronize, pieces: Sequence[Piece]) -> Fields:
    """The fields of a node's stream, whose inputs are ``pieces``."""
    if isinstance(node, SelectObject):
        return pieces[0].fields
    made: dict[str, FieldType | None] = {
        role.id_field: None for role in node.roles if role.id_field is not None
    }
    if isinstance(node, Compute):
        return {**made, node.output.field: None}
    return made | {port.target_field: None for edge in node.inputs for port in edge.ports}


def bound(
    recipe: Compute | SelectObject | Synchronize, real: Callable[[UseStream], Node]
) -> Compute | SelectObject | Synchronize:
    """The recipe over the real nodes of its inputs; ``real`` gives that of a stand-in."""
    match recipe:
        case SelectObject(UseStream() as source, field, object):
            return SelectObject(real(source), field, object)
        case Synchronize(inputs, roles):
            return Synchronize(tuple(_bound_edge(edge, real) for edge in inputs), roles)
        case Compute(inputs=inputs):
            return replace(recipe, inputs=tuple(_bound_edge(edge, real) for edge in inputs))
        case _:
            raise AssertionError(recipe)


def _bound_edge(edge: Edge, real: Callable[[UseStream], Node]) -> Edge:
    match edge.node:
        case UseStream() as source:
            return Edge(real(source), edge.ports, edge.roles)
        case Synchronize() as several:
            return Edge(bound(several, real), edge.ports, edge.roles)
        case _:
            raise AssertionError(edge.node)


# -- which field ------------------------------------------------------------------------------


def _check_number(unit: TransformationDescription, number: int) -> None:
    takes = len(unit.inputs)
    if number == takes or (number == 1 and takes > 1):
        return
    if not takes:
        raise Unfit(f"`{unit.name}` is a source, and reads nothing", "leave its inputs out")
    wanted = ", ".join(f"{port.field} ({shorten(port.feature)})" for port in unit.inputs)
    count = "1 input" if takes == 1 else f"{takes} inputs"
    raise Unfit(
        f"`{unit.name}` takes {count}, and {number or 'none'} {'is' if number < 2 else 'are'} here",
        f"one `cu` or `stream` for {'it' if takes == 1 else 'each of them, in order'}: {wanted}"
        + ("; or a single one that holds them all" if takes > 1 else ""),
    )


def _together(
    ports: Sequence[PortAnnotation], piece: Piece, vocabulary: Vocabulary
) -> list[tuple[Node, Roles, Port]]:
    """One stream feeds all ports, with fields that speak of the same objects."""
    options = [_options(port, piece, vocabulary, 0) for port in ports]
    known = [option.roles for own in options for option in own if option.roles is not None]
    for roles in known or [_roles(piece)]:
        fitting = [[o for o in own if o.roles is None or o.roles == roles] for own in options]
        if all(fitting):
            return [(piece.stand_in, roles, own[0].port) for own in fitting]
    names = ", ".join(shorten(port.feature) for port in ports)
    raise Unfit(
        f"it holds {names} of different objects",
        "give an input for each of them: they are brought together object by object",
        0,
    )


def _fed(option: _Option, piece: Piece) -> tuple[Node, Roles, Port]:
    roles = _roles(piece) if option.roles is None else option.roles
    return piece.stand_in, roles, option.port


def _options(
    port: PortAnnotation, piece: Piece, vocabulary: Vocabulary, number: int
) -> list[_Option]:
    """The ways in which ``piece`` can feed a port, best first: the feature itself, a sub-feature,
    a field of the port's own name. At least one; raises `Unfit`."""
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
        made = Port(content.field, port.field, content.feature, content.unit, port.unit, change)
        options.append(_Option(made, content.roles))
    if contents and not options:
        raise Unfit(
            f"input `{port.field}` cannot be fed by `{contents[0].field}`: {contradiction}",
            "annotate the stream or the transformation in the unit that it really has",
            number,
        )
    if not options:
        options.append(_Option(_by_name(port, piece, number), None))
    return [_checked(option, piece, number) for option in options]


def _by_name(port: PortAnnotation, piece: Piece, number: int) -> Port:
    if port.field not in piece.fields:
        held = ", ".join(shorten(content.feature) for content in piece.contents)
        raise Unfit(
            f"it holds no {shorten(port.feature)}, which input `{port.field}` takes",
            (f"it holds {held}" if held else "nobody has said what it contains: annotate it in SSL")
            + f"; {_known_fields(piece)}",
            number,
        )
    return Port(port.field, port.field, port.feature, port.unit, port.unit, IDENTITY)


def _checked(option: _Option, piece: Piece, number: int) -> _Option:
    type = piece.fields.get(option.port.source_field)
    if option.port.target and type in (FieldType.STRING, FieldType.BOOLEAN):
        raise Unfit(
            f"field `{option.port.source_field}` is a {type}, and "
            f"`{option.port.target_field}` a number with a unit",
            _known_fields(piece),
            number,
        )
    return option


def _conversion(source: Unit, target: Unit) -> Conversion:
    """Values are converted where both units are known; raises `UnitError`."""
    return conversion(source, target) if source and target and source != target else IDENTITY


def _roles(piece: Piece) -> Roles:
    """Whose everything in a stream is; nobody's if it speaks of several."""
    roles = {content.roles for content in piece.contents}
    return roles.pop() if len(roles) == 1 else ()


def _check_many(edges: Sequence[Edge]) -> None:
    """Streams are brought together by one object, or one tuple of objects, of a sample."""
    arities = {len(many_roles(edge)) for edge in edges} - {0}
    if len(arities) > 1:
        raise Unfit(
            "its inputs speak of one object and of several objects in a sample",
            "what is brought together speaks of the same objects",
        )


def _known_fields(piece: Piece) -> str:
    return f"its fields are {', '.join(piece.fields)}" if piece.fields else "it has no fields yet"
