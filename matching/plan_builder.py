"""From chosen answers to a plan: which streams, selections, synchronizations and units.

The builder settles the details that goals leave open: the stream and field of a feature, its unit
of measurement, and the field that names the objects.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import NamedTuple

from ..languages.ssl.annotation import Role
from ..ontology.units import IDENTITY, Unit, conversion, parse_unit
from .goal import Answer, Apart, Goal, Offer, Through
from .plan import (
    Compute,
    Detect,
    Edge,
    Node,
    Port,
    SelectObject,
    SupplySource,
    Synchronize,
    UseStream,
    tuple_roles,
)
from .space import EventDescription, TransformationDescription
from .subject import Roles, Sorts, Subjects
from .want import Want


class Output(NamedTuple):
    """A field of a node's stream, with the feature in it and its unit."""

    field: str
    feature: str
    unit: Unit


class Found(NamedTuple):
    """A node that answers asks: ``outputs`` one an ask, all of ``roles``.

    ``depth`` is the greatest number of transformations on a path below it, itself included.
    """

    node: Node
    outputs: tuple[Output, ...]
    roles: Roles
    depth: int = 0


class Builder:
    """Builds nodes; equal goals are one node.

    Contract: ``chosen`` has every goal to build with all its needs, without a circle.
    """

    def __init__(self, chosen: Mapping[Goal, Answer], sorts: Sorts) -> None:
        self._chosen = chosen
        self._sorts = sorts
        self._built: dict[Goal, tuple[tuple[Found, tuple[int, ...]], ...]] = {}

    def build(self, goal: Goal) -> Found:
        """Build the node that answers a goal of one ask."""
        ((found, _),) = self._parts(goal)
        return found

    def _parts(self, goal: Goal) -> tuple[tuple[Found, tuple[int, ...]], ...]:
        """Build the parts that answer a goal, each with the places of its asks."""
        waiting = [goal]
        while waiting:
            last = waiting[-1]
            if last in self._built:
                waiting.pop()
                continue
            answer = self._chosen[last]
            needs = () if isinstance(answer, Offer) else answer.needs
            missing = [need for need in needs if need not in self._built]
            if missing:
                waiting += missing
                continue
            waiting.pop()
            self._built[last] = self._answer(last, answer)
        return self._built[goal]

    def _answer(self, goal: Goal, answer: Answer) -> tuple[tuple[Found, tuple[int, ...]], ...]:
        everything = tuple(range(len(goal.asks)))
        match answer:
            case Offer():
                return ((self._offered(answer, goal.subjects), everything),)
            case Through():
                return ((self._computed(answer, goal.subjects, len(everything)), everything),)
            case Apart(needs, places):
                return tuple(
                    (found, tuple(group[i] for i in inner))
                    for need, group in zip(needs, places, strict=True)
                    for found, inner in self._built[need]
                )

    def _offered(self, offer: Offer, subjects: Subjects) -> Found:
        node: Node = UseStream(offer.stream.name, offer.stream.contents)
        outputs = tuple(Output(c.field, c.feature, c.unit) for c in offer.contents)
        return _selected(Found(node, outputs, offer.roles), subjects)

    # -- units -------------------------------------------------------------------------------

    def _computed(self, through: Through, subjects: Subjects, asks: int) -> Found:
        unit = through.unit
        if isinstance(unit, EventDescription):
            return self._detected(unit, through, subjects)
        feeds, places = self._feeds(through)
        node = computed(unit, feeds, places, self._sorts)
        own = _own_fields(unit)
        made = Output(unit.output.field, unit.output.feature, unit.output.unit)
        found = Found(node, (made,) * asks, node.roles, self._depth(through))
        return _selected(found, subjects, own)

    def _detected(self, unit: EventDescription, through: Through, subjects: Subjects) -> Found:
        subject = subjects[0]._replace(bounds=())
        wants = unit.wants_of(subject) or ()
        sources = []
        for want, need in zip(wants, through.needs, strict=True):
            ((found, _),) = self._built[need]
            sources.append(source_of(found, need, want))
        (argument,) = unit.arguments
        sort = subject.sort or argument.sort
        object = subject.object if unit.is_selective(subject) else None
        roles = (Role(sort, object, unit.id_field),)
        node = Detect(unit.name, subject, wants, tuple(sources), unit.output, roles)
        made = Output(unit.output.field, unit.output.feature, unit.output.unit)
        return _selected(Found(node, (made,), roles, self._depth(through)), subjects)

    def _depth(self, through: Through) -> int:
        below = (found.depth for need in through.needs for found, _ in self._built[need])
        return 1 + max(below, default=0)

    def _feeds(self, through: Through) -> tuple[list[Edge], list[int]]:
        """The edges that feed the inputs, each stream once, and the edge of each input."""
        fed = []
        for port, (j, k) in zip(through.unit.inputs, through.feeds, strict=True):
            found, asks = next(part for part in self._built[through.needs[j]] if k in part[1])
            output = found.outputs[asks.index(k)]
            fed.append((found.node, found.roles, make_port(output, port.field, port.unit)))
        return gathered(fed, [len(through.needs[j].subjects) for j, _ in through.feeds])


def gathered(
    fed: Sequence[tuple[Node, Roles, Port]], wanted: Sequence[int] | None = None
) -> tuple[list[Edge], list[int]]:
    """The edges that feed the inputs of a unit, each stream once, and the edge of each input.

    ``fed[i]`` is the node, the roles of what it holds, and the port that feed input ``i``. Where
    several streams meet, input ``i`` has the first ``wanted[i]`` roles only: nothing defines how
    further roles meet the other streams.
    """
    if len(fed) == 1:
        ((node, roles, port),) = fed
        return [Edge(node, (port,), roles)], [0]
    counts = [len(roles) for _, roles, _ in fed]
    if wanted is not None and len({(node, roles) for node, roles, _ in fed}) > 1:
        counts = list(wanted)
    places: dict[tuple[Node, Roles, int], int] = {}
    ports: list[list[Port]] = []
    order = []
    for (node, roles, port), count in zip(fed, counts, strict=True):
        place = places.setdefault((node, roles, count), len(ports))
        if place == len(ports):
            ports.append([])
        ports[place].append(port)
        order.append(place)
    edges = [
        Edge(node, tuple(own), roles[:count])
        for (node, roles, count), own in zip(places, ports, strict=True)
    ]
    return edges, order


def computed(
    unit: TransformationDescription, feeds: Sequence[Edge], places: Sequence[int], sorts: Sorts
) -> Compute:
    """The unit of a transformation whose input ``i`` is fed by ``feeds[places[i]]``; several feeds
    are synchronized. Where an input has no roles, the output has none."""
    feed = synchronized(feeds) if len(feeds) > 1 else next(iter(feeds), None)
    given = _output_roles(unit, feeds, places, feed, sorts)
    # An id field of the inputs may have the name of a field of the output.
    taken = {unit.output.field, *_own_fields(unit)}
    names: dict[str, str] = {}
    roles: list[Role] = []
    carried: list[tuple[str, str]] = []
    for place, role in enumerate(given):
        before = role.id_field
        if before is None or (unit.arguments and unit.arguments[place].id_field is not None):
            roles.append(role)
            continue
        if before not in names:
            names[before] = _free(before, taken)
            taken.add(names[before])
        after = names[before]
        roles.append(role if after == before else role._replace(id_field=after))
        carried.append((before, after))
    inputs = () if feed is None else (feed,)
    return Compute(unit.name, inputs, unit.output, tuple(roles), tuple(carried))


def synchronized(feeds: Sequence[Edge]) -> Edge:
    """One stream of tuples of the values that several streams hold of the same objects.

    Its id fields are those of the first stream that has any: of several kinds of objects only
    one is many.
    """
    first = next((many for many in map(many_roles, feeds) if many), ())
    taken = {role.id_field for role in first if role.id_field is not None}
    ports: list[Port] = []
    edges: list[Edge] = []
    for feed in feeds:
        # Values stand in the tuple as in the stream: the consumer converts them.
        own: dict[str, Port] = {}
        for port in feed.ports:
            if port.source_field not in own:
                name = numbered(port.target_field, taken)
                taken.add(name)
                own[port.source_field] = Port(
                    port.source_field, name, port.feature, port.source, port.source, IDENTITY
                )
            name = own[port.source_field].target_field
            ports.append(
                Port(
                    name, port.target_field, port.feature, port.source, port.target, port.conversion
                )
            )
        edges.append(Edge(feed.node, tuple(own.values()), feed.roles))
    return Edge(Synchronize(tuple(edges), first), tuple(ports), first)


def _own_fields(unit: TransformationDescription) -> set[str]:
    """The id fields of objects that a unit finds itself."""
    return {argument.id_field for argument in unit.arguments if argument.id_field is not None}


def _output_roles(
    unit: TransformationDescription,
    feeds: Sequence[Edge],
    places: Sequence[int],
    feed: Edge | None,
    sorts: Sorts,
) -> Roles:
    """The roles of the output."""
    whose = []
    if feed is not None:
        whose = [feed.roles if len(feeds) == 1 else tuple_roles(f, feed.roles) for f in feeds]
    given: dict[str, Role] = {}
    for port, place in zip(unit.inputs, places, strict=True):
        for argument, role in zip(port.arguments or unit.arguments, whose[place], strict=False):
            if argument.object is None:
                given.setdefault(argument.variable, role)
    roles = []
    for argument in unit.arguments:
        if argument.object is not None:
            roles.append(Role(None, sorts.canonical(argument.object), None))
        elif argument.id_field is not None:
            roles.append(Role(argument.sort, None, argument.id_field))
        elif argument.variable in given:
            roles.append(given[argument.variable])
        else:
            return ()
    return tuple(roles) if roles or not whose else whose[places[0]]


def source_of(found: Found, goal: Goal, want: Want) -> SupplySource:
    """The node that answers the goal of a want, as a source of the want."""
    (ask,), (output,) = goal.asks, found.outputs
    unit = output.unit if ask.unit is None else parse_unit(ask.unit)
    return SupplySource(found.node, make_port(output, want.feature, unit), found.roles)


def _selected(found: Found, subjects: Subjects, fields: Collection[str] | None = None) -> Found:
    """Select the samples of the wanted objects, where a stream has those of others.

    ``fields`` are the id fields to look at (None: all): those that a unit takes over from its
    inputs were selected there.
    """
    node = found.node
    roles: list[Role] = []
    for place, role in enumerate(found.roles):
        field = role.id_field if fields is None or role.id_field in fields else None
        wanted = subjects[place].object if place < len(subjects) else None
        object = wanted if wanted is not None else role.object
        # A role with a sort and an object is one that was selected already.
        if object is not None and field is not None and not (role.sort and role.object):
            node = SelectObject(node, field, object)
            role = role._replace(object=object)
        roles.append(role)
    return found if node is found.node else found._replace(node=node, roles=tuple(roles))


def many_roles(feed: Edge) -> Roles:
    """The roles that stand for many objects."""
    return tuple(role for role in feed.roles if role.object is None)


def numbered(field: str, taken: set[str]) -> str:
    """``v``, or ``v_2`` where there is a ``v`` already."""
    name, number = field, 2
    while name in taken:
        name, number = f"{field}_{number}", number + 1
    return name


def _free(field: str, taken: set[str]) -> str:
    while field in taken:
        field += "_of"
    return field


def make_port(output: Output, field: str, unit: Unit) -> Port:
    """The port that feeds ``field``, in ``unit``, from an output."""
    same = output.unit == unit
    change = IDENTITY if same else conversion(output.unit, unit)
    return Port(output.field, field, output.feature, output.unit, unit, change)
