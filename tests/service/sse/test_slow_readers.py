"""Clients that do not take what they asked for, on real connections: each costs little, is let go
and counted, and nobody alone takes every place."""

from __future__ import annotations

import asyncio
import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager

import httpx
import pytest
from asking import asking
from fastapi import FastAPI
from sse_clients import chunks, connect
from starlette.responses import PlainTextResponse, StreamingResponse
from starlette.types import Message, Receive, Scope, Send
from waiting import until

from dyknow.engine.engine import Engine
from dyknow.service.app import create_app
from dyknow.service.client.client import Client
from dyknow.service.config.media_types import ARROW
from dyknow.service.config.recent_requests import RecentRequests
from dyknow.service.config.settings import Settings
from dyknow.service.http.access_log import AccessLog
from dyknow.service.http.problems import Problem
from dyknow.service.http.response_limit import (
    EACH,
    PIECE_BYTES,
    STREAMED,
    LongAnswers,
    ResponseLimit,
)
from dyknow.service.server import running
from dyknow.streams.time import Clock

SOON = 0.5
"""Seconds; who takes nothing for longer is slow in these tests."""
LONG = 20.0
"""Seconds until a test gives up; nothing here waits so long unless it is broken."""
HISTORY = "/streams/s/samples?limit=100000"
SPARQL = "/sparql?query=SELECT+*+%7B+?a+?b+?c+.+?d+?e+?f+%7D+LIMIT+60000"


@pytest.fixture
def settings() -> Settings:
    return Settings(port=0, tick=0.02, sse_ping=0, answer_timeout=SOON, answer_rate=0)


@pytest.fixture
def http(url: str, client: Client) -> Iterator[httpx.Client]:
    """With a stream whose history is longer than what a kernel holds for who takes nothing."""
    fill(client)
    with asking(url) as http:
        yield http


def fill(client: Client) -> None:
    client.put_stream("s", {"text": "string"})
    for first in range(0, 1200, 100):
        rows = [{"valid": i, "available": i, "text": "x" * 10_000} for i in range(100)]
        for i, row in enumerate(rows):
            row["valid"] = row["available"] = first + i
        client.publish("s", rows)


def metric(http: httpx.Client, line: str) -> float:
    found = [row for row in http.get("/metrics").text.splitlines() if row.startswith(line + " ")]
    return float(found[0].rpartition(" ")[2]) if found else 0.0


def slow_readers(http: httpx.Client) -> float:
    return metric(http, 'dyknow_refusals_total{reason="slow reader"}')


def is_reset(connection: socket.socket) -> bool:
    return bool(connection.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR))


@contextmanager
def filled(engine: Engine, settings: Settings, clock: Clock) -> Iterator[tuple[str, httpx.Client]]:
    """A service of its own with that stream; its address, and a client."""
    app = create_app(engine, settings, clock)
    with running(app, settings) as url, Client(url, timeout=LONG) as client:
        fill(client)
        with asking(url) as http:
            yield url, http


@contextmanager
def stalled(url: str, path: str) -> Iterator[socket.socket]:
    with connect(url, path, receive=2048) as connection:
        yield connection


@pytest.mark.parametrize("path", [HISTORY, SPARQL])
def test_who_takes_nothing_is_let_go_and_counted(url: str, http: httpx.Client, path: str) -> None:
    """A history is encoded as it is taken, the result of a query there as a whole."""
    with stalled(url, path) as connection:
        until(lambda: metric(http, "dyknow_long_answers") == 1)
        assert metric(http, "dyknow_long_answers_bytes") >= STREAMED
        until(lambda: is_reset(connection))
    assert slow_readers(http) == 1
    until(lambda: metric(http, "dyknow_long_answers") == 0)
    assert metric(http, "dyknow_long_answers_bytes") == 0


def test_who_takes_little_at_a_time_gets_all(
    engine: Engine, settings: Settings, clock: Clock
) -> None:
    """It takes longer than the timeout in all."""
    # Long, since a busy machine may leave this reader out for a while.
    patient = settings.model_copy(update={"answer_timeout": 2.0})
    with filled(engine, patient, clock) as (url, http):
        wanted = http.get(HISTORY).content
        with connect(url, HISTORY, receive=65536) as connection:
            begun, data = time.monotonic(), b""
            while not data.endswith(b"0\r\n\r\n"):
                data += connection.recv(65536)
                time.sleep(0.015)
        assert time.monotonic() - begun > patient.answer_timeout
        assert chunks(data.partition(b"\r\n\r\n")[2])[0] == wanted
        assert slow_readers(http) == 0


def test_who_takes_too_little_is_let_go(engine: Engine, settings: Settings, clock: Clock) -> None:
    """Something all the time, and it comes to no end."""
    demanding = settings.model_copy(update={"answer_rate": 10_000_000})
    with filled(engine, demanding, clock) as (url, http), stalled(url, HISTORY) as slow:
        limit = time.monotonic() + LONG
        while slow_readers(http) == 0:
            assert time.monotonic() < limit
            slow.recv(512)
            time.sleep(0.01)


def test_event_streams_have_a_patience_of_their_own(
    engine: Engine, settings: Settings, clock: Clock
) -> None:
    patient = settings.model_copy(update={"sse_send_timeout": 60.0})
    with filled(engine, patient, clock) as (url, http):
        with stalled(url, "/streams/s/events?since=start") as events:
            until(lambda: metric(http, "dyknow_event_stream_blocked") == 1)
            with stalled(url, HISTORY) as history:
                until(lambda: is_reset(history))
            assert not is_reset(events)
            assert metric(http, "dyknow_event_stream_blocked") == 1
        assert slow_readers(http) == 1


@pytest.mark.parametrize("kind", ["application/x-ndjson", ARROW, "text/csv"])
def test_a_history_is_reckoned_with_what_is_held_for_it(
    url: str, client: Client, kind: str
) -> None:
    fields = {f"v{i}": "float" for i in range(20)}
    client.put_stream("wide", fields)
    for first in range(0, 20_000, 5_000):
        given = range(first, first + 5_000)
        client.publish("wide", [{"valid": i, **dict.fromkeys(fields, 1.5)} for i in given])
    with (
        asking(url) as http,
        connect(url, "/streams/wide/samples?limit=15000", receive=2048, accept=kind),
    ):
        held = 15_000 * (16 + 20 * 8)
        until(lambda: metric(http, "dyknow_long_answers_bytes") == STREAMED + held)


def test_an_answer_without_a_place_is_refused_and_others_are_answered(
    engine: Engine, settings: Settings, clock: Clock
) -> None:
    narrow = settings.model_copy(update={"answers": 2, "answer_timeout": 60.0})
    app = create_app(engine, narrow, clock)
    # Who is who is told by a header here, as it would be by a token.
    app.state.service.client_key = lambda request: request.headers.get("last-event-id", "")
    with running(app, narrow) as url, Client(url, timeout=LONG) as client:
        fill(client)
        for i in range(200):  # so that /metrics are long, too
            client.put_stream(f"other{i}", {"v": "float"})
        with asking(url) as http:
            with connect(url, HISTORY, "a", receive=2048), connect(url, SPARQL, "a", receive=2048):
                until(lambda: metric(http, "dyknow_long_answers") == 2)
                for key, status in (("a", 429), ("b", 503)):
                    refused = http.get(HISTORY, headers={"Last-Event-ID": key})
                    assert (refused.status_code, refused.headers["retry-after"]) == (status, "5")
                    assert refused.json()["title"] == "too many long answers"
                    assert refused.json()["hint"]
                assert len(http.get("/metrics").content) > PIECE_BYTES
                assert http.head(HISTORY).status_code == 200
                assert http.get("/streams/s").status_code == 200
                assert http.get("/streams/s/samples?limit=3").text.count("\n") == 3
                assert metric(http, 'dyknow_long_answer_refusals_total{limit="each"}') == 1
                assert metric(http, 'dyknow_long_answer_refusals_total{limit="total"}') == 1
            until(lambda: metric(http, "dyknow_long_answers") == 0)
            assert http.get(HISTORY).status_code == 200


def test_places_are_counted_by_client_in_answers_and_in_bytes() -> None:
    long = LongAnswers(most=4, total=100)

    def status(key: str, size: int) -> int:
        try:
            long.begin(key, size)
        except Problem as problem:
            return problem.status_code
        return 200

    assert status("a", 1000) == 200  # alone, whatever it is
    assert [status("a", 1), status("b", 1)] == [429, 503]
    long.end("a", 1000)
    assert [status("a", 50), status("a", 25), status("a", 1)] == [200, 200, 429]
    assert [status("b", 20), status("b", 6), status("b", 5)] == [200, 503, 200]
    assert status("c", 0) == 503
    long.begin("c", 70, always=True)
    with pytest.raises(Problem) as refused:
        long.begin("c", 10, always=True)
    assert refused.value.status_code == 429
    long.end("c", 70)
    assert EACH * 4 == 3
    long.end("a", 50)
    long.end("a", 25)
    assert (long.all.count, long.all.bytes) == (2, 25)


async def sent(app: FastAPI | PlainTextResponse | StreamingResponse, method: str) -> list[Message]:
    messages: list[Message] = []

    async def send(message: Message) -> None:
        messages.append(message)

    async def receive() -> Message:
        await asyncio.Event().wait()
        raise AssertionError

    scope = {"type": "http", "method": method, "path": "/", "headers": [], "client": None}
    await ResponseLimit(app, LongAnswers(1, 10), lambda _: "")(scope, receive, send)
    return messages


@pytest.mark.parametrize("size", [0, 1, PIECE_BYTES, PIECE_BYTES + 1, 3 * PIECE_BYTES])
def test_an_answer_is_the_same_in_pieces(size: int) -> None:
    text = ("0123456789" * (size // 10 + 1))[:size]
    for method in ("GET", "POST"):
        start, *pieces = asyncio.run(sent(PlainTextResponse(text), method))
        assert start["type"] == "http.response.start"
        assert b"".join(piece["body"] for piece in pieces).decode() == text
        assert [piece.get("more_body", False) for piece in pieces] == [True] * (len(pieces) - 1) + [
            False
        ]
        assert len(pieces) == max(1, -(-size // PIECE_BYTES))


def test_so_is_one_that_is_encoded_as_it_is_taken() -> None:
    parts = ["a" * 3, "", "b" * (2 * PIECE_BYTES + 1)]
    _, *pieces = asyncio.run(sent(StreamingResponse(iter(parts)), "GET"))
    assert b"".join(piece["body"] for piece in pieces).decode() == "".join(parts)
    assert max(len(piece["body"]) for piece in pieces) == PIECE_BYTES
    assert [piece.get("more_body", False) for piece in pieces] == [True] * (len(pieces) - 1) + [
        False
    ]


def test_how_long_a_client_takes_is_no_slow_request(monkeypatch: pytest.MonkeyPatch) -> None:
    now = 0.0
    monkeypatch.setattr("dyknow.service.http.access_log.time.perf_counter", lambda: now)
    told: list[float | None] = []

    class Count:
        def request(self, method: str, route: str, status: int, seconds: float | None) -> None:
            told.append(seconds)

    async def app(scope: Scope, receive: Receive, send: Send) -> None:
        nonlocal now
        now += 2.0  # it thinks about it
        await StreamingResponse(iter(["a", "b"]))(scope, receive, send)

    async def send(message: Message) -> None:
        nonlocal now
        now += 100.0

    async def receive() -> Message:
        await asyncio.Event().wait()
        raise AssertionError

    scope = {"type": "http", "method": "GET", "path": "/", "headers": [], "client": None}
    asyncio.run(AccessLog(app, Count(), RecentRequests())(scope, receive, send))
    assert told == [2.0]
    assert now > 300.0
