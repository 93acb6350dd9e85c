"""The search through the transformation tree, depth first ([Introspection15 §4.3]).

A node of the search is an *ask*: the fields that one consumer needs from one stream. A stream or
the output of a transformation answers an ask whole or not at all (fields of different streams
would have to be synchronized first). What is tried, in this order: streams (those that serve
more wants of the same query, then exact features before sub-features, then streams about the
wanted object itself, then as registered), then transformations (exact outputs first, then as
registered), each in depth.

A feature occurs at most once on a path. Whose features they are goes unchanged from the streams
up to the want, so before going down the search asks `_solvable`, a closure from the streams
upwards: it does not enter what leads nowhere. Cost: one closure a step of the plan, each linear
in the transformations that can lead to the wanted feature, times the distinct sorts and objects.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import TypeAlias

from ..languages.ssl.annotation import Content, Role, StreamAnnotation
from ..ontology.units import Conversion, Unit, UnitError, conversion
from ..ontology.vocabulary import Vocabulary
from .fit import Roles, Sorts
from .plan import Compute, Edge, Node, Port, SelectObject, UseStream
from .space import StreamSpace, TransformationDescription
from .want import Want

MAX_DEPTH = 64
"""Transformations on a path of a plan, at most."""


@dataclass(frozen=True, slots=True)
class Input:
    """A field that is asked for. ``unit`` None: whatever unit it stands in."""

    field: str
    feature: str
    unit: Unit | None


Ask: TypeAlias = tuple[Input, ...]


@dataclass(frozen=True, slots=True)
class Offer:
    """A stream that answers an ask: with these contents, one an input, all of the same roles."""

    rank: tuple[int, ...]
    position: int
    annotation: StreamAnnotation
    contents: tuple[Content, ...]

    @property
    def roles(self) -> Roles:
        return self.contents[0].roles


@dataclass(frozen=True, slots=True)
class Found:
    """An answer to an ask: a node, the ports on it (one an input), and whose features they are."""

    node: Node
    ports: tuple[Port, ...]
    roles: Roles


class Search:
    """The search for one want over one snapshot. Not for threads.

    ``favoured`` says of streams (positions in the space) how many wants they serve: more is first.
    """

    def __init__(
        self,
        want: Want,
        space: StreamSpace,
        vocabulary: Vocabulary,
        favoured: Mapping[int, int] | None = None,
    ) -> None:
        self.want = want
        self.space = space
        self.vocabulary = vocabulary
        self.sorts = Sorts(want, vocabulary)
        info = vocabulary.feature(want.feature)
        name = want.feature
        self.top: Ask = (Input(name, name, info.unit if info is not None else None),)
        self._favoured = favoured or {}
        self._offers: dict[Ask, dict[Roles, Offer]] = {}
        self._producers: dict[Ask, tuple[int, ...]] = {}
        self.relevant = self._reach(self.top)
        self._consumers: dict[int, list[int]] = {}
        self._feeds: dict[Roles, list[int]] = {}
        for position in self.relevant:
            ask = self.ask_at(position)
            for producer in self.producers(ask):
                self._consumers.setdefault(producer, []).append(position)
            for roles in self.offers(ask):
                self._feeds.setdefault(roles, []).append(position)
        self._closures: dict[tuple[Roles, frozenset[str]], Mapping[int, int]] = {}
        self._failed: set[tuple[Ask, frozenset[Roles], frozenset[str], int]] = set()

    def roles(self) -> tuple[Roles, ...]:
        """Whose features stand in any stream that can lead to the want, in order of trying."""
        return tuple(dict.fromkeys((*self.offers(self.top), *self._feeds)))

    def find(
        self,
        ask: Ask,
        allowed: frozenset[Roles],
        path: frozenset[str] = frozenset(),
        depth: int = 0,
    ) -> Found | None:
        """The first answer to ``ask`` whose roles are ``allowed``, with no feature of ``path``."""
        offers = self.offers(ask)
        held = [offers[roles] for roles in allowed if roles in offers]
        if held:
            return self._use(ask, min(held, key=lambda offer: offer.rank))
        key = (ask, allowed, path, depth)
        if depth == MAX_DEPTH or key in self._failed:
            return None
        for position in self.producers(ask):
            found = self.through(ask, position, allowed, path, depth)
            if found is not None:
                return found
        self._failed.add(key)
        return None

    def through(
        self,
        ask: Ask,
        position: int,
        allowed: frozenset[Roles],
        path: frozenset[str] = frozenset(),
        depth: int = 0,
    ) -> Found | None:
        """The first answer to ``ask`` by the transformation at ``position``."""
        below = self.step(ask, position, path)
        if below is None:
            return None
        unit = self.space.transformations[position]
        inner = self.ask_at(position)
        able = frozenset(
            roles
            for roles in allowed
            if self.takes(unit, roles) and self.possible(inner, roles, below, depth + 1)
        )
        found = self.find(inner, able, below, depth + 1) if able else None
        return None if found is None else self._compute(ask, unit, found)

    def ask_at(self, position: int) -> Ask:
        """What a unit of the transformation at ``position`` needs from one stream."""
        ports = self.space.transformations[position].inputs
        return tuple(Input(port.field, port.feature, port.unit) for port in ports)

    def possible(
        self, ask: Ask, roles: Roles, path: frozenset[str] = frozenset(), depth: int = 0
    ) -> bool:
        """False only if nothing answers ``ask`` for ``roles`` without the features of ``path``."""
        if roles in self.offers(ask):
            return True
        heights = self._solvable(roles, path)
        return any(
            heights.get(producer, MAX_DEPTH) <= MAX_DEPTH - depth - 1
            for producer in self.producers(ask)
        )

    def takes(self, unit: TransformationDescription, roles: Roles) -> bool:
        """The unit may be fed with features of ``roles``.

        Its output carries their id fields over, so none may have the name of its own field.
        """
        clash = any(role.id_field == unit.output.field for role in roles)
        return not clash and self.sorts.allows(unit.sort, roles)

    def offers(self, ask: Ask) -> Mapping[Roles, Offer]:
        """The streams that answer ``ask``: the first of each that speak of the same objects."""
        if ask not in self._offers:
            offers: dict[Roles, Offer] = {}
            for offer in sorted(self.all_offers(ask), key=lambda offer: offer.rank):
                offers.setdefault(offer.roles, offer)
            self._offers[ask] = offers
        return self._offers[ask]

    def producers(self, ask: Ask) -> tuple[int, ...]:
        """The transformations (positions) whose output answers ``ask``, in order of trying."""
        if ask not in self._producers:
            features = self.serving(ask[0].feature)
            positions = [
                (rank, position)
                for rank, feature in enumerate(features)
                for position in self.space.transformations_by_output.get(feature, ())
                if self._answers(self.space.transformations[position], ask)
            ]
            positions.sort(key=lambda pair: (pair[0] > 0, pair[1]))
            self._producers[ask] = tuple(position for _, position in positions)
        return self._producers[ask]

    def candidates(self, feature: str) -> tuple[int, ...]:
        """The streams (positions) that hold ``feature`` or a sub-feature of it.

        For a want of one object, without the streams that speak of another object only.
        """
        index = self.space.streams_by_feature
        positions: dict[int, None] = {}
        for name in self.serving(feature):
            if self.want.object is None:
                positions |= dict.fromkeys(index.get(name, ()))
            else:
                by_object = self.space.streams_by_object
                positions |= dict.fromkeys(by_object.get((name, None), ()))
                positions |= dict.fromkeys(by_object.get((name, self.want.object), ()))
        return tuple(sorted(positions))

    def serving(self, feature: str) -> tuple[str, ...]:
        """``feature``, then its sub-features by name."""
        return (feature, *sorted(self.vocabulary.subfeatures(feature) - {feature}))

    def _serves(self, given: str, wanted: str) -> bool:
        return given == wanted or given in self.vocabulary.subfeatures(wanted)

    def all_offers(self, ask: Ask) -> Iterator[Offer]:
        """Every stream that answers ``ask``, once for each whose features it holds; unordered."""
        for position in self.candidates(ask[0].feature):
            annotation = self.space.streams[position]
            seen: set[Roles] = set()
            for first in self._contents(annotation, ask[0], None):
                roles = first.roles
                others = [next(self._contents(annotation, i, roles), None) for i in ask[1:]]
                contents = (first, *(other for other in others if other is not None))
                if len(contents) < len(ask) or roles in seen:
                    continue
                seen.add(roles)
                inexact = sum(c.feature != i.feature for c, i in zip(contents, ask, strict=True))
                own = self.want.object is not None and roles[0].object == self.want.object
                rank = (
                    -self._favoured.get(position, 0),
                    inexact,
                    not own,
                    self._generality(roles[0].sort),
                    position,
                    len(seen),
                )
                yield Offer(rank, position, annotation, contents)

    def _generality(self, sort: str | None) -> int:
        """How far ``sort`` is above the wanted one: a stream made for a sort goes before one
        that speaks of it among others."""
        above = self.vocabulary.supersorts(self.want.wanted_sort)
        if sort is None or sort not in above:
            return 0
        return len(above) - len(self.vocabulary.supersorts(sort))

    def _contents(
        self, annotation: StreamAnnotation, input: Input, roles: Roles | None
    ) -> Iterator[Content]:
        """What can feed ``input`` for ``roles`` (None: any): exact features, then sub-features."""
        fitting = (
            content
            for content in annotation.contents
            if content.roles
            and (roles is None or content.roles == roles)
            and self._serves(content.feature, input.feature)
            and convertible(content.unit, input.unit)
        )
        return iter(sorted(fitting, key=lambda content: content.feature != input.feature))

    def _answers(self, unit: TransformationDescription, ask: Ask) -> bool:
        # What has no inputs is a source: it would have to be started for `self`.
        return bool(unit.inputs) and all(
            self._serves(unit.output.feature, input.feature)
            and convertible(unit.output.unit, input.unit)
            for input in ask
        )

    def step(self, ask: Ask, position: int, path: frozenset[str]) -> frozenset[str] | None:
        """The path below a transformation that answers ``ask``; None if a feature came twice."""
        unit = self.space.transformations[position]
        if unit.output.feature in path:
            return None
        below = path.union((unit.output.feature,), (input.feature for input in ask))
        return None if any(port.feature in below for port in unit.inputs) else below

    def _reach(self, ask: Ask) -> tuple[int, ...]:
        """The transformations that can lead to ``ask`` at all."""
        seen: dict[int, None] = {}
        waiting = list(self.producers(ask))
        while waiting:
            position = waiting.pop()
            if position not in seen:
                seen[position] = None
                waiting.extend(self.producers(self.ask_at(position)))
        return tuple(sorted(seen))

    def _solvable(self, roles: Roles, path: frozenset[str]) -> Mapping[int, int]:
        """The transformations that can be fed, for ``roles``, without the features of ``path``.

        Each with the least number of transformations below it. Upwards from the streams, breadth
        first. What is not in it is no part of a plan below ``path``.
        """
        key = (roles, path)
        if key not in self._closures:
            heights: dict[int, int] = {}
            waiting = deque((position, 0) for position in self._feeds.get(roles, ()))
            while waiting:
                position, height = waiting.popleft()
                unit = self.space.transformations[position]
                if (
                    position not in heights
                    and unit.output.feature not in path
                    and not any(port.feature in path for port in unit.inputs)
                    and self.takes(unit, roles)
                ):
                    heights[position] = height
                    above = self._consumers.get(position, ())
                    waiting.extend((consumer, height + 1) for consumer in above)
            self._closures[key] = heights
        return self._closures[key]

    def _use(self, ask: Ask, offer: Offer) -> Found:
        node: Node = UseStream(offer.annotation.stream, offer.annotation.contents)
        wanted = self.want.object
        roles: list[Role] = []
        for place, role in enumerate(offer.roles):
            selected = wanted if wanted is not None and place == 0 else role.object
            if selected is not None and role.id_field is not None:
                node = SelectObject(node, role.id_field, selected)
                role = replace(role, object=selected)
            roles.append(role)
        ports = tuple(
            make_port(content.field, content.feature, content.unit, input)
            for content, input in zip(offer.contents, ask, strict=True)
        )
        return Found(node, ports, tuple(roles))

    def _compute(self, ask: Ask, unit: TransformationDescription, found: Found) -> Found:
        node = Compute(unit.name, (Edge(found.node, found.ports),), unit.output, found.roles)
        output = unit.output
        ports = tuple(make_port(output.field, output.feature, output.unit, i) for i in ask)
        return Found(node, ports, found.roles)


def convertible(source: Unit, target: Unit | None) -> bool:
    """Values in ``source`` units can be had in ``target`` units (None: any)."""
    return why_not_convertible(source, target) == ""


def why_not_convertible(source: Unit, target: Unit | None) -> str:
    """Why not, in words; empty if they can."""
    if target is None or source == target:
        return ""
    try:
        conversion(source, target)
    except UnitError as error:
        return str(error)
    return ""


def make_port(field: str, feature: str, source: Unit, input: Input) -> Port:
    """The port that feeds ``input`` from ``field``."""
    target = source if input.unit is None else input.unit
    change = Conversion(1.0, 0.0) if source == target else conversion(source, target)
    return Port(field, input.field, feature, source, target, change)
