"""Late samples and idle streams: the engine equals its definition, however input is cut
(docs/explanation/semantics.md, "Late samples", "Idle streams")."""

from event_time_definition import Reader, Stream
from hypothesis import example, given, settings
from hypothesis import strategies as st

from dyknow.converters.wire import Incoming
from dyknow.engine.engine import Engine
from dyknow.engine.model.views import StreamDeclaration
from dyknow.streams.sample import Field, FieldType, batch_from_rows

NAMES = ("a", "b", "c")
FIELDS = (Field("id", FieldType.STRING), Field("v", FieldType.FLOAT))

declared = st.tuples(st.integers(0, 6), st.sampled_from([None, 1, 2, 3]))
times = st.lists(st.integers(0, 40), min_size=1, max_size=6)
steps = st.lists(
    st.one_of(
        st.tuples(st.sampled_from(NAMES), times, st.lists(st.integers(1, 3), max_size=4)),
        st.tuples(st.sampled_from(NAMES), times, st.lists(st.integers(1, 3), max_size=4)),
        st.integers(1, 4),
        st.sampled_from(NAMES),
    ),
    min_size=4,
    max_size=14,
)
worlds = st.tuples(
    st.lists(declared, min_size=2, max_size=3) | st.lists(declared, min_size=1, max_size=3),
    steps,
    st.integers(1, 9),
    st.integers(1, 6),
)


def query(names, range, step):
    clauses = "".join(
        f"FROM STREAM <http://www.ida.liu.se/dyknow/{name}.trdf> [RANGE {range}ns STEP {step}ns] "
        for name in names
    )
    return f"REGISTER QUERY q AS SELECT ?v {clauses}WHERE {{ ?o dyknow:speed ?v }}"


def play(engine, declarations, steps, *, cut):
    """Let the streams say what the steps say, to their end."""
    names, now, number = NAMES[: len(declarations)], 0, 0
    for each in steps:
        match each:
            case int():
                now += each
                engine.tick(now)
            case (name, times, cuts) if name in names:
                rows = [
                    (time, -time, {"id": "uav1", "v": float(number + i)})
                    for i, time in enumerate(times)
                ]
                number += len(rows)
                for part in parts(rows, cuts if cut else []):
                    generator = engine.generator(name)
                    batch = batch_from_rows(generator.schema, part, generator.stream.pools)
                    engine.publish(name, Incoming(batch, False), now)
            case str() if each in names:
                engine.end(each)
    for name in names:
        engine.end(name)


def declare(declarations):
    engine, names = Engine(epoch="law"), NAMES[: len(declarations)]
    for name, (lateness, idle) in zip(names, declarations, strict=True):
        engine.declare(StreamDeclaration(name, FIELDS, lateness, idle=idle))
        engine.stream(f"{name}_late")
    return engine, names


def run(declarations, steps, range, step, *, cut):
    """Windows and late samples, as the engine gives them."""
    engine, names = declare(declarations)
    for name in names:
        engine.annotate(f"stream {name} contains speed(UAV) = v [km.h-1] for every UAV = id")
    engine.queries.register(query(names, range, step))
    for name in names:
        engine.stream(f"q_late_{name}")
    play(engine, declarations, steps, cut=cut)
    windows = [
        (result.end, sorted(float(row["v"].value) for row in result.solutions.rows()))
        for result in engine.queries.results("q")
    ]
    late = {name: late_of(engine, f"{name}_late") for name in names}
    behind = {name: late_of(engine, f"q_late_{name}") for name in names}
    assert engine.queries.view("q").late == sum(map(len, behind.values()))
    for name in names:
        counters = engine.stream(name).counters
        assert counters.late == len(late[name])
        assert counters.accepted == counters.used + counters.late + counters.duplicate
    return windows, late, behind


def run_join(declarations, steps, *, cut):
    """When there are tuples, and what came too late for them."""
    engine, names = declare(declarations)
    sources = "".join(f"source s {name}\nstrmgen of_{name} = {name}\n" for name in names)
    joined = ", ".join(f"of_{name}" for name in names)
    engine.add_kpl(f"sort s = (id string, v float)\n{sources}strmgen j = join({joined})")
    for name in names:
        engine.stream(f"j_late_{name}")
    play(engine, declarations, steps, cut=cut)
    behind = {name: late_of(engine, f"j_late_{name}") for name in names}
    return engine.generator("j").stream.availtimes().tolist(), behind


def late_of(engine, name):
    rows = engine.generator(name).stream.all().rows()
    return [(available, values["v"]) for available, _, values in rows]


def parts(rows, cuts):
    rows = list(rows)
    for cut in cuts:
        if rows[:cut]:
            yield rows[:cut]
        rows = rows[cut:]
    if rows:
        yield rows


def defined(declarations, steps, range, step):
    reader, now, number = Reader(range, step), 0, 0
    streams = {
        name: Stream(lateness, idle, [reader])
        for name, (lateness, idle) in zip(NAMES, declarations, strict=False)
    }
    reader.streams = tuple(streams.values())
    for each in steps:
        match each:
            case int():
                now += each
                for stream in streams.values():
                    stream.tick(now)
                    reader.settle()
            case (name, times, _) if name in streams:
                for i, time in enumerate(times):
                    streams[name].offer([(time, float(number + i))], now)
                    reader.settle()
                number += len(times)
            case str() if each in streams:
                streams[each].end()
                reader.settle()
    for stream in streams.values():
        stream.end()
        reader.settle()
    late = {name: stream.late for name, stream in streams.items()}
    behind = {name: reader.late.get(stream, []) for name, stream in streams.items()}
    return reader, late, behind


@given(worlds)
@example(([(0, 2), (0, None)], [("b", [5], []), 2, ("b", [20], []), ("a", [3, 25], [1])], 5, 5))
@example(([(0, 1), (0, None)], [("b", [1], []), 1, "a", "b", ("a", [0], [])], 1, 1))
@settings(deadline=None, max_examples=60)
def test_windows_and_late_samples_equal_the_definition_however_input_is_cut(world) -> None:
    declarations, steps, range, step = world
    reader, late, behind = defined(declarations, steps, range, step)
    wanted = reader.results, late, behind
    assert run(declarations, steps, range, step, cut=False) == wanted
    assert run(declarations, steps, range, step, cut=True) == wanted


@given(worlds)
@example(([(0, 2), (0, None)], [("b", [5], []), 2, ("b", [20], []), ("a", [3, 25], [1])], 5, 5))
@settings(deadline=None, max_examples=40)
def test_joins_wait_for_no_idle_stream_either(world) -> None:
    declarations, steps, range, step = world
    if len(declarations) < 2:
        return
    steps = [each for each in steps if not isinstance(each, str)]  # ends are another law's
    reader, _, behind = defined(declarations, steps, range, step)
    wanted = sorted({available for available, _ in reader.elements}), behind
    assert run_join(declarations, steps, cut=False) == wanted
    assert run_join(declarations, steps, cut=True) == wanted
