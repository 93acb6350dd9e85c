"""What a program before the rules of instants did and wrote: run once with the code of c17d4bb.

``python tests/support/engines/directory_of_before.py TARGET`` writes
``TARGET/before_instants.tar.xz``: data directories and, in ``expected.json``, what the engine told
when it wrote them. The archive is a fixture of tests/engine/durability/test_directory_of_before.py
and is never made anew: this script only shows how it came to be. `told` is used by the test, too.
"""

from __future__ import annotations

import json
import shutil
import sys
import tarfile
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

from dyknow.engine.durability import commands as c
from dyknow.engine.durability import durable_engine as recording
from dyknow.engine.durability.durable_engine import RecordedEngine
from dyknow.engine.model.views import Since, StreamDeclaration
from dyknow.journal.checkpoints import parts_of, read_checkpoint
from dyknow.streams.history import Retention
from dyknow.streams.sample import Field, FieldType
from dyknow.streams.time import SECOND

IRI = "http://www.ida.liu.se/dyknow/"
ID, NUMBER = FieldType.STRING, FieldType.FLOAT
SORTS = """@prefix dyknow: <http://www.ida.liu.se/dyknow/> .
dyknow:rmax1 a dyknow:RMAX . dyknow:uav1 a dyknow:UAV . dyknow:uav2 a dyknow:UAV .
"""
TEMPLATE = """REGISTER TEMPLATE dyknow:FastEvent(?o, ?type, ?limit) COMPUTE EVERY 1s AS
PREFIX dyknow: <http://www.ida.liu.se/dyknow/>
CONSTRUCT { ?o dyknow:speed ?average }
FROM <http://www.ida.liu.se/dyknow/ontology.rdf>
WHERE { ?o a ?type . ?o dyknow:speed ?speed }
AGGREGATE {(?average, AVG, {?speed}) FILTER (?average > ?limit)}
WINDOW [RANGE 3s STEP 1s]"""
PAIRS = f"""REGISTER STREAM pairs AS SELECT ?a ?b ?v ?w
FROM STREAM <{IRI}radar.trdf> [RANGE 1s STEP 1s]
WHERE {{ ?a dyknow:speed ?v . ?b dyknow:speed ?w FILTER (?v < ?w) }}"""
COUNTS = f"""REGISTER STREAM counts AS SELECT (COUNT(?v) AS ?n) (SUM(?v) AS ?sum)
FROM STREAM <{IRI}radar.trdf> [RANGE 2s STEP 1s] FROM STREAM <{IRI}late_radar.trdf> [RANGE 2s STEP
1s] WHERE {{ ?o dyknow:speed ?v }}"""
TURNS = f"""REGISTER STREAM turns AS SELECT ?o ?v ?h
FROM STREAM <{IRI}radar.trdf> [RANGE 2s STEP 1s] FROM STREAM <{IRI}arrivals.trdf> [RANGE 2s STEP 1s]
WHERE {{ ?o dyknow:speed ?v . ?o dyknow:heading ?h }}"""
KPL = """sort fix = (id string, spd float)
source fix blips
source float x
source float y
source object members
strmgen fx = x
strmgen fy = y
strmgen sweep = blips
strmgen objects = members
strmgen both = join(fx, fy)
strmgen states = sync(fx, fy; any change, max delay 2s)
strmgen grid = sync(fx, fy; sample every 1s, max delay 2s, use most recent)
strmgen held = join(fx with monotone order, max delay 2s, fy)
foreach o in objects { strmgen of[o] = selectObject(sweep) }
strmgen all = aggregate(of[o] foreach o in objects)
stream ordered = fx with monotone order, max delay 2s
stream rising = fx with strict order, max delay 2s
stream changed = fx with any change
stream gridded = fx with sample every 1s, max delay 2s
"""


def commands() -> list[c.Command]:
    """Equal stamps, rows sent twice and rows that are late, to whatever reads streams."""
    speeds = (Field("id", ID), Field("spd", NUMBER))
    given: list[c.Command] = [
        c.LoadOntology(SORTS, f"{IRI}objects"),
        c.DeclareStream(StreamDeclaration("radar", speeds, 0)),
        c.DeclareStream(StreamDeclaration("late_radar", speeds, 2 * SECOND, Retention(12))),
        c.DeclareStream(StreamDeclaration("arrivals", (Field("id", ID), Field("hdg", NUMBER)), 0)),
        c.Annotate("stream radar contains speed(UAV) = spd for every UAV = id"),
        c.Annotate("stream late_radar contains speed(RMAX) = spd for every RMAX = id"),
        c.Annotate("stream arrivals contains heading(UAV) = hdg for every UAV = id"),
        c.RegisterTemplate(TEMPLATE),
        c.AddKpl(KPL, "s"),
        c.RegisterQuery(PAIRS),
        c.RegisterQuery(COUNTS),
        c.RegisterQuery(TURNS),
        c.RequestEvent("dyknow:FastEvent(?o, dyknow:UAV, 1)"),
        c.RequestEvent("dyknow:FastEvent(dyknow:rmax1, dyknow:RMAX, 2)"),
        c.Subscribe("radar", "strict order, max delay 1s"),
        c.SubscribeToFeature("dyknow:speed", sort="dyknow:UAV", since=Since.START),
        c.OpenStream("radar_late"),
        c.OpenStream("late_radar_late"),
        c.OpenStream("rising_violations"),
    ]
    now = 0
    for second in range(1, 15):
        now += SECOND
        given += _second(second, now)
    return given


def _second(s: int, now: int) -> list[c.Command]:
    """A second's sweeps, the last of which is stamped with the end of a window."""
    at = s * SECOND
    sweep = [(at, at, f"uav{k}", float(k + s)) for k in (1, 2)]
    within = [(at - SECOND // 2, at - SECOND, f"uav{k}", float(k * s % 5)) for k in (2, 1)]
    behind = [(at - 3 * SECOND, at - SECOND, "rmax1", float(s)), (at, at, "rmax1", float(s + 1))]
    found: list[c.Command] = [
        _rows("radar", ("id", "spd"), [*within, *sweep], now),
        _rows("radar", ("id", "spd"), [sweep[-1], (at, at, "uav2", 9.0)], now),
        _rows("late_radar", ("id", "spd"), [*behind, behind[1], (at, at, "rmax2", 7.0)], now),
        _rows("blips", ("id", "spd"), [*within, *sweep, *sweep], now),
        _rows("x", ("value",), [(at, at - SECOND * (s % 3), None, float(s // 2))], now),
        _rows("x", ("value",), [(at, at, None, float(s)), (at, at, None, float(s))], now),
        _rows("y", ("value",), [(at, at, None, float(-s))], now),
        _rows("arrivals", ("id", "hdg"), [(None, at, f"uav{k}", 90.0 * k) for k in (1, 2)], now),
    ]
    if s % 4 == 1:
        names = "uav1 uav2" if s % 8 == 1 else "uav2"
        found.append(_rows("members", ("value",), [(at, at, names, None)] * 2, now))
    if s % 3 == 0:
        found.append(_rows("radar", ("id", "spd"), [(at - SECOND, at, "uav1", 3.0)], now))
        found.append(c.Tick(now + SECOND // 2))
    if s == 9:
        found.append(c.RequestEvent("dyknow:FastEvent(?o, dyknow:UAV, 4)", since=Since.START))
    return found


def _rows(
    stream: str, names: tuple[str, ...], rows: list[tuple[int | None, int, Any, Any]], now: int
) -> c.Command:
    lines = []
    for available, valid, id, value in rows:
        values = [value for value in (id, value) if value is not None]
        line = {"valid": valid, **dict(zip(names, values, strict=True))}
        lines.append(json.dumps(line if available is None else {"available": available, **line}))
    return c.Publish(stream, "ndjson", "\n".join(lines).encode(), now)


def told(recorded: RecordedEngine) -> dict[str, Any]:
    """All that publishers and readers know of an engine."""
    engine, streams = recorded.engine, {}
    for view in engine.streams():
        if view.name == "status":
            continue  # tells of the start, too
        generator = engine.generator(view.name)
        stream, kept = generator.stream, generator.counters
        counts = [kept.accepted, kept.used, kept.late, kept.duplicate, kept.expired, kept.pending]
        rows = [[a, v, values] for a, v, values in stream.all().rows()]
        streams[view.name] = {
            "numbers": [stream.first_number, stream.last_number],
            "rows": rows,
            "pending": [[a, v, values] for a, v, values in generator.pending.rows()],
            "counters": counts,
            "watermark": generator.watermark,
        }
    return {
        "streams": streams,
        "published": [each.name for each in engine.published()],
        "events": [[view.id, str(view.event), view.stream] for view in engine.events()],
        "queries": [[view.name, view.state] for view in engine.queries.views()],
        "subscriptions": [[view.id, view.stream] for view in engine.subscriptions()],
        "kpl": engine.kpl_text(),
    }


def _drop_state(path: Path) -> None:
    """Leave of a checkpoint what another program reads: the rest is megabytes for nobody."""
    for name in (path / "checkpoints").glob("*.checkpoint"):
        kept = read_checkpoint(name)
        name.write_bytes(b"".join(parts_of(replace(kept, state=b""))))


def main(target: Path) -> None:
    expected, program = {}, recording.program
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for kind in ("log", "checkpoint"):
            recorded = RecordedEngine(folder / kind, now=0)
            given = commands()
            for i, command in enumerate(given):
                if kind == "checkpoint" and i == 2 * len(given) // 3:
                    recorded.checkpoint().write()
                recorded.do(command)
            recorded.close(checkpoint=False)
            written = told(recorded)
            # What the same code tells where it takes itself for another program.
            shutil.copytree(folder / kind, folder / "copy")
            recording.program = lambda *_: "another"
            again = RecordedEngine(folder / "copy", now=0)
            expected[kind] = told(again)
            again.close(checkpoint=False)
            shutil.rmtree(folder / "copy")
            recording.program = program
            _drop_state(folder / kind)
            assert expected[kind] == written or kind == "checkpoint"
            assert expected[kind]["streams"]["radar"] == written["streams"]["radar"]
        (folder / "expected.json").write_text(json.dumps(expected, separators=(",", ":")))
        with tarfile.open(target / "before_instants.tar.xz", "w:xz") as archive:
            for each in ("log", "checkpoint", "expected.json"):
                archive.add(folder / each, each)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
