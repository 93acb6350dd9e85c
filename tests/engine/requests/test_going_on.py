"""Formulas and patterns over a recording that is played again: each time is evaluated by itself
(tests/laws/engine/test_shared_reasoning.py has the law)."""

import pytest
from feeding import feed, samples

from dyknow.engine.durability.accepted_commands import AcceptedCommands
from dyknow.engine.durability.checkpoint import Outside
from dyknow.engine.durability.portable_state import engine_from, portable_of
from dyknow.engine.model.errors import NoResult
from dyknow.engine.processes.registry import Processes
from dyknow.engine.processes.supervision import DIRECT

SSL = "stream robots contains speed(UAV) = level for every UAV = id"
LOW = "monitor low(?x in UAV) = always [0s, 2s] speed(?x) > 20"
ONE = "monitor low = always [0s, 2s] speed(r1) > 20"
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
    engine.queries.register(f"{ONE} with once, report verdicts")
    play(engine, 0, levels=(60.0, 60.0))
    told = samples(engine, "low")
    assert len(told) == 1
    play(engine, 100)
    assert samples(engine, "low") == told
    assert engine.generator("low").is_ended
    assert engine.queries.view("low").failure is None
    assert engine.queries.why("low", [], 0)().verdict == told[0][1]["verdict"]


def test_a_single_start_that_has_not_begun_begins(engine):
    engine.annotate(SSL)
    feed(engine, "robots", [(1, {"id": "r1", "level": None})])
    engine.end("robots")
    engine.queries.register(f"{LOW} with once, report verdicts")
    play(engine, 100)
    assert found(engine, "low", 100) == [0]


def test_further_objects_have_a_single_start_each(engine):
    engine.annotate(SSL)
    engine.queries.register(f"{LOW} with once, report verdicts")
    play(engine, 0)
    feed(engine, "robots", [(100, {"id": "r1", "level": 60.0}), (101, {"id": "r2", "level": 60.0})])
    engine.end("robots")
    assert [(int(t), r["x"]) for t, r in samples(engine, "low")] == [(0, "r1"), (101, "r2")]


def test_a_sample_at_the_time_of_the_end_is_late(engine):
    engine.annotate(SSL)
    engine.queries.register(DROP)
    play(engine, 0, levels=(10.0, 60.0))
    for time in (1, 2):
        feed(engine, "robots", [(time, {"id": "r1", "level": 20.0})])
    engine.end("robots")
    assert engine.queries.view("drop").late == 1
    assert samples(engine, "drop") == []
    with pytest.raises(NoResult):
        engine.queries.why("drop", ["r1"], 10**9)()


def test_another_version_goes_on_where_streams_had_ended(engine):
    """A portable restore tells units nothing of the ends of streams before."""
    engine.annotate("stream s contains speed(UAV) = level for every UAV = id")
    engine.annotate("stream h contains altitude(UAV) = level for every UAV = id")
    either = "eventually [0s, 1s] (speed(?x) > 20 or altitude(?x) > 3)"
    engine.queries.register(
        f"monitor low(?x in UAV) = {either} with report verdicts, use most recent"
    )
    engine.queries.register("monitor one = speed(uav1) > 20 with report verdicts")
    for name in "sh":
        feed(engine, name, [(t, {"id": "uav1", "level": 30.0}) for t in range(3)])
        engine.end(name)
    outside = Outside(Processes(), DIRECT)
    engine = engine_from(portable_of(engine, AcceptedCommands(), {}, []), 0, outside)[0]
    feed(engine, "s", [(t, {"id": "uav1", "level": 30.0}) for t in range(100, 104)])
    engine.end("s")
    assert found(engine, "low", 100) == [0, 1, 2, 3]
    assert found(engine, "one", 100) == [0, 1, 2, 3]
    assert engine.generator("low").is_ended


def test_only_the_last_time_is_explained(robots):
    play(robots, 100)
    second = 10**9
    assert robots.queries.why("low", ["r1"], 102 * second)().verdict == "false"
    assert len(robots.queries.why("drop", ["r1"], 101 * second)()) == 1
    with pytest.raises(NoResult, match="went on"):
        robots.queries.why("low", ["r1"], 2 * second)()
    with pytest.raises(NoResult, match="went on"):
        robots.queries.why("drop", ["r1"], 1 * second)()


def test_what_comes_before_what_was_reached_meanwhile_is_late(engine):
    """A stream that had ended, even before its first sample, goes on behind the others."""
    engine.annotate("stream a contains speed(UAV) = v [m.s-1] for every UAV = id")
    engine.annotate("stream b contains altitude(UAV) = w [m] for every UAV = id")
    view = engine.queries.register(
        "monitor m(?x in UAV) = speed(?x) > 3 or altitude(?x) > 3 "
        "with max delay 0s, report verdicts, use most recent"
    )
    engine.end("a")
    feed(engine, "b", [(t, {"id": "u", "w": 9.0}) for t in (2, 3, 5)])
    feed(engine, "a", [(t, {"id": "u", "v": 9.0}) for t in (2, 3)])
    feed(engine, "b", [(6, {"id": "u", "w": 9.0})])
    feed(engine, "a", [(7, {"id": "u", "v": 9.0})])
    for name in "ab":
        engine.end(name)
    assert [int(start) for start, _ in samples(engine, view.stream)] == [2, 3, 5, 6, 7]
    assert engine.queries.unit("m").late == 2
