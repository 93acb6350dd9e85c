"""Features that lead to a feature through transformations."""

from __future__ import annotations

from ..ontology.vocabulary import Vocabulary
from .space import StreamSpace


class Reachability:
    """The features that lead to a feature, remembered until transformations or the vocabulary
    change (`forget`)."""

    def __init__(self, space: StreamSpace) -> None:
        self._space = space
        self._known: dict[str, frozenset[str]] = {}
        self._version = -1

    def forget(self) -> None:
        """Forget all: a transformation is new, or has other inputs."""
        self._known.clear()

    def of(self, feature: str, vocabulary: Vocabulary) -> frozenset[str]:
        """``feature``, its sub-features, and the features from which they can be made. Cost: linear
        in the transformations on the way the first time, then a look-up."""
        if vocabulary.version != self._version:
            self._version = vocabulary.version
            self._known.clear()
        found = self._known.get(feature)
        if found is None:
            found = self._known[feature] = frozenset(self._look(feature, vocabulary))
        return found

    def _look(self, feature: str, vocabulary: Vocabulary) -> set[str]:
        seen: set[str] = set()
        waiting = [feature]
        while waiting:
            for served in vocabulary.subfeatures(waiting.pop()):
                if served in seen:
                    continue
                seen.add(served)
                for name in self._space.giving(served):
                    inputs = self._space.transformations[name].inputs
                    waiting += [port.feature for port in inputs]
        return seen
