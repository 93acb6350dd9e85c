"""What outlives a collection is not looked at again before everything is."""

from __future__ import annotations

import gc
import math
from collections.abc import Iterator
from weakref import ref

import pytest

from dyknow.service.runtime.gc_policy import FEW, LEAST, LONGEST, SHARE, CollectionSchedule


class Thing:
    """Refers to itself."""

    def __init__(self) -> None:
        self.itself = self


class Policy(CollectionSchedule):
    """One whose clock is moved by hand."""

    def __init__(self, slow: float = 0.0) -> None:
        self.now = 0.0
        super().__init__(lambda: self.now, slow)

    def looks_after(self, seconds: float) -> bool:
        """Whether everything is looked at then."""
        kept = Thing()
        gone = ref(kept)
        gc.collect()
        del kept
        gc.collect()
        assert gone() is not None
        self.now += seconds
        self.review()
        return gone() is None


@pytest.fixture
def policy() -> Iterator[Policy]:
    # An automatic collection in between would freeze objects of other tests.
    gc.disable()
    found = Policy()
    found.begin()
    try:
        yield found
    finally:
        found.end()
        gc.enable()


def test_what_outlives_a_collection_is_left_alone(policy: Policy) -> None:
    kept = [Thing() for _ in range(1000)]

    def count() -> int:
        return sum(isinstance(one, Thing) for one in gc.get_objects())

    gc.collect(1)
    assert count() == len(kept)
    gc.collect()
    assert count() == 0


@pytest.mark.long
def test_everything_is_looked_at_more_and_more_rarely(policy: Policy) -> None:
    gc.collect()
    assert not policy.looks_after(LEAST - 1)
    assert policy.looks_after(1)
    assert not policy.looks_after(2 * LEAST - 1)
    assert policy.looks_after(1)
    for _ in range(math.ceil(math.log2(LONGEST / LEAST))):
        policy.now += LONGEST
        policy.review()
    assert not policy.looks_after(LONGEST - 1)
    assert policy.looks_after(1)


def test_and_sooner_again_where_much_is_found(policy: Policy) -> None:
    assert policy.looks_after(LEAST)
    things = [Thing() for _ in range(FEW + 1)]
    gc.collect()
    things.clear()
    policy.now += 2 * LEAST
    policy.review()
    assert policy.looks_after(LEAST)


def test_a_thousand_times_as_long_as_it_takes(policy: Policy) -> None:
    def slowly(phase: str, info: object) -> None:
        if phase == "start":
            policy.now += 0.2

    gc.callbacks.append(slowly)
    try:
        gc.collect()
        gc.callbacks.remove(slowly)
        assert not policy.looks_after(SHARE * 0.2 - 1)
        assert policy.looks_after(1)
    finally:
        if slowly in gc.callbacks:
            gc.callbacks.remove(slowly)


def test_as_long_as_collections_are_quick_nothing_is_left_alone() -> None:
    policy = Policy(slow=0.001)
    policy.begin()
    try:
        gc.freeze()  # as at the end of a start
        before = gc.get_freeze_count()
        kept = Thing()
        gone = ref(kept)
        gc.collect()
        assert gc.get_freeze_count() <= before
        del kept
        gc.collect()
        assert gone() is None
        policy.now += LONGEST
        policy.review()
        assert gc.get_freeze_count() > 0, "there was no need to look at what the start has left"
    finally:
        policy.end()


def test_at_its_end_all_is_as_it_was() -> None:
    policy = Policy()
    policy.begin()
    gc.collect()
    policy.end()
    assert gc.get_freeze_count() == 0
    gc.collect()
    assert gc.get_freeze_count() == 0
