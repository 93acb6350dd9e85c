"""Monitors over streams that fall silent."""

from feeding import feed, samples

from dyknow.engine.model.views import StreamDeclaration
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
