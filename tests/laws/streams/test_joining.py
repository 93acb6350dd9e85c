"""join and state synchronization against their definitions, however inputs are cut and mixed."""

from dataclasses import replace
from itertools import pairwise

import joint_definition as definition
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from dyknow.streams.jit import JIT
from dyknow.streams.joins.join import Join
from dyknow.streams.policies.policy import (
    AnyChange,
    AnyUpdate,
    Approximation,
    Duration,
    Order,
    PolicyError,
    SampleEvery,
    SynchronizationPolicy,
)
from dyknow.streams.sample import (
    Column,
    Field,
    FieldType,
    SampleBatch,
    Schema,
    batch_from_rows,
)
from dyknow.streams.synchronization import states as state_making
from dyknow.streams.synchronization.synchronization import Synchronization
from dyknow.streams.synchronization.tuple_definition import (
    TupleInput,
    prove_join,
    prove_states,
)

LIMITS = settings(deadline=None, max_examples=150)
LEAST, GREATEST = -(2**63), 2**63 - 1
SMALL = st.integers(-3, 16)
EDGES = st.integers(LEAST, LEAST + 9) | st.integers(GREATEST - 9, GREATEST) | st.integers(-3, 3)


def batch_of(samples):
    """Samples (t_a, t_v, number)."""
    available, valid, number = np.array(samples, np.int64).reshape(-1, 3).T.copy()
    return SampleBatch(available, valid, {"k": Column(FieldType.INTEGER, number)})


@st.composite
def streams(draw, times=SMALL, monotone=False, most=8):
    available = sorted(draw(st.lists(times, max_size=most)))
    valid = [draw(times) for _ in available]
    return list(zip(available, sorted(valid) if monotone else valid, strict=True))


@st.composite
def feedings(draw, inputs, last=None):
    """One way to tell ``inputs``: [(input, "push" | "advance" | "end", what)], ends included.

    ``last[i]`` is a watermark told before input i ends, or None.
    """
    queues = []
    for i, stream in enumerate(inputs):
        cuts = draw(st.lists(st.integers(0, len(stream)), max_size=4))
        bounds = sorted({0, len(stream), *cuts})
        numbered = [(a, v, k) for k, (a, v) in enumerate(stream)]
        told = []
        for low, high in pairwise(bounds):
            if draw(st.booleans()):
                floor = stream[low - 1][0] if low else LEAST
                told.append(("advance", draw(st.integers(floor, stream[low][0]))))
            told.append(("push", numbered[low:high]))
        if last is not None and last[i] is not None:
            told.append(("advance", last[i]))
        queues.append([*told, ("end", None)])
    steps = []
    while any(queues):
        i = draw(st.sampled_from([k for k, queue in enumerate(queues) if queue]))
        steps.append((i, *queues[i].pop(0)))
    return steps


def tell(process, step):
    i, what, content = step
    match what:
        case "push":
            return process.push(i, batch_of(content))
        case "advance":
            return process.advance(i, content)
        case _:
            return process.end(i)


def named(batches, streams):
    """Tuples with each sample named by its place in its stream."""
    result = []
    for batch in batches:
        places = []
        for i, one in enumerate(batch.inputs):
            places.append(one.columns["k"].values.tolist() if one.columns else [])
            for k, a, v in zip(places[i], one.available.tolist(), one.valid.tolist(), strict=True):
                assert streams[i][k] == (a, v)
        for available, valid, rows in batch.tuples():
            chosen = tuple(None if k is None else places[i][k] for i, k in enumerate(rows))
            result.append((available, valid, chosen))
    return result


@LIMITS
@given(st.data())
def test_join_is_the_definition_however_it_is_fed(data):
    times = data.draw(st.sampled_from([SMALL, EDGES]))
    inputs = data.draw(st.lists(streams(times), min_size=1, max_size=3))
    expected = definition.join(inputs)
    join = Join(len(inputs))
    given_so_far = []
    for step in data.draw(feedings(inputs)):
        batch = tell(join, step)
        if batch is not None:
            assert len(batch)
            given_so_far += named([batch], inputs)
        known = join.known
        if known is None:
            assert given_so_far == []
        else:
            assert given_so_far == [row for row in expected if row[0] <= known]
    assert given_so_far == expected


@st.composite
def synchronizations(draw, times, reach):
    """(streams, monotone, policy, arguments of the twin but the promised times)."""
    order = draw(st.sampled_from(Order))
    monotone = draw(st.lists(st.booleans(), min_size=1, max_size=3))
    inputs = [draw(streams(times, each and draw(st.integers(0, 4)) > 0)) for each in monotone]
    change = draw(st.sampled_from([AnyChange(), AnyUpdate()]) | st.builds(SampleEvery, reach))
    delay = draw(st.none() | st.integers(0, 9) | st.just(GREATEST))
    bounds = st.none() | times
    duration = Duration(draw(bounds), draw(bounds))
    approximation = draw(st.sampled_from(Approximation))
    policy = SynchronizationPolicy(change, delay, duration, order, approximation)
    exact = approximation is Approximation.NONE
    strict = [each or order is not Order.ANY for each in monotone]
    twin = (strict, policy.period, delay, duration.start, duration.end, exact)
    return inputs, monotone, policy, twin


def check_synchronization(data, inputs, monotone, policy, twin, watermarks):
    told = []
    last = [
        data.draw(st.none() | watermarks.map(lambda w, s=s: max(w, s[-1][0] if s else LEAST)))
        for s in inputs
    ]
    process = Synchronization(policy, monotone, told.append, limit=5000)
    steps = data.draw(feedings(inputs, last))
    promised = [LEAST - 1] * len(inputs)
    for i, what, content in steps:
        if what != "end":
            reached = content - 1 if what == "advance" else content[-1][0]
            promised[i] = max(promised[i], reached)
    try:
        given_so_far, knowns = [], []
        for step in steps:
            batches = tell(process, step)
            given_so_far += named(batches, inputs)
            knowns.append((process.known, len(given_so_far)))
    except PolicyError:
        return
    states, late, incomplete = definition.synchronize(inputs, promised, *twin)
    assert given_so_far == states
    for known, count in knowns:
        expected = [] if known is None else [s for s in states if s[0] <= known]
        assert count == len(expected)
    rows = [
        (a, one.input, k, one.constraint.value)
        for one in told
        for a, k in zip(one.at.tolist(), one.batch.columns["k"].values.tolist(), strict=True)
    ]
    assert set(rows) == late
    assert len(rows) == len(late)
    assert [row[:2] for row in rows] == sorted(row[:2] for row in rows)
    assert process.counters.incomplete == incomplete
    assert process.counters.states == len(states)


@LIMITS
@given(st.data())
def test_synchronization_is_the_definition(data):
    case = data.draw(synchronizations(SMALL, st.integers(1, 5)))
    check_synchronization(data, *case, SMALL)


@pytest.fixture(params=["compiled", "plain"])
def loop(request, monkeypatch):
    """The compiled loop or plain Python finds the late states, however few there are."""
    if request.param == "compiled" and not JIT:
        pytest.skip("loops are not compiled: DYKNOW_JIT=off or NUMBA_DISABLE_JIT")
    monkeypatch.setattr(state_making, "COMPILED", 1 if request.param == "compiled" else 10**9)


ANY_ORDER = settings(LIMITS, suppress_health_check=[HealthCheck.function_scoped_fixture])


@ANY_ORDER
@given(st.data(), st.booleans())
def test_the_compiled_loop_is_the_definition(loop, data, is_at_the_end):
    far = st.integers(LEAST, LEAST + 9) | st.integers(GREATEST - 9, GREATEST)
    times = far if is_at_the_end else SMALL
    inputs, monotone, policy, twin = data.draw(synchronizations(times, st.just(1)))
    delay = 3 if policy.max_delay is None else policy.max_delay  # without one no state is too late
    policy = replace(policy, change=AnyChange(), order=Order.ANY, max_delay=delay)
    twin = (monotone, None, delay, *twin[3:])
    if is_at_the_end:  # near one of the two ends
        inputs = [[(a, v) for a, v in stream if (a > 0) == (v > 0)] for stream in inputs]
    check_synchronization(data, inputs, monotone, policy, twin, times)


def shaped(shape, random, count):
    """Two inputs of ``count`` samples: (available, valid) of each."""
    steps = np.arange(count)
    first, second = steps * 10, steps * 10 + 5
    match shape:
        case "mixed":
            valid = [first + random.integers(-40, 40, count), second]
            return [(first, valid[0]), (second, valid[1] + random.integers(-3, 1, count) * 5)]
        case "offline":  # the second was cut off, and delivers when the first has ended
            return [(first, first), (second + 10 * count, first + random.integers(0, 2, count))]
        case "ahead":  # one clock is far ahead
            return [(first, np.append(10 * count, first[1:])), (second, second)]
        case _:
            raise AssertionError(shape)


@LIMITS
@given(st.data())
def test_synchronization_at_the_ends_of_time(data):
    near = data.draw(
        st.sampled_from([st.integers(LEAST, LEAST + 9), st.integers(GREATEST - 9, GREATEST)])
    )
    case = data.draw(synchronizations(near, st.integers(1, 5) | st.integers(2**62, GREATEST)))
    check_synchronization(data, *case, near)


def flat(tuples, streams):
    """Tuples as a stream of their own: of each input the place of its sample."""
    schema = Schema(tuple(Field(f"x{i}", FieldType.INTEGER) for i in range(len(streams))))
    rows = [(a, v, {f"x{i}": k for i, k in enumerate(chosen)}) for a, v, chosen in tuples]
    return batch_from_rows(schema, rows)


def numbered(stream):
    schema = Schema((Field("x", FieldType.INTEGER),))
    return batch_from_rows(schema, [(a, v, {"x": k}) for k, (a, v) in enumerate(stream)])


@pytest.mark.parametrize("delay", [None, 20, 10**6])
@pytest.mark.parametrize("shape", ["mixed", "offline", "ahead"])
@pytest.mark.parametrize("monotone", [False, True])
def test_many_samples_at_once_give_the_states_of_few(shape, delay, monotone):
    """Long streams, with some hundred samples that are late, in three cuts and by their proof."""
    policy = SynchronizationPolicy(AnyChange(), delay, approximation=Approximation.MOST_RECENT)
    streams = [
        list(zip(a.tolist(), v.tolist(), strict=True))
        for a, v in shaped(shape, np.random.default_rng(5), 4000)
    ]
    inputs = [numbered(stream) for stream in streams]

    def states(size):
        told = []
        process = Synchronization(policy, [monotone] * 2, told.append)
        made = []
        for start in range(0, 4000, size):
            for i, samples in enumerate(inputs):
                made += process.push(i, samples.take(slice(start, start + size)))
        for i in range(2):
            made += process.end(i)
        late = [
            (one.input, one.constraint, at)
            for one in told
            for at in one.batch.columns["x"].values.tolist()
        ]
        places = [
            (
                a,
                v,
                tuple(
                    None if k is None else int(b.inputs[i].columns["x"].values[k])
                    for i, k in enumerate(rows)
                ),
            )
            for b in made
            for a, v, rows in b.tuples()
        ]
        return places, sorted(late), process.counters

    found = states(4000)
    assert found == states(100) == states(3)
    ends = [stream[-1][0] for stream in streams]
    known = [
        TupleInput(samples, [f"x{i}"], monotone, None if ends[i] == max(ends) else ends[i] + 1)
        for i, samples in enumerate(inputs)
    ]
    assert prove_states(flat(found[0], inputs), known, policy) is None


@LIMITS
@given(st.data(), st.sampled_from(["not", "less", "value", "moment"]))
def test_what_proves_tuples_agrees_with_the_definition(data, how):
    """On what the definition gives, and on what was spoilt afterwards."""
    is_join = data.draw(st.booleans())
    if is_join:
        inputs = data.draw(st.lists(streams(), min_size=1, max_size=3))
        tuples, policy = definition.join(inputs), None
        known = [TupleInput(numbered(s), [f"x{i}"]) for i, s in enumerate(inputs)]
    else:
        inputs, _, policy, twin = data.draw(synchronizations(SMALL, st.integers(1, 5)))
        promised = [s[-1][0] if s else -4 for s in inputs]
        tuples, _, _ = definition.synchronize(inputs, promised, *twin)
        last = max(promised)
        known = [
            TupleInput(numbered(s), [f"x{i}"], twin[0][i], None if p == last else p + 1)
            for i, (s, p) in enumerate(zip(inputs, promised, strict=True))
        ]
    spoilt = list(tuples)
    # The end of a grid that no duration ends depends on the last news; what proves asks for less.
    rows = len(tuples) - (policy is not None and policy.period is not None)
    if how != "not" and rows > 0:
        row = data.draw(st.integers(0, rows - 1))
        available, valid, chosen = spoilt[row]
        match how:
            case "less":
                del spoilt[row]
            case "value":
                spoilt[row] = (available, valid, (*chosen[:-1], 77))
            case "moment":
                spoilt[row] = (available - 1, valid, chosen)
    made = flat(spoilt, inputs)
    found = prove_join(made, known) if is_join else prove_states(made, known, policy)
    assert (found is None) == (spoilt == tuples), found
