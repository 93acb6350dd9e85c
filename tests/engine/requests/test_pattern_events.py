"""Patterns in the engine: over matched streams, as templates, read by others and reading them."""

import pytest
from feeding import feed, samples

from dyknow.engine.model.errors import BadArguments, NoPlan, NoResult
from dyknow.engine.model.views import StreamDeclaration
from dyknow.languages.errors import LanguageError
from dyknow.streams.sample import Field, FieldType
from dyknow.streams.time import SECOND

DESCENT = """REGISTER TEMPLATE Descent(?x, ?low) AS chronicle descent(?x) {
  event(speed[?x]:(?, > 100 [km.h-1]), t1);
  event(altitude[?x]:(>= ?low, < ?low), t2);
  t2 - t1 in [0s, 3s];
}"""


@pytest.fixture
def flying(engine):
    engine.annotate("stream speeds contains speed(UAV) = spd [km.h-1] for every UAV = id")
    engine.annotate("stream heights contains altitude(UAV) = alt [m] for every UAV = id")
    return engine


def fly(engine, end=True):
    """uav1 is fast at 3 s and low at 5 s; uav2 is fast at 2 s and low at 9 s."""
    speeds, heights = [], []
    for t in range(1, 12):
        for name, fast, low in (("uav1", 3, 5), ("uav2", 2, 9)):
            speeds.append((t, {"id": name, "spd": 120.0 if t == fast else 80.0}))
            heights.append((t, {"id": name, "alt": 50.0 if t >= low else 150.0}))
    feed(engine, "speeds", speeds)
    feed(engine, "heights", heights)
    if end:
        engine.end("speeds")
        engine.end("heights")


def ask(engine, text):
    return engine.request_event(engine.parse_request(text))


def told(engine, stream):
    return [(int(valid), values["x"]) for valid, values in samples(engine, stream)]


def test_a_registered_chronicle(flying):
    text = DESCENT.split(" AS ", 1)[1].replace("?low", "100 [m]")
    view = flying.queries.register(text)
    assert (view.name, view.kind, view.dialect) == ("descent", "PATTERN", "chronicle")
    assert view.fields[0].name == "x"
    fly(flying, end=False)
    assert samples(flying, "descent") == [
        (5, {"x": "uav1", "start": "1970-01-01T00:00:03Z", "end": "1970-01-01T00:00:05Z"})
    ]
    assert "evaluated by a join" in flying.queries.explain_running("descent")
    assert flying.queries.view("descent").failure is None


def test_units_are_converted(flying):
    flying.annotate("stream knots contains speed(Car) = kt [kt] for every Car = id")
    text = "chronicle fast(?x) { event(speed[?x]:(?, > 100 [km.h-1]), t); }"
    flying.queries.register(text)
    feed(flying, "knots", [(1, {"id": "car1", "kt": 53.0}), (2, {"id": "car1", "kt": 54.5})])
    feed(flying, "speeds", [(2, {"id": "uav1", "spd": 99.0}), (3, {"id": "uav1", "spd": 101.0})])
    for name in ("speeds", "knots"):
        flying.end(name)
    assert told(flying, "fast") == [(2, "car1"), (3, "uav1")]


def test_arguments_of_a_template(flying):
    flying.register_template(DESCENT)
    free, mine, other, lower = (
        ask(flying, f"Descent({arguments})")
        # In feet, the unit of altitude: 150 m are 492 ft, 50 m are 164 ft.
        for arguments in ("?x, 400", "dyknow:uav1, 400", "dyknow:uav2, 400", "?x, 100")
    )
    assert free.event.endswith("Descent")
    assert [unit.transformation for unit in free.plan.units] == ["pattern"]
    fly(flying)
    assert told(flying, free.stream) == told(flying, mine.stream) == [(5, "uav1")]
    assert told(flying, other.stream) == told(flying, lower.stream) == []


def test_wrong_arguments_are_refused(flying):
    flying.register_template(DESCENT)
    with pytest.raises(BadArguments, match="must be given"):
        ask(flying, "Descent(?x, ?low)")
    with pytest.raises(BadArguments, match="number"):
        ask(flying, "Descent(?x, dyknow:uav1)")


def test_patterns_build_on_events(flying):
    """A chronicle of two events: one of a formula, one of another chronicle."""
    flying.register_template(
        "REGISTER TEMPLATE Fast(?o in UAV) AS speed(?o) > 100 with report changes, max delay 0s"
    )
    flying.register_template(
        "REGISTER TEMPLATE Low(?x in UAV) AS chronicle low(?x) "
        "{ event(altitude[?x]:(>= 100 [m], < 100 [m]), t); }"
    )
    flying.queries.register(
        'chronicle both(?x in UAV) { event(Fast[?x]:(?, "true"), t1); event(Low[?x], t2); '
        "t2 - t1 in [0s, 3s]; }"
    )
    fly(flying)
    assert told(flying, "both") == [(5, "uav1")]


def test_others_build_on_patterns(flying):
    flying.register_template(
        "REGISTER TEMPLATE Low(?x in UAV) AS chronicle low(?x) "
        "{ event(altitude[?x]:(>= 100 [m], < 100 [m]), t); }"
    )
    flying.queries.register(
        """REGISTER STREAM lows COMPUTE EVERY 1s AS PREFIX dyknow: <http://www.ida.liu.se/dyknow/>
        CONSTRUCT { ?o dyknow:wasLow ?n } WHERE { ?o dyknow:Low ?v }
        AGGREGATE {(?n, COUNT, {?v})} WINDOW [RANGE 20s STEP 20s]"""
    )
    flying.queries.register(
        "chronicle lower(?x in UAV, ?y in UAV) { event(Low[?x], t1); event(Low[?y], t2); "
        "t2 - t1 in [1s, 9s]; }"
    )
    fly(flying)
    assert [values["id"] for _, values in samples(flying, "lows")] == ["uav1", "uav2"]
    ((valid, values),) = samples(flying, "lower")
    assert (int(valid), values["x"], values["y"]) == (9, "uav1", "uav2")


def test_sase(flying):
    flying.queries.register(
        "REGISTER STREAM restocked AS PATTERN SEQ(speed a, ~altitude b, speed c) "
        "WHERE skip_till_next_match [id] AND a.value > 100 AND b.value < 100 AND c.value < 100 "
        "WITHIN 20 seconds RETURN a.id AS x, c.value AS v"
    )
    view = flying.queries.view("restocked")
    assert (view.kind, view.dialect) == ("PATTERN", "SASE+")
    fly(flying)
    assert [(int(v), r["x"], r["v"]) for v, r in samples(flying, "restocked")] == [
        (3, "uav2", 80.0),
        (4, "uav1", 80.0),
    ]


def test_numbers_that_all_events_share(flying):
    """Also of two types, in one unit: 100 km/h are an integer here and a float there. A missing
    value equals none, and -0 equals 0."""
    flying.annotate("stream cars contains speed(Car) = kmh [km.h-1] for every Car = id")
    flying.queries.register(
        "REGISTER STREAM s AS PATTERN SEQ(speed a, speed b) WHERE partition_contiguity [value] "
        "WITHIN 9s RETURN a.id AS x, b.value AS v"
    )
    feed(flying, "speeds", [(t, {"id": "uav1", "spd": v}) for t, v in
                            ((1, 100.0), (2, -0.0), (4, None), (5, None), (6, 0.0))])  # fmt: skip
    feed(flying, "cars", [(t, {"id": "car1", "kmh": v}) for t, v in ((3, 100), (7, 3))])
    for name in ("speeds", "cars"):
        flying.end(name)
    assert [(int(t), r["x"], r["v"]) for t, r in samples(flying, "s")] == [
        (3, "uav1", 100.0),
        (6, "uav1", 0.0),
    ]


def test_one_name_for_fields_of_two_types(engine):
    for stream, feature, type in (("s1", "speed", "STRING"), ("s2", "altitude", "FLOAT")):
        fields = (Field("id", FieldType.STRING), Field("v", FieldType.FLOAT))
        engine.declare(StreamDeclaration(stream, (*fields, Field("tag", FieldType[type]))))
        engine.annotate(f"stream {stream} contains {feature}(UAV) = v for every UAV = id")
    engine.queries.register(
        "REGISTER STREAM s AS PATTERN SEQ(speed a, altitude b) WHERE [id] and a.tag = 'x' and "
        "b.tag > 3 WITHIN 5s RETURN a.id AS x"
    )
    feed(engine, "s1", [(1, {"id": "uav1", "v": 1.0, "tag": "x"})])
    feed(engine, "s2", [(2, {"id": "uav1", "v": 1.0, "tag": 4.0})])
    for name in ("s1", "s2"):
        engine.end(name)
    assert told(engine, "s") == [(2, "uav1")]


def test_a_duration_of_a_request(flying):
    """uav1 is fast at 3 s and low at 5 s."""
    flying.register_template(
        DESCENT.replace("?low) AS", "?low, ?time) AS").replace("3s]", "?time]")
    )
    streams = {
        time: ask(flying, f'Descent(?x, 400, "{time}"^^xsd:duration)').stream
        for time in ("PT1.9S", "PT2S", "PT7S")
    }
    fly(flying)
    found = {time: told(flying, stream) for time, stream in streams.items()}
    assert found == {"PT1.9S": [], "PT2S": [(5, "uav1")], "PT7S": [(5, "uav1"), (9, "uav2")]}


LIMITED = (
    "REGISTER STREAM s AS PATTERN SEQ(speed+ a[], altitude b) WHERE [id] WITHIN 1 minute "
    "RETURN count(a[]) AS n LIMIT 2"
)


def test_the_first_loss_is_reported(flying):
    """Of two speeds and a height there are three matches, and two are results."""
    flying.queries.register(LIMITED)
    feed(flying, "speeds", [(t, {"id": "uav1", "spd": 80.0}) for t in (1, 2)])
    feed(flying, "heights", [(t, {"id": "uav1", "alt": 50.0}) for t in (3, 4, 5)])
    for name in ("speeds", "heights"):
        flying.end(name)
    assert len(samples(flying, "s")) == 6
    unit = flying.queries.unit("s")
    reported = [v for _, v in samples(flying, "status") if v["change"] == "limit reached"]
    assert [(each["stream"], each["unit"], each["specification"]) for each in reported] == [
        ("s", unit.name, "left out: rows that complete more matches than the limit")
    ]
    assert unit.recognition.losses() == {"rows that complete more matches than the limit": 3}


def test_rounded_numbers_are_told(flying):
    """Of 70 speeds each subset but the empty one ends with the height: 2^70 - 1 matches."""
    flying.queries.register(
        "REGISTER STREAM many AS PATTERN SEQ(speed+ a[], altitude b) WHERE [id] "
        "WITHIN 2 minutes RETURN COUNT(*) AS n, b.id AS id"
    )
    for t in range(1, 71):
        feed(flying, "speeds", [(t, {"id": "uav1", "spd": 80.0})])
    feed(flying, "heights", [(71, {"id": "uav1", "alt": 50.0})])
    for name in ("speeds", "heights"):
        flying.end(name)
    ((_, found),) = samples(flying, "many")
    assert found["n"] == float(2**70)
    assert "rounded      1 numbers" in flying.queries.explain_running("many")


def test_why_and_partial(flying):
    flying.queries.register(DESCENT.split(" AS ", 1)[1].replace("?low", "100 [m]"))
    fly(flying, end=False)
    (match,) = flying.queries.why("descent", ["uav1"], 5 * SECOND)()
    assert [(e.event, e.stream, e.valid // SECOND) for e in match.events] == [
        ("t1", "speeds", 3),
        ("t2", "heights", 5),
    ]
    assert match.events[0].values["spd"] == 120.0
    with pytest.raises(NoResult, match="no match"):
        flying.queries.why("descent", ["uav2"], 5 * SECOND)()
    assert not flying.queries.partial("descent", [], 9).partial
    # What is available at 12 s is known once something is at 13 s.
    feed(flying, "speeds", [(t, {"id": "uav1", "spd": v}) for t, v in ((12, 130.0), (13, 80.0))])
    feed(flying, "heights", [(t, {"id": "uav1", "alt": 150.0}) for t in (12, 13)])
    (partial,) = flying.queries.partial("descent", ["uav1"], 9).partial
    ((name, time, values),) = partial.events
    assert (name, time // SECOND, values["object 1"]) == ("t1", 12, "uav1")
    (pending,) = partial.pending
    assert (pending.event, pending.latest // SECOND) == ("t2", 15)
    assert not flying.queries.partial("descent", ["uav2"], 9).partial


def test_what_is_missing(engine):
    with pytest.raises(NoPlan, match="no stream"):
        engine.queries.register("chronicle c(?x) { event(speed[?x], t); }")
    with pytest.raises(LanguageError, match="for ever"):
        engine.queries.register(
            "chronicle c(?x) { event(speed[?x], t1); event(altitude[?x], t2); }"
        )
    with pytest.raises(BadArguments, match="no windows"):
        engine.queries.register("chronicle c(?x) { event(speed[?x], t); }", semantics="set")


def test_it_says_why_it_is_empty(flying):
    flying.queries.register(DESCENT.split(" AS ", 1)[1].replace("?low", "10 [m]"))
    assert "no sample read yet" in flying.queries.view("descent").empty
    feed(flying, "speeds", [(1, {"id": "uav1", "spd": 120.0})])
    assert "none of them of dyknow:altitude" in flying.queries.view("descent").empty
    fly(flying)
    assert "no events match" in flying.queries.view("descent").empty


RISE = """PREFIX dyknow: <http://www.ida.liu.se/dyknow/>
SELECT ?c ?p1 ?p2 WHERE { ?c dyknow:speed ?p1 } SEQ { ?c dyknow:speed ?p2 }
FILTER (?p2 > ?p1 * 1.4 && getDURATION() < "PT3S"^^xsd:duration)"""


def test_ep_sparql(flying):
    view = flying.queries.register("REGISTER STREAM rise AS " + RISE)
    assert (view.kind, view.dialect) == ("PATTERN", "EP-SPARQL")
    fly(flying)
    assert [
        (int(v), r["c"], r["p1"], r["p2"], r["start"][-3:]) for v, r in samples(flying, "rise")
    ] == [
        (2, "uav2", 80.0, 120.0, "01Z"),
        (3, "uav1", 80.0, 120.0, "01Z"),
        (3, "uav1", 80.0, 120.0, "02Z"),
    ]
    assert [
        flying.queries.why("rise", ["uav1"], 3 * SECOND)()[i].events[0].valid for i in (0, 1)
    ] == [
        1 * SECOND,
        2 * SECOND,
    ]


def test_ep_sparql_as_a_template(flying):
    flying.register_template(
        "REGISTER TEMPLATE dyknow:Rise(?c, ?factor) AS "
        + RISE.replace("1.4", "?factor").replace("?c ?p1 ?p2 WHERE", "?c ?p2 WHERE")
    )
    view = ask(flying, "dyknow:Rise(dyknow:uav2, 1.2)")
    fly(flying)
    assert [(int(v), r["c"]) for v, r in samples(flying, view.stream)] == [(2, "uav2")]


def test_optional_parts_and_unions(flying):
    flying.queries.register(
        """REGISTER STREAM drops AS PREFIX dyknow: <http://www.ida.liu.se/dyknow/>
        SELECT ?c ?s WHERE { { ?c dyknow:speed ?s FILTER (?s > 100) } OPTIONALSEQ
        { ?c dyknow:altitude ?h FILTER (?h < 400) } } WITHIN 3 s"""
    )
    fly(flying)
    found = [(int(v), r["c"], r["s"]) for v, r in samples(flying, "drops")]
    # uav1 is low from 5 s on, and was fast at 3 s: the first two low samples are within 3 s.
    assert [each for each in found if each[2] is not None] == [
        (5, "uav1", 120.0),
        (6, "uav1", 120.0),
    ]
    assert {each[0] for each in found if each[1] == "uav1" and each[2] is None} == set(range(7, 12))


def test_static_triples_are_joined(flying):
    flying.load_ontology(
        "@prefix d: <http://www.ida.liu.se/dyknow/> . @prefix e: <http://e.org/> . "
        "d:uav1 e:owner e:ann .",
        name="http://e.org/owners",
        format="turtle",
    )
    flying.queries.register(
        """REGISTER STREAM owned AS PREFIX dyknow: <http://www.ida.liu.se/dyknow/>
        PREFIX e: <http://e.org/>
        SELECT ?c WHERE { ?c dyknow:speed ?v . ?c e:owner e:ann FILTER (?v > 100) } WITHIN 1 s"""
    )
    fly(flying)
    assert [(int(v), r["c"]) for v, r in samples(flying, "owned")] == [(3, "uav1")]


LIMITS = """REGISTER STREAM speeding AS PREFIX dyknow: <http://www.ida.liu.se/dyknow/>
PREFIX e: <http://e.org/>
SELECT ?c (?v - ?limit AS ?over) ?limit WHERE { ?c dyknow:speed ?v . ?c e:limit ?limit
  FILTER (?v - ?limit > 0) } WITHIN 1 s"""


def test_each_object_has_a_limit_of_its_own(flying):
    """A condition compares samples with values of static triples; another kind is no value."""
    flying.load_ontology(
        "@prefix d: <http://www.ida.liu.se/dyknow/> . @prefix e: <http://e.org/> . "
        "d:uav1 e:limit 110 , 'none' . d:uav2 e:limit 130.5 . d:uav3 e:owner e:ann .",
        name="http://e.org/limits",
        format="turtle",
    )
    flying.queries.register(LIMITS)
    flown = [(1, "uav1", 120.0), (2, "uav2", 120.0), (3, "uav3", 500.0), (4, "uav2", 131.0)]
    feed(flying, "speeds", [(t, {"id": name, "spd": speed}) for t, name, speed in flown])
    flying.end("speeds")
    assert [(int(t), r["c"], r["over"], r["limit"]) for t, r in samples(flying, "speeding")] == [
        (1, "uav1", 10.0, "110"),
        (4, "uav2", 0.5, "130.5"),
    ]
    assert "static number limit" in flying.queries.explain_running("speeding")
    assert "static number limit" in flying.explain(query=LIMITS)


def test_a_graph_of_from_is_loaded(flying):
    with pytest.raises(NoPlan, match=r"FROM <http://e\.org/none> names no loaded ontology"):
        flying.queries.register(LIMITS.replace("WHERE", "FROM <http://e.org/none> WHERE"))


def test_static_triples_are_told(flying):
    """A result for each of their solutions, in order of texts; `*` has their variables, too."""
    flying.load_ontology(
        "@prefix d: <http://www.ida.liu.se/dyknow/> . @prefix e: <http://e.org/> . "
        "d:uav1 e:owner d:ann , e:bob . e:bob e:age 40 . d:ann e:age 'old' .",
        name="http://e.org/owners",
        format="turtle",
    )
    head = "PREFIX dyknow: <http://www.ida.liu.se/dyknow/> PREFIX e: <http://e.org/> "
    where = ("{ ?c dyknow:speed ?v . ?c e:owner ?who . ?who e:age ?age FILTER (?v > 100) } "
             "WITHIN 1 s")  # fmt: skip
    flying.queries.register(f"REGISTER STREAM s AS {head} SELECT ?c ?age (?who AS ?o) {where}")
    flying.queries.register(f"REGISTER STREAM t AS {head} SELECT * {where}")
    flying.queries.register(f"REGISTER STREAM u AS {head} CONSTRUCT {{ ?c e:by ?who }} {where}")
    assert [field.name for field in flying.queries.view("t").fields] == [
        "c", "v", "who", "age", "start", "end"]  # fmt: skip
    fly(flying)
    owners = ["ann", "http://e.org/bob"]
    found = {
        name: [(int(t), r.get("o"), r.get("who"), r.get("age"), r.get("by"))
               for t, r in samples(flying, name)]
        for name in "stu"
    }  # fmt: skip
    assert found == {
        "s": [(3, "http://e.org/bob", None, "40", None), (3, "ann", None, "old", None)],
        "t": [(3, None, "ann", "old", None), (3, None, owners[1], "40", None)],
        "u": [(3, None, None, None, who) for who in owners],
    }
    (bob, ann) = flying.queries.why("s", ["uav1"], 3 * SECOND)()
    assert (bob.values["o"], ann.values["o"]) == (owners[1], "ann")
