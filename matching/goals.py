"""The transformation tree, unfolded on demand ([Introspection15 §4.3]).

Answers come in the order of trying: streams (`stream_offers`), transformations
(`transformation_ways`), then parts that are synchronized.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from collections.abc import Set as AbstractSet
from itertools import islice, product

from ..ontology.vocabulary import Vocabulary
from .feature_index import FeatureIndex, held_subject
from .goal import Answer, Apart, Goal, Through
from .space import StreamSpace
from .stream_offers import StreamOffers
from .subject import Subjects, unified
from .transformation_ways import TransformationWays

COMBINED = 512
"""Combinations of parts that are tried, at most, where several subjects are wanted at once."""


class Goals:
    """The answers to goals in one space. Valid as long as the space and the vocabulary stay.

    ``without`` names streams and transformations that are not to be used; ``favoured`` gives the
    number of wants that a stream serves: one that serves more comes first.
    """

    def __init__(
        self,
        space: StreamSpace,
        vocabulary: Vocabulary,
        *,
        without: AbstractSet[str] = frozenset(),
        favoured: Mapping[str, int] | None = None,
    ) -> None:
        self.index = FeatureIndex(space, vocabulary, without)
        self.streams = StreamOffers(self.index, favoured or {})
        self.offers = self.streams.of
        self._transformations = TransformationWays(self.index)
        self._ways: dict[Goal, tuple[Through | Apart, ...]] = {}

    def ways(self, goal: Goal) -> tuple[Through | Apart, ...]:
        """The transformations, then the parts, that give all that is asked for, in order."""
        found = self._ways.get(goal)
        if found is None:
            apart = () if len(goal.asks) == 1 else self._aparts(goal)
            found = self._ways[goal] = (*self._transformations.of(goal), *apart)
        return found

    def answers(self, goal: Goal) -> Iterator[Answer]:
        """Every answer, in order of trying; looked for only when it is asked for."""
        yield from self.offers(goal)
        yield from self._transformations.of(goal)
        if len(goal.asks) > 1:
            yield from self._aparts(goal)

    def parts(self, goal: Goal) -> tuple[Goal, ...]:
        """The same goal for some of its objects, where no stream gives all; in order of trying. Of
        a sort, one for each stream that tells of its objects and that no unit makes.
        Cost: one pass over all that leads to the feature, for each subject."""
        if self.index.sorts.is_sort(goal.asks[0].feature) and not goal.streams:
            return tuple(self._of_streams(goal))
        held = self.index.subjects(frozenset(ask.feature for ask in goal.asks))
        choices = []
        for wanted in goal.subjects:
            parts = (self.index.sorts.part(each, wanted) for each in held)
            choices.append(dict.fromkeys((wanted, *(part for part in parts if part is not None))))
        if len(choices) == 1:
            combined: dict[Subjects, None] = {(part,): None for part in choices[0]}
        else:
            combined = dict.fromkeys(map(unified, islice(product(*choices), COMBINED)))
        combined.pop(goal.subjects, None)
        return tuple(goal._replace(subjects=subjects) for subjects in combined)

    def _of_streams(self, goal: Goal) -> Iterator[Goal]:
        """A goal of a sort, stream by stream, for all wanted objects and for those of each of its
        contents. What a unit makes tells of the same events again."""
        (wanted,) = goal.subjects
        for name, stream in self.index.space.streams.items():
            if stream.maker:
                continue
            held = (content.roles[0] for content in stream.contents if content.roles)
            parts = (self.index.sorts.part(held_subject(role), wanted) for role in held)
            for part in dict.fromkeys((wanted, *(part for part in parts if part is not None))):
                yield goal._replace(subjects=(part,), streams=(name,))

    def _aparts(self, goal: Goal) -> Iterator[Apart]:
        """Asks that one stream serves together, as many as possible, and the others one by one;
        last all asks one by one."""
        everything = range(len(goal.asks))
        groups: dict[tuple[int, ...], None] = {}
        for first in everything if len(goal.asks) > 2 else ():
            for offer in self.offers(Goal((goal.asks[first],), goal.subjects)):
                stream, roles = offer.stream, offer.roles
                contents = (next(self.streams.contents(stream, a, roles), None) for a in goal.asks)
                held = tuple(i for i, content in enumerate(contents) if content is not None)
                if 1 < len(held) < len(goal.asks):
                    groups[held] = None
        for held in sorted(groups, key=len, reverse=True):
            yield self._apart(goal, (held, *((i,) for i in everything if i not in held)))
        yield self._apart(goal, tuple((i,) for i in everything))

    def _apart(self, goal: Goal, places: tuple[tuple[int, ...], ...]) -> Apart:
        needs = (Goal(tuple(goal.asks[i] for i in group), goal.subjects) for group in places)
        return Apart(tuple(needs), places)
