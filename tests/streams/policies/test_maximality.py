"""What may still be added where samples are equal ([DyKnow10 Def. 5.35, 5.36]), by hand."""

import pytest

from dyknow.streams.policies.policy import AnyChange, ChangeBy, Order, Policy
from dyknow.streams.policies.satisfaction import prove
from dyknow.streams.policies.select_adaptation import adapt
from dyknow.streams.sample import Field, FieldType, Schema, batch_from_rows
from dyknow.streams.string_pool import StringPool

POOL = StringPool()
SCHEMA = Schema((Field("value", FieldType.STRING),))
CHANGE = Policy(AnyChange())


def stream(*samples):
    rows = [(available, valid, {"value": value}) for available, valid, value in samples]
    return batch_from_rows(SCHEMA, rows, {"value": POOL})


def adapted(policy, *samples):
    adaptation = adapt(policy)
    batches = [*adaptation.push(stream(*samples)), *adaptation.end()]
    return [(ta, tv, values["value"]) for batch in batches for ta, tv, values in batch.rows()]


@pytest.mark.parametrize("change", [Policy().change, AnyChange()])
def test_an_equal_sample_at_the_last_moment_is_left_out_as_a_copy_only(change):
    """The sample that waited for the last moment stands for the first of the two; the instant has
    room for the other."""
    policy = Policy(change, 0, order=Order.MONOTONE)
    recorded = [(1, 6, "a"), (6, 6, "a")]
    count = 1 if isinstance(change, AnyChange) else 2
    assert adapted(policy, *recorded) == [(6, 6, "a")] * count
    assert prove(stream(*[(6, 6, "a")] * count), stream(*recorded), policy) is None
    found = prove(stream((6, 6, "a")), stream(*recorded), policy)
    assert (found is None) == isinstance(change, AnyChange)


def test_an_equal_sample_with_a_moment_left_may_not():
    policy = Policy(max_delay=1, order=Order.MONOTONE)
    recorded = stream((1, 6, "a"), (6, 6, "a"))
    assert prove(stream((6, 6, "a")), recorded, policy) is not None
    assert prove(stream((6, 6, "a"), (7, 6, "a")), recorded, policy) is None


@pytest.mark.parametrize("valid", [(8, 8, 8), (1, 2, 1)])
def test_there_and_back_are_two_changes(valid):
    first, other, last = zip((1, 2, 3), valid, "aba", strict=True)
    recorded = stream(first, other, last)
    assert prove(recorded, recorded, CHANGE) is None
    for spoilt in ((first, other), (other, last), (first,), (last,), (other,)):
        assert prove(stream(*spoilt), recorded, CHANGE) is not None, spoilt


def test_there_and_back_are_two_changes_by_d():
    """Which of two equal samples was left out must not matter."""
    rows = [(9, 19, 3.0), (15, 12, 1.0), (19, 19, 3.0)]
    schema, policy = Schema((Field("value", FieldType.FLOAT),)), Policy(ChangeBy(1))

    def batch(kept):
        return batch_from_rows(schema, [(a, v, {"value": x}) for a, v, x in kept], {})

    assert prove(batch(rows), batch(rows), policy) is None
    for row in range(3):
        assert prove(batch(rows[:row] + rows[row + 1 :]), batch(rows), policy) is not None, row


def test_a_delayed_copy_is_no_news():
    recorded = stream((1, 8, "a"), (2, 8, "a"), (3, 8, "b"))
    assert prove(stream((1, 8, "a"), (3, 8, "b")), recorded, CHANGE) is None
    assert prove(stream((2, 8, "a"), (3, 8, "b")), recorded, CHANGE) is None


def test_two_copies_may_need_each_other():
    """Neither b nor a can stand between a and b alone, but both can."""
    recorded = stream((1, 8, "a"), (2, 8, "b"), (3, 8, "a"), (4, 8, "b"))
    assert prove(stream((1, 8, "a"), (4, 8, "b")), recorded, CHANGE) is not None
    # Nothing is left for a second b, as the delayed one stands for the only one there was.
    recorded = stream((1, 8, "a"), (2, 8, "b"), (3, 8, "a"))
    assert prove(stream((1, 8, "a"), (4, 8, "b"), (5, 8, "a")), recorded, CHANGE) is None


def test_a_copy_that_came_while_its_like_waited_is_no_news():
    """b repeats b, though a free moment would be left between them."""
    policy = Policy(AnyChange(), 5, order=Order.MONOTONE)
    recorded = [(3, 2, "a"), (4, 2, "b"), (5, 2, "b"), (7, 2, "b"), (8, 4, "c")]
    sent = adapted(policy, *recorded)
    assert sent == [(7, 2, "a"), (7, 2, "b"), (9, 4, "c")]
    assert prove(stream(*sent), stream(*recorded), policy) is None
