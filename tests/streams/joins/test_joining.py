"""join: Example 5.4 with the paper's numbers, and what an online join must get right."""

import numpy as np
import pytest

from dyknow.streams.joins.join import Join, OneByOne
from dyknow.streams.sample import Field, FieldType, Schema, batch_from_rows
from dyknow.streams.string_pool import StringPool

SCHEMA = Schema((Field("v", FieldType.STRING),))
LEAST, GREATEST = -(2**63), 2**63 - 1


POOLS = {"v": StringPool()}


def make(*samples):
    return batch_from_rows(SCHEMA, [(a, v, {"v": value}) for a, v, value in samples], POOLS)


def push(join, input, *samples):
    """Samples, after which the next instant begins: so their tuples are decided."""
    assert join.push(input, make(*samples)) is None or len(samples) > 1
    return join.advance(input, samples[-1][0] + 1)


def shown(batch):
    """Tuples as (t_a, t_v, ((t_a, t_v, value) or None of each input))."""
    if batch is None:
        return []
    lists = [list(one.rows()) for one in batch.inputs]
    result = []
    for available, valid, rows in batch.tuples():
        samples = [None if k is None else lists[i][k] for i, k in enumerate(rows)]
        values = tuple(None if s is None else (s[0], s[1], s[2]["v"]) for s in samples)
        result.append((available, valid, values))
    return result


F1 = [(1, 1, "v1"), (3, 2, "v2"), (4, 5, "v3")]
F2 = [(2, 1, "v4"), (4, 1, "v5"), (5, 1, "v6")]
EXAMPLE_5_4 = [
    (1, 1, ((1, 1, "v1"), None)),
    (2, 2, ((1, 1, "v1"), (2, 1, "v4"))),
    (3, 3, ((3, 2, "v2"), (2, 1, "v4"))),
    (4, 4, ((4, 5, "v3"), (4, 1, "v5"))),
    (5, 5, ((4, 5, "v3"), (5, 1, "v6"))),
]


def test_example_5_4():
    join = Join(2)
    assert join.push(0, make(*F1)) is None
    assert join.known is None
    assert shown(join.push(1, make(*F2))) == EXAMPLE_5_4[:3]
    assert join.known == 3  # more may come at 4
    assert shown(join.end(0)) == EXAMPLE_5_4[3:4]
    assert join.known == 4
    assert shown(join.end(1)) == EXAMPLE_5_4[4:]
    assert join.known == GREATEST


def test_a_tuple_is_given_as_soon_as_all_inputs_are_known():
    join = Join(2)
    join.push(0, make((10, 0, "a")))
    assert shown(join.advance(1, 10)) == []
    assert join.known == 9
    assert shown(join.advance(1, 11)) == []
    assert shown(join.advance(0, 11)) == [(10, 10, ((10, 0, "a"), None))]


def test_equal_times_make_one_tuple():
    join = Join(2)
    push(join, 0, (1, 0, "a"))
    assert shown(push(join, 1, (1, 7, "b"))) == [(1, 1, ((1, 0, "a"), (1, 7, "b")))]


def test_an_instant_makes_one_tuple_of_the_last_samples():
    join = Join(2)
    push(join, 0, (1, 0, "a"), (1, 0, "b"))
    assert join.push(1, make((1, 7, "c"))) is None
    assert join.push(1, make((1, 6, "d"))) is None
    assert shown(join.advance(1, 2)) == [(1, 1, ((1, 0, "b"), (1, 6, "d")))]


def test_a_single_input_is_taken_sample_by_sample():
    join = OneByOne()
    one, other = (1, 1, ((1, 0, "a"),)), (1, 1, ((1, 0, "b"),))
    assert shown(join.push(0, make((1, 0, "a"), (1, 0, "b")))) == [one, other]
    assert shown(join.push(0, make((1, 0, "a")))) == [one]
    join.end(0)
    with pytest.raises(ValueError, match="do not decrease"):
        join.push(0, make((1, 0, "c")))


def test_an_input_that_never_began_holds_back_the_others():
    join = Join(3)
    assert join.push(0, make((1, 0, "a"))) is None
    assert join.end(1) is None
    assert join.retained == 1
    join.advance(0, 2)
    assert shown(join.end(2)) == [(1, 1, ((1, 0, "a"), None, None))]
    assert join.retained == 1


def test_a_push_after_the_end_continues_the_input():
    join = Join(2)
    join.push(0, make((1, 0, "a")))
    join.end(1)
    assert shown(push(join, 0, (5, 0, "b"), (6, 0, "c")))
    with pytest.raises(ValueError, match="available times of an input do not decrease"):
        join.push(1, make((6, 0, "x")))
    join.push(1, make((8, 0, "y")))
    assert join.known == 6
    assert shown(push(join, 0, (7, 0, "d"))) == [(7, 7, ((7, 0, "d"), None))]
    assert shown(join.end(0)) == []
    assert shown(join.end(1)) == [(8, 8, ((7, 0, "d"), (8, 0, "y")))]


def test_the_ends_of_time():
    join = Join(2)
    assert join.advance(1, LEAST) is None
    assert join.push(0, make((LEAST, 3, "a"), (GREATEST, -3, "b"))) is None
    assert join.known == LEAST - 1
    assert [row[0] for row in shown(join.end(1))] == [LEAST]
    assert [row[0] for row in shown(join.end(0))] == [GREATEST]


def test_a_join_has_an_input():
    with pytest.raises(ValueError, match="at least one"):
        Join(0)


def test_memory_does_not_grow_with_history():
    join = Join(3)
    random = np.random.default_rng(3)
    most = 0
    for round in range(200):
        for i in random.permutation(3).tolist():
            at = [(round * 10 + k, 0, "x") for k in range(10)]
            push(join, i, *at)
            most = max(most, join.retained)
    assert most <= 23
    assert all(len(last) == 1 and last.available.base is None for last in join._last)


def test_one_input_far_ahead_is_not_copied_at_every_step():
    join = Join(2)
    many = 200_000
    times = np.arange(many, dtype=np.int64)
    batch = make((0, 0, "x")).take(np.zeros(many, np.int64))
    join.push(0, batch.with_available(times))
    for t in range(50):
        assert len(push(join, 1, (t, 0, "y"))) == 1
    assert join.retained == many - 50 + 2
    assert join._inputs[0]._waiting[0].available.base is not None  # a view, no copy


def test_the_first_batch_is_not_kept_for_its_fields():
    join = Join(2)
    join.push(0, make((1, 0, "x"), (2, 0, "y")))
    like = join._inputs[0].empty()
    assert list(like.columns) == ["v"]
    assert like.available.base is None
    assert like.columns["v"].values.base is None
