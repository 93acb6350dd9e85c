"""Law: the events of a formula's template are the verdicts of the monitor with the arguments in
their places; of an object, where each object has its own states and a delay, those that name it."""

from hypothesis import given, settings
from hypothesis import strategies as st
from monitor_worlds import OBJECTS, WORLDS, begun, options, publish, told

BODIES = (
    "speed(?x) > ?limit",
    "always[0s, 3s] (speed(?x) > ?limit [km.h-1] -> eventually[0s, 2s] altitude(?x) > ?low [ft])",
    "speed(?x) * 2 > ?limit + speed(?x) since[0s, 4s] altitude(?x) < ?low",
    "not (altitude(?x) > ?low until[1s, oo] speed(?x) < ?limit [m.s-1])",
)
SHARED = (
    "forall ?y in UAV (speed(?y) < ?limit or eventually[0s, 1s] altitude(?x) < ?low [m])",
    "speed(?x) > speed(uav2) or previous speed(?x) > ?limit",
)


def rows_of(engine, stream):
    return list(engine.generator(stream).stream.all().rows())


@settings(deadline=None, max_examples=60)
@given(
    st.sampled_from(sorted(WORLDS)),
    st.sampled_from([*BODIES, *SHARED]),
    options(),
    st.sampled_from(OBJECTS),
    st.sampled_from([3.0, 18.0, 36.5]),
    st.sampled_from([3.5, 12.0]),
    told(),
    told(),
    st.data(),
)
def test_events_are_verdicts(world, body, how, name, limit, low, a, b, data):
    engine = begun(world, "", registers=False)
    used = [each for each in ("limit", "low") if f"?{each}" in body]
    slots = ", ".join(["?x in UAV", *(f"?{each}" for each in used)])
    engine.register_template(f"REGISTER TEMPLATE Odd({slots}) AS {body}{how}")
    values = {"limit": limit, "low": low}
    arguments = ", ".join(["?x", *(str(values[each]) for each in used)])
    written = body
    for each in used:
        written = written.replace(f"?{each}", str(values[each]))
    engine.queries.register(f"monitor m(?x in UAV) = {written}{how}")
    streams = [
        engine.request_event(engine.parse_request(f"Odd({each})")).stream
        for each in (arguments, arguments.replace("?x", f"dyknow:{name}"))
        if "dyknow:" not in each or has(engine, world, name, body)
    ]
    left = {"a": list(a), "b": list(b)}
    while left:
        stream = data.draw(st.sampled_from(sorted(left)))
        if not left[stream]:
            engine.end(stream)
            del left[stream]
            continue
        cut = data.draw(st.integers(1, len(left[stream])))
        publish(engine, stream, left[stream][:cut])
        del left[stream][:cut]
    expected = rows_of(engine, "m")
    assert rows_of(engine, streams[0]) == expected
    # Without a delay, samples of other objects show that later ones are valid later.
    has_own = body in BODIES and "sample every" not in how and "max delay" in how
    if has_own and len(streams) > 1:
        of_one = [row for row in expected if row[2]["x"] == name]
        assert rows_of(engine, streams[1]) == of_one


def has(engine, world, name, body):
    """Whether a stream has the altitude of the object."""
    return world != "one of an object" or name == "uav1" or "altitude" not in body
