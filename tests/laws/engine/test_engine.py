"""The whole way does not depend on how samples were cut into batches, nor on when it was asked."""

from feeding import flight
from hypothesis import given, settings
from hypothesis import strategies as st
from places import ROOT

from dyknow.converters.wire import Incoming
from dyknow.engine.engine import Engine
from dyknow.streams.sample import batch_from_rows
from dyknow.streams.time import SECOND

COORDINATES = (
    "stream coordinates contains latitude(UAV) = lat, longitude(UAV) = lon for every UAV = id"
)
REQUESTS = (
    "dyknow:HighSpeedEvent(?o, dyknow:Thing, 100)",
    "dyknow:HighSpeedEvent(dyknow:uav1, dyknow:UAV, 40)",
)


def rows():
    """Two flights, mixed, one of them with a gap and a change of speed."""
    first = flight(1, 12, 150.0) + flight(40, 10, 50.0)
    second = flight(1, 30, 99.0, longitude=16.0)
    together = [("uav1", *fix) for fix in first] + [("uav2", *fix) for fix in second]
    together.sort(key=lambda row: row[1])
    return [
        (int(t * SECOND) + i, int(t * SECOND), {"id": name, "lat": lat, "lon": lon})
        for i, (name, t, lat, lon) in enumerate(together)
    ]


def run(cuts):
    engine = Engine(epoch="law")
    engine.annotate(COORDINATES)
    engine.register_template((ROOT / "templates" / "library" / "high_speed.rq").read_text())
    streams = [engine.request_event(engine.parse_request(text)).stream for text in REQUESTS]
    generator = engine.generator("coordinates")
    left = rows()
    while left:
        cut = next(cuts, len(left))
        part, left = left[:cut], left[cut:]
        batch = batch_from_rows(generator.schema, part, generator.stream.pools)
        engine.publish("coordinates", Incoming(batch, False), 0)
    engine.end("coordinates")
    return [list(engine.generator(name).stream.all().rows()) for name in streams]


WHOLE = run(iter(()))


def test_there_are_events():
    assert all(WHOLE)


@settings(deadline=None, max_examples=8)
@given(st.lists(st.integers(1, 30), max_size=20))
def test_events_do_not_depend_on_batch_cuts(cuts):
    assert run(iter(cuts)) == WHOLE
