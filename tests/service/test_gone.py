"""What nobody needs any more is gone without the collector of garbage: it may have left it alone
while it was at work (`garbage`). So nothing large may refer to what refers to it."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from weakref import ref

import httpx
import pytest
from hosting import hosting
from waiting import until

from dyknow.engine.engine import Engine
from dyknow.engine.units.base import ComputationalUnit
from dyknow.engine.units.windowed import WindowUnit
from dyknow.service.config.settings import Settings
from dyknow.service.runtime.context import Service
from dyknow.service.sse.cursor import Cursor
from dyknow.service.sse.feed import Feed
from dyknow.service.turns.window_turns import WindowTurns
from dyknow.streams.generator import StreamGenerator

STREAM = {"fields": {"id": "string", "v": "float"}}
TEMPLATE = """REGISTER TEMPLATE dyknow:FastEvent(?o, ?type, ?limit) COMPUTE EVERY 1s AS
PREFIX dyknow: <http://www.ida.liu.se/dyknow/>
CONSTRUCT {?o dyknow:speed ?average}
WHERE { ?o a ?type . ?o dyknow:speed ?v . }
AGGREGATE {(?average, AVG, {?v}) FILTER (?average > ?limit)}
WINDOW [RANGE 5s STEP 1s]"""
QUERY = """REGISTER STREAM most AS SELECT ?o (MAX(?v) AS ?most)
FROM STREAM <http://www.ida.liu.se/dyknow/s.trdf> [RANGE 3s STEP 1s]
WHERE { ?o dyknow:speed ?v } GROUP BY ?o"""
KINDS = (ComputationalUnit, StreamGenerator, Cursor, Feed)


def there() -> set[int]:
    return {id(one) for one in gc.get_objects() if isinstance(one, KINDS)}


@pytest.fixture
def both() -> Iterator[tuple[Service, httpx.Client]]:
    engine = Engine(epoch="test", turns=WindowTurns(5, 60))
    with hosting(engine, Settings(port=0, tick=0.02), lambda: 10**18) as made:
        yield made


def publish(http: httpx.Client, start: int) -> None:
    lines = [
        f'{{"valid": {n * 10**9}, "available": {n * 10**9}, "id": "a", "v": {50 + n % 3}}}'
        for n in range(start, start + 20)
    ]
    headers = {"Content-Type": "application/x-ndjson"}
    answer = http.post("/streams/s/samples", content="\n".join(lines), headers=headers)
    answer.raise_for_status()


def test_units_streams_and_clients(both: tuple[Service, httpx.Client]) -> None:
    service, http = both
    http.put("/streams/s", json=STREAM).raise_for_status()
    said = "stream s contains speed(UAV) = v for every UAV = id"
    http.post("/annotations", content=said).raise_for_status()
    publish(http, 0)
    gc.unfreeze()
    before = there()

    http.post("/templates", content=TEMPLATE).raise_for_status()
    made = [
        http.post("/events", content=f"dyknow:FastEvent(?o, dyknow:UAV, {limit})").json()
        for limit in range(6)
    ]
    http.post("/queries", content=QUERY).raise_for_status()
    wanted = {"stream": "s", "policy": "sample every 1s, max delay 2s"}
    followed = [
        http.post("/subscriptions", json=wanted).json(),
        http.post("/subscriptions", json={"feature": "dyknow:speed", "sort": "dyknow:UAV"}).json(),
    ]
    with http.stream("GET", made[0]["events"]) as answer:
        publish(http, 20)
        lines = answer.iter_lines()
        until(lambda: next(lines).startswith("data:"))
        until(lambda: not service.engine.backlog)
        # What parsers leave behind refers to whom they were called by; a start leaves all alone.
        gc.unfreeze()
        gc.collect()
        gc.disable()
        alive = [each for each in gc.get_objects() if isinstance(each, KINDS)]
    new = [each for each in alive if id(each) not in before]
    assert {Cursor, Feed} < {type(each) for each in new}
    evaluators = [each.evaluator for each in new if isinstance(each, WindowUnit)]
    assert len(evaluators) > 2  # one request alone, one evaluation of the others, the query
    watched = [(type(each).__name__, ref(each)) for each in (*new, *evaluators)]
    del alive, new, evaluators
    try:
        for each in made:
            http.delete(f"/events/{each['id']}").raise_for_status()
        for each in followed:
            http.delete(f"/subscriptions/{each['id']}").raise_for_status()
        http.delete("/queries/most").raise_for_status()
        http.delete("/templates/FastEvent").raise_for_status()
        publish(http, 40)
        left = lambda: [kind for kind, one in watched if one() is not None]  # noqa: E731
        until(lambda: not left(), 10)
    finally:
        gc.enable()


@pytest.mark.parametrize("done", [True, False])
def test_a_turn_that_is_over(done: bool) -> None:
    """It refers to the evaluator whose windows it closes, whether it was run or not."""

    def close_next() -> bool:
        return False

    pausing = WindowTurns(5, 60)
    watched = ref(close_next)
    task = pausing.start(close_next)
    gc.disable()
    try:
        if done:
            task.run(to_end=True)
        del task, close_next
        assert watched() is None
    finally:
        gc.enable()
        pausing.close()
