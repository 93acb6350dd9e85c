"""What a data directory keeps of user-written processes, of what was refused, and of other
programs' checkpoints (the law is tests/laws/test_recorded.py)."""

import pickle
import random
import threading

import pytest
from pyoxigraph import NamedNode, Quad
from simulated_disk import SimulatedDisk

import dyknow.engine.recorded as recorded_module
from dyknow.continuous.asking import Kept
from dyknow.engine.checkpoint import CheckpointError
from dyknow.engine.commands import (
    AddKpl,
    Annotate,
    DeclareStream,
    OpenStream,
    Publish,
    RegisterQuery,
    RegisterTemplate,
    RequestEvent,
    SetQuality,
    Subscribe,
    Tick,
    read,
)
from dyknow.engine.errors import UnknownStream
from dyknow.engine.processes import Processes
from dyknow.engine.recorded import RecordedEngine
from dyknow.engine.reports import Report
from dyknow.engine.supervision import UnitBlocked
from dyknow.engine.views import StreamDeclaration
from dyknow.journal.errors import JournalFull
from dyknow.journal.log import Durability
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
    assert read(_last(first)) == OpenStream("s_late")
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
    first.do(RequestEvent("dyknow:HighSpeedEvent(?o, dyknow:UAV, 2)"))
    first.do(Subscribe("s", "sample every 1s"))
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
    monkeypatch.setattr(recorded_module, "program", lambda: "a later version")
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
    assert [view.id for view in later.engine.events()] == ["event1"]
    assert len(later.engine.subscriptions()) == len(later.engine.queries) == 1
    assert (
        later.engine.template("HighSpeedEvent").source
        == first.engine.template("HighSpeedEvent").source
    )
    say(later, 10, 20, 21)
    assert later.engine.stream("s").last_number > before.last_number
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

    monkeypatch.setattr(recorded_module, "engine_of", gone)
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
    with pytest.raises(CheckpointError, match="not to be trusted"):
        first.checkpoint()
    cut_off(first)
    again = opened(tmp_path)
    assert again.recovery.is_continued
    assert [view.name for view in again.engine.streams()] == ["status", "s"]
    again.close()


def test_quads_out_of_a_checkpoint_are_taken_for_no_others():
    """Workers know them by their number, which counts from 0 in each process."""
    quads = [Quad(NamedNode("urn:a"), NamedNode("urn:p"), NamedNode("urn:b"))]
    kept = Kept(quads)
    one, other = pickle.loads(pickle.dumps([kept, kept]))
    assert one is other
    assert list(one.quads) == quads
    assert len({kept.number, one.number, Kept().number}) == 3


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
