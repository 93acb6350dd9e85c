"""Plans: the streams and units that give a wanted feature ([Introspection15 §4.3]).

A plan is a value: frozen nodes, of which several may rest on one, that say which streams are used,
whose samples are selected, and which units compute what from which fields. Equal nodes stand for
one unit, so two plans that hold equal nodes share it. `match` makes plans, the engine carries them
out.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from operator import attrgetter
from typing import NamedTuple, TypeAlias, assert_never

from ..languages.ssl.annotation import (
    Content,
    PortAnnotation,
    Role,
    StreamAnnotation,
)
from ..languages.ssl.annotation_text import with_ssl_source
from ..ontology.units import Conversion, Unit
from .subject import Subject
from .want import Want


class _Hashed:
    """Caches its hash, and the nodes it was found equal to: a plan shares nodes, so a plain
    comparison would walk every path. Cost of both: O(distinct nodes) the first time."""

    __slots__ = ("_hash", "_same")

    @property
    def parts(self) -> tuple[Node | Edge, ...]:
        """The nodes and edges in it."""
        raise NotImplementedError

    def __hash__(self) -> int:
        try:
            return self._hash  # type: ignore[attr-defined,no-any-return]
        except AttributeError:
            found = hash((type(self).__name__, _values_of(self)))
            object.__setattr__(self, "_hash", found)
            return found

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, _Hashed) or type(other) is not type(self):
            return NotImplemented
        # Parts first, without recursion: a plan may be some hundred nodes deep.
        waiting = [(self, other)]
        while waiting:
            one, another = waiting[-1]
            if _found_equal(one, another):
                waiting.pop()
                continue
            if type(one) is not type(another) or hash(one) != hash(another):
                return False
            pairs = zip(one.parts, another.parts, strict=False)
            below = [
                (mine, others)
                for mine, others in pairs
                if isinstance(mine, _Hashed)
                and isinstance(others, _Hashed)
                and not _found_equal(mine, others)
            ]
            if below:
                waiting += below
                continue
            if _values_of(one) != _values_of(another):
                return False
            _tell_equal(one, another)
            waiting.pop()
        return True


def _found_equal(one: _Hashed, another: _Hashed) -> bool:
    """Whether they are one, or were compared and are equal."""
    mark = getattr(one, "_same", None)
    return one is another or (mark is not None and mark is getattr(another, "_same", None))


def _tell_equal(one: _Hashed, another: _Hashed) -> None:
    mark = getattr(one, "_same", None) or object()
    object.__setattr__(one, "_same", mark)
    object.__setattr__(another, "_same", mark)


def _values_of(node: _Hashed) -> tuple[object, ...]:
    """The values of a node's fields."""
    kind = type(node)
    read = _VALUES.get(kind)
    if read is None:
        names = (field.name for field in fields(kind))  # type: ignore[arg-type]
        read = _VALUES[kind] = attrgetter(*names)
    return read(node)


_VALUES: dict[type, Callable[[object], tuple[object, ...]]] = {}
"""The reader of the fields of each class of nodes."""


@dataclass(frozen=True, slots=True)
class UseStream:
    """A stream that exists, with all that one annotation says it contains.

    All contents are kept, used or not, so that nodes over the same stream are equal.
    """

    stream: str
    contents: tuple[Content, ...]


@dataclass(frozen=True, slots=True)
class SelectObject(_Hashed):
    """The samples of ``source`` whose ``id_field`` names ``object`` (an IRI).

    Same fields, same order: a filter. [Events14 §V.C]: "filters this stream for coordinate
    information on uav1".
    """

    source: Node
    id_field: str
    object: str

    __hash__ = _Hashed.__hash__
    __eq__ = _Hashed.__eq__

    @property
    def parts(self) -> tuple[Node | Edge, ...]:
        return (self.source,)


@dataclass(frozen=True, slots=True)
class SelectObjects(_Hashed):
    """The samples of ``source`` whose ``id_field`` names an object that a running request asks for.

    Matching never makes it: requests that share a query do (`engine.planning.request_sharing`). An
    object that has left a ``generation`` does not enter it again, since the units that read it know
    the earlier samples of the object.
    """

    source: Node
    id_field: str
    generation: int

    __hash__ = _Hashed.__hash__
    __eq__ = _Hashed.__eq__

    @property
    def parts(self) -> tuple[Node | Edge, ...]:
        return (self.source,)


class Port(NamedTuple):
    """A field of a node's stream feeds a field of the consumer, with the change of unit.

    ``feature`` is the feature of the field in the stream: the one that the consumer asked for, or a
    sub-feature. ``conversion`` turns ``source`` units into ``target`` units.
    """

    source_field: str
    target_field: str
    feature: str
    source: Unit
    target: Unit
    conversion: Conversion


@dataclass(frozen=True, slots=True)
class Edge(_Hashed):
    """The fields that a unit takes from one node's stream, and the roles of their features."""

    node: Node
    ports: tuple[Port, ...]
    roles: tuple[Role, ...]

    __hash__ = _Hashed.__hash__
    __eq__ = _Hashed.__eq__

    @property
    def parts(self) -> tuple[Node | Edge, ...]:
        return (self.node,)

    @property
    def id_fields(self) -> tuple[str, ...]:
        """The fields of the stream that tell the objects apart."""
        return tuple(role.id_field for role in self.roles if role.id_field is not None)


@dataclass(frozen=True, slots=True)
class Synchronize(_Hashed):
    """For each object the latest values of several streams together, whenever one has a new one.

    The join of [DyKnow10 Def. 5.11], object by object. The value of an input with a single object
    goes to each of the others. The stream has the ``target_field`` of each port, in the units of
    its source, and the id fields of ``roles``: the roles of the inputs with many objects.
    """

    inputs: tuple[Edge, ...]
    roles: tuple[Role, ...]

    __hash__ = _Hashed.__hash__
    __eq__ = _Hashed.__eq__

    @property
    def parts(self) -> tuple[Node | Edge, ...]:
        return self.inputs


@dataclass(frozen=True, slots=True)
class Compute(_Hashed):
    """A unit made from ``transformation``. It keeps apart the objects that its inputs speak of.

    ``inputs`` is one edge, or none for a source. ``roles`` say whose its output is: the objects of
    its inputs, or those that it finds itself. Its stream has their id fields (none where the
    object is constant) and ``output.field``; ``carried`` are pairs of an id field of the input and
    the id field of the output that takes it over. ``parameters`` override the transformation's: a
    specification may give some, matching never does.
    """

    transformation: str
    inputs: tuple[Edge, ...]
    output: PortAnnotation
    roles: tuple[Role, ...]
    carried: tuple[tuple[str, str], ...] = ()
    parameters: tuple[tuple[str, str], ...] = ()

    __hash__ = _Hashed.__hash__
    __eq__ = _Hashed.__eq__

    @property
    def parts(self) -> tuple[Node | Edge, ...]:
        return self.inputs


@dataclass(frozen=True, slots=True)
class Detect(_Hashed):
    """The continuous query of an event template for objects of ``subject`` ([Events14 §V.B]).

    ``sources[i]`` gives ``wants[i]``. Its stream has the event's value in ``output.field``, and the
    id fields of ``roles``.
    """

    event: str
    subject: Subject
    wants: tuple[Want, ...]
    sources: tuple[SupplySource, ...]
    output: PortAnnotation
    roles: tuple[Role, ...]

    __hash__ = _Hashed.__hash__
    __eq__ = _Hashed.__eq__

    @property
    def parts(self) -> tuple[Node | Edge, ...]:
        return tuple(source.node for source in self.sources)


Node: TypeAlias = UseStream | SelectObject | SelectObjects | Synchronize | Compute | Detect


def nothing_runs(node: Node) -> bool:
    """The assumption that no node has a unit yet."""
    return False


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
    """The contents of the stream of ``node``: features, fields, units, roles.

    A selection keeps fields and units, and its object stands in each role that its id field
    names: such a role has sort, object and id field, and means "this object, which is of this
    sort, named by this field". A unit's stream has one content, whose roles are its input's: the
    same id field over ``every S = id``, a constant object over a constant object.
    """
    match node:
        case UseStream(_, contents):
            return contents
        case SelectObjects(source):
            return contents_of(source)
        case SelectObject(source, id_field, object):
            return tuple(
                replace(content, roles=_select(content.roles, id_field, object))
                for content in contents_of(source)
            )
        case Synchronize(inputs, roles):
            return tuple(
                Content(port.feature, port.target_field, port.target, tuple_roles(edge, roles))
                for edge in inputs
                for port in edge.ports
            )
        case Compute(output=output, roles=roles) | Detect(output=output, roles=roles):
            return (Content(output.feature, output.field, output.unit, roles),)
        case _:
            assert_never(node)


def tuple_roles(edge: Edge, kept: tuple[Role, ...]) -> tuple[Role, ...]:
    """The roles of a part of a tuple: the tuple's own id fields name many objects."""
    many = iter(kept)
    return tuple(
        next(many) if role.object is None else Role(None, role.object, None) for role in edge.roles
    )


def _select(roles: tuple[Role, ...], id_field: str, object: str) -> tuple[Role, ...]:
    return tuple(
        role._replace(object=object) if role.id_field == id_field else role for role in roles
    )


def annotation_of(node: Node, stream: str = "") -> StreamAnnotation:
    """The annotation of ``node``'s stream, under the name it was given.

    A stream that exists keeps its own name.
    """
    name = node.stream if isinstance(node, UseStream) else stream
    contents = contents_of(node)
    return with_ssl_source(StreamAnnotation(name, contents, ""))


def wanted_annotation(supply: Supply, source: SupplySource, stream: str = "") -> StreamAnnotation:
    """The annotation for a consumer of ``source``: one content, named as the *wanted* feature.

    A stream of a sub-feature is a stream of the feature, so the triples made from it have the
    predicate that the query asks for. The unit is still the stream's (``source.port.source``).
    """
    return _annotation_of_source(supply.want.feature, source, stream)


def own_annotation(source: SupplySource, stream: str = "") -> StreamAnnotation:
    """The same under the feature that the stream names: that of several wanted ones is entailed."""
    return _annotation_of_source(source.port.feature, source, stream)


def _annotation_of_source(feature: str, source: SupplySource, stream: str) -> StreamAnnotation:
    name = source.node.stream if isinstance(source.node, UseStream) else stream
    port = source.port
    contents = (Content(feature, port.source_field, port.source, source.roles),)
    return with_ssl_source(StreamAnnotation(name, contents, ""))


def nodes_of(node: Node) -> Iterator[Node]:
    """``node`` and all below it, each once, inputs first (the order in which units can be
    started)."""
    seen: set[Node] = set()
    waiting = [node]
    while waiting:
        last = waiting[-1]
        missing = [below for below in below_of(last) if below not in seen]
        if missing:
            waiting += reversed(missing)
            continue
        waiting.pop()
        if last not in seen:
            seen.add(last)
            yield last


def below_of(node: Node) -> tuple[Node, ...]:
    """The nodes whose streams ``node`` reads."""
    match node:
        case UseStream():
            return ()
        case SelectObject(source) | SelectObjects(source):
            return (source,)
        case Compute(_, inputs) | Synchronize(inputs):
            return tuple(edge.node for edge in inputs)
        case Detect(sources=sources):
            return tuple(source.node for source in sources)
        case _:
            assert_never(node)


def is_for_some_objects(node: Node) -> bool:
    """Whether the stream of ``node`` lacks objects that no request asks for (`SelectObjects`)."""
    return any(isinstance(each, SelectObjects) for each in nodes_of(node))


def nodes_of_supply(supply: Supply) -> tuple[Node, ...]:
    """The nodes of all sources, each once, inputs first."""
    found: dict[Node, None] = {}
    for source in supply.sources:
        found |= dict.fromkeys(nodes_of(source.node))
    return tuple(found)


def streams_of(supply: Supply) -> tuple[str, ...]:
    """Names of the existing streams that the supply rests on, each once, in order of use."""
    nodes = nodes_of_supply(supply)
    return tuple(dict.fromkeys(node.stream for node in nodes if isinstance(node, UseStream)))


def expanded(supply: Supply, made: Mapping[str, Node]) -> Supply:
    """The same plan, with the nodes that make the streams ``made`` instead of these streams."""
    known: dict[Node, Node] = {}

    def of_edge(edge: Edge) -> Edge:
        return Edge(known[edge.node], edge.ports, edge.roles)

    def of_sources(sources: Sequence[SupplySource]) -> tuple[SupplySource, ...]:
        return tuple(SupplySource(known[s.node], s.port, s.roles) for s in sources)

    for node in nodes_of_supply(supply):
        match node:
            case UseStream(stream):
                known[node] = made.get(stream, node)
            case SelectObject(source, id_field, object):
                known[node] = SelectObject(known[source], id_field, object)
            case SelectObjects(source):
                known[node] = replace(node, source=known[source])
            case Synchronize(inputs, roles):
                known[node] = Synchronize(tuple(map(of_edge, inputs)), roles)
            case Compute():
                known[node] = replace(node, inputs=tuple(map(of_edge, node.inputs)))
            case Detect():
                known[node] = replace(node, sources=of_sources(node.sources))
            case _:
                assert_never(node)
    return replace(supply, sources=of_sources(supply.sources))
