"""Law: a request that begins at a time of the past gives what one from the ``start`` gives where
nothing but the samples available from that time on has ever been; a duration is the time so long
before the newest sample of all streams that are read (SPEC §1)."""

import pytest
from feeding import feed, flight
from hypothesis import example, given, note, settings
from hypothesis import strategies as st
from places import ROOT

from dyknow.engine.engine import Engine
from dyknow.engine.model.views import Since, StreamDeclaration
from dyknow.streams.history import Retention
from dyknow.streams.past_queries import Forgotten
from dyknow.streams.sample import Field, FieldType
from dyknow.streams.time import SECOND

LAWS = settings(deadline=None, max_examples=60)
HIGH_SPEED = ROOT / "templates" / "library" / "high_speed.rq"
TEXT, FLOAT = FieldType.STRING, FieldType.FLOAT
FIELDS = {
    "s": (Field("id", TEXT), Field("v", FLOAT)),
    "t": (Field("id", TEXT), Field("a", FLOAT)),
    "c": (Field("id", TEXT), Field("lat", FLOAT), Field("lon", FLOAT)),
}
MEANING = """stream s contains speed(UAV) = v [km.h-1] for every UAV = id
stream t contains altitude(UAV) = a for every UAV = id"""
COORDINATES = "stream c contains latitude(UAV) = lat, longitude(UAV) = lon for every UAV = id"
S, T = (f"<http://www.ida.liu.se/dyknow/{name}.trdf>" for name in "st")
QUERIES = [
    f"REGISTER QUERY q AS SELECT ?o ?v FROM STREAM {S} [RANGE 3s STEP 1s] "
    "WHERE { ?o dyknow:speed ?v }",
    f"REGISTER STREAM q AS CONSTRUCT {{ ?o dyknow:speed ?m }} FROM STREAM {S} [RANGE 2s STEP 2s] "
    "WHERE { ?o dyknow:speed ?v } AGGREGATE {(?m, MAX, {?v})}",
    f"REGISTER QUERY q AS SELECT ?o ?v ?a FROM STREAM {S} [RANGE 3s STEP 1s] "
    f"FROM STREAM {T} [RANGE 2s STEP 1s] WHERE {{ ?o dyknow:speed ?v ; dyknow:altitude ?a }}",
    "REGISTER QUERY q AS SELECT ?o ?v ?a WHERE { ?o dyknow:speed ?v ; dyknow:altitude ?a } "
    "WINDOW [RANGE 3s STEP 1s]",
]
POLICIES = ("", "any change", "strict order, any change", "sample every 500, max delay 5 s")


def by_query(text):
    return lambda engine, since: engine.queries.register(text, since=since).stream


def by_policy(policy):
    return lambda engine, since: engine.subscribe("s", policy, since=since).stream


def by_feature(engine, since):
    return engine.subscribe_to_feature("speed", sort="UAV", since=since).stream


def by_event(engine, since):
    text = "dyknow:HighSpeedEvent(?o, dyknow:UAV, 2)"
    return engine.request_event(engine.parse_request(text), since=since).stream


REQUESTS = [*map(by_query, QUERIES), *map(by_policy, POLICIES[1:]), by_feature, by_event]

times = st.integers(0, 60).map(lambda n: n / 5)
rows = st.lists(
    st.tuples(
        st.sampled_from("sst"),
        st.integers(0, 4).map(lambda n: n / 5),
        st.sampled_from(["uav1", "uav2"]),
        st.integers(0, 5).map(float),
    ),
    min_size=1,
    max_size=25,
)


def timed(wanted):
    """Rows with times that do not decrease: rows of one time are an instant."""
    now, found = 0.0, []
    for stream, wait, name, value in wanted:
        now = round(now + wait, 1)
        field = "v" if stream == "s" else "a"
        found.append((stream, now, {"id": name, field: value}))
    return found


def new_engine():
    engine = Engine(epoch="law")
    engine.register_template(HIGH_SPEED.read_text())
    for name, fields in FIELDS.items():
        engine.declare(StreamDeclaration(name, fields))
    engine.annotate(MEANING)
    return engine


def give(engine, timed_rows):
    for stream, time, values in timed_rows:
        feed(engine, stream, [(time, values)])


def told(engine, stream):
    return list(engine.generator(stream).stream.all().rows())


@LAWS
@given(st.sampled_from(REQUESTS), rows, rows, times, st.booleans())
@example(by_feature, [("s", 1, "uav1", 1.0)] * 5, [("s", 0, "uav1", 2.0)] * 5, 3.0, True)
def test_a_request_at_a_time_reads_the_samples_from_then_on(ask, before, after, time, duration):
    all_rows = timed(before + after)
    past, future = all_rows[: len(before)], all_rows[len(before) :]
    since = str(int(time * SECOND))
    if duration:
        # s has always something to say; t is read by some requests and may be the newer one.
        newest = past[-1][1]
        past.append(("s", newest, {"id": "uav1", "v": 1.0}))
        since = f"{round((newest - time) * 10) * 100}ms" if newest >= time else since
        note(since)
    whole, part = new_engine(), new_engine()
    give(whole, past)
    give(part, [row for row in past if row[1] >= time])
    streams = ask(whole, since), ask(part, Since.START)
    assert told(whole, streams[0]) == told(part, streams[1])
    give(whole, future)
    give(part, [row for row in future if row[1] >= time])
    for engine in (whole, part):
        for name in "st":
            engine.end(name)
    assert told(whole, streams[0]) == told(part, streams[1])


@settings(LAWS, max_examples=12)
@given(st.integers(0, 20), st.integers(1, 20))
def test_what_is_computed_for_it_begins_there_too(time, cut):
    """Speeds are made from positions: there is none of the first position that is read."""
    flown = [(t, {"id": "uav1", "lat": lat, "lon": lon}) for t, lat, lon in flight(0, 20, 400)]
    whole, part = new_engine(), new_engine()
    for engine in (whole, part):
        engine.annotate(COORDINATES)
        engine.remove_stream("s")
    feed(whole, "c", flown[:cut])
    if seen := [row for row in flown[:cut] if row[0] >= time]:
        feed(part, "c", seen)
    streams = by_event(whole, str(time * SECOND)), by_event(part, Since.START)
    for t, values in flown[cut:]:
        feed(whole, "c", [(t, values)])
        if t >= time:
            feed(part, "c", [(t, values)])
    for engine in (whole, part):
        engine.end("c")
    assert told(whole, streams[0]) == told(part, streams[1])


@settings(LAWS, max_examples=40)
@given(st.sampled_from(REQUESTS), rows, times, st.integers(1, 8))
@example(REQUESTS[0], [("s", 0, "uav1", 0.0), ("s", 0.8, "uav1", 0.0)], 0.5, 1)
def test_what_is_forgotten_is_refused_or_not_needed(ask, given_rows, time, kept):
    # Retention may cut an instant; each of these is one sample.
    given_rows = timed([(name, wait + 0.2, id, value) for name, wait, id, value in given_rows])
    whole, short = new_engine(), new_engine()
    for name in "st":
        short.declare(StreamDeclaration(name, FIELDS[name], retention=Retention(kept)))
    give(whole, given_rows)
    give(short, given_rows)
    since = str(int(time * SECOND))
    expected = ask(whole, since)
    try:
        stream = ask(short, since)
    except Forgotten:
        stream = None
    gone = [[at for name, at, _ in given_rows if name == each][:-kept] for each in "st"]
    lacks = [any(at >= time for at in each) for each in gone]
    if stream is None:
        assert any(lacks)
        return
    assert not lacks[0]
    for engine in (whole, short):
        for name in "st":
            engine.end(name)
    assert told(whole, expected) == told(short, stream)


@pytest.mark.parametrize("ask", REQUESTS)
@pytest.mark.parametrize("since", ["1h", str(SECOND)])
def test_a_request_that_is_refused_leaves_nothing(ask, since):
    engine = new_engine()
    for name in "st":
        engine.declare(StreamDeclaration(name, FIELDS[name], retention=Retention(2)))
    give(engine, timed([(name, 1, "uav1", 1.0) for name in "ststst"]))
    before = engine.units(), [stream.subscribers for stream in engine.streams()]
    with pytest.raises(Forgotten) as refused:
        ask(engine, since)
    assert refused.value.oldest in (3 * SECOND, 4 * SECOND)
    assert (engine.units(), [stream.subscribers for stream in engine.streams()]) == before
