"""Law: the verdicts of a monitor are the same samples however those of its streams are cut into
batches, whichever stream publishes first, and also by an engine that was cut off and goes on."""

import json
import shutil
from pathlib import Path

import pytest
from commanding import state
from hypothesis import given, settings
from hypothesis import strategies as st
from monitor_worlds import OBJECTS, WORLDS, in_order, in_some_order, options, told

from dyknow.engine.durability import commands as c
from dyknow.engine.durability.durable_engine import RecordedEngine
from dyknow.engine.engine import Engine
from dyknow.journal.durability import Durability
from dyknow.streams.time import SECOND, format_time

FORMULAS = {
    "m(?x in UAV)": (
        "speed(?x) > 36",
        "always[0s, 3s] (speed(?x) > 36 [km.h-1] -> eventually[0s, 2s] altitude(?x) > 10 [ft])",
        "speed(?x) > 10 [m.s-1] since[0s, 4s] altitude(?x) > 12",
        "eventually[1s, oo] speed(?x) * 2 > speed(?x) + 10 [m.s-1]",
        "forall ?y in UAV (speed(?y) < 40 or eventually[0s, 1s] altitude(?x) < 3 [m])",
        "eventually[0s, 2s] speed(?x) > speed(uav1)",
    ),
    "m(?y in UAV, ?x in UAV)": (
        "speed(?x) >= speed(?y) until[0s, 3s] altitude(?y) > 10",
        "?x = ?y or eventually[1s, 2s] (speed(?x) > 36 and altitude(?y) > 3)",
    ),
    "m": (
        "exists ?x in UAV eventually[1s, 3s] speed(?x) > 36",
        "forall ?x in UAV (speed(?x) > 18 or previous altitude(?x) > 3 [m])",
        "exists ?x in UAV (speed(?x) > 18 and not once[0s, 2s] altitude(?x) > 12)",
        # A unit selects the samples of uav1; its watermarks are those of whole batches.
        "speed(uav1) > 18",
        "speed(uav2) > 18 -> eventually[0s, 2s] altitude(uav1) > 3",
    ),
}


@st.composite
def monitors(draw):
    head = draw(st.sampled_from(sorted(FORMULAS)))
    body = draw(st.sampled_from(FORMULAS[head]))
    return f"monitor {head} = {body}{draw(options())}"


@settings(deadline=None, max_examples=80)
@given(st.sampled_from(sorted(WORLDS)), monitors(), told(), told(), st.data())
def test_verdicts_do_not_depend_on_cuts(world, text, a, b, data):
    left = {"a": a, "b": b}
    expected = in_order(world, text, left)
    for _ in range(2):
        assert in_some_order(world, text, left, data.draw) == expected


# -- an example by hand ----------------------------------------------------------------------


def row(second, valid=None, **values):
    given = {"id": "uav1", "v": None, "w": None, **values}
    return second * SECOND, (second if valid is None else valid) * SECOND, given


def verdict(available, valid, value, **objects):
    """An atom or a disjunction: its own state decides, and bears witness unless it is unknown."""
    decided = format_time(valid * SECOND)
    witness = None if value == "unknown" else decided
    fields = {"verdict": value, "decided": decided, "witness": witness}
    return available, valid * SECOND, {**objects, **fields}


def test_units_and_objects_of_two_streams():
    """10 m/s are 36 km/h, and 3.05 m are just more than 10 ft."""
    text = (
        "monitor m(?x in UAV) = speed(?x) >= 36 -> altitude(?x) > 10 "
        "with report verdicts, use most recent, max delay 1s"
    )
    a = [row(1, v=9.9), row(2, v=10.0), row(3, id="uav2", v=10.0), row(4, v=10.0)]
    b = [row(1, w=3.04), row(3, valid=2, w=3.05), row(5, id="uav2", w=3.0)]
    found, ended, _ = in_order("a stream each", text, {"a": a, "b": b})
    assert ended == "ended"
    # A state leaves a second later, the last one at the end.
    assert found == [
        verdict(2 * SECOND, 1, "true", x="uav1"),
        verdict(3 * SECOND, 2, "true", x="uav1"),
        verdict(4 * SECOND, 3, "unknown", x="uav2"),
        verdict(5 * SECOND, 4, "true", x="uav1"),
        verdict(5 * SECOND, 5, "false", x="uav2"),
    ]


# -- restarts --------------------------------------------------------------------------------

MANY = (
    "monitor m(?x in UAV) = always[0s, 8s] (speed(?x) > 36 -> eventually[0s, 4s] altitude(?x) > 10)"
    " with report verdicts, use most recent, max delay 1s",
    "monitor runs(?x in UAV) = speed(?x) > 18 until[0s, 6s] altitude(?x) > 10 "
    "with report changes, use most recent",
    "monitor grid = forall ?x in UAV historically[0s, 5s] speed(?x) > 10 "
    "with sample every 1s, max delay 2s, use most recent, present for 4s, report changes",
    "monitor first(?x in UAV) = eventually[6s, 9s] speed(?x) > 20 with once, report verdicts",
    "monitor margin(?x in UAV) = always[0s, 6s] (speed(?x) > 10 or altitude(?x) > 5)"
    " with report verdicts, use most recent, robustness, max delay 1s",
)
NAMES = ("m", "runs", "grid", "first", "margin")


@st.composite
def lives(draw):
    stamped = draw(st.booleans())
    made = [c.Annotate(WORLDS["a stream each"])]
    asked = [c.RegisterQuery(text) for text in MANY]
    now = 1
    for _ in range(draw(st.integers(4, 16))):
        kind = draw(st.sampled_from(["publish", "publish", "publish", "tick"]))
        if kind == "tick":
            now += draw(st.sampled_from([0, 1, 6]))
            made.append(c.Tick(now * SECOND))
            continue
        stream, rows = draw(st.sampled_from("ab")), []
        for _ in range(draw(st.integers(1, 4))):
            now += draw(st.sampled_from([0, 1, 1, 3]))
            value = draw(st.sampled_from([1.0, 6.0, 12.0]))
            one = {"valid": now * SECOND, "id": draw(st.sampled_from(OBJECTS))}
            one["v" if stream == "a" else "w"] = value
            rows.append(one if stamped else {**one, "available": now * SECOND})
        body = "\n".join(map(json.dumps, rows)).encode()
        made.append(c.Publish(stream, "ndjson", body, now * SECOND))
    at = draw(st.sampled_from([1, 1, len(made) // 2]))
    made[at:at] = asked
    ends = draw(st.permutations([c.EndStream("a"), c.EndStream("b")]))
    return made + draw(st.sampled_from([[], ends[:1], ends]))


def cut_off(recorded):
    """The process is killed: what was committed is there, and nothing else of it."""
    recorded.log.commit()
    recorded._directory.close()


def opened(path):
    return RecordedEngine(path, now=0, durability=Durability.WRITE)


def pending(engine):
    return sum(
        engine._parts.configuration.units[name].monitoring.retained
        for name in NAMES
        if engine.queries.has(name)
    )


def lived(path: Path, commands, cuts):
    """The verdicts of an engine that is cut off after some commands, with True behind a checkpoint;
    and how much was in memory then."""
    recorded, kept = opened(path), 0
    try:
        for number, command in enumerate(commands):
            recorded.do(command)
            if number in cuts:
                before = pending(recorded.engine)
                if cuts[number]:
                    recorded.checkpoint().write()
                cut_off(recorded)
                recorded = opened(path)
                assert recorded.recovery.notes == []
                assert pending(recorded.engine) == before
                kept += before
        explained = [recorded.engine.queries.explain_running(name) for name in NAMES]
        return {**state(recorded.engine), "explained": explained}, kept
    finally:
        recorded._directory.close()
        shutil.rmtree(path)


def whole(commands, epoch):
    engine = Engine(epoch=epoch)
    for command in commands:
        c.execute(engine, command)
    explained = [engine.queries.explain_running(name) for name in NAMES]
    return {**state(engine), "explained": explained}


@settings(deadline=None, max_examples=20)
@given(lives(), st.dictionaries(st.integers(0, 24), st.booleans(), min_size=1, max_size=4))
def test_wherever_it_is_cut_off_it_goes_on(tmp_path_factory, commands, cuts):
    found, _ = lived(tmp_path_factory.mktemp("data"), commands, cuts)
    for part, value in whole(commands, found["epoch"]).items():
        assert found[part] == value, part


@pytest.mark.parametrize("is_checkpoint", [True, False])
def test_a_cut_amid_windows_that_are_open(tmp_path, is_checkpoint):
    rows = [{"valid": t * SECOND, "available": t * SECOND, "id": "uav1"} for t in range(1, 13)]
    published = [
        c.Publish(stream, "ndjson", json.dumps({**one, field: 12.0}).encode(), 0)
        for one in rows
        for stream, field in (("a", "v"), ("b", "w"))
    ]
    ends = [c.EndStream("a"), c.EndStream("b")]
    asked = [c.RegisterQuery(text) for text in MANY]
    commands = [c.Annotate(WORLDS["a stream each"]), *asked, *published, *ends]
    found, kept = lived(tmp_path / "data", commands, {5 + 10: is_checkpoint})
    assert kept > 10
    expected = whole(commands, found["epoch"])
    assert found == expected
    assert all(found["streams"][name][2] for name in NAMES)
