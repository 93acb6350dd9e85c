"""Requests of a pattern's template for an object each, evaluated as one
(engine/planning/object_sharing.py)."""

import json

import pytest
from feeding import Reader, feed, samples

from dyknow.engine.durability import commands as c
from dyknow.engine.durability.durable_engine import RecordedEngine
from dyknow.engine.model.errors import BadArguments, NoResult
from dyknow.engine.model.views import Since, StreamDeclaration
from dyknow.journal.durability import Durability
from dyknow.streams.sample import Field, FieldType
from dyknow.streams.time import SECOND

STREAM = "stream a contains speed(UAV) = v, altitude(UAV) = w for every UAV = id"
CLIMB = """REGISTER TEMPLATE Climb(?x in UAV, ?limit) AS chronicle climb(?x) {
  event(speed[?x]:(?, > ?limit), t1); event(altitude[?x]:(?, > 10), t2); t2 - t1 in [1s, 3s];
  noevent(speed[?x]:(?, < 5), (t1, t2 + 1s)); }"""


@pytest.fixture
def flying(engine):
    engine.annotate(STREAM)
    engine.register_template(CLIMB)
    return engine


def ask(engine, *arguments, event="Climb", **options):
    text = f"{event}({', '.join(arguments)})"
    return engine.request_event(engine.parse_request(text), **options)


def made_by(view):
    return [unit.transformation for unit in view.plan.units]


def fly(engine, *rows):
    """Rows of seconds, name, speed and altitude."""
    feed(engine, "a", [(time, {"id": name, "v": v, "w": w}) for time, name, v, w in rows])


def climb(engine, begin=0, names=("uav1", "uav2", "uav3", "uav4")):
    """Each is fast, and two seconds later high."""
    for second, v, w in (
        (1, 50.0, 0.0),
        (2, 20.0, 0.0),
        (3, 20.0, 20.0),
        (4, 20.0, 0.0),
        (5, 20.0, 0.0),
    ):
        fly(engine, *((begin + second + 0.1 * i, n, v, w) for i, n in enumerate(names)))


def objects(engine, view):
    return [values["x"] for _, values in samples(engine, view.stream)]


def test_requests_share_from_the_second_on(flying):
    views = [ask(flying, f"dyknow:uav{i}", "30") for i in (1, 2, 3)]
    assert made_by(views[0]) == ["selectObject", "pattern"]
    assert made_by(views[1]) == made_by(views[2]) == ["pattern", "selectInstance"]
    assert views[1].plan.units[0].name == views[2].plan.units[0].name
    assert views[1].plan.streams == ("a",)
    climb(flying)
    assert [objects(flying, view) for view in views] == [["uav1"], ["uav2"], ["uav3"]]
    first, third = (flying.stream(views[i].stream) for i in (0, 2))
    assert third.fields == first.fields
    assert third.annotation == first.annotation.replace(first.name, third.name)


def test_what_is_shared_is_explained(flying):
    view = [ask(flying, f"dyknow:uav{i}", "30") for i in (1, 2, 3)][-1]
    climb(flying)
    explained = flying.explain_running(view.id)
    assert "Climb(dyknow:uav3, 30)" in explained
    assert "for each object at its own time" in explained
    assert "shared by    2 requests" in explained
    assert "2 by now" in explained


def test_a_match_is_explained_as_one_of_a_request_by_itself(flying):
    """By the samples that the request has read: an earlier match is none of it."""
    alone, first = (ask(flying, f"dyknow:uav{i}", "30") for i in (1, 2))
    climb(flying)
    later = ask(flying, "dyknow:uav3", "30")
    climb(flying, 10)

    def why(view, second):
        (match,) = flying.event_why(view.id, (), int(second * SECOND))()
        return [(each.event, each.valid // SECOND) for each in match.events]

    wanted = [("t1", 1), ("t2", 3)]
    assert why(alone, 3) == why(first, 3.1) == wanted
    assert why(later, 13.2) == [("t1", 11), ("t2", 13)]
    (match,) = flying.event_why(first.id, ("uav2",), 31 * SECOND // 10)()
    assert match.values["x"] == "uav2"
    with pytest.raises(NoResult):
        flying.event_why(later.id, (), 32 * SECOND // 10)()


def test_partial_matches_are_those_of_a_request_by_itself(flying):
    alone, shared = (ask(flying, f"dyknow:uav{i}", "30") for i in (1, 2))
    names = ("uav1", "uav2", "uav3")

    def partials(view, *objects):
        found = flying.event_partial(view.id, objects, 10)
        assert not found.more
        return found.watermark, [(each.events, each.pending) for each in found.partial]

    assert partials(shared)[1] == []
    fly(flying, *((1, name, 50.0, 0.0) for name in names))
    fly(flying, *((2, name, 60.0, 0.0) for name in names))
    fly(flying, (9, "uav3", 60.0, 0.0))
    _, found = partials(shared)
    assert [[(event, time // SECOND) for event, time, _ in events] for events, _ in found] == [
        [("t1", 2)],
        [("t1", 1)],
    ]
    assert partials(shared) == partials(alone)
    # A match is about the object of its request, whether an event names it or not.
    assert partials(shared, "uav2") == partials(shared)
    assert partials(alone, "uav1") == partials(alone)
    assert partials(shared, "uav1")[1] == partials(alone, "uav2")[1] == []
    for second in (10, 11):
        fly(flying, *((second, name, 20.0, 0.0) for name in names))
    assert partials(shared) == partials(alone) == (10 * SECOND, [])


def test_why_there_is_no_match_is_said_of_the_own_object(flying):
    _, second, third = (ask(flying, f"dyknow:uav{i}", "30") for i in (1, 2, 3))
    fly(flying, (1, "uav2", 50.0, None), (2, "uav2", 20.0, None))
    assert flying.event(second.id).empty == (
        "2 samples read, none of them of dyknow:altitude with its objects and a value"
    )
    assert flying.event(third.id).empty.startswith("no sample read yet")
    fly(flying, (3, "uav3", 50.0, 20.0), (4, "uav3", 20.0, 0.0))
    assert flying.event(third.id).empty == "2 samples read: no events match"


def test_samples_of_others_decide_nothing(flying):
    """What still may not happen is known when the own object speaks again."""
    _, view = (ask(flying, f"dyknow:uav{i}", "30") for i in (1, 2))
    fly(flying, (1, "uav2", 50.0, 0.0), (3, "uav2", 20.0, 20.0), (9, "uav1", 1.0, 1.0))
    fly(flying, (10, "uav3", 1.0, 1.0))
    assert objects(flying, view) == []
    fly(flying, (11, "uav2", 20.0, 0.0), (12, "uav1", 1.0, 1.0))
    assert objects(flying, view) == ["uav2"]
    found = flying.generator(view.stream).stream.all()
    assert found.available.tolist() == [11 * SECOND]


def test_other_constants_are_groups_of_their_own(flying):
    asked = [(f"dyknow:uav{i}", limit) for limit in ("30", "60") for i in (1, 2, 3)]
    views = [ask(flying, *arguments) for arguments in asked]
    assert [made_by(view)[-1] for view in views] == ["pattern", *["selectInstance"] * 2] * 2
    shared = {view.plan.units[0].name for view in views if made_by(view)[0] == "pattern"}
    assert len(shared) == 2
    climb(flying)
    assert [objects(flying, view) for view in views[3:]] == [[], [], []]


@pytest.mark.parametrize(
    "template",
    [
        # The object is compared with another one.
        "REGISTER TEMPLATE Odd(?x in UAV) AS chronicle odd(?x, ?y) "
        "{ event(speed[?x]:(?, > 30), t1); event(altitude[?y], t2); ?x != ?y; "
        "t2 - t1 in [0s, 3s]; }",
    ],
)
def test_what_is_not_of_an_object_by_itself_is_not_shared(flying, template):
    flying.register_template(template)
    views = [ask(flying, f"dyknow:uav{i}", event="Odd") for i in (1, 2, 3)]
    assert all("selectInstance" not in made_by(view) for view in views)


def test_what_is_computed_of_the_object_alone_is_not_shared(engine):
    engine.annotate(
        "stream a contains latitude(UAV) = v [deg], longitude(UAV) = w [deg] for every UAV = id"
    )
    engine.register_template(
        "REGISTER TEMPLATE Fast(?x in UAV) AS chronicle f(?x) { event(speed[?x]:(?, > 30), t); }"
    )
    views = [ask(engine, f"dyknow:uav{i}", event="Fast") for i in (1, 2, 3)]
    assert {made_by(view)[-1] for view in views} == {"pattern"}


def test_the_past_is_each_ones_own(flying):
    climb(flying)
    views = [ask(flying, f"dyknow:uav{i}", "30", since=Since.START) for i in (1, 2, 3)]
    assert {made_by(view)[-1] for view in views} == {"pattern"}
    assert [objects(flying, view) for view in views] == [["uav1"], ["uav2"], ["uav3"]]


def test_a_request_knows_no_sample_from_before_it(flying):
    _, view = (ask(flying, f"dyknow:uav{i}", "30") for i in (1, 2))
    fly(flying, (1, "uav2", 50.0, 0.0), (1.5, "uav3", 50.0, 0.0))
    flying.cancel_event(view.id)
    # uav1 has a unit of its own: one more of the same template shares with nobody yet.
    third = ask(flying, "dyknow:uav3", "30")
    again = ask(flying, "dyknow:uav2", "30")
    climb(flying, begin=1, names=("uav2", "uav3"))
    assert objects(flying, third) == ["uav3"]
    assert objects(flying, again) == ["uav2"]
    first = flying.generator(again.stream).stream.all().values_at(0)["start"]
    assert first == "1970-01-01T00:00:02Z"


def test_it_runs_as_long_as_a_request_needs_it(flying):
    first, second, third = (ask(flying, f"dyknow:uav{i}", "30") for i in (1, 2, 3))
    shared = second.plan.units[0].output
    flying.cancel_event(first.id)
    flying.cancel_event(second.id)
    assert shared in flying._parts.configuration.units
    # The unit runs, so the next request shares it.
    fourth = ask(flying, "dyknow:uav4", "30")
    assert fourth.plan.units[0].output == shared
    climb(flying)
    assert [objects(flying, view) for view in (third, fourth)] == [["uav3"], ["uav4"]]
    flying.cancel_event(third.id)
    flying.cancel_event(fourth.id)
    assert not flying._parts.configuration.units


def test_what_fails_in_one_fails_in_no_other(flying):
    _, second, third = (ask(flying, f"dyknow:uav{i}", "30") for i in (1, 2, 3))
    unit = flying._parts.configuration.units[second.stream]

    def fail(found, pools):
        raise RuntimeError("no more")

    unit._writer.columns = fail
    climb(flying)
    assert unit.failure == "RuntimeError: no more"
    with pytest.raises(BadArguments, match="is evaluated no more: RuntimeError: no more"):
        flying.event_partial(second.id, (), 10)
    with pytest.raises(BadArguments, match="is evaluated no more"):
        flying.event_why(second.id, (), SECOND)
    assert objects(flying, third) == ["uav3"]
    again = ask(flying, "dyknow:uav2", "30")
    assert again.stream != second.stream
    climb(flying, begin=10)
    assert objects(flying, again) == ["uav2"]
    for view in (second, third, again):
        flying.cancel_event(view.id)


def test_what_fails_in_the_evaluation_fails_in_all(flying):
    views = [ask(flying, f"dyknow:uav{i}", "30") for i in (1, 2, 3)]
    shared = flying._parts.configuration.units[views[1].plan.units[0].output]

    def fail(watermark, by_clock=False):
        raise RuntimeError("no more")

    shared.recognition.advance = fail
    climb(flying)
    assert flying.event(views[0].id).failure is None
    assert all(flying.event(view.id).failure for view in views[1:])
    again = ask(flying, "dyknow:uav2", "30")
    climb(flying, begin=10)
    assert objects(flying, again) == ["uav2"]
    for view in (*views, again):
        flying.cancel_event(view.id)
    assert not flying._parts.configuration.units


def test_a_request_that_comes_after_a_silent_stream_went_on_has_its_own(engine):
    """The shared evaluation has not waited for the stream, so its next samples are late there."""
    fields = (Field("id", FieldType.STRING), Field("v", FieldType.FLOAT))
    for name, feature, idle in (("a", "speed", None), ("b", "altitude", 2 * SECOND)):
        engine.declare(StreamDeclaration(name, fields, idle=idle))
        engine.annotate(f"stream {name} contains {feature}(UAV) = v for every UAV = id")
    engine.register_template(CLIMB)
    views = [ask(engine, f"dyknow:uav{i}", "30") for i in (1, 2)]
    feed(engine, "b", [(1, {"id": "uav3", "v": 1.0})])
    engine.tick(9 * SECOND)
    feed(engine, "a", [(5, {"id": "uav2", "v": 1.0}), (6, {"id": "uav3", "v": 50.0})])
    assert made_by(ask(engine, "dyknow:uav4", "30"))[-1] == "selectInstance"
    feed(engine, "b", [(3, {"id": "uav2", "v": 1.0}), (3, {"id": "uav3", "v": 20.0})])
    assert engine.event(views[1].id).late == 1
    assert made_by(ask(engine, "dyknow:uav3", "30"))[-1] == "pattern"


def test_a_reader_of_an_answer_hears_of_time(flying):
    _, view = (ask(flying, f"dyknow:uav{i}", "30") for i in (1, 2))
    fly(flying, (1, "uav3", 1.0, 1.0))
    generator, reader = flying.generator(view.stream), Reader()
    generator.subscribe(reader)
    assert reader.heard == [("time", SECOND)]
    fly(flying, (2, "uav3", 1.0, 1.0))
    assert reader.heard[1:] == [("time", 2 * SECOND)]
    climb(flying, begin=2, names=("uav2",))
    assert ("samples", 1) in reader.heard
    flying.end("a")
    assert reader.heard[-1] == ("ended", view.stream)
    generator.unsubscribe(reader)


def test_the_shared_unit_tells_how_many_were_answered(flying):
    _, second, _ = (ask(flying, f"dyknow:uav{i}", "30") for i in (1, 2, 3))
    climb(flying, names=("uav2",))
    assert samples(flying, second.plan.units[0].output) == [
        (3, {"instances": 2, "answered": 1}),
    ]


@pytest.mark.parametrize("writes_checkpoint", [True, False])
def test_a_data_directory_that_is_opened_again_goes_on(tmp_path, writes_checkpoint):
    """From a checkpoint, or from the log: while a match waits, and a sample of another is kept."""
    asked = [c.RequestEvent(f"Climb(dyknow:uav{i}, 30)") for i in (1, 2, 3)]
    made = [c.Annotate(STREAM), c.RegisterTemplate(CLIMB), *asked]
    rows = [(1, "uav2", 50.0, 0.0), (1, "uav3", 50.0, 0.0), (3, "uav2", 20.0, 20.0)]
    later = [(3, "uav3", 20.0, 20.0), (4, "uav2", 20.0, 0.0), (4.5, "uav3", 20.0, 0.0)]
    later.append((5, "uav1", 1.0, 0.0))

    def published(time, name, v, w):
        row = {
            "available": int(time * SECOND),
            "valid": int(time * SECOND),
            "id": name,
            "v": v,
            "w": w,
        }
        return c.Publish("a", "ndjson", json.dumps(row).encode(), 0)

    recorded = opened(tmp_path)
    for command in (*made, *(published(*row) for row in rows)):
        recorded.do(command)
    if writes_checkpoint:
        recorded.checkpoint().write()
    recorded.log.commit()
    recorded._directory.close()
    recorded = opened(tmp_path)
    assert recorded.recovery.notes == []
    for row in later:
        recorded.do(published(*row))
    engine = recorded.engine
    views = engine.events()
    assert [made_by(view)[-1] for view in views] == ["pattern", "selectInstance", "selectInstance"]
    assert [objects(engine, view) for view in views] == [[], ["uav2"], ["uav3"]]
    recorded._directory.close()


def opened(path):
    return RecordedEngine(path, now=0, durability=Durability.WRITE)


def test_a_recording_that_has_ended_keeps_no_request_from_sharing(engine):
    """Requests read the stream that goes on, and so does the evaluation that they share."""
    engine.annotate(STREAM.replace("stream a", "stream recorded"))
    engine.register_template(CLIMB)
    feed(engine, "recorded", [(t, {"id": "uav1", "v": 1.0, "w": 1.0}) for t in (1, 2)])
    engine.end("recorded")
    engine.annotate(STREAM)
    views = [ask(engine, f"dyknow:uav{i}", "30") for i in (1, 2)]
    assert made_by(views[1]) == ["pattern", "selectInstance"]
    assert views[1].plan.streams == ("a",)
    climb(engine)
    assert [objects(engine, view) for view in views] == [["uav1"], ["uav2"]]
