"""Networks that follow a set of objects: the paper's cars ([DyKnow10 §4.3], Def. 4.6, 4.7)."""

import gc

import pytest

from dyknow.converters.wire import Incoming
from dyknow.engine.engine import Engine
from dyknow.engine.model.errors import Conflict, UnknownFeature, UnknownStream
from dyknow.engine.model.object_sets import read_sets
from dyknow.engine.processes.registry import Processes
from dyknow.languages.errors import LanguageError
from dyknow.streams.sample import Field, FieldType, Schema, batch_from_rows
from dyknow.streams.time import MILLISECOND as MS

CARS = """
sort fix = (id string, pos float)
source fix all_cars
source object cars_in_sight
source object operator
compunit float SpeedEst(fix)
strmgen positions = all_cars
strmgen cars = cars_in_sight
strmgen focus = operator
foreach car in cars {
  strmgen pos[car] = selectObject(positions)
  strmgen speed[car] = SpeedEst(pos[car])
}
strmgen speeds = aggregate(speed[car] foreach car in cars)
strmgen watched = select(speed[car] foreach car in focus)
stream all_speeds = speeds
"""


@pytest.fixture
def processes():
    registry = Processes()

    @registry.computational_unit("float", ["fix"])
    def SpeedEst(time, samples, state):
        (now,) = samples
        if state is None:
            return None, now
        return (now["pos"] - state["pos"]) / ((now.valid - state.valid) / MS), now

    return registry


@pytest.fixture
def engine(processes):
    return Engine(processes=processes)


def publish(engine, name, *rows):
    generator = engine.generator(name)
    names = generator.schema.names
    timed = [(t * MS, t * MS, dict(zip(names, values, strict=True))) for t, *values in rows]
    batch = batch_from_rows(generator.schema, timed, generator.stream.pools)
    engine.publish(name, Incoming(batch, stamped=False), 0)


def content(engine, name):
    rows = engine.generator(name).stream.all().rows()
    return [(a // MS, *values.values()) for a, _, values in rows]


def labels(engine):
    return sorted(view.name for view in engine.streams() if "[" in view.name)


def test_processes_follow_the_set(engine):
    engine.add_kpl(CARS)
    assert labels(engine) == []
    publish(engine, "cars_in_sight", (0, "car1 car2"))
    assert labels(engine) == ["pos[car1]", "pos[car2]", "speed[car1]", "speed[car2]"]
    publish(engine, "all_cars", (1, "car1", 0.0), (2, "car2", 10.0), (3, "car1", 4.0))
    assert content(engine, "pos[car1]") == [(1, "car1", 0.0), (3, "car1", 4.0)]
    assert content(engine, "speed[car1]") == [(3, 2.0)]
    publish(engine, "cars_in_sight", (4, "car2, car3"))
    # The positions are known up to 3 only: car1 may have said something before it left.
    view, _ = engine.kpl_declaration("foreach car in cars: pos[car], speed[car]")
    assert view.counters == {"objects": 2, "waiting": {}, "leaving": 2}
    publish(engine, "all_cars", (5, "car1", 9.0), (6, "car2", 18.0), (7, "car3", 0.0))
    assert labels(engine) == ["pos[car2]", "pos[car3]", "speed[car2]", "speed[car3]"]
    assert content(engine, "speed[car2]") == [(6, 2.0)]
    publish(engine, "cars_in_sight", (8, None))
    engine.end("all_cars")
    assert labels(engine) == []
    changes = [v["change"] for _, _, v in engine.generator("status").stream.all().rows()]
    assert changes.count("unit stopped") == 6  # a selection and a unit for each of three cars


def test_a_new_object_is_seen_from_the_moment_of_its_set(engine):
    engine.add_kpl(CARS)
    publish(engine, "all_cars", (1, "car1", 0.0), (2, "car1", 5.0), (3, "car1", 6.0))
    publish(engine, "cars_in_sight", (2, "car1"))
    assert content(engine, "pos[car1]") == [(2, "car1", 5.0), (3, "car1", 6.0)]
    assert content(engine, "speed[car1]") == [(3, 1.0)]


def test_what_comes_again_begins_anew(engine):
    engine.add_kpl(CARS)
    publish(engine, "cars_in_sight", (0, "car1"))
    publish(engine, "all_cars", (1, "car1", 0.0), (2, "car1", 5.0))
    publish(engine, "cars_in_sight", (3, ""), (10, "car1"))
    publish(engine, "all_cars", (11, "car1", 50.0), (12, "car1", 53.0))
    assert content(engine, "speed[car1]") == [(12, 3.0)]  # nothing of its first life
    publish(engine, "cars_in_sight", (13, "car1"))
    publish(engine, "all_cars", (13, "car2", 0.0))  # no more of 12
    assert content(engine, "all_speeds") == [(2, "car1", 5.0), (12, "car1", 3.0)]


def test_what_comes_again_is_read_again_under_a_policy(engine):
    engine.add_kpl(CARS)
    engine.add_kpl("strmgen slowly = aggregate(pos[car] with sample every 2 foreach car in cars)")
    publish(engine, "cars_in_sight", (0, "car1"))
    publish(engine, "all_cars", (1, "car1", 1.0), (2, "car1", 2.0), (3, "car1", 3.0))
    publish(engine, "cars_in_sight", (4, ""), (10, "car1"), (20, "car1"))
    publish(engine, "all_cars", (11, "car1", 11.0), (12, "car1", 12.0), (13, "car1", 13.0))
    engine.end("all_cars")
    engine.end("cars_in_sight")
    assert [(t, pos) for t, _, _, pos in content(engine, "slowly")] == [
        *((1, 1.0), (3, 3.0), (11, 11.0), (13, 13.0)),
    ]
    adapted = [view.name for view in engine.streams() if view.name.startswith("dyknow_")]
    assert len(adapted) == 1


def test_one_batch_of_sets_is_as_good_as_many(engine, processes):
    other = Engine(processes=processes)
    sets = [(0, "car1"), (5, "car1 car2"), (9, "car2"), (20, "")]
    for one in (engine, other):
        one.add_kpl(CARS)
    moves = [(t, f"car{1 + t % 2}", float(t * t)) for t in range(1, 20)]
    publish(engine, "all_cars", *moves)
    publish(engine, "cars_in_sight", *sets[:3])
    publish(other, "all_cars", *moves[:7])
    publish(other, "all_cars", *moves[7:])
    for one in sets[:3]:
        publish(other, "cars_in_sight", one)
    assert content(engine, "speed[car2]") == content(other, "speed[car2]") != []
    assert labels(engine) == labels(other)


def test_aggregation_says_whose_a_sample_is(engine):
    engine.add_kpl(CARS)
    publish(engine, "cars_in_sight", (0, "car1 car2"))
    publish(engine, "all_cars", *[(t, f"car{1 + t % 2}", float(t * t)) for t in range(1, 9)])
    publish(engine, "cars_in_sight", (9, "car1 car2"))
    # What one car said is decided once the other cannot have said anything before it.
    publish(engine, "all_cars", (10, "car3", 0.0))
    assert content(engine, "all_speeds") == [
        (3, "car2", 4.0),
        (4, "car1", 6.0),
        (5, "car2", 8.0),
        (6, "car1", 10.0),
        (7, "car2", 12.0),
        (8, "car1", 14.0),
    ]
    view, _ = engine.kpl_declaration("speeds")
    assert view.counters == {"inputs": 2, "without stream": []}


def test_selection_follows_the_focus(engine):
    engine.add_kpl(CARS)
    publish(engine, "cars_in_sight", (0, "car1 car2"))
    publish(engine, "operator", (0, "car1"))
    publish(engine, "all_cars", *[(t, f"car{1 + t % 2}", float(t * t)) for t in range(1, 6)])
    publish(engine, "operator", (6, "car2"))
    publish(engine, "all_cars", *[(t, f"car{1 + t % 2}", float(t * t)) for t in range(6, 10)])
    publish(engine, "operator", (10, "car7"))
    assert content(engine, "watched") == []  # nobody has said that the cars were in sight still
    publish(engine, "cars_in_sight", (10, "car1 car2"))
    publish(engine, "all_cars", (10, "car3", 0.0))  # no more of 9
    assert content(engine, "watched") == [(4, 6.0), (7, 12.0), (9, 16.0)]
    assert engine.kpl_declaration("watched")[0].counters["without stream"] == ["car7"]


def test_stamped_streams_do_not_wait_for_silent_ones(engine):
    """The clock tells that nobody has said anything."""
    engine.add_kpl(CARS)

    def say(name, now, *values):
        generator = engine.generator(name)
        row = (now * MS, now * MS, dict(zip(generator.schema.names, values, strict=True)))
        batch = batch_from_rows(generator.schema, [row], generator.stream.pools)
        engine.publish(name, Incoming(batch, stamped=True), now * MS)

    say("cars_in_sight", 1, "car1 car2")
    say("all_cars", 2, "car1", 0.0)
    say("all_cars", 3, "car1", 2.0)
    engine.tick(4 * MS)
    assert content(engine, "all_speeds") == [(3, "car1", 2.0)]


def test_mediation_of_declared_streams(engine):
    """Without foreach: the pattern names generators that were declared one by one."""
    engine.add_kpl(
        "source float a\nsource float b\nsource object who\nstrmgen p[one] = a\n"
        "strmgen p[two] = b\nstrmgen members = who\n"
        "strmgen both = aggregate(p[x] with any change foreach x in members)"
    )
    publish(engine, "who", (0, '["one", "two", "three"]'))
    publish(engine, "a", (1, 1.0), (2, 1.0), (3, 2.0))
    publish(engine, "b", (2, 5.0), (4, 6.0))
    engine.end("a")
    engine.end("b")
    assert content(engine, "both") == []  # a set from 1 on might leave one out
    engine.end("who")
    assert content(engine, "both") == [
        *((1, "one", 1.0), (2, "one", 1.0), (2, "two", 5.0)),
        *((3, "one", 2.0), (4, "two", 6.0)),
    ]
    rows = list(engine.generator("both").stream.all().rows())
    assert [a for a, _, _ in rows] == [1 * MS, 2 * MS, 2 * MS, 3 * MS, 4 * MS]
    engine.add_kpl("source float c\nstrmgen p[three] = c")
    publish(engine, "c", (9, 7.0))
    engine.end("c")
    assert content(engine, "both")[-1] == (9, "three", 7.0)


@pytest.mark.parametrize("policy", ["", " with any change"])
def test_an_object_that_leaves_and_enters_in_an_instant_has_never_left(engine, policy):
    """Of an instant the last set holds, however the sets came."""
    engine.add_kpl(
        "source float a\nsource object who\nstrmgen p[one] = a\nstrmgen members = who\n"
        f"strmgen all = aggregate(p[x]{policy} foreach x in members)"
    )
    publish(engine, "a", (1, 1.0), (1, 2.0))
    for members in ("one", None, "one,", "two", "one two"):
        publish(engine, "who", (1, members))
    publish(engine, "who", (2, None))
    for name in ("a", "who"):
        engine.end(name)
    assert content(engine, "all") == [(1, "one", 1.0), (1, "one", 2.0)]


def test_what_waits_for_an_input_starts_when_it_is_there(engine):
    engine.add_kpl(
        "source float a\nsource object who\nstrmgen p[one] = a\nstrmgen members = who\n"
        "foreach x in members { strmgen q[x] = join(p[x]) }"
    )
    publish(engine, "who", (0, "one two"))
    assert labels(engine) == ["q[one]"]
    key = "foreach x in members: q[x]"
    assert engine.kpl_declaration(key)[0].counters["waiting"] == {"q[two]": "there is no p[two]"}
    engine.add_kpl("source float b\nstrmgen p[two] = b")
    assert labels(engine) == ["q[one]", "q[two]"]
    engine.remove_kpl("b", cascade=True)
    assert labels(engine) == ["q[one]"]
    assert engine.kpl_declaration(key)[0].counters["waiting"] == {"q[two]": "there is no p[two]"}


def test_a_set_that_names_nothing_is_told_and_left_out(engine):
    engine.add_kpl(CARS)
    publish(engine, "cars_in_sight", (0, "car1"), (1, "[car2"), (2, "car1 car2"))
    assert "speed[car2]" in labels(engine)
    view, _ = engine.kpl_declaration("foreach car in cars: pos[car], speed[car]")
    assert view.errors == 1
    assert "not a JSON list" in view.last_error


def test_removal(engine):
    engine.add_kpl(CARS)
    publish(engine, "cars_in_sight", (0, "car1"))
    with pytest.raises(Conflict):
        engine.remove_kpl("cars")
    engine.remove_kpl("foreach car in cars: pos[car], speed[car]", cascade=True)
    assert labels(engine) == []
    with pytest.raises(UnknownStream):
        engine.generator("all_speeds")
    engine.remove_kpl("all_cars", cascade=True)
    engine.remove_kpl("cars_in_sight", cascade=True)
    engine.remove_kpl("operator", cascade=True)
    assert [view.name for view in engine.streams()] == ["status"]
    assert engine.ontology.query_rows("SELECT * { ?u :instantiationOf ?of }")[1] == []


def test_it_survives_a_restart(tmp_path, processes):
    first = Engine(tmp_path, processes=processes)
    first.add_kpl(CARS)
    text = first.kpl_text()
    del first
    gc.collect()
    again = Engine(tmp_path, processes=processes)
    assert again.kpl_text() == text
    publish(again, "cars_in_sight", (0, "car1"))
    assert labels(again) == ["pos[car1]", "speed[car1]"]
    del again
    gc.collect()
    poorer = Engine(tmp_path, processes=Processes())
    assert "foreach" not in poorer.kpl_text()
    poorer.add_kpl("source float x")
    del poorer
    gc.collect()
    assert "foreach" in Engine(tmp_path, processes=processes).kpl_text()


def test_a_thousand_objects(engine):
    engine.add_kpl(
        "sort fix = (id string, pos float)\nsource fix all\nsource object sight\n"
        "strmgen positions = all\nstrmgen cars = sight\n"
        "foreach car in cars { strmgen pos[car] = selectObject(positions) }"
    )
    names = [f"car{i}" for i in range(1_000)]
    publish(engine, "sight", (0, " ".join(names)))
    publish(engine, "all", *[(t, f"car{t * 7 % 1000}", float(t)) for t in range(1, 50)])
    assert content(engine, "pos[car7]") == [(1, "car7", 1.0)]
    publish(engine, "sight", (100, " ".join(names[500:])))
    publish(engine, "all", (100, "car7", 7.0))
    assert len(labels(engine)) == 500


# -- sinks -------------------------------------------------------------------------------------


def test_a_sink_gets_what_comes_from_now_on(engine, processes):
    seen = []
    processes.consumer(["float", "float"], name="Log")(
        lambda sample, number: seen.append((number, sample.value))
    )
    engine.add_kpl("source float a\nsource float b\nstrmgen p[x] = a\nstrmgen q[x] = b")
    publish(engine, "a", (1, 1.0))
    engine.add_kpl("sink Log(p[x], q[x] with any change)")
    publish(engine, "a", (2, 2.0))
    publish(engine, "b", (2, 5.0), (3, 6.0))
    assert seen == [(0, 2.0), (1, 5.0), (1, 6.0)]
    with pytest.raises(Conflict, match="Log"):
        engine.remove_kpl("p[x]")
    assert len(engine.ontology.query_rows("SELECT * { ?s a :Sink ; :hasInput ?i }")[1]) == 2
    engine.remove_kpl("a", cascade=True)
    publish(engine, "b", (4, 7.0))
    assert len(seen) == 3
    # The adapted stream that only the sink read is gone.
    assert {view.name for view in engine.streams()} == {"status", "b"}


def test_a_sink_without_code_is_refused(engine, processes):
    engine.add_kpl("source float a\nstrmgen p[x] = a")
    with pytest.raises(UnknownFeature, match=r"@dyknow\.sink"):
        engine.add_kpl("sink Nobody(p[x])")
    processes.consumer(["float", "float"], name="Two")(lambda sample, number: None)
    with pytest.raises(Conflict, match="takes 2"):
        engine.add_kpl("sink Two(p[x])")
    with pytest.raises(LanguageError):
        engine.add_kpl("sink Two(nothing[x])")


def test_a_sink_that_fails_is_told(engine, processes):
    @processes.consumer(["float"], on_error="stop")
    def Breaks(sample):
        raise RuntimeError("full")

    engine.add_kpl("source float a\nstrmgen p[x] = a\nsink Breaks(p[x])\nstream s = p[x]")
    publish(engine, "a", (1, 1.0), (2, 2.0))
    assert "full" in engine.kpl_declaration("Breaks")[0].failure
    changes = [v["change"] for _, _, v in engine.generator("status").stream.all().rows()]
    assert changes[-2:] == ["unit failed", "unit stopped by rule"]
    assert content(engine, "s") == [(1, 1.0), (2, 2.0)]


# -- label sets --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("car1", ("car1",)),
        ("car1 car2,car3,  car1", ("car1", "car2", "car3")),
        ("", ()),
        (None, ()),
        ('["car 1", "b,c"]', ("car 1", "b,c")),
        ("[]", ()),
    ],
)
def test_ways_to_write_a_set(text, found):
    schema = Schema((Field("other", FieldType.FLOAT), Field("value", FieldType.STRING)))
    batch = batch_from_rows(schema, [(7, 0, {"other": 1.0, "value": text})])
    assert list(read_sets(batch)) == [(7, found)]


@pytest.mark.parametrize("text", ["[car1", "[1]", "[" * 100_000, '["\\ud800"]', '[""]', "[{}]"])
def test_what_is_no_set_says_why(text):
    schema = Schema((Field("value", FieldType.STRING),))
    ((_, reason),) = read_sets(batch_from_rows(schema, [(0, 0, {"value": text})]))
    assert isinstance(reason, str)
    assert len(reason) < 150


def test_numbers_name_objects_too():
    schema = Schema((Field("mmsi", FieldType.INTEGER),))
    assert list(read_sets(batch_from_rows(schema, [(0, 0, {"mmsi": 265})]))) == [(0, ("265",))]
    floats = batch_from_rows(Schema((Field("x", FieldType.FLOAT),)), [(0, 0, {"x": 1.0})])
    assert list(read_sets(floats)) == [
        (0, "no field names objects: there is no text or integer among x")
    ]


def test_what_is_told_of_streams_that_others_replace_is_told_in_one_order():
    """So that it is the same when commands are done again."""

    def told():
        engine = Engine()
        engine.add_kpl(
            "sort row = (id string, x float)\nsource row r\nsource object m\n"
            "strmgen row = r\nstrmgen members = m\n"
            "foreach x in members { strmgen one[x] = selectObject(row) }\n"
            "strmgen all = aggregate(one[x] foreach x in members)"
        )
        names = "abcdefgh"
        publish(engine, "r", *((i, name, 1.0) for i, name in enumerate(names)))
        publish(engine, "m", (10, " ".join(names)))
        publish(engine, "m", (12, None))
        publish(engine, "m", (13, " ".join(names)))
        publish(engine, "r", *((14 + i, name, 1.0) for i, name in enumerate(names)))
        publish(engine, "r", *((30 + i, name, 1.0) for i, name in enumerate(names)))
        rows = engine.generator("status").stream.all().rows()
        return [v["inputs"] for _, _, v in rows if v["change"] == "inputs changed"]

    first = told()
    assert len(first) > 8
    assert all(told() == first for _ in range(3))
