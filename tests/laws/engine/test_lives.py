"""Networks that follow a set of objects against their definition, whatever is published first
([DyKnow10 Def. 4.6, 4.7], docs/reference/kpl.md)."""

import joint_definition
from hypothesis import given, settings
from hypothesis import strategies as st
from mediation_definition import held, lives, merged, within
from playing import play, play_in_order

from dyknow.converters.wire import Incoming
from dyknow.engine.kpl.verification import rehearse
from dyknow.engine.processes.registry import Processes
from dyknow.languages.kpl import check_kpl, parse_kpl
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
    sums = {}
    every, chosen = [], []
    for time, label, value in moves:
        if label not in held(sets, time):
            continue
        key = (label, next(life for life in lives(label, sets) if within(life, [time])))
        sums[key] = sums.get(key, 0.0) + value
        every.append((time, label, sums[key]))
        # Valid times differ, so every sample is a change.
        if held(sets, time)[-1] == label:
            chosen.append((time, sums[key]))
    return every, chosen


@st.composite
def worlds(draw):
    times = sorted(draw(st.sets(TIMES, max_size=5)))
    sets = [(t, draw(st.lists(st.sampled_from(OBJECTS), unique=True))) for t in times]
    times = sorted(draw(st.sets(TIMES, max_size=8)))
    moves = [(t, draw(st.sampled_from(OBJECTS)), float(draw(st.integers(1, 9)))) for t in times]
    return sets, moves


@LIMITS
@given(st.data(), worlds())
def test_streams_of_objects_depend_on_times_alone(data, world):
    sets, moves = world
    rows = {
        "sets": [(t, t, {"value": " ".join(labels)}) for t, labels in sets],
        "moves": [(t, t, {"id": label, "pos": value}) for t, label, value in moves],
    }
    engine = play(data.draw, PROCESSES, SOURCES, NETWORK, rows)
    every, chosen = definition(sets, moves)
    made = engine.generator("all").stream.all().rows()
    assert [(t, values["object"], values["value"]) for t, _, values in made] == every
    made = engine.generator("last").stream.all().rows()
    assert [(t, values["value"]) for t, _, values in made] == chosen


# -- two sets, and a source for each object --------------------------------------------------------

TWO_SETS = """
compunit float Count(float)
source float from_a
source float from_b
source object sets
source object others
strmgen of[a] = from_a
strmgen of[b] = from_b
strmgen objects = sets
strmgen chosen = others
"""
FOLLOWING = """
foreach x in objects { strmgen n[x] = Count(of[x]) }
strmgen own = aggregate(n[x] foreach x in objects)
strmgen other = aggregate(n[x] foreach x in chosen)
strmgen values = aggregate(of[x] foreach x in chosen)
strmgen focus = select(n[x] foreach x in chosen)
"""


@PROCESSES.computational_unit("float", ["float"])
def Count(time, samples, state):
    return float((state or 0) + 1), (state or 0) + 1


def counted(label, times, *sets):
    """[(available, object, count)]: counted anew in each life, in which it is in all ``sets``."""
    given, count, previous = [], 0, None
    left = [at for each in sets for at, labels in each if label not in labels]
    for time in times:
        if any(label not in held(each, time) for each in sets):
            continue
        if previous is None or any(previous < at <= time for at in left):
            count = 0
        count, previous = count + 1, time
        given.append((time, label, float(count)))
    return given


@st.composite
def set_streams(draw):
    times = sorted(draw(st.sets(TIMES, max_size=5)))
    # "c" has no stream.
    return [(t, draw(st.lists(st.sampled_from("abc"), unique=True))) for t in times]


def check(expected, samples_of):
    for name, samples in expected.items():
        made = samples_of(name).rows()
        assert [(t, v, x.get("object"), x["value"]) for t, v, x in made] == samples, name


def rehearsed(text, rows):
    """What ``dyknow kpl run`` has of each stream."""
    _, signature = check_kpl(parse_kpl(text), text)
    fields = {one.name: one.sort.schema for one in signature.declarations if one.key in rows}
    samples = [
        (name, Incoming(batch_from_rows(fields[name], said), False))
        for name, said in rows.items()
        if said
    ]
    rehearsal = rehearse(signature, PROCESSES, samples)
    assert rehearsal.failures == []
    return rehearsal.application.samples_of


def of_sources(sets, others, a, b):
    """What each source says, and when each object says something."""
    times = {"a": sorted(a), "b": sorted(b)}
    return {
        "sets": [(t, t, {"value": " ".join(labels)}) for t, labels in sets],
        "others": [(t, t, {"value": " ".join(labels)}) for t, labels in others],
        **{f"from_{o}": [(t, t, {"value": float(t)}) for t in times[o]] for o in times},
    }, times


WORLDS = (set_streams(), set_streams(), st.sets(TIMES), st.sets(TIMES))


@LIMITS
@given(st.data(), *WORLDS)
def test_what_one_set_makes_another_may_follow(data, sets, others, a, b):
    rows, times = of_sources(sets, others, a, b)
    engine = play(data.draw, PROCESSES, TWO_SETS, FOLLOWING, rows)
    counts = [row for label in times for row in counted(label, times[label], sets)]
    said = [(t, label, float(t)) for label in times for t in times[label]]
    focus = [row for row in counts if held(others, row[0])[-1:] == [row[1]]]
    expected = {
        "own": merged(counts),
        "other": merged([row for row in counts if row[1] in held(others, row[0])]),
        "values": merged([row for row in said if row[1] in held(others, row[0])]),
        "focus": [(t, t, None, count) for t, _, count in sorted(focus)],
    }
    check(expected, lambda name: engine.generator(name).stream.all())
    check(expected, rehearsed(TWO_SETS + FOLLOWING, rows))


LIVES_IN_LIVES = """
foreach x in objects { strmgen n[x] = Count(of[x]) }
foreach x in objects { strmgen same[x] = Count(n[x]) }
foreach x in chosen { strmgen both[x] = Count(n[x]) }
strmgen all_same = aggregate(same[x] foreach x in objects)
strmgen all_both = aggregate(both[x] foreach x in chosen)
strmgen too = aggregate(both[x] foreach x in objects)
"""


@LIMITS
@given(st.data(), *WORLDS)
def test_a_life_ends_with_the_one_that_it_reads(data, sets, others, a, b):
    """In order of time: see docs/reference/kpl.md."""
    rows, times = of_sources(sets, others, a, b)
    engine = play_in_order(data.draw, PROCESSES, TWO_SETS, LIVES_IN_LIVES, rows)
    one = [row for label in times for row in counted(label, times[label], sets)]
    both = [row for label in times for row in counted(label, times[label], sets, others)]
    expected = {"all_same": merged(one), "all_both": merged(both), "too": merged(both)}
    check(expected, lambda name: engine.generator(name).stream.all())
    check(expected, rehearsed(TWO_SETS + LIVES_IN_LIVES, rows))


@LIMITS
@given(st.data(), *WORLDS)
def test_at_the_end_of_all_sources_every_mediation_ends(data, sets, others, a, b):
    rows, _ = of_sources(sets, others, a, b)
    engine = play(data.draw, PROCESSES, TWO_SETS, LIVES_IN_LIVES, rows)
    for name in ("all_same", "all_both", "too"):
        assert engine.generator(name).is_ended, name


WITH_ANOTHER = """unit ns
strmgen w = wind
foreach x in objects {
  strmgen n[x] = Count(of[x])
  strmgen both[x] = join(n[x], w)
  strmgen state[x] = sync(of[x], w with monotone order; any change, max delay 2, use most recent)
}
strmgen counts = aggregate(n[x] foreach x in objects)
strmgen tuples = aggregate(both[x] foreach x in objects)
strmgen states = aggregate(state[x] foreach x in objects)
"""


@LIMITS
@given(st.data(), set_streams(), *[st.sets(TIMES)] * 3)
def test_what_is_made_for_an_object_has_its_life_by_itself(data, sets, a, b, wind):
    """Together with a stream of all objects, which may come first or last or never."""
    rows, times = of_sources(sets, [], a, b)
    blown = sorted(wind)
    rows["wind"] = [(t, t, {"value": float(t)}) for t in blown]
    engine = play(data.draw, PROCESSES, TWO_SETS + "source float wind", WITH_ANOTHER, rows)
    counts, tuples, states = [], [], []
    for label, own in times.items():
        for life in lives(label, sets):
            inputs = [[(t, t) for t in within(life, each)] for each in (own, blown)]
            counts += [(t, label, (float(n),)) for n, (t, _) in enumerate(inputs[0], 1)]
            for t, _, (n, k) in joint_definition.join(inputs):
                values = (None if n is None else n + 1.0, None if k is None else inputs[1][k][0])
                tuples.append((t, label, values))
            ends = [each[-1] if each else -(2**63) - 1 for each in (own, blown)]
            promised = ends if life[1] is None else [min(life[1] - 1, end) for end in ends]
            made, _, _ = joint_definition.synchronize(
                inputs, promised, [False, True], None, 2, None, None, False
            )
            for t, _, chosen in made:
                if within(life, [t]):
                    picked = [None if k is None else inputs[i][k][0] for i, k in enumerate(chosen)]
                    states.append((t, label, tuple(picked)))
    for name, expected in (("counts", counts), ("tuples", tuples), ("states", states)):
        made = engine.generator(name).stream.all().rows()
        turns = [(t, label, *values) for t, _, label, values in merged(expected)]
        assert [(t, *values.values()) for t, _, values in made] == turns, name
