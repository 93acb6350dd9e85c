"""``sample every`` on samples that come out of turn: many at once are as many one by one."""

import numpy as np
import pytest

from dyknow.streams.policies.policy import Constraint, Policy, SampleEvery
from dyknow.streams.policies.select_adaptation import adapt
from dyknow.streams.sample import SampleBatch
from dyknow.streams.stream_rules import UNIQUE_TIMES, Rules


def run(policy, available, valid, size):
    """(sent, dropped, counters) when the samples come ``size`` at a time."""
    drops, sent = [], []

    def tell(told):
        columns = told.at, told.batch.available, told.batch.valid, told.reasons
        drops.extend(zip(*(column.tolist() for column in columns), strict=True))

    adaptation = adapt(policy, tell)
    for start in range(0, len(available), size):
        rows = slice(start, start + size)
        for batch in adaptation.push(SampleBatch(available[rows], valid[rows], {})):
            sent += zip(batch.available.tolist(), batch.valid.tolist(), strict=True)
    for batch in adaptation.end():
        sent += zip(batch.available.tolist(), batch.valid.tolist(), strict=True)
    return sent, drops, adaptation.counters


@pytest.mark.parametrize("delay", [None, 60, 5])
@pytest.mark.parametrize("lost", [None, 7_500])
def test_out_of_turn_at_once_or_one_by_one(delay, lost):
    random = np.random.default_rng(3)
    valid = np.arange(2_000) // 2 * 10  # each twice: the first that comes counts
    available = valid + random.integers(0, 50, 2_000)
    available[:2] = 0
    order, steps = np.argsort(available, kind="stable"), np.arange(2_000)
    available = np.maximum.accumulate(available[order] - steps) + steps
    valid = valid[order]
    available, valid = available[valid != lost], valid[valid != lost]
    whole = run(Policy(SampleEvery(10), delay), available, valid, 2_000)
    for size in (1, 7, 100):
        assert run(Policy(SampleEvery(10), delay), available, valid, size) == whole
    sent, _, counters = whole
    assert [time for _, time in sent] == list(range(0, 10 * len(sent), 10))
    assert all(np.diff([at for at, _ in sent]) >= 0)
    if delay == 5:
        assert len(sent) < 10
    else:
        assert len(sent) == (750 if lost else 1_000)
        assert counters.dropped[Constraint.ORDER] >= len(sent) - 50


def test_one_in_turn_is_sent_after_those_that_waited():
    """30 came before 40, but had to wait for 10 and is sent with it."""
    available, valid = np.array([0, 5, 6, 7, 8]), np.array([0, 20, 30, 10, 40])
    for size in (5, 1):
        sent, drops, _ = run(Policy(SampleEvery(10)), available, valid, size)
        assert sent == [(0, 0), (7, 10), (7, 20), (7, 30), (8, 40)]
        assert drops == []


@pytest.mark.parametrize("delay", [None, 20])
@pytest.mark.parametrize(
    "ending", [lambda adaptation: adaptation.advance(11), lambda adaptation: adaptation.end()]
)
def test_what_must_wait_for_its_available_time_is_not_given_before(delay, ending):
    """By unique times 6 follows 4, which came at 9, at 10: nobody sees it before 10 is known."""
    adaptation = adapt(Policy(SampleEvery(2), delay), rules=Rules(UNIQUE_TIMES))
    made = adaptation.push(SampleBatch(np.array([5, 6, 9]), np.array([2, 6, 4]), {}))
    assert [time for batch in made for time in batch.available.tolist()] == [5, 9]
    counters = adaptation.counters
    assert (counters.kept, counters.delayed, counters.pending) == (2, 0, 1)
    assert adaptation.advance(10) == []
    assert [time for batch in ending(adaptation) for time in batch.available.tolist()] == [10]
    assert (counters.kept, counters.delayed, counters.pending) == (3, 1, 0)


def test_those_that_wait_for_their_time_are_followed_by_the_next():
    adaptation = adapt(Policy(SampleEvery(1)), rules=Rules(UNIQUE_TIMES))
    adaptation.push(SampleBatch(np.array([0, 1, 2, 3]), np.array([0, 2, 3, 4]), {}))
    made = adaptation.push(SampleBatch(np.array([4]), np.array([1]), {}))
    made += adaptation.push(SampleBatch(np.array([6]), np.array([5]), {}))
    assert [time for batch in made for time in batch.available.tolist()] == [4, 5, 6]
    made = adaptation.advance(9)
    assert [time for batch in made for time in batch.available.tolist()] == [7, 8]
    assert adaptation.counters.delayed == 4
