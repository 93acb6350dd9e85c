"""The streams that SASE+ patterns read: of sorts, and those that FROM names."""

import pytest
from feeding import feed, samples

import dyknow
from dyknow.engine.model.errors import BadArguments, NoPlan
from dyknow.languages.errors import LanguageError


@pytest.fixture
def flying(engine):
    engine.annotate("stream speeds contains speed(UAV) = spd [km.h-1] for every UAV = id")
    engine.annotate("stream heights contains altitude(UAV) = alt [m] for every UAV = id")
    return engine


def ask(engine, text):
    return engine.request_event(engine.parse_request(text))


def told(engine, stream):
    return [(int(valid), values["x"]) for valid, values in samples(engine, stream)]


TWICE = "PATTERN SEQ({} a, {} b) WHERE [id] WITHIN 1s RETURN a.id AS x"


def test_a_sort_as_a_type(flying):
    """Each sample of a stream that tells of a UAV is an event once, also one without a value. What
    patterns and queries make of them is none."""
    flying.annotate("stream both contains speed(RMAX) = spd [km.h-1], altitude(RMAX) = alt [m] "
                    "for every RMAX = id")  # fmt: skip
    flying.annotate("stream cars contains speed(Car) = spd [km.h-1] for every Car = id")
    flying.register_template("REGISTER TEMPLATE Fast(?o in UAV) AS speed(?o) > 100")
    ask(flying, "Fast(?o)")
    flying.queries.register("REGISTER STREAM s AS " + TWICE.format("UAV", "UAV"))
    assert flying.queries.view("s").reads == ("speeds", "heights", "both")
    feed(flying, "both", [(1, {"id": "r1", "spd": 50.0, "alt": None}),
                          (2, {"id": "r1", "spd": None, "alt": 50.0}),
                          (3, {"id": None, "spd": 50.0, "alt": 50.0})])  # fmt: skip
    feed(flying, "cars", [(t, {"id": "car1", "spd": 50.0}) for t in range(1, 4)])
    feed(flying, "speeds", [(1, {"id": "uav1", "spd": 50.0})])
    feed(flying, "heights", [(2, {"id": "uav1", "alt": 50.0})])
    for name in ("speeds", "heights", "both"):
        flying.end(name)
    assert sorted(told(flying, "s")) == [(2, "r1"), (2, "uav1")]


def test_a_named_stream(flying):
    """FROM reads one stream only, for a feature as for a sort; an IRI may name it."""
    flying.annotate("stream more contains speed(UAV) = v [km.h-1], altitude(UAV) = h [m] "
                    "for every UAV = id")  # fmt: skip
    for name, text in {
        "s": "FROM more " + TWICE.format("speed", "altitude"),
        "t": "FROM dyknow:more " + TWICE.format("UAV", "UAV").replace("[id]", "[id] and a.v > 1"),
        "u": "FROM <http://www.ida.liu.se/dyknow/more.trdf> " + TWICE.format("RMAX", "RMAX"),
    }.items():
        flying.queries.register(f"REGISTER STREAM {name} AS {text}")
        assert flying.queries.view(name).reads == ("more",)
    feed(flying, "more", [(1, {"id": "uav1", "v": 5.0, "h": None}),
                          (2, {"id": "uav1", "v": None, "h": 6.0})])  # fmt: skip
    flying.end("more")
    assert told(flying, "s") == told(flying, "t") == [(2, "uav1")]
    assert told(flying, "u") == []


def test_a_template_of_a_named_stream(flying):
    """Other patterns read its events."""
    flying.register_template(
        "REGISTER TEMPLATE Again(?x) AS FROM heights "
        + TWICE.format("UAV", "UAV").replace("[id]", "[id = ?x]").replace(" RETURN a.id AS x", "")
        + " RETURN b.alt AS h"
    )
    flying.queries.register("chronicle c(?x) { event(Again[?x], t); }")
    mine = ask(flying, "Again(dyknow:uav1)")
    feed(flying, "heights", [(t, {"id": "uav1", "alt": 50.0}) for t in (1, 2)])
    flying.end("heights")
    assert told(flying, "c") == told(flying, mine.stream) == [(2, "uav1")]


def test_a_template_of_a_sort_names_its_stream(flying):
    body = TWICE.format("UAV", "UAV").replace("[id]", "[id = ?x]").replace(" RETURN a.id AS x", "")
    flying.register_template(f"REGISTER TEMPLATE Again(?x) AS {body}")
    with pytest.raises(NoPlan, match="`FROM NAME` names it"):
        flying.queries.register("chronicle c(?x in UAV) { event(Again[?x], t1); "
                                "event(Again[?x], t2); t2 - t1 in [1s, 2s]; }")  # fmt: skip


def test_streams_that_cannot_be_read(flying):
    with pytest.raises(NoPlan) as caught:
        flying.queries.register("FROM height " + TWICE.format("speed", "speed"))
    assert "there is no stream height with an annotation: did you mean heights?" in str(
        caught.value
    )
    with pytest.raises(NoPlan, match="stream speeds: only heights is read"):
        flying.queries.register("FROM heights " + TWICE.format("speed", "speed"))
    with pytest.raises(BadArguments, match="heights, which gives UAV, has no field 'spd'") as other:
        flying.queries.register(TWICE.format("UAV", "UAV").replace("[id]", "[id] and a.spd > 1"))
    assert "FROM NAME" in other.value.hint
    with pytest.raises(LanguageError, match="`UAV` is a sort, not a feature"):
        flying.queries.register("chronicle c(?x) { event(UAV[?x], t); }")


def test_a_sort_and_a_named_stream_of_recordings():
    ssl = """stream speeds contains speed(UAV) = spd [km.h-1] for every UAV = id
    stream heights contains altitude(UAV) = alt [ft] for every UAV = id"""
    rows = {
        "speeds": [{"valid": t, "id": "u", "spd": 1.0} for t in (1, 4)],
        "heights": [{"valid": t, "id": "u", "alt": 1.0} for t in (2, 3)],
    }
    text = "PATTERN SEQ(UAV a, UAV b) WHERE skip_till_next_match [id] WITHIN 9s"
    found = {
        start: [(r["start"], r["end"]) for r in dyknow.run(start + text, streams=rows, ssl=ssl)]
        for start in ("", "FROM heights ")
    }
    assert found == {"": [(1, 2), (2, 3), (3, 4)], "FROM heights ": [(2, 3)]}
