"""Several streams made one, object by object, through real stream generators."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from keyed_join_definition import keyed_join
from process_running import OPEN, content, stream
from process_running import offer as offer_open
from synchronizing import SAME, broken, taken, unit

from dyknow.converters.objects import ObjectTable
from dyknow.engine.model.views import Since
from dyknow.engine.units.synchronization import SynchronizationUnit, schema_of
from dyknow.ontology.units import Conversion
from dyknow.rdf.dictionary import TermDictionary
from dyknow.rdf.namespaces import DYKNOW
from dyknow.streams.generator import StreamGenerator
from dyknow.streams.sample import FieldType, SampleError, batch_from_rows

ELSEWHERE = "https://example.org/"


def offer(source, *rows):
    """Samples after which the next instant begins."""
    offer_open(source, *rows)
    if not source.lateness:
        source.advance(rows[-1][0] + 1)


def altitude_and_speed(altitude=None):
    altitude = altitude or stream("altitude", uav="string", alt="float")
    speed = stream("speed", pilot="string", kmh="float")
    made = unit(
        [altitude, speed],
        [taken("alt"), taken(("kmh", "v", Conversion(1 / 3.6)))],
        [("uav",), ("pilot",)],
        (("uav", "object"),),
    )
    return altitude, speed, made


def test_tuples_of_the_same_object():
    """Each time one of the two comes, with the latest of the other, of the same object."""
    altitude, speed, made = altitude_and_speed()
    assert made.output.schema.names == ("object", "alt", "v")
    offer(altitude, (1, 1, "uav1", 100.0), (2, 1, "uav2", 200.0), (5, 5, "uav1", 110.0))
    offer(speed, (3, 4, "dyknow:uav1", 36.0), (4, 2, "uav3", 3.6), (6, 3, "uav2", 72.0))
    assert content(made.output) == [(3, 4, "uav1", 100.0, 10.0), (5, 5, "uav1", 110.0, 10.0)]
    altitude.advance(7)
    assert content(made.output)[2:] == [(6, 3, "uav2", 200.0, 20.0)]
    assert made.output.watermark == 7
    assert made.retained == 5


def test_the_same_object_and_another_at_one_time():
    altitude, speed, made = altitude_and_speed()
    offer(altitude, (1, 1, "a", 1.0), (2, 2, "b", 2.0), (5, 5, "a", 3.0), (6, 6, "b", 4.0))
    offer(speed, (3, 3, "a", 36.0), (4, 4, "b", 36.0), (5, 9, "b", 72.0), (6, 0, "b", 108.0))
    assert content(made.output)[2:] == [
        (5, 5, "a", 3.0, 10.0),
        (5, 9, "b", 2.0, 20.0),  # both at 5: by the order of inputs
        (6, 6, "b", 4.0, 30.0),  # both inputs at 6 have a sample of b
    ]
    assert made.output.watermark == 7


def test_the_samples_of_an_instant_make_a_tuple_of_each_object():
    altitude, speed, made = altitude_and_speed()
    offer(altitude, (1, 1, "a", 1.0), (1, 1, "b", 2.0), (1, 1, "a", 3.0))
    offer_open(speed, (1, 1, "b", 36.0))
    offer_open(speed, (1, 1, "a", 72.0), (1, 1, "c", 36.0))
    assert content(made.output) == []  # more may come
    speed.advance(2)
    assert content(made.output) == [(1, 1, "a", 3.0, 20.0), (1, 1, "b", 2.0, 10.0)]


@pytest.mark.parametrize(
    "second", [{"kind": "integer", "ids": (7, 8)}, {"kind": "string", "ids": ("7", "dyknow:8")}]
)
def test_ids_of_other_types_and_spellings_are_the_same_object(second):
    first = stream("first", id="string", x="float")
    other = stream("other", key=second["kind"], y="float")
    made = unit([first, other], [taken("x"), taken("y")], [("id",), ("key",)], (("id", "id"),))
    offer(first, (1, 1, "7", 1.0), (2, 2, f"{DYKNOW}8", 2.0))
    offer(other, (3, 3, second["ids"][0], 30.0), (4, 4, second["ids"][1], 40.0))
    first.end()
    assert content(made.output) == [(3, 3, "7", 1.0, 30.0), (4, 4, f"{DYKNOW}8", 2.0, 40.0)]


def test_equal_names_in_other_namespaces_are_other_objects():
    first, other = stream("first", id="string", x="float"), stream("other", id="string", y="float")
    made = unit(
        [first, other],
        [taken("x"), taken("y")],
        [("id",), ("id",)],
        (("id", "id"),),
        namespaces={"other": ELSEWHERE},
    )
    offer(first, (1, 1, "a", 1.0), (2, 2, f"{ELSEWHERE}b", 2.0))
    offer(other, (3, 3, "a", 30.0), (4, 4, "b", 40.0))
    first.end()
    assert content(made.output) == [(4, 4, f"{ELSEWHERE}b", 2.0, 40.0)]


@pytest.mark.parametrize("arity", [2, 3])
def test_features_of_several_objects(arity):
    """The objects of a tuple are the same in the same roles; each has its own field and pool."""
    roles = ("from", "to", "by")[:arity]
    first = stream("first", **dict.fromkeys(roles, "string"), x="float")
    other = stream("other", **dict.fromkeys(reversed(roles), "string"), y="float")
    made = unit(
        [first, other],
        [taken("x"), taken("y")],
        [roles, roles],
        tuple((role, f"the_{role}") for role in roles),
    )
    rest = ("c",) * (arity - 2)
    offer(first, (1, 1, "a", "b", *rest, 1.0), (2, 2, "b", "a", *rest, 2.0))
    offer(other, (3, 3, *rest, "a", "b", 30.0), (4, 4, *rest, "a", "a", 40.0))
    offer(other, (5, 5, *reversed(rest), "b", "a", 50.0), (6, 6, *rest, "b", None, 60.0))
    first.end()
    assert content(made.output) == [
        (3, 3, "b", "a", *rest, 2.0, 30.0),
        (5, 5, "a", "b", *rest, 1.0, 50.0),
    ]
    assert made.keyless == 1


def test_a_constant_input_is_context():
    """A sample of the wind alone makes no tuple; the latest one stands for all objects."""
    wind = stream("wind", knots="integer")
    speed = stream("speed", id="string", v="float")
    made = unit(
        [wind, speed],
        [taken(("knots", "wind", Conversion(0.5))), taken("v")],
        [(), ("id",)],
        (("id", "id"),),
    )
    assert made.output.schema.names == ("id", "wind", "v")
    assert made.output.schema.get("wind").type is FieldType.FLOAT
    offer(speed, (1, 1, "a", 10.0), (3, 3, "b", 30.0), (5, 5, "a", 50.0))
    offer(wind, (2, 2, 4), (4, 9, 6))
    assert content(made.output) == [(3, 3, "b", 2.0, 30.0)]
    wind.end()
    assert content(made.output)[1:] == [(5, 9, "a", 3.0, 50.0)]


def test_without_objects_it_is_join_once_all_are_there():
    a, b = stream("a", x="float"), stream("b", y="float")
    made = unit([a, b], [taken("x"), taken("y")], [(), ()])
    offer(a, (1, 1, 1.0), (3, 3, 3.0))
    offer(b, (2, 2, 20.0), (4, 1, 40.0))
    a.end()
    assert content(made.output) == [(2, 2, 1.0, 20.0), (3, 3, 3.0, 20.0), (4, 3, 3.0, 40.0)]


def test_what_lacks_a_value_is_no_sample():
    altitude, speed, made = altitude_and_speed()
    offer(altitude, (1, 1, "a", 1.0), (2, 2, "a", None), (4, 4, None, 4.0), (5, 5, None, None))
    offer(speed, (3, 3, "a", 36.0), (6, 6, "a", None))
    assert content(made.output) == [(3, 3, "a", 1.0, 10.0)]
    altitude.end()
    speed.end()
    assert content(made.output) == [(3, 3, "a", 1.0, 10.0)]
    assert (made.incomplete, made.keyless) == (3, 1)


def test_what_was_left_out_has_been_there():
    """Nobody waits for a sample that lacks its value."""
    altitude, speed, made = altitude_and_speed()
    offer(altitude, (1, 1, "a", 1.0))
    offer(speed, (3, 3, "a", 36.0))
    offer(altitude, (3, 3, "a", None))
    assert content(made.output) == [(3, 3, "a", 1.0, 10.0)]


def test_a_value_beyond_floats_is_no_value():
    speed = stream("speed", id="string", v="float")
    made = unit(
        [speed, speed],
        [taken(("v", "big", Conversion(1e300))), taken("v")],
        [("id",), ("id",)],
        (("id", "id"),),
    )
    offer(speed, (1, 1, "a", 1.0), (2, 2, "a", 1e300))
    assert content(made.output) == [(1, 1, "a", 1e300, 1.0), (2, 2, "a", 1e300, 1e300)]
    assert made.incomplete == 1


def test_text_and_truth_stay_as_they_are():
    state = stream("state", id="string", mode="string", on="boolean")
    speed = stream("speed", id="string", v="integer")
    made = unit(
        [speed, state],
        [taken("v"), taken(("mode", "how", SAME), "on")],
        [("id",), ("id",)],
        (("id", "who"),),
    )
    assert made.output.stream.pools["how"] is state.stream.pools["mode"]
    assert made.output.stream.pools["who"] is speed.stream.pools["id"]
    offer(state, (1, 1, "b", "hover", True), (2, 2, "a", "land", False))
    offer(speed, (3, 3, "a", 3), (4, 4, "c", 4), (5, 5, "b", 5))
    state.end()
    assert content(made.output) == [
        (3, 3, "a", 3.0, "land", False),
        (5, 5, "b", 5.0, "hover", True),
    ]
    assert [type(v) for v in content(made.output)[0][2:]] == [str, float, str, bool]


def test_the_same_stream_twice():
    """Once as a stream about those who see, once about those who are seen."""
    seen = stream("seen", by="string", who="string", d="float")
    made = unit(
        [seen, seen],
        [taken(("d", "sees", SAME)), taken(("d", "is_seen", SAME))],
        [("by",), ("who",)],
        (("by", "id"),),
    )
    assert seen.subscribers == 1
    offer(seen, (1, 1, "a", "b", 1.0), (2, 2, "b", "a", 2.0), (9, 9, "a", "a", 9.0))
    # At 2 there is one of b by its first input, of a by its second.
    assert content(made.output) == [
        (2, 2, "b", 2.0, 1.0),
        (2, 2, "a", 1.0, 2.0),
        (9, 9, "a", 9.0, 9.0),
    ]
    seen.end()
    assert made.output.is_ended


def test_late_samples_are_counted_and_left_out():
    """An input that had ended goes on with what the others did not wait for."""
    altitude, speed, made = altitude_and_speed()
    offer(altitude, (1, 1, "a", 1.0))
    altitude.end()
    offer(speed, (4, 4, "a", 36.0))
    assert content(made.output) == [(4, 4, "a", 1.0, 10.0)]
    offer(altitude, (3, 3, "a", 3.0), (4, 4, "a", None), (5, 5, "a", 5.0))
    speed.advance(6)
    assert content(made.output)[1:] == [(5, 5, "a", 5.0, 10.0)]
    assert (made.late, made.incomplete) == (2, 0)


def test_it_goes_on_after_the_end():
    altitude, speed, made = altitude_and_speed()
    offer(altitude, (1, 1, "a", 1.0))
    offer(speed, (2, 2, "a", 36.0))
    altitude.end()
    speed.end()
    assert made.output.is_ended
    assert made.output.watermark == 3
    offer(speed, (7, 7, "a", 72.0))
    assert not made.output.is_ended
    assert content(made.output) == [(2, 2, "a", 1.0, 10.0), (7, 7, "a", 1.0, 20.0)]
    offer(altitude, (8, 8, "a", 8.0))
    assert len(content(made.output)) == 2  # speed is waited for again
    speed.end()
    altitude.end()
    assert content(made.output)[2:] == [(8, 8, "a", 8.0, 20.0)]
    assert made.output.is_ended
    assert made.late == 0


def test_an_input_that_goes_on_is_waited_for():
    """Its sample has not left its generator yet, as an earlier one may come."""
    altitude = stream("altitude", lateness=5, uav="string", alt="float")
    altitude, speed, made = altitude_and_speed(altitude)
    offer(altitude, (1, 1, "a", 1.0))
    altitude.end()
    offer(speed, (2, 2, "a", 36.0))
    assert made.output.watermark == 3
    offer(altitude, (6, 6, "a", 6.0))
    offer(speed, (7, 7, "a", 72.0))
    assert len(content(made.output)) == 1
    altitude.end()
    assert content(made.output)[1:] == [(6, 6, "a", 6.0, 10.0), (7, 7, "a", 6.0, 20.0)]
    assert made.output.watermark == 8
    assert made.late == 0


def test_it_begins_with_the_past_and_ends_where_its_life_ends():
    altitude = stream("altitude", uav="string", alt="float")
    speed = stream("speed", pilot="string", kmh="float")
    offer_open(altitude, (1, 1, "a", 1.0), (5, 5, "a", 5.0))
    offer_open(speed, (2, 2, "a", 2.0), (6, 6, "a", 6.0))
    made = unit(
        [altitude, speed],
        [taken("alt"), taken("kmh")],
        [("uav",), ("pilot",)],
        since=Since.START,
        until=5,
    )
    assert content(made.output) == [(2, 2, 1.0, 2.0)]
    assert not made.output.is_ended
    offer(altitude, (7, 7, "a", 7.0))
    assert content(made.output) == [(2, 2, 1.0, 2.0), (5, 5, 5.0, 2.0)]
    assert made.output.is_ended


def test_an_open_output_gets_the_fields():
    source = stream("source", id="string", x="float")
    made = SynchronizationUnit(
        "cu1", "synchronize", [source], StreamGenerator("out", OPEN), {}, broken,
        ports=[taken("x")], keys=[("id",)], id_fields=(("id", "who"),),
        objects=lambda _: ObjectTable(TermDictionary(), DYKNOW),
    )  # fmt: skip
    assert made.output.schema.names == ("who", "x")
    assert made.output.stream.pools["who"] is source.stream.pools["id"]


SOURCES = {"id": "string", "other": "integer", "x": "float", "on": "boolean"}


@pytest.mark.parametrize(
    ("ports", "keys", "ids", "why"),
    [
        ([["x"]], [("id",), ("id",)], (), "2 inputs, 1 lists of fields"),
        ([["x"], []], [("id",), ("id", "other")], (), "the same number of id fields"),
        ([["y"], []], [("id",), ("id",)], (), "no field 'y' of stream 's'"),
        ([["x"], []], [("id",), ("on",)], (), "is not a string or integer"),
        ([["x"], []], [("id",), ("id",)], (("other", "o"),), "'other' is not an id field"),
        ([["x"], []], [(), ()], (("id", "o"),), "'id' is not an id field"),
        ([[("on", "on", Conversion(2.0))], []], [(), ()], (), "which has no unit"),
        ([["x"], ["x"]], [(), ()], (), "x is there twice"),
        ([["x"], []], [("id",), ()], (("id", "x"),), "x is there twice"),
    ],
)
def test_it_refuses_what_does_not_fit_together(ports, keys, ids, why):
    source = stream("s", **SOURCES)
    with pytest.raises(ValueError, match=why):
        schema_of([source, source], [taken(*own) for own in ports], keys, ids)


def test_it_refuses_an_output_of_other_fields():
    source = stream("s", **SOURCES)
    with pytest.raises(SampleError, match="has the fields y: float"):
        SynchronizationUnit(
            "cu1", "synchronize", [source], stream("out", y="float"), {}, broken,
            ports=[taken("x")], keys=[("id",)], id_fields=(), objects=None,
        )  # fmt: skip


# -- against the definition --------------------------------------------------------------------

ROWS = st.lists(
    st.tuples(
        st.integers(0, 3),  # after the one before
        st.sampled_from(["a", "dyknow:a", "b", None]),
        st.sampled_from([None, 1.0, 2.0, 3.0]),
    ),
    max_size=8,
)


@settings(deadline=None, max_examples=150)
@given(st.data())
def test_it_is_the_definition_however_it_is_published(data):
    """Two keyed inputs and a constant one; samples out of order within the lateness."""
    sources = [stream(f"s{i}", lateness=3, id="string", x="float") for i in range(3)]
    keys = [("id",), ("id",), ()]
    ports = [taken(("x", f"x{i}", Conversion(10.0**i))) for i in range(3)]
    made = unit(sources, ports, keys, (("id", "id"),))
    worlds, queues = [], []
    for _ in sources:
        time, rows = 0, []
        for step, id, x in data.draw(ROWS):
            time += step
            rows.append((time, data.draw(st.integers(0, 9)), id, x))
        rows = list(dict.fromkeys(rows))  # others are duplicates
        worlds.append(rows)
        cut = data.draw(st.integers(0, len(rows)))
        queues.append([rows[:cut], rows[cut:], None])
    while any(queues):
        i = data.draw(st.sampled_from([k for k, queue in enumerate(queues) if queue]))
        rows = queues[i].pop(0)
        if rows is None:
            sources[i].end()
        else:
            sources[i].offer(
                batch_from_rows(
                    sources[i].schema,
                    [(a, v, {"id": id, "x": x}) for a, v, id, x in rows],
                    sources[i].stream.pools,
                )
            )
    spelled = {"dyknow:a": "a", "a": "a", "b": "b", None: None}
    whole = [[row for row in rows if row[3] is not None] for rows in worlds]
    keyed = [bool(own) for own in keys]
    streams = [
        [(a, v, spelled[id] if each else None) for a, v, id, _ in rows]
        for rows, each in zip(whole, keyed, strict=True)
    ]
    expected = [
        (t, v, whole[0][k[0]][2], *(whole[i][k[i]][3] * 10.0**i for i in range(3)))
        for t, v, k in keyed_join(streams, keyed)
    ]
    assert content(made.output) == expected
    assert made.output.is_ended
    assert made.output.counters.late == 0
    assert made.incomplete == sum(map(len, worlds)) - sum(map(len, whole))
    assert made.keyless == sum(row[2] is None for rows in whole[:2] for row in rows)
