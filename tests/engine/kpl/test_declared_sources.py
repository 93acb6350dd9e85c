"""Streams that are sources of KPL declarations can be declared further while they are in use."""

import pytest

from dyknow.engine.durability import durable_engine as recorded_module
from dyknow.engine.durability.commands import AddKpl, DeclareStream, Publish, RemoveKpl
from dyknow.engine.durability.durable_engine import RecordedEngine
from dyknow.engine.engine import Engine
from dyknow.engine.model.errors import Conflict
from dyknow.engine.model.views import StreamDeclaration
from dyknow.journal.durability import Durability
from dyknow.streams.history import Retention
from dyknow.streams.sample import Field, FieldType

ID, SPD, NOTE = (
    Field("id", FieldType.STRING),
    Field("spd", FieldType.FLOAT),
    Field("note", FieldType.STRING),
)
SORTED = (
    "sort fix = (id string, spd float)\nsource fix s\nstrmgen f = s\nstream k = f with any change"
)
OPEN = "source open s\nstrmgen f = s\nstream k = f with any change"


def line(time, **values):
    fields = "".join(f', "{name}": {value}' for name, value in values.items())
    return f'{{"available": {time}, "valid": {time}{fields}}}\n'.encode()


def told(engine, stream):
    return [values for _, _, values in engine.generator(stream).stream.all().rows()]


def test_a_source_of_a_declared_sort_gets_a_field_and_another_lateness():
    engine = Engine()
    engine.add_kpl(SORTED)
    retention = Retention(7)
    view = engine.declare(StreamDeclaration("s", (ID, SPD, NOTE), 5, retention, idle=9))
    assert (engine.generator("s").schema.names, view.lateness) == (("id", "spd", "note"), 5)
    assert engine.generator("s").stream.retention == retention
    assert engine.generator("s").idle == 9
    with pytest.raises(Conflict, match="source of KPL"):
        engine.declare(StreamDeclaration("s", (SPD, NOTE)))
    with pytest.raises(Conflict, match="source of KPL"):
        engine.remove_stream("s")


def test_an_open_source_takes_the_fields_that_are_declared():
    engine = Engine()
    engine.add_kpl(OPEN)
    engine.declare(StreamDeclaration("s", (ID, SPD)))
    assert engine.generator("s").schema.names == ("id", "spd")
    engine.declare(StreamDeclaration("s", (ID, SPD, NOTE)))
    assert engine.generator("s").schema.names == ("id", "spd", "note")


@pytest.mark.parametrize("version", ["same", "another"])
@pytest.mark.parametrize("kpl", [SORTED, OPEN])
def test_a_declared_source_after_a_restart(tmp_path, monkeypatch, kpl, version):
    def opened():
        return RecordedEngine(tmp_path, now=0, durability=Durability.WRITE)

    first = opened()
    first.do(AddKpl(kpl))
    first.do(DeclareStream(StreamDeclaration("s", (ID, SPD))))
    first.do(Publish("s", "ndjson", line(1, id='"a"', spd=1), 0))
    first.do(DeclareStream(StreamDeclaration("s", (ID, SPD, NOTE))))
    first.do(Publish("s", "ndjson", line(2, id='"a"', spd=1, note='"x"'), 0))
    first.do(Publish("s", "ndjson", line(3, id='"a"', spd=2, note='"y"'), 0))
    kept, passed = told(first.engine, "s"), told(first.engine, "k")
    assert passed == [{"id": "a", "spd": v} for v in (1.0, 1.0, 2.0)]
    first.close(checkpoint=version == "another")
    if version == "another":
        monkeypatch.setattr(recorded_module, "program", lambda *_: "another version")
    again = opened()
    try:
        assert told(again.engine, "s") == kept
        if version == "same":
            assert told(again.engine, "k") == passed
        again.do(Publish("s", "ndjson", line(4, id='"a"', spd=5, note='"z"'), 0))
        assert told(again.engine, "s")[-1] == {"id": "a", "spd": 5.0, "note": "z"}
        assert told(again.engine, "k")[-1]["spd"] == 5.0
        again.do(RemoveKpl("s", cascade=True))
        assert again.engine.generator("s").schema.names == ("id", "spd", "note")
    finally:
        again.close()
