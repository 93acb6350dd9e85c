"""Many clients: none misses a sample, none gets one twice, the stalled cost little and are cut off,
nobody takes every place, and all leave when the service stops."""

from __future__ import annotations

import logging
import random
import socket
import struct
import threading
import time
from collections.abc import Iterator

import httpx
import pytest
from asking import asking
from sse_clients import Reader, connect, head, read_all
from waiting import until

from dyknow.engine.engine import Engine
from dyknow.service.app import create_app
from dyknow.service.client.client import Client
from dyknow.service.config.file_limits import RESERVED, places
from dyknow.service.config.settings import Settings
from dyknow.service.http.problems import Problem
from dyknow.service.runtime.context import Service
from dyknow.service.server import running
from dyknow.service.sse.clients import LEAVE_SECONDS, EventClients
from dyknow.service.sse.message_cache import PIECE_BYTES
from dyknow.service.sse.response import SEND_BUFFER
from dyknow.streams.time import Clock

FIELDS = {"n": "integer", "text": "string"}


def publish(client: Client, first: int, count: int, text: str = "") -> None:
    rows = [{"valid": i, "available": i, "n": i, "text": text} for i in range(first, first + count)]
    client.publish("many", rows)


def metric(http: httpx.Client, line: str) -> float:
    found = [row for row in http.get("/metrics").text.splitlines() if row.startswith(line + " ")]
    assert len(found) == 1, line
    return float(found[0].rpartition(" ")[2])


@pytest.fixture
def settings() -> Settings:
    return Settings(port=0, tick=0.02, sse_ping=0, sse_send_timeout=0.5)


@pytest.fixture
def stream(client: Client) -> str:
    client.put_stream("many", FIELDS)
    return "/streams/many/events"


@pytest.fixture
def lines(caplog: pytest.LogCaptureFixture) -> Iterator[list[logging.LogRecord]]:
    """What is logged at warning or above: nothing of it is expected of clients."""
    with caplog.at_level(logging.WARNING):
        yield caplog.records


def test_cut_anywhere_and_resumed_nobody_misses_or_repeats(
    client: Client, http: httpx.Client, url: str, stream: str, lines: list[logging.LogRecord]
) -> None:
    draw = random.Random(7)
    readers = [
        # Who is cut before it has read the head of its answer begins where it did.
        Reader(
            url, stream + "?since=e1-0", [draw.randrange(1, 4000) for _ in range(draw.randrange(4))]
        )
        for _ in range(90)
    ]
    stalled = [connect(url, stream, receive=2048) for _ in range(10)]
    until(lambda: client.status()["clients"] == 100)

    def load() -> None:
        first = 1
        while first <= 400:
            count = draw.randrange(1, 9)
            publish(client, first, count, "x" * draw.randrange(400))
            first += count
        client.end("many")

    publisher = threading.Thread(target=load)
    publisher.start()
    read_all(readers)
    publisher.join()
    last = client.stream("many")["last"]
    wanted = [f"e1-{i}".encode() for i in range(1, last + 1)]
    assert [reader.samples == wanted for reader in readers] == [True] * 90
    assert {kind for reader in readers for kind, _ in reader.others} == {"end"}
    assert all(not reader.cuts for reader in readers)
    # These may have been sent all there is: the kernel holds it for them. They leave.
    for connection in stalled:
        connection.close()
    until(lambda: client.status()["clients"] == 0)
    assert lines == []


def test_a_stalled_client_costs_little_and_is_cut_off_and_counted(
    client: Client, http: httpx.Client, url: str, stream: str, lines: list[logging.LogRecord]
) -> None:
    reading = Reader(url, stream)
    reader = threading.Thread(target=read_all, args=([reading],))
    reader.start()
    stalled = connect(url, stream, receive=2048)
    until(lambda: client.status()["clients"] == 2)
    for i in range(20):  # in all many times what buffers hold
        publish(client, 1 + 50 * i, 50, "x" * 2000)
    until(lambda: metric(http, 'dyknow_event_stream_ends_total{reason="stalled"}') == 1)
    assert metric(http, "dyknow_event_stream_clients") == 1
    client.end("many")
    reader.join()
    assert reading.samples == [f"e1-{i}".encode() for i in range(1, 1001)]
    # What it was sent before is bounded, and then its connection is reset, not merely ended.
    until(lambda: bool(stalled.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR)))
    assert len(stalled.recv(1 << 20)) < SEND_BUFFER
    stalled.close()
    assert metric(http, 'dyknow_event_stream_ends_total{reason="ended"}') == 1
    assert metric(http, "dyknow_event_stream_bytes_total") > 1000 * 2000
    assert lines == []


def test_what_is_held_for_who_takes_nothing_is_bounded(
    engine: Engine, settings: Settings, clock: Clock
) -> None:
    patient = settings.model_copy(update={"sse_send_timeout": 60.0})
    app = create_app(engine, patient, clock)
    service: Service = app.state.service
    with (
        running(app, patient) as url,
        Client(url) as client,
        asking(url) as http,
    ):
        client.put_stream("many", FIELDS)
        for i in range(8):  # a megabyte each
            publish(client, 1 + 500 * i, 500, "x" * 2000)
        stalled = connect(url, "/streams/many/events?since=start", receive=2048)
        until(lambda: metric(http, "dyknow_event_stream_blocked") == 1)
        # The kernel takes up to twice what it was told.
        assert service.feeds.all.sent < 2 * SEND_BUFFER + 3 * PIECE_BYTES
        stalled.close()


def test_who_takes_little_at_a_time_is_not_stalled(
    client: Client, url: str, stream: str, settings: Settings
) -> None:
    """It gets everything, though it takes longer than the timeout in all."""
    publish(client, 1, 300, "x" * 2000)
    client.end("many")
    slow = connect(url, stream + "?since=start", receive=4096)
    begun, data = time.monotonic(), b""
    while not data.endswith(b"0\r\n\r\n"):
        data += slow.recv(4096)
        time.sleep(0.005)
    assert time.monotonic() - begun > settings.sse_send_timeout
    assert data.count(b"event: sample") == 300
    slow.close()


def test_one_address_does_not_take_every_place(
    engine: Engine, settings: Settings, clock: Clock
) -> None:
    limited = settings.model_copy(update={"sse_clients": 4, "sse_clients_each": 3})
    app = create_app(engine, limited, clock)
    service: Service = app.state.service
    # Who is who is told by a header here, as it would be by a token.
    service.client_key = lambda request: request.headers.get("last-event-id", "")[:1]
    with (
        running(app, limited) as url,
        asking(url) as http,
    ):
        http.put("/streams/many", json={"fields": FIELDS})
        path = "/streams/many/events"
        kept = [connect(url, path, f"a-{i}") for i in range(3)]
        assert [head(one)[0] for one in kept] == [200] * 3
        refused = http.get(path, headers={"Last-Event-ID": "a-0"})
        assert refused.status_code == 429
        assert refused.headers["retry-after"] == "5"
        assert refused.headers["content-type"] == "application/problem+json"
        assert refused.json()["title"] == "too many event streams"
        kept.append(connect(url, path, "b-0"))
        assert head(kept[-1])[0] == 200
        full = http.get(path, headers={"Last-Event-ID": "b-0"})
        assert (full.status_code, full.headers["retry-after"]) == (503, "5")
        # HEAD takes no place, and other routes answer.
        assert http.head(path, headers={"Last-Event-ID": "b-0"}).status_code == 200
        assert metric(http, 'dyknow_event_stream_refusals_total{limit="each"}') == 1
        assert metric(http, 'dyknow_event_stream_refusals_total{limit="total"}') == 1
        kept.pop(0).close()
        until(lambda: metric(http, 'dyknow_event_stream_ends_total{reason="left"}') == 1)
        again = connect(url, path, "a-9")
        assert head(again)[0] == 200
        for one in [*kept, again]:
            one.close()


def test_places_are_given_back(engine: Engine) -> None:
    clients = EventClients(2, 1, 0, 30)
    clients._timer = object()  # type: ignore[assignment]  # no loop runs here
    first = clients.admit("a")
    clients.join(first)
    with pytest.raises(Problem) as caught:
        clients.admit("a")
    assert caught.value.status_code == 429
    clients.join(second := clients.admit("b"))
    with pytest.raises(Problem) as caught:
        clients.admit("c")
    assert caught.value.status_code == 503
    clients.leave(first, "left")
    clients.leave(second, "ended")
    clients.join(clients.admit("a"))
    assert len(clients) == 1
    assert clients.ends["left"] == clients.ends["ended"] == 1


def test_clients_leave_descriptors_for_others(monkeypatch: pytest.MonkeyPatch) -> None:
    limits = (1024, 4096)
    monkeypatch.setattr("resource.getrlimit", lambda _: limits)
    assert places(10_000) == 1024 - RESERVED
    assert places(500) == 500


def test_heartbeats_keep_a_quiet_connection_open(
    engine: Engine, settings: Settings, clock: Clock
) -> None:
    beating = settings.model_copy(update={"sse_ping": 0.1})
    with running(create_app(engine, beating, clock), beating) as url:
        quiet = connect(url, "/status/events")
        data = b""
        while data.count(b": ping\n") < 3:
            data += quiet.recv(4096)
        assert b"event:" not in data
        quiet.close()


def test_the_service_stops_with_stalled_clients_in_bounded_time(
    engine: Engine, settings: Settings, clock: Clock, lines: list[logging.LogRecord]
) -> None:
    patient = settings.model_copy(update={"sse_send_timeout": 60.0})
    app = create_app(engine, patient, clock)
    service: Service = app.state.service
    with running(app, patient) as url, Client(url) as client:
        client.put_stream("many", FIELDS)
        publish(client, 1, 400, "x" * 2000)
        stalled = [connect(url, "/streams/many/events?since=start", receive=2048) for _ in range(5)]
        reading = [Reader(url, "/streams/many/events") for _ in range(5)]
        until(lambda: service.feeds.all.blocked == 5)
        until(lambda: client.status()["clients"] == 10)
        begun = time.monotonic()
    took = time.monotonic() - begun
    assert (
        took >= LEAVE_SECONDS
    )  # those that take nothing have that long, and no more is waited for
    assert service.feeds.all.ends["shutdown"] == 10
    read_all(reading)  # their answers are whole
    assert [reader.others for reader in reading] == [[]] * 5
    for one in stalled:
        one.close()
    assert lines == []


def test_a_client_that_resets_its_connection_is_let_go_quietly(
    client: Client, http: httpx.Client, url: str, stream: str, lines: list[logging.LogRecord]
) -> None:
    gone = connect(url, stream)
    assert head(gone)[0] == 200
    gone.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    gone.close()
    publish(client, 1, 10)
    until(lambda: metric(http, 'dyknow_event_stream_ends_total{reason="left"}') == 1)
    assert lines == []
