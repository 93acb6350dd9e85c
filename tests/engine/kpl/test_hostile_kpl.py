"""KPL where things go wrong: ends, clocks, names, removals, restarts, sets that run ahead."""

import gc

import pytest

from dyknow.converters.wire import Incoming
from dyknow.engine.engine import Engine
from dyknow.engine.model.errors import Conflict, NoPlan, Refused, UnknownStream
from dyknow.engine.model.views import StreamDeclaration
from dyknow.engine.processes.registry import Processes
from dyknow.streams.sample import Field, FieldType, batch_from_rows
from dyknow.streams.time import MILLISECOND as MS

TWO = "source float a\nsource float b\nstrmgen f[o] = a\nstrmgen g[o] = b\n"


@pytest.fixture
def processes():
    return Processes()


@pytest.fixture
def engine(processes):
    return Engine(processes=processes)


def publish(engine, name, *rows, now=None):
    generator = engine.generator(name)
    names = generator.schema.names
    timed = [(t * MS, t * MS, dict(zip(names, values, strict=True))) for t, *values in rows]
    batch = batch_from_rows(generator.schema, timed, generator.stream.pools)
    engine.publish(name, Incoming(batch, now is not None), (now or 0) * MS)


def content(engine, name):
    rows = engine.generator(name).stream.all().rows()
    return [(a // MS, *values.values()) for a, _, values in rows]


# -- ends and clocks ---------------------------------------------------------------------------


@pytest.mark.parametrize("process", ["join(f[o], g[o])", "sync(f[o], g[o]; any change)"])
def test_a_second_recording_after_the_end(engine, process):
    engine.add_kpl(TWO + f"strmgen j[o] = {process}")
    for start in (0, 100):
        publish(engine, "a", (start + 1, 1.0), (start + 3, 2.0))
        publish(engine, "b", (start + 1, 5.0), (start + 2, 6.0))
        engine.end("a")
        engine.end("b")
    assert engine.kpl_declaration("j[o]")[0].failure is None
    assert engine.generator("j[o]").stream.last_available == 103 * MS


def test_taken_up_again_both_ways_to_a_join_wait(engine):
    """The direct way must not run ahead of the one through a policy."""
    text = "source float a\nstrmgen f[o] = a\nstrmgen j[o] = join(f[o], f[o] with strict order)\n"
    whole, cut = engine, Engine(processes=Processes())
    for one in (whole, cut):
        one.add_kpl(text)
    publish(whole, "a", (1, 1.0), (2, 2.0), (5, 5.0))
    publish(cut, "a", (1, 1.0), (2, 2.0))
    cut.end("a")
    publish(cut, "a", (5, 5.0))
    whole.end("a")
    cut.end("a")
    assert content(cut, "j[o]") == content(whole, "j[o]")
    assert content(cut, "j[o]")[-1] == (5, 5.0, 5.0)


def test_a_sample_behind_the_clock_is_late_and_counted(engine):
    engine.add_kpl(TWO + "strmgen j[o] = join(f[o], g[o])")
    publish(engine, "a", (100, 1.0), now=100)
    engine.tick(101 * MS)
    publish(engine, "b", (100, 2.0), (102, 3.0))
    view, _ = engine.kpl_declaration("j[o]")
    assert view.failure is None
    assert view.counters["late"] == 1
    engine.tick(103 * MS)
    engine.end("b")
    assert content(engine, "j[o]")[-1] == (102, 1.0, 3.0)


# -- sets --------------------------------------------------------------------------------------

MEDIATED = (
    "source float a\nsource object who\nstrmgen p[one] = a\nstrmgen members = who\n"
    "strmgen all = aggregate(p[x] foreach x in members)\n"
    "strmgen last = select(p[x] foreach x in members)\n"
)


def test_a_bad_set_is_told_and_left_out_everywhere(engine):
    engine.add_kpl(MEDIATED)
    publish(engine, "who", (0, "[one"), (1, "one"))
    publish(engine, "a", (1, 1.0), (2, 2.0))
    engine.end("a")
    engine.end("who")
    for name in ("all", "last"):
        view, _ = engine.kpl_declaration(name)
        assert (view.failure, view.errors) == (None, 1)
        assert [row[0] for row in content(engine, name)] == [1, 2]


@pytest.mark.parametrize("first", ["who", "a"])
def test_sets_may_run_ahead_of_samples_and_behind(engine, first):
    engine.add_kpl(MEDIATED)
    rows = {"who": [(0, "one"), (5, ""), (8, "one")], "a": [(t, float(t)) for t in range(1, 10)]}
    for name in (first, *(other for other in rows if other != first)):
        publish(engine, name, *rows[name])
    engine.end("a")
    engine.end("who")
    for name in ("all", "last"):
        assert [row[0] for row in content(engine, name)] == [1, 2, 3, 4, 8, 9]


@pytest.mark.parametrize("cuts", [1, 2, 50])
@pytest.mark.parametrize("first", ["sets", "moves"])
def test_a_foreach_depends_on_times_alone(engine, cuts, first):
    engine.add_kpl(
        "sort fix = (id string, pos float)\nsource fix moves\nsource object sets\n"
        "strmgen positions = moves\nstrmgen cars = sets\n"
        "foreach car in cars {\n strmgen pos[car] = selectObject(positions)\n"
        " strmgen even[car] = join(pos[car] with sample every 2)\n}\n"
        "strmgen out = aggregate(even[car] foreach car in cars)"
    )
    rows = {
        "sets": [(0, "a"), (5, "a b"), (9, "b"), (14, "a"), (17, "")],
        "moves": [(t, "ab"[t % 2], float(t)) for t in range(1, 20)],
    }
    for name in (first, *(other for other in rows if other != first)):
        for i in range(0, len(rows[name]), cuts):
            publish(engine, name, *rows[name][i : i + cuts])
    engine.end("sets")
    engine.end("moves")
    assert [(t, car) for t, car, *_ in content(engine, "out")] == [
        *((2, "a"), (4, "a"), (5, "b"), (6, "a"), (7, "b"), (8, "a"), (9, "b"), (11, "b")),
        *((13, "b"), (14, "a"), (16, "a")),
    ]
    assert not [view.name for view in engine.streams() if "[" in view.name]


POLICIES = [
    *("any change", "max delay 5", "monotone order, max delay 16", "sample every 1"),
    "sample every 1, max delay 1, from 0 to 40, use most recent",
]


@pytest.mark.parametrize("policy", POLICIES)
@pytest.mark.parametrize("one_by_one", [False, True])
@pytest.mark.parametrize("order", ["d S F", "d F S", "S d F", "S F d", "F d S"])
def test_lives_under_a_policy_know_nothing_of_each_other(processes, policy, order, one_by_one):
    """A unit with state: its second life begins anew, also where the sets come last."""

    @processes.computational_unit("float", ["fix"])
    def Sum(time, samples, state):
        total = (state or 0.0) + samples[0]["pos"]
        return total, total

    sets = [(0, "a"), (10, ""), (20, "a")]
    fixes = [(5, "a", 1.0), (15, "a", 7.0), (25, "a", 2.0)]
    sources = (
        "sort fix = (id string, pos float)\nsource fix moves\nsource object sets\n"
        "compunit float Sum(fix)\nstrmgen positions = moves\nstrmgen cars = sets\n"
    )
    network = (
        "foreach car in cars {\n strmgen pos[car] = selectObject(positions)\n"
        " strmgen sum[car] = Sum(pos[car])\n}\n"
        f"strmgen out = aggregate(sum[car] with {policy} foreach car in cars)"
    )

    def played(order, one_by_one):
        engine = Engine(processes=processes)
        engine.add_kpl(sources)
        for step in order.split():
            if step == "d":
                engine.add_kpl(network)
                continue
            name, rows = ("sets", sets) if step == "S" else ("moves", fixes)
            for some in [[row] for row in rows] if one_by_one else [rows]:
                publish(engine, name, *some)
        engine.end("moves")
        engine.end("sets")
        assert len([view for view in engine.streams() if view.name.startswith("sum")]) == 1
        return content(engine, "out")

    def reference():
        engine = Engine(processes=processes)
        engine.add_kpl(sources + network)
        for _, name, row in sorted(
            [(row[0], "sets", row) for row in sets] + [(row[0], "fixes", row) for row in fixes],
            key=lambda item: (item[0], item[1] != "sets"),
        ):
            publish(engine, "sets" if name == "sets" else "moves", row)
        engine.end("moves")
        engine.end("sets")
        return content(engine, "out")

    assert played(order, one_by_one) == reference()
    assert {value for *_, value in reference()} <= {1.0, 2.0}


def test_a_foreach_declared_late_is_what_it_would_have_been(engine):
    engine.add_kpl("source float a\nsource object who\nstrmgen p[one] = a\nstrmgen members = who")
    publish(engine, "who", (0, "one"), (9, "one two"))
    publish(engine, "a", (1, 1.0), (2, 2.0), (10, 3.0))
    engine.add_kpl("foreach x in members { strmgen q[x] = join(p[x]) }")
    publish(engine, "a", (11, 4.0))  # no more of 10
    assert [row[0] for row in content(engine, "q[one]")] == [1, 2, 10]


def test_the_status_stream_is_no_source(engine):
    with pytest.raises(Refused, match="made by the system"):
        engine.add_kpl("source state status")


def test_an_instance_follows_its_input_into_its_second_life(engine):
    engine.add_kpl(
        "sort fix = (id string, pos float)\nsource fix moves\nsource object one\n"
        "source object other\nstrmgen positions = moves\nstrmgen a = one\nstrmgen b = other\n"
        "foreach car in a { strmgen pos[car] = selectObject(positions) }\n"
        "foreach c in b { strmgen speed[c] = join(pos[c]) }"
    )
    publish(engine, "other", (0, "x"))
    publish(engine, "one", (0, "x"), (3, ""), (10, "x"))
    publish(engine, "moves", (1, "x", 1.0), (4, "x", 4.0), (11, "x", 11.0))
    publish(engine, "moves", (12, "y", 0.0))  # no more of 11
    assert [row[0] for row in content(engine, "speed[x]")][-1:] == [11]


# -- names, removal, restart -------------------------------------------------------------------


def test_put_does_not_touch_a_running_stream(engine):
    engine.add_kpl("source float a\nstrmgen f[o] = a\nstream q = f[o]")
    with pytest.raises(Refused):
        engine.declare(StreamDeclaration("q", (Field("other", FieldType.FLOAT),)))
    publish(engine, "a", (1, 1.0))
    assert content(engine, "q") == [(1, 1.0)]


def test_an_annotation_goes_with_its_stream(tmp_path, processes, high_speed):
    sort = "sort s = (id string, spd float)\nsource s raw\nstrmgen all = raw\n"
    first = Engine(tmp_path, processes=processes)
    first.add_kpl(sort + "stream fast = all")
    first.annotate("stream fast contains speed(UAV) = spd [km.h-1] for every UAV = id")
    first.register_template(high_speed)
    first.remove_kpl("fast")
    request = first.parse_request("dyknow:HighSpeedEvent(?o, dyknow:UAV, 100)")
    with pytest.raises(NoPlan):
        first.request_event(request)
    del first
    gc.collect()
    again = Engine(tmp_path, processes=processes)
    with pytest.raises(UnknownStream):
        again.generator("fast")
    again.add_kpl("stream fast = all")


def test_an_alias_is_not_annotated(engine):
    engine.add_kpl("sort s = (id string, spd float)\nsource s raw\nstrmgen all = raw")
    before = engine.annotations()
    with pytest.raises(Refused, match="raw"):
        engine.annotate("stream all contains speed(UAV) = spd [km.h-1] for every UAV = id")
    assert engine.annotations() == before


def test_the_kept_text_can_be_declared_after_removals(tmp_path, processes):
    first = Engine(tmp_path, processes=processes)
    first.add_kpl(MEDIATED + "stream out = all")
    first.add_kpl("source float b\nstrmgen p[two] = b")
    first.remove_kpl("p[one]")
    text = first.kpl_text()
    del first
    gc.collect()
    again = Engine(tmp_path, processes=processes)
    assert again.kpl_text() == text
    assert "stream out = all" in text
    assert not [view for view in again.kpl() if view.kind == "not restored"]


def test_a_subscription_ends_with_its_stream_and_is_in_nobodys_way(engine):
    engine.add_kpl("source float p\nstrmgen f = p")
    view = engine.subscribe("p", "strict order")
    engine.remove_kpl("p", cascade=True)
    assert engine.generator(view.stream).is_ended
    engine.declare(StreamDeclaration("p", (Field("value", FieldType.FLOAT),)))
    engine.remove_stream("p")
    engine.unsubscribe(view.id)
    assert [one.name for one in engine.streams()] == ["status"]


def test_code_of_a_source_is_not_passed_over_silently(engine, processes):
    processes.sampled("float", "100ms", name="Thermometer")(lambda time: 1.0)
    engine.declare(StreamDeclaration("Thermometer", (Field("value", FieldType.FLOAT),)))
    with pytest.raises(Conflict, match=r"@dyknow\.source"):
        engine.add_kpl("source float Thermometer")


def test_a_stream_that_stays_does_not_hold_up_a_removal(engine, high_speed):
    fields = (Field("id", FieldType.STRING), Field("spd", FieldType.FLOAT))
    engine.declare(StreamDeclaration("gps", fields))
    engine.annotate("stream gps contains speed(UAV) = spd [km.h-1] for every UAV = id")
    engine.register_template(high_speed)
    engine.request_event(engine.parse_request("dyknow:HighSpeedEvent(?o, dyknow:UAV, 100)"))
    engine.add_kpl("sort s = (id string, spd float)\nsource s gps\nstrmgen all = gps")
    assert engine.remove_kpl("gps", cascade=True) == ("all", "gps")
    assert engine.stream("gps").annotation is not None


def test_a_key_goes_with_its_stream(engine):
    def send():
        generator = engine.generator("p")
        batch = batch_from_rows(generator.schema, [(1, 1, {"value": 1.0})])
        return engine.publish("p", Incoming(batch, False), 0, idempotency_key="k")

    engine.add_kpl("source float p")
    send()
    engine.remove_kpl("p")
    engine.add_kpl("source float p")
    send()
    assert engine.stream("p").counters.used == 1


def test_names_of_the_ontology_are_not_for_code(engine, processes):
    processes.computational_unit("float", ["float"], name="Stream")(lambda t, s, i: (None, i))
    with pytest.raises(Refused, match="the system uses the name"):
        engine.add_kpl("compunit float Stream(float)")


def test_diamonds_and_long_chains_cost_what_they_are(engine):
    levels = 30
    text = "source float a\nstrmgen f[l0] = a\n" + "\n".join(
        f"strmgen f[l{i}] = join(f[l{i - 1}], f[l{i - 1}] with any change)"
        if i == 1
        else f"strmgen f[l{i}] = sync(f[l{i - 1}], f[l{i - 1}] with any change; any change)"
        for i in range(1, 4)
    )
    engine.add_kpl(text)
    engine.add_kpl(
        "\n".join(
            f"strmgen h[l{i}] = join(h[l{i - 1}])" if i else "strmgen h[l0] = join(f[l0])"
            for i in range(levels)
        )
    )
    publish(engine, "a", (1, 1.0), now=1)
    engine.tick(2 * MS)
    assert len(content(engine, f"h[l{levels - 1}]")) == 1
