"""Networks that follow a set of objects against their definition, whatever is published first
([DyKnow10 Def. 4.6, 4.7], docs/kpl.md)."""

from hypothesis import given, settings
from hypothesis import strategies as st

from dyknow.converters.wire import Incoming
from dyknow.engine.engine import Engine
from dyknow.engine.processes import Processes
from dyknow.streams.sample import batch_from_rows

LIMITS = settings(deadline=None, max_examples=60)
OBJECTS = ("a", "b")
TIMES = st.integers(0, 12)
SOURCES = """
sort fix = (id string, pos float)
source fix moves
source object sets
compunit float Sum(fix)
strmgen positions = moves
strmgen objects = sets
"""
NETWORK = """
foreach x in objects {
  strmgen pos[x] = selectObject(positions)
  strmgen sum[x] = Sum(pos[x])
}
strmgen all = aggregate(sum[x] foreach x in objects)
strmgen last = select(sum[x] with any change foreach x in objects)
"""

PROCESSES = Processes()


@PROCESSES.computational_unit("float", ["fix"])
def Sum(time, samples, state):
    total = (state or 0.0) + samples[0]["pos"]
    return total, total


def definition(sets, moves):
    """The samples of ``all`` and ``last``: (available, object, sum), and (available, sum)."""

    def held(time):
        found = [labels for at, labels in sets if at <= time]
        return found[-1] if found else ()

    def life(label, time):
        """When the life of an object began in which ``time`` is."""
        begun = None
        for at, labels in sets:
            if at <= time:
                begun = (at if begun is None else begun) if label in labels else None
        return begun

    sums = {}
    every, chosen = [], []
    for time, label, value in moves:
        if label not in held(time):
            continue
        key = (label, life(label, time))
        sums[key] = sums.get(key, 0.0) + value
        every.append((time, label, sums[key]))
        # Valid times differ, so every sample is a change.
        if held(time)[-1] == label:
            chosen.append((time, sums[key]))
    return every, chosen


@st.composite
def worlds(draw):
    times = sorted(draw(st.sets(TIMES, max_size=5)))
    sets = [(t, draw(st.lists(st.sampled_from(OBJECTS), unique=True))) for t in times]
    times = sorted(draw(st.sets(TIMES, max_size=8)))
    moves = [(t, draw(st.sampled_from(OBJECTS)), float(draw(st.integers(1, 9)))) for t in times]
    return sets, moves


def play(draw, sets, moves):
    """The world told in some order and some cuts, the network declared at some moment."""
    engine = Engine(processes=PROCESSES)
    engine.add_kpl(SOURCES)
    rows = {
        "sets": [(t, {"value": " ".join(labels)}) for t, labels in sets],
        "moves": [(t, {"id": label, "pos": value}) for t, label, value in moves],
    }
    steps = ["network"]
    while rows["sets"] or rows["moves"] or steps:
        left = [name for name in ("sets", "moves") if rows[name]] + steps
        name = draw(st.sampled_from(left))
        if name == "network":
            engine.add_kpl(NETWORK)
            steps = []
            continue
        cut = draw(st.integers(1, len(rows[name])))
        generator = engine.generator(name)
        some = [(t, t, values) for t, values in rows[name][:cut]]
        batch = batch_from_rows(generator.schema, some, generator.stream.pools)
        engine.publish(name, Incoming(batch, stamped=False), 0)
        rows[name] = rows[name][cut:]
    for name in draw(st.permutations(["sets", "moves"])):
        engine.end(name)
    assert [view for view in engine.kpl() if view.failure] == []
    return engine


@LIMITS
@given(st.data(), worlds())
def test_streams_of_objects_depend_on_times_alone(data, world):
    sets, moves = world
    engine = play(data.draw, sets, moves)
    every, chosen = definition(sets, moves)
    made = engine.generator("all").stream.all().rows()
    assert [(t, values["object"], values["value"]) for t, _, values in made] == every
    made = engine.generator("last").stream.all().rows()
    assert [(t, values["value"]) for t, _, values in made] == chosen
