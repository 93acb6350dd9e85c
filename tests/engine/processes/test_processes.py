"""User-written computational units (Def. 5.10, 5.34), their registry, and their failures."""

import asyncio
import re
import signal
import threading

import numpy as np
import pytest
from process_running import Events, content, offer, stream, unit

from dyknow.engine.model.views import Since
from dyknow.streams.sample import Column, FieldType, SampleBatch
from dyknow.streams.single_sample import Sample
from dyknow.streams.time import TIME_MAX, TIME_MIN

# -- what a unit computes ----------------------------------------------------------------------


def speed_est(time, samples, state):
    """Example 5.5's SpeedEst: difference quotient of the last two positions."""
    (pos,) = samples
    if state is None:
        return None, pos
    return (pos.value - state.value) / (pos.valid - state.valid), pos


def test_example_5_6_speed_est():
    """pos sampled every 200 gives valid 200 and 400; speed is the one sample <510,400,s3>."""
    pos = stream(value="float")
    made = unit(speed_est, [pos])
    offer(pos, (280, 200, 1000.0), (510, 400, 1600.0))
    assert content(made.output) == [(510, 400, 3.0)]
    assert made.output.schema.names == ("value",)
    assert made.output.watermark == 510


def test_state_and_no_sample():
    """A function may store and say nothing: it gives the sum of every third sample."""

    def third(time, samples, state):
        kept = [*(state or []), samples[0]["v"]]
        return (sum(kept), None) if len(kept) == 3 else (None, kept)

    pos = stream(v="integer")
    made = unit(third, [pos])
    offer(pos, *[(t, 10 * t, t) for t in range(1, 8)])
    assert content(made.output) == [(3, 30, 6), (6, 60, 15)]


def test_two_inputs_with_one_available_time_are_one_tuple():
    seen = []

    def both(time, samples, state):
        seen.append((time, [s and (s.available, s.valid, s.value) for s in samples]))
        return None, None

    a, b = stream("a", v="integer"), stream("b", w="string")
    unit(both, [a, b])
    offer(a, (1, 1, 10), (3, 3, 30))
    offer(b, (2, 0, "x"), (3, 5, "y"))
    b.end()
    a.end()
    assert seen == [
        (1, [(1, 1, 10), None]),
        (2, [(1, 1, 10), (2, 0, "x")]),
        (3, [(3, 3, 30), (3, 5, "y")]),
    ]


def test_the_same_stream_twice():
    pos = stream(value="float")
    made = unit(lambda t, s, state: (s[0].value - s[1].value, None), [pos, pos])
    assert pos.subscribers == 1
    offer(pos, (1, 1, 5.0), (2, 2, 6.0))
    pos.end()
    assert content(made.output) == [(1, 1, 0.0), (2, 2, 0.0)]
    assert made.output.is_ended


def test_the_output_ends_with_the_last_input_and_goes_on_without_the_first():
    a, b = stream("a", v="integer"), stream("b", v="integer")
    made = unit(lambda t, s, state: (sum(x.value for x in s if x), None), [a, b])
    offer(a, (1, 1, 1))
    a.end()
    offer(b, (2, 2, 2))
    assert not made.output.is_ended
    assert made.output.watermark == 2
    b.end()
    assert made.output.is_ended
    assert content(made.output) == [(1, 1, 1), (2, 2, 3)]


def test_it_may_begin_with_the_past():
    a, b = stream("a", v="integer"), stream("b", v="integer")
    offer(a, (1, 1, 1), (4, 4, 4))
    offer(b, (2, 2, 2))
    made = unit(lambda t, s, state: (sum(x.value for x in s if x), None), [a, b], since=Since.START)
    assert content(made.output) == [(1, 1, 1)]  # more may come at 2
    offer(b, (5, 5, 5))
    assert content(made.output) == [(1, 1, 1), (2, 2, 3)]
    a.advance(5)
    assert content(made.output)[2:] == [(4, 4, 6)]
    made.stop()
    assert (a.subscribers, b.subscribers, made.output.is_ended) == (0, 0, True)


def test_valid_time_is_the_greatest_of_the_present_inputs():
    a, b = stream("a", v="integer"), stream("b", v="integer")
    made = unit(lambda t, s, state: (t, None), [a, b])
    offer(a, (1, 50, 1))
    offer(b, (2, 7, 1))
    a.end()
    b.end()
    assert content(made.output) == [(1, 50, 1), (2, 50, 2)]


def test_what_a_unit_may_give():
    answers = iter(
        [
            {"x": 1.5, "name": "a"},
            Sample(-5, {"x": 2, "name": None}),
            Sample(3, {"name": "b", "x": np.float32(0.5)}, 40),
            None,
        ]
    )
    pos = stream(v="integer")
    made = unit(lambda t, s, state: (next(answers), None), [pos])
    offer(pos, *[(t, t, 0) for t in (1, 2, 3, 4)])
    pos.end()
    assert content(made.output) == [(1, 1, 1.5, "a"), (2, -5, 2.0, None), (40, 3, 0.5, "b")]
    types = [field.type for field in made.output.schema.fields]
    assert types == [FieldType.FLOAT, FieldType.STRING]


@pytest.mark.parametrize(
    ("value", "kind"),
    [(True, "boolean"), (np.True_, "boolean"), (1, "integer"), (1.0, "float"), ("a", "string")],
)
def test_an_open_output_takes_its_type_from_the_first_sample(value, kind):
    pos = stream(v="integer")
    made = unit(lambda t, s, state: (value, None), [pos])
    offer(pos, (1, 1, 0))
    assert [f.type for f in made.output.schema.fields] == [FieldType(kind)]
    assert content(made.output) == [(1, 1, value)]


def test_an_open_output_is_fixed_by_its_first_sample():
    answers = iter([1, 1.5, {"value": 2}, {"other": 3}, {"value": 4, "more": 5}])
    pos, events = stream(v="integer"), Events()
    made = unit(lambda t, s, state: (next(answers), None), [pos], events=events, on_error="skip")
    offer(pos, *[(t, t, 0) for t in range(1, 6)])
    assert content(made.output) == [(1, 1, 1), (3, 3, 2)]
    assert "field 'value' is an integer, got 1.5" in events[0][1]
    assert "field 'value' is missing" in events[1][1]
    assert "no field 'more'" in events[2][1]


@pytest.mark.parametrize(
    ("answer", "problem"),
    [
        (float("nan"), "field 'x' must be finite"),
        (float("inf"), "field 'x' must be finite"),
        (10**400, "field 'x' must be finite"),
        ("fast", "field 'x' is a float, got 'fast'"),
        (True, "field 'x' is a float"),
        ([1.0], "field 'x' is a float"),
        ({"y": 1.0}, "field 'x' is missing"),
        ({"x": 1.0, "y": 1.0}, "no field 'y'"),
        ({1: 1.0, "x": 1.0}, "no field 1"),
        (Sample(1, 5.0), "values of a sample must be a mapping"),
        (Sample(1.5, {"x": 1.0}), "valid time must be an integer in ns, not float"),
        (Sample(2**63, {"x": 1.0}), "outside signed 64-bit"),
        (Sample(1, {"x": 1.0}, 9), "made at 10 cannot have been available at 9"),
        (Sample(1, {"x": 1.0}, "now"), "available time must be an integer"),
    ],
)
def test_what_a_unit_must_not_give(answer, problem):
    pos, events = stream(v="integer"), Events()
    output = stream("out", x="float")
    made = unit(lambda t, s, state: (answer, None), [pos], output, events, on_error="skip")
    offer(pos, (10, 10, 0))
    assert content(output) == []
    assert made.counters.errors == 1
    assert made.counters.last_error_time == 10
    assert problem in made.counters.last_error
    assert problem in events[0][1]


@pytest.mark.parametrize("answer", [None, 1.0, (1.0,), (1, 2, 3), [1.0, None]])
def test_a_unit_gives_a_pair(answer):
    pos = stream(v="integer")
    made = unit(lambda t, s, state: answer, [pos], on_error="skip")
    offer(pos, (1, 1, 0))
    assert "returns a pair (sample, new state)" in made.counters.last_error


def test_an_open_output_wants_values_of_known_types():
    answers = iter([{}, {"x": None}, {"": 1}, {"x": object()}, "\ud800", b"a"])
    pos = stream(v="integer")
    made = unit(lambda t, s, state: (next(answers), None), [pos], on_error="skip")
    offer(pos, *[(t, t, 0) for t in range(1, 7)])
    assert made.counters.errors == 6
    assert made.output.is_open


def test_samples_out_of_order_within_the_lateness():
    """Made available later than their tuple, they are brought in order, or counted as late."""

    def ahead(time, samples, state):
        return Sample(time, {"x": time}, time + samples[0].value), None

    rows = [(10, 10, 25), (20, 20, 0), (30, 30, 0), (100, 100, 0)]
    results = []
    for lateness in (0, 50):
        pos, output = stream(v="integer"), stream("out", lateness, x="integer")
        unit(ahead, [pos], output)
        offer(pos, *rows)
        pos.end()
        results.append(([a for a, _, _ in content(output)], output.counters.late))
    assert results == [([35, 100], 2), ([20, 30, 35, 100], 0)]


def test_times_at_the_ends_of_64_bits():
    pos = stream(v="integer")
    made = unit(lambda t, s, state: (t, None), [pos])
    offer(pos, (TIME_MIN, TIME_MAX, 0), (TIME_MAX, TIME_MIN, 0))
    assert content(made.output) == [(TIME_MIN, TIME_MAX, TIME_MIN), (TIME_MAX, TIME_MIN, TIME_MAX)]
    assert made.output.watermark == TIME_MAX


def test_what_a_user_does_to_a_sample_is_seen_nowhere_else():
    def spoil(time, samples, state):
        before = samples[0].value
        samples[0].values["v"] = -1
        return before, None

    a, b = stream("a", v="integer"), stream("b", v="integer")
    made = unit(spoil, [a, b])
    offer(a, (1, 1, 7))
    offer(b, (2, 2, 0), (3, 3, 0))
    a.end()
    b.end()
    assert [row[2] for row in content(made.output)] == [7, 7, 7]


def test_a_class_has_its_own_state_for_each_process():
    class Count:
        def __init__(self):
            self.count = 0

        def __call__(self, time, samples, state):
            self.count += 1
            return self.count, None

    pos = stream(v="integer")
    first = unit(Count, [pos])
    offer(pos, (1, 1, 0))
    second = unit(Count, [pos])
    offer(pos, (2, 2, 0))
    assert content(first.output) == [(1, 1, 1), (2, 2, 2)]
    assert content(second.output) == [(2, 2, 1)]


# -- failures ----------------------------------------------------------------------------------


def failing(*times):
    """Counts in its state; raises at ``times``."""

    def count(time, samples, state):
        if time in times:
            raise RuntimeError(f"not at {time}")
        return (state or 0) + 1, (state or 0) + 1

    return count


def run(rows=range(1, 8), fails=(), **rule):
    pos, events = stream(v="integer"), Events()
    made = unit(failing(*fails), [pos], events=events, **rule)
    offer(pos, *[(t, t, 0) for t in rows])
    return made, events


def test_skip_keeps_the_state():
    made, events = run(fails=(3, 4), on_error="skip")
    assert content(made.output) == [(1, 1, 1), (2, 2, 2), (5, 5, 3), (6, 6, 4), (7, 7, 5)]
    assert made.failure is None
    assert made.counters.errors == 2
    assert events.kinds == ["unit failed", "unit failed"]
    assert re.search(
        r"error 1: RuntimeError: not at 3 \(test_processes.py:\d+\); the sample is skipped",
        events[0][1],
    )


def test_restart_forgets_the_state():
    made, events = run(fails=(3,), on_error="restart")
    assert [row[2] for row in content(made.output)] == [1, 2, 1, 2, 3, 4]
    assert events.kinds == ["unit failed", "unit restarted"]
    assert (made.counters.errors, made.counters.restarts) == (1, 1)


def test_restart_makes_a_new_instance_and_its_constructor_may_fail():
    made = []

    class Fragile:
        def __init__(self):
            made.append(self)
            if len(made) == 2:
                raise OSError("no camera")

        def __call__(self, time, samples, state):
            if time == 2:
                raise ValueError
            return len(made), None

    pos, events = stream(v="integer"), Events()
    running = unit(Fragile, [pos], events=events)
    offer(pos, *[(t, t, 0) for t in range(1, 6)])
    assert content(running.output) == [(1, 1, 1), (4, 4, 3), (5, 5, 3)]
    assert running.counters.restarts == 2
    assert "OSError: no camera" in running.counters.last_error


def test_too_many_restarts_in_a_row_stop():
    made, events = run(fails=(2, 3, 5, 6, 7), rows=range(1, 10), restarts=2)
    assert [row[0] for row in content(made.output)] == [1, 4]
    assert events.kinds[-2:] == ["unit failed", "unit stopped by rule"]
    assert events.kinds.count("unit restarted") == 4
    assert "3 failures in a row, 2 restarts are allowed" in made.failure
    assert made.output.is_ended
    assert made.inputs[0].subscribers == 0


def test_stop_stops_at_the_first_error_and_others_go_on():
    pos, events = stream(v="integer"), Events()
    bad = unit(failing(2), [pos], events=events, on_error="stop")
    good = unit(failing(), [pos])
    after = unit(lambda t, s, state: (len([x for x in s if x]), None), [bad.output, pos])
    offer(pos, (1, 1, 0), (2, 2, 0))
    offer(pos, (3, 3, 0))
    pos.advance(4)
    assert [row[0] for row in content(bad.output)] == [1]
    assert [row[0] for row in content(good.output)] == [1, 2, 3]
    assert [row[0] for row in content(after.output)] == [1, 2, 3]  # it does not wait for the dead
    assert events.kinds == ["unit failed", "unit stopped by rule"]
    assert "on_error is stop" in bad.failure


def test_a_flood_of_errors_is_counted_whole_and_told_thinly():
    made, events = run(rows=range(1, 1001), fails=range(1001), on_error="skip")
    assert made.counters.errors == 1000
    assert len(events) == 10 + 6  # each of the first ten, then 16, 32 … 512
    assert events[-1][1].startswith("error 512: ")


def test_samples_go_out_before_the_failure_is_told():
    pos, seen = stream(v="integer"), []
    made = unit(failing(3), [pos], events=lambda p, e, t: seen.append(content(p.output)))
    offer(pos, *[(t, t, 0) for t in range(1, 5)])
    assert seen[0] == content(made.output)


def test_a_stop_is_done_when_it_is_told():
    pos, seen = stream(v="integer"), []
    unit(
        failing(1),
        [pos],
        events=lambda p, e, t: seen.append((p.failure is None, p.output.is_ended)),
        on_error="stop",
    )
    offer(pos, (1, 1, 0))
    assert seen == [(False, True)] * 2


@pytest.mark.parametrize("error", [RecursionError, MemoryError, AssertionError, StopIteration])
def test_every_exception_is_isolated(error):
    def fail(time, samples, state):
        raise error

    pos = stream(v="integer")
    made = unit(fail, [pos], on_error="skip")
    offer(pos, (1, 1, 0))
    assert made.counters.last_error.startswith(error.__name__)


def test_endless_recursion_is_an_error_of_the_unit():
    def dive(time, samples, state):
        return dive(time, samples, state)

    pos = stream(v="integer")
    made = unit(dive, [pos], on_error="skip")
    offer(pos, (1, 1, 0))
    assert "RecursionError" in made.counters.last_error


@pytest.mark.parametrize("error", [SystemExit, GeneratorExit, asyncio.CancelledError])
def test_what_ends_programs_is_an_error_of_the_unit(error):
    def fail(time, samples, state):
        if time == 1:
            raise error
        return 5, state

    pos = stream(v="integer")
    made = unit(fail, [pos], on_error="skip")
    offer(pos, (1, 1, 0), (2, 2, 0))
    assert made.counters.last_error.startswith(error.__name__)
    assert made.output.counters.used == 1


def test_an_interrupt_is_of_the_unit_where_python_raises_none():
    """Nowhere but in the main thread, and there only under Python's own handler of SIGINT."""

    def fail(time, samples, state):
        raise KeyboardInterrupt

    def failed():
        pos = stream(v="integer")
        made = unit(fail, [pos], on_error="skip")
        offer(pos, (1, 1, 0))
        return made.counters.errors

    found = []
    # What runs in the background of a shell starts with the signal ignored.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with pytest.raises(KeyboardInterrupt):
            failed()
        thread = threading.Thread(target=lambda: found.append(failed()))
        thread.start()
        thread.join()
        signal.signal(signal.SIGINT, lambda *_: None)
        found.append(failed())
    finally:
        signal.signal(signal.SIGINT, before)
    assert found == [1, 1]


def test_an_error_that_cannot_be_shown_is_told_all_the_same():
    class Silent(Exception):
        def __str__(self):
            raise ValueError

    def fail(time, samples, state):
        raise Silent if time == 1 else RuntimeError("\ud800\n" + "x" * 10_000)

    pos, events = stream(v="integer"), Events()
    made = unit(fail, [pos], events=events, on_error="skip")
    offer(pos, (1, 1, 0), (2, 2, 0))
    assert "Silent: (its text raised ValueError)" in events[0][1]
    assert len(made.counters.last_error) == 500
    assert "\n" not in made.counters.last_error
    made.counters.last_error.encode()


# -- the batch form ----------------------------------------------------------------------------


def column(kind, values, **more):
    return Column(FieldType(kind), np.array(values, FieldType(kind).dtype), **more)


@pytest.mark.parametrize(
    ("make", "problem"),
    [
        (lambda t: [1.0], "returns a SampleBatch or None, not list"),
        (
            lambda t: SampleBatch(t - 1, t, {"x": column("float", [1])}),
            "cannot have been available",
        ),
        (
            lambda t: SampleBatch(t, t[:0], {"x": column("float", [1])}),
            "1 available times, but 0 valid",
        ),
        (lambda t: SampleBatch(t, t * 1.0, {"x": column("float", [1])}), "int64"),
        (lambda t: SampleBatch(t, t, {"x": column("float", [np.nan])}), "'x' must be finite"),
        (lambda t: SampleBatch(t, t, {"x": column("float", [1, 2])}), "another length"),
        (lambda t: SampleBatch(t, t, {"x": column("integer", [1])}), "the output has x (float)"),
        (lambda t: SampleBatch(t, t, {"y": column("float", [1])}), "the output has x (float)"),
        (lambda t: SampleBatch(t, t, {}), "the batch has no fields"),
        (lambda t: SampleBatch(t, t, {"x": column("string", [0])}), "a string column needs a pool"),
        (
            lambda t: SampleBatch(t, t, {"x": Column(FieldType.FLOAT, np.ones(1, np.float32))}),
            "must be float64, not float32",
        ),
    ],
)
def test_what_a_batch_form_must_not_give(make, problem):
    pos, output = stream(v="integer"), stream("out", x="float")

    def give(tuples, state):
        return make(tuples.available), None

    made = unit(give, [pos], output, batch=True, on_error="skip")
    offer(pos, (1, 1, 0))
    assert problem in made.counters.last_error
    assert content(output) == []


def test_a_batch_form_may_pass_text_on():
    """Its codes are those of the input; the output has a pool of its own."""
    pos = stream(name="pos", who="string")

    def pass_on(tuples, state):
        keep = tuples.column(0, "who").values >= 0
        return SampleBatch(tuples.available, tuples.valid, {"who": tuples.column(0, "who")}), keep

    made = unit(pass_on, [pos], batch=True)
    offer(pos, (1, 1, "b"), (2, 2, None), (3, 3, "a"))
    offer(pos, (4, 4, "b"))
    assert [row[2] for row in content(made.output)] == ["b", None, "a", "b"]
    assert made.output.stream.pools["who"] is not pos.stream.pools["who"]
