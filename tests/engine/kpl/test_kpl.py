"""KPL in the running engine: declared, fed, watched, removed, kept."""

import gc

import numpy as np
import pytest

from dyknow.converters.errors import WireError
from dyknow.converters.ndjson import decode_ndjson
from dyknow.converters.wire import Incoming
from dyknow.engine.engine import Engine
from dyknow.engine.model.errors import (
    AlreadyExists,
    Conflict,
    Refused,
    UnknownDeclaration,
    UnknownFeature,
    UnknownStream,
)
from dyknow.engine.model.views import StreamDeclaration
from dyknow.engine.processes.registry import Processes
from dyknow.languages.errors import LanguageError
from dyknow.languages.kpl import parse_policy
from dyknow.streams.history import Retention
from dyknow.streams.policies.satisfaction import prove
from dyknow.streams.sample import Field, FieldType, batch_from_rows
from dyknow.streams.time import MILLISECOND as MS

CARS = """
sort pos = float
source pos pos_car1
compunit speed SpeedEst(pos)
strmgen pos[car1] = pos_car1
strmgen speed[car1] = SpeedEst(pos[car1] with sample every 200)
stream speed_car1 = speed[car1] with from 300 to 400
"""


@pytest.fixture
def processes():
    registry = Processes()

    @registry.computational_unit("speed", ["pos"])
    def SpeedEst(time, samples, state):
        """Example 5.6."""
        (pos,) = samples
        if state is None:
            return None, pos
        return (pos.value - state.value) / ((pos.valid - state.valid) / MS), pos

    return registry


@pytest.fixture
def engine(processes):
    return Engine(processes=processes)


def publish(engine, name, *rows):
    """``(available, valid, values…)`` in ms."""
    generator = engine.generator(name)
    names = generator.schema.names
    timed = [(a * MS, v * MS, dict(zip(names, values, strict=True))) for a, v, *values in rows]
    batch = batch_from_rows(generator.schema, timed, generator.stream.pools)
    engine.publish(name, Incoming(batch, stamped=False), 0)


def content(engine, name):
    rows = engine.generator(name).stream.all().rows()
    return [(a // MS, v // MS, *values.values()) for a, v, values in rows]


def status(engine):
    return [
        (values["change"], values["stream"], values["transformation"])
        for _, _, values in engine.generator("status").stream.all().rows()
    ]


def asked(engine, pattern):
    _, rows = engine.ontology.query_rows(f"SELECT * WHERE {{ {pattern} }}")
    return sorted(tuple(term.value.split("#")[-1] for term in row) for row in rows)


def test_example_5_5_runs(engine):
    """The paper's application, with the samples of Example 5.6."""
    added = engine.add_kpl(CARS)
    names = ["sort pos", "pos_car1", "SpeedEst", "pos[car1]", "speed[car1]", "speed_car1"]
    assert [view.name for view in added] == names
    assert [view.kind for view in added] == [
        *("sort", "source", "compunit", "strmgen", "strmgen", "stream")
    ]
    publish(engine, "pos_car1", (280, 200, 1000.0), (390, 300, 1300.0), (510, 400, 1600.0))
    assert content(engine, "speed[car1]") == [(510, 400, 3.0)]
    assert content(engine, "speed_car1") == [(510, 400, 3.0)]
    view, users = engine.kpl_declaration("speed_car1")
    assert users == ()
    assert view.counters["received"] == view.counters["sent"] == 1
    assert view.uses == ("speed[car1]",)


F1 = [(250, 200, 1.0), (325, 300, 2.0), (430, 400, 3.0), (505, 500, 4.0)]
"""pos[car1] in Example 5.6: positions p1 … p4 of the traffic example (Example 5.1)."""


def test_example_5_7_values_of_a_source_are_of_its_sort(engine):
    engine.add_kpl(CARS)
    generator = engine.generator("pos_car1")
    assert {field.type for field in generator.schema.fields} == {FieldType.FLOAT}
    line = b'{"valid": 200, "available": 250, "value": "p1"}'
    with pytest.raises(WireError, match="'value' is a float"):
        decode_ndjson(line, generator.schema, generator.stream.pools)


def test_example_5_8_a_label_is_what_its_source_gives(engine):
    engine.add_kpl(CARS)
    publish(engine, "pos_car1", *F1)
    assert content(engine, "pos[car1]") == F1


def test_example_5_11_is_one_of_the_streams_of_the_term(engine):
    """What the system makes is another one of them: it sends at once what may be sent."""
    engine.add_kpl(CARS)
    engine.add_kpl("stream every200 = pos[car1] with sample every 200")
    publish(engine, "pos_car1", *F1)
    assert content(engine, "every200") == [(250, 200, 1.0), (430, 400, 3.0)]
    whole = engine.generator("pos_car1").stream.all()
    policy = parse_policy("sample every 200")
    for times in ([250, 430], [280, 480]):  # ours, and the paper's f
        made = whole.take(np.array([0, 2])).with_available(np.array(times, np.int64) * MS)
        assert prove(made, whole, policy) is None


def test_a_label_of_a_source_is_its_stream(engine):
    engine.add_kpl(CARS)
    assert engine.generator("pos[car1]") is engine.generator("pos_car1")
    assert engine.kpl_declaration("pos[car1]")[0].stream == "pos_car1"


def test_what_is_added_later_begins_with_what_is_kept(engine):
    engine.add_kpl(CARS)
    publish(engine, "pos_car1", (280, 200, 1000.0), (510, 400, 1600.0))
    engine.add_kpl("stream again = speed[car1]\nstream positions = pos[car1] with from 300")
    assert content(engine, "again") == [(510, 400, 3.0)]
    assert content(engine, "positions") == [(510, 400, 1600.0)]
    publish(engine, "pos_car1", (700, 600, 1000.0))
    assert content(engine, "again") == [(510, 400, 3.0), (700, 600, -3.0)]


def test_equal_terms_share_one_stream(engine):
    engine.add_kpl(CARS)
    streams = len(engine.streams())
    engine.add_kpl("strmgen other[car1] = SpeedEst(pos[car1] with sample every 200)")
    assert len(engine.streams()) == streams + 1  # only the label's own


def test_the_same_again_changes_nothing(engine):
    engine.add_kpl(CARS)
    before = status(engine)
    assert engine.add_kpl(CARS) == ()
    assert status(engine) == before


@pytest.mark.parametrize(
    ("text", "error", "words"),
    [
        ("stream x = nowhere[car1]", LanguageError, "nowhere"),
        ("compunit pos Missing(pos)\nstrmgen m = Missing(pos[car1])", UnknownFeature, "Missing"),
        ("sort pace = float\nsource pace pos_car2\nstream taken = pos[car1]", AlreadyExists, ""),
        ("stream status2 = pos[car1]\nstream dyknow_x = pos[car1]", Refused, "dyknow_x"),
        ("stream sync = pos[car1]", LanguageError, "sync"),
    ],
)
def test_refused_whole(engine, text, error, words):
    engine.add_kpl(CARS)
    engine.declare(StreamDeclaration("taken", (Field("value", FieldType.FLOAT),)))
    streams, told = engine.streams(), status(engine)
    with pytest.raises(error) as refused:
        engine.add_kpl(text)
    assert words in str(refused.value)
    assert [view.name for view in engine.streams()] == [view.name for view in streams]
    assert status(engine) == told
    assert engine.kpl_text().count("\n") == 6


def test_code_and_declaration_must_agree(engine):
    with pytest.raises(Conflict) as refused:
        engine.add_kpl("source pos p\ncompunit pace SpeedEst(pos)")
    assert "compunit speed SpeedEst(pos)" in str(refused.value)
    assert engine.kpl() == ()


def test_a_declared_stream_may_be_a_source(engine):
    fields = (Field("lat", FieldType.FLOAT), Field("lon", FieldType.FLOAT))
    engine.declare(StreamDeclaration("gps", fields))
    with pytest.raises(Conflict, match="lat float, lon float"):
        engine.add_kpl("source float gps")
    engine.add_kpl("sort place = (lat float, lon float)\nsource place gps\nstrmgen place = gps")
    publish(engine, "gps", (1, 1, 58.4, 15.6))
    assert content(engine, "place") == [(1, 1, 58.4, 15.6)]
    with pytest.raises(Conflict, match="DELETE /kpl/gps"):
        engine.remove_stream("gps")
    engine.remove_kpl("gps", cascade=True)
    assert content(engine, "gps") == [(1, 1, 58.4, 15.6)]  # it was there before KPL
    engine.remove_stream("gps")


def test_removal_is_refused_or_cascades(engine):
    engine.add_kpl(CARS)
    engine.add_kpl("stream more = pos[car1] with any change")
    with pytest.raises(Conflict, match="speed_car1"):
        engine.remove_kpl("pos_car1")
    assert engine.kpl_declaration("pos_car1")[1] == (
        *("more", "speed_car1", "speed[car1]", "pos[car1]"),
    )
    assert engine.remove_kpl("speed[car1]", cascade=True) == ("speed_car1", "speed[car1]")
    names = {view.name for view in engine.streams()}
    # The adapted stream that only speed[car1] read is gone too.
    assert names == {"status", "pos_car1", "more"}
    engine.remove_kpl("pos_car1", cascade=True)
    assert {view.name for view in engine.streams()} == {"status"}
    assert [view.name for view in engine.kpl()] == ["sort pos", "SpeedEst"]
    with pytest.raises(UnknownDeclaration, match="did you mean"):
        engine.remove_kpl("SpedEst")


def test_removal_while_a_request_reads_is_refused(engine, high_speed):
    engine.add_kpl(
        "sort s = (id string, spd float)\nsource s raw\nstrmgen all = raw\nstream fast = all"
    )
    engine.annotate("stream fast contains speed(UAV) = spd [km.h-1] for every UAV = id")
    engine.register_template(high_speed)
    request = engine.request_event(
        engine.parse_request("dyknow:HighSpeedEvent(?o, dyknow:UAV, 100)")
    )
    with pytest.raises(Conflict, match="read by"):
        engine.remove_kpl("fast")
    engine.cancel_event(request.id)
    assert engine.remove_kpl("fast") == ("fast",)


def test_violations_are_a_stream(engine):
    engine.add_kpl("source float p\nstrmgen f[a] = p\nstream q = f[a] with monotone order")
    with pytest.raises(UnknownStream):
        engine.generator("p_violations")
    publish(engine, "p", (1, 10, 1.0), (2, 5, 2.0), (3, 11, 3.0), (4, 10, 4.0))
    generator = engine.generator("q_violations")
    assert [
        (a // MS, v // MS, values["reason"], values["arrived"] // MS, values["value"])
        for a, v, values in generator.stream.all().rows()
    ] == [(2, 5, "order", 2, 2.0), (4, 10, "order", 4, 4.0)]
    view, _ = engine.kpl_declaration("q")
    assert view.violations == "q_violations"
    assert view.counters["dropped"] == {"order": 2}
    with pytest.raises(Refused, match="the system makes"):
        engine.accepting("q_violations")
    engine.remove_kpl("q")
    with pytest.raises(UnknownStream):
        engine.generator("q_violations")


def test_violations_of_a_stream_that_keeps_its_policy(engine):
    """Whoever asks before anything was dropped gets the stream that will have it."""
    engine.add_kpl("source float p\nstrmgen f[a] = p\nstream q = f[a] with monotone order")
    generator = engine.generator("q_violations")
    assert len(generator.stream) == 0
    publish(engine, "p", (1, 10, 1.0), (2, 5, 2.0))
    assert len(generator.stream) == 1


def test_late_samples_of_a_synchronization(engine):
    engine.add_kpl(
        "source float a\nsource float b\nstrmgen f[o] = a\nstrmgen g[o] = b\n"
        "strmgen state = sync(f[o], g[o]; sample every 100, from 100 to oo, max delay 10, "
        "use most recent)"
    )
    publish(engine, "a", (100, 100, 1.0), (200, 200, 2.0), (250, 190, 2.5))
    publish(engine, "b", (101, 100, 5.0), (260, 200, 6.0), (400, 400, 7.0))
    publish(engine, "a", (400, 400, 3.0))
    assert content(engine, "state")[:2] == [(101, 100, 1.0, 5.0), (210, 200, 2.0, 5.0)]
    rows = engine.generator("state_violations").stream.all().rows()
    told = [(v // MS, values["input"], values["sample"]) for _, v, values in rows]
    assert told == [(190, "f[o]", '{"value":2.5}'), (200, "g[o]", '{"value":6.0}')]
    assert engine.kpl_declaration("state")[0].counters["late"] == 2


def test_the_mirror_shows_the_network(engine):
    engine.add_kpl(CARS)
    found = asked(engine, "?u :instantiationOf :SpeedEst ; :hasOutput ?o")
    assert [set(row) for row in found] == [{"dyknow_cu2", "speed%5Bcar1%5D"}]
    assert asked(engine, '?s a :Stream ; :hasName "speed[car1]"') == [("speed%5Bcar1%5D",)]
    engine.remove_kpl("pos_car1", cascade=True)
    assert asked(engine, "?u :instantiationOf ?of") == []


def test_a_unit_that_fails_is_told_and_restarted(engine, processes):
    @processes.computational_unit("x", ["float"], restarts=1)
    def Picky(time, samples, state):
        if samples[0].value < 0:
            raise ValueError("negative")
        return samples[0].value, None

    engine.add_kpl(
        "source float p\nstrmgen f[a] = p\ncompunit x Picky(float)\nstrmgen x[a] = Picky(f[a])"
    )
    publish(engine, "p", (1, 1, 1.0), (2, 2, -1.0), (3, 3, 3.0))
    assert content(engine, "x[a]") == [(1, 1, 1.0), (3, 3, 3.0)]
    assert [change for change, stream, _ in status(engine) if stream == "x[a]"][-2:] == [
        "unit failed",
        "unit restarted",
    ]
    publish(engine, "p", (4, 4, -1.0), (5, 5, -1.0), (6, 6, 1.0))
    assert [change for change, stream, _ in status(engine) if stream == "x[a]"][-1] == (
        "unit stopped by rule"
    )
    view, _ = engine.kpl_declaration("x[a]")
    assert (view.errors, view.restarts) == (3, 2)
    assert "negative" in view.failure
    assert engine.generator("x[a]").is_ended


def test_a_source_that_the_system_reads(engine, processes):
    @processes.sampled("temperature", "100ms")
    def Thermometer(time):
        return float(time // MS)

    engine.add_kpl("source temperature Thermometer\nstrmgen temperature = Thermometer")
    engine.tick(1000 * MS)
    engine.tick(1250 * MS)
    assert content(engine, "Thermometer") == [(t, t, float(t)) for t in (1000, 1100, 1200)]
    with pytest.raises(Refused, match="the system makes"):
        engine.accepting("Thermometer")
    assert asked(engine, "?s a :Source ; :hasOutput :Thermometer") != []
    with pytest.raises(Conflict, match="temperature"):
        Engine(processes=processes).add_kpl("source float Thermometer")
    engine.remove_kpl("Thermometer", cascade=True)
    assert asked(engine, "?s a :Source") == []
    engine.tick(2000 * MS)
    assert {view.name for view in engine.streams()} == {"status"}


def test_an_open_source_takes_its_fields_from_the_first_samples(engine):
    engine.add_kpl("source pos p\nstrmgen pos[a] = p\nstream q = pos[a]")
    generator = engine.generator("p")
    assert generator.is_open
    incoming = decode_ndjson(
        b'{"valid": 1, "x": 1.5, "who": "a"}', generator.schema, generator.stream.pools
    )
    engine.publish("p", incoming, 5)
    assert [values for _, _, values in engine.generator("q").stream.all().rows()] == [
        {"x": 1.5, "who": "a"}
    ]


def open_join(engine, *steps, process="join(pos, n)"):
    """Tuples of ``process``, of the sources p (open) and f, after each of ``steps``."""
    engine.add_kpl("unit ns\nsource pos p\nsource float f\nstrmgen pos = p\nstrmgen n = f")
    engine.add_kpl(f"unit ns\nstrmgen both = {process}")
    given = []
    for name, line in steps:
        generator = engine.generator(name)
        if line is None:
            engine.end(name)
        else:
            incoming = decode_ndjson(line, generator.schema, generator.stream.pools)
            engine.publish(name, incoming, 0)
        made = engine.generator("both").stream.all().rows()
        given.append([(t, *values.values()) for t, _, values in made])
    return given


def test_tuples_wait_for_the_fields_of_an_open_stream(engine):
    given = open_join(
        engine,
        ("f", b'{"available": 1, "valid": 1, "value": 7}'),
        ("p", b'{"available": 3, "valid": 3, "x": 1.5, "who": "a"}'),
        ("f", b'{"available": 4, "valid": 4, "value": 8}'),
        ("f", None),
        ("p", None),
    )
    whole = [(1, None, None, 7.0), (3, 1.5, "a", 7.0), (4, 1.5, "a", 8.0)]
    # The tuple of an instant leaves when both inputs have got beyond it.
    assert given == [[], [], whole[:1], whole[:1], whole]


def test_states_wait_for_the_fields_of_an_open_stream(engine):
    """After their deadline, if need be; the stream may be given twice."""
    given = open_join(
        engine,
        ("f", b'{"available": 1, "valid": 1, "value": 7}'),
        ("f", b'{"available": 9, "valid": 9, "value": 8}'),
        ("p", b'{"available": 10, "valid": 10, "x": 1.5}'),
        ("f", None),
        ("p", None),
        process="sync(pos with monotone order, n, pos with monotone order; any change, "
        "max delay 2, use most recent)",
    )
    assert given[:2] == [[], []]
    assert given[-1] == [(3, None, 7.0, None), (10, None, 8.0, None), (11, 1.5, 8.0, 1.5)]


def test_not_more_tuples_wait_than_the_stream_keeps(engine):
    lines = [f'{{"available": {t}, "valid": {t}, "value": 7}}'.encode() for t in range(1, 6)]
    engine.add_kpl("unit ns\nsource pos p\nsource float f\nstrmgen pos = p\nstrmgen n = f")
    engine.add_kpl("strmgen both = join(pos, n)")
    engine.generator("both").stream.retention = Retention(samples=3)
    engine.generator("p").advance(100)  # as the clock does for a stream that is silent
    for number, line in enumerate(lines, 1):
        generator = engine.generator("f")
        incoming = decode_ndjson(line, generator.schema, generator.stream.pools)
        engine.publish("f", incoming, 0)
        (view,) = [view for view in engine.kpl() if view.name == "both"]
        if 1 < number <= 4:  # that of the last instant is not decided
            assert view.counters == {"late": 0, "held": number - 1, "waits for fields of": ["p"]}
    assert "4 tuples wait for the fields of p: declare them" in view.failure


def test_an_open_stream_that_ends_without_fields_cannot_bring_any_later(engine):
    given = open_join(
        engine,
        ("p", None),
        ("f", b'{"available": 1, "valid": 1, "value": 7}'),
        ("f", b'{"available": 4, "valid": 4, "value": 8}'),
        ("p", b'{"available": 5, "valid": 5, "x": 1.5}'),
        ("f", None),
        ("p", None),
    )
    assert given[:3] == [[], [], [(1, 7.0)]]
    assert given[-1] == given[2]
    (failed,) = [view for view in engine.kpl() if view.failure]
    assert "'p' has fields now, but it had ended without any" in failed.failure


def test_declarations_survive_a_restart(tmp_path, processes):
    first = Engine(tmp_path, processes=processes)
    first.add_kpl(CARS)
    first.add_kpl("unit s\nstream late = pos[car1] with max delay 2, to oo")
    first.add_kpl("stream gone = pos[car1]")
    first.remove_kpl("gone")
    text = first.kpl_text()
    del first
    gc.collect()  # lets the store go
    again = Engine(tmp_path, processes=processes)
    assert again.kpl_text() == text
    publish(again, "pos_car1", (280, 200, 1000.0), (510, 400, 1600.0))
    assert content(again, "speed_car1") == [(510, 400, 3.0)]
    del again
    gc.collect()
    # Without the code of SpeedEst the rest is there, and the text is kept for later.
    poorer = Engine(tmp_path, processes=Processes())
    kinds = {view.name: view.kind for view in poorer.kpl()}
    lost = [name for name, kind in kinds.items() if kind == "not restored"]
    assert list(kinds)[:5] == ["sort pos", "pos_car1", "SpeedEst", "pos[car1]", "late"]
    assert lost == list(kinds)[5:]
    assert [name.split(" = ")[0] for name in lost] == ["strmgen speed[car1]", "stream speed_car1"]
    assert [change for change, _, _ in status(poorer) if change == "not restored"] != []
    poorer.add_kpl("stream new = pos[car1]")
    del poorer
    gc.collect()
    richer = Engine(tmp_path, processes=processes)
    assert {view.name for view in richer.kpl()} >= {"speed[car1]", "speed_car1", "new"}
    del richer
    gc.collect()
    poorer = Engine(tmp_path, processes=Processes())
    for name in lost:
        assert poorer.remove_kpl(name) == (name,)
    assert "speed" not in poorer.ontology.registered.kpl().replace("compunit speed", "")


def test_annotations_of_declared_streams_survive_a_restart(tmp_path, processes):
    first = Engine(tmp_path, processes=processes)
    first.add_kpl("sort s = (id string, spd float)\nsource s raw\nstrmgen a = raw\nstream f = a")
    first.annotate("stream f contains speed(UAV) = spd [km.h-1] for every UAV = id")
    del first
    gc.collect()  # lets the store go
    again = Engine(tmp_path, processes=processes)
    assert [change for change, _, _ in status(again) if change == "not restored"] == []
    assert again.stream("f").annotation is not None


def test_thousands_of_small_streams(engine):
    """A source and a stream for each of fifteen hundred cars."""
    count = 1_500
    text = "\n".join(
        f"source float p{i}\nstrmgen pos[car{i}] = p{i}\nstream q{i} = pos[car{i}] with any change"
        for i in range(count)
    )
    engine.add_kpl(text)
    for i in range(0, count, 97):
        publish(engine, f"p{i}", (1, 1, float(i)))
        assert content(engine, f"q{i}") == [(1, 1, float(i))]
    engine.tick(5 * MS)
    assert len(engine.kpl()) == 3 * count
    removed = engine.remove_kpl("p97", cascade=True)
    assert removed == ("q97", "pos[car97]", "p97")
