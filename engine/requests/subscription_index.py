"""The adaptive subscriptions that run, found by what concerns them: the streams that they read, the
transformations that they use, the features that they want."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator
from typing import TypeAlias

from ...streams.generator import StreamGenerator
from ..configuration.configuration import Configuration
from ..units.base import ComputationalUnit
from .adaptive_subscription import AdaptiveSubscription, behind, transformations_of

_Index: TypeAlias = dict[str, dict[str, None]]
"""Ids of subscriptions, in order, by a name that concerns them."""


class SubscriptionIndex:
    """What `Rematching` looks up when something changes. Each look-up costs what it finds; it gives
    the subscriptions as they are when it is made, so that they may change meanwhile."""

    def __init__(self) -> None:
        self._subscriptions: dict[str, AdaptiveSubscription] = {}
        self._by_output: dict[str, AdaptiveSubscription] = {}
        self._readers: _Index = {}
        self._users: _Index = {}
        self._wanting: _Index = {}
        self._avoiders: _Index = {}
        self._candidates: _Index = {}
        """Whose `AdaptiveSubscription.young` a stream or transformation is among."""

    def add(self, found: AdaptiveSubscription) -> None:
        """A subscription that reads nothing yet."""
        self._subscriptions[found.id] = found
        self._by_output[found.output.name] = found
        _put(self._wanting, found.wish.want.feature, found.id)

    def remove(self, id: str) -> AdaptiveSubscription:
        """Forget a subscription."""
        found = self._subscriptions.pop(id)
        self._by_output.pop(found.output.name, None)
        self.forget_reads(found)
        _drop(self._avoiders, found.avoided, id)
        _drop(self._candidates, found.young, id)
        _drop(self._wanting, (found.wish.want.feature,), id)
        return found

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
        """Those that read a stream, themselves or through the units of their plans."""
        return self._of(self._readers, stream)

    def users(self, transformation: str) -> tuple[AdaptiveSubscription, ...]:
        """Those whose plan has a unit of a transformation."""
        return self._of(self._users, transformation)

    def wanted(self) -> Iterator[tuple[str, tuple[AdaptiveSubscription, ...]]]:
        """Each feature that is wanted, and by whom."""
        for feature in tuple(self._wanting):
            yield feature, self._of(self._wanting, feature)

    def _of(self, index: _Index, name: str) -> tuple[AdaptiveSubscription, ...]:
        return tuple(self._subscriptions[id] for id in index.get(name, ()))

    # -- what a plan reads

    def remember_reads(self, found: AdaptiveSubscription, configuration: Configuration) -> None:
        """What ``found`` reads now; it waits for none of that any more."""
        found.reads = frozenset(behind(found.unit, configuration))
        found.made_by = transformations_of(found.nodes)
        for name in found.reads:
            _put(self._readers, name, found.id)
        for name in found.made_by:
            _put(self._users, name, found.id)
        for name in found.reads | found.made_by:
            self.drop_young(found, name)

    def forget_reads(self, found: AdaptiveSubscription) -> None:
        """It reads nothing."""
        _drop(self._readers, found.reads, found.id)
        _drop(self._users, found.made_by, found.id)

    # -- what is avoided

    def avoid(self, found: AdaptiveSubscription, name: str) -> None:
        """``found`` uses a stream or transformation no more."""
        found.avoided.add(name)
        _put(self._avoiders, name, found.id)

    def forgive(self, found: AdaptiveSubscription, name: str) -> None:
        """It may use it again."""
        found.avoided.discard(name)
        _drop(self._avoiders, (name,), found.id)

    def admit(self, name: str) -> None:
        """Nobody avoids a stream or transformation any longer."""
        for id in self._avoiders.pop(name, ()):
            self._subscriptions[id].avoided.discard(name)

    # -- what may be better, when it has been there for a while

    def candidates(self, name: str) -> tuple[AdaptiveSubscription, ...]:
        """Those for whom a stream or transformation may be better."""
        return self._of(self._candidates, name)

    def add_young(self, found: AdaptiveSubscription, name: str, now: int) -> None:
        """It may be better for ``found``; it has been there since ``now`` (ns)."""
        found.young[name] = now
        _put(self._candidates, name, found.id)

    def drop_young(self, found: AdaptiveSubscription, name: str) -> None:
        """It is no longer waited for."""
        if found.young.pop(name, None) is not None:
            _drop(self._candidates, (name,), found.id)

    def drop_candidate(self, name: str) -> None:
        """What might have been better is gone: when it comes again that is anew."""
        for id in self._candidates.pop(name, ()):
            del self._subscriptions[id].young[name]


def others(
    stream: str, subscriptions: Iterable[AdaptiveSubscription], configuration: Configuration
) -> tuple[str, ...]:
    """The names of the readers of a stream that serve somebody else, too. Cost: O(units)."""
    merges = {found.unit for found in subscriptions}
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
        return unit in merges or (bool(own) and unit.users == len(own) and all(map(is_ours, own)))

    ours = {unit.name for unit in readers[configuration.streams[stream]] if is_ours(unit)}
    return tuple(name for name in unsure if name not in ours)


def _put(index: _Index, key: str, id: str) -> None:
    index.setdefault(key, {})[id] = None


def _drop(index: _Index, keys: Iterable[str], id: str) -> None:
    for key in keys:
        known = index.get(key)
        if known is not None:
            known.pop(id, None)
            if not known:
                del index[key]
