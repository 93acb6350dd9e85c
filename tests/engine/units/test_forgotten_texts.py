"""Texts of streams that are read: they are forgotten, and nothing that is made changes."""

from __future__ import annotations

import gc
import json
from contextlib import nullcontext

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sweeping import texts_at_every_chance

from dyknow.converters.ndjson import decode_ndjson
from dyknow.engine.durability.commands import Publish
from dyknow.engine.engine import Engine
from dyknow.engine.model.errors import Conflict
from dyknow.engine.model.views import StreamDeclaration
from dyknow.engine.units.violations import Violations
from dyknow.streams import history
from dyknow.streams.generator import StreamGenerator
from dyknow.streams.history import Retention
from dyknow.streams.policies.policy import Constraint
from dyknow.streams.sample import (
    Field,
    FieldType,
    SampleBatch,
    Schema,
    batch_from_rows,
)
from dyknow.streams.string_pool import StringPool
from dyknow.streams.synchronization.synchronization import Late
from dyknow.streams.time import SECOND

FIELDS = (
    Field("id", FieldType.STRING),
    Field("note", FieldType.STRING),
    Field("v", FieldType.FLOAT),
    Field("lat", FieldType.FLOAT),
    Field("lon", FieldType.FLOAT),
)
SAYS = {
    "its speed": "speed(UAV) = v",
    "where it is": "latitude(UAV) = lat [deg], longitude(UAV) = lon [deg]",
}
QUERY = """REGISTER STREAM {name} COMPUTE EVERY 1s AS
PREFIX dyknow: <http://www.ida.liu.se/dyknow/>
SELECT ?o (MAX(?v) AS ?most) FROM STREAM <http://www.ida.liu.se/dyknow/{of}.trdf> [RANGE 2s STEP 1s]
WHERE {{ ?o dyknow:speed ?v }} GROUP BY ?o"""
MS = 1_000_000


def engine(lateness: int, says: str = "its speed") -> Engine:
    made = Engine(epoch="e")
    made.declare(StreamDeclaration("s", FIELDS, lateness=lateness, retention=Retention(20)))
    made.annotate(f"stream s contains {SAYS[says]} for every UAV = id")
    # The same samples, for terms of KPL.
    fields = "id string, note string, v float, lat float, lon float"
    made.add_kpl(f"sort row = ({fields})\nsource row r\nstrmgen row = r")
    return made


def publish(made: Engine, rows: list[tuple[int, str, str | None]]) -> None:
    """Each: available time in ms, object, note."""
    lines = [
        json.dumps(
            {
                "valid": time * MS,
                "available": time * MS,
                "id": name,
                "note": note,
                "v": time % 7,
                "lat": 58 + time % 11 / 1000,
                "lon": 15 + time % 13 / 1000,
            }
        )
        for time, name, note in rows
    ]
    for stream in ("s", "r"):
        generator = made.accepting(stream)
        batch = decode_ndjson("\n".join(lines).encode(), generator.schema, generator.stream.pools)
        made.publish(stream, batch, 0)


def told(made: Engine) -> dict[str, object]:
    """What every stream has; the status stream tells no texts of these."""
    for stream in ("s", "r"):
        made.end(stream)
    return {
        each.name: (list(each.stream.all().rows()), each.counters) for each in made.generators()
    }


names = st.sampled_from(["a", "b", "c", "d", "e"])
notes = st.none() | st.sampled_from(["x", "y", "z"]) | st.integers(0, 30).map(str)
rows = st.lists(st.tuples(st.integers(0, 6000), names, notes), min_size=1, max_size=12)
batches = st.lists(rows, min_size=1, max_size=8)
POLICIES = {
    "changes": "any change",
    "sampled": "sample every 700, max delay 2000",
    "most recent": "sample every 700, max delay 2000, use most recent, from 0 to 5600",
    "ordered": "monotone order, max delay 1500",
    "strictly ordered": "strict order, any change",
}
KPL = {
    "pairs": "join(row, row)",
    "states": "sync(row, row with any change; any change, max delay 1500)",
}
readers = st.sets(st.sampled_from(["late", "query", "select", "every object", *POLICIES, *KPL]))


@settings(deadline=None, max_examples=100)
@given(
    batches, readers, st.sampled_from([0, SECOND]), st.integers(0, 8), st.sampled_from(list(SAYS))
)
def test_forgetting_at_any_moment_changes_nothing(
    given_batches: list[list[tuple[int, str, str | None]]],
    readers: set[str],
    lateness: int,
    begins: int,
    says: str,
) -> None:
    """Whoever reads the stream from the ``begins``-th batch on, and whatever it makes of it."""

    def run(forgetting: bool) -> dict[str, object]:
        made = engine(lateness, says)
        with texts_at_every_chance() if forgetting else nullcontext():
            for number, batch in enumerate(given_batches):
                if number == begins:
                    read(made, readers)
                publish(made, batch)
            if begins >= len(given_batches):
                read(made, readers)
            return told(made)

    assert run(True) == run(False)


def read(made: Engine, readers: set[str]) -> None:
    if "late" in readers:
        made.generator("s_late")
    if "query" in readers:
        made.queries.register(QUERY.format(name="most", of="s"))
    if "select" in readers:
        made.subscribe_to_feature("speed", objects=["a"])
    if "every object" in readers:
        made.subscribe_to_feature("speed", sort="UAV")
    for name in sorted(readers & POLICIES.keys()):
        made.subscribe("s", POLICIES[name])
    for number, name in enumerate(sorted(readers & KPL.keys())):
        made.add_kpl(f"strmgen made{number} = {KPL[name]}")


@pytest.fixture
def few(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(history, "_TEXTS", 50)


@pytest.mark.usefixtures("few")
@pytest.mark.parametrize("lateness", [0, SECOND])
def test_texts_of_a_stream_that_queries_read_are_forgotten(lateness: int) -> None:
    made = engine(lateness)
    made.queries.register(QUERY.format(name="most", of="s"))
    read(made, {"select", "every object", *POLICIES, *KPL})
    for second in range(60):
        publish(
            made,
            [(second * 1000 + k * 100, f"u{k}", f"fresh{second}-{k}") for k in range(10)],
        )
        pools = made.generator("s").stream.pools
        assert max(map(len, pools.values())) <= 120
    newest = list(made.generator("s").stream.newest(1).rows())
    assert newest[0][2]["note"].startswith("fresh5")
    assert len(made.generator("most").stream) > 50


@pytest.mark.usefixtures("few")
@pytest.mark.parametrize("why", ["late", "stamped", "another body for a key"])
def test_texts_of_what_nothing_comes_of_are_forgotten(why: str) -> None:
    made = engine(0)
    others = {"id": "a", "v": 1.0, "lat": None, "lon": None}
    first = {"valid": 0, "available": 9 * SECOND, "note": "a"} | others
    Publish("s", "ndjson", json.dumps(first).encode(), 0, "key").apply(made)
    times = {
        "late": {"available": 1},
        "stamped": {},
        "another body for a key": {"available": 10 * SECOND},
    }
    key = "key" if why == "another body for a key" else None
    for number in range(60):
        same = {"valid": number} | others | times[why]
        rows = [{"note": f"{number} {k}"} | same for k in range(10)]
        body = "\n".join(map(json.dumps, rows)).encode()
        with nullcontext() if why == "late" else pytest.raises(Conflict):
            Publish("s", "ndjson", body, 0, key).apply(made)
        assert len(made.generator("s").stream.pools["note"]) <= 60
    assert made.generator("s").counters.used == 1


@pytest.mark.usefixtures("few")
def test_late_samples_are_kept_after_texts_were_forgotten() -> None:
    made = engine(0)
    late = made.generator("s_late")
    for second in range(20):
        publish(made, [(second * 1000 + k, "a", f"n{second}-{k}") for k in range(1, 30)])
        publish(made, [(second * 1000, "a", f"late{second}")])
    said = [values["note"] for _, _, values in late.stream.all().rows()]
    assert said == [f"late{second}" for second in range(20)]


@pytest.mark.usefixtures("few")
def test_samples_that_came_too_late_for_a_state_are_forgotten() -> None:
    stream = StreamGenerator("late", Schema(()), retention=Retention(10))
    violations = Violations(lambda: stream)
    schema = Schema((Field("note", FieldType.STRING),))
    for number in range(300):
        batch = batch_from_rows(schema, [(number, number, {"note": f"told{number}"})])
        violations.add_late(Late(0, batch, Constraint.ORDER, batch.available), "f[o]")
    gc.collect()
    pools = [found for found in gc.get_objects() if isinstance(found, StringPool)]
    told = [sum("told" in text for text in pool.strings()) for pool in pools]
    assert 10 <= sum(told) <= 120
    assert [values["sample"] for _, _, values in stream.stream.newest(1).rows()] == [
        '{"note":"told299"}'
    ]


def test_few_long_texts_are_forgotten_as_many_short_ones_are() -> None:
    """A pool is looked through when what it takes has doubled, not only when it is long."""
    schema = Schema((Field("note", FieldType.STRING),))
    stream = StreamGenerator("s", schema, retention=Retention(10))
    most = 0
    for i in range(2_000):
        note = f"{i:08d}" + "x" * 30_000
        stream.offer(batch_from_rows(schema, [(i, i, {"note": note})]))
        most = max(most, len(stream.stream.pools["note"]))
    # 4 Mi characters.
    assert 10 < most < 160
    kept = [values["note"][:8] for _, _, values in stream.stream.all().rows()]
    assert kept == [f"{i:08d}" for i in range(1_990, 2_000)]


def test_texts_that_are_all_kept_are_looked_through_ever_more_seldom(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    schema = Schema((Field("note", FieldType.STRING),))
    stream = StreamGenerator("s", schema)
    looks = 0
    encoded = stream.stream.encoded

    def counted(batch: SampleBatch) -> SampleBatch:
        nonlocal looks
        looks += batch.columns["note"].pool is not stream.stream.pools["note"]
        return encoded(batch)

    monkeypatch.setattr(stream.stream, "encoded", counted)
    pool = stream.stream.pools.setdefault("note", StringPool())
    for i in range(1_000):
        pool = stream.stream.pools["note"]
        rows = [(i, i, {"note": f"{i:08d}" + "x" * 60_000})]
        stream.offer(batch_from_rows(schema, rows, {"note": pool}))
    # 60 million characters: 4 Mi doubled four times, each time with some runs.
    assert 1 <= looks < 500
    assert len(stream.stream.pools["note"]) == 1_000


def test_what_waits_is_not_looked_through_with_each_batch(monkeypatch: pytest.MonkeyPatch) -> None:
    """Texts that are held back within the lateness are no garbage."""
    schema = Schema((Field("note", FieldType.STRING),))
    stream = StreamGenerator("s", schema, lateness=300, retention=Retention(1))
    looks = 0
    forget = StreamGenerator.forget_texts

    def counted(self: StreamGenerator) -> None:
        nonlocal looks
        before = self.stream.pools.get("note")
        forget(self)
        looks += self.stream.pools.get("note") is not before

    monkeypatch.setattr(StreamGenerator, "forget_texts", counted)
    for i in range(2_000):
        rows = [(i, i, {"note": f"{i:08d}" + "x" * 30_000})]
        stream.offer(batch_from_rows(schema, rows))
    # 300 of them are 9 million characters: each look comes after as many new ones.
    assert 3 <= looks <= 12
