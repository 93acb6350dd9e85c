"""Registered queries that differ in constants and are evaluated as one
(engine/planning/query_sharing.py)."""

import gc
import re

import pytest
from feeding import feed, samples

from dyknow.engine.engine import Engine
from dyknow.engine.model.errors import Conflict
from dyknow.engine.model.views import Since, StreamDeclaration
from dyknow.engine.planning import query_sharing
from dyknow.languages.errors import LanguageError
from dyknow.streams.sample import Field, FieldType
from dyknow.streams.time import SECOND

DYKNOW = "http://www.ida.liu.se/dyknow/"
S5 = f"<{DYKNOW}s5.trdf>"
SSL = "stream s5 contains speed(UAV) = v, heading(UAV) = h for every UAV = id"
WINDOW = "[RANGE 5s STEP 1s]"


@pytest.fixture
def flying(engine, monkeypatch):
    """An engine in which queries share from the third one on."""
    monkeypatch.setattr(query_sharing, "MIN_SHARED", 3)
    engine.annotate(SSL)
    return engine


def fast(name, limit, clauses=f"FROM STREAM {S5} {WINDOW}"):
    return f"""REGISTER STREAM {name} COMPUTE EVERY 1s AS
    CONSTRUCT {{ ?o dyknow:speed ?mean }} {clauses}
    WHERE {{ ?o a dyknow:UAV . ?o dyknow:speed ?v }}
    AGGREGATE {{(?mean, AVG, {{?v}}) FILTER (?mean > {limit})}}"""


def register(engine, *limits, start=0, **how):
    return [
        engine.queries.register(fast(f"q{i}", limit), **how)
        for i, limit in enumerate(limits, start)
    ]


def fly(engine, seconds, since=0, **speeds):
    """A sample a second of each, the first after ``since``."""
    rows = [
        (since + i + 0.1 * j, {"id": name, "v": float(speed), "h": 10.0})
        for i in range(1, seconds + 1)
        for j, (name, speed) in enumerate(speeds.items(), -len(speeds))
    ]
    feed(engine, "s5", rows)


def made_by(view):
    return [unit.transformation for unit in view.plan.units]


def units_of(engine):
    return sorted(unit.transformation for unit in engine._parts.configuration.units.values())


def shares(engine, text, **how):
    """Whether a query that was registered so became part of what others share."""
    return made_by(engine.queries.register(text, **how))[-1] == "selectInstance"


def test_from_some_queries_on_they_are_one(flying):
    views = register(flying, 100, 110, 120, 130)
    assert [made_by(view) for view in views[:2]] == [["cSparql"]] * 2
    assert [made_by(view) for view in views[2:]] == [["cSparql", "selectInstance"]] * 2
    assert views[2].plan.units[0].name == views[3].plan.units[0].name
    assert views[3].plan.units[0].users == 2
    last = flying.queries.view("q3")
    assert (last.stream, last.reads, last.plan.streams) == ("q3", ("s5",), ("s5",))
    assert last.fields == views[0].fields
    assert last.waits_for == ("s5",)
    assert "(?mean > 130)" in last.plan.query


def test_each_is_told_and_keeps_what_it_asked_for(flying):
    register(flying, 100, 110, 120, 200)
    fly(flying, 7, uav1=105, uav2=130)
    told = [{values["id"] for _, values in samples(flying, f"q{i}")} for i in range(4)]
    assert told == [{"uav1", "uav2"}, {"uav2"}, {"uav2"}, set()]
    ends = [[w.end for w in flying.queries.results(f"q{i}")] for i in range(4)]
    assert ends[0] == ends[1] == ends[2] == ends[3] == [i * SECOND for i in range(1, 7)]
    # Of a window without solutions, too.
    assert flying.queries.latest("q3").size == 0
    assert flying.queries.latest("q2").size == 1
    views = [flying.queries.view(f"q{i}") for i in range(4)]
    assert len({(view.watermark, view.last_window, view.windows) for view in views}) == 1
    assert f'<{DYKNOW}uav2> <{DYKNOW}speed> "130"' in "".join(
        flying.rdf_of("q2", flying.generator("q2").stream.all())
    )


def test_what_is_shared_is_explained(flying):
    register(flying, 100, 110, 120, 130)
    told = flying.queries.explain_running("q3")
    assert flying.explain_running("q3") == told
    for words in (
        "q3  ← selectInstance",
        "one of 2 queries that differ in constants, computed together",
        "\n  here ?.parameter1 is 130",
        "costs a window, of all of them",
        "s5: 1,000 samples a second of 100 subjects (assumed)",
        "?.parameter1: compared, found by order",
        "Aggregate by (?o)",
    ):
        assert words in told
    assert "by itself: fewer than 3 queries of its form" in flying.explain_running("q0")


def test_constants_on_which_all_agree_stay_in_the_plan(flying):
    """What nobody asks for is not computed."""
    texts = [
        f"REGISTER QUERY q{i} AS SELECT ?v FROM STREAM {S5} {WINDOW} "
        f"WHERE {{ dyknow:uav{object} dyknow:speed ?v FILTER (?v > {limit}) }}"
        for i, (object, limit) in enumerate([(1, 5), (1, 6), (1, 7), (1, 8), (2, 7), (3, 7)])
    ]
    views = [flying.queries.register(text) for text in texts]
    assert [made_by(view)[-1] for view in views] == ["cSparql"] * 2 + ["selectInstance"] * 4
    told = flying.queries.explain_running("q3")
    assert "Scan dyknow:uav1 dyknow:speed ?v" in told
    assert "here ?.parameter1 is 8" in told
    # Others came, and those with which they share are more general.
    told = flying.queries.explain_running("q5")
    assert "Scan ?.parameter1 dyknow:speed ?v" in told
    assert "?.parameter1: joined" in told
    assert [view.plan.units[0].users for view in map(flying.queries.view, ("q3", "q5"))] == [2, 2]
    fly(flying, 3, uav1=7.5, uav2=7.5, uav3=6.5)
    told = [len(samples(flying, f"q{i}")) > 0 for i in range(6)]
    assert told == [True, True, True, False, True, False]


def test_constants_of_every_place_differ(flying, monkeypatch):
    monkeypatch.setattr("dyknow.engine.planning.query_units.break_even_count", lambda *_: 1)
    texts = [
        f"REGISTER STREAM q{i} AS CONSTRUCT {{ dyknow:base{i} dyknow:speed ?v }} "
        f"FROM STREAM {S5} {WINDOW} WHERE {{ dyknow:uav{i} dyknow:speed ?v ; dyknow:heading ?h "
        f"FILTER (?h < {i} * 10 + 1) }}"
        for i in range(1, 5)
    ]
    views = [flying.queries.register(text) for text in texts]
    assert made_by(views[3]) == ["cSparql", "selectInstance"]
    fly(flying, 3, uav3=1, uav4=2)
    told = [{(v["id"], v["speed"]) for _, v in samples(flying, f"q{i}")} for i in range(1, 5)]
    assert told == [set(), set(), {("base3", 1.0)}, {("base4", 2.0)}]


def test_what_would_cost_more_than_it_saves_is_not_shared(flying):
    """Of one object the pairs of two features are few, of all objects many."""
    texts = [
        f"REGISTER QUERY q{i} AS SELECT ?v ?h FROM STREAM {S5} {WINDOW} "
        f"WHERE {{ dyknow:uav{i} dyknow:speed ?v ; dyknow:heading ?h }}"
        for i in range(20)
    ]
    made = [shares(flying, text) for text in texts]
    told = flying.queries.explain_running("q3")
    found = re.search(r"by itself: sharing is estimated to cost as much as (\d+) separate", told)
    least = int(found[1])
    assert 4 < least < 20
    assert made == [i >= least - 1 for i in range(20)]


def test_the_same_query_under_other_names_is_computed_once(flying):
    register(flying, 100, 100, 100, 100)
    fly(flying, 3, uav1=130)
    assert units_of(flying) == ["cSparql"] * 3 + ["selectInstance"] * 2
    assert samples(flying, "q3") == samples(flying, "q0") != []


def test_queries_whose_streams_are_found_share_too(flying):
    clauses = ""
    texts = [fast(f"q{i}", 100 + i, clauses) + f" WINDOW {WINDOW}" for i in range(4)]
    views = [flying.queries.register(text) for text in texts]
    assert made_by(views[3]) == ["cSparql", "selectInstance"]
    assert flying.queries.view("q3").reads == ("s5",)
    assert "semantic matching" in flying.queries.explain_running("q3")
    fly(flying, 3, uav1=130)
    assert samples(flying, "q3") == samples(flying, "q0") != []
    # A query that names the stream reads all that it says.
    assert not shares(flying, fast("other", 100))


@pytest.mark.parametrize(
    ("text", "how", "why"),
    [
        (fast("other", 90), {"semantics": "set"}, "fewer than 3"),
        (fast("other", 90), {"origin": 1}, "fewer than 3"),
        (fast("other", 90), {"report": "close"}, "depends on when it began"),
        (fast("other", 90), {"since": Since.START}, "begins with the history"),
        (fast("other", 90).replace("5s", "6s"), {}, "fewer than 3"),
        (fast("other", 90).replace("a dyknow:UAV", "a dyknow:RMAX"), {}, "fewer than 3"),
        (fast("other", 90).replace("AVG", "MAX"), {}, "fewer than 3"),
        (fast("other", 90).replace("RANGE 5s STEP 1s", "TRIPLES 5"), {}, "depends on when"),
        (fast("other", 90).replace("speed ?mean", "speed ?mean ; dyknow:at []"), {}, "blank"),
        (fast("other", "90 + RAND()"), {}, "another value each time"),
    ],
)
def test_what_cannot_be_shared_stays_alone_and_says_why(flying, text, how, why):
    register(flying, 100, 110, 120)
    assert not shares(flying, text, **how)
    assert why in flying.queries.explain_running("other")


def test_what_streams_mean_has_to_be_the_same(flying):
    register(flying, 100, 110, 120)
    flying.annotate("stream s5 contains speed(UAV) = h for every UAV = id")
    assert not shares(flying, fast("other", 130))


def test_it_runs_as_long_as_somebody_needs_it(flying):
    register(flying, 100, 110, 120, 130)
    flying.queries.remove("q0")
    flying.queries.remove("q2")
    assert units_of(flying) == ["cSparql", "cSparql", "selectInstance"]
    fly(flying, 3, uav1=150)
    assert samples(flying, "q3")
    flying.queries.remove("q3")
    flying.queries.remove("q1")
    assert units_of(flying) == []
    assert {view.name for view in flying.streams()} == {"s5", "status"}
    # Nobody shares with those that are gone.
    assert not shares(flying, fast("q0", 130))


def test_a_query_of_the_same_name_and_text_has_one_user_more(flying):
    register(flying, 100, 110, 120)
    view = flying.queries.register(fast("q2", 120))
    assert (view.users, len(flying.queries)) == (2, 3)
    flying.queries.remove("q2")
    assert flying.queries.view("q2").state == "running"


def test_what_is_refused_begins_nothing(flying):
    register(flying, 100, 110)
    before = units_of(flying)
    with pytest.raises(LanguageError):
        flying.queries.register(fast("bad", "'x").replace("?mean }", "'x' }"))
    assert units_of(flying) == before


def test_a_stream_that_others_read_is_not_removed(flying):
    register(flying, 100, 110, 120, 130)
    for i in range(4):
        flying.queries.register(
            f"REGISTER QUERY count{i} AS SELECT ?o ?v FROM STREAM <{DYKNOW}q3.trdf> {WINDOW} "
            f"WHERE {{ ?o dyknow:speed ?v FILTER (?v > {i}) }}"
        )
    with pytest.raises(Conflict, match="read by query count0, query count1, query count2"):
        flying.queries.remove("q3")
    fly(flying, 4, uav1=150)
    assert samples(flying, "count3") == samples(flying, "count0") != []


def test_what_fails_in_one_fails_in_no_other(flying):
    register(flying, 100, 110, 120, 130)
    unit = flying._parts.configuration.units["q2"]

    def fail(result, available):
        raise RuntimeError("no more")

    unit._emitter.results.convert = fail
    fly(flying, 4, uav1=150)
    view = flying.queries.view("q2")
    assert (view.state, view.failure) == ("failed", f"{unit.name}: RuntimeError: no more")
    assert flying.queries.view("q3").state == "running"
    assert len(samples(flying, "q3")) == 3
    # Registered again it works.
    assert flying.queries.register(fast("q2", 120)).state == "running"
    fly(flying, 4, since=4, uav1=150)
    assert samples(flying, "q2")
    for i in range(4):
        flying.queries.remove("q2") if i == 2 else None
        flying.queries.remove(f"q{i}")
    assert units_of(flying) == []


def test_what_fails_in_all_fails_in_each(flying):
    register(flying, 100, 110, 120, 130)
    shared = flying._parts.configuration.units["q3"]._template

    def fail(*args):
        raise RuntimeError("no more")

    shared.evaluator.push = fail
    fly(flying, 2, uav1=150)
    states = [flying.queries.view(f"q{i}").state for i in range(4)]
    assert states == ["running", "running", "failed", "failed"]
    assert shares(flying, fast("q4", 140))
    assert flying._parts.configuration.units["q4"]._template is not shared
    assert flying.queries.register(fast("q3", 130)).state == "running"
    fly(flying, 5, since=2, uav1=150)
    assert samples(flying, "q3")
    assert samples(flying, "q4")


def test_a_stream_that_is_declared_anew_is_another_one(flying):
    register(flying, 100, 110, 120, 130)
    for name in ("q0", "q1", "q2", "q3"):
        flying.queries.remove(name)
    flying.remove_stream("s5")
    flying.annotate(SSL)
    assert not shares(flying, fast("q0", 100))


def test_who_comes_when_all_windows_have_closed_waits_for_what_is_in_time(flying):
    """A stream that has ended may go on."""
    register(flying, 100, 110, 120)
    fly(flying, 3, uav1=130)
    flying.end("s5")
    assert [flying.queries.view(f"q{i}").state for i in range(3)] == ["ended"] * 3
    assert not shares(flying, fast("q3", 100))
    told = flying.queries.explain_running("q3")
    assert "by itself: the shared windows have closed further than its streams are" in told
    fly(flying, 9, since=3, uav1=130)
    assert len(samples(flying, "q3")) == 8
    assert flying.queries.view("q2").state == "running"
    assert shares(flying, fast("q4", 100))


def test_late_samples_are_told_for_each(engine, monkeypatch):
    monkeypatch.setattr(query_sharing, "MIN_SHARED", 1)
    fields = (Field("id", FieldType.STRING), Field("v", FieldType.FLOAT))
    for name, idle in (("slow", 5 * SECOND), ("quick", None)):
        engine.declare(StreamDeclaration(name, fields, idle=idle))
        engine.annotate(f"stream {name} contains speed(UAV) = v for every UAV = id")
    both = " ".join(f"FROM STREAM <{DYKNOW}{n}.trdf> {WINDOW}" for n in ("slow", "quick"))
    for i in range(2):
        assert shares(engine, fast(f"q{i}", 100 + i, both))
    sides = [engine.generator(f"q{i}_late_slow") for i in range(2)]

    def say(stream, *seconds, clock):
        engine.tick(clock * SECOND)
        feed(engine, stream, [(second, {"id": "uav1", "v": 130.0}) for second in seconds])

    say("slow", 1, clock=0)
    say("quick", 1, 2, 3, clock=1)
    assert engine.queries.view("q1").held_back_by == ("slow",)
    engine.tick(7 * SECOND)
    say("slow", 2, clock=8)
    assert [engine.queries.view(f"q{i}").late for i in range(2)] == [1, 1]
    assert [len(side.stream.all()) for side in sides] == [1, 1]
    assert [side.watermark for side in sides] == [3 * SECOND] * 2
    # Each has a stream of its own, which goes with it.
    engine.remove_stream("q0_late_slow")
    engine.queries.remove("q1")
    assert {view.name for view in engine.streams()} == {
        "status",
        "slow",
        "quick",
        "q0",
        engine._parts.configuration.units["q0"]._template.output.name,
    }
    engine.tick(14 * SECOND)
    say("quick", 9, clock=14)
    say("slow", 4, clock=15)
    assert engine.queries.view("q0").late == 2
    for name in ("slow", "quick"):
        engine.end(name)
    assert engine.queries.view("q0").state == "ended"


def test_they_share_again_after_a_restart(tmp_path, monkeypatch):
    monkeypatch.setattr(query_sharing, "MIN_SHARED", 2)
    first = Engine(tmp_path)
    first.annotate(SSL)
    register(first, 100, 110, 120)
    del first
    gc.collect()
    second = Engine(tmp_path)
    views = second.queries.views()
    assert [(view.name, view.state) for view in views] == [(f"q{i}", "running") for i in range(3)]
    assert [made_by(view)[-1] for view in views] == ["cSparql", "selectInstance", "selectInstance"]
    fly(second, 3, uav1=115)
    assert [len(samples(second, f"q{i}")) for i in range(3)] == [2, 2, 0]
