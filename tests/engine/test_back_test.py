"""Back tests: what a query or a request would have given on what is kept."""

from __future__ import annotations

from itertools import count
from typing import Any

import pytest
from feeding import feed, flight, samples

from dyknow.engine.back_test import Trial, back_test
from dyknow.engine.engine import Engine
from dyknow.engine.model.errors import BadArguments
from dyknow.engine.model.views import StreamDeclaration
from dyknow.streams.history import Retention
from dyknow.streams.sample import Field, FieldType
from dyknow.streams.time import SECOND

REQUEST = "dyknow:HighSpeedEvent(?o, dyknow:UAV, 100)"
QUERY = """REGISTER QUERY fast COMPUTE EVERY 1s AS SELECT ?o ?v
FROM STREAM <http://www.ida.liu.se/dyknow/s.trdf> [RANGE 2s STEP 1s]
WHERE { ?o dyknow:speed ?v FILTER(?v > 100) }"""
MONITOR = "monitor slow(?x in UAV) = always [0s, 2s] speed(?x) < 100 with use most recent"
SPEEDS = [(i, {"id": f"uav{i % 2}", "v": float(v)}) for i, v in enumerate([90, 150] * 20)]


@pytest.fixture
def kept(engine: Engine, high_speed: str) -> Engine:
    """An engine with a template, and speeds of two objects."""
    fields = (Field("id", FieldType.STRING), Field("v", FieldType.FLOAT))
    engine.declare(StreamDeclaration("s", fields))
    engine.annotate("stream s contains speed(UAV) = v [km.h-1] for every UAV = id")
    engine.register_template(high_speed)
    feed(engine, "s", SPEEDS)
    return engine


def tried(engine: Engine, wanted: str, since: str = "start") -> Trial:
    asked = engine.parse_request(wanted) if wanted == REQUEST else wanted
    return back_test(engine, asked, since)


def given(engine: Engine, wanted: str, since: str = "start") -> list[tuple[float, dict[str, Any]]]:
    """What one gives that begins there."""
    if wanted == REQUEST:
        request = engine.parse_request(wanted)
        return samples(engine, engine.request_event(request, since=since).stream)
    return samples(engine, engine.queries.register(wanted, since=since).name)


@pytest.mark.parametrize("since", ["start", "1970-01-01T00:00:20Z", "15s"])
@pytest.mark.parametrize("wanted", [REQUEST, QUERY, MONITOR], ids=["event", "query", "monitor"])
def test_it_gives_what_one_that_begins_there_gives(kept: Engine, wanted: str, since: str) -> None:
    found = tried(kept, wanted, since)
    assert not kept.events()
    assert not kept.queries.views()
    expected = given(kept, wanted, since)
    assert found.results == len(expected) > 5
    assert found.first == expected[0][0] * SECOND
    assert found.last == expected[-1][0] * SECOND
    assert found.is_complete
    assert found.failure is None
    first = {"start": 0, "15s": 24}.get(since, 20)
    assert (found.since, found.until) == (first * SECOND, 39 * SECOND)
    assert found.samples == 40 - first


def test_of_streams_together(engine: Engine, high_speed: str) -> None:
    """The speed is computed from two streams, whose samples come in order of available time."""
    for name in ("latitude", "longitude"):
        fields = (Field("id", FieldType.STRING), Field("v", FieldType.FLOAT))
        retention = Retention(samples=1000)
        engine.declare(StreamDeclaration(name, fields, retention=retention, idle=5 * SECOND))
        engine.annotate(f"stream {name} contains {name}(UAV) = v [deg] for every UAV = id")
    engine.register_template(high_speed)
    for name, place in (("latitude", 1), ("longitude", 2)):
        flown = flight(0, 60 if place == 1 else 40, 150)
        feed(engine, name, [(each[0], {"id": "a", "v": each[place]}) for each in flown])
    engine.tick(60 * SECOND)
    # Longitudes end early: their stream is idle from then on.
    found = tried(engine, REQUEST)
    assert found.results == len(given(engine, REQUEST)) > 20
    assert found.samples == 100
    assert found.until == 59 * SECOND


@pytest.mark.parametrize("wanted", [REQUEST, QUERY, MONITOR], ids=["event", "query", "monitor"])
def test_a_stream_that_has_ended_ends(kept: Engine, wanted: str) -> None:
    kept.end("s")
    assert tried(kept, wanted).results == len(given(kept, wanted))


def test_streams_that_it_does_not_read_do_not_count(kept: Engine) -> None:
    kept.declare(StreamDeclaration("other", (Field("v", FieldType.FLOAT),)))
    feed(kept, "other", [(2000, {"v": 1.0})])
    found = tried(kept, QUERY, "15s")
    assert (found.samples, found.until) == (16, 39 * SECOND)
    assert found.results == len(given(kept, QUERY, "15s"))


def test_what_queries_make_is_left_out(kept: Engine) -> None:
    """Their streams would have no samples."""
    kept.remove_stream("s")
    feed_stream = StreamDeclaration("raw", (Field("v", FieldType.FLOAT),))
    kept.declare(feed_stream)
    kept.annotate("stream raw contains heading(uav1) = v")
    kept.queries.register(
        "REGISTER STREAM made AS CONSTRUCT { ?o dyknow:speed ?v } "
        "FROM STREAM <http://www.ida.liu.se/dyknow/raw.trdf> [RANGE 1s STEP 1s] "
        "WHERE { ?o dyknow:heading ?v }"
    )
    kept.annotate("stream made contains speed(UAV) = speed for every UAV = id")
    feed(kept, "raw", [(i, {"v": 200.0}) for i in range(20)])
    found = tried(kept, REQUEST)
    assert found.results == 0
    assert found.failure is not None
    # Nor is its name taken.
    again = QUERY.replace("QUERY fast", "QUERY made").replace("/s.trdf", "/raw.trdf")
    assert tried(kept, again).failure is None


def test_nothing_of_the_engine_changes(kept: Engine) -> None:
    kept.queries.register(QUERY)

    def seen() -> tuple[object, ...]:
        return kept.ontology.quads(), kept.now, kept.streams(), samples(kept, "fast")

    before = seen()
    tried(kept, REQUEST)
    tried(kept, QUERY)  # of the same name as the one that runs
    assert seen() == before


def test_what_is_over_tells_how_far_it_came(kept: Engine) -> None:
    looks = count()
    found = back_test(kept, QUERY, "start", is_over=lambda: next(looks) > 3)
    assert not found.is_complete
    assert found.failure is None
    assert found.until is not None


def test_what_cannot_be_tried_says_why(kept: Engine) -> None:
    found = tried(kept, QUERY.replace("dyknow/s.trdf", "dyknow/other.trdf"))
    assert found.failure is not None
    assert "other" in found.failure
    assert (found.samples, found.results, found.is_complete) == (0, 0, False)
    empty = Engine()
    found = back_test(empty, MONITOR, "start")
    assert (found.since, found.until, found.results) == (None, None, 0)
    for text in ("now", "whenever"):
        with pytest.raises(BadArguments):
            back_test(kept, QUERY, text)
