"""A stream that got further fields while it was in use goes on after a restart."""

import pytest

from dyknow.engine.durability import durable_engine as recorded_module
from dyknow.engine.durability.commands import (
    Annotate,
    DeclareStream,
    Publish,
    Subscribe,
)
from dyknow.engine.durability.durable_engine import RecordedEngine
from dyknow.engine.model.views import Since, StreamDeclaration
from dyknow.journal.durability import Durability
from dyknow.streams.sample import Field, FieldType

ID, SPD, NOTE = (
    Field("id", FieldType.STRING),
    Field("spd", FieldType.FLOAT),
    Field("note", FieldType.STRING),
)
SSL = "stream s contains speed(UAV) = spd [km.h-1] for every UAV = id"


def opened(path):
    return RecordedEngine(path, now=0, durability=Durability.WRITE)


def told(engine, stream):
    return list(engine.generator(stream).stream.all().rows())


@pytest.mark.parametrize("checkpoint", [None, "before", "after"])
@pytest.mark.parametrize("version", ["same", "another"])
def test_a_widened_stream_after_a_restart(tmp_path, monkeypatch, checkpoint, version):
    first = opened(tmp_path)
    first.do(DeclareStream(StreamDeclaration("s", (ID, SPD))))
    first.do(Annotate(SSL))
    policed = first.do(Subscribe("s", "any change", since=Since.START, keyed=True)).stream
    first.do(Publish("s", "ndjson", b'{"available": 1, "valid": 1, "id": "a", "spd": 1}\n', 0))
    if checkpoint == "before":
        first.checkpoint().put()
    first.do(DeclareStream(StreamDeclaration("s", (NOTE, ID, SPD), 5)))
    line = b'{"available": 9, "valid": 9, "id": "a", "spd": 2, "note": "x"}\n'
    first.do(Publish("s", "ndjson", line, 0))
    if checkpoint == "after":
        first.checkpoint().put()
    wanted, passed = told(first.engine, "s"), told(first.engine, policed)
    pending = first.engine.stream("s").counters.pending
    first.close()
    if version == "another":
        monkeypatch.setattr(recorded_module, "program", lambda *_: "another version")
    again = opened(tmp_path)
    try:
        assert told(again.engine, "s") == wanted
        assert again.engine.stream("s").counters.pending == pending
        assert again.engine.stream("s").annotation == SSL
        if version == "same":
            assert told(again.engine, policed) == passed
        again.do(Publish("s", "ndjson", line.replace(b"9", b"20"), 0))
        assert told(again.engine, "s")[-1][2] == {"note": "x", "id": "a", "spd": 2.0}
    finally:
        again.close()
