"""Policies with the paper's numbers ([DyKnow10 Examples 5.6, 5.9-5.11, Def. 5.26])."""

import pytest

from dyknow.streams.policies.policy import (
    Approximation,
    ChangeBy,
    Constraint,
    Duration,
    Policy,
    PolicyError,
    SampleEvery,
)
from dyknow.streams.policies.satisfaction import (
    extend,
    is_substream,
    prove,
    satisfies,
)
from dyknow.streams.policies.select_adaptation import adapt
from dyknow.streams.sample import (
    Field,
    FieldType,
    SampleBatch,
    Schema,
    batch_from_rows,
)
from dyknow.streams.string_pool import StringPool
from dyknow.streams.time import TIME_MAX, TIME_MIN

POOL = StringPool()
SCHEMA = Schema((Field("value", FieldType.STRING),))


def stream(*samples: tuple[int, int, str]) -> SampleBatch:
    rows = [(available, valid, {"value": value}) for available, valid, value in samples]
    return batch_from_rows(SCHEMA, rows, {"value": POOL})


def rows(*batches: SampleBatch) -> list[tuple[int, int, object]]:
    return [(ta, tv, values["value"]) for batch in batches for ta, tv, values in batch.rows()]


F1 = stream((250, 200, "p1"), (325, 300, "p2"), (430, 400, "p3"), (505, 500, "p4"))
"""Example 5.6: what pos is for car1."""
F5 = stream((345, 300, "p2"), (460, 400, "p3"))
"""Example 5.6: speed_car1."""


def test_example_5_9_a_delayed_part_is_a_substream() -> None:
    assert is_substream(F5, F1) is None
    assert is_substream(F1, F5) is not None
    assert prove(F5, F1, Policy(duration=Duration(300, 400))) is None


def test_example_5_10_every_100_holds_and_a_delay_of_40_does_not() -> None:
    assert satisfies(F1, Policy(SampleEvery(100))) is None
    found = satisfies(F1, Policy(max_delay=40))
    assert found is not None
    assert (found.constraint, found.row) == (Constraint.DELAY, 0)


def test_example_5_11_every_200_has_this_stream_among_others() -> None:
    policy = Policy(SampleEvery(200))
    assert prove(stream((280, 200, "p1"), (480, 400, "p3")), F1, policy) is None
    adaptation = adapt(policy)
    made = adaptation.push(F1) + adaptation.end()
    assert rows(*made) == [(250, 200, "p1"), (430, 400, "p3")]
    assert prove(made[0], F1, policy) is None
    assert prove(stream((280, 200, "p1")), F1, policy) is not None, "p3 could be added"


def test_extend_makes_a_grid_of_the_most_recent_samples() -> None:
    policy = Policy(
        SampleEvery(50), 30, Duration(150, 350), approximation=Approximation.MOST_RECENT
    )
    # p1 is available at 250, so the first sample that knows it is the one for 250 (at 280).
    expected = [(280, 250, "p1"), (330, 300, "p2"), (380, 350, "p2")]
    assert rows(extend(F1, policy)) == expected
    adaptation = adapt(policy)
    assert rows(*adaptation.push(F1), *adaptation.end()) == expected
    assert adaptation.counters.approximated == 2


def test_most_recent_needs_a_complete_policy() -> None:
    with pytest.raises(PolicyError, match=r"sample every.*from a to b.*max delay"):
        Policy(approximation=Approximation.MOST_RECENT)


def test_a_grid_that_is_far_too_long_is_refused() -> None:
    policy = Policy(SampleEvery(1), 0, Duration(0, 10**12), approximation=Approximation.MOST_RECENT)
    adaptation = adapt(policy, limit=1_000)
    adaptation.push(stream((1, 1, "p1")))
    with pytest.raises(PolicyError, match="samples at once"):
        adaptation.push(stream((5_000, 5_000, "p2")))


def test_what_proves_refuses_a_grid_that_is_far_too_long() -> None:
    policy = Policy(SampleEvery(1), 5, Duration(0, 10**15), approximation=Approximation.MOST_RECENT)
    with pytest.raises(PolicyError, match="more than 10000000") as caught:
        extend(F1, policy)
    assert "longer period" in caught.value.hint
    with pytest.raises(PolicyError, match="grid"):
        prove(stream(), F1, policy)


def test_a_grid_over_all_of_time_has_its_points() -> None:
    policy = Policy(
        SampleEvery(2**62),
        0,
        Duration(TIME_MIN, TIME_MAX),
        approximation=Approximation.MOST_RECENT,
    )
    recorded = stream((TIME_MIN, TIME_MIN, "p1"), (1, 0, "p2"))
    expected = [
        (-(2**63), -(2**63), "p1"),
        (-(2**62), -(2**62), "p1"),
        (0, 0, "p1"),
        (2**62, 2**62, "p2"),
    ]
    assert rows(extend(recorded, policy)) == expected
    assert prove(stream(*expected), recorded, policy) is None
    assert prove(stream(*expected[:-1]), recorded, policy) is not None
    assert prove(stream(*expected[:-1], (2**62, 2**62, "p1")), recorded, policy) is not None


def test_an_estimate_is_sent_when_it_has_changed_by_ten_metres() -> None:
    """[DyKnow10 §4.3.1]; a number that comes or goes has changed, and text never does."""
    schema = Schema((Field("at", FieldType.FLOAT), Field("lane", FieldType.STRING)))
    places = [(0.0, "a"), (9.9, "b"), (10.0, "b"), (19.0, "b"), (0.5, "b"), (None, "b"), (0.5, "b")]
    estimates = batch_from_rows(
        schema, [(t, t, {"at": at, "lane": lane}) for t, (at, lane) in enumerate(places)]
    )
    policy = Policy(ChangeBy(10))
    adaptation = adapt(policy)
    (made,) = adaptation.push(estimates) + adaptation.end()
    assert made.available.tolist() == [0, 2, 5, 6]
    assert adaptation.counters.dropped == {Constraint.CHANGE_BY: 3}
    assert prove(made, estimates, policy) is None
    found = satisfies(estimates, policy)
    assert found is not None
    assert (found.constraint, found.row) == (Constraint.CHANGE_BY, 1)
    assert prove(made.take(slice(0, 3)), estimates, policy) is not None
