"""Formulas and patterns over a recording that is played again: each time is evaluated by itself
(tests/laws/engine/test_shared_reasoning.py has the law)."""

import pytest
from feeding import feed, samples

from dyknow.engine.model.errors import NoResult

SSL = "stream robots contains speed(UAV) = level for every UAV = id"
LOW = "monitor low(?x in UAV) = always [0s, 2s] speed(?x) > 20"
DROP = "chronicle drop(?x) { event(speed[?x]:(> 50, < 30), t1); }"


@pytest.fixture
def robots(engine):
    engine.annotate(SSL)
    engine.queries.register(LOW)
    engine.queries.register(DROP)
    play(engine, 0)
    return engine


def play(engine, begin, levels=(60.0, 25.0, 15.0, 25.0, 25.0)):
    """A recording of five seconds."""
    rows = [(begin + i, {"id": "r1", "level": level}) for i, level in enumerate(levels)]
    feed(engine, "robots", rows)
    engine.end("robots")


def found(engine, name, begin):
    """The valid times (s) of its results that are not before ``begin``."""
    return [time - begin for time, _ in samples(engine, name) if time >= begin]


def test_each_time_has_its_verdicts_and_matches(robots):
    first = found(robots, "low", 0), found(robots, "drop", 0)
    assert first == ([0, 1, 2], [1])
    assert robots.generator("low").is_ended
    play(robots, 100)
    assert (found(robots, "low", 100), found(robots, "drop", 100)) == first
    assert robots.generator("low").is_ended
    assert [robots.queries.view(name).failure for name in ("low", "drop")] == [None, None]
    # Only of this time, as the samples read before.
    assert "5 by now, of 5 samples" in robots.queries.explain_running("low")
    assert "1 by now" in robots.queries.explain_running("drop")


def test_the_end_parts_what_is_before_from_what_is_after(robots):
    play(robots, 100, levels=(25.0,))
    assert found(robots, "drop", 100) == []
    assert found(robots, "low", 100) == []


def test_late_samples_begin_nothing(robots):
    before = robots.stream("low"), samples(robots, "low")
    play(robots, 0)
    assert robots.stream("robots").counters.late == 4
    assert robots.generator("low").is_ended
    assert (robots.stream("low"), samples(robots, "low")) == before


def test_a_single_start_is_decided_by_the_end(engine):
    engine.annotate(SSL)
    engine.queries.register(f"{LOW} with once, report verdicts")
    play(engine, 0, levels=(60.0, 60.0))
    told = samples(engine, "low")
    assert len(told) == 1
    play(engine, 100)
    assert samples(engine, "low") == told
    assert engine.generator("low").is_ended
    assert engine.queries.view("low").failure is None
    assert engine.queries.why("low", ["r1"], 0)().verdict == told[0][1]["verdict"]


def test_a_single_start_that_has_not_begun_begins(engine):
    engine.annotate(SSL)
    feed(engine, "robots", [(1, {"id": "r1", "level": None})])
    engine.end("robots")
    engine.queries.register(f"{LOW} with once, report verdicts")
    play(engine, 100)
    assert found(engine, "low", 100) == [0]


def test_only_the_last_time_is_explained(robots):
    play(robots, 100)
    second = 10**9
    assert robots.queries.why("low", ["r1"], 102 * second)().verdict == "false"
    assert len(robots.queries.why("drop", ["r1"], 101 * second)()) == 1
    with pytest.raises(NoResult, match="went on"):
        robots.queries.why("low", ["r1"], 2 * second)()
    with pytest.raises(NoResult, match="went on"):
        robots.queries.why("drop", ["r1"], 1 * second)()
