"""What was written once is readable for ever: the files in tests/cases/journal.

``DYKNOW_REWRITE=1 pytest tests/engine/durability/test_written_forms.py`` adds what is not there
yet. It never changes what is: a file that cannot be read any more is an error in the program.
"""

import itertools
import json
import os
from typing import get_args

import msgspec
import pytest
from places import TESTS

from dyknow.engine.catalog.iri_annotations import (
    DescribedArgument,
    DescribedPort,
    DescribedStream,
    DescribedTransformation,
)
from dyknow.engine.durability import commands as c
from dyknow.engine.durability.portable_state import (
    KeptColumn,
    KeptStream,
    Portable,
)
from dyknow.engine.model.views import Since, StreamDeclaration
from dyknow.engine.processes.external_io import Failed, Outcome, Reading
from dyknow.engine.units.backlog import TurnRecord
from dyknow.journal.checkpoints import Checkpoint, parts_of, read_checkpoint
from dyknow.journal.examination import examine
from dyknow.journal.log import Log
from dyknow.journal.segment import walk
from dyknow.streams.generator import Counters
from dyknow.streams.history import Retention
from dyknow.streams.sample import Field, FieldType
from dyknow.streams.stream_rules import INSTANTS
from dyknow.streams.time import FOREVER, HOUR

CASES = TESTS / "cases" / "journal"
COMMANDS = CASES / "commands.jsonl"
CHECKPOINT = CASES / "00000000000000000003.checkpoint"
PORT = DescribedPort("dyknow:speed", "spd", "km/h", (DescribedArgument("UAV", "a", "id"),))
LATER = {"ahead": HOUR}
"""What members that came later say where nothing is written."""
KNOWN = DescribedPort(
    "dyknow:speed", "spd", None, (DescribedArgument("UAV", "a", "id", True, True),)
)
EXAMPLES = [
    c.Begin("3f2a91c0", 1_633_633_973_000_000_000, "dyknow 0.1.0, Python 3.11.7, 0123456789abcdef"),
    c.Tick(1_633_633_973_100_000_000),
    c.Tick(
        1_633_633_973_200_000_000,
        (
            Reading("pos", 5, (5, 4, {"x": 1.5, "n": 2, "b": True, "id": "a", "none": None})),
            Reading("pos", 6, None, 0.5, "speed(UAV) = v", "ValueError: no"),
        ),
    ),
    c.Publish("s5", "ndjson", b'{"valid": 1, "spd": 31.5}\n', 5, "key"),
    c.Publish("s5", "arrow", b"\x00\xff", 6),
    c.Publish("rdf", "turtle", b"<urn:a> <urn:p> [] .", 7),
    c.DeclareStream(
        StreamDeclaration("rdf", (Field("subject", FieldType.STRING),), time_property="urn:t")
    ),
    c.EndStream("s5"),
    c.Refused(c.encode_command(c.EndStream("nowhere"))),
    c.DeclareStream(
        StreamDeclaration(
            "s5",
            (Field("id", FieldType.STRING), Field("spd", FieldType.FLOAT)),
            5_000_000_000,
            Retention(100, 3_600_000_000_000, 1_000_000),
            "http://example.org/",
            30_000_000_000,
        )
    ),
    c.DeclareStream(StreamDeclaration("s6", (Field("v", FieldType.FLOAT),), ahead=FOREVER)),
    c.WorkBacklog((TurnRecord("dyknow_cu1", 3), TurnRecord("dyknow_cu2", 1, "it took 5 s"))),
    c.WorkBacklog((TurnRecord("dyknow_cu1", 0, parts=3),)),
    c.RemoveStream("s5"),
    c.OpenStream("s5_late"),
    c.SetQuality("s5", 0.5),
    c.Annotate("stream s5 contains speed(UAV) = spd for every UAV = id"),
    c.Describe((DescribedStream("s5", (PORT,)),)),
    c.Describe((), (DescribedTransformation("t", (PORT,), KNOWN),)),
    c.RegisterTemplate("REGISTER TEMPLATE …", True),
    c.RemoveTemplate("HighSpeedEvent"),
    c.RequestEvent("dyknow:HighSpeedEvent(?o, dyknow:UAV, 100)", strategy="cost"),
    c.RequestEvent(None, "dyknow:HighSpeedEvent", ("?o", "100"), "fast", Since.START),
    c.RequestEvent("dyknow:HighSpeedEvent(?o, dyknow:UAV, 100)", since="2021-10-07T19:12:53Z"),
    c.RegisterQuery("REGISTER QUERY …", since="30s"),
    c.CancelEvent("event1"),
    c.Subscribe("s5", "sample every 200", "s", Since.START),
    c.Subscribe("s5", "any change", keyed=True),
    c.SubscribeToFeature("dyknow:speed", keyed=True),
    c.SubscribeToFeature(
        "dyknow:speed",
        "dyknow:UAV",
        ("dyknow:uav1",),
        "quality",
        "max delay 5",
        "s",
        Since.START,
        5_000_000_000,
        0.5,
        1_000_000_000,
    ),
    c.Unsubscribe("subscription1"),
    c.RegisterQuery("REGISTER QUERY …", "set", "[)", 7, "close", "quality", Since.START),
    c.ReportSinkFailures(
        (
            Outcome("cu7", (Failed(5, "OSError: nobody is there", "it stops", "on_error"),), 1),
            Outcome("cu8"),
        )
    ),
    c.RegisterQuery("SELECT …", name="dyknow_reserved7"),
    c.RemoveQuery("fast"),
    c.AddKpl("source float x", "s"),
    c.RemoveKpl("x", True),
    c.ApplySpecification(b"<specification/>"),
    c.LoadOntology("<urn:a> <urn:b> <urn:c> .", "http://example.org/o", "ntriples"),
    c.RemoveOntology("http://example.org/o"),
    c.RegisterTransformations(
        (DescribedTransformation("t", (PORT,), PORT, "Scaled", {"factor": "2"}, 2.0, 0.5),), True
    ),
    c.RegisterAnnotatedTransformation(
        "compunit t transforms …", "Scaled", {"factor": "2"}, 2.0, 0.5, True
    ),
    c.ChangeTransformation("t", 2.0, 0.5),
    c.RemoveTransformation("t"),
    c.Begin("3f2a91c1", 0, "dyknow 0.1.0, Python 3.11.7, 0123", {"Smooth": "my_units"}),
    c.Begin("3f2a91c2", 0, "dyknow 0.2.0, Python 3.11.7, 0123", rules=INSTANTS),
    c.ReportUnkept("Smooth", "self.lock is a lock and cannot be pickled (…)"),
    c.Tick(8, (Reading("pos", 7, error="UnitBlocked: it did not come back", is_blocked=True),)),
]
PORTABLE = Portable(
    1,
    5_000_000_000,
    b"<urn:a> <urn:b> <urn:c> .\n",
    [
        KeptStream(
            "s5",
            [Field("id", FieldType.STRING)],
            3,
            1,
            (1).to_bytes(8, "little") + (2).to_bytes(8, "little"),
            (1).to_bytes(8, "little") + (2).to_bytes(8, "little"),
            {"id": KeptColumn(FieldType.STRING, bytes(8), b"\x00\x01", ["uav1"])},
            Counters(4, 3, 1, 0, 0),
            False,
            2,
            False,
        )
    ],
    [c.RequestEvent("dyknow:HighSpeedEvent(?o, dyknow:UAV, 100)", strategy="cost")],
)
PAYLOADS = [c.encode_command(EXAMPLES[i]) for i in (0, 1, 3)]


def test_every_command_is_among_the_examples():
    kinds = {type(each) for each in EXAMPLES}
    assert kinds == set(get_args(c.AnyCommand))
    assert kinds == set(c.Command.__subclasses__())


def test_every_member_of_a_command_is_somewhere_not_its_default():
    """Else the file would not tell how it is written."""
    there = {(type(each), name) for each in EXAMPLES for name in msgspec.to_builtins(each)}
    wanted = {
        (kind, each.encode_name)
        for kind in get_args(c.AnyCommand)
        for each in msgspec.structs.fields(kind)
    }
    assert wanted <= there


def _lines():
    if os.environ.get("DYKNOW_REWRITE") == "1":
        known = COMMANDS.read_text() if COMMANDS.exists() else ""
        there = {json.loads(line)["bytes"] for line in known.splitlines()}
        for each in EXAMPLES:
            if c.encode_command(each).hex() not in there:
                told = msgspec.to_builtins(each, builtin_types=(bytes,))
                line = {"bytes": c.encode_command(each).hex(), "is": _plain(told)}
                known += json.dumps(line, ensure_ascii=False) + "\n"
        COMMANDS.write_text(known)
    return [json.loads(line) for line in COMMANDS.read_text().splitlines()]


def _plain(value):
    if isinstance(value, bytes):
        return value.hex()
    if isinstance(value, dict):
        return {key: _plain(each) for key, each in value.items()}
    return [_plain(each) for each in value] if isinstance(value, list | tuple) else value


def _without_later(told, was):
    """``told`` without the members of objects that ``was`` lacks and that say nothing, or what is
    usual."""
    if isinstance(told, list) and isinstance(was, list):
        return [_without_later(*each) for each in itertools.zip_longest(told, was)]
    if not isinstance(told, dict) or not isinstance(was, dict):
        return told
    return {
        key: _without_later(each, was.get(key))
        for key, each in told.items()
        if key in was or each not in (None, LATER.get(key))
    }


def test_commands_that_were_written_are_read_as_what_they_were():
    lines = _lines()
    for line in lines:
        command = c.decode_command(bytes.fromhex(line["bytes"]))
        told = _plain(msgspec.to_builtins(command, builtin_types=(bytes,)))
        # Members that came later have their defaults, which are told in arrays and dataclasses.
        assert _without_later(told, line["is"]) == line["is"]
    there = {line["bytes"] for line in lines}
    assert {c.encode_command(each).hex() for each in EXAMPLES} <= there
    found = [c.decode_command(bytes.fromhex(line["bytes"])) for line in lines]
    assert all(each in found for each in EXAMPLES)


def test_a_log_that_was_written_is_read():
    if os.environ.get("DYKNOW_REWRITE") == "1" and not list(CASES.glob("*.log")):
        log = Log(CASES)
        for payload in PAYLOADS:
            log.append(payload)
        log.close()
        name = CASES / "00000000000000000001.log"
        name.write_bytes(name.read_bytes().rstrip(b"\0") + bytes(100))
    found = examine(CASES)
    assert (found.first, found.position, found.damage, found.torn) == (1, 3, None, None)
    assert (found.mark.first, found.mark.synced, found.mark.durable) == (1, 3, 3)
    data = (CASES / "00000000000000000001.log").read_bytes()
    records = list(walk(data, 1))
    assert [data[each.begin : each.begin + each.length] for each in records] == PAYLOADS
    assert [each.position for each in records] == [1, 2, 3]


def test_a_checkpoint_that_was_written_is_read():
    kept = Checkpoint(3, "dyknow 0.1.0", msgspec.msgpack.encode(PORTABLE), b"state")
    if os.environ.get("DYKNOW_REWRITE") == "1" and not CHECKPOINT.exists():
        CHECKPOINT.write_bytes(b"".join(parts_of(kept)))
    found = read_checkpoint(CHECKPOINT)
    assert (found.position, found.program, found.state) == (3, "dyknow 0.1.0", b"state")
    assert msgspec.msgpack.decode(found.portable, type=Portable) == PORTABLE


def test_a_command_of_a_later_version_is_told():
    with pytest.raises(msgspec.DecodeError):
        c.decode_command(msgspec.msgpack.encode({"do": "what nobody knows"}))
    with pytest.raises(msgspec.DecodeError):
        c.decode_command(msgspec.msgpack.encode({"do": "tick", "now": 1, "more": 2}))
