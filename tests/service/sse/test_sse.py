"""Streams as server-sent events: order, resume, gaps, ends, sharing."""

from __future__ import annotations

import itertools
import logging
import socket
from collections.abc import Iterator
from contextlib import ExitStack
from typing import Any

import httpx
import pytest
from waiting import until

from dyknow.engine.engine import Engine
from dyknow.service.app import create_app
from dyknow.service.client.client import Client, Event, ServiceError
from dyknow.service.config.settings import Settings
from dyknow.service.server import GRACE, running
from dyknow.service.sse.clients import EventClients
from dyknow.service.sse.feeds import Feeds
from dyknow.service.sse.message_cache import (
    BLOCK_SAMPLES,
    PIECE_BYTES,
    Blocks,
    MessageCache,
)
from dyknow.streams.sample import SampleBatch
from dyknow.streams.time import Clock

FIELDS = {"id": "string", "speed": "float"}
DAY = "2021-10-07T19:12"


def samples(first: int, count: int) -> list[dict[str, Any]]:
    """Samples a second apart that bring their own available times."""
    return [
        {
            "valid": 1_000_000_000 * i,
            "available": 1_000_000_000 * i,
            "id": f"uav{i % 3}",
            "speed": float(i),
        }
        for i in range(first, first + count)
    ]


def take(events: Iterator[Event], count: int) -> list[Event]:
    return list(itertools.islice(events, count))


def numbers(events: list[Event]) -> list[int]:
    return [event.data["sequence"] for event in events if event.kind == "sample"]


@pytest.fixture
def stream(client: Client) -> str:
    client.put_stream("s5", FIELDS)
    return "s5"


def test_message_has_the_documented_form(client: Client, http: httpx.Client, stream: str) -> None:
    client.publish(stream, samples(1, 1))
    client.end(stream)
    answer = http.get("/streams/s5/events?since=start")
    assert answer.headers["content-type"].startswith("text/event-stream")
    assert answer.headers["dyknow-position"] == "e1-0"
    lines = answer.text.splitlines()
    assert lines[1:3] == ["id: e1-1", "event: sample"]
    event = take(client.events(stream, since="start"), 1)[0]
    assert event.id == "e1-1"
    assert set(event.data) == {"stream", "sequence", "available", "valid", "values", "rdf"}
    assert event.data["stream"] == "s5"
    assert event.data["valid"] == "1970-01-01T00:00:01Z"
    assert event.values == {"id": "uav1", "speed": 1.0}


def test_a_client_gets_what_comes_after_it_connected(client: Client, url: str, stream: str) -> None:
    client.publish(stream, samples(1, 5))
    with httpx.stream("GET", f"{url}/streams/s5/events", trust_env=False, timeout=120) as answer:
        assert answer.headers["dyknow-position"] == "e1-5"
        client.publish(stream, samples(6, 2))
        client.end(stream)
        text = answer.read().decode()
    assert [line for line in text.splitlines() if line.startswith("id:")] == [
        "id: e1-6",
        "id: e1-7",
    ]
    assert "event: end" in text


def test_resume_continues_without_loss_or_repetition(client: Client, stream: str) -> None:
    client.publish(stream, samples(1, 10))
    first = take(client.events(stream, since="start"), 4)
    client.publish(stream, samples(11, 5))
    client.end(stream)
    rest = list(client.events(stream, since=first[-1].id))
    assert numbers(first) + numbers(rest) == list(range(1, 16))
    assert rest[-1].kind == "end"
    assert rest[-1].data == {"stream": "s5", "sequence": 15, "reason": "ended"}


def test_last_event_id_goes_before_since(client: Client, http: httpx.Client, stream: str) -> None:
    client.publish(stream, samples(1, 3))
    client.end(stream)
    answer = http.get("/streams/s5/events?since=start", headers={"Last-Event-ID": "e1-2"})
    assert answer.headers["dyknow-position"] == "e1-2"
    assert "id: e1-3" in answer.text
    assert "id: e1-2" not in answer.text


def test_large_history_comes_in_order_through_all_pieces(client: Client, stream: str) -> None:
    count = 3 * BLOCK_SAMPLES + 17
    client.publish(stream, samples(1, count - 100))
    client.publish(stream, samples(count - 99, 100))
    client.end(stream)
    assert numbers(list(client.events(stream, since="start"))) == list(range(1, count + 1))
    middle = f"e1-{BLOCK_SAMPLES + 3}"
    assert numbers(list(client.events(stream, since=middle)))[0] == BLOCK_SAMPLES + 4


def test_a_gap_is_told_exactly(client: Client) -> None:
    client.put_stream("short", FIELDS, retention={"samples": 4})
    for i in range(1, 21):
        client.publish("short", samples(i, 1))
    client.end("short")
    kept = client.stream("short")["first"]
    events = list(client.events("short", since="e1-3"))
    assert events[0].kind == "gap"
    assert (events[0].data["from"], events[0].data["to"]) == (4, kept - 1)
    assert numbers(events) == list(range(kept, 21))


@pytest.mark.parametrize("id", ["old-2", "e1-99"], ids=["another epoch", "a number not reached"])
def test_a_new_beginning_is_told(client: Client, stream: str, id: str) -> None:
    client.publish(stream, samples(1, 3))
    client.end(stream)
    events = list(client.events(stream, since=id))
    assert events[0].kind == "gap"
    assert events[0].data["from"] == int(id.rpartition("-")[2]) + 1
    assert events[0].data["to"] is None
    assert "anew" in events[0].data["reason"]
    assert numbers(events) == [1, 2, 3]


@pytest.mark.parametrize("id", ["nonsense", "e1-", "-x", "e1-²", "e1-" + "9" * 30, "e" * 65 + "-1"])
def test_an_id_that_is_none_is_refused(client: Client, stream: str, id: str) -> None:
    with pytest.raises(ServiceError) as caught:
        take(client.events(stream, since=id), 1)
    assert caught.value.status == 400
    assert caught.value.title == "bad event id"


def test_unknown_stream_is_a_problem_not_a_stream(client: Client) -> None:
    with pytest.raises(ServiceError) as caught:
        take(client.events("nowhere"), 1)
    assert caught.value.status == 404


def test_a_client_that_leaves_is_unsubscribed(client: Client, stream: str) -> None:
    client.publish(stream, samples(1, 2))
    events = client.events(stream, since="start")
    take(events, 2)
    assert client.stream(stream)["subscribers"] == 1
    assert client.status()["clients"] == 1
    events.close()  # type: ignore[attr-defined]
    # The service learns of it when the connection is torn down: ask until it has.
    while client.stream(stream)["subscribers"]:
        pass
    assert client.status()["clients"] == 0


def test_clients_share_one_subscription_and_one_encoding(
    client: Client, stream: str, engine: Engine, monkeypatch: pytest.MonkeyPatch
) -> None:
    encoded: list[int] = []
    rdf_of = engine.rdf_of

    def counted(name: str, batch: SampleBatch, places: Any) -> list[str]:
        encoded.append(len(batch))
        return rdf_of(name, batch, places)

    monkeypatch.setattr(engine, "rdf_of", counted)
    client.publish(stream, samples(1, 20))
    assert encoded == []  # nobody listens
    listeners = [client.events(stream, since="start") for _ in range(3)]
    assert [numbers(take(events, 20)) for events in listeners] == [list(range(1, 21))] * 3
    assert client.stream(stream)["subscribers"] == 1
    assert sum(encoded) == 20


def test_the_rdf_of_a_sample_is_the_same_wherever_a_client_begins(
    client: Client, engine: Engine
) -> None:
    client.put_stream("dist", {"id": "string", "to": "string", "v": "float"})
    client.annotate("stream dist contains xydist(UAV as a, UAV as b) = v for every a = id, b = to")
    rows = [{"valid": 5, "available": 5, "id": "a", "to": "b", "v": float(k)} for k in range(4)]
    client.publish("dist", rows)
    client.end("dist")
    whole = engine.rdf_of("dist", engine.generator("dist").stream.all())
    assert len(set(whole)) == 4
    for begin in range(4):
        events = list(client.events("dist", since=f"e1-{begin}"))
        assert [event.rdf for event in events if event.kind == "sample"] == whole[begin:]


def test_status_is_a_stream_like_any_other(client: Client) -> None:
    events = client.status_events(since="start")
    client.put_stream("another", FIELDS)
    for event in events:
        assert event.data["stream"] == "status"
        if "another" in event.values.values():
            return


def test_head_answers_without_a_stream(http: httpx.Client, client: Client, stream: str) -> None:
    answer = http.head("/streams/s5/events")
    assert answer.status_code == 200
    assert answer.headers["content-type"].startswith("text/event-stream")
    assert answer.content == b""


def test_only_event_streams_are_offered(http: httpx.Client, client: Client, stream: str) -> None:
    answer = http.get("/streams/s5/events", headers={"Accept": "application/json"})
    assert answer.status_code == 406


def test_an_open_client_does_not_hold_up_the_stop(
    engine: Engine, settings: Settings, clock: Clock
) -> None:
    with running(create_app(engine, settings, clock), settings) as url:
        http = httpx.Client(base_url=url, trust_env=False, timeout=GRACE * 4)
        http.put("/streams/s5", json={"fields": FIELDS})
        answer = http.send(http.build_request("GET", "/streams/s5/events"), stream=True)
    # Stopped while the client was there; its answer is whole, and says nothing of an end.
    assert b"event: end" not in answer.read()
    http.close()


def test_client_resumes_by_itself_after_a_broken_connection() -> None:
    asked: list[tuple[str | None, str]] = []

    def answer(request: httpx.Request) -> httpx.Response:
        asked.append((request.headers.get("last-event-id"), str(request.url.query, "ascii")))
        number = len(asked)
        if number == 2:
            raise httpx.ConnectError("away", request=request)
        text = f'id: e1-{number}\nevent: sample\ndata: {{"sequence": {number}}}\n\n'
        if number == 3:
            text += 'event: end\ndata: {"reason": "ended"}\n\n'
        return httpx.Response(
            200, headers={"content-type": "text/event-stream"}, text=text, request=request
        )

    waited: list[float] = []
    with Client(transport=httpx.MockTransport(answer), sleep=waited.append) as client:
        events = list(client.events("s5", since="start"))
    assert [event.kind for event in events] == ["sample", "sample", "end"]
    assert asked == [(None, "since=start"), ("e1-1", ""), ("e1-1", "")]
    assert len(waited) == 2


def test_a_wrong_address_is_an_error_at_once() -> None:
    def answer(request: httpx.Request) -> httpx.Response:
        raise httpx.ConnectError("away", request=request)

    with Client(transport=httpx.MockTransport(answer)) as client, pytest.raises(httpx.ConnectError):
        take(client.events("s5"), 1)


def test_cache_stays_within_its_limit(engine: Engine) -> None:
    cache = MessageCache(100)
    blocks = Blocks(cache)
    for i in range(1, 51):
        block, _ = blocks.place(2 * i)  # every other one: each is a block of its own
        blocks.extend(block, [b"x" * 30])
    assert cache.size == 90
    kept = [i for i in range(1, 101) if blocks.find(i)]
    assert kept == [96, 98, 100]
    assert blocks.find(96)
    blocks.extend(blocks.place(1)[0], [b"x" * 30])
    assert [i for i in range(1, 101) if blocks.find(i)] == [1, 96, 100]  # 98 was read last
    blocks.clear()
    assert (cache.size, blocks.find(100)) == (0, None)


def test_a_message_longer_than_the_cache_goes_out_and_is_not_kept() -> None:
    cache = MessageCache(10)
    blocks = Blocks(cache)
    block, _ = blocks.place(5)
    blocks.extend(block, [b"x" * 30])
    assert block.part(5, 9) == (5, b"x" * 30)
    assert (cache.size, blocks.find(5)) == (0, None)


def test_what_is_sent_in_one_go_is_bounded_in_bytes() -> None:
    blocks = Blocks(MessageCache(1 << 30))
    block, room = blocks.place(1)
    assert room == BLOCK_SAMPLES
    blocks.extend(block, [b"%2d" % i + b"x" * (PIECE_BYTES // 4) for i in range(10)])
    sizes, number = [], 1
    while number <= 10:
        number, data = block.part(number, 8 if number <= 8 else 10)
        assert data.startswith(b"%2d" % (number - len(data) // (PIECE_BYTES // 4)))
        sizes.append(len(data) // (PIECE_BYTES // 4))
        number += 1
    assert sizes == [3, 3, 2, 2]  # nothing after 8 was asked for at first


def test_feeds_start_from_now(engine: Engine) -> None:
    feeds = Feeds(engine, 1000, EventClients(10, 10, 0, 30))
    last = engine.generator("status").stream.last_number
    assert feeds.start("status", None).number == last + 1


def test_who_follows_a_stream_by_another_name_is_woken_after_others_have_left(
    client: Client,
) -> None:
    client.declare_kpl("source float pos_car1\nstrmgen pos[car1] = pos_car1")
    rows = [{"valid": i, "available": i, "value": 1.0} for i in range(1, 5)]
    client.publish("pos_car1", rows[:1])
    for i, name in enumerate(("pos[car1]", "pos_car1", "pos[car1]"), start=1):
        events = client.events(name, since="start")
        assert numbers(take(events, i)) == list(range(1, i + 1))
        client.publish("pos_car1", rows[i : i + 1])
        assert numbers(take(events, 1)) == [i + 1]
        events.close()  # type: ignore[attr-defined]
        while client.status()["clients"]:
            pass


@pytest.mark.parametrize("more", ["", "GET /healthz HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n"])
def test_what_is_no_http_ends_an_event_stream_quietly(
    client: Client, url: str, stream: str, more: str, caplog: pytest.LogCaptureFixture
) -> None:
    """With requests behind it, uvicorn told only the last of them that the connection is gone."""
    host, port = url.removeprefix("http://").split(":")
    asked = f"GET /streams/{stream}/events HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n".encode()
    with ExitStack() as stack:
        for _ in range(8):
            connection = stack.enter_context(socket.create_connection((host, int(port)), 5))
            connection.sendall(asked)
            assert connection.recv(64).startswith(b"HTTP/1.1 200")
            connection.sendall(more.encode() + b"GET /x HTTP/1.1\r\nHost: a\r\n\0\xff")
        for number in range(5):
            client.publish(stream, samples(number * 20, 20))
    gone = "dyknow_event_stream_clients 0.0"
    until(lambda: gone in httpx.get(f"{url}/metrics", trust_env=False, timeout=60).text)
    assert [r.getMessage() for r in caplog.records if r.levelno >= logging.ERROR] == []
