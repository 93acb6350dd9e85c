"""Sinks: called with each sample, and harmless to everybody else."""

import pytest
from process_running import Events, content, offer, stream, unit

from dyknow.engine.model.views import Since
from dyknow.engine.processes.registry import Processes
from dyknow.engine.units.sink import Sink


def sink(code, inputs, events=None, since=Since.NOW, batch=False, **rule):
    registry = Processes()
    registry.consumer(["sort"] * len(inputs), name="log", batch=batch, **rule)(code)
    events = Events() if events is None else events
    made = Sink(registry.sink("log"), inputs, on_event=events)
    made.start(since)
    return made


def test_it_is_called_with_each_sample():
    pos, seen = stream(v="integer", who="string"), []
    sink(lambda s: seen.append((s.available, s.valid, dict(s.values))), [pos])
    offer(pos, (1, 0, 5, "a"), (2, 2, None, None))
    offer(pos, (3, 3, 6, "b"))
    assert seen == [
        (1, 0, {"v": 5, "who": "a"}),
        (2, 2, {"v": None, "who": None}),
        (3, 3, {"v": 6, "who": "b"}),
    ]


def test_several_inputs_are_told_apart():
    a, b, seen = stream("a", v="integer"), stream("b", v="integer"), []
    made = sink(lambda s, number: seen.append((number, s.value)), [a, b, a])
    offer(a, (1, 1, 10))
    offer(b, (1, 1, 20))
    assert seen == [(0, 10), (2, 10), (1, 20)]
    assert (a.subscribers, b.subscribers) == (1, 1)
    made.stop()
    assert (a.subscribers, b.subscribers) == (0, 0)


def test_the_batch_form():
    pos, seen = stream(v="integer"), []
    sink(lambda batch: seen.append(batch.columns["v"].tolist()), [pos], batch=True)
    offer(pos, (1, 1, 1), (2, 2, 2))
    assert seen == [[1, 2]]


def test_it_may_begin_with_the_past():
    pos, seen = stream(v="integer"), []
    offer(pos, (1, 1, 1))
    sink(lambda s: seen.append(s.value), [pos], since=Since.START)
    offer(pos, (2, 2, 2))
    assert seen == [1, 2]


@pytest.mark.parametrize(
    ("on_error", "seen", "kinds"),
    [
        ("skip", [1, 3, 4], ["unit failed"]),
        ("restart", [1, 3, 4], ["unit failed", "unit restarted"]),
        ("stop", [1], ["unit failed", "unit stopped by rule"]),
    ],
)
def test_failures_follow_the_rule_and_nobody_else_is_stalled(on_error, seen, kinds):
    pos, got, events = stream(v="integer"), [], Events()

    def fragile(sample):
        if sample.value == 2:
            raise OSError("disk full")
        got.append(sample.value)

    made = sink(fragile, [pos], events, on_error=on_error)
    after = unit(lambda t, s, state: (s[0].value, None), [pos])
    offer(pos, (1, 1, 1), (2, 2, 2))
    offer(pos, (3, 3, 3), (4, 4, 4))
    assert got == seen
    assert events.kinds == kinds
    assert [row[2] for row in content(after.output)] == [1, 2, 3, 4]
    assert (made.failure is not None) == (on_error == "stop")
    assert (made.counters.errors, made.counters.last_error_time) == (1, 2)
    assert pos.subscribers == (1 if on_error == "stop" else 2)


def test_a_sink_that_fails_on_the_past_never_subscribes():
    pos = stream(v="integer")
    offer(pos, (1, 1, 1))

    def fail(sample):
        raise OSError

    sink(fail, [pos], since=Since.START, on_error="stop")
    assert pos.subscribers == 0
