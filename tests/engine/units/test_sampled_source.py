"""Sample-based sources (Def. 5.9): read at their period, never more than there is time for."""

import pytest
from process_running import Events, content, stream

from dyknow.engine.processes.registry import Processes
from dyknow.engine.units.sampled_source import SampledSource
from dyknow.streams.single_sample import Sample
from dyknow.streams.time import TIME_MAX


def source(code, start=0, output=None, events=None, behind=100, period="10ns", **rule):
    registry = Processes()
    registry.sampled("temperature", period, name="thermo", **rule)(code)
    output = stream("temperature") if output is None else output
    events = Events() if events is None else events
    return SampledSource(registry.source("thermo"), output, start, on_event=events, behind=behind)


def test_it_reads_at_every_due_time():
    """What it gives does not depend on when the ticks come."""
    results = []
    for ticks in ([35], [-5, 0, 5, 9, 10, 10, 29, 30, 35], range(36)):
        made = source(lambda t: t * 2)
        for now in ticks:
            made.tick(now)
        assert made.output.watermark == 36
        results.append(content(made.output))
    assert results[0] == [(0, 0, 0), (10, 10, 20), (20, 20, 40), (30, 30, 60)]
    assert results[1] == results[0]
    assert results[2] == results[0]


def test_the_first_tick_is_the_start_if_none_is_given():
    made = source(lambda t: 1.0, start=None)
    made.tick(7)
    made.tick(18)
    assert [a for a, _, _ in content(made.output)] == [7, 17]


def test_what_it_may_give():
    answers = {0: None, 10: Sample(3, {"x": 1, "at": "a"}), 20: {"x": 2, "at": "b"}}
    answers[30] = Sample(30, {"x": 3, "at": "a"}, 34)
    made = source(answers.get)
    made.tick(35)
    made.tick(40)
    assert content(made.output) == [(10, 3, 1, "a"), (20, 20, 2, "b"), (34, 30, 3, "a")]


def test_a_sensor_is_not_asked_for_too_much_of_the_past():
    made = source(lambda t: t, behind=3)
    made.tick(100)
    assert [a for a, _, _ in content(made.output)] == [80, 90, 100]
    assert made.missed == 8
    made.tick(110)
    assert made.missed == 8
    far = source(lambda t: t, behind=2, period="1ns")
    far.tick(TIME_MAX)
    assert [a for a, _, _ in content(far.output)] == [TIME_MAX - 1, TIME_MAX]
    assert far.missed == TIME_MAX - 1


def test_a_clock_that_goes_back_changes_nothing():
    made = source(lambda t: t)
    made.tick(20)
    made.tick(5)
    made.tick(30)
    assert [a for a, _, _ in content(made.output)] == [0, 10, 20, 30]


class Camera:
    made = 0

    def __init__(self):
        Camera.made += 1
        self.read = 0

    def __call__(self, time):
        if time in (20, 30):
            raise OSError("no picture")
        self.read += 1
        return self.read


@pytest.mark.parametrize(
    ("rule", "values", "kinds", "instances"),
    [
        ({"on_error": "skip"}, [1, 2, 3], ["unit failed"] * 2, 1),
        ({"on_error": "restart"}, [1, 2, 1], ["unit failed", "unit restarted"] * 2, 3),
        (
            {"on_error": "restart", "restarts": 1},
            [1, 2],
            ["unit failed", "unit restarted", "unit failed", "unit stopped by rule"],
            2,
        ),
        ({"on_error": "stop"}, [1, 2], ["unit failed", "unit stopped by rule"], 1),
    ],
)
def test_failures_follow_the_rule(rule, values, kinds, instances):
    Camera.made = 0
    events = Events()
    made = source(Camera, events=events, **rule)
    for now in range(0, 41, 5):
        made.tick(now)
    assert [value for _, _, value in content(made.output)] == values
    assert events.kinds == kinds
    assert Camera.made == instances
    stopped = kinds[-1] == "unit stopped by rule"
    assert (made.failure is not None) == stopped
    assert made.output.is_ended == stopped


def test_a_wrong_answer_is_an_error_of_the_source():
    output = stream("temperature", t="float")
    made = source(lambda t: "warm", output=output, on_error="skip")
    made.tick(0)
    assert "field 't' is a float, got 'warm'" in made.counters.last_error
    early = source(lambda t: Sample(0, {"t": 1.0}, t - 1), on_error="skip")
    early.tick(0)
    assert "cannot have been available" in early.counters.last_error


def test_stop_ends_the_output():
    made = source(lambda t: t)
    made.tick(0)
    made.stop()
    made.tick(10)
    assert len(content(made.output)) == 1
    assert made.output.is_ended
