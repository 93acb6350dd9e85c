"""State synchronization: scenarios by hand (SPEC §1), the guard, and bounded memory."""

import numpy as np
import pytest

from dyknow.streams.most_recent import most_recent_rows
from dyknow.streams.policies.policy import (
    AnyChange,
    Approximation,
    Constraint,
    Duration,
    PolicyError,
    SampleEvery,
    SynchronizationPolicy,
)
from dyknow.streams.sample import Column, FieldType, SampleBatch, concatenate
from dyknow.streams.synchronization.synchronization import Synchronization
from dyknow.streams.synchronization.tuple_definition import TupleInput, prove_states
from dyknow.streams.time import TIME_MIN

RECENT = Approximation.MOST_RECENT


def make(*samples):
    times = np.array(samples, np.int64).reshape(-1, 2)
    return SampleBatch(times[:, 0], times[:, 1], {})


def shown(batches):
    """(L, t, valid time of each value or None)."""
    return [
        (a, t, tuple(None if k is None else int(b.inputs[i].valid[k]) for i, k in enumerate(rows)))
        for b in batches
        for a, t, rows in b.tuples()
    ]


def test_a_grid_of_monotone_inputs_leaves_when_all_have_passed_it():
    policy = SynchronizationPolicy(SampleEvery(10), 100, Duration(0, 20), approximation=RECENT)
    sync = Synchronization(policy, [True, True])
    assert sync.push(0, make((1, 0), (12, 11), (25, 24))) == []
    assert shown(sync.push(1, make((2, 0), (22, 21)))) == [(2, 0, (0, 0))]
    assert shown(sync.advance(1, 23)) == [(22, 10, (0, 0))]
    assert sync.known == 22
    assert shown(sync.push(1, make((25, 25)))) == []
    assert shown([*sync.advance(0, 26), *sync.advance(1, 26)]) == [(25, 20, (11, 0))]
    assert sync.counters.complete == sync.counters.states


def test_a_missing_input_is_unknown_at_the_deadline_without_approximation():
    sync = Synchronization(SynchronizationPolicy(AnyChange(), 5), [False, False])
    sync.push(0, make((10, 10)))
    assert sync.advance(1, 15) == []
    assert sync.advance(0, 16) == []
    assert shown(sync.advance(1, 16)) == [(15, 10, (10, None))]
    assert (sync.counters.unknown, sync.counters.complete) == (1, 0)


def test_a_value_is_chosen_when_the_state_leaves():
    policy = SynchronizationPolicy(AnyChange(), 5, approximation=RECENT)
    sync = Synchronization(policy, [False, False])
    sync.push(0, make((10, 10)))
    sync.push(1, make((11, 3), (14, 9)))
    sync.advance(1, 15)
    # The sample valid at 3 is too late to make a state; the one valid at 9 makes one just in time,
    # and is there when the state for 10, which began before, leaves.
    assert shown(sync.advance(0, 100)) == [(14, 9, (None, 9))]
    assert shown(sync.advance(1, 100)) == [(15, 10, (10, 9))]
    assert sync.counters.late == 1


def test_what_comes_after_its_state_left_is_told():
    told = []
    policy = SynchronizationPolicy(SampleEvery(10), 5, Duration(0, 100))
    sync = Synchronization(policy, [False], told.append)
    states = [*sync.push(0, make((0, 0), (3, 0), (17, 10))), *sync.advance(0, 18)]
    assert shown(states) == [(0, 0, (0,)), (15, 10, (None,))]
    assert [(one.constraint, one.at.tolist()) for one in told] == [
        (Constraint.AVAILABLE, [3]),
        (Constraint.DELAY, [17]),
    ]
    assert sync.counters.late == 2


def test_waiting_for_ever_is_counted_at_the_end():
    sync = Synchronization(SynchronizationPolicy(SampleEvery(10), None), [False, False])
    sync.push(0, make((0, 0), (10, 10)))
    sync.end(1)
    sync.end(0)
    counters = sync.counters
    assert (counters.states + counters.incomplete, counters.pending) == (2, 0)


@pytest.mark.parametrize("approximation", Approximation)
def test_an_input_may_bring_its_first_sample_after_others_have_gone_on(approximation):
    policy = SynchronizationPolicy(AnyChange(), None, approximation=approximation)
    sync = Synchronization(policy, [False, False])
    number = {"k": Column(FieldType.INTEGER, np.array([7]))}
    one = SampleBatch(np.array([3]), np.array([3]), number)
    sync.advance(0, 9)
    sync.push(1, one)
    sync.advance(1, 9)
    late = SampleBatch(np.array([9]), np.array([3]), number)
    assert shown([*sync.push(0, late), *sync.end(0), *sync.end(1)]) == [(9, 3, (3, 3))]


def test_a_state_may_leave_at_the_least_time_there_is():
    """What comes the moment after it is late."""
    sync = Synchronization(SynchronizationPolicy(AnyChange(), 3), [False, False])
    sync.push(0, make((TIME_MIN, TIME_MIN + 9), (TIME_MIN + 1, TIME_MIN + 8)))
    states = [*sync.end(0), *sync.end(1)]  # both samples in one run
    assert shown(states) == [(TIME_MIN, TIME_MIN + 9, (TIME_MIN + 9, None))]
    assert sync.counters.late == 1


def test_a_grid_does_not_begin_before_what_is_known():
    """Without `from` the first state is one that the first sample came in time for."""
    for delay, states in ((0, [(20, 20, (None,))]), (5, []), (None, [])):
        sync = Synchronization(SynchronizationPolicy(SampleEvery(2), delay), [False])
        sync.advance(0, 20)
        assert sync.known == 19
        assert shown([*sync.push(0, make((20, 3))), *sync.advance(0, 21)]) == states
    sync = Synchronization(SynchronizationPolicy(SampleEvery(2), 5), [False])
    assert shown([*sync.push(0, make((20, 3))), *sync.advance(0, 23)]) == [(21, 16, (None,))]


def test_a_grid_begins_with_the_earliest_sample_of_the_first_instant():
    sync = Synchronization(SynchronizationPolicy(SampleEvery(1), None), [False])
    states = [*sync.push(0, make((0, 0), (0, -1))), *sync.end(0)]
    assert shown(states) == [(0, -1, (-1,)), (1, 0, (0,))]


def test_a_very_old_first_sample_makes_no_flood_of_states():
    policy = SynchronizationPolicy(SampleEvery(1), 5, approximation=RECENT)
    now = 10**18
    sync = Synchronization(policy, [True], limit=1000)
    sync.push(0, make((now, 3)))
    assert shown(sync.advance(0, now + 1)) == [(now, now - 5, (3,))]


def test_too_many_states_at_once_are_refused():
    policy = SynchronizationPolicy(SampleEvery(1), 0, Duration(0))
    with pytest.raises(PolicyError, match="more than 1000") as caught:
        Synchronization(policy, [True], limit=1000).push(0, make((10**18, 10**18)))
    assert "from" in caught.value.hint


def test_chunks_are_small():
    policy = SynchronizationPolicy(SampleEvery(1), 0, Duration(0))
    batches = Synchronization(policy, [True]).push(0, make((0, 0), (150_000, 150_000)))
    assert [len(b) for b in batches] == [65_536, 65_536, 150_000 - 2 * 65_536]


@pytest.mark.parametrize("change", [SampleEvery(50), AnyChange()])
@pytest.mark.parametrize("monotone", [True, False])
def test_memory_does_not_grow_with_history(change, monotone):
    policy = SynchronizationPolicy(change, 100, approximation=RECENT)
    sync = Synchronization(policy, [monotone, monotone])
    most = 0
    for k in range(300):
        for i in range(2):
            sync.push(i, make(*[(k * 50 + j * 10 + 7, k * 50 + j * 10) for j in range(5)]))
            most = max(most, sync.retained)
    assert most < 60
    assert sync.counters.states > 250


def test_most_recent_rows_by_hand():
    available = np.array([1, 3, 4, 6], np.int64)
    valid = np.array([5, 2, 5, 4], np.int64)
    points, known = np.array([1, 2, 4, 5, 5], np.int64), np.array([9, 9, 9, 9, 9], np.int64)
    assert most_recent_rows(available, valid, points, known).tolist() == [-1, 1, 3, 2, 2]
    known = np.array([0, 1, 5, 6, 7], np.int64)
    assert most_recent_rows(available, valid, points, known).tolist() == [-1, -1, 1, 2, 2]
    none = np.empty(0, np.int64)
    assert most_recent_rows(none, none, points, known).tolist() == [-1] * 5


@pytest.mark.parametrize("approximation", Approximation)
@pytest.mark.parametrize("delay", [3, 40])
def test_long_monotone_streams_have_the_states_of_the_definition(approximation, delay):
    """Streams with gaps, repeated times and late samples, in two cuts."""
    random = np.random.default_rng(5)
    policy = SynchronizationPolicy(
        AnyChange(), delay, Duration(100, 3_000), approximation=approximation
    )
    inputs = []
    for _ in range(3):
        available = np.cumsum(random.choice([1, 2, 5, 60], 400, p=[0.5, 0.3, 0.15, 0.05]))
        valid = np.maximum.accumulate(available - random.integers(0, 9, 400))
        number = Column(FieldType.INTEGER, np.arange(400))
        inputs.append(SampleBatch(available, valid, {"k": number}))
    results = []
    for size in (50, 1):
        told = []
        sync = Synchronization(policy, [True] * 3, told.append)
        made = []
        for start in range(0, 400, size):
            for i, batch in enumerate(inputs):
                made += sync.push(i, batch.take(slice(start, start + size)))
        for i in (1, 0, 2):
            made += sync.end(i)
        late = sorted((one.input, one.constraint, at) for one in told for at in one.at.tolist())
        results.append((shown(made), late, sync.counters))
    assert results[0] == results[1]
    assert results[0][2].states > 300
    assert results[0][2].late > 10 or delay != 3
    names = [["a"], ["b"], ["c"]]
    states = concatenate([one.flatten(names, False) for one in made])
    last = max(batch.available[-1] for batch in inputs)
    known = [
        TupleInput(batch, own, True, None if batch.available[-1] == last else at + 1)
        for batch, own in zip(inputs, names, strict=True)
        for at in [int(batch.available[-1])]
    ]
    assert prove_states(states, known, policy) is None
