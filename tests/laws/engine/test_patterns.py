"""Law: the matches of a pattern are the same samples however those of its streams are cut into
batches, whichever stream publishes first, and also by an engine that was cut off and goes on."""

import json
import shutil

from commanding import state
from hypothesis import given, settings
from hypothesis import strategies as st
from monitor_worlds import OBJECTS, WORLDS, in_order, in_some_order, told

from dyknow.engine.durability import commands as c
from dyknow.engine.durability.durable_engine import RecordedEngine
from dyknow.engine.engine import Engine
from dyknow.journal.durability import Durability
from dyknow.streams.time import SECOND

EP = "PREFIX dyknow: <http://www.ida.liu.se/dyknow/> "
PATTERNS = (
    "chronicle m(?x in UAV) { event(speed[?x]:(?, > 36), t1); "
    "event(altitude[?x]:(?, > 10 [ft]), t2); t2 - t1 in [0s, 3s]; }",
    "chronicle m(?x in UAV, ?v) { event(speed[?x]:(< 60, >= 60), t1); "
    "event(speed[?x]:(?, ?v), t2); t2 - t1 in [0.5s, 2s]; "
    "noevent(altitude[?x]:(?, < 8), (t1, t2 + 1s)); "
    "when recognized { emit event(m[?x, ?v], t1); } }",
    "chronicle m(?y in UAV) { event(speed[?x]:(?, > 36), t1); event(altitude[?y], t2); ?x != ?y; "
    "hold(speed[?y]:(< 100), (t1, t2)); t2 - t1 in [-2s, 2s]; }".replace(":(< 100)", ":< 100"),
    # A unit selects the samples of uav2; its watermarks are those of whole batches. Each world has
    # the altitude of uav1.
    "chronicle m { event(speed[uav2]:(?, > 18), t1); event(altitude[uav1], t2); "
    "t2 - t1 in [0s, 3s]; }",
    "REGISTER STREAM m AS PATTERN SEQ(speed a, altitude+ b[], speed c) WHERE skip_till_next_match "
    "[id] AND b[i].value > 5 WITHIN 4 seconds RETURN a.id AS x, count(b[]) AS n, b[].value AS all",
    "REGISTER STREAM m AS PATTERN SEQ(speed a, ~altitude b, speed c) WHERE [id] AND b.value < 10 "
    "WITHIN 3 seconds RETURN a.id AS x, c.value AS v",
    "REGISTER STREAM m AS PATTERN SEQ(speed a, altitude+ b[]) WHERE skip_till_any_match [id] "
    "WITHIN 3 seconds RETURN COUNT(*) AS n",
    f"REGISTER STREAM m AS {EP}SELECT ?x ?v WHERE {{ ?x dyknow:speed ?v }} SEQ "
    "{ ?x dyknow:altitude ?w FILTER (?w > 10) } WITHIN 3 s",
    f"REGISTER STREAM m AS {EP}SELECT ?x ?v ?w WHERE {{ {{ ?x dyknow:speed ?v }} OPTIONALSEQ "
    "{ ?x dyknow:altitude ?w } } WITHIN 2 s",
    "chronicle m(?x in UAV) { event(speed[?x]:(?, > 36), t); "
    "noevent(altitude[?x], (t, t + 1s)); } with max delay 1s",
    "REGISTER STREAM m AS PATTERN SEQ(speed a, speed b) WHERE partition_contiguity [value] "
    "WITHIN 4 seconds RETURN a.id AS x, b.value AS v WITH MAX DELAY 0.5s",
)


@settings(deadline=None, max_examples=80)
@given(st.sampled_from(sorted(WORLDS)), st.sampled_from(PATTERNS), told(), told(), st.data())
def test_matches_do_not_depend_on_cuts(world, text, a, b, data):
    left = {"a": a, "b": b}
    expected = in_order(world, text, left)
    for _ in range(2):
        assert in_some_order(world, text, left, data.draw) == expected


# -- restarts --------------------------------------------------------------------------------


def named(text, number):
    """The pattern under the name m0, m1, …"""
    if text.startswith("chronicle"):
        return f"REGISTER STREAM m{number} AS {text}"
    return text.replace("STREAM m ", f"STREAM m{number} ", 1)


MANY = tuple(named(text, number) for number, text in enumerate(PATTERNS))
NAMES = tuple(f"m{number}" for number in range(len(MANY)))


@st.composite
def lives(draw):
    stamped = draw(st.booleans())
    made = [c.Annotate(WORLDS["a stream each"]), *(c.RegisterQuery(text) for text in MANY)]
    now = 1
    for _ in range(draw(st.integers(4, 16))):
        if draw(st.sampled_from([False, False, False, True])):
            now += draw(st.sampled_from([0, 1, 6]))
            made.append(c.Tick(now * SECOND))
            continue
        stream, rows = draw(st.sampled_from("ab")), []
        for _ in range(draw(st.integers(1, 4))):
            now += draw(st.sampled_from([0, 1, 1, 3]))
            one = {"valid": now * SECOND, "id": draw(st.sampled_from(OBJECTS))}
            one["v" if stream == "a" else "w"] = draw(st.sampled_from([1.0, 6.0, 12.0, 20.0]))
            rows.append(one if stamped else {**one, "available": now * SECOND})
        body = "\n".join(map(json.dumps, rows)).encode()
        made.append(c.Publish(stream, "ndjson", body, now * SECOND))
    ends = draw(st.permutations([c.EndStream("a"), c.EndStream("b")]))
    return made + draw(st.sampled_from([[], ends[:1], ends]))


def opened(path):
    return RecordedEngine(path, now=0, durability=Durability.WRITE)


def told_of(engine):
    return {**state(engine), "explained": [engine.queries.explain_running(n) for n in NAMES]}


def lived(path, commands, cuts):
    """What an engine tells that is cut off after some commands, with True behind a checkpoint."""
    recorded = opened(path)
    try:
        for number, command in enumerate(commands):
            recorded.do(command)
            if number in cuts:
                if cuts[number]:
                    recorded.checkpoint().write()
                recorded.log.commit()
                recorded._directory.close()
                recorded = opened(path)
                assert recorded.recovery.notes == []
        return told_of(recorded.engine)
    finally:
        recorded._directory.close()
        shutil.rmtree(path)


@settings(deadline=None, max_examples=15)
@given(lives(), st.dictionaries(st.integers(10, 30), st.booleans(), min_size=1, max_size=3))
def test_wherever_it_is_cut_off_it_goes_on(tmp_path_factory, commands, cuts):
    found = lived(tmp_path_factory.mktemp("data"), commands, cuts)
    engine = Engine(epoch=found["epoch"])
    for command in commands:
        c.execute(engine, command)
    for part, value in told_of(engine).items():
        assert found[part] == value, part


def test_the_patterns_have_matches():
    """The laws above see matches of each pattern."""
    rows = [(t * SECOND, {"id": f"uav{1 + t % 2}"}) for t in range(1, 20)]
    left = {
        "a": [
            (t, t, {**one, "v": [4.0, 20.0, 50.0][t // SECOND % 3], "w": None}) for t, one in rows
        ],
        "b": [
            (t, t, {**one, "v": None, "w": [9.0, 20.0][t // SECOND // 2 % 2]}) for t, one in rows
        ],
    }
    for text in PATTERNS:
        assert in_order("a stream each", text, left)[0], text
