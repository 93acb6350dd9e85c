"""Partial matches of running patterns."""

import pytest
from feeding import feed

from dyknow.engine.model.errors import BadArguments
from dyknow.streams.time import SECOND


@pytest.fixture
def flying(engine):
    engine.annotate("stream speeds contains speed(UAV) = spd [km.h-1] for every UAV = id")
    engine.annotate("stream heights contains altitude(UAV) = alt [m] for every UAV = id")
    return engine


def partials(engine, name, *objects, limit=9):
    found = engine.queries.partial(name, list(objects), limit)
    return [
        (
            [(event, time // SECOND) for event, time, _ in each.events],
            [(p.event, p.earliest // SECOND, p.latest // SECOND) for p in each.pending],
        )
        for each in found.partial
    ], found.more


def test_partial_matches_of_runs(flying):
    """Of a repeated part the first and the last event have come."""
    flying.queries.register(
        "REGISTER STREAM s AS PATTERN SEQ(speed a, speed+ b[], altitude c) WHERE "
        "skip_till_next_match [id] and b[i].value > 100 WITHIN 9s RETURN a.id AS x"
    )
    feed(flying, "heights", [(1, {"id": "uav2", "alt": 50.0})])
    speeds = ((1, 80.0), (2, 120.0), (3, 130.0), (4, 140.0))
    feed(flying, "speeds", [(t, {"id": "uav1", "spd": v}) for t, v in speeds])
    feed(flying, "heights", [(4, {"id": "uav2", "alt": 50.0})])
    feed(flying, "speeds", [(5, {"id": "uav2", "spd": 50.0})])
    feed(flying, "heights", [(5, {"id": "uav2", "alt": 50.0})])
    found, more = partials(flying, "s", "uav1")
    assert not more
    assert found == [
        ([("a", 1), ("b", 2), ("b", 4)], [("c", 4, 10)]),
        ([("a", 2), ("b", 3), ("b", 4)], [("c", 4, 11)]),
        ([("a", 3), ("b", 4)], [("c", 4, 12)]),
        ([("a", 4)], [("b", 4, 12), ("c", 4, 13)]),
    ]
    assert partials(flying, "s", limit=1) == (found[:1], True)
    assert partials(flying, "s", "uav3") == ([], False)
    feed(flying, "heights", [(t, {"id": "uav1", "alt": 50.0}) for t in (6, 7)])
    feed(flying, "speeds", [(t, {"id": "uav2", "spd": 50.0}) for t in (6, 7)])
    assert partials(flying, "s", "uav1")[0] == [([("a", 4)], [("b", 6, 12), ("c", 6, 13)])]


def test_a_number_is_no_object(flying):
    """The keys of numbers are their bits: that of 0 is also the number of an object."""
    flying.queries.register(
        "REGISTER STREAM s AS PATTERN SEQ(speed a, speed b) WHERE skip_till_next_match [value] "
        "WITHIN 9s RETURN a.id AS x"
    )
    feed(flying, "speeds", [(1, {"id": "uav1", "spd": 5.0}), (2, {"id": "uav2", "spd": 0.0})])
    feed(flying, "speeds", [(3, {"id": "uav3", "spd": 7.0})])
    names = [f"uav{i}" for i in (1, 2)]
    assert [[e[0][0][1] for e in partials(flying, "s", name)[0]] for name in names] == [[1], [2]]


def test_partial_matches_of_alternatives(flying):
    flying.queries.register(
        """REGISTER STREAM s AS PREFIX dyknow: <http://www.ida.liu.se/dyknow/>
        SELECT ?c ?v ?h WHERE { { { ?c dyknow:speed ?v } UNION { ?c dyknow:altitude ?h } }
        SEQ { ?c dyknow:speed 100 } } WITHIN 5 s"""
    )
    feed(flying, "speeds", [(1, {"id": "uav1", "spd": 50.0}), (4, {"id": "uav2", "spd": 50.0})])
    feed(flying, "heights", [(2, {"id": "uav1", "alt": 50.0}), (4, {"id": "uav2", "alt": 50.0})])
    feed(flying, "heights", [(5, {"id": "uav3", "alt": 50.0})])
    feed(flying, "speeds", [(5, {"id": "uav3", "spd": 50.0})])
    found, _ = partials(flying, "s", "uav1")
    assert [each for each in found if each[0][0][1] < 3] == [
        ([("altitude", 2)], [("speed", 4, 7)]),
        ([("speed", 1)], [("speed (2)", 4, 6)]),
    ]


def test_repetition_under_any_match_has_no_partial_matches(flying):
    flying.queries.register(
        "REGISTER STREAM s AS PATTERN SEQ(speed+ a[], altitude b) WHERE [id] WITHIN 9s LIMIT 2"
    )
    with pytest.raises(BadArguments, match="exponentially many partial matches"):
        flying.queries.partial("s", [], 9)
