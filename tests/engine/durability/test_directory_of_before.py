"""Directories that a program before the rules of instants wrote give what they gave (P9).

tests/fixtures/before_instants.tar.xz holds them, with what the engine of then told of them
(tests/support/engines/directory_of_before.py); it is never made anew.
"""

import json
import tarfile

import pytest
from directory_of_before import told
from places import TESTS

from dyknow.engine.durability import durable_engine as recording
from dyknow.engine.durability import recovery
from dyknow.engine.durability.commands import (
    AddKpl,
    Annotate,
    ApplySpecification,
    DeclareStream,
    Publish,
    Subscribe,
)
from dyknow.engine.durability.durable_engine import RecordedEngine
from dyknow.engine.model.views import Since, StreamDeclaration
from dyknow.journal.durability import Durability
from dyknow.streams.sample import Field, FieldType
from dyknow.streams.stream_rules import UNIQUE_TIMES
from dyknow.streams.time import SECOND

ARCHIVE = TESTS / "fixtures" / "before_instants.tar.xz"


FIELDS = (Field("id", FieldType.STRING), Field("spd", FieldType.FLOAT))


@pytest.fixture
def written(tmp_path):
    """The directories, and what was told of each."""
    with tarfile.open(ARCHIVE) as archive:
        archive.extractall(tmp_path, filter="data")
    return tmp_path, json.loads((tmp_path / "expected.json").read_text())


def opened(path):
    return RecordedEngine(path, now=15 * SECOND, durability=Durability.WRITE)


def plain(found):
    return json.loads(json.dumps(found))


@pytest.mark.parametrize("kind", ["log", "checkpoint"])
def test_streams_numbers_and_events_are_what_they_were(written, kind):
    folder, expected = written
    recorded = opened(folder / kind)
    found = plain(told(recorded))
    recorded.close(checkpoint=False)
    assert found["streams"].keys() == expected[kind]["streams"].keys()
    for name, stream in expected[kind]["streams"].items():
        assert found["streams"][name] == stream, name
    assert found == expected[kind]


POLICY = """<specification xmlns="http://www.dyknow.eu/ontology#Specification"><insertions>
<cu name="specified" type="policy"><parameter name="policy" value="sample every 1s"/>
<stream name="radar"/></cu></insertions></specification>"""


@pytest.mark.parametrize("kind", ["log", "state", "checkpoint"])
def test_policies_of_before_are_of_the_whole_stream(tmp_path, monkeypatch, kind):
    """A program with the rules of before is this one: only `begin` says by which rules it wrote."""
    monkeypatch.setattr(recovery, "INSTANTS", UNIQUE_TIMES)
    first = opened(tmp_path)
    first.do(DeclareStream(StreamDeclaration("radar", FIELDS)))
    first.do(Annotate("stream radar contains speed(UAV) = spd for every UAV = id"))
    first.do(AddKpl("sort fix = (id string, spd float) source fix radar strmgen f = radar"))
    first.do(AddKpl("stream declared = f with sample every 1s"))
    first.do(ApplySpecification(POLICY.encode()))
    rows = [row(at + k / 2, f"uav{k}", 1.0) for at in range(1, 4) for k in (0, 1)]
    first.do(Publish("radar", "ndjson", "\n".join(rows[:3]).encode(), 9 * SECOND))
    first.close(checkpoint=kind != "log")
    monkeypatch.undo()
    if kind == "checkpoint":
        monkeypatch.setattr(recording, "program", lambda *_: "another")
    recorded = opened(tmp_path)
    recorded.do(Publish("radar", "ndjson", "\n".join(rows[3:]).encode(), 9 * SECOND))
    # Of a checkpoint another program takes the samples of streams that people publish to.
    expected = ["uav1"] * 2 if kind == "checkpoint" else ["uav0"] * 3
    for name in ("declared", "specified"):
        whole = recorded.engine.generator(name).stream.all()
        assert [values["id"] for _, _, values in whole.rows()] == expected
    # What is asked for from now on goes by the rules of now, where these hold.
    found = recorded.do(Subscribe("radar", "sample every 1s", since=Since.START, keyed=True))
    after = recorded.engine.generator(found.stream).stream.all()
    assert len(after) == (6 if recorded.engine.rules.separates_objects else 3)
    assert recorded.engine.rules.separates_objects is (kind == "checkpoint")
    recorded.close()


def row(at, id, value):
    line = {"valid": int(at * SECOND), "available": int(at * SECOND), "id": id, "spd": value}
    return json.dumps(line)


@pytest.mark.parametrize("kind", ["log", "checkpoint"])
def test_what_comes_after_it_goes_by_the_rules_of_now(written, kind):
    """Of the last instant the directory knows one row: others are samples now."""
    folder, expected = written
    before = expected[kind]["streams"]["radar"]["counters"]
    recorded = opened(folder / kind)
    sweep = "\n".join([row(14, "uav1", 15.0), row(14, "uav2", 16.0), row(14, "uav2", 16.0)])
    recorded.do(Publish("radar", "ndjson", sweep.encode(), 16 * SECOND))
    found = plain(told(recorded))
    _, used, late, duplicate, *_ = found["streams"]["radar"]["counters"]
    assert (used, late, duplicate) == (before[1] + 1, before[2], before[3] + 2)
    recorded.log.commit()
    recorded._directory.close()  # killed: the next start repeats both kinds of commands
    again = opened(folder / kind)
    assert again.recovery.is_continued
    assert plain(told(again)) == found
    again.close()
