"""Samples with one available time are one instant, from the sender to windows, joins and units
(SPEC §1, docs/explanation/semantics.md "Instants")."""

import json

import pytest

from dyknow.converters.ndjson import decode_ndjson
from dyknow.engine.engine import Engine
from dyknow.engine.model.views import StreamDeclaration
from dyknow.engine.processes.registry import Processes
from dyknow.streams.sample import Field, FieldType
from dyknow.streams.time import SECOND

IRI = "http://www.ida.liu.se/dyknow/"
FIELDS = (Field("id", FieldType.STRING), Field("v", FieldType.FLOAT))
COUNT = f"""REGISTER QUERY counted AS SELECT (COUNT(?v) AS ?n)
FROM STREAM <{IRI}radar.trdf> [RANGE 1s STEP 1s] WHERE {{ ?o dyknow:speed ?v }}"""
PAIRS = f"""REGISTER QUERY pairs AS SELECT ?a ?b
FROM STREAM <{IRI}radar.trdf> [RANGE 1s STEP 1s]
WHERE {{ ?a dyknow:speed ?v . ?b dyknow:speed ?w FILTER (?v < ?w) }}"""


def publish(engine, stream, *rows, now=0):
    """Rows (available in s or None, id, v); each is valid when it is available."""
    generator = engine.generator(stream)
    lines = []
    for at, id, value in rows:
        line = {"valid": int((at or 0) * SECOND), "id": id, "v": value}
        if at is not None:
            line["available"] = int(at * SECOND)
        lines.append(json.dumps(line))
    body = "\n".join(lines).encode()
    incoming = decode_ndjson(body, generator.schema, generator.stream.pools)
    engine.publish(stream, incoming, now)


def sweep(at, shift=0.0):
    return [(at, f"uav{k}", k + shift) for k in range(10)]


@pytest.fixture
def engine():
    engine = Engine()
    engine.declare(StreamDeclaration("radar", FIELDS, 0))
    engine.annotate("stream radar contains speed(UAV) = v for every UAV = id")
    return engine


def windows(engine, name):
    return [
        (result.end // SECOND, [str(row) for row in result.solutions.rows()])
        for result in engine.queries.results(name)
    ]


def history(engine, name):
    return [(a, *values.values()) for a, _, values in engine.generator(name).stream.all().rows()]


@pytest.mark.parametrize("size", [1, 3, 10, 20])
def test_a_window_holds_all_of_an_instant_however_it_is_cut(engine, size):
    engine.queries.register(COUNT)
    engine.queries.register(PAIRS)
    rows = [*sweep(1), *sweep(2, 20.0)]
    for start in range(0, len(rows), size):
        publish(engine, "radar", *rows[start : start + size])
    engine.end("radar")
    assert [end for end, _ in windows(engine, "counted")] == [1, 2]
    assert [values["n"] for _, _, values in engine.generator("counted").stream.all().rows()] == [
        10,
        10,
    ]
    # No pair is of two sweeps: 10 objects have 45 pairs in each.
    assert [len(found) for _, found in windows(engine, "pairs")] == [45, 45]
    assert {a for a, *_ in history(engine, "radar")} == {SECOND, 2 * SECOND}


def test_a_window_closes_on_a_stamp_after_its_end(engine):
    engine.queries.register(COUNT)
    publish(engine, "radar", *sweep(1))
    assert windows(engine, "counted") == []
    publish(engine, "radar", (1, "uav10", 10.0))
    assert windows(engine, "counted") == []
    publish(engine, "radar", (1.5, "uav1", 1.0))
    assert len(windows(engine, "counted")) == 1


def test_a_duplicate_is_an_equal_row_not_an_equal_time(engine):
    publish(engine, "radar", *sweep(1), *sweep(1))
    publish(engine, "radar", *sweep(1))
    publish(engine, "radar", (1, "uav1", 1.5), (1, "uav1", 1.5))
    counters = engine.stream("radar").counters
    assert (counters.used, counters.duplicate, counters.late) == (11, 21, 0)
    publish(engine, "radar", (2, "uav1", 1.0), *sweep(1))
    counters = engine.stream("radar").counters
    assert (counters.used, counters.duplicate, counters.late) == (12, 21, 10)


def test_duplicates_are_recognized_within_the_lateness(engine):
    engine.declare(StreamDeclaration("late", FIELDS, 2 * SECOND))
    publish(engine, "late", *sweep(1), *sweep(2))
    publish(engine, "late", *sweep(2), (3, "uav1", 0.0))
    publish(engine, "late", *sweep(1), (1, "uav1", 5.0), *sweep(2))
    counters = engine.stream("late").counters
    assert (counters.used, counters.duplicate, counters.pending) == (11, 30, 11)


def test_a_batch_that_is_stamped_on_arrival_is_one_instant(engine):
    engine.queries.register(COUNT)
    publish(engine, "radar", *sweep(None), now=SECOND)
    publish(engine, "radar", *sweep(None), now=SECOND)  # the clock has not moved
    engine.tick(3 * SECOND)
    assert [a for a, *_ in history(engine, "radar")] == [SECOND] * 10 + [SECOND + 1] * 10
    found = engine.generator("counted").stream.all()
    assert [values["n"] for _, _, values in found.rows()] == [10, 10]


def test_the_result_of_a_window_is_one_instant(engine):
    engine.queries.register(PAIRS)
    publish(engine, "radar", *sweep(1), (2, "uav1", 1.0))
    assert [a for a, *_ in history(engine, "pairs")] == [SECOND + 1] * 45


def test_a_join_makes_one_tuple_an_instant_and_a_unit_of_one_input_takes_each_sample():
    registry, seen = Processes(), []

    @registry.computational_unit("float", ["fix"])
    def Taken(time, samples, state):
        seen.append((time // SECOND, samples[0]["id"]))
        return samples[0]["v"], None

    engine = Engine(processes=registry)
    engine.add_kpl(
        "sort fix = (id string, v float)\nsource fix f\nsource fix g\ncompunit float Taken(fix)\n"
        "strmgen of_f = f\nstrmgen of_g = g\nstrmgen j = join(of_f, of_g)\nstrmgen t = Taken(of_f)"
    )
    publish(engine, "f", (1, "a", 1.0), (1, "b", 2.0))
    publish(engine, "f", (1, "c", 3.0))
    publish(engine, "g", (1, "d", 4.0), (1, "e", 5.0))
    assert seen == [(1, "a"), (1, "b"), (1, "c")]
    assert history(engine, "t") == [(SECOND, 1.0), (SECOND, 2.0), (SECOND, 3.0)]
    assert history(engine, "j") == []  # more may come
    publish(engine, "f", (2, "a", 6.0))
    publish(engine, "g", (2, "d", 7.0))
    assert history(engine, "j") == [(SECOND, "c", 3.0, "e", 5.0)]


def test_the_rdf_of_samples_of_an_instant_is_their_own(engine):
    engine.declare(
        StreamDeclaration("dist", (*FIELDS[:1], Field("to", FieldType.STRING), FIELDS[1]), 0)
    )
    engine.annotate("stream dist contains xydist(UAV as a, UAV as b) = v for every a = id, b = to")
    generator = engine.generator("dist")
    rows = [{"valid": 5, "available": 5, "id": "a", "to": "b", "v": float(k)} for k in range(3)]
    body = "\n".join(map(json.dumps, rows)).encode()
    engine.publish("dist", decode_ndjson(body, generator.schema, generator.stream.pools), 0)
    found = engine.rdf_of("dist", generator.stream.all())
    nodes = [text.split("xydist> <")[1].split(">")[0] for text in found]
    assert len(set(nodes)) == 3
    assert nodes[1] == f"{nodes[0]}.1"
    assert ['"1"' in found[1], '"2"' in found[2]] == [True, True]


def test_two_equal_results_of_a_unit_are_two_samples():
    """They differ in a field of the source that the subscription does not carry."""
    engine = Engine()
    engine.declare(StreamDeclaration("radar", (*FIELDS, Field("beam", FieldType.FLOAT)), 0))
    engine.annotate("stream radar contains speed(UAV) = v for every UAV = id")
    engine.subscribe_to_feature("dyknow:speed", sort="dyknow:UAV")
    generator = engine.generator("radar")
    rows = [{"valid": 5, "available": 5, "id": "a", "v": 1.0, "beam": float(k)} for k in (1, 2)]
    body = "\n".join(map(json.dumps, rows)).encode()
    engine.publish("radar", decode_ndjson(body, generator.schema, generator.stream.pools), 0)
    (view,) = engine.subscriptions()
    assert history(engine, view.stream) == [(5, "a", 1.0)] * 2
