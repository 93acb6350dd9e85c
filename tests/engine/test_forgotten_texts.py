"""Texts of streams that are read: they are forgotten, and nothing that is made changes."""

from __future__ import annotations

import json
from contextlib import nullcontext

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sweeping import texts_at_every_chance

from dyknow.converters.ndjson import decode_ndjson
from dyknow.engine.engine import Engine
from dyknow.engine.views import StreamDeclaration
from dyknow.streams import fluent
from dyknow.streams.fluent import Retention
from dyknow.streams.sample import Field, FieldType
from dyknow.streams.time import SECOND

FIELDS = (
    Field("id", FieldType.STRING),
    Field("note", FieldType.STRING),
    Field("v", FieldType.FLOAT),
)
QUERY = """REGISTER STREAM {name} COMPUTE EVERY 1s AS
PREFIX dyknow: <http://www.ida.liu.se/dyknow/>
SELECT ?o (MAX(?v) AS ?most) FROM STREAM <http://www.ida.liu.se/dyknow/{of}.trdf> [RANGE 2s STEP 1s]
WHERE {{ ?o dyknow:speed ?v }} GROUP BY ?o"""
MS = 1_000_000


def engine(lateness: int) -> Engine:
    made = Engine(epoch="e")
    made.declare(StreamDeclaration("s", FIELDS, lateness=lateness, retention=Retention(20)))
    made.annotate("stream s contains speed(UAV) = v for every UAV = id")
    return made


def publish(made: Engine, rows: list[tuple[int, str, str | None]]) -> None:
    """Each: available time in ms, object, note."""
    lines = [
        json.dumps(
            {"valid": time * MS, "available": time * MS, "id": name, "note": note, "v": time % 7}
        )
        for time, name, note in rows
    ]
    generator = made.accepting("s")
    batch = decode_ndjson("\n".join(lines).encode(), generator.schema, generator.stream.pools)
    made.publish("s", batch, 0)


def told(made: Engine) -> dict[str, object]:
    """What every stream has; the status stream tells no texts of these."""
    made.end("s")
    return {
        each.name: (list(each.stream.all().rows()), each.counters) for each in made.generators()
    }


names = st.sampled_from(["a", "b", "c", "d", "e"])
notes = st.none() | st.sampled_from(["x", "y", "z"]) | st.integers(0, 30).map(str)
rows = st.lists(st.tuples(st.integers(0, 6000), names, notes), min_size=1, max_size=12)
batches = st.lists(rows, min_size=1, max_size=8)
readers = st.sets(st.sampled_from(["late", "query", "changes", "sampled", "select"]))


@settings(deadline=None, max_examples=60)
@given(batches, readers, st.sampled_from([0, SECOND]), st.integers(0, 8))
def test_forgetting_at_any_moment_changes_nothing(
    given_batches: list[list[tuple[int, str, str | None]]],
    readers: set[str],
    lateness: int,
    begins: int,
) -> None:
    """Whoever reads the stream from the ``begins``-th batch on, and whatever it makes of it."""

    def run(forgetting: bool) -> dict[str, object]:
        made = engine(lateness)
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
    if "changes" in readers:
        made.subscribe("s", "any change")
    if "sampled" in readers:
        made.subscribe("s", "sample every 700, max delay 2000")
    if "select" in readers:
        made.subscribe_to_feature("speed", objects=["a"])


@pytest.fixture
def few(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fluent, "_TEXTS", 50)


@pytest.mark.usefixtures("few")
@pytest.mark.parametrize("lateness", [0, SECOND])
def test_texts_of_a_stream_that_queries_read_are_forgotten(lateness: int) -> None:
    made = engine(lateness)
    made.queries.register(QUERY.format(name="most", of="s"))
    made.subscribe_to_feature("speed", objects=["u3"])
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
def test_late_samples_are_kept_after_texts_were_forgotten() -> None:
    made = engine(0)
    late = made.generator("s_late")
    for second in range(20):
        publish(made, [(second * 1000 + k, "a", f"n{second}-{k}") for k in range(1, 30)])
        publish(made, [(second * 1000, "a", f"late{second}")])
    said = [values["note"] for _, _, values in late.stream.all().rows()]
    assert said == [f"late{second}" for second in range(20)]
