"""Law: requests that share a query are told what each would be told by a query of its own, from the
first window on that begins after the request."""

import pytest
from feeding import feed, samples
from hypothesis import given, settings
from hypothesis import strategies as st

from dyknow.continuous.windows import window_schedule
from dyknow.engine.durability.checkpoint import Outside, engine_of, state_of
from dyknow.engine.engine import Engine
from dyknow.engine.planning import request_sharing
from dyknow.engine.processes.registry import Processes
from dyknow.engine.processes.supervision import DIRECT

RANGE = 3
TEMPLATES = [
    f"""REGISTER TEMPLATE dyknow:{name}Event({parameters}) COMPUTE EVERY 1s AS
PREFIX dyknow: <http://www.ida.liu.se/dyknow/>
{body} WINDOW [RANGE {RANGE}s STEP 1s]"""
    for name, parameters, body in (
        (
            "Fast",
            "?o, ?type, ?limit",
            """CONSTRUCT { ?o dyknow:speed ?a } WHERE { ?o a ?type . ?o dyknow:speed ?s }
            AGGREGATE { (?a, AVG, {?s}) FILTER (?a > ?limit) }""",
        ),
        (
            "Turning",
            "?o, ?type, ?limit",
            """CONSTRUCT { ?o dyknow:speed ?s ; dyknow:heading ?h }
            WHERE { ?o a ?type ; dyknow:speed ?s ; dyknow:heading ?h . FILTER (?h > ?limit) }""",
        ),
        (
            "Apart",
            "?o, ?limit",
            """SELECT ?o ?other (?s - ?t AS ?apart) WHERE { ?o dyknow:speed ?s .
            ?other dyknow:heading ?t . FILTER (?s > ?limit) }""",
        ),
        (
            "Count",
            "?o, ?limit",
            """SELECT (COUNT(*) AS ?n) WHERE { ?o dyknow:speed ?s . FILTER (?s > ?limit) }""",
        ),
        ("Any", "?o, ?limit", "ASK { ?o dyknow:speed ?s . FILTER (?s > ?limit) }"),
        (
            "Perhaps",
            "?o, ?limit",
            """SELECT ?o ?s ?h WHERE { ?o dyknow:speed ?s . OPTIONAL { ?o dyknow:heading ?h
            FILTER (?h > ?limit) } }""",
        ),
        (
            "Kinds",
            "?o, ?type, ?limit",
            """SELECT ?o ?s ?x WHERE { ?o dyknow:speed ?s . ?x a ?type . FILTER (?s > ?limit) }""",
        ),
    )
]
NAMES = ["Fast", "Turning", "Apart", "Count", "Any", "Perhaps", "Kinds"]
WITH_SORT = {"Fast", "Turning", "Kinds"}
OBJECTS = ["uav1", "uav2", "uav3"]


@st.composite
def requests(draw):
    name = draw(st.sampled_from(NAMES))
    given = [draw(st.sampled_from(["?o", *(f"dyknow:{one}" for one in OBJECTS)]))]
    if name in WITH_SORT:
        given.append(draw(st.sampled_from(["dyknow:UAV", "dyknow:RMAX"])))
    limit = draw(st.sampled_from(["1", "2.5", "4"]))
    return f"dyknow:{name}Event({', '.join([*given, limit])})"


rows = st.lists(
    st.tuples(
        st.floats(0.01, 1.2).map(lambda x: round(x, 2)),
        st.sampled_from(OBJECTS),
        st.integers(0, 5).map(float),
        st.one_of(st.none(), st.integers(0, 5).map(float)),
    ),
    min_size=1,
    max_size=6,
)
steps = st.lists(
    st.one_of(rows, rows, requests(), requests(), st.integers(0, 8), st.just(("restart",))),
    min_size=4,
    max_size=14,
)
STREAMS = [
    "stream s contains speed(UAV) = v, heading(UAV) = h for every UAV = id",
    "stream s contains speed(RMAX) = v for every RMAX = id\n"
    "stream t contains heading(UAV) = h for every UAV = id",
]


class Follower:
    """Counts the samples of a stream."""

    def __init__(self):
        self.heard = 0

    def receive(self, source, batch):
        self.heard += len(batch)

    def ended(self, source):
        pass


def told(given, streams, least, *, followed=False):
    """What each request is told, with the time at which it was made. ``followed``: somebody listens
    to the stream of every second request."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(window_schedule, "FEWEST", 2)
        patch.setattr(request_sharing, "MIN_SHARED", least)
        engine = Engine(epoch="law")
        engine.annotate(streams)
        for template in TEMPLATES:
            engine.register_template(template)
        now, running, ended, followers = 0.0, {}, [], {}
        for i, step in enumerate(given):
            match step:
                case str():
                    view = engine.request_event(engine.parse_request(step))
                    running[i] = (view.id, step, now, view.stream)
                    if followed and i % 2:
                        follower, generator = Follower(), engine.generator(view.stream)
                        followers[i] = follower, generator.counters.used
                        generator.listen(follower)
                case ("restart",):
                    outside = Outside(Processes(), DIRECT)
                    engine, _ = engine_of(state_of(engine, None, outside).data, outside)
                    followers.clear()
                case int():
                    if step in running:
                        ended.append((step, *seen(engine, running[step])))
                        engine.cancel_event(running.pop(step)[0])
                case _:
                    now = publish(engine, step, now)
        shared = sum(
            unit.transformation == "selectInstance"
            for unit in engine._parts.configuration.units.values()
        )
        # Two windows close that are complete.
        publish(engine, [(1.0, "uav1", 3.0, 3.0)] * (RANGE + 2), now)
        for number, (follower, before) in followers.items():
            if number in running:
                used = engine.generator(running[number][3]).counters.used
                assert follower.heard == used - before
        for number, request in running.items():
            ended.append((number, *seen(engine, request)))
        for id, *_ in running.values():
            engine.cancel_event(id)
        assert not engine._parts.configuration.units
        return sorted(ended, key=lambda one: one[0]), shared


def publish(engine, given, now):
    names = {view.name for view in engine.streams()}
    spoken, headings = [], []
    for wait, name, speed, heading in given:
        now = round(now + wait, 2)
        both = {"id": name, "v": speed} | ({} if "t" in names else {"h": heading})
        spoken.append((now, both))
        headings.append((now, {"id": name, "h": heading}))
    feed(engine, "s", spoken)
    if "t" in names:
        feed(engine, "t", headings)
    return now


def seen(engine, request):
    _, text, since, stream = request
    found = [
        (valid, sorted(values.items(), key=str))
        for valid, values in samples(engine, stream)
        if valid - RANGE >= since
    ]
    return text, found


@settings(deadline=None, max_examples=60)
@given(steps, st.sampled_from(STREAMS), st.sampled_from([1, 2]), st.booleans())
def test_sharing_changes_nothing(given, streams, least, followed):
    alone, _ = told(given, streams, 10**9)
    shared, _ = told(given, streams, least, followed=followed)
    assert shared == alone


def test_requests_are_shared_in_the_law():
    texts = [f"dyknow:FastEvent({one}, dyknow:UAV, 2)" for one in ("?o", "dyknow:uav1")]
    _, shared = told([*texts, "dyknow:PerhapsEvent(dyknow:uav2, 1)"], STREAMS[0], 1)
    assert shared == 3
