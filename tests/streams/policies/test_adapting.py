"""Adapting at the edges: equal samples, ends of grids and of time; at once or one by one."""

import pytest

from dyknow.streams.policies.adaptation import REASONS
from dyknow.streams.policies.policy import (
    AnyChange,
    Approximation,
    Constraint,
    Duration,
    Order,
    Policy,
    SampleEvery,
)
from dyknow.streams.policies.select_adaptation import adapt
from dyknow.streams.sample import Field, FieldType, Schema, batch_from_rows
from dyknow.streams.time import TIME_MAX, TIME_MIN

SCHEMA = Schema((Field("value", FieldType.INTEGER),))
SIZES = pytest.mark.parametrize("size", [1, 2, 10])


def run(policy, samples, size):
    """(sent, dropped, counters) when the samples come ``size`` at a time."""
    drops, batches = [], []

    def tell(told):
        columns = told.at, told.batch.available, told.reasons
        for at, available, reason in zip(*(each.tolist() for each in columns), strict=True):
            drops.append((at, available, REASONS[reason]))

    adaptation = adapt(policy, tell)
    for start in range(0, len(samples), size):
        rows = [(a, v, {"value": x}) for a, v, x in samples[start : start + size]]
        batches += adaptation.push(batch_from_rows(SCHEMA, rows))
    batches += adaptation.end()
    sent = [(a, v, values["value"]) for batch in batches for a, v, values in batch.rows()]
    return sent, drops, adaptation.counters


@SIZES
def test_in_strict_order_an_equal_sample_replaces_too(size):
    policy = Policy(AnyChange(), 2, order=Order.STRICT)
    sent, drops, counters = run(policy, [(3, 4, 1), (4, 4, 1), (7, 5, 1)], size)
    assert sent == [(6, 4, 1), (7, 5, 1)]
    assert drops == [(4, 3, Constraint.ORDER)]
    assert counters.delayed == 1


@SIZES
def test_what_is_delayed_does_not_depend_on_batches(size):
    policy = Policy(AnyChange(), 2, order=Order.STRICT)
    sent, drops, counters = run(policy, [(1, 0, 2), (2, 1, 0), (3, 1, 0)], size)
    assert sent == [(2, 0, 2), (3, 1, 0)]
    assert drops == [(3, 2, Constraint.ORDER)]
    assert counters.delayed == 1


@SIZES
def test_after_the_end_of_a_grid_nothing_is_pending(size):
    """9 is after the duration, the third sample came after the last of the grid was made."""
    policy = Policy(SampleEvery(2), 1, Duration(0, 2), approximation=Approximation.MOST_RECENT)
    sent, drops, counters = run(policy, [(1, 1, 0), (5, 9, 1), (6, 2, 2)], size)
    assert sent == [(3, 2, 0)]
    assert drops == [(5, 5, Constraint.DURATION), (6, 6, Constraint.DURATION)]
    assert (counters.received, counters.kept, counters.pending) == (3, 1, 0)
    assert counters.dropped == {Constraint.DURATION: 2}


@SIZES
def test_a_duration_that_ends_before_it_begins_uses_nothing(size):
    policy = Policy(SampleEvery(2), 1, Duration(5, 2), approximation=Approximation.MOST_RECENT)
    sent, _, counters = run(policy, [(1, 1, 0), (5, 9, 1)], size)
    assert sent == []
    assert counters.dropped == {Constraint.DURATION: 2}


@SIZES
def test_a_grid_without_end_goes_to_the_end_of_time_for_what_lies_there(size):
    policy = Policy(
        SampleEvery(2),
        5,
        Duration(TIME_MAX - 20, to_oo=True),
        approximation=Approximation.MOST_RECENT,
    )
    sent, drops, counters = run(
        policy, [(TIME_MAX - 19, TIME_MAX - 20, 0), (TIME_MAX - 9, TIME_MAX - 2, 1)], size
    )
    assert [valid for _, valid, _ in sent] == list(range(TIME_MAX - 20, TIME_MAX - 4, 2))
    assert drops == [(TIME_MAX - 9, TIME_MAX - 9, Constraint.AVAILABLE)]
    assert counters.pending == 0


@SIZES
@pytest.mark.parametrize("delay", [None, 1, 50])
@pytest.mark.parametrize("order", Order)
def test_a_chain_at_the_ends_of_time(size, delay, order):
    policy = Policy(SampleEvery(2), delay, order=order)
    last = TIME_MAX
    near_the_end = [(last - 2, last - 5, 0), (last - 1, last - 1, 2), (last, last - 3, 0)]
    first = TIME_MIN
    at_the_start = [(first, first + 4, 0), (first + 1, first, 1), (first + 2, first + 6, 2)]
    for samples in (near_the_end, at_the_start):
        sent, drops, counters = run(policy, samples, size)
        assert len(sent) + len(drops) == 3
        assert (counters.pending, counters.sent) == (0, len(sent))
