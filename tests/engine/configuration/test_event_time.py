"""Late samples on streams of their own, and idle streams (docs/explanation/semantics.md)."""

import gc
import json

import pytest
from feeding import feed, samples

from dyknow.engine.engine import Engine
from dyknow.engine.model.errors import (
    BadArguments,
    Conflict,
    Refused,
    UnknownStream,
)
from dyknow.engine.model.views import StreamDeclaration
from dyknow.streams.history import Retention
from dyknow.streams.sample import Field, FieldType
from dyknow.streams.time import SECOND

FIELDS = (Field("id", FieldType.STRING), Field("spd", FieldType.FLOAT))
WINDOW = "[RANGE 5s STEP 5s]"
IRI = "http://www.ida.liu.se/dyknow/"


def declare(engine, name, lateness=0, idle=None):
    idle = None if idle is None else idle * SECOND
    engine.declare(StreamDeclaration(name, FIELDS, lateness * SECOND, idle=idle))
    engine.annotate(f"stream {name} contains speed(UAV) = spd [km.h-1] for every UAV = id")


def say(engine, name, *seconds, clock=0):
    """Publish a sample at each of ``seconds`` of the stream's time."""
    engine.tick(clock * SECOND)
    feed(engine, name, [(second, {"id": "uav1", "spd": float(second)}) for second in seconds])


def count(engine, *names, query="n"):
    clauses = " ".join(f"FROM STREAM <{IRI}{name}.trdf> {WINDOW}" for name in names)
    head = f"REGISTER QUERY {query} AS SELECT (COUNT(?v) AS ?n)"
    return engine.queries.register(f"{head} {clauses} WHERE {{ ?o dyknow:speed ?v }}")


def counts(engine, query="n"):
    return [
        (result.end / SECOND, int(row["n"].value))
        for result in engine.queries.results(query)
        for row in result.solutions.rows()
    ]


def times(engine, name):
    """Available and valid times in seconds."""
    rows = engine.generator(name).stream.all().rows()
    return [(available / SECOND, valid / SECOND) for available, valid, _ in rows]


# -- late samples ----------------------------------------------------------------------------


def test_late_samples_are_a_stream_from_when_somebody_asks(engine):
    declare(engine, "s", lateness=2)
    say(engine, "s", 10, 1)
    assert engine.stream("s").counters.late == 1
    assert "s_late" not in [view.name for view in engine.streams()]
    view = engine.stream("s_late")
    assert (view.fields, view.samples_kept) == (FIELDS, 0)
    say(engine, "s", 3, 9, 2, 20)
    # They came when the stream had got to 10 s.
    assert times(engine, "s_late") == [(10.0, 3.0), (10.0, 2.0)]
    assert samples(engine, "s_late")[0] == (3.0, {"id": "uav1", "spd": 3.0})
    assert engine.stream("s_late").watermark == 18 * SECOND
    assert engine.stream("s").counters.late == 3
    engine.end("s")
    assert engine.stream("s_late").ended


def test_late_samples_are_read_like_any_others(engine):
    declare(engine, "s")
    view = count(engine, "s_late")
    assert view.reads == ("s_late",)
    say(engine, "s", 3, 1, 2, 6, 4, 11)
    assert counts(engine) == [(5.0, 2), (10.0, 1)]
    subscription = engine.subscribe("s_late", "any change")
    say(engine, "s", 7)
    assert samples(engine, subscription.stream) == [(7.0, {"id": "uav1", "spd": 7.0})]
    assert "speed" in engine.rdf_of("s_late", engine.generator("s_late").stream.all())[0]


def test_who_is_asked_about_what_comes_too_late(engine):
    declare(engine, "s")
    declare(engine, "late_riser")
    for name in ("t_late", "s_late_s", "s_late_late", "_late", "late", "s_late_"):
        with pytest.raises(UnknownStream):
            engine.stream(name)
    engine.stream("late_riser_late")
    with pytest.raises(Refused, match="the system uses the name"):
        declare(engine, "trains_late")
    engine.stream("s_late")
    with pytest.raises(Refused):
        declare(engine, "s_late")
    with pytest.raises(Refused, match="the system makes"):
        say(engine, "s_late", 1)
    with pytest.raises(UnknownStream):
        engine.stream("s_late_late")


def test_a_stream_of_late_samples_goes_when_nobody_wants_it(engine):
    declare(engine, "s")
    count(engine, "s_late")
    for name in ("s", "s_late"):
        with pytest.raises(Conflict, match="is read by"):
            engine.remove_stream(name)
    engine.queries.remove("n")
    engine.remove_stream("s_late")
    say(engine, "s", 5, 1)
    assert engine.stream("s").counters.late == 1
    assert engine.stream("s_late").samples_kept == 0
    engine.remove_stream("s")
    with pytest.raises(UnknownStream):
        engine.stream("s_late")


def test_what_comes_too_late_for_a_query(engine):
    declare(engine, "s")
    count(engine, "s")
    view = engine.stream("n_late_s")
    assert (view.fields, view.producer) == (FIELDS, "dyknow_cu1")
    say(engine, "s", 1, 6)
    engine.end("s")  # windows close up to the one that ends at 10 s
    say(engine, "s", 7, 9, 11)
    assert engine.stream("s").counters.late == 0
    assert engine.queries.view("n").late == 2
    assert times(engine, "n_late_s") == [(10.000000001, 7.0), (10.000000001, 9.0)]
    engine.end("s")
    assert counts(engine) == [(5.0, 1), (10.0, 1), (15.0, 1)]
    count(engine, "n_late_s", query="behind")
    with pytest.raises(Conflict, match="query behind"):
        engine.queries.remove("n")
    engine.queries.remove("behind")
    engine.queries.remove("n")
    assert [view.name for view in engine.streams()] == ["status", "s"]


def test_late_samples_after_a_restart(tmp_path):
    engine = Engine(tmp_path, epoch="first")
    declare(engine, "s", lateness=1, idle=3)
    count(engine, "s_late")
    del engine
    gc.collect()
    engine = Engine(tmp_path, epoch="second")
    assert engine.stream("s").idle == 3 * SECOND
    assert engine.queries.view("n").state == "running"
    say(engine, "s", 10, 1)
    assert samples(engine, "s_late")[0][0] == 1.0


def test_a_declaration_of_before_there_was_idleness(tmp_path):
    engine = Engine(tmp_path, epoch="first")
    declare(engine, "s", lateness=1)
    kept = json.loads(engine.ontology.registered.streams["s"])
    del kept["idle"]
    engine.ontology.registered.streams["s"] = json.dumps(kept)
    engine.ontology.registered.streams["trains_late"] = json.dumps(kept)
    del engine
    gc.collect()
    engine = Engine(tmp_path, epoch="second")
    assert (engine.stream("s").lateness, engine.stream("s").idle) == (SECOND, None)
    # A name that has become the system's own since.
    declare(engine, "trains_late", lateness=1)
    say(engine, "trains_late", 1)


def test_how_much_is_kept_outlives_a_restart(tmp_path):
    engine = Engine(tmp_path, epoch="first")
    for name, kept in (("s", Retention(7)), ("t", Retention(7, SECOND, 1_000))):
        engine.declare(StreamDeclaration(name, FIELDS, 0, kept))
    # As an earlier version wrote it, which knew of no bytes.
    assert json.loads(engine.ontology.registered.streams["s"])["retention"] == [7, None]
    del engine
    gc.collect()
    engine = Engine(tmp_path, epoch="second")
    assert engine.stream("s").retention == Retention(7)
    assert engine.stream("t").retention == Retention(7, SECOND, 1_000)


# -- idle streams ----------------------------------------------------------------------------


def test_an_idle_stream_holds_no_windows_back(engine):
    declare(engine, "s")
    declare(engine, "t", idle=10)
    count(engine, "s", "t")
    engine.stream("n_late_t")
    say(engine, "t", 4)
    say(engine, "s", 3, 12)
    assert counts(engine) == []
    view = engine.queries.view("n")
    assert (view.watermark, view.held_back_by) == (4 * SECOND, ("t",))
    engine.tick(10 * SECOND)
    assert engine.stream("t").is_idle
    assert counts(engine) == [(5.0, 2)]
    view = engine.queries.view("n")
    assert (view.watermark, view.held_back_by) == (12 * SECOND, ("s",))
    assert "t  (stream, idle)" in engine.queries.explain_running("n")
    say(engine, "s", 21, clock=11)
    assert counts(engine) == [(5.0, 2), (15.0, 1)]
    # It speaks again: what is behind is late for this query; and it is waited for.
    say(engine, "t", 13, 22, clock=12)
    assert not engine.stream("t").is_idle
    assert times(engine, "n_late_t") == [(21.0, 13.0)]
    assert engine.queries.view("n").late == 1
    assert engine.stream("t").counters.late == 0
    say(engine, "s", 40, clock=13)
    assert counts(engine) == [(5.0, 2), (15.0, 1)]
    say(engine, "t", 26, clock=14)
    assert counts(engine) == [(5.0, 2), (15.0, 1), (25.0, 2)]


def test_a_stream_that_never_speaks(engine):
    declare(engine, "s")
    declare(engine, "t", idle=10)
    count(engine, "s", "t")
    say(engine, "s", 1, 6)
    assert engine.queries.view("n").waits_for == ("t",)
    engine.tick(9 * SECOND)
    assert counts(engine) == []
    engine.tick(10 * SECOND)
    assert engine.queries.view("n").waits_for == ()
    assert counts(engine) == [(5.0, 1)]
    count(engine, "t", "s", query="later")  # a query that comes when it is idle already
    say(engine, "s", 7, 12, clock=11)
    assert counts(engine, "later") == [(10.0, 1)]


def test_without_idle_everybody_waits(engine):
    declare(engine, "s")
    declare(engine, "t")
    count(engine, "s", "t")
    say(engine, "s", 1, 6)
    engine.tick(10**6 * SECOND)
    assert counts(engine) == []
    assert engine.queries.view("n").waits_for == ("t",)


def test_what_waits_for_its_order_comes_in_time_when_the_stream_falls_idle(engine):
    declare(engine, "s")
    declare(engine, "t", lateness=5, idle=2)
    count(engine, "s", "t")
    say(engine, "t", 4, 3)
    say(engine, "s", 1, 9)
    engine.tick(2 * SECOND)
    assert engine.stream("t").counters.pending == 0
    assert counts(engine) == [(5.0, 3)]
    say(engine, "t", 2, 6, clock=3)
    assert engine.stream("t").counters.late == 1


def test_all_streams_idle(engine):
    for name in ("s", "t"):
        declare(engine, name, idle=2)
    count(engine, "s", "t")
    say(engine, "s", 1, 12)
    say(engine, "t", 3)
    engine.tick(5 * SECOND)
    # None holds another back: what is known is what the furthest has said.
    assert counts(engine) == [(5.0, 2)]
    assert engine.generator("n").is_idle
    assert engine.queries.view("n").held_back_by == ()


@pytest.mark.parametrize("made", ["query", "join"])
def test_late_samples_of_one_moment_are_available_at_one_time(engine, made):
    """Behind the watermark that an idle stream was moved to, or behind what was given at the end:
    the unit was as far for both."""
    declare(engine, "s", idle=2)
    declare(engine, "t")
    if made == "query":
        count(engine, "s", "t")
    else:
        engine.add_kpl(
            "sort fix = (id string, spd float)\nsource fix s\nsource fix t\n"
            "strmgen of_s = s\nstrmgen of_t = t\nstrmgen n = join(of_s, of_t)"
        )
    engine.stream("n_late_s")
    say(engine, "t", 3, 5)
    engine.tick(2 * SECOND)
    engine.end("s")
    engine.end("t")
    say(engine, "s", 2, 5, 8)
    late = engine.generator("n_late_s").stream.all()
    assert late.valid.tolist() == [2 * SECOND, 5 * SECOND]
    assert late.available.tolist() == [5 * SECOND + 1] * 2


def test_a_late_sample_of_a_stream_that_is_joined_with_itself_counts_once(engine):
    declare(engine, "s")
    engine.add_kpl(
        "sort fix = (id string, spd float)\nsource fix s\nstrmgen of_s = s\n"
        "strmgen n = join(of_s, of_s)"
    )
    engine.stream("n_late_s")
    say(engine, "s", 1, 5)
    engine.end("s")
    feed(engine, "s", [(5, {"id": "uav2", "spd": 5.0})])
    assert engine.stream("s").counters.used == 3
    assert len(times(engine, "n_late_s")) == 1


def test_idleness_passes_through_units(engine):
    declare(engine, "s")
    declare(engine, "t", idle=2)
    say(engine, "t", 1)
    selected = engine.subscribe("t", "any change").stream
    assert not engine.generator(selected).is_idle
    engine.tick(2 * SECOND)
    assert engine.generator(selected).is_idle
    say(engine, "t", 5, clock=3)
    assert not engine.generator(selected).is_idle


def test_a_stream_that_is_stamped_on_arrival_goes_with_the_clock(engine):
    declare(engine, "t", idle=2)
    feed(engine, "t", [(0, {"id": "uav1", "spd": 1.0})], now=SECOND)
    engine.tick(60 * SECOND)
    assert not engine.stream("t").is_idle
    assert engine.stream("t").watermark == 60 * SECOND


def test_how_long_a_stream_may_be_silent_can_be_changed(engine):
    declare(engine, "t")
    say(engine, "t", 1)
    declare(engine, "t", idle=5)
    engine.tick(4 * SECOND)
    assert not engine.stream("t").is_idle
    engine.tick(5 * SECOND)
    assert engine.stream("t").is_idle
    declare(engine, "t")
    assert (engine.stream("t").idle, engine.stream("t").is_idle) == (None, False)
    for idle in (0, -1):
        with pytest.raises(BadArguments, match="must be more than 0"):
            declare(engine, "t", idle=idle)
    engine.declare(StreamDeclaration("t", FIELDS, 0, Retention(7), idle=SECOND))
    assert engine.stream("t").retention == Retention(7)
    with pytest.raises(Conflict):
        engine.declare(StreamDeclaration("t", FIELDS[:1], 0, Retention(7), idle=SECOND))


def test_late_samples_say_that_a_stream_is_not_idle(engine):
    declare(engine, "t", idle=5)
    say(engine, "t", 10)
    say(engine, "t", 1, clock=4)
    engine.tick(8 * SECOND)
    assert not engine.stream("t").is_idle
    engine.end("t")
    engine.tick(20 * SECOND)
    assert not engine.stream("t").is_idle
