"""Requests of a formula's template for an object each, evaluated as one
(engine/planning/object_sharing.py)."""

import pytest
from feeding import Reader, feed, samples

from dyknow.engine.model.errors import NoResult
from dyknow.engine.model.views import Since
from dyknow.streams.time import SECOND

STREAM = "stream a contains speed(UAV) = v, altitude(UAV) = w for every UAV = id"
FAST = (
    "REGISTER TEMPLATE Fast(?x in UAV, ?limit) AS always[0s, 2s] speed(?x) < ?limit "
    "with report verdicts"
)
GRID = f"{FAST}, sample every 1s, use most recent"


@pytest.fixture
def flying(engine):
    engine.annotate(STREAM)
    return engine


def ask(engine, *arguments, event="Fast", **options):
    text = f"{event}({', '.join(arguments)})"
    return engine.request_event(engine.parse_request(text), **options)


def made_by(view):
    return [unit.transformation for unit in view.plan.units]


def fly(engine, begin=0, names=("uav1", "uav2", "uav3")):
    """Each has a speed of its own for five seconds, and is faster at the third."""
    for second in range(1, 6):
        rows = [
            (begin + second + 0.25 * i, {"id": name, "v": 10.0 * i + 30 * (second == 3), "w": 1.0})
            for i, name in enumerate(names, 1)
        ]
        feed(engine, "a", rows)


def told(engine, view):
    rows = samples(engine, view.stream)
    return [(values["x"], start, values["verdict"]) for start, values in rows]


@pytest.mark.parametrize("template", [FAST, GRID])
def test_requests_share_from_the_second_on(flying, template):
    flying.register_template(template)
    views = [ask(flying, f"dyknow:uav{i}", "45") for i in (1, 2, 3)]
    assert made_by(views[0]) == ["selectObject", "mtl"]
    assert made_by(views[1]) == made_by(views[2]) == ["mtl", "selectInstance"]
    assert views[1].plan.units[0].name == views[2].plan.units[0].name
    assert [view.kind for view in views] == ["MONITOR"] * 3
    fly(flying)
    # 30 and 50, 60 at the third second; a grid begins with the request's own first sample.
    assert told(flying, views[0])[:2] == [("uav1", 1.25, "true"), ("uav1", 2.25, "true")]
    assert told(flying, views[1])[:2] == [("uav2", 1.5, "false"), ("uav2", 2.5, "false")]
    assert told(flying, views[2])[:2] == [("uav3", 1.75, "false"), ("uav3", 2.75, "false")]
    first, third = (flying.stream(views[i].stream) for i in (0, 2))
    assert third.fields == first.fields
    assert third.annotation == first.annotation.replace(first.name, third.name).replace(
        "uav1", "uav3"
    )


def test_requests_with_other_values_share_too(flying):
    flying.register_template(FAST)
    views = [ask(flying, "dyknow:uav2", limit) for limit in ("40", "49", "51", "60")]
    assert [made_by(view)[-1] for view in views] == ["mtl", *["selectInstance"] * 3]
    assert len({view.plan.units[0].name for view in views[1:]}) == 1
    fly(flying)
    assert [told(flying, view)[0] for view in views] == [
        ("uav2", 1.5, "false"),
        ("uav2", 1.5, "false"),
        ("uav2", 1.5, "true"),
        ("uav2", 1.5, "true"),
    ]
    flying.cancel_event(views[2].id)
    fly(flying, 10)
    assert told(flying, views[3])[-1][0] == "uav2"


def test_what_is_shared_is_explained(flying):
    flying.register_template(FAST)
    views = [ask(flying, f"dyknow:uav{i}", "45") for i in (1, 2, 3)]
    fly(flying)
    explained = flying.explain_running(views[2].id)
    assert "Fast(dyknow:uav3, 45)" in explained
    assert "shared by    2 requests" in explained
    assert "states       10 by now" not in explained
    assert "not shared" not in explained
    assert "not shared   it was the first of its kind" in flying.explain_running(views[0].id)


@pytest.mark.parametrize(
    ("template", "reason"),
    [
        ("forall ?y in UAV speed(?y) < ?limit + speed(?x)", "not those of many objects"),
        ("speed(?x) > ?limit + speed(uav3)", "not those of many objects"),
        ("speed(?x) > ?limit + speed(uav2)", "further objects"),
        ("speed(?x) > ?limit with once, sample every 1s, use most recent", "a single start"),
    ],
)
def test_why_a_formula_does_not_share_is_explained(flying, template, reason):
    flying.register_template(f"REGISTER TEMPLATE Fast(?x in UAV, ?limit) AS {template}")
    views = [ask(flying, f"dyknow:uav{i}", "45") for i in (1, 2)]
    assert [made_by(view)[-1] for view in views] == ["mtl", "mtl"]
    assert reason in flying.explain_running(views[1].id)


def test_a_request_for_the_past_is_evaluated_by_itself(flying):
    flying.register_template(FAST)
    fly(flying)
    views = [ask(flying, f"dyknow:uav{i}", "45", since=Since.START) for i in (1, 2)]
    assert [made_by(view)[-1] for view in views] == ["mtl", "mtl"]
    assert "it begins in the past" in flying.explain_running(views[1].id)


@pytest.mark.parametrize("template", [FAST, GRID])
def test_a_verdict_is_explained_as_one_of_a_request_by_itself(flying, template):
    flying.register_template(template)
    alone, second = (ask(flying, f"dyknow:uav{i}", "45") for i in (1, 2))
    fly(flying)
    later = ask(flying, "dyknow:uav3", "45")
    fly(flying, 10)

    def why(view, name, start):
        found = flying.event_why(view.id, (name,), int(start * SECOND))()
        return found.verdict, found.decided / SECOND

    assert why(alone, "uav1", 2.25) == ("true", 4.25)
    assert why(second, "uav2", 2.5) == ("false", 3.5)
    assert why(later, "uav3", 12.75) == ("false", 13.75)
    with pytest.raises(NoResult):
        why(later, "uav3", 2.75)


def test_why_there_is_no_verdict_is_said_of_the_own_object(flying):
    flying.register_template(FAST.replace("verdicts", "violations"))
    _, second, third = (ask(flying, f"dyknow:uav{i}", "95") for i in (1, 2, 3))
    fly(flying, names=("uav1", "uav2"))
    assert flying.event(third.id).empty.startswith("no sample read yet")
    assert flying.event(second.id).empty == (
        "5 samples read, 3 states: the verdicts are 1 true, others are not decided yet, and it "
        "reports violations"
    )


def test_a_reader_of_an_answer_hears_of_time(flying):
    flying.register_template(FAST)
    _, view = (ask(flying, f"dyknow:uav{i}", "45") for i in (1, 2))
    generator, reader = flying.generator(view.stream), Reader()
    feed(flying, "a", [(1, {"id": "uav3", "v": 1.0, "w": 1.0})])
    generator.subscribe(reader)
    assert reader.heard == [("time", SECOND)]
    flying.end("a")
    assert reader.heard[-1] == ("ended", view.stream)
    generator.unsubscribe(reader)


def test_units_stop_with_the_last_request(flying):
    flying.register_template(FAST)
    views = [ask(flying, f"dyknow:uav{i}", "45") for i in (1, 2, 3)]
    fly(flying)
    for view in views:
        flying.cancel_event(view.id)
    assert not flying._parts.configuration.units
