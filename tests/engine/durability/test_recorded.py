"""What a data directory keeps of user-written processes, of what was refused, and of other
programs' checkpoints (the law is tests/laws/engine/test_recorded.py)."""

import importlib.util
import pickle
import random
import sys
import threading

import msgspec
import pytest
from pyoxigraph import NamedNode, Quad
from simulated_disk import SimulatedDisk

import dyknow.engine.durability.checkpoint as checkpoint_module
import dyknow.engine.durability.durable_engine as recorded_module
from dyknow.continuous.columns.oxigraph_port import StoredQuads
from dyknow.converters.rdf.statements import SCHEMA
from dyknow.engine.catalog.iri_annotations import (
    DescribedArgument,
    DescribedPort,
    DescribedTransformation,
)
from dyknow.engine.catalog.registered_transformations import (
    RegisteredTransformations,
)
from dyknow.engine.configuration.configuration import Configuration
from dyknow.engine.durability import recovery
from dyknow.engine.durability.checkpoint import CheckpointError, Outside, program
from dyknow.engine.durability.commands import (
    AddKpl,
    Annotate,
    ApplySpecification,
    CancelEvent,
    DeclareStream,
    LoadOntology,
    OpenStream,
    Publish,
    RegisterQuery,
    RegisterTemplate,
    RegisterTransformations,
    RemoveKpl,
    RemoveOntology,
    RemoveQuery,
    RemoveStream,
    RemoveTemplate,
    RemoveTransformation,
    RequestEvent,
    SetQuality,
    Subscribe,
    SubscribeToFeature,
    Tick,
    Unsubscribe,
    decode_command,
)
from dyknow.engine.durability.durable_engine import RecordedEngine
from dyknow.engine.durability.portable_state import Portable, engine_from
from dyknow.engine.engine import Engine
from dyknow.engine.model.errors import Conflict, UnknownRequest, UnknownStream
from dyknow.engine.model.process_reports import Report
from dyknow.engine.model.views import StreamDeclaration
from dyknow.engine.processes.registry import Processes
from dyknow.engine.processes.supervision import DIRECT, UnitBlocked
from dyknow.engine.requests.continuous_queries import RegisteredQueries
from dyknow.journal.durability import Durability
from dyknow.journal.errors import JournalFull
from dyknow.ontology.ontology import Ontology
from dyknow.streams.history import Retention
from dyknow.streams.sample import Field, FieldType
from dyknow.streams.time import SECOND


def throw(time):
    """The world outside: nobody can say again what it said."""
    if random.random() < 0.1:
        raise OSError("the dice fell off the table")
    return Report(random.random(), quality=round(random.random(), 2))


def opened(path, **more):
    return RecordedEngine(path, now=0, durability=Durability.WRITE, **more)


def cut_off(recorded):
    recorded.log.commit()
    recorded._directory.close()


def rows(engine, name):
    return list(engine.generator(name).stream.all().rows())


def sensors():
    registry = Processes()
    registry.sampled("float", "100ms", name="dice", on_error="skip")(throw)
    return registry


@pytest.mark.parametrize("checkpoint", [False, True])
def test_what_a_source_said_is_not_asked_again(tmp_path, checkpoint):
    first = opened(tmp_path, processes=sensors())
    first.do(AddKpl("source float dice\nstrmgen thrown = dice"))
    for now in range(0, 3 * SECOND, SECOND // 4):
        first.do(Tick(now))
        if checkpoint and now == SECOND:
            first.checkpoint().write()
    said = rows(first.engine, "dice")
    process = first.engine.kpl_declaration("dice")[0]
    assert len(said) > 10
    cut_off(first)
    again = opened(tmp_path, processes=sensors())
    assert rows(again.engine, "dice") == said
    assert again.engine.kpl_declaration("dice")[0] == process
    again.do(Tick(4 * SECOND))
    assert len(rows(again.engine, "dice")) > len(said)
    again.close()


def test_what_was_refused_leaves_no_trace(tmp_path):
    first = opened(tmp_path)
    position = first.log.position
    with pytest.raises(UnknownStream):
        first.do(Publish("nowhere", "ndjson", b"{}", 7))
    assert first.log.position == position
    assert first.engine.now == 0
    first.close()


def test_a_stream_that_is_asked_for_is_there_again(tmp_path):
    first = opened(tmp_path)
    declare(first, "s")
    first.engine.stream("s_late")
    assert decode_command(_last(first)) == OpenStream("s_late")
    cut_off(first)
    again = opened(tmp_path)
    assert "s_late" in [view.name for view in again.engine.streams()]
    again.close()


def _last(recorded):
    recorded.log.commit()
    return list(recorded.log.read())[-1][1]


def declare(recorded, name):
    fields = (Field("id", FieldType.STRING), Field("v", FieldType.FLOAT))
    recorded.do(DeclareStream(StreamDeclaration(name, fields, 2 * SECOND)))
    recorded.do(Annotate(f"stream {name} contains speed(UAV) = v for every UAV = id"))


def say(recorded, *seconds):
    lines = [
        f'{{"valid": {t}000000000, "available": {t}000000000, "id": "uav1", "v": {t}}}'
        for t in seconds
    ]
    recorded.do(Publish("s", "ndjson", "\n".join(lines).encode(), 0, f"key {seconds}"))


def test_another_program_goes_on_from_what_it_understands(tmp_path, monkeypatch, high_speed):
    first = opened(tmp_path)
    declare(first, "s")
    first.do(RegisterTemplate(high_speed))
    first.do(RequestEvent("dyknow:HighSpeedEvent(?o, dyknow:UAV, 1)"))
    first.do(RequestEvent("dyknow:HighSpeedEvent(?o, dyknow:UAV, 2)"))
    first.do(CancelEvent("event1"))
    first.do(Subscribe("s"))
    first.do(Subscribe("s", "sample every 1s"))
    first.do(Unsubscribe("subscription1"))
    first.do(RequestEvent("dyknow:HighSpeedEvent(?o, dyknow:UAV, 3)"))
    first.do(CancelEvent("event3"))
    first.do(
        RegisterQuery(
            "SELECT ?o ?v FROM STREAM <http://www.ida.liu.se/dyknow/s.trdf> "
            "[RANGE 5s STEP 1s] WHERE { ?o dyknow:speed ?v }"
        )
    )
    say(first, 1, 2, 3, 4, 5, 9)
    before = first.engine.stream("s")
    kept = rows(first.engine, "s")
    assert before.counters.pending
    first.close()
    monkeypatch.setattr(recorded_module, "program", lambda *_: "a later version")
    later = opened(tmp_path)
    assert not later.recovery.is_continued
    assert "numbers" in " ".join(later.recovery.notes)
    assert later.engine.epoch != first.engine.epoch
    after = later.engine.stream("s")
    assert (after.counters, after.first_number, after.last_number, after.watermark) == (
        before.counters,
        before.first_number,
        before.last_number,
        before.watermark,
    )
    assert rows(later.engine, "s") == kept
    assert [view.id for view in later.engine.events()] == ["event2"]
    assert [view.id for view in later.engine.subscriptions()] == ["subscription2"]
    assert len(later.engine.subscriptions()) == len(later.engine.queries) == 1
    assert (
        later.engine.template("HighSpeedEvent").source
        == first.engine.template("HighSpeedEvent").source
    )
    say(later, 10, 20, 21)
    assert later.engine.stream("s").last_number > before.last_number
    # Nor is an id given twice.
    assert later.do(RequestEvent("dyknow:HighSpeedEvent(?o, dyknow:UAV, 4)")).id == "event4"
    later.close()
    monkeypatch.undo()


def test_a_state_that_names_what_is_gone_is_no_loss(tmp_path, monkeypatch):
    """As of a class of a user-written process that has another name now."""
    first = opened(tmp_path)
    declare(first, "s")
    say(first, 1, 2, 9)
    kept = rows(first.engine, "s")
    first.close()

    def gone(*given):
        raise CheckpointError("there is no class Smooth any more")

    monkeypatch.setattr(recovery, "engine_of", gone)
    later = opened(tmp_path)
    assert not later.recovery.is_continued
    assert "Smooth" in " ".join(later.recovery.notes)
    assert rows(later.engine, "s") == kept
    later.close()


def test_after_an_error_within_a_command_there_is_no_checkpoint(tmp_path, monkeypatch):
    first = opened(tmp_path)
    declare(first, "s")
    monkeypatch.setattr(first.engine, "set_quality", lambda *given: {}["none"])
    with pytest.raises(KeyError):
        first.do(SetQuality("s", 0.5))
    with pytest.raises(CheckpointError, match="undefined since an error"):
        first.checkpoint()
    cut_off(first)
    again = opened(tmp_path)
    assert again.recovery.is_continued
    assert [view.name for view in again.engine.streams()] == ["status", "s"]
    again.close()


def test_quads_out_of_a_checkpoint_are_taken_for_no_others():
    """Workers know them by their number, which counts from 0 in each process."""
    quads = [Quad(NamedNode("urn:a"), NamedNode("urn:p"), NamedNode("urn:b"))]
    kept = StoredQuads(quads)
    one, other = pickle.loads(pickle.dumps([kept, kept]))
    assert one is other
    assert list(one.quads) == quads
    assert len({kept.number, one.number, StoredQuads().number}) == 3


def speakers(size):
    """A source that says as much as ``size()`` says, and one that says little."""
    registry = Processes()

    @registry.sampled("Text", "100ms", name="chatter")
    def chatter(time):
        return "x" * size() + str(random.random())

    registry.sampled("float", "100ms", name="dice")(lambda time: random.random())
    return registry


SPEAKERS = "sort Text = (value string)\nsource Text chatter\nsource float dice"


def no_room_from_now_on(recorded, disk, room=0):
    """Not even what the log has made before."""
    disk.room = room
    for segment in recorded.log._open:
        segment._room = segment.end


def counted(recorded, name):
    return recorded.engine.kpl_declaration(name)[0].counters


def test_sources_that_say_more_than_there_is_room_for_are_not_asked(tmp_path):
    disk = SimulatedDisk()
    sizes = [100]
    first = opened(tmp_path, processes=speakers(lambda: sizes[0]), disk=disk)
    first.do(AddKpl(SPEAKERS))
    for now in range(0, SECOND, SECOND // 10):
        first.do(Tick(now))
    no_room_from_now_on(first, disk, 100_000)
    sizes[0] = 300_000
    for now in range(SECOND, 2 * SECOND, SECOND // 10):
        first.do(Tick(now))
    # It is asked once and then no more; the other one, for which there is room, is.
    assert "chatter" in first.unread
    assert "dice" not in first.unread
    assert counted(first, "chatter")["without room"] == 10
    assert len(rows(first.engine, "chatter")) == 10
    assert len(rows(first.engine, "dice")) == 20
    first.log.commit()
    disk.room = None
    for now in range(2 * SECOND, 3 * SECOND, SECOND // 10):
        first.do(Tick(now))
    assert first.unread is None
    assert len(rows(first.engine, "chatter")) == 20
    said = [rows(first.engine, name) for name in ("chatter", "dice", "status")]
    cut_off(first)
    again = opened(tmp_path, processes=speakers(lambda: 100))
    assert again.recovery.notes == []
    assert [rows(again.engine, name) for name in ("chatter", "dice", "status")] == said
    assert counted(again, "chatter")["without room"] == 10
    again.close()


@pytest.mark.parametrize("seed", range(20))
def test_wherever_the_room_ends_what_is_done_is_what_is_written_down(tmp_path, seed):
    pick = random.Random(seed)
    disk = SimulatedDisk()
    registry = speakers(lambda: pick.choice((0, 10, 5_000, 200_000)))
    first = opened(tmp_path, processes=registry, disk=disk)
    first.do(AddKpl(SPEAKERS))
    for now in range(0, 4 * SECOND, SECOND // 5):
        if pick.random() < 0.4:
            no_room_from_now_on(first, disk, pick.choice((0, 300, 1_000, 10_000, 400_000)))
        try:
            first.do(Tick(now))
        except JournalFull:
            disk.room = None
            first.do(Tick(now))
    told = [(rows(first.engine, name), counted(first, name)) for name in ("chatter", "dice")]
    disk.room = None
    cut_off(first)
    again = opened(tmp_path, processes=registry)
    assert [
        (rows(again.engine, name), counted(again, name)) for name in ("chatter", "dice")
    ] == told
    again.close()


def test_other_commands_ask_for_the_room_they_need_and_no_more(tmp_path):
    disk = SimulatedDisk()
    first = opened(tmp_path, disk=disk)
    declare(first, "s")
    no_room_from_now_on(first, disk, 400)
    say(first, 1)
    first.do(Tick(SECOND))
    with pytest.raises(JournalFull):
        say(first, *range(2, 9))
    assert len(rows(first.engine, "s")) == 0
    assert first.engine.stream("s").counters.accepted == 1
    disk.room = None
    first.close()


class Patience:
    """A runner that waits for nobody: what ``late`` holds up is given up, and comes back when the
    next one is asked."""

    tape = None

    def __init__(self):
        self.late = None

    def run(self, work, deadline, progress):
        if self.late is None:
            return work()
        held, self.late = self.late, None
        thread = threading.Thread(target=work)
        thread.start()
        held.begun.wait()
        held.thread = thread
        raise UnitBlocked("it did not come back within 2s")


class Held:
    def __init__(self):
        self.begun, self.go, self.thread = threading.Event(), threading.Event(), None


def test_a_source_that_came_back_too_late_stays_stopped(tmp_path):
    """Also where it comes back while another one is asked."""
    held, runner = Held(), Patience()

    def registered(slow, quick):
        registry = Processes()
        registry.sampled("float", "100ms", name="slow")(slow)
        registry.sampled("float", "100ms", name="quick")(quick)
        return registry

    def slow(time):
        if time < SECOND:
            return 1.0
        held.begun.set()
        held.go.wait()
        return 2.0

    def quick(time):
        if time == SECOND:
            held.go.set()
            held.thread.join()
        return float(time)

    first = opened(tmp_path, processes=registered(slow, quick), runner=runner)
    first.do(AddKpl("source float slow\nsource float quick"))
    first.do(Tick(SECOND // 2))
    runner.late = held
    first.do(Tick(SECOND))
    first.do(Tick(2 * SECOND))
    told = [rows(first.engine, name) for name in ("slow", "quick", "status")]
    failure = first.engine.kpl_declaration("slow")[0].failure
    assert "did not come back" in failure
    cut_off(first)
    again = opened(tmp_path, processes=registered(lambda _: 3.0, lambda _: 4.0))
    assert [rows(again.engine, name) for name in ("slow", "quick", "status")] == told
    assert again.engine.kpl_declaration("slow")[0].failure == failure
    again.close()


class Locked:
    """What it remembers cannot be pickled."""

    def __init__(self):
        self.inner = {"deep": [threading.Lock()]}
        self.total = 0.0

    def __call__(self, time, samples, state):
        self.total += samples[0].value
        return self.total, state


def locked_state(time, samples, state):
    state = state or {"lock": threading.Lock(), "total": 0.0}
    state["total"] += samples[0].value
    return state["total"], state


def summing(code):
    registry = Processes()
    registry.computational_unit("total", ["v"], name="Sum")(code)
    return registry


SUMMED = "compunit total Sum(v)\nsource v s\nstrmgen x = s\nstrmgen summed = Sum(x)"


def declare_numbers(recorded):
    recorded.do(DeclareStream(StreamDeclaration("s", (Field("value", FieldType.FLOAT),))))
    recorded.do(AddKpl("sort v = (value float)\nsort total = (value float)\n" + SUMMED))


def number(recorded, *seconds):
    lines = [f'{{"valid": {t}000000000, "available": {t}000000000, "value": {t}}}' for t in seconds]
    recorded.do(Publish("s", "ndjson", "\n".join(lines).encode(), 0))


@pytest.mark.parametrize(
    ("code", "part"), [(Locked, "self.inner['deep'][0]"), (locked_state, "the state['lock']")]
)
def test_what_a_unit_cannot_keep_is_told_and_prevents_no_checkpoint(tmp_path, code, part):
    first = opened(tmp_path, processes=summing(code))
    declare_numbers(first)
    number(first, 1, 2, 3)
    unwritten = first.checkpoint()
    (unkept,) = unwritten.put()
    assert unkept.process == "Sum"
    assert f"{part} is a lock and cannot be pickled" in unkept.reason
    assert "__getstate__" in unkept.reason
    first.log.commit()
    unwritten.keep()
    # It goes on as it was, and so does a start; but what comes of it has other ids.
    number(first, 4)
    assert [value["value"] for *_, value in rows(first.engine, "summed")] == [1, 3, 6, 10]
    cut_off(first)
    again = opened(tmp_path, processes=summing(code))
    assert any("Sum" in note and part in note for note in again.recovery.notes)
    assert not again.recovery.is_continued
    assert again.engine.epoch != first.engine.epoch
    assert [value["value"] for *_, value in rows(again.engine, "summed")] == [1, 3, 6, 4]
    again.close()


class Sensor:
    """As of a device: what it has open cannot be pickled."""

    def __init__(self):
        self.lock = threading.Lock()

    def __call__(self, time):
        return float(time)


def test_a_source_that_holds_something_open_goes_on_under_the_same_ids(tmp_path):
    registry = Processes()
    registry.sampled("float", "100ms", name="sensor")(Sensor)
    first = opened(tmp_path, processes=registry)
    first.do(AddKpl("source float sensor"))
    first.do(Tick(SECOND))
    (unkept,) = first.checkpoint().put()
    assert "self.lock" in unkept.reason
    first.close()
    again = opened(tmp_path, processes=registry)
    assert again.recovery.notes == []
    assert again.engine.epoch == first.engine.epoch
    again.do(Tick(2 * SECOND))
    assert len(rows(again.engine, "sensor")) > 1
    again.close()


def test_what_a_process_that_can_be_written_remembers_goes_on(tmp_path):
    """Also where its code has no name in its module."""

    class Total:
        def __init__(self):
            self.total = 0.0

        def __call__(self, time, samples, state):
            self.total += samples[0].value
            return self.total, state

    registry = summing(Total)
    first = opened(tmp_path, processes=registry)
    declare_numbers(first)
    number(first, 1, 2, 3)
    assert first.checkpoint().put() == ()
    first.close()
    again = opened(tmp_path, processes=registry)
    assert again.recovery.notes == []
    number(again, 4)
    assert [value["value"] for *_, value in rows(again.engine, "summed")] == [1, 3, 6, 10]
    again.close()


def total(time, samples, state):
    return (state or 0.0) + samples[0].value, (state or 0.0) + samples[0].value


@pytest.mark.parametrize("checkpoint", ["before", "after", "never"])
def test_without_a_module_what_was_declared_waits_and_comes_back_with_it(tmp_path, checkpoint):
    first = opened(tmp_path, processes=summing(total))
    if checkpoint == "before":
        first.checkpoint().write()
    declare_numbers(first)
    first.do(SubscribeToFeature("dyknow:speed"))
    first.do(Subscribe("summed"))
    number(first, 1, 2, 3)
    if checkpoint == "after":
        first.checkpoint().write()
    declared = [view.name for view in first.engine.kpl()]
    cut_off(first)
    for _ in range(3):  # from the log, from the checkpoint that this has written, and again
        without = opened(tmp_path, processes=Processes())
        notes = " ".join(without.recovery.notes)
        assert "'Sum'" in notes
        assert f"--processes {__name__}" in notes
        views = {view.name: view.kind for view in without.engine.kpl()}
        assert views["strmgen summed = Sum(x)"] == "not restored", views
        assert views["s"] == "source"
        assert len(rows(without.engine, "s")) >= 3
        told = [value["specification"] or "" for *_, value in rows(without.engine, "status")]
        assert any("is missing" in text for text in told)
        assert any("summed" in text and "Subscribe" in text for text in told)
        number(without, without.engine.stream("s").last_number + 1)
        cut_off(without)
    again = opened(tmp_path, processes=summing(total))
    assert "missing" not in " ".join(again.recovery.notes)
    assert sorted(view.name for view in again.engine.kpl()) == sorted(declared)
    assert {view.kind for view in again.engine.kpl()} == {
        "sort",
        "compunit",
        "source",
        "strmgen",
    }
    assert len(again.engine.subscriptions()) == 2
    before = len(rows(again.engine, "summed"))
    number(again, 99)
    assert len(rows(again.engine, "summed")) == before + 1
    again.close()


def test_what_was_removed_before_a_module_was_missing_does_not_come_back(tmp_path):
    first = opened(tmp_path, processes=summing(total))
    declare_numbers(first)
    first.checkpoint().write()
    first.do(RemoveKpl("summed"))
    first.do(RemoveKpl("Sum"))
    cut_off(first)
    without = opened(tmp_path, processes=Processes())
    assert "not restored" not in {view.kind for view in without.engine.kpl()}
    cut_off(without)
    again = opened(tmp_path, processes=summing(total))
    assert {view.name for view in again.engine.kpl()} == {"sort v", "sort total", "s", "x"}
    again.close()


@pytest.mark.parametrize("checkpoint", [True, False])
def test_what_was_given_up_before_a_module_was_missing_stays_so_and_takes_no_other_with_it(
    tmp_path, checkpoint
):
    first = opened(tmp_path, processes=summing(total))
    declare_numbers(first)
    if checkpoint:
        first.checkpoint().write()
    waits, stays = first.do(Subscribe("summed")), first.do(Subscribe("s"))
    first.do(Unsubscribe(waits.id))
    cut_off(first)
    for processes in (Processes(), summing(total)):
        again = opened(tmp_path, processes=processes)
        assert _subscribed(again) == {stays.id: "s"}
        cut_off(again)


def test_ids_stay_with_what_was_asked_for_while_a_module_is_missing(tmp_path):
    first = opened(tmp_path, processes=summing(total))
    declare_numbers(first)
    first.do(Unsubscribe(first.do(Subscribe("s")).id))
    for stream in ("summed", "s", "summed", "s"):
        first.do(Subscribe(stream))
    cut_off(first)
    for _ in range(3):  # from the log, from the checkpoint that this has written, and again
        without = opened(tmp_path, processes=Processes())
        assert _subscribed(without) == {"subscription3": "s", "subscription5": "s"}
        told = [value["specification"] or "" for *_, value in rows(without.engine, "status")]
        cut_off(without)
    assert any("subscription subscription4: there is no stream called 'summed'" in t for t in told)
    without = opened(tmp_path, processes=Processes())
    assert without.do(Subscribe("s")).id == "subscription6"
    cut_off(without)
    again = opened(tmp_path, processes=summing(total))
    assert list(_subscribed(again).items()) == [
        ("subscription2", "summed"),
        ("subscription3", "s"),
        ("subscription4", "summed"),
        ("subscription5", "s"),
        ("subscription6", "s"),
    ]
    again.close()


def _subscribed(recorded):
    return {view.id: view.source for view in recorded.engine.subscriptions()}


def test_people_give_up_what_waits_for_a_module_by_its_id(tmp_path):
    first = opened(tmp_path, processes=summing(total))
    declare_numbers(first)
    for stream in ("summed", "s", "summed"):
        first.do(Subscribe(stream))
    cut_off(first)
    without = opened(tmp_path, processes=Processes())
    with pytest.raises(UnknownRequest):  # a subscription is no request
        without.do(CancelEvent("subscription1"))
    without.do(Unsubscribe("subscription1"))
    with pytest.raises(UnknownRequest):
        without.do(Unsubscribe("subscription1"))
    without.do(RemoveKpl("summed"))
    cut_off(without)
    still = opened(tmp_path, processes=Processes())  # it was written down, too
    with pytest.raises(UnknownRequest):
        still.do(Unsubscribe("subscription1"))
    still.close()
    back = opened(tmp_path, processes=summing(total))
    assert _subscribed(back) == {"subscription2": "s"}
    assert "summed" not in {view.stream for view in back.engine.kpl()}
    back.do(Unsubscribe("subscription3"))  # waits for `summed`
    cut_off(back)


UNNAMED = (
    "SELECT ?o ?v FROM STREAM <http://www.ida.liu.se/dyknow/s.trdf> "
    "[RANGE 5s STEP 1s] WHERE { ?o dyknow:speed ?v }"
)
POLICY = (
    '<cu type="policy"><parameter name="policy" value="sample every {}s"/><stream name="s"/></cu>'
)
TWO_POLICIES = (
    '<specification xmlns="http://www.dyknow.eu/ontology#Specification"><insertions>'
    f"{POLICY.format(1)}{POLICY.format(2)}</insertions></specification>"
).encode()
PORT = DescribedPort("dyknow:speed", "value", None, (DescribedArgument("dyknow:UAV"),))


def summed(name):
    return DescribedTransformation(name, (PORT,), PORT, "Sum")


@pytest.mark.parametrize("removed", ["in the log", "while it waits", "not at all"])
def test_whatever_another_version_refuses_can_be_taken_back(
    tmp_path, monkeypatch, high_speed, removed
):
    def remove(recorded):
        for id in ("event2", "event1"):
            recorded.do(CancelEvent(id))
        recorded.do(RemoveTemplate("HighSpeedEvent"))
        recorded.do(RemoveQuery("q"))
        recorded.do(RemoveTransformation("half"))
        recorded.do(RemoveStream("gone"))
        recorded.do(RemoveStream("described"))
        recorded.do(RemoveOntology("ships"))

    first = opened(tmp_path, processes=summing(total))
    declare(first, "s")
    first.checkpoint().write()
    first.do(RegisterTemplate(high_speed))
    first.do(RequestEvent("dyknow:HighSpeedEvent(?o, dyknow:UAV, 1)"))
    first.do(RequestEvent("dyknow:HighSpeedEvent(?o, dyknow:UAV, 2)"))
    first.do(RegisterQuery(f"REGISTER QUERY q AS {UNNAMED}"))
    first.do(RegisterTransformations((summed("half"), summed("third"))))
    first.do(DeclareStream(StreamDeclaration("gone", (Field("v", FieldType.FLOAT),))))
    first.do(Annotate("stream described contains speed(UAV) = v for every UAV = id"))
    first.do(LoadOntology("<urn:a> <urn:b> <urn:c> .", "ships"))
    if removed == "in the log":
        remove(first)
    cut_off(first)

    def refuse(*_, **__):
        raise Conflict("this version takes none of it")

    with monkeypatch.context() as patched:
        patched.setattr(recorded_module, "program", lambda *_: "a version that refuses")
        for name in ("register_template", "declare", "annotate", "load_ontology"):
            patched.setattr(Engine, name, refuse)
        patched.setattr(RegisteredQueries, "start", refuse)
        patched.setattr(RegisteredTransformations, "register_all", refuse)
        refusing = opened(tmp_path, processes=summing(total))
        assert refusing.engine.templates() == refusing.engine.events() == ()
        assert not refusing.engine.has_stream("gone")
        if removed == "while it waits":
            remove(refusing)
        cut_off(refusing)
        cut_off(opened(tmp_path, processes=summing(total)))
    back = opened(tmp_path, processes=summing(total))
    is_there = removed == "not at all"
    assert [view.id for view in back.engine.events()] == ["event1", "event2"] * is_there
    assert bool(back.engine.templates()) == back.engine.queries.has("q") == is_there
    assert back.engine.has_stream("gone") == back.engine.has_stream("described") == is_there
    names = {view.name for view in back.engine.transformations.views()}
    assert ("half" in names, "third" in names) == (is_there, True)
    assert (back.engine.ontology.loaded("ships") is not None) == is_there
    cut_off(back)


def test_each_user_of_a_query_that_waits_is_one(tmp_path, monkeypatch):
    first = opened(tmp_path)
    declare(first, "s")
    first.checkpoint().write()
    other = first.do(RegisterQuery(UNNAMED.replace("5s", "3s"))).name
    shared = [first.do(RegisterQuery(UNNAMED)).name for _ in range(4)]
    for name in shared[:2]:
        first.do(RemoveQuery(name))
    cut_off(first)

    def refuse(*_):
        raise Conflict("this version has no windows")

    with monkeypatch.context() as patched:
        patched.setattr(recorded_module, "program", lambda *_: "a version that refuses")
        patched.setattr(RegisteredQueries, "start", refuse)
        refusing = opened(tmp_path)
        told = [value["specification"] or "" for *_, value in rows(refusing.engine, "status")]
        assert any(f"query {other}: this version" in text for text in told)
        cut_off(refusing)
    back = opened(tmp_path)
    assert [view.users for view in back.engine.queries.views()] == [1, 2]
    cut_off(back)


@pytest.mark.parametrize("checkpoint", ["before", "after", "never"])
def test_queries_without_a_name_keep_what_they_were_called(tmp_path, monkeypatch, checkpoint):
    """Also those that wait, and where what is made besides them took names before they did."""
    first = opened(tmp_path)
    declare(first, "s")
    if checkpoint == "before":
        first.checkpoint().write()
    gone = first.do(RegisterQuery(UNNAMED.replace("5s", "2s"))).name
    kept = first.do(RegisterQuery(UNNAMED)).name
    first.do(ApplySpecification(TWO_POLICIES))
    assert first.do(RegisterQuery(UNNAMED)).name == kept
    other = first.do(RegisterQuery(UNNAMED.replace("5s", "3s"))).name
    first.do(RemoveQuery(gone))
    if checkpoint == "after":
        first.checkpoint().write()
    cut_off(first)

    def refuse(*_):
        raise Conflict("this version has no windows")

    def named(recorded):
        return {view.name: view.source for view in recorded.engine.queries.views()}

    reserved_name = Configuration.reserved_name

    def wasteful(self):
        """This version makes more units for the same."""
        return [reserved_name(self) for _ in range(3)][-1]

    monkeypatch.setattr(recorded_module, "program", lambda *_: "another version")
    monkeypatch.setattr(Configuration, "reserved_name", wasteful)
    taking = opened(tmp_path)
    assert named(taking) == {kept: UNNAMED, other: UNNAMED.replace("5s", "3s")}
    assert taking.waiting() == ()
    cut_off(taking)
    with monkeypatch.context() as patched:
        patched.setattr(recorded_module, "program", lambda *_: "a version that refuses")
        patched.setattr(RegisteredQueries, "start", refuse)
        for _ in range(2):
            refusing = opened(tmp_path)
            assert {each.key.name for each in refusing.waiting()} == {kept, other}
            assert {each.reason for each in refusing.waiting()} == {"this version has no windows"}
            cut_off(refusing)
    back = opened(tmp_path)
    assert set(named(back)) == {kept, other}
    new = back.do(RegisterQuery(UNNAMED.replace("5s", "9s"))).name
    assert new not in (gone, kept, other)
    back.do(RemoveQuery(other))
    cut_off(back)
    again = opened(tmp_path)
    assert set(named(again)) == {kept, new}
    cut_off(again)


def test_what_was_said_anew_counts_and_not_what_waited(tmp_path, monkeypatch, high_speed):
    first = opened(tmp_path)
    declare(first, "s")
    first.checkpoint().write()
    first.do(RegisterTemplate(high_speed, replace=True))
    cut_off(first)

    def refuse(*_, **__):
        raise Conflict("this version takes none of it")

    with monkeypatch.context() as patched:
        patched.setattr(recorded_module, "program", lambda *_: "a version that refuses")
        with patched.context() as once:
            once.setattr(Engine, "register_template", refuse)
            refusing = opened(tmp_path)
        newer = refusing.do(RegisterTemplate(f"# newer\n{high_speed}"))
        refusing.close()
    back = opened(tmp_path)
    assert back.engine.template("HighSpeedEvent").source == newer.source
    cut_off(back)


def test_what_was_refused_is_not_done_by_another_program(tmp_path):
    """Nobody was promised it, and what came after it keeps its ids."""
    first = opened(tmp_path, processes=summing(total))
    declare_numbers(first)
    cut_off(first)
    without = opened(tmp_path, processes=Processes())
    with pytest.raises(UnknownStream):
        without.do(Subscribe("summed"))
    stays, gone = without.do(Subscribe("s")), without.do(Subscribe("s"))
    without.do(Unsubscribe(gone.id))
    cut_off(without)
    again = opened(tmp_path, processes=summing(total))
    assert _subscribed(again) == {stays.id: "s"}
    cut_off(again)


def test_what_waits_in_a_checkpoint_of_an_earlier_version_comes_after_all_others():
    portable = msgspec.convert(
        {
            "format": 1,
            "now": 0,
            "quads": b"",
            "streams": [],
            "standing": [{"do": "subscribe", "stream": "status"}],
            "waiting": [{"do": "subscribe", "stream": "status"}],
            "ids": ["subscription3", "event1", "subscription4"],
        },
        Portable,
    )
    engine, _, lost = engine_from(portable, 0, Outside(Processes(), DIRECT))
    assert [view.id for view in engine.subscriptions()] == ["subscription3", "subscription4"]
    assert not lost


def test_a_new_life_begins_once_and_not_at_each_start(tmp_path, monkeypatch):
    first = opened(tmp_path)
    declare(first, "s")
    say(first, 1, 2, 9)
    cut_off(first)
    monkeypatch.setattr(recorded_module, "program", lambda *_: "a later version")
    later = opened(tmp_path)
    assert not later.recovery.is_continued
    say(later, 10, 20)
    cut_off(later)
    again = opened(tmp_path)
    assert again.recovery.is_continued
    assert again.engine.epoch == later.engine.epoch
    assert rows(again.engine, "s") == rows(later.engine, "s")
    cut_off(again)
    monkeypatch.undo()
    # The first program is back: what the later one did need not be what comes of it here.
    back = opened(tmp_path)
    assert not back.recovery.is_continued
    back.close()


def test_what_another_program_did_after_a_checkpoint_of_this_one_begins_anew(tmp_path, monkeypatch):
    """Also where that one could write no checkpoint of its own."""
    first = opened(tmp_path)
    declare(first, "s")
    first.checkpoint().write()
    cut_off(first)
    monkeypatch.setattr(recorded_module, "program", lambda *_: "a later version")
    monkeypatch.setattr(RecordedEngine, "_write_first_checkpoint", lambda self: None)
    later = opened(tmp_path)
    say(later, 1, 9)
    cut_off(later)
    monkeypatch.undo()
    back = opened(tmp_path)
    assert not back.recovery.is_continued
    assert back.engine.epoch != later.engine.epoch
    back.close()


def test_the_program_is_another_with_other_user_written_code(tmp_path):
    module = tmp_path / "units_of_mine.py"
    found = []
    for text in ("1.0", "2.0", "1.0"):
        module.write_text(f"def same(time):\n    return {text}\n")
        sys.modules.pop("units_of_mine", None)
        spec = importlib.util.spec_from_file_location("units_of_mine", module)
        sys.modules["units_of_mine"] = loaded = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(loaded)
        registry = Processes()
        registry.sampled("float", "100ms")(loaded.same)
        found.append(program(registry))
    del sys.modules["units_of_mine"]
    assert found[0] == found[2] != found[1]
    assert program() not in found
    assert all(each.startswith(f"{program()}, ") for each in found)


def test_the_program_is_another_with_other_versions_of_what_is_pickled(monkeypatch):
    known = checkpoint_module._program.__wrapped__()
    usual = checkpoint_module.version
    for package in ("numpy", "msgspec", "pyoxigraph", "numba"):
        monkeypatch.setattr(
            checkpoint_module,
            "version",
            lambda name, package=package: "99" if name == package else usual(name),
        )
        assert checkpoint_module._program.__wrapped__() != known
        monkeypatch.undo()
    assert checkpoint_module._program.__wrapped__() == known


def test_a_stream_whose_fields_are_others_now_says_what_is_not_taken_over(tmp_path, monkeypatch):
    first = opened(tmp_path)
    declare(first, "s")
    say(first, 1, 2, 3, 9)
    before = first.engine.stream("s")
    first.close()
    monkeypatch.setattr(recorded_module, "program", lambda *_: "a later version")
    usual = Ontology.from_quads

    def changed(quads):
        return usual(quads.replace(b'[\\"v\\", \\"float\\"]', b'[\\"w\\", \\"string\\"]'))

    monkeypatch.setattr(Ontology, "from_quads", changed)
    later = opened(tmp_path)
    (note,) = [note for note in later.recovery.notes if "other fields" in note]
    assert "s has other fields" in note
    assert "of its 4 samples v (float) was not restored" in note
    assert "w (string)" in note
    told = [value["specification"] for *_, value in rows(later.engine, "status")]
    assert note in told
    after = later.engine.stream("s")
    assert (after.counters, after.last_number) == (before.counters, before.last_number)
    kept = [value for *_, value in rows(later.engine, "s")]
    assert kept == [{"id": "uav1", "w": None}] * len(kept)
    assert len(kept) > 1
    later.close()


def test_a_command_that_cannot_be_written_is_not_begun(tmp_path):
    def declare(size):
        fields = (Field("v", FieldType.FLOAT),)
        return DeclareStream(StreamDeclaration("s", fields, retention=Retention(bytes=size)))

    first = RecordedEngine(tmp_path, now=0)
    with pytest.raises(OverflowError):
        first.do(declare(2**70))
    assert first.failure is None
    assert "s" not in [view.name for view in first.engine.streams()]
    first.do(declare(2**62))
    first.close()
    again = RecordedEngine(tmp_path, now=0)
    assert again.engine.stream("s").retention == Retention(bytes=2**62)
    again.close()


def test_the_data_directory_is_for_its_owner_only(tmp_path):
    data = tmp_path / "new" / "data"
    first = RecordedEngine(data, now=0)
    first.do(DeclareStream(StreamDeclaration("s", (Field("v", FieldType.FLOAT),))))
    first.checkpoint().put()
    first.close()
    assert [path.name for path in [data, *data.rglob("*")] if path.stat().st_mode & 0o077] == []


def test_streams_of_rdf_stay_also_for_another_program(tmp_path, monkeypatch):
    """Their kind, their statements, and the names of blank nodes, which are given on arrival."""
    first = opened(tmp_path)
    first.do(DeclareStream(StreamDeclaration("r", SCHEMA.fields, time_property="")))
    first.do(
        RegisterQuery(
            "REGISTER QUERY all AS SELECT ?s ?o FROM STREAM <http://www.ida.liu.se/dyknow/r.trdf> "
            "[RANGE 5s STEP 1s] WHERE { ?s <urn:p> ?o }"
        )
    )
    for now in (1, 2):
        first.do(Publish("r", "turtle", b"<urn:a> <urn:p> [ <urn:q> 1 ] .", now * SECOND))
    first.do(Tick(20 * SECOND))
    before, results = rows(first.engine, "r"), rows(first.engine, "all")
    nodes = {row["object"] for *_, row in before if row["object"] is not None}
    assert nodes == {"_:s1b0", "_:s3b0"}
    assert len(results)
    cut_off(first)
    again = opened(tmp_path)
    assert rows(again.engine, "r") == before
    assert rows(again.engine, "all") == results
    again.checkpoint().write()
    again.close()
    monkeypatch.setattr(recorded_module, "program", lambda *_: "a later version")
    later = opened(tmp_path)
    assert rows(later.engine, "r") == before
    later.do(Publish("r", "turtle", b"<urn:a> <urn:p> [] .", 30 * SECOND))
    assert later.engine.rdf_of("r", later.engine.generator("r").stream.newest(1)) != [""]
    assert later.engine.queries.view("all").state == "running"
    cut_off(later)
