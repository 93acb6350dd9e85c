"""The objects that shared requests select (engine/planning/request_sharing.py)."""

from itertools import permutations

import pytest
from feeding import feed, samples

COORDINATES = (
    "stream coordinates contains latitude(UAV) = lat [deg], longitude(UAV) = lon [deg] "
    "for every UAV = id"
)
SPEEDS = "stream speeds contains speed(UAV) = v for every UAV = id"
TOGETHER = ["selectObjects", "coordinatesToSpeed", "cSparql", "selectInstance"]


@pytest.fixture
def flying(engine, high_speed):
    engine.annotate(COORDINATES)
    engine.register_template(high_speed)
    return engine


def ask(engine, object, threshold=0):
    text = f"dyknow:HighSpeedEvent({object}, dyknow:UAV, {threshold})"
    return engine.request_event(engine.parse_request(text))


def made_by(view):
    return [unit.transformation for unit in view.plan.units]


def units(engine, transformation):
    return [unit for unit in engine.units() if unit.transformation == transformation]


def fly(engine, start, end, *names):
    """A position a second of each, further north by the same distance."""
    rows = [
        (second + 0.1 * i, {"id": name, "lat": 50 + second / 1000, "lon": 13.0})
        for second in range(start, end)
        for i, name in enumerate(names)
    ]
    feed(engine, "coordinates", rows)


def test_speeds_are_computed_once_for_the_objects_asked_for(flying):
    views = [ask(flying, f"dyknow:uav{i}") for i in range(4)]
    assert [made_by(view) for view in views[1:]] == [TOGETHER] * 3
    fly(flying, 0, 20, "uav0", "uav1", "uav2", "uav3", "uav4")
    alone, together = units(flying, "coordinatesToSpeed")
    ids = {values["id"] for _, values in samples(flying, together.output.name)}
    assert ids == {"uav1", "uav2", "uav3"}
    assert {values["id"] for _, values in samples(flying, alone.output.name)} == {"uav0"}
    found = [[values for _, values in samples(flying, view.stream)] for view in views]
    assert all(found)
    assert [{row["id"] for row in rows} for rows in found] == [{f"uav{i}"} for i in range(4)]


def test_the_units_say_how_many_objects_they_select(flying):
    views = [ask(flying, f"dyknow:uav{i}") for i in range(3)]
    (unit,) = units(flying, "selectObjects")
    assert unit.parameters == {"field": "id", "objects": "2"}
    flying.cancel_event(views[1].id)
    assert unit.parameters == {"field": "id", "objects": "1"}
    assert "selectObjects(field=id, objects=1)" in flying.event(views[2].id).plan.text


def test_an_object_that_comes_back_is_selected_anew(flying):
    """The old unit would compute a speed over the time in between."""
    views = [ask(flying, f"dyknow:uav{i}") for i in range(3)]
    fly(flying, 0, 10, "uav1", "uav2")
    flying.cancel_event(views[1].id)
    fly(flying, 100, 110, "uav2")
    again = ask(flying, "dyknow:uav1")
    assert made_by(again) == TOGETHER
    assert len(units(flying, "selectObjects")) == 2
    fly(flying, 110, 112, "uav1")
    speeds = [unit.output.name for unit in units(flying, "coordinatesToSpeed")]
    later = [
        values
        for name in speeds
        for time, values in samples(flying, name)
        if values["id"] == "uav1" and time >= 100
    ]
    # The first position gives no speed, and the second one that of a second.
    assert [round(row["speed"]) for row in later] == [111]
    flying.cancel_event(again.id)
    assert len(units(flying, "selectObjects")) == 1


def test_thresholds_for_one_object_share_its_streams(flying):
    views = [ask(flying, "dyknow:uav1", threshold) for threshold in (0, 10, 20)]
    own = ["selectObject", "coordinatesToSpeed", "cSparql"]
    assert [made_by(view) for view in views] == [own, *[[*own, "selectInstance"]] * 2]
    assert len(units(flying, "coordinatesToSpeed")) == 1


def test_matching_does_not_find_a_stream_that_lacks_objects(flying):
    for i in range(3):
        ask(flying, f"dyknow:uav{i}")
    lacking = {unit.output.name for unit in units(flying, "coordinatesToSpeed")[1:]}
    assert len(lacking) == 1
    every = ask(flying, "?o")
    assert lacking.isdisjoint(unit.output for unit in every.plan.units)
    assert not any(flying.stream(name).annotation for name in lacking)


def test_a_request_joins_those_that_share_when_the_first_has_gone(flying):
    views = [ask(flying, f"dyknow:uav{i}") for i in range(2)]
    flying.cancel_event(views[0].id)
    assert made_by(ask(flying, "dyknow:uav2")) == TOGETHER


def test_the_last_request_stops_all(flying):
    views = [ask(flying, f"dyknow:uav{i}") for i in range(3)]
    for view in views:
        flying.cancel_event(view.id)
    assert not flying.units()


def test_a_specification_does_not_name_such_units(flying):
    for i in range(3):
        ask(flying, f"dyknow:uav{i}")
    # A comment names the units that no specification can start.
    text = flying.current_specification().partition("-->")[2]
    assert "selectObjects" not in text
    assert text.count("coordinatesToSpeed") >= 1


QUERY = """REGISTER STREAM fast COMPUTE EVERY 1s AS
PREFIX dyknow: <http://www.ida.liu.se/dyknow/>
SELECT ?o ?s WHERE { ?o a dyknow:UAV . ?o dyknow:speed ?s } WINDOW [RANGE 1s STEP 1s]"""


@pytest.mark.parametrize("order", list(permutations(["subscription", "request", "query"])))
def test_subscriptions_requests_and_queries_compute_speeds_once(flying, order):
    for kind in order:
        match kind:
            case "subscription":
                flying.subscribe_to_feature("dyknow:speed", sort="dyknow:UAV")
            case "request":
                ask(flying, "?o", 100)
                ask(flying, "?o", 200)
            case "query":
                flying.queries.register(QUERY)
        start = order.index(kind) * 5
        fly(flying, start, start + 5, "uav1")
    assert len(units(flying, "coordinatesToSpeed")) == 1


def test_a_subscription_with_another_source_computes_no_speeds_again(engine, high_speed):
    for name in ("coordinates", "others"):
        engine.annotate(COORDINATES.replace("coordinates", name))
    engine.register_template(high_speed)
    engine.subscribe_to_feature("dyknow:speed", sort="dyknow:UAV")
    fly(engine, 0, 5, "uav1")
    engine.end("coordinates")
    assert [unit.inputs[0].name for unit in units(engine, "coordinatesToSpeed")] == ["others"]
    ask(engine, "?o", 100)
    ask(engine, "?o", 200)
    assert len(units(engine, "coordinatesToSpeed")) == 1
