"""What comes and goes without end leaves nothing in an engine but what has a bound."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from growing import entries, grown, growth

from dyknow.engine import parts
from dyknow.engine.configuration import configuration
from dyknow.engine.durability.commands import (
    AddKpl,
    Annotate,
    ApplySpecification,
    CancelEvent,
    DeclareStream,
    Publish,
    RegisterAnnotatedTransformation,
    RegisterQuery,
    RegisterTemplate,
    RemoveKpl,
    RemoveQuery,
    RemoveStream,
    RemoveTemplate,
    RemoveTransformation,
    RequestEvent,
    Subscribe,
    SubscribeToFeature,
    Tick,
    Unsubscribe,
)
from dyknow.engine.durability.durable_engine import RecordedEngine
from dyknow.engine.model.views import StreamDeclaration
from dyknow.ontology import replicas
from dyknow.rdf.dictionary import TermDictionary
from dyknow.streams import history
from dyknow.streams.history import Retention
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


def text(insertions: str = "", removals: str = "") -> bytes:
    namespace = "http://www.dyknow.eu/ontology#Specification"
    return (
        f'<specification xmlns="{namespace}"><insertions>{insertions}</insertions>'
        f"<removals>{removals}</removals></specification>"
    ).encode()


def come_and_go(recorded: RecordedEngine, number: int) -> None:
    def do(command: Any) -> Any:
        return recorded.do(command)

    name = f"{number:04}"
    # What is asked for.
    do(RegisterTemplate(TEMPLATE.format(name)))
    limits = (10, 20, 30, 40, 50)
    asked = [do(RequestEvent(f"dyknow:Round{name}Event(?o, dyknow:UAV, {n})")) for n in limits]
    do(RegisterQuery(QUERY.format(name)))
    followed = [
        do(Subscribe("s", "sample every 1s, max delay 2s")),
        do(SubscribeToFeature("dyknow:speed", sort="dyknow:UAV")),
        do(SubscribeToFeature("dyknow:heading", objects=(f"dyknow:round{name}",))),
    ]
    # What there is.
    do(DeclareStream(StreamDeclaration(f"other{name}", FIELDS)))
    do(Annotate(f"stream other{name} contains speed(UAV) = v for every UAV = id"))
    do(DeclareStream(StreamDeclaration(f"own{name}", FIELDS)))
    do(Annotate(f"stream own{name} contains heading(round{name}) = v"))
    scaled = f"compunit scaled{name} transforms lat:latitude, lon:longitude to spd:speed [m.s-1]"
    do(RegisterAnnotatedTransformation(scaled, "coordinatesToSpeed", {"baseline": "10s"}))
    do(
        AddKpl(
            f"source float source{name}\nstrmgen drawn{name} = source{name}\n"
            f"stream slow{name} = drawn{name} with sample every 2s, max delay 1s"
        )
    )
    policy = '<parameter name="policy" value="sample every 1s"/><stream name="s"/>'
    do(ApplySpecification(text(f'<cu name="slower{name}" type="policy">{policy}</cu>')))
    # What comes.
    start = number * 10 * SECOND
    times = range(start, start + 10 * SECOND, SECOND // 10)
    rows = [
        {"valid": t, "available": t, "id": f"uav{name}.{i % 7}", "v": 1.0 * i}
        for i, t in enumerate(times)
    ]
    body = "\n".join(map(json.dumps, rows)).encode()
    for stream in ("s", f"other{name}", f"own{name}"):
        do(Publish(stream, "ndjson", body, start + 10 * SECOND))
    do(Tick(start + 10 * SECOND))
    # And all of it goes.
    for each in asked:
        do(CancelEvent(each.id))
    for each in followed:
        do(Unsubscribe(each.id))
    do(ApplySpecification(text(removals=f'<cu name="slower{name}"/>')))
    do(RemoveKpl(f"source{name}", cascade=True))
    do(RemoveQuery(f"round{name}"))
    do(RemoveTransformation(f"scaled{name}"))
    do(RemoveTemplate(f"dyknow:Round{name}Event"))
    do(RemoveStream(f"other{name}"))
    do(RemoveStream(f"own{name}"))
    recorded.log.commit()


@pytest.mark.long
def test_what_comes_and_goes_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # What is kept of what was is kept of the last: of few, so that these have come soon.
    monkeypatch.setattr(replicas, "MOST", 100)
    monkeypatch.setattr(configuration, "_MOST_REMOVED", 10)
    monkeypatch.setattr(parts, "RETENTION", Retention(samples=20))
    monkeypatch.setattr(history, "_TEXTS", 20)
    recorded = RecordedEngine(tmp_path, now=0)
    kept = Retention(samples=100)
    recorded.do(DeclareStream(StreamDeclaration("s", FIELDS, retention=kept)))
    recorded.do(Annotate("stream s contains speed(UAV) = v for every UAV = id"))
    sizes = []
    for number in range(1000, 1100):
        come_and_go(recorded, number)
        # Terms are forgotten now and then, in jumps (test_forgetting).
        sizes.append(entries(recorded.engine, TermDictionary))
    # One thing that stays of each round would be 30 more.
    assert grown(sizes[40:70], sizes[70:]) < 20, growth(sizes[69], sizes[99])
    recorded.close(checkpoint=False)
