"""An index of the running adaptive subscriptions by the streams that they read, the transformations
that they use, and the features that they want."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator
from typing import TypeAlias

from ...streams.generator import StreamGenerator
from ..configuration.configuration import Configuration
from ..units.base import ComputationalUnit
from .adaptive_subscription import AdaptiveSubscription, transformations_of, upstream_names

_Index: TypeAlias = dict[str, dict[str, None]]
"""Ids of subscriptions, in order, by the name of a stream, transformation or feature."""


class SubscriptionIndex:
    """The index that `Rematching` searches when something changes. A look-up costs O(results). It
    returns a copy, so the caller may change the index while it iterates."""

    def __init__(self) -> None:
        self._subscriptions: dict[str, AdaptiveSubscription] = {}
        self._by_output: dict[str, AdaptiveSubscription] = {}
        self._readers: _Index = {}
        self._users: _Index = {}
        self._wanting: _Index = {}
        self._avoiders: _Index = {}
        self._candidates: _Index = {}
        """By each stream or transformation, the subscriptions that have it in
        `AdaptiveSubscription.candidates`."""

    def add(self, subscription: AdaptiveSubscription) -> None:
        """Add a subscription without sources."""
        self._subscriptions[subscription.id] = subscription
        self._by_output[subscription.output.name] = subscription
        _put(self._wanting, subscription.wish.want.feature, subscription.id)

    def remove(self, id: str) -> AdaptiveSubscription:
        """Remove a subscription and return it."""
        subscription = self._subscriptions.pop(id)
        self._by_output.pop(subscription.output.name, None)
        self.drop_sources(subscription)
        _drop(self._avoiders, subscription.avoided, id)
        _drop(self._candidates, subscription.candidates, id)
        _drop(self._wanting, (subscription.wish.want.feature,), id)
        return subscription

    def get(self, id: str) -> AdaptiveSubscription | None:
        """A subscription by its id."""
        return self._subscriptions.get(id)

    def of_stream(self, name: str) -> AdaptiveSubscription | None:
        """The subscription whose stream this is."""
        return self._by_output.get(name)

    def all(self) -> tuple[AdaptiveSubscription, ...]:
        """All of them."""
        return tuple(self._subscriptions.values())

    def readers(self, stream: str) -> tuple[AdaptiveSubscription, ...]:
        """The subscriptions that read a stream, directly or through the units of their plans."""
        return self._of(self._readers, stream)

    def users(self, transformation: str) -> tuple[AdaptiveSubscription, ...]:
        """The subscriptions whose plans have a unit of a transformation."""
        return self._of(self._users, transformation)

    def wanted(self) -> Iterator[tuple[str, tuple[AdaptiveSubscription, ...]]]:
        """Yield each wanted feature with its subscriptions."""
        for feature in tuple(self._wanting):
            yield feature, self._of(self._wanting, feature)

    def _of(self, index: _Index, name: str) -> tuple[AdaptiveSubscription, ...]:
        return tuple(self._subscriptions[id] for id in index.get(name, ()))

    # -- sources

    def index_sources(
        self, subscription: AdaptiveSubscription, configuration: Configuration
    ) -> None:
        """Index the sources that ``subscription`` reads now; they are no candidates any more."""
        subscription.reads = frozenset(upstream_names(subscription.unit, configuration))
        subscription.transformations = transformations_of(subscription.nodes)
        for name in subscription.reads:
            _put(self._readers, name, subscription.id)
        for name in subscription.transformations:
            _put(self._users, name, subscription.id)
        for name in subscription.reads | subscription.transformations:
            self.drop_candidate_of(subscription, name)

    def drop_sources(self, subscription: AdaptiveSubscription) -> None:
        """Remove the sources of ``subscription`` from the index."""
        _drop(self._readers, subscription.reads, subscription.id)
        _drop(self._users, subscription.transformations, subscription.id)

    # -- avoided streams and transformations

    def avoid(self, subscription: AdaptiveSubscription, name: str) -> None:
        """Let ``subscription`` avoid a stream or transformation."""
        subscription.avoided.add(name)
        _put(self._avoiders, name, subscription.id)

    def stop_avoiding(self, subscription: AdaptiveSubscription, name: str) -> None:
        """Let ``subscription`` use it again."""
        subscription.avoided.discard(name)
        _drop(self._avoiders, (name,), subscription.id)

    def stop_avoiding_all(self, name: str) -> None:
        """Let all subscriptions use a stream or transformation again."""
        for id in self._avoiders.pop(name, ()):
            self._subscriptions[id].avoided.discard(name)

    # -- candidates for a better plan

    def candidates(self, name: str) -> tuple[AdaptiveSubscription, ...]:
        """The subscriptions for which a stream or transformation is a candidate."""
        return self._of(self._candidates, name)

    def add_candidate(self, subscription: AdaptiveSubscription, name: str, now: int) -> None:
        """Add a candidate for ``subscription`` that exists since ``now`` (ns)."""
        subscription.candidates[name] = now
        _put(self._candidates, name, subscription.id)

    def drop_candidate_of(self, subscription: AdaptiveSubscription, name: str) -> None:
        """Remove a candidate of ``subscription``."""
        if subscription.candidates.pop(name, None) is not None:
            _drop(self._candidates, (name,), subscription.id)

    def drop_candidate(self, name: str) -> None:
        """Remove a candidate of all subscriptions; if it comes again its hold-off starts again."""
        for id in self._candidates.pop(name, ()):
            del self._subscriptions[id].candidates[name]


def other_readers(
    stream: str, subscriptions: Iterable[AdaptiveSubscription], configuration: Configuration
) -> tuple[str, ...]:
    """Return the names of a stream's readers that do not serve ``subscriptions`` only. Cost:
    O(units)."""
    merges = {subscription.unit for subscription in subscriptions}
    names = {unit.name for unit in merges}
    unsure = tuple(n for n in configuration.readers_of(stream) if n not in names)
    if not unsure:
        return ()
    readers: dict[StreamGenerator, list[ComputationalUnit]] = defaultdict(list)
    for unit in configuration.units.values():
        for source in unit.inputs:
            readers[source].append(unit)

    def is_ours(unit: ComputationalUnit) -> bool:
        own = readers.get(unit.output, [])
        # Users that are no readers, such as requests, need the unit for themselves.
        return unit in merges or (bool(own) and unit.users == len(own) and all(map(is_ours, own)))

    ours = {unit.name for unit in readers[configuration.streams[stream]] if is_ours(unit)}
    return tuple(name for name in unsure if name not in ours)


def _put(index: _Index, key: str, id: str) -> None:
    index.setdefault(key, {})[id] = None


def _drop(index: _Index, keys: Iterable[str], id: str) -> None:
    for key in keys:
        ids = index.get(key)
        if ids is not None:
            ids.pop(id, None)
            if not ids:
                del index[key]
