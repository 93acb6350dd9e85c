"""A large batch is taken in parts, with others' commands in between
(tests/laws/engine/test_backlog.py has the law: nothing changes but when)."""

from __future__ import annotations

import json
from random import Random

import pytest
from stepping import Steps, caught_up

from dyknow.engine.durability.commands import (
    Annotate,
    DeclareStream,
    Publish,
    RegisterQuery,
    RemoveQuery,
)
from dyknow.engine.engine import Engine
from dyknow.engine.model.views import StreamDeclaration
from dyknow.engine.units import windowed
from dyknow.engine.units.backlog import TurnRecord
from dyknow.streams.sample import Field, FieldType

FIELDS = (Field("id", FieldType.STRING), Field("v", FieldType.FLOAT))
QUERY = """REGISTER QUERY count COMPUTE EVERY 1s AS SELECT (COUNT(?v) AS ?many)
FROM STREAM <http://www.ida.liu.se/dyknow/s.trdf> [RANGE 1s STEP 1s] WHERE { ?o dyknow:speed ?v }"""
SECOND = 10**9


class Looks(Steps):
    """Over when it has been asked so often."""

    def __init__(self) -> None:
        super().__init__(Random(1))
        self.left = 0

    @property
    def is_over(self) -> bool:
        self.left -= 1
        return self.left < 0


@pytest.fixture(autouse=True)
def _small_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(windowed, "_PART", 10)


@pytest.fixture
def looks() -> Looks:
    return Looks()


@pytest.fixture
def engine(looks: Looks) -> Engine:
    return reading(Engine(turns=looks))


def reading(engine: Engine) -> Engine:
    for command in (
        DeclareStream(StreamDeclaration("s", FIELDS)),
        Annotate("stream s contains speed(UAV) = v for every UAV = id"),
        RegisterQuery(QUERY),
    ):
        command.apply(engine)
    return engine


def publish(engine: Engine, *times: int) -> None:
    """Samples at these times, in ms."""
    moments = [n * SECOND // 1000 for n in times]
    rows = [{"valid": t, "available": t, "id": f"uav{t}", "v": 1.0} for t in moments]
    body = "\n".join(map(json.dumps, rows)).encode()
    Publish("s", "ndjson", body, moments[-1]).apply(engine)


def counts(engine: Engine) -> list[object]:
    batches = [segment.batch for segment in engine.generator("count").stream.since(0)]
    return [n for batch in batches for n in batch.columns["many"].values.tolist()]


def test_others_have_their_turn_between_two_parts(engine: Engine, looks: Looks) -> None:
    at_once = reading(Engine())
    for each in (engine, at_once):
        publish(each, *range(100, 4600, 100))
    unit = engine.backlog_of("s")[0]
    assert unit.is_taking_parts
    assert counts(at_once)
    assert counts(engine) == []
    looks.left = 2
    assert engine.work_backlog() == (TurnRecord(unit.name, 0, parts=2),)
    # What comes meanwhile comes after them.
    for each in (engine, at_once):
        publish(each, 5000, 6100)
    assert unit.is_taking_parts
    looks.left = 100
    assert engine.work_backlog() == (TurnRecord(unit.name, 0, parts=3),)
    assert not unit.is_taking_parts
    looks.left = 1000
    caught_up(engine.work_backlog, engine.backlog, looks)
    assert engine.backlog_of("s") == ()
    assert counts(engine) == counts(at_once)


def test_a_batch_that_is_not_large_is_taken_at_once(engine: Engine) -> None:
    publish(engine, *range(1, 21))
    assert engine.backlog_of("s") == ()
    publish(engine, *range(21, 42))
    assert engine.backlog_of("s")


def test_what_is_removed_takes_nothing_more(engine: Engine) -> None:
    publish(engine, *range(100, 4600, 100))
    RemoveQuery("count").apply(engine)
    assert not engine.backlog
    publish(engine, *range(4600, 9000, 100))
    assert not engine.backlog


def test_parts_that_are_not_there_cannot_be_taken_again(engine: Engine) -> None:
    publish(engine, *range(1, 26))
    name = engine.backlog_of("s")[0].name
    with pytest.raises(ValueError, match="has no part of a batch to take"):
        engine.replay_turns([TurnRecord(name, 0, parts=4)])
