"""What comes and goes without end leaves nothing in an engine but what has a bound."""

from __future__ import annotations

import gc
import json
from collections import deque
from pathlib import Path
from types import CodeType, FunctionType, ModuleType
from typing import Any

import pytest

from dyknow.engine import configuration, engine
from dyknow.engine.commands import (
    Annotate,
    CancelEvent,
    DeclareStream,
    Publish,
    RegisterQuery,
    RegisterTemplate,
    RemoveQuery,
    RemoveStream,
    RemoveTemplate,
    RequestEvent,
    Subscribe,
    Unsubscribe,
)
from dyknow.engine.recorded import RecordedEngine
from dyknow.engine.views import StreamDeclaration
from dyknow.ontology import replicas
from dyknow.rdf import dictionary
from dyknow.streams import fluent
from dyknow.streams.fluent import Retention
from dyknow.streams.sample import Field, FieldType

FIELDS = (Field("id", FieldType.STRING), Field("v", FieldType.FLOAT))
TEMPLATE = """REGISTER TEMPLATE dyknow:Round{}Event(?o, ?type, ?limit) COMPUTE EVERY 1s AS
PREFIX dyknow: <http://www.ida.liu.se/dyknow/>
CONSTRUCT {{?o dyknow:speed ?average}}
WHERE {{ ?o a ?type . ?o dyknow:speed ?v . }}
AGGREGATE {{(?average, AVG, {{?v}}) FILTER (?average > ?limit)}}
WINDOW [RANGE 5s STEP 1s]"""
QUERY = """REGISTER STREAM round{} COMPUTE EVERY 1s AS
SELECT ?o (MAX(?v) AS ?most) FROM STREAM <http://www.ida.liu.se/dyknow/s.trdf> [RANGE 3s STEP 1s]
WHERE {{ ?o dyknow:speed ?v }} GROUP BY ?o"""
SECOND = 1_000_000_000
OUTSIDE = (type, ModuleType, FunctionType, CodeType)


def come_and_go(recorded: RecordedEngine, number: int) -> None:
    def do(command: Any) -> Any:
        return recorded.do(command)

    name = f"{number:04}"
    do(RegisterTemplate(TEMPLATE.format(name)))
    limits = (10, 20, 30, 40, 50)
    asked = [do(RequestEvent(f"dyknow:Round{name}Event(?o, dyknow:UAV, {n})")) for n in limits]
    do(RegisterQuery(QUERY.format(name)))
    subscription = do(Subscribe("s", "sample every 1s, max delay 2s"))
    do(DeclareStream(StreamDeclaration(f"other{name}", FIELDS)))
    do(Annotate(f"stream other{name} contains speed(UAV) = v for every UAV = id"))
    start = number * 10 * SECOND
    times = range(start, start + 10 * SECOND, SECOND // 10)
    rows = [{"valid": t, "available": t, "id": f"uav{t % 7}", "v": 1.0 * (t % 100)} for t in times]
    body = "\n".join(map(json.dumps, rows)).encode()
    do(Publish("s", "ndjson", body, start + 10 * SECOND))
    do(Publish(f"other{name}", "ndjson", body, start + 10 * SECOND))
    for each in asked:
        do(CancelEvent(each.id))
    do(Unsubscribe(subscription.id))
    do(RemoveQuery(f"round{name}"))
    do(RemoveTemplate(f"dyknow:Round{name}Event"))
    do(RemoveStream(f"other{name}"))
    recorded.log.commit()


def entries(root: object) -> int:
    """How much dictionaries, sets and lists have that can be reached from ``root``."""
    seen: dict[int, object] = {}
    waiting = [root]
    count = 0
    while waiting:
        found = waiting.pop()
        if id(found) in seen or isinstance(found, OUTSIDE):
            continue
        seen[id(found)] = found
        if isinstance(found, dict | list | set | frozenset | deque):
            count += len(found)
        waiting += gc.get_referents(found)
    return count


def test_what_comes_and_goes_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # What is kept of what was is kept of the last: of few, so that these have come soon.
    monkeypatch.setattr(replicas, "MOST", 100)
    monkeypatch.setattr(configuration, "_REMEMBERED", 10)
    monkeypatch.setattr(engine, "RETENTION", Retention(samples=20))
    monkeypatch.setattr(fluent, "_TEXTS", 20)
    monkeypatch.setattr(dictionary, "FLOOR", 50)
    recorded = RecordedEngine(tmp_path, now=0)
    kept = Retention(samples=100)
    recorded.do(DeclareStream(StreamDeclaration("s", FIELDS, retention=kept)))
    recorded.do(Annotate("stream s contains speed(UAV) = v for every UAV = id"))
    sizes = []
    for number in range(1000, 1140):
        come_and_go(recorded, number)
        sizes.append(entries(recorded.engine))
    assert max(sizes[-40:]) <= max(sizes[60:100]) + 10
    recorded.close(checkpoint=False)
