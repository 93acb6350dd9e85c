"""Law: `dyknow.run` gives the samples of the monitor's stream in an engine that gets the same
samples in any batches, the streams one before the other or in turns."""

from __future__ import annotations

from typing import Any

from hypothesis import given, settings
from hypothesis import strategies as st

import dyknow
from dyknow.converters.wire import Incoming
from dyknow.engine.engine import Engine
from dyknow.engine.model.views import StreamDeclaration
from dyknow.streams.sample import Field, FieldType, batch_from_rows
from dyknow.streams.time import SECOND

SSL = """stream heights contains altitude(UAV) = alt [ft] for every UAV = id
stream speeds contains speed(UAV) = spd [km.h-1] for every UAV = id"""
FIELDS = {"heights": "alt", "speeds": "spd"}
FORMULAS = [
    "(?x in UAV) = altitude(?x) < 50",
    "(?x in UAV) = eventually[0s, 3s] altitude(?x) > 60",
    "(?x in UAV) = speed(?x) > 50 -> always[1s, 4s] altitude(?x) > 20",
    "(?x in UAV) = altitude(?x) < 50 since[0s, 2s] speed(?x) > 60",
    "(?x in UAV, ?y in UAV) = altitude(?x) < altitude(?y) until[0s, 3s] speed(?y) < 40",
    " = forall ?x in UAV (altitude(?x) > 30 or once[0s, 2s] speed(?x) > 70)",
    "(?x in UAV) = exists ?y in UAV (speed(?y) > 50 and altitude(?x) < 50)",
]
REPORTS = ["violations", "changes", "verdicts"]
WAYS = [
    "any change",
    "any change, once",
    "sample every 2s",
    "sample every 1s, use most recent",
    "use most recent",
]


@st.composite
def recordings(draw: st.DrawFn, delays: bool) -> dict[str, list[tuple[int, int, dict[str, Any]]]]:
    """Rows ``(available, valid, values)`` of both streams, in order of available time."""
    found = {}
    for name, field in FIELDS.items():
        rows, valid = [], draw(st.integers(0, 3))
        for _ in range(draw(st.integers(1, 12))):
            id, value = (
                draw(st.sampled_from("abc")),
                draw(st.sampled_from([None, 10.0, 40.0, 80.0])),
            )
            delay = draw(st.sampled_from([0, 0, 0, 1, 3])) if delays else 0
            rows.append(((valid + delay) * SECOND, valid * SECOND, {"id": id, field: value}))
            valid += draw(st.sampled_from([0, 0, 1, 1, 2, 14]))
        rows[0][2][field] = 40.0  # so that the field is seen to be a number
        found[name] = sorted(rows, key=lambda row: row[0])
    return found


@st.composite
def cases(draw: st.DrawFn) -> tuple[str, dict[str, list[tuple[int, int, dict[str, Any]]]]]:
    delay = draw(st.sampled_from(["", ", max delay 0s", ", max delay 2s"]))
    text = (
        f"monitor m{draw(st.sampled_from(FORMULAS))} with {draw(st.sampled_from(WAYS))}, "
        f"report {draw(st.sampled_from(REPORTS))}{delay}"
    )
    return text, draw(recordings(delays=bool(delay)))


def published(
    text: str, rows: dict[str, list[tuple[int, int, dict[str, Any]]]], draw: st.DataObject
) -> list[tuple[int, int, dict[str, Any]]]:
    """What the service's stream has, with drawn batches."""
    engine = Engine()
    for name, field in FIELDS.items():
        fields = (Field("id", FieldType.STRING), Field(field, FieldType.FLOAT))
        engine.declare(StreamDeclaration(name, fields))
    engine.annotate(SSL)
    engine.queries.register(text)
    left = {name: list(own) for name, own in rows.items()}
    while left:
        name = draw.draw(st.sampled_from(sorted(left)))
        count = draw.draw(st.integers(1, 6))
        generator = engine.generator(name)
        batch = batch_from_rows(generator.schema, left[name][:count], generator.stream.pools)
        engine.publish(name, Incoming(batch, False), 0)
        left[name] = left[name][count:]
        if not left[name]:
            del left[name]
            engine.end(name)
    assert engine.queries.view("m").state == "ended"
    return list(engine.generator("m").stream.all().rows())


@settings(max_examples=60, deadline=None)
@given(cases(), st.data())
def test_a_recording_gives_the_samples_of_the_service(case: Any, draw: st.DataObject) -> None:
    text, rows = case
    given = {
        name: [{"available": a, "valid": v, **values} for a, v, values in own]
        for name, own in rows.items()
    }
    run = dyknow.run(text, given, ssl=SSL)
    made = [row for batch in run.batches() for row in batch.rows()]
    assert made == published(text, rows, draw)
    verdicts = list(dyknow.run(text, given, ssl=SSL))
    assert [verdict["valid"] for verdict in verdicts] == [valid for _, valid, _ in made]
