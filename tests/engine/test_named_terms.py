"""What queries and annotations name is forgotten when they are gone, and at once: no collection
of garbage is waited for."""

from __future__ import annotations

import gc
import json
from collections.abc import Iterator

import pytest

from dyknow.engine.durability.commands import (
    Annotate,
    ApplySpecification,
    DeclareStream,
    LoadOntology,
    Publish,
    RegisterQuery,
    RemoveQuery,
    RemoveStream,
    Subscribe,
    SubscribeToFeature,
    Tick,
    Unsubscribe,
)
from dyknow.engine.engine import Engine
from dyknow.engine.model.views import StreamDeclaration
from dyknow.languages.specification.markup import NAMESPACE
from dyknow.streams.sample import Field, FieldType

FIELDS = (Field("id", FieldType.STRING), Field("v", FieldType.FLOAT))
SECOND = 10**9
SPECIFICATION = f"""<specification xmlns="{NAMESPACE}">
<insertions>{{}}</insertions><removals>{{}}</removals></specification>"""
VALUES = " ".join(f"(<http://x/{{0}}.{k}> 'v{{0}}.{k}')" for k in range(20))


@pytest.fixture(autouse=True)
def no_collection() -> Iterator[None]:
    gc.collect()
    gc.disable()
    yield
    gc.enable()


@pytest.fixture
def engine() -> Engine:
    found = Engine()
    DeclareStream(StreamDeclaration("s", FIELDS)).apply(found)
    Annotate("stream s contains speed(UAV) = v for every UAV = id").apply(found)
    return found


def terms(engine: Engine) -> int:
    """How many there are that are needed."""
    engine.dictionary._sweep()
    return engine.dictionary.count


def ask(engine: Engine, number: int, query: str) -> None:
    """Register a query, let windows of it close, and remove it."""
    head, body = query.replace("ROWS", VALUES).format(number).split(" WHERE ")
    stream = "FROM STREAM <http://www.ida.liu.se/dyknow/s.trdf> [RANGE 3s STEP 1s]"
    text = f"REGISTER QUERY q{number} COMPUTE EVERY 1s AS {head} {stream} WHERE {body}"
    RegisterQuery(text).apply(engine)
    start = number * 10 * SECOND
    times = [start + k * SECOND for k in range(5)]
    rows = [{"valid": t, "available": t, "id": f"u{k}", "v": 1.0} for k, t in enumerate(times)]
    body = "\n".join(map(json.dumps, rows))
    Publish("s", "ndjson", body.encode(), times[-1]).apply(engine)
    Tick(times[-1] + SECOND).apply(engine)
    assert engine.generator(f"q{number}").stream.last_number or "FILTER NOT" in query
    RemoveQuery(f"q{number}").apply(engine)


@pytest.mark.parametrize(
    "query",
    [
        "SELECT ?o WHERE {{ ?o dyknow:speed ?v FILTER(?o != <http://x/{0}>) }}",
        "SELECT ?o ?x WHERE {{ ?o dyknow:speed ?v BIND('text {0}' AS ?x) }}",
        "SELECT ?o ?x WHERE {{ ?o dyknow:speed ?v OPTIONAL {{ VALUES (?x ?y) {{ ROWS }} }} }}",
        "SELECT ?o ?x WHERE {{ ?o dyknow:speed ?v OPTIONAL {{ <http://x/{0}> dyknow:speed ?x }} }}",
        "SELECT ?o WHERE {{ ?o dyknow:speed ?v FILTER NOT EXISTS {{ ?o dyknow:speed 'a{0}' }} }}",
        "SELECT ?o ?x WHERE {{ ?o dyknow:speed ?v OPTIONAL {{ ?o <http://x/{0}> ?x }} }}",
        "SELECT ?o ?x WHERE {{ ?o dyknow:speed ?v OPTIONAL {{ ?o <http://x/{0}>+ ?x }} }}",
        "SELECT ?o ?x WHERE {{ ?o dyknow:speed ?v OPTIONAL {{ ?o a <http://x/{0}>, ?x }} }}",
        "SELECT ?o WHERE {{ ?o dyknow:speed ?v FILTER NOT EXISTS {{ ?o <http://x/{0}> ?x }} }}",
        "CONSTRUCT {{ ?o <http://p/{0}> <http://o/{0}> }} WHERE {{ ?o dyknow:speed ?v }}",
    ],
)
def test_constants_of_queries(engine: Engine, query: str) -> None:
    ask(engine, 1, query)
    before = terms(engine)
    for number in range(2, 12):
        ask(engine, number, query)
    assert terms(engine) == before


def test_objects_of_annotations_and_subscriptions(engine: Engine) -> None:
    def come_and_go(number: int) -> None:
        name = f"a{number}"
        DeclareStream(StreamDeclaration(name, FIELDS)).apply(engine)
        contents = ", ".join(f"heading(r{number}x{k}) = v" for k in range(20))
        Annotate(f"stream {name} contains {contents}").apply(engine)
        followed = [
            SubscribeToFeature("dyknow:heading", objects=(f"dyknow:r{number}x3",)).apply(engine),
            SubscribeToFeature("dyknow:speed", objects=(f"dyknow:uav{number}",)).apply(engine),
            Subscribe("s", "sample every 1s, max delay 2s").apply(engine),
        ]
        text = (
            f"REGISTER QUERY z{number} COMPUTE EVERY 1s AS SELECT ?o FROM STREAM "
            f"<http://www.ida.liu.se/dyknow/{name}.trdf> [RANGE 3s STEP 1s] "
            "WHERE { ?o dyknow:heading ?v }"
        )
        RegisterQuery(text).apply(engine)
        Publish(name, "ndjson", b'{"valid": 1, "available": 1, "id": "u", "v": 1}', 1).apply(engine)
        RemoveQuery(f"z{number}").apply(engine)
        for each in followed:
            Unsubscribe(each.id).apply(engine)
        RemoveStream(name).apply(engine)

    come_and_go(1)
    before = terms(engine)
    for number in range(2, 12):
        come_and_go(number)
    assert terms(engine) == before


@pytest.mark.parametrize(
    "pattern",
    ["?o a dyknow:UAV ; dyknow:speed ?v", "?s ?p ?o", "?o <http://x/p> ?x", "?o a ?c . ?c ?p ?x"],
)
def test_individuals_sorts_and_predicates_of_ontologies_and_annotations(
    engine: Engine, pattern: str
) -> None:
    def come_and_go(number: int) -> None:
        sort = f"dyknow:Sort{number}"
        turtle = f"""@prefix : <http://www.dyknow.eu/ontology#> .
            @prefix rdfs: <http://www.w3.org/2000/01/rdf-schema#> .
            @prefix owl: <http://www.w3.org/2002/07/owl#> .
            @prefix dyknow: <http://www.ida.liu.se/dyknow/> .
            {sort} a owl:Class ; rdfs:subClassOf dyknow:UAV .
            dyknow:feature{number} a owl:DatatypeProperty, :Feature ; rdfs:domain {sort} ."""
        for k in range(20):
            one = f"http://x/{number}.{k}"
            turtle += f"<{one}> a dyknow:UAV, {sort} ; <http://x/p> 'is {one}', <{one}> ."
        LoadOntology(turtle, "http://x/ontology").apply(engine)
        name = f"n{number}"
        DeclareStream(StreamDeclaration(name, FIELDS)).apply(engine)
        said = f"feature{number}(Sort{number}) = v"
        Annotate(f"stream {name} contains {said} for every Sort{number} = id").apply(engine)
        ask(engine, number, f"SELECT * WHERE {{{{ {pattern} }}}}")
        RemoveStream(name).apply(engine)

    for number in (1, 2):
        come_and_go(number)
    before = terms(engine)
    for number in range(3, 6):
        come_and_go(number)
    assert terms(engine) == before


def test_objects_that_streams_were_put_together_by(engine: Engine) -> None:
    Annotate("stream s contains speed(UAV) = v for every UAV = id").apply(engine)
    DeclareStream(StreamDeclaration("t", FIELDS)).apply(engine)
    Annotate("stream t contains altitude(UAV) = v for every UAV = id").apply(engine)
    streams = '<stream name="s"/><stream name="t"/>'

    def come_and_go(number: int) -> None:
        unit = f'<cu name="both{number}" type="synchronize">{streams}</cu>'
        ApplySpecification(SPECIFICATION.format(unit, "").encode()).apply(engine)
        for place, stream in enumerate("st", 1):
            rows = [{"valid": number, "id": f"u{number}.{k}", "v": 1.0} for k in range(20)]
            body = "\n".join(map(json.dumps, rows)).encode()
            Publish(stream, "ndjson", body, number * SECOND + 10 * place).apply(engine)
            Tick(number * SECOND + 10 * place + 1).apply(engine)
        assert engine.generator(f"both{number}").stream.last_number >= 19
        assert terms(engine) >= 20
        unit = f'<cu name="both{number}"/>'
        ApplySpecification(SPECIFICATION.format("", unit).encode()).apply(engine)

    come_and_go(1)
    before = terms(engine)
    for number in range(2, 6):
        come_and_go(number)
    assert terms(engine) == before
