"""What a client asks of an event stream: the newest samples first, fewer members, or messages."""

from __future__ import annotations

import asyncio
import itertools
import json
from typing import Any

import httpx
import pytest

from dyknow.converters.wire import Incoming
from dyknow.engine.engine import Engine
from dyknow.engine.model.views import StreamDeclaration
from dyknow.service.client.client import AsyncClient, Client, Event, ServiceError
from dyknow.service.sse.clients import EventClient, EventClients
from dyknow.service.sse.cursor import Cursor, Start
from dyknow.service.sse.delivery import Projection
from dyknow.service.sse.feeds import Feeds
from dyknow.streams.sample import Field, FieldType, batch_from_rows

SSL = "stream s5 contains speed(UAV) = spd [m.s-1] for every UAV = id"
FIELDS = {"id": "string", "spd": "float", "alt": "float"}
ALL = {"stream", "sequence", "available", "valid", "values", "rdf"}


def samples(first: int, count: int, objects: int = 3) -> list[dict[str, Any]]:
    return [
        {"valid": i, "available": i, "id": f"uav{i % objects}", "spd": float(i), "alt": 0.5}
        for i in range(first, first + count)
    ]


def numbers(events: list[Event]) -> list[int]:
    return [event.data["sequence"] for event in events if event.kind == "sample"]


@pytest.fixture
def stream(client: Client) -> str:
    """Ten samples of three objects; it has ended, so that its events do."""
    client.put_stream("s5", FIELDS)
    client.annotate(SSL)
    client.publish("s5", samples(1, 10))
    client.end("s5")
    return "s5"


@pytest.mark.parametrize(("last", "found"), [(1, [10]), (3, [8, 9, 10]), (99, [*range(1, 11)])])
def test_last_begins_with_the_newest_samples(
    client: Client, stream: str, last: int, found: list[int]
) -> None:
    assert numbers(list(client.events(stream, last=last))) == found


def test_last_begins_with_what_is_kept_and_goes_on(client: Client, http: httpx.Client) -> None:
    client.put_stream("s5", FIELDS, retention={"samples": 4})
    for i in range(1, 11):
        client.publish("s5", samples(i, 1))
    kept = client.stream("s5")["first"]
    assert http.head("/streams/s5/events?last=99").headers["dyknow-position"] == f"e1-{kept - 1}"
    events = client.events("s5", last=2)
    assert [next(events).data["sequence"] for _ in range(2)] == [9, 10]
    client.publish("s5", samples(11, 1))
    assert next(events).data["sequence"] == 11


def test_an_id_goes_before_last(http: httpx.Client, stream: str) -> None:
    """A browser that reconnects repeats the URL."""
    answer = http.get("/streams/s5/events?last=1", headers={"Last-Event-ID": "e1-7"})
    assert [line for line in answer.text.splitlines() if line.startswith("id")] == [
        f"id: e1-{number}" for number in (8, 9, 10)
    ]


def test_messages_without_rdf_and_with_some_fields(client: Client, stream: str) -> None:
    for event in list(client.events(stream, since="start", rdf=False))[:-1]:
        assert event.data.keys() == ALL - {"rdf"}
        assert event.values.keys() == FIELDS.keys()
    chosen = list(client.events(stream, last=2, fields=["spd", "id"]))[:-1]
    assert [json.dumps(event.values) for event in chosen] == [
        '{"spd": 9.0, "id": "uav0"}',
        '{"spd": 10.0, "id": "uav1"}',
    ]
    assert all("speed" in event.rdf for event in chosen)  # that of the whole sample


def test_the_messages_of_a_projection_go_with_its_last_client(engine: Engine) -> None:
    engine.declare(StreamDeclaration("s", (Field("v", FieldType.FLOAT),)))
    feeds = Feeds(engine, 10_000, EventClients(10, 10, 0, 30))
    shorter = Projection(has_rdf=False)
    clients = [EventClient("x") for _ in range(3)]
    cursors = [
        Cursor(feeds, "s", Start(1), None, projection)
        for projection in (Projection(), shorter, shorter)
    ]
    for cursor, client in zip(cursors, clients, strict=True):
        cursor.join(client)
    batch = batch_from_rows(engine.generator("s").schema, [(1, 1, {"v": 0.5})])
    engine.publish("s", Incoming(batch, False), 0)
    messages = [cursor.take() or b"" for cursor in cursors]
    assert [b'"rdf"' in message for message in messages] == [True, False, False]
    assert messages[1] is messages[2]  # encoded once
    cursors[1].leave(clients[1])
    assert feeds._cache.size == len(messages[0]) + len(messages[2])
    cursors[2].leave(clients[2])
    assert feeds._cache.size == len(messages[0])
    cursors[0].leave(clients[0])
    assert feeds._cache.size == 0


@pytest.mark.parametrize(
    ("query", "status", "title", "hint"),
    [
        ("last=5&since=start", 400, "wrong arguments", "one of them"),
        ("last=0", 422, "values do not fit", ""),
        ("rdf=maybe", 422, "values do not fit", ""),
        ("fields=sped", 400, "unknown field", "did you mean spd?"),
        ("fields=id,", 400, "unknown field", "there are: id, spd, alt"),
        ("every=soon", 400, "bad duration", "1ms to 1h"),
        ("every=0s", 400, "bad duration", "1ms to 1h"),
        ("every=2h", 400, "bad duration", "1ms to 1h"),
    ],
)
@pytest.mark.parametrize("path", ["/streams/s5/events?", "/follow?stream=s5&"])
def test_what_is_wrong_is_refused_with_the_next_step(
    http: httpx.Client, stream: str, path: str, query: str, status: int, title: str, hint: str
) -> None:
    answer = http.get(path + query)
    assert (answer.status_code, answer.json()["title"]) == (status, title)
    assert hint in answer.json()["hint"]


@pytest.mark.parametrize("query", ["", "&fields=id", "&last=1", "&every=1s"])
def test_an_unknown_stream_is_unknown_in_any_case(http: httpx.Client, query: str) -> None:
    assert http.get(f"/streams/nothing/events?rdf=no{query}").status_code == 404


def test_every_sends_the_newest_of_each_object_and_how_many_it_stands_for(
    client: Client, stream: str
) -> None:
    events = list(client.events(stream, since="start", every="1h"))
    assert [(event.data["sequence"], event.count) for event in events[:-1]] == [
        (8, 3),
        (9, 3),
        (10, 4),
    ]
    assert events[-1].data == {"stream": "s5", "sequence": 10, "reason": "ended"}
    assert events[0].data.keys() == ALL | {"count"}
    (first, *_) = client.events(stream, last=4, every="1h", rdf=False, fields=["id", "spd"])
    assert first.data.keys() == (ALL | {"count"}) - {"rdf"}
    assert (first.values, first.count) == ({"id": "uav2", "spd": 8.0}, 1)
    (rest, _) = client.events(stream, since="e1-9", every="1h")
    assert (rest.data["sequence"], rest.count) == (10, 1)


def test_what_waits_for_its_interval_comes_without_another_sample(client: Client) -> None:
    client.put_stream("s5", FIELDS)
    client.annotate(SSL)
    events = client.events("s5", since="start", every="50ms")
    client.publish("s5", samples(1, 3))
    client.publish("s5", samples(4, 3))
    found: dict[str, int] = {}
    counts = 0
    while counts < 6:
        event = next(events)
        counts += event.count
        found[event.values["id"]] = event.data["sequence"]
    assert found == {"uav1": 4, "uav2": 5, "uav0": 6}


def test_a_stream_without_objects_is_one(client: Client) -> None:
    client.put_stream("plain", {"v": "float"})
    client.publish("plain", [{"valid": i, "available": i, "v": 1.0} for i in range(5)])
    client.end("plain")
    (event, _) = client.events("plain", since="start", every="1s")
    assert (event.data["sequence"], event.count) == (5, 5)


def test_streams_of_rdf_and_of_subscriptions_have_objects(
    client: Client, http: httpx.Client, stream: str
) -> None:
    text = "<urn:a> <urn:p> 1 . <urn:b> <urn:p> 2 . <urn:a> <urn:p> 3 ."
    client.publish_rdf("facts", text, create=True)
    client.end("facts")
    *found, _ = client.events("facts", since="start", every="1s")
    assert sorted((event.values["subject"], event.count) for event in found) == [
        ("<urn:a>", 2),
        ("<urn:b>", 1),
    ]
    kept = client.subscribe("s5", "any change", since="start")
    events = client.subscription_events(kept["id"], since="start", every="1s")
    assert [event.count for event in itertools.islice(events, 3)] == [3, 3, 4]
    wanted = client.subscribe_to("dyknow:speed", sort="dyknow:UAV", since="start")
    adapted = client.subscription_events(wanted["id"], since="start", every="1s")
    told = (event for event in adapted if event.kind == "sample")
    assert [event.count for event in itertools.islice(told, 3)] == [3, 3, 4]


def test_several_streams_each_have_their_newest(client: Client, stream: str) -> None:
    client.put_stream("other", {"id": "string", "v": "float"})
    client.publish("other", [{"valid": i, "id": "x", "v": float(i)} for i in range(5)])
    client.end("other")
    names = [stream, "other"]
    events = list(client.follow(names, last=2, rdf=False, fields=["id", "v"]))
    told = [(e.data["stream"], e.data["values"]) for e in events if e.kind == "sample"]
    assert sorted(told, key=str) == [
        ("other", {"id": "x", "v": 3.0}),
        ("other", {"id": "x", "v": 4.0}),
        ("s5", {"id": "uav0"}),
        ("s5", {"id": "uav1"}),
    ]
    conflated = [e for e in client.follow(names, since="start", every="1s") if e.kind == "sample"]
    counts = sorted((event.data["stream"], event.count) for event in conflated)
    assert counts == [("other", 5), ("s5", 3), ("s5", 3), ("s5", 4)]
    for i, event in enumerate(conflated):
        rest = [e for e in client.follow(names, since=event.id, every="1s") if e.kind == "sample"]
        assert [e.data["sequence"] for e in rest] == [
            e.data["sequence"] for e in conflated[i + 1 :]
        ]


def test_a_client_that_resumes_repeats_what_it_wants_but_not_where_it_began() -> None:
    asked: list[str] = []

    def answer(request: httpx.Request) -> httpx.Response:
        asked.append(str(request.url.query, "ascii"))
        text = f'id: e1-{len(asked)}\nevent: sample\ndata: {{"sequence": {len(asked)}}}\n\n'
        if len(asked) == 2:
            text += 'event: end\ndata: {"reason": "ended"}\n\n'
        return httpx.Response(
            200, headers={"content-type": "text/event-stream"}, text=text, request=request
        )

    with Client(transport=httpx.MockTransport(answer), sleep=lambda _: None) as client:
        list(client.events("s5", last=3, rdf=False, fields=["a", "b"], every="1s"))
    rest = "rdf=no&fields=a&fields=b&every=1s"
    assert asked == [f"last=3&{rest}", rest]


def test_the_asynchronous_client_has_the_same_parameters(url: str, stream: str) -> None:
    async def read() -> list[int]:
        async with AsyncClient(url) as client:
            events = client.events(stream, last=5, every="1s", rdf=False)
            return [event.count async for event in events if event.kind == "sample"]

    assert asyncio.run(read()) == [1, 2, 2]


def test_what_the_client_does_not_know_is_an_error(client: Client) -> None:
    with pytest.raises(TypeError, match="evry"):
        client.events("s5", evry="1s")  # type: ignore[call-arg]
    with pytest.raises(ServiceError, match="no field"):
        next(client.events("status", fields=["nothing"]))
