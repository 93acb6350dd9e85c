"""A request that begins now passes over streams that have ended, if others give as much."""

import pytest
from feeding import feed, samples

from dyknow.engine.model.views import Since

SPEEDS = "stream {} contains speed(UAV) = spd [km.h-1] for every UAV = id"
EVENT = "dyknow:HighSpeedEvent(?o, dyknow:UAV, 100)"


def row(second, speed, name="uav1"):
    return second, {"id": name, "spd": speed}


@pytest.fixture
def two(engine, high_speed):
    """A recording that has ended, and a stream that goes on; the recording came first."""
    engine.register_template(high_speed)
    engine.annotate(SPEEDS.format("recorded"))
    feed(engine, "recorded", [row(t, 200.0) for t in range(1, 5)])
    engine.end("recorded")
    engine.annotate(SPEEDS.format("live"))
    return engine


def read_by(engine, since=Since.NOW):
    view = engine.request_event(engine.parse_request(EVENT), since=since)
    return view.plan.units[0].inputs[0], view


def test_it_reads_the_stream_that_goes_on(two):
    name, view = read_by(two)
    assert name == "live"
    feed(two, "live", [row(t, 150.0) for t in range(11, 15)])
    assert [values["speed"] for _, values in samples(two, view.stream)] == [150.0] * 3


def test_one_from_the_start_reads_the_recording(two):
    name, view = read_by(two, Since.START)
    assert name == "recorded"
    assert samples(two, view.stream)


def test_without_another_it_reads_the_recording(two):
    two.remove_stream("live")
    assert read_by(two)[0] == "recorded"


def test_a_stream_of_fewer_objects_does_not_replace_it(two):
    two.remove_stream("live")
    two.annotate("stream one contains speed(uav1) = spd [km.h-1]")
    assert read_by(two)[0] == "recorded"


def test_what_is_explained_is_what_a_request_does(two):
    shown = two.match("speed", sort="UAV")
    assert "chosen: stream live" in shown.plan.text
    assert "chosen: stream live" in two.explain(event=EVENT)


def test_a_stream_that_goes_on_again_is_first_again(two):
    feed(two, "recorded", [row(20, 200.0)])
    assert read_by(two)[0] == "recorded"


def test_a_constant_stream_is_read(engine, high_speed):
    """Its one sample holds from now on, too: it is no recording that is over."""
    engine.register_template(high_speed)
    engine.annotate(SPEEDS.format("constant"))
    feed(engine, "constant", [row(1, 200.0)])
    engine.end("constant")
    engine.annotate(SPEEDS.format("live"))
    assert read_by(engine)[0] == "constant"
