"""A data directory of an earlier version, or program, opens; of a later one it is told (P9)."""

import gc
import json

import pytest
from asking import asking
from httpx_sse import connect_sse
from typer.testing import CliRunner

from dyknow.engine.durability.checkpoint import program
from dyknow.engine.durability.commands import (
    AddKpl,
    Annotate,
    DeclareStream,
    Publish,
    RegisterAnnotatedTransformation,
    RegisterQuery,
    RegisterTemplate,
    RequestEvent,
    Subscribe,
    Tick,
)
from dyknow.engine.durability.durable_engine import RecordedEngine
from dyknow.engine.engine import Engine
from dyknow.engine.model.views import StreamDeclaration
from dyknow.journal.errors import UnknownFormat
from dyknow.rdf.namespaces import DYKNOW
from dyknow.service.app import create_app
from dyknow.service.cli import app
from dyknow.service.server import running
from dyknow.streams.history import Retention
from dyknow.streams.sample import Field, FieldType
from dyknow.streams.time import SECOND

PROGRAM = "dyknow.engine.durability.durable_engine.program"

SPEEDS = StreamDeclaration(
    "s5",
    (Field("id", FieldType.STRING), Field("spd", FieldType.FLOAT)),
    2 * SECOND,
    Retention(5),
    DYKNOW,
    None,
)
SSL = "stream s5 contains speed(UAV) = spd [km.h-1] for every UAV = id"
KPL = "source float height\nstrmgen heights = height"
QUERY = """REGISTER QUERY mean AS SELECT ?o (AVG(?v) AS ?m) WHERE { ?o dyknow:speed ?v }
GROUP BY ?o WINDOW [RANGE 5s STEP 1s]"""
TRANSFORMATION = RegisterAnnotatedTransformation(
    "compunit speedOver10s transforms lat:latitude, lon:longitude to spd:speed [m.s-1]",
    "coordinatesToSpeed",
    {"baseline": "10s"},
    quality=0.5,
)
HIGH = "templates/library/high_speed.rq"
EVENT = "dyknow:HighSpeedEvent(?o, dyknow:UAV, 100)"


def body(*numbers):
    lines = [
        {"valid": n * SECOND, "available": n * SECOND, "id": f"uav{n % 2}", "spd": 100.0 + n}
        for n in numbers
    ]
    return "".join(json.dumps(line) + "\n" for line in lines).encode()


def high():
    with open(HIGH) as file:
        return file.read()


@pytest.fixture
def old(tmp_path):
    """What every version before the journal wrote: a store in ``ontology/``, nothing else."""
    path = tmp_path / "data"
    path.mkdir()
    engine = Engine(path)
    engine.declare(SPEEDS)
    engine.annotate(SSL)
    engine.register_template(high())
    engine.add_kpl(KPL)
    engine.queries.register(QUERY)
    TRANSFORMATION.apply(engine)
    del engine
    gc.collect()
    assert [each.name for each in path.iterdir()] == ["ontology"]
    return path


def assert_defined(engine):
    view = engine.stream("s5")
    assert (view.fields, view.lateness) == (SPEEDS.fields, SPEEDS.lateness)
    assert "speed" in view.annotation
    assert len(engine.templates()) == 1
    assert [each.name for each in engine.kpl()] == ["height", "heights"]
    (query,) = engine.queries.views()
    assert (query.name, query.state) == ("mean", "running")
    assert engine.transformations.view("speedOver10s").quality == 0.5


def test_a_directory_of_format_1_is_taken_over(old):
    result = CliRunner().invoke(app, ["check", str(old), "--json"])
    assert json.loads(result.stdout)["format"] == 1
    assert "takes over" in json.loads(result.stdout)["start"]
    recorded = RecordedEngine(old, now=SECOND)
    assert any("earlier version" in note for note in recorded.recovery.notes)
    assert_defined(recorded.engine)
    assert (old / "ontology.format1").is_dir()
    assert not (old / "ontology").exists()
    recorded.do(Publish("s5", "ndjson", body(1, 2, 3, 4, 5, 6, 7, 8), 9 * SECOND))
    recorded.do(RequestEvent(EVENT))
    recorded.close(checkpoint=False)
    again = RecordedEngine(old, now=SECOND)
    assert again.recovery.is_continued
    assert_defined(again.engine)
    assert again.engine.stream("s5").counters.accepted == 8
    again.close()
    # Who goes back to the earlier version finds what it wrote.
    (old / "ontology.format1").rename(old.parent / "ontology")
    assert len(Engine(old.parent).templates()) == 1


def test_a_take_over_that_was_stopped_is_done_again(old, monkeypatch):
    def stop(self):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr("dyknow.journal.directory.DataDirectory.forget_old_store", stop)
        with pytest.raises(KeyboardInterrupt):
            RecordedEngine(old, now=SECOND)
    gc.collect()
    assert (old / "ontology").is_dir()
    recorded = RecordedEngine(old, now=SECOND)
    assert_defined(recorded.engine)
    assert (old / "ontology.format1").is_dir()
    recorded.close()


def test_a_directory_of_a_later_format_is_refused_and_not_touched(tmp_path):
    (tmp_path / "format.json").write_text('{"format": 3}')
    with pytest.raises(UnknownFormat):
        RecordedEngine(tmp_path, now=0)
    for command in (["serve", "--data", str(tmp_path), "--port", "0"], ["check", str(tmp_path)]):
        result = CliRunner().invoke(app, command)
        assert result.exit_code == 1
        assert "format 3" in result.stderr
        assert "a later one" in result.stderr
    assert sorted(path.name for path in tmp_path.iterdir()) == ["format.json", "lock"]


@pytest.fixture
def written(tmp_path):
    """A directory of this program, with a checkpoint at its end; its epoch, and what it holds."""
    path = tmp_path / "data"
    recorded = RecordedEngine(path, now=SECOND)
    for command in (
        DeclareStream(SPEEDS),
        Annotate(SSL),
        RegisterTemplate(high()),
        AddKpl(KPL),
        RegisterQuery(QUERY),
        RequestEvent(EVENT),
        Subscribe("s5", "sample every 1000"),
        TRANSFORMATION,
    ):
        recorded.do(command)
    for n in range(1, 11):
        recorded.do(Publish("s5", "ndjson", body(n), n * SECOND, f"key {n}"))
    recorded.do(Publish("s5", "ndjson", body(3), 11 * SECOND))  # too late
    recorded.do(Tick(11 * SECOND))
    return path, recorded


def told(recorded):
    """What a publisher and a reader of stream s5 know."""
    generator = recorded.engine.generator("s5")
    stream = generator.stream
    return (
        stream.first_number,
        stream.last_number,
        stream.all().valid.tolist(),
        stream.all().columns["spd"].values.tolist(),
        generator.counters,
        generator.watermark,
        len(generator.pending),
    )


def results_of(recorded, name="mean"):
    """What a reader of a query's stream knows, and who publishes to it."""
    generator = recorded.engine.generator(name)
    stream = generator.stream
    rows = [(available, values) for available, _, values in stream.all().rows()]
    return stream.first_number, rows, generator.counters.accepted


def test_results_of_queries_stay_with_another_program(written, monkeypatch):
    path, recorded = written
    before = results_of(recorded)
    assert len(before[1]) > 5
    recorded.close()
    monkeypatch.setattr(PROGRAM, lambda *_: "dyknow 0.2.0")
    again = RecordedEngine(path, now=12 * SECOND)
    assert results_of(again) == before
    # New results follow, and are numbered behind those.
    for n in range(12, 16):
        again.do(Publish("s5", "ndjson", body(n), n * SECOND))
    after = results_of(again)
    assert after[:2] == (before[0], after[1])
    assert after[1][: len(before[1])] == before[1]
    times = [available for available, _ in after[1]]
    assert times == sorted(times)
    assert len(times) > len(before[1])
    assert again.engine.generator("mean").counters.late == 0
    again.close()
    monkeypatch.setattr(PROGRAM, lambda *_: "dyknow 0.3.0")
    third = RecordedEngine(path, now=17 * SECOND)
    assert results_of(third) == after
    third.close()


def test_what_another_program_wrote_goes_on_under_new_ids(written, settings, clock, monkeypatch):
    path, recorded = written
    before, epoch = told(recorded), recorded.engine.epoch
    requests = [each.id for each in recorded.engine.events()]
    recorded.close()
    monkeypatch.setattr(PROGRAM, lambda *_: "dyknow 0.2.0")
    again = RecordedEngine(path, now=12 * SECOND)
    engine = again.engine
    assert not again.recovery.is_continued
    assert any(program() in note and "dyknow 0.2.0" in note for note in again.recovery.notes)
    assert_defined(engine)
    assert told(again) == before
    assert engine.epoch != epoch
    assert [each.id for each in engine.events()] == requests
    assert len(engine.subscriptions()) == 1
    # It takes samples: the same ones once more are known, by their key or by themselves.
    again.do(Publish("s5", "ndjson", body(10), 12 * SECOND, "key 10"))
    assert engine.generator("s5").counters.accepted == before[4].accepted
    again.do(Publish("s5", "ndjson", body(10), 12 * SECOND))
    assert engine.generator("s5").counters.duplicate == 1
    new_epoch, last = engine.epoch, before[1]
    with (
        running(create_app(again, settings, clock), settings) as url,
        asking(url) as http,
    ):
        headers = {"Last-Event-ID": f"{epoch}-{last}"}
        with connect_sse(http, "GET", "/streams/s5/events", headers=headers) as source:
            events = source.iter_sse()
            gap = next(event for event in events if event.event == "gap")
            assert gap.json()["epoch"] == epoch
            assert gap.json()["to"] is None
            assert next(event for event in events if event.event == "sample").id.startswith(
                new_epoch
            )
    # From now on it is this program's own.
    third = RecordedEngine(path, now=13 * SECOND)
    assert third.recovery.is_continued
    assert third.engine.epoch == new_epoch
    third.close()


def test_what_another_program_wrote_and_left_by_a_kill_goes_on(written, monkeypatch):
    """What came after the checkpoint is done again by the program that is."""
    path, recorded = written
    recorded.checkpoint().write()
    recorded.do(Publish("s5", "ndjson", body(11, 12, 13), 13 * SECOND, "key 11"))
    recorded.log.commit()
    before, epoch = told(recorded), recorded.engine.epoch
    recorded.log.close()
    recorded._directory.close()
    monkeypatch.setattr(PROGRAM, lambda *_: "dyknow 0.2.0")
    again = RecordedEngine(path, now=14 * SECOND)
    assert again.recovery.replayed == 1
    assert told(again) == before
    assert again.engine.epoch != epoch
    assert_defined(again.engine)
    again.close()
    third = RecordedEngine(path, now=15 * SECOND)
    assert told(third) == before
    third.close()


def test_what_another_program_wrote_without_a_checkpoint_is_done_again(written, monkeypatch):
    path, recorded = written
    recorded.close(checkpoint=False)
    monkeypatch.setattr(PROGRAM, lambda *_: "dyknow 0.2.0")
    monkeypatch.setattr("dyknow.service.cli.data.data_directory.program", lambda *_: "dyknow 0.2.0")
    start = json.loads(CliRunner().invoke(app, ["check", str(path), "--json"]).stdout)["start"]
    assert start.startswith("goes on from the beginning")
    assert program() in start
    assert "begin anew" in start
    again = RecordedEngine(path, now=14 * SECOND)
    assert not again.recovery.is_continued
    assert again.engine.stream("s5").counters.accepted == 11
    assert len(again.engine.events()) == 1
    again.close()
