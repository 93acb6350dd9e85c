"""Requests of one template that are evaluated as one query (engine/planning/request_sharing.py)."""

import pytest
from feeding import Reader, feed, samples

from dyknow.engine.model.views import Since, StreamDeclaration
from dyknow.engine.planning import request_sharing
from dyknow.streams.sample import Field, FieldType
from dyknow.streams.time import SECOND

SPEEDS = "stream speeds contains speed(UAV) = v for every UAV = id"


@pytest.fixture
def shared(engine, high_speed):
    """An engine in which requests share from the second one on."""
    engine.annotate(SPEEDS)
    engine.register_template(high_speed)
    return engine


def ask(engine, object, threshold, **options):
    text = f"dyknow:HighSpeedEvent({object}, dyknow:UAV, {threshold})"
    return engine.request_event(engine.parse_request(text), **options)


def fly(engine, seconds, since=0, **speeds):
    """A sample a second of each, the first after ``since``."""
    rows = [
        (since + i + 0.1 * j, {"id": name, "v": float(speed)})
        for i in range(1, seconds + 1)
        for j, (name, speed) in enumerate(speeds.items(), -len(speeds))
    ]
    feed(engine, "speeds", rows)


def made_by(view):
    return [unit.transformation for unit in view.plan.units]


def test_from_some_requests_on_they_are_one_query(shared):
    first, second, third = (ask(shared, "?o", limit) for limit in (100, 110, 120))
    assert made_by(first) == ["cSparql"]
    assert made_by(second) == made_by(third) == ["cSparql", "selectInstance"]
    assert second.plan.units[0].name == third.plan.units[0].name
    assert third.plan.units[0].users == 2
    assert second.plan.streams == ("speeds",)
    assert "?avgSpeed > 110" in second.plan.query
    assert second.waits_for == ("speeds",)
    assert "selectInstance(request=dyknow:HighSpeedEvent(?o, dyknow:UAV, 120))" in third.plan.text


def test_what_is_shared_is_explained(shared):
    view = [ask(shared, "?o", limit) for limit in (100, 110, 120)][-1]
    told = shared.explain_running(view.id)
    assert "?avgSpeed > 120" in told
    assert "2 instances in 1 cohorts" in told
    assert "?threshold: compared, found by order" in told


def test_each_is_told_what_it_asked_for(shared):
    views = [ask(shared, "?o", limit) for limit in (100, 110, 120)]
    fly(shared, 7, uav1=105, uav2=130)
    told = [{values["id"] for _, values in samples(shared, view.stream)} for view in views]
    assert told == [{"uav1", "uav2"}, {"uav2"}, {"uav2"}]
    fields = [shared.stream(view.stream).fields for view in views]
    assert fields[1] == fields[0]
    meanings = [shared.stream(view.stream).annotation for view in views]
    assert "HighSpeedEvent(UAV) = speed" in meanings[2]


def test_own_objects_are_selected_by_the_template(shared):
    views = [ask(shared, f"dyknow:uav{i}", 100) for i in (1, 2, 3, 4)]
    assert made_by(views[0]) == ["selectObject", "cSparql"]
    together = ["selectObjects", "cSparql", "selectInstance"]
    assert made_by(views[1]) == made_by(views[2]) == made_by(views[3]) == together
    assert "selectObjects(field=id, objects=3)" in shared.event(views[3].id).plan.text
    fly(shared, 7, uav1=130, uav2=130, uav3=130, uav4=50)
    told = [{values["id"] for _, values in samples(shared, view.stream)} for view in views]
    assert told == [{"uav1"}, {"uav2"}, {"uav3"}, set()]


def test_who_does_not_agree_on_what_the_plan_has_to_have_does_not_share(shared):
    """A sort is put into the plan: one query would have a plan for each."""
    sorts = ["dyknow:UAV", "dyknow:Aircraft", "dyknow:Vehicle", "dyknow:UAV"]
    texts = [f"dyknow:HighSpeedEvent(?o, {sort}, {100 + i})" for i, sort in enumerate(sorts)]
    views = [shared.request_event(shared.parse_request(text)) for text in texts]
    assert [made_by(view)[-1] for view in views] == ["cSparql"] * 3 + ["selectInstance"]


@pytest.mark.parametrize(
    ("body", "window"),
    [
        ("SELECT ?o ?s WHERE { @ } ORDER BY DESC(?s)", "RANGE 1s STEP 1s"),
        ("SELECT ?o ?s WHERE { @ }", "TRIPLES 3 STEP 2"),
        ("SELECT ?o (RAND() AS ?x) WHERE { @ }", "RANGE 1s STEP 1s"),
        ("CONSTRUCT { ?o dyknow:at [] } WHERE { @ }", "RANGE 1s STEP 1s"),
    ],
)
def test_what_is_a_requests_own_is_not_shared(shared, body, window):
    """The order of its solutions, windows that count from when it began."""
    body = body.replace("@", "?o dyknow:speed ?s FILTER (?s > ?limit)")
    shared.register_template(
        "REGISTER TEMPLATE dyknow:OwnEvent(?limit) COMPUTE EVERY 1s AS "
        f"PREFIX dyknow: <http://www.ida.liu.se/dyknow/> {body} WINDOW [{window}]"
    )
    texts = [f"dyknow:OwnEvent({limit})" for limit in (1, 2, 3)]
    views = [shared.request_event(shared.parse_request(text)) for text in texts]
    assert [made_by(view) for view in views] == [["cSparql"]] * 3


def test_streams_that_are_made_for_somebody_are_the_same_streams(engine, high_speed):
    engine.annotate(
        "stream coordinates contains latitude(UAV) = lat [deg], longitude(UAV) = lon [deg] "
        "for every UAV = id"
    )
    engine.register_template(high_speed)
    views = [ask(engine, f"dyknow:uav{i}", 100) for i in range(6)]
    assert made_by(views[0]) == ["selectObject", "coordinatesToSpeed", "cSparql"]
    shared = [view.plan.units[-2].name for view in views[1:]]
    together = ["selectObjects", "coordinatesToSpeed", "cSparql", "selectInstance"]
    assert made_by(views[5]) == together
    assert len(set(shared)) == 1
    views += [ask(engine, "?o", limit) for limit in (100, 110)]
    assert [made_by(view)[-1] for view in views[6:]] == ["cSparql", "selectInstance"]
    for view in views:
        engine.cancel_event(view.id)
    assert not engine._parts.configuration.units


def test_the_past_is_each_ones_own(shared):
    fly(shared, 7, uav1=130)
    views = [ask(shared, "?o", limit, since=Since.START) for limit in (100, 110, 120)]
    assert [made_by(view) for view in views] == [["cSparql"]] * 3
    assert all(samples(shared, view.stream) for view in views)


def test_the_template_runs_as_long_as_somebody_needs_it(shared):
    first, second, third = (ask(shared, "?o", limit) for limit in (100, 110, 120))
    template = second.plan.units[0].output
    shared.cancel_event(first.id)
    shared.cancel_event(second.id)
    assert template in shared._parts.configuration.units
    fly(shared, 7, uav1=130)
    assert samples(shared, third.stream)
    shared.cancel_event(third.id)
    assert not shared._parts.configuration.units
    # Nobody shares with those that are gone.
    assert made_by(ask(shared, "?o", 130)) == ["cSparql"]


def test_the_template_tells_how_many_were_answered(shared):
    views = [ask(shared, "?o", limit) for limit in (100, 110, 120)]
    fly(shared, 3, uav1=115)
    assert samples(shared, views[1].plan.units[0].output) == [
        (1, {"instances": 2, "answered": 1}),
        (2, {"instances": 2, "answered": 1}),
    ]


def test_who_follows_an_answer_hears_of_time(shared):
    ask(shared, "?o", 100)
    view = ask(shared, "?o", 110)
    fly(shared, 3, uav1=50)
    generator, reader = shared.generator(view.stream), Reader()
    generator.subscribe(reader)
    assert reader.heard == [("time", 2_900_000_001)]
    fly(shared, 1, since=3, uav1=50)
    assert reader.heard[1:] == [("time", 3_900_000_001)]
    shared.generator("speeds").end()
    assert reader.heard[-1] == ("ended", view.stream)
    fly(shared, 1, since=5, uav1=50)
    assert ("resumed", view.stream) in reader.heard
    generator.unsubscribe(reader)
    before = len(reader.heard)
    fly(shared, 1, since=6, uav1=50)
    assert len(reader.heard) == before


def test_what_fails_in_one_fails_in_no_other(shared):
    _, second, third = (ask(shared, "?o", limit) for limit in (100, 110, 120))
    unit = shared._parts.configuration.units[second.stream]

    def fail(batch):
        raise RuntimeError("no more")

    unit.output.emit = fail
    fly(shared, 7, uav1=130)
    assert samples(shared, third.stream)
    assert unit.failure == "RuntimeError: no more"
    # Who asks for the same gets another unit, which works.
    again = ask(shared, "?o", 110)
    assert again.stream != second.stream
    for view in (second, third, again):
        shared.cancel_event(view.id)


def test_what_fails_in_the_template_fails_in_all(shared):
    views = [ask(shared, "?o", limit) for limit in (100, 110, 120)]
    template = shared._parts.configuration.units[views[1].plan.units[0].output]

    def fail(*args):
        raise RuntimeError("no more")

    template.evaluator.push = fail
    fly(shared, 2, uav1=130)
    assert template.failure == "RuntimeError: no more"
    again = ask(shared, "?o", 110)
    assert again.plan.units[0].name != template.name
    fly(shared, 7, since=2, uav1=130)
    assert samples(shared, again.stream)
    for view in (*views, again):
        shared.cancel_event(view.id)
    assert not shared._parts.configuration.units


@pytest.fixture
def two_streams(engine, high_speed, monkeypatch):
    """Requests over two streams, one of which may fall idle."""
    monkeypatch.setattr(request_sharing, "MIN_SHARED", 1)
    fields = (Field("id", FieldType.STRING), Field("v", FieldType.FLOAT))
    for name, sort, idle in (("rmaxes", "RMAX", 5 * SECOND), ("cars", "Car", None)):
        engine.declare(StreamDeclaration(name, fields, idle=idle))
        engine.annotate(f"stream {name} contains speed({sort}) = v for every {sort} = id")
    engine.register_template(high_speed)
    return engine


def say(engine, stream, *seconds, clock=0):
    engine.tick(clock * SECOND)
    feed(engine, stream, [(second, {"id": "uav1", "v": 130.0}) for second in seconds])


def test_idle_streams_hold_no_request_back_and_what_is_late_is_told(two_streams):
    request = two_streams.parse_request("dyknow:HighSpeedEvent(?o, dyknow:Vehicle, 100)")
    view = two_streams.request_event(request)
    assert made_by(view) == ["cSparql", "selectInstance"]
    assert view.plan.streams == ("rmaxes", "cars")
    template = view.plan.units[0].output
    say(two_streams, "rmaxes", 1)
    say(two_streams, "cars", 1, 2, 3, clock=1)
    assert two_streams.event(view.id).held_back_by == ("rmaxes",)
    before = len(samples(two_streams, view.stream))
    late = two_streams.generator(f"{template}_late_rmaxes")
    two_streams.tick(7 * SECOND)
    assert two_streams.stream("rmaxes").is_idle
    assert len(samples(two_streams, view.stream)) > before
    say(two_streams, "rmaxes", 2, clock=8)
    assert two_streams.event(view.id).late == 1
    assert len(late.stream.all()) == 1


def test_an_answer_is_idle_with_all_that_it_is_made_of(shared):
    fields = (Field("id", FieldType.STRING), Field("v", FieldType.FLOAT))
    shared.declare(StreamDeclaration("slow", fields, idle=5 * SECOND))
    shared.annotate("stream slow contains heading(UAV) = v for every UAV = id")
    shared.register_template(
        """REGISTER TEMPLATE dyknow:TurnedEvent(?o, ?limit) COMPUTE EVERY 1s AS
        PREFIX dyknow: <http://www.ida.liu.se/dyknow/>
        SELECT ?o ?h WHERE { ?o dyknow:heading ?h . FILTER (?h > ?limit) }
        WINDOW [RANGE 1s STEP 1s]"""
    )
    views = [
        shared.request_event(shared.parse_request(f"dyknow:TurnedEvent(?o, {limit})"))
        for limit in (1, 2, 3)
    ]
    say(shared, "slow", 1)
    shared.tick(6 * SECOND)
    assert [shared.stream(view.stream).is_idle for view in views] == [True] * 3
    late_comer = shared.request_event(shared.parse_request("dyknow:TurnedEvent(?o, 4)"))
    assert shared.stream(late_comer.stream).is_idle
    say(shared, "slow", 2, clock=7)
    assert not any(shared.stream(view.stream).is_idle for view in (*views, late_comer))


def test_a_request_that_nobody_follows_is_as_far_as_its_template(shared):
    """Its own stream is promised nothing while it has no results."""
    for threshold in (100, 110, 120):
        ask(shared, "?o", threshold)
    fly(shared, 50, a=150)
    fly(shared, 50, since=100, a=1)
    lags = {unit.transformation: unit.lag for unit in shared.units()}
    assert lags.keys() == {"cSparql", "selectInstance"}
    assert all(lag is not None and lag <= SECOND for lag in lags.values()), lags
