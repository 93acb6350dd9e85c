"""Streams of some UAVs, samples of them in some cuts, and options of monitors."""

import itertools

from commanding import IRI, SORTS
from hypothesis import strategies as st

from dyknow.converters.wire import Incoming
from dyknow.engine.durability import commands as c
from dyknow.engine.engine import Engine
from dyknow.engine.model.views import Since
from dyknow.streams.sample import batch_from_rows
from dyknow.streams.time import SECOND

# The ontology has km/h and ft. Objects have names of a field, or one is in the annotation.
SPEEDS = "stream a contains speed(UAV) = v [m.s-1] for every UAV = id"
WORLDS = {
    "one stream": "stream a contains speed(UAV) = v [m.s-1], altitude(UAV) = w [m] for every UAV = "
    "id\nstream b contains heading(UAV) = w for every UAV = id",
    "a stream each": f"{SPEEDS}\nstream b contains altitude(UAV) = w [m] for every UAV = id",
    "speed in both": f"{SPEEDS}\nstream b contains speed(UAV) = v [km.h-1], altitude(UAV) = w "
    "for every UAV = id",
    "computed": "stream a contains latitude(UAV) = v [deg], longitude(UAV) = w [deg] "
    "for every UAV = id\nstream b contains altitude(UAV) = w [m] for every UAV = id",
    "one of an object": f"{SPEEDS}\nstream b contains altitude(uav1) = w [m]",
}
OBJECTS = ("uav1", "uav2", "uav3")
OPTIONS = (
    ("any change", "sample every 1s", "sample every 2s", None),
    ("max delay 0s", "max delay 2s", None, None),
    ("use most recent", "use most recent", None),
    ("present for 2s", None, None, None),
    ("from 1970-01-01T00:00:02Z to 1970-01-01T00:00:09Z", None, None, None),
    ("once", None, None, None, None),
    ("report verdicts", "report verdicts", "report changes", None),
)


@st.composite
def options(draw):
    """What follows ``with``, with the word; empty for no option."""
    found = [option for each in OPTIONS if (option := draw(st.sampled_from(each)))]
    return f" with {', '.join(found)}" if found else ""


@st.composite
def told(draw):
    """The samples of a stream: (available, valid, values), in order of available time."""
    delays = draw(st.sampled_from([[0], [0, 0, 1], [0, 1, 2, 5, -2]]))
    rows = draw(
        st.lists(
            st.tuples(
                st.sampled_from([0, 0, 1, 1, 2, 5]),
                st.sampled_from(delays),
                st.sampled_from(OBJECTS),
                st.sampled_from([1.0, 20.0, 10.5, 4.0, 50.0, None]),
                st.sampled_from([1.0, 20.0, 3.5, 4.0, None]),
            ),
            min_size=draw(st.sampled_from([6, 0])),
            max_size=14,
        )
    )
    times = itertools.accumulate((wait for wait, *_ in rows), initial=draw(st.sampled_from([1, 2])))
    return [
        (t * SECOND // 2, (t - delay) * SECOND // 2, {"id": name, "v": v, "w": w})
        for t, (_, delay, name, v, w) in zip(times, rows, strict=False)
    ]


def publish(engine, stream, rows):
    generator = engine.generator(stream)
    fitting = [(a, v, fields_of(generator, values)) for a, v, values in rows]
    batch = batch_from_rows(generator.schema, fitting, generator.stream.pools)
    engine.publish(stream, Incoming(batch, stamped=False), 0)


def fields_of(generator, values):
    return {name: values[name] for name in generator.schema.names}


def begun(world, text, registers=True):
    engine = Engine(epoch="law")
    c.execute(engine, c.LoadOntology(SORTS, f"{IRI}objects"))
    engine.annotate(WORLDS[world])
    if registers:
        engine.queries.register(text)
    return engine


def result(engine):
    view = engine.queries.view("m")
    assert view.failure is None
    rows = list(engine.generator("m").stream.all().rows())
    counters = engine.generator("m").counters
    assert counters.used == counters.accepted == len(rows)
    return rows, view.state, view.fields


def in_order(world, text, left):
    """Each sample by itself, in order of available time."""
    engine = begun(world, text)
    rows = [(row, name) for name, own in left.items() for row in own]
    for row, name in sorted(rows, key=lambda each: each[0][0]):
        publish(engine, name, [row])
    for name in left:
        engine.end(name)
    return result(engine)


def in_some_order(world, text, left, draw):
    """One stream after the other or by turns, in some cuts; the query may come later, and begin
    with the past."""
    late = draw(st.integers(-3, 3))
    engine = begun(world, text, registers=late <= 0)
    left = {name: list(rows) for name, rows in left.items()}
    for step in itertools.count(1):
        if step == late:
            engine.queries.register(text, since=Since.START)
        if not left:
            break
        name = draw(st.sampled_from(sorted(left)))
        if not left[name]:
            engine.end(name)
            del left[name]
            continue
        cut = draw(st.integers(1, len(left[name])))
        publish(engine, name, left[name][:cut])
        del left[name][:cut]
    if step < late:
        engine.queries.register(text, since=Since.START)
    return result(engine)
