"""Explanations of verdicts: they say what the verdict stream says, with the parts that lead
there."""

import random

import pytest
from feeding import feed, samples

from dyknow.engine.model.errors import BadArguments, NoResult, Refused
from dyknow.engine.model.views import StreamDeclaration
from dyknow.reasoning.mtl import evaluator
from dyknow.reasoning.states import state_maker
from dyknow.streams.history import Retention
from dyknow.streams.past_queries import Forgotten
from dyknow.streams.sample import Field, FieldType
from dyknow.streams.time import SECOND, parse_time

FIELDS = (
    Field("id", FieldType.STRING),
    Field("spd", FieldType.FLOAT),
    Field("alt", FieldType.FLOAT),
)
SSL = "stream s5 contains speed(UAV) = spd [km.h-1], altitude(UAV) = alt [ft] for every UAV = id"
FORMULAS = [
    "always [0s, 4s] (speed(?x) > 100 -> eventually [0s, 2s] speed(?x) < 90)",
    "not (speed(?x) > 100 until [1s, 5s] altitude(?x) > 50)",
    "once [0s, 3s] speed(?x) > 110 and previous altitude(?x) > 20",
    "historically [0s, 2s] speed(?x) > 30 -> eventually speed(?x) > 118",
    "forall ?y in UAV (speed(?y) > 20 or speed(?x) > speed(?y))",
]
OTHERS = ("uav1", "uav2", "uav3")
POLICIES = [
    "sample every 1s, max delay 0s, use most recent",
    "sample every 2s, max delay 1s",
    "any change, use most recent",
    "max delay 3s",
]


@pytest.fixture
def flying(engine):
    engine.annotate(SSL)
    return engine


def fly(engine, seed):
    draw = random.Random(seed)
    rows = []
    for second in range(1, 30):
        for name in ("uav1", "uav2"):
            if draw.random() < 0.7:
                row = {"id": name, "spd": draw.uniform(0, 130), "alt": draw.uniform(0, 100)}
                rows.append((second, row))
    feed(engine, "s5", rows)


@pytest.mark.parametrize("formula", FORMULAS)
@pytest.mark.parametrize("policy", POLICIES)
def test_an_explanation_says_what_the_stream_says(flying, formula, policy):
    flying.queries.register(f"monitor m(?x in UAV) = {formula} with {policy}, report verdicts")
    fly(flying, formula + policy)
    flying.end("s5")
    told = samples(flying, "m")
    assert len(told) > 20
    for seconds, sample in told[:: len(told) // 10]:
        start = int(seconds * SECOND)
        found = flying.queries.why("m", [sample["x"]], start)()
        assert found.start == start
        assert found.verdict == sample["verdict"]
        assert found.decided == parse_time(sample["decided"])
        assert found.valid[-1] == found.decided
        assert start in found.valid
        root, *parts = found.formulas
        assert root.depth == 0
        assert root.values[found.valid.index(start)] == sample["verdict"]
        assert all(part.depth > 0 for part in parts)
        for shown in (*found.features, *found.formulas):
            assert len(shown.values) in (0, len(found.valid))


@pytest.mark.parametrize("formula", FORMULAS)
def test_a_verdict_with_robustness_is_decided_when_the_stream_says(flying, formula):
    flying.queries.register(
        f"monitor m(?x in UAV) = {formula}"
        " with sample every 1s, max delay 0s, use most recent, robustness, report verdicts"
    )
    fly(flying, formula)
    told = {(int(start), sample["x"]) for start, sample in samples(flying, "m")}
    checked = 0
    for second in range(1, 29):
        for name in ("uav1", "uav2"):
            try:
                found = flying.queries.why("m", [name], second * SECOND)()
            except NoResult:
                continue
            assert (found.verdict == "open") is ((second, name) not in told)
            assert (found.decided is None) is (found.verdict == "open")
            checked += 1
    assert checked > 20
    flying.end("s5")
    told = samples(flying, "m")
    assert len(told) > 20
    for seconds, sample in told:
        found = flying.queries.why("m", [sample["x"]], int(seconds * SECOND))()
        assert found.verdict == sample["verdict"]
        assert found.decided == parse_time(sample["decided"])


def test_the_values_of_parts_and_features(flying):
    flying.queries.register(
        "monitor m(?x in UAV) = always [0s, 2s] (speed(?x) > 100 -> altitude(?x) > 50)"
        " with sample every 1s, max delay 0s, report verdicts"
    )
    speeds = [(1, 120.0, 60.0), (2, 90.0, 10.0), (3, 120.0, 10.0), (4, 120.0, 10.0)]
    feed(flying, "s5", [(t, {"id": "uav1", "spd": s, "alt": a}) for t, s, a in speeds])
    found = flying.queries.why("m", ["uav1"], SECOND)()
    assert found.verdict == "false"
    assert found.valid == (SECOND, 2 * SECOND, 3 * SECOND)
    assert [(each.text, each.values) for each in found.features] == [
        ("speed(?x) [km.h-1]", (120.0, 90.0, 120.0)),
        ("altitude(?x) [ft]", (60.0, 10.0, 10.0)),
    ]
    assert [(each.depth, each.values) for each in found.formulas] == [
        (0, ("false", "false", "false")),
        (1, ("true", "true", "false")),
        (2, ("true", "false", "true")),
        (2, ("true", "false", "false")),
    ]
    # The last state that has left decides nothing for its own window.
    open_one = flying.queries.why("m", ["uav1"], 2 * SECOND)()
    assert open_one.verdict == "false"


def test_a_verdict_that_is_not_decided_yet(flying):
    flying.queries.register(
        "monitor m(?x in UAV) = eventually [0s, 9s] speed(?x) > 100 with any change"
    )
    feed(flying, "s5", [(t, {"id": "uav1", "spd": 1.0, "alt": 1.0}) for t in range(1, 5)])
    found = flying.queries.why("m", ["uav1"], SECOND)()
    assert (found.verdict, found.decided) == ("open", None)
    assert found.formulas[1].values == ("false",) * len(found.valid)


def test_what_cannot_be_explained(flying):
    flying.queries.register("monitor m(?x in UAV) = speed(?x) > 100 with sample every 1s")
    with pytest.raises(NoResult, match="no state yet"):
        flying.queries.why("m", ["uav1"], SECOND)()
    feed(flying, "s5", [(t, {"id": "uav1", "spd": 1.0, "alt": 1.0}) for t in range(1, 5)])
    with pytest.raises(NoResult, match="no state at this time") as refused:
        flying.queries.why("m", ["uav1"], SECOND + 1)()
    assert "1970-01-01T00:00:01Z and 1970-01-01T00:00:02Z" in refused.value.hint
    with pytest.raises(NoResult, match="uav9 is not there"):
        flying.queries.why("m", ["uav9"], SECOND)()
    with pytest.raises(BadArguments, match="0 objects are given for a monitor of 1"):
        flying.queries.why("m", [], SECOND)()
    flying.queries.register(
        "REGISTER QUERY q AS SELECT ?v FROM STREAM <http://www.ida.liu.se/dyknow/s5.trdf> "
        "[RANGE 2s STEP 1s] WHERE { ?o dyknow:speed ?v }"
    )
    with pytest.raises(BadArguments, match="only verdicts of monitors"):
        flying.queries.why("q", [], SECOND)()


def test_forgotten_samples_are_not_guessed(engine):
    engine.declare(StreamDeclaration("s5", FIELDS, retention=Retention(samples=6)))
    engine.annotate(SSL)
    engine.queries.register("monitor m(?x in UAV) = speed(?x) > 100 with sample every 2s")
    engine.queries.register("monitor all = forall ?x in UAV speed(?x) > 100 with sample every 2s")
    for t in range(1, 21):
        feed(engine, "s5", [(t, {"id": "uav1", "spd": 1.0, "alt": 1.0})])
    assert engine.generator("s5").stream.first_number == 15
    # The grid is the one that began at the first second; of 15 s the state before is not known.
    for second in (1, 13, 15):
        with pytest.raises(Forgotten):
            engine.queries.why("m", ["uav1"], second * SECOND)()
    assert engine.queries.why("m", ["uav1"], 17 * SECOND)().verdict == "false"
    with pytest.raises(NoResult):
        engine.queries.why("m", ["uav1"], 18 * SECOND)()
    with pytest.raises(Forgotten):
        engine.queries.why("all", [], 17 * SECOND)()


def test_a_monitor_that_begins_later_has_its_own_grid(flying):
    feed(flying, "s5", [(t, {"id": "uav1", "spd": 1.0, "alt": 1.0}) for t in (1, 2, 3)])
    flying.queries.register(
        "monitor m(?x in UAV) = speed(?x) > 100 with sample every 2s, report verdicts"
    )
    feed(flying, "s5", [(t, {"id": "uav1", "spd": 1.0, "alt": 1.0}) for t in (4, 5, 6, 7, 8)])
    starts = [int(seconds * SECOND) for seconds, _ in samples(flying, "m")]
    assert starts[0] == 4 * SECOND
    assert flying.queries.why("m", ["uav1"], starts[0])().verdict == "false"


def test_more_states_than_can_be_evaluated(flying, monkeypatch):
    flying.queries.register("monitor m(?x in UAV) = speed(?x) > 100 with sample every 1s")
    feed(flying, "s5", [(t, {"id": "uav1", "spd": 1.0, "alt": 1.0}) for t in range(1, 5)])
    work = flying.queries.why("m", ["uav1"], SECOND)
    monkeypatch.setattr(state_maker, "MOST_STATES", 1)
    with pytest.raises(Refused, match="more states"):
        work()


def test_states_of_many_objects(flying, monkeypatch):
    flying.queries.register("monitor m = forall ?x in UAV speed(?x) < 100 with max delay 0s")
    rows = [(t, {"id": name, "spd": 1.0, "alt": 1.0}) for t in range(1, 5) for name in OTHERS]
    feed(flying, "s5", rows)
    work = flying.queries.why("m", [], SECOND)
    assert work().verdict == "true"
    monkeypatch.setattr(evaluator, "MOST_VALUES", 2)
    with pytest.raises(Refused, match="more states"):
        work()


def test_samples_that_come_meanwhile_change_no_explanation(flying):
    flying.queries.register(
        "monitor m(?x in UAV) = always [0s, 9s] speed(?x) < 100 with max delay 0s"
    )
    rows = [(t, {"id": name, "spd": 1.0, "alt": 1.0}) for t in range(1, 5) for name in OTHERS]
    feed(flying, "s5", rows)
    work = flying.queries.why("m", ["uav1"], SECOND)
    feed(flying, "s5", [(t, {"id": "uav1", "spd": 200.0, "alt": 1.0}) for t in (6, 7)])
    assert work().verdict == "open"
    assert flying.queries.why("m", ["uav1"], SECOND)().verdict == "false"


def test_an_object_without_samples_has_no_state(flying):
    flying.queries.register("monitor m(?x in UAV) = speed(?x) > 100")
    feed(flying, "s5", [(t, {"id": "uav1", "spd": 1.0, "alt": 1.0}) for t in range(1, 5)])
    with pytest.raises(NoResult, match="there is no state of uav9 yet"):
        flying.queries.why("m", ["uav9"], SECOND)()
