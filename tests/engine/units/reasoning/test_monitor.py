"""Monitors over streams that fall silent; robustness of verdicts."""

import pytest
from feeding import feed, samples

from dyknow.engine.model.views import StreamDeclaration
from dyknow.streams.jit import JIT
from dyknow.streams.sample import Field, FieldType
from dyknow.streams.time import SECOND

SSL = """stream speeds contains speed(UAV) = v for every UAV = id
stream heights contains altitude(UAV) = v for every UAV = id"""


def test_an_idle_stream_holds_no_state_back_and_its_late_samples_are_counted(engine):
    for name in ("speeds", "heights"):
        fields = (Field("id", FieldType.STRING), Field("v", FieldType.FLOAT))
        engine.declare(StreamDeclaration(name, fields, idle=2 * SECOND))
    engine.annotate(SSL)
    engine.queries.register(
        "monitor m(?x in UAV) = altitude(?x) < 50 or speed(?x) < 10"
        " with use most recent, report verdicts"
    )
    feed(engine, "speeds", [(0, {"id": "u", "v": 1.0})])
    for second in range(20):
        feed(engine, "heights", [(second, {"id": "u", "v": 60.0})])
        engine.tick(second * SECOND)
    assert len(samples(engine, "m")) > 12
    feed(engine, "speeds", [(10, {"id": "u", "v": 1.0})])
    assert engine.queries.view("m").late == 1
    feed(engine, "heights", [(20, {"id": "u", "v": 60.0})])
    assert engine.queries.view("m").late == 1


def test_intervals_may_reach_beyond_the_end_of_time(engine):
    engine.annotate("stream speeds contains speed(UAV) = v for every UAV = id")
    century = "always [0s, 4000000000s]"
    engine.queries.register(
        f"monitor m(?x in UAV) = {century} {century} {century} speed(?x) < 3"
        " with report verdicts, robustness"
    )
    feed(engine, "speeds", [(t, {"id": "u", "v": v}) for t, v in ((1, 1.0), (2, 2.5))])
    assert samples(engine, "m") == []
    engine.end("speeds")
    assert [(s["verdict"], s["robustness"]) for _, s in samples(engine, "m")] == [("true", 0.5)] * 2


def test_robustness_is_a_column_of_numbers(engine):
    fields = (Field("id", FieldType.STRING), Field("v", FieldType.FLOAT))
    engine.declare(StreamDeclaration("speeds", fields))
    engine.annotate("stream speeds contains speed(UAV) = v [km.h-1] for every UAV = id")
    engine.queries.register(
        "monitor m(?x in UAV) = always [0s, 2s] (speed(?x) < 36 [m.s-1] or ?x = uav2)"
        " with report verdicts, robustness, max delay 0s"
    )
    speeds = [120.0, 129.5, 100.0, 140.0, None, 90.0]
    feed(
        engine,
        "speeds",
        [(t, {"id": "uav1", "v": v}) for t, v in enumerate(speeds, 1)]
        + [(7, {"id": "uav2", "v": 999.0})],
    )
    engine.end("speeds")
    found = [(v, s["x"], s["verdict"], s["robustness"]) for v, s in samples(engine, "m")]
    limit = 129.6
    assert [(v, x, verdict) for v, x, verdict, _ in found] == [
        (1, "uav1", "true"),
        (2, "uav1", "false"),
        (3, "uav1", "false"),
        (4, "uav1", "false"),
        (6, "uav1", "true"),
        (7, "uav2", "true"),
    ]
    margins = [each[-1] for each in found]
    expected = [limit - 129.5, limit - 140, limit - 140, limit - 140, limit - 90]
    assert margins[:-1] == pytest.approx(expected)
    # No speed changes a verdict on uav2.
    assert margins[-1] is None


@pytest.mark.skipif(not JIT, reason="tables of bits need compiled loops")
@pytest.mark.parametrize(
    ("options", "way"),
    [
        ("report verdicts", "by moments, over each object's own states"),
        ("sample every 1s", "over tables of bits, 64 objects at a time"),
        ("sample every 1s, robustness, report verdicts", "by moments, over the states of all"),
    ],
)
def test_the_explanation_says_how_verdicts_are_made(engine, options, way):
    engine.annotate("stream speeds contains speed(UAV) = v for every UAV = id")
    name = engine.queries.register(f"monitor m(?x in UAV) = speed(?x) < 3 with {options}").name
    feed(engine, "speeds", [(t, {"id": "u", "v": 1.0}) for t in range(3)])
    assert f"evaluated    {way}" in engine.queries.unit(name).explain()


def test_intervals_on_a_grid_may_reach_beyond_the_end_of_time(engine):
    engine.annotate("stream speeds contains speed(UAV) = v for every UAV = id")
    century = "always [0s, 4000000000s]"
    engine.queries.register(
        f"monitor m(?x in UAV) = {century} {century} {century} speed(?x) < 3"
        " with sample every 1s, report verdicts"
    )
    feed(engine, "speeds", [(t, {"id": "u", "v": v}) for t, v in ((1, 1.0), (2, 2.5))])
    assert samples(engine, "m") == []
    engine.end("speeds")
    assert [s["verdict"] for _, s in samples(engine, "m")] == ["true"] * 2
