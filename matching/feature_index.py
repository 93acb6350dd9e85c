"""An index of a stream space by feature: sub-features, transformations, subjects."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from collections.abc import Set as AbstractSet
from typing import TypeAlias

from ..languages.ssl.annotation import Role
from ..ontology.vocabulary import THING, Vocabulary
from .space import Ask, StreamSpace, TransformationDescription
from .subject import Sorts, Subject

_Features: TypeAlias = tuple[str, ...]


class FeatureIndex:
    """Look-ups in one space by feature, each computed once. Valid as long as the space and the
    vocabulary stay. ``without`` names streams and transformations that are not to be used.
    """

    def __init__(
        self,
        space: StreamSpace,
        vocabulary: Vocabulary,
        without: AbstractSet[str] = frozenset(),
    ) -> None:
        self.space = space
        self.vocabulary = vocabulary
        self.sorts = Sorts(vocabulary)
        self.without = without
        self._serving: dict[str, _Features] = {}
        self._holders: dict[str, frozenset[str]] = {}
        self._known: dict[frozenset[str], tuple[Subject, ...]] = {}

    def serving(self, feature: str) -> _Features:
        """``feature``, then its sub-features by name; of a sort, all features of streams."""
        found = self._serving.get(feature)
        if found is None and self.sorts.is_sort(feature):
            found = self._serving[feature] = self.space.features
        if found is None:
            below = sorted(self.vocabulary.subfeatures(feature) - {feature})
            found = self._serving[feature] = (feature, *below)
        return found

    def producers(self, ask: Ask) -> Iterator[TransformationDescription]:
        """The transformations whose output is the feature or a sub-feature of it, in order."""
        if self.sorts.is_sort(ask.feature):
            return
        space = self.space
        for feature in self.serving(ask.feature):
            for name in space.giving(feature):
                if name not in self.without:
                    yield space.transformations[name]

    def may_be_held_together(self, asks: tuple[Ask, ...]) -> bool:
        """Whether there may be a stream that holds two of the features, or a unit whose output is
        both."""
        first, *others = asks
        seen = self._where(first.feature)
        for ask in others:
            names = self._where(ask.feature)
            if not seen.isdisjoint(names):
                return True
            seen = seen | names
        return False

    def _where(self, feature: str) -> frozenset[str]:
        """The feature and its sub-features, and the streams that hold them."""
        found = self._holders.get(feature)
        if found is None:
            serving = self.serving(feature)
            streams = (name for served in serving for name in self.space.holding(served))
            found = self._holders[feature] = frozenset((*serving, *streams))
        return found

    def subjects(self, features: frozenset[str]) -> tuple[Subject, ...]:
        """The subjects of all streams and sources that can lead to ``features``: each once, in the
        order of discovery."""
        found = self._known.get(features)
        if found is None:
            found = self._known[features] = tuple(self._look(features))
        return found

    def _look(self, features: frozenset[str]) -> Iterable[Subject]:
        space = self.space
        found: dict[Subject, None] = {}
        waiting, seen = sorted(features), set(features)
        for feature in waiting:
            for served in self.serving(feature):
                for name in space.holding(served):
                    if name in self.without:
                        continue
                    for content in space.streams[name].contents:
                        if content.feature == served:
                            found |= dict.fromkeys(map(held_subject, content.roles))
            for unit in self.producers(Ask(feature, None)):
                for argument in unit.arguments:
                    if argument.object is not None:
                        found[Subject(None, self.sorts.canonical(argument.object))] = None
                    else:
                        found[Subject(argument.sort or THING, None)] = None
                for port in unit.inputs:
                    if port.feature not in seen:
                        seen.add(port.feature)
                        waiting.append(port.feature)
        return found


def held_subject(role: Role) -> Subject:
    """Whose feature a stream with this role holds."""
    return Subject(role.sort or THING, None) if role.object is None else Subject(None, role.object)
