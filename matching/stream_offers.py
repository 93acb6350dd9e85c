"""Streams that answer a goal by themselves, best first.

The order: streams that serve more wants of the same query, then exact features before sub-features,
then streams about the wanted object itself, then those made for the sort before more general ones,
then as registered.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from ..languages.ssl.annotation import Content
from ..ontology.vocabulary import THING
from .feature_index import FeatureIndex
from .goal import Goal, Offer
from .space import Ask, StreamDescription, why_not_convertible
from .subject import Roles, Subjects


class StreamOffers:
    """The offers of the streams in an index. ``favoured`` gives the number of wants that a stream
    serves: one that serves more comes first.
    """

    def __init__(self, index: FeatureIndex, favoured: Mapping[str, int]) -> None:
        self._index = index
        self._space = index.space
        self._sorts = index.sorts
        self._serving = index.serving
        self._favoured = favoured
        self._offers: dict[Goal, tuple[Offer, ...]] = {}

    def of(self, goal: Goal) -> tuple[Offer, ...]:
        """The streams that hold all asks of a goal, best first. No stream alone holds a sort, which
        is divided by streams (`Goals.parts`)."""
        found = self._offers.get(goal)
        if found is None:
            is_divided = self._sorts.is_sort(goal.asks[0].feature) and not goal.streams
            ranked = [] if is_divided else list(self._ranked_offers(goal))
            if len(ranked) > 1:
                ranked.sort(key=lambda pair: pair[0])
            found = self._offers[goal] = tuple(offer for _, offer in ranked)
        return found

    def candidates(self, goal: Goal) -> Iterator[StreamDescription]:
        """The streams that hold the first feature of a goal, of any object that may be meant."""
        features = self._serving(goal.asks[0].feature)
        if not any(map(self._space.holding, features)):
            return
        object = goal.subjects[0].object if goal.subjects else None
        seen: dict[str, None] = {}
        for feature in features:
            if object is None:
                seen |= dict.fromkeys(self._space.holding(feature))
            else:
                seen |= dict.fromkeys(self._space.holding_object(feature, None))
                seen |= dict.fromkeys(self._space.holding_object(feature, object))
        for name in seen:
            if name not in self._index.without and (not goal.streams or name in goal.streams):
                yield self._space.streams[name]

    def contents(
        self, stream: StreamDescription, ask: Ask, roles: Roles | None
    ) -> Iterator[Content]:
        """The contents that answer ``ask`` for ``roles`` (None: any): exact features first."""
        serving = self._serving(ask.feature)
        fitting = [
            content
            for content, unit in zip(stream.contents, stream.units, strict=True)
            if content.roles
            and (roles is None or content.roles == roles)
            and content.feature in serving
            and why_not_convertible(unit, ask.unit) == ""
        ]
        if len(fitting) > 1:
            fitting.sort(key=lambda content: content.feature != ask.feature)
        return iter(fitting)

    def _ranked_offers(self, goal: Goal) -> Iterator[tuple[tuple[object, ...], Offer]]:
        subjects = goal.subjects
        object = subjects[0].object if subjects else None
        for stream in self.candidates(goal):
            seen: set[Roles] = set()
            for first in self.contents(stream, goal.asks[0], None):
                roles = first.roles
                if roles in seen or not self._sorts.holds(roles, subjects):
                    continue
                others = [next(self.contents(stream, a, roles), None) for a in goal.asks[1:]]
                contents = (first, *(other for other in others if other is not None))
                if len(contents) < len(goal.asks):
                    continue
                seen.add(roles)
                inexact = sum(
                    c.feature != a.feature for c, a in zip(contents, goal.asks, strict=True)
                )
                rank = (
                    -self._favoured.get(stream.name, 0),
                    inexact,
                    object is None or roles[0].object != object,
                    self._generality(roles, subjects),
                    self._space.place(stream.name),
                    len(seen),
                )
                yield rank, Offer(stream, contents)

    def _generality(self, roles: Roles, subjects: Subjects) -> int:
        """How far the stream's sort is above the wanted one: a stream made for a sort comes before
        one for a more general sort."""
        sort = roles[0].sort
        above = self._index.vocabulary.supersorts((subjects[0].sort if subjects else None) or THING)
        if sort is None or sort not in above:
            return 0
        return len(above) - len(self._index.vocabulary.supersorts(sort))
