"""Law: what went wrong in sinks is told once, in the same place and under the same number, also by
an engine that was killed and opened again; no sample is given to a sink twice (P6)."""

import shutil
import tempfile
from contextlib import closing
from pathlib import Path

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from dyknow.engine.durability.commands import (
    AddKpl,
    DeclareStream,
    Publish,
    ReportSinkFailures,
    Tick,
)
from dyknow.engine.durability.durable_engine import RecordedEngine
from dyknow.engine.model.views import StreamDeclaration
from dyknow.engine.processes.external_io import Failed, Outcome
from dyknow.engine.processes.registry import Processes
from dyknow.engine.processes.supervision import UnitBlocked
from dyknow.journal.durability import Durability
from dyknow.journal.errors import JournalFull
from dyknow.journal.log import Log
from dyknow.streams.sample import Field, FieldType
from dyknow.streams.time import SECOND

LIMITS = settings(deadline=None, max_examples=30)
KPL = "source float s\nstrmgen x = s\nsink Log(x)\nsink Second(x with any change)"


class World:
    """Outside of the engine: the calls of the sink ``Log``, of which some fail, whatever they are
    called with. It outlives the engine."""

    def __init__(self, fates, rule):
        self.fates = fates
        self.calls = []
        self.processes = Processes()
        self.processes.consumer(["float"], name="Log", **rule)(self._log)
        self.processes.consumer(["float"], name="Second", on_error="skip")(self._second)

    def _log(self, sample):
        self.calls.append(sample.value)
        fate = self.fates[(len(self.calls) - 1) % len(self.fates)]
        if fate == "fails":
            raise OSError(f"call {len(self.calls)} found nobody")
        if fate == "blocks":
            raise UnitBlocked("it did not come back")

    def _second(self, sample):
        if sample.value % 3 == 0:
            raise ValueError(f"{sample.value} is not to its taste")

    def opened(self, path):
        return RecordedEngine(path, now=0, processes=self.processes, durability=Durability.WRITE)


def batch(first, count):
    lines = [
        f'{{"valid": {k}000000000, "available": {k}000000000, "value": {k}}}'
        for k in range(first, first + count)
    ]
    return Publish("s", "ndjson", "\n".join(lines).encode(), 0)


def commands(sizes):
    yield DeclareStream(StreamDeclaration("s", (Field("value", FieldType.FLOAT),)))
    yield AddKpl(KPL)
    first = 1
    for number, size in enumerate(sizes):
        yield batch(first, size)
        first += size
        yield Tick((number + 1) * SECOND)


def told(engine):
    """What clients of `/status/events` see, and how the sinks are."""
    sinks = engine._parts.application._readers.values()
    return (
        list(engine.generator("status").stream.all().rows()),
        [(sink.counters, sink.failure, sink._supervisor._in_a_row) for sink in sinks],
    )


def lived(world, sizes, cuts):
    """What is told by a life that is cut off after the commands that ``cuts`` has; with True behind
    a checkpoint. Also how many sinks there were."""
    path = Path(tempfile.mkdtemp())
    recorded = world.opened(path)
    try:
        for number, command in enumerate(commands(sizes)):
            recorded.do(command)
            if number in cuts:
                if cuts[number]:
                    recorded.checkpoint().write()
                recorded.log.commit()
                recorded._directory.close()
                recorded = world.opened(path)
                assert recorded.recovery.notes == []
        assert len(recorded.engine._parts.application._readers) == 2
        return told(recorded.engine)
    finally:
        recorded._directory.close()
        shutil.rmtree(path)


RULES = st.sampled_from([{"on_error": "skip"}, {"on_error": "stop"}, {"restarts": 2}])
FATES = st.lists(st.sampled_from(["works", "works", "fails", "blocks"]), min_size=1, max_size=12)


@LIMITS
@given(
    FATES,
    RULES,
    st.lists(st.integers(1, 4), max_size=6),
    st.dictionaries(st.integers(0, 13), st.booleans()),
)
@example(["fails"], {"restarts": 2}, [2, 1, 1], {3: False, 5: True})
@example(
    ["fails", "works", "fails", "fails", "works"],
    {"restarts": 1},
    [1] * 5,
    dict.fromkeys(range(12), False),
)
def test_a_life_that_is_cut_tells_what_a_whole_one_tells(fates, rule, sizes, cuts):
    whole, cut = World(fates, rule), World(fates, rule)
    expected = lived(whole, sizes, {})
    assert lived(cut, sizes, cuts) == expected
    assert cut.calls == whole.calls


def changes(engine):
    return [values["change"] for *_, values in engine.generator("status").stream.all().rows()]


@pytest.fixture
def recorded(tmp_path):
    world = World(["fails"], {"on_error": "stop"})
    with closing(world.opened(tmp_path)) as recorded:
        for command in commands([]):
            recorded.do(command)
        yield recorded


def test_a_sink_that_stops_is_not_called_again_in_the_same_command(recorded):
    recorded.do(batch(1, 2))
    assert changes(recorded.engine).count("unit stopped by rule") == 1
    recorded.do(batch(3, 2))
    assert changes(recorded.engine).count("unit stopped by rule") == 1


def test_what_finds_no_room_is_told_when_there_is_room(recorded, monkeypatch):
    """Before the next command, which is refused until then."""
    entry = Log.entry

    def full(self, payload):
        if b"sinks" in payload:
            raise JournalFull("no room")
        return entry(self, payload)

    with monkeypatch.context() as patched:
        patched.setattr(Log, "entry", full)
        recorded.do(batch(1, 1))  # it is taken
        assert "unit failed" not in changes(recorded.engine)
        with pytest.raises(JournalFull):
            recorded.do(Tick(SECOND))
        assert "unit failed" not in changes(recorded.engine)
    recorded.do(Tick(SECOND))
    assert changes(recorded.engine)[-2:] == ["unit failed", "unit stopped by rule"]


def test_what_is_told_of_a_sink_that_is_gone_is_nothing(recorded):
    before = changes(recorded.engine)
    gone = Outcome("a sink that is gone", (Failed(1, "it failed", "it stops"),), 1)
    recorded.do(ReportSinkFailures((gone,)))
    assert changes(recorded.engine) == before
