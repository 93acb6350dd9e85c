"""User-written units do what Def. 5.34 says, whatever the cuts; so do their failures."""

from itertools import zip_longest

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from process_running import Events, content, offer, stream, unit

from dyknow.streams.sample import Column, FieldType, SampleBatch
from dyknow.streams.single_sample import Sample


def running_mean(time, samples, state):
    """The mean of all values so far, where there is one."""
    total, count = state or (0.0, 0)
    value = samples[0]["v"]
    if value is None:
        return None, state
    return {"mean": (total + value) / (count + 1)}, (total + value, count + 1)


def running_mean_of_batches(tuples, state):
    """The same on columns."""
    total, count = state or (0.0, 0)
    column = tuples.column(0, "v")
    there = column.present
    values = column.values[there].astype(np.float64)
    if not len(values):
        return None, state
    sums = np.cumsum(np.concatenate(([total], values)))[1:]
    counts = count + 1 + np.arange(len(values))
    means = Column(FieldType.FLOAT, sums / counts)
    valid = tuples.times(0, "valid").values[there]
    batch = SampleBatch(tuples.available[there], valid, {"mean": means})
    return batch, (float(sums[-1]), int(counts[-1]))


VALUES = st.lists(st.none() | st.integers(-100, 100), max_size=30)
CUTS = st.lists(st.integers(1, 8), max_size=30)


def cut(rows, cuts):
    """``rows`` in parts; what is left over is the last one."""
    cuts = iter(cuts)
    while rows:
        size = next(cuts, len(rows))
        yield rows[:size]
        rows = rows[size:]


def outcome(code, parts, **rule):
    pos, events = stream(v="integer"), Events()
    made = unit(code, [pos], events=events, **rule)
    for part in parts:
        offer(pos, *part)
    pos.end()
    return content(made.output), made.output.watermark, made.counters, list(events), made.failure


@settings(deadline=None, max_examples=100)
@given(VALUES, CUTS, CUTS)
def test_batch_form_and_sample_form_are_equal_whatever_the_cuts(values, one, other):
    rows = [(2 * i, i // 2, value) for i, value in enumerate(values)]
    by_sample = outcome(running_mean, cut(rows, one))
    by_batch = outcome(running_mean_of_batches, cut(rows, other), batch=True)
    assert by_sample == by_batch


@settings(deadline=None, max_examples=100)
@given(
    st.lists(st.integers(0, 4), max_size=30),
    CUTS,
    CUTS,
    st.sampled_from(["skip", "restart", "stop"]),
    st.integers(0, 3),
)
def test_failures_do_not_depend_on_cuts(values, one, other, on_error, restarts):
    def fragile(time, samples, state):
        if samples[0].value == 0:
            raise ValueError("zero")
        return (state or 0) + 1, (state or 0) + 1

    rows = [(i, i, value) for i, value in enumerate(values)]
    rule = {"on_error": on_error, "restarts": restarts}
    first = outcome(fragile, cut(rows, one), **rule)
    second = outcome(fragile, cut(rows, other), **rule)
    # The watermark of a unit that stopped is where it stood then.
    assert (first[0], first[2:]) == (second[0], second[2:])


def pair(time, samples, state):
    """Says what it was called with, and how often it was."""
    count = (state or 0) + 1
    seen = [sample and (sample.available, sample.value) for sample in samples]
    return {"count": count, "seen": str(seen)}, count


def defined(function, inputs):
    """Def. 5.34 over Def. 5.11, word for word, for inputs of ``(available, valid, v)`` rows."""

    def last_avail(rows, time):
        known = [row for row in rows if row[0] <= time]
        if not known:
            return None
        available, valid, value = max(known)
        return Sample(valid, {"v": value}, available)

    made, state = [], None
    for time in sorted({row[0] for rows in inputs for row in rows}):
        samples = tuple(last_avail(rows, time) for rows in inputs)
        answer, state = function(time, samples, state)
        valid = max(sample.valid for sample in samples if sample)
        made.append((time, valid, *answer.values()))
    return made


@settings(deadline=None, max_examples=100)
@given(
    st.lists(st.tuples(st.sampled_from([(0,), (1,), (0, 1)]), st.integers(1, 3)), max_size=25),
    CUTS,
    CUTS,
    st.booleans(),
)
def test_a_unit_of_two_inputs_is_as_defined(steps, one, other, twice):
    rows, time = ([], []), 0
    for inputs, gap in steps:
        time += gap
        for input in inputs:
            rows[input].append((time, -gap, 10 * input + gap))
    a, b = stream("a", v="integer"), stream("b", v="integer")
    made = unit(pair, [a, b, a] if twice else [a, b])
    for for_a, for_b in zip_longest(cut(rows[0], one), cut(rows[1], other), fillvalue=()):
        offer(a, *for_a)
        offer(b, *for_b)
    a.end()
    b.end()
    inputs = [rows[0], rows[1], rows[0]] if twice else rows
    assert content(made.output) == defined(pair, inputs)
