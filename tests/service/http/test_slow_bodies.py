"""Senders that take their time, on real connections: bodies, heads, and too many of them."""

from __future__ import annotations

import http.client
import json
import socket
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import Any
from urllib.parse import urlsplit

import httpx
import pytest
from starlette.types import Receive, Scope, Send
from waiting import until

from dyknow.engine.engine import Engine
from dyknow.service.app import create_app
from dyknow.service.config.settings import Settings
from dyknow.service.http import body_limit, connection_limits
from dyknow.service.http.body_limit import GRACE, BodyLimit
from dyknow.service.http.connection_limits import (
    HEAD_LIMIT,
    REFUSED,
    TRAILERS,
    ConnectionLimits,
)
from dyknow.service.server import running
from dyknow.streams.time import Clock

FIELDS = {"v": "float"}
SAMPLE = b'{"valid": 1, "available": 1, "v": 1.5}\n'
SOON = 0.3
"""Seconds; what takes longer is slow in these tests."""
LONG = 20.0
"""Seconds until a test gives up; nothing here waits so long unless it is broken."""


@pytest.fixture
def settings() -> Settings:
    return Settings(
        port=0,
        tick=0.02,
        sse_ping=0,
        body_timeout=SOON,
        head_timeout=SOON,
        max_connections=20,
        max_connections_per_client=12,
    )


@pytest.fixture
def stream(http: httpx.Client) -> str:
    assert http.put("/streams/s", json={"fields": FIELDS}).status_code == 201
    return "/streams/s/samples"


@contextmanager
def connected(url: str) -> Iterator[socket.socket]:
    parts = urlsplit(url)
    with socket.create_connection((parts.hostname, parts.port), timeout=LONG) as connection:
        yield connection


def head(method: str, path: str, *lines: str) -> bytes:
    return "\r\n".join([f"{method} {path} HTTP/1.1", "Host: localhost", *lines, "", ""]).encode()


def rest(connection: socket.socket) -> bytes:
    """What comes until the service closes the connection."""
    received = b""
    try:
        while data := connection.recv(65536):
            received += data
    except ConnectionResetError:
        pass  # closed while something of ours was on its way
    return received


def answer(connection: socket.socket) -> tuple[int, dict[str, Any], http.client.HTTPMessage]:
    found = http.client.HTTPResponse(connection)
    found.begin()
    return found.status, json.loads(found.read()), found.headers


def refusals(http: httpx.Client, reason: str) -> float:
    for line in http.get("/metrics").text.splitlines():
        if line.startswith(f'dyknow_refusals_total{{reason="{reason}"}}'):
            return float(line.split()[-1])
    return 0.0


# -- bodies ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("framing", ["Content-Length: 1000", "Transfer-Encoding: chunked"])
def test_a_body_that_does_not_end_is_answered(
    url: str, http: httpx.Client, stream: str, framing: str
) -> None:
    with connected(url) as connection:
        connection.sendall(head("POST", stream, framing) + b"5\r\n12345\r\n")
        status, problem, headers = answer(connection)
        assert status == 408
        assert problem["title"] == "slow body"
        assert problem["hint"]
        assert headers["connection"] == "close"
        assert rest(connection) == b""
    assert refusals(http, "slow body") == 1
    assert http.get("/streams/s").json()["counters"]["accepted"] == 0


def test_a_body_that_trickles_is_answered(url: str, http: httpx.Client, stream: str) -> None:
    """Something comes all the time, and it comes to no end."""
    with connected(url) as connection:
        connection.sendall(head("POST", stream, "Content-Length: 1000000"))
        connection.settimeout(0.02)
        begun = time.monotonic()
        received = b""
        while not received and time.monotonic() - begun < LONG:
            connection.sendall(b" ")
            try:
                received = connection.recv(4096)
            except TimeoutError:
                continue
        assert received.startswith(b"HTTP/1.1 408 ")


def test_a_body_that_is_too_slow_need_not_come_to_its_deadline(
    engine: Engine, clock: Clock, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(body_limit, "GRACE", SOON)
    # Its deadline is far beyond the end of this test.
    settings = Settings(port=0, body_timeout=120 * LONG, body_rate=1_000_000)
    with running(create_app(engine, settings, clock), settings) as url, connected(url) as slow:
        httpx.put(f"{url}/streams/s", json={"fields": FIELDS}, trust_env=False, timeout=60)
        slow.sendall(head("POST", "/streams/s/samples", "Content-Length: 1000") + b"{")
        assert answer(slow)[0] == 408


@pytest.mark.parametrize(
    ("method", "path", "kind"),
    [
        ("PUT", "/streams/x", "application/json"),
        ("POST", "/kpl", "text/plain"),
        ("POST", "/sparql", "application/sparql-query"),
        ("POST", "/ontologies", "text/turtle"),
        ("POST", "/specifications", "application/xml"),
    ],
)
def test_bodies_of_all_routes_have_a_deadline(url: str, method: str, path: str, kind: str) -> None:
    with connected(url) as connection:
        connection.sendall(head(method, path, f"Content-Type: {kind}", "Content-Length: 9") + b"{}")
        assert answer(connection)[0] == 408


def test_a_body_in_pieces_is_taken_in_time(url: str, http: httpx.Client, stream: str) -> None:
    with connected(url) as connection:
        connection.sendall(head("POST", stream, f"Content-Length: {len(SAMPLE)}"))
        for byte in SAMPLE:
            connection.sendall(bytes([byte]))
        assert answer(connection)[:2] == (202, {"accepted": 1})
        # The connection is as good as before.
        connection.sendall(head("GET", "/healthz"))
        assert answer(connection)[0] == 200


def test_live_bodies_have_their_own_patience(url: str, http: httpx.Client, stream: str) -> None:
    with connected(url) as connection:
        connection.sendall(
            head("POST", f"{stream}/live", "Transfer-Encoding: chunked")
            + b"%x\r\n%s\r\n" % (len(SAMPLE), SAMPLE)
        )
        begun = time.monotonic()
        # Others are let go meanwhile, so that more time than they have has passed.
        while time.monotonic() - begun < 2 * SOON:
            with connected(url) as other:
                other.sendall(head("POST", stream, "Content-Length: 9"))
                assert answer(other)[0] == 408
        connection.sendall(b"0\r\n\r\n")
        assert answer(connection)[:2] == (202, {"accepted": 1})


def test_the_service_answers_others_meanwhile(url: str, http: httpx.Client, stream: str) -> None:
    with ExitStack() as stack:
        slow = [stack.enter_context(connected(url)) for _ in range(10)]
        for connection in slow:
            connection.sendall(head("POST", stream, "Content-Length: 1000") + b"{")
        assert http.post(stream, content=SAMPLE).status_code == 202
        assert [answer(connection)[0] for connection in slow] == [408] * 10
    assert refusals(http, "slow body") == 10


def test_a_slow_body_of_a_get_ends_its_event_stream(
    url: str, http: httpx.Client, stream: str
) -> None:
    """Nobody reads it, and it must not keep the listener for ever, nor end in a failure."""
    with connected(url) as connection:
        connection.sendall(head("GET", "/streams/s/events", "Content-Length: 1000"))
        assert rest(connection).startswith(b"HTTP/1.1 200 ")
    assert 'status="500"' not in http.get("/metrics").text


def test_what_comes_slowly_has_until_a_deadline_that_moves_with_it() -> None:
    async def nothing(scope: Scope, receive: Receive, send: Send) -> None:
        """Never called."""

    limit = BodyLimit(nothing, 1, 1, timeout=30.0, rate=500)
    assert limit.deadline(100.0, 0) == 100 + GRACE
    assert limit.deadline(100.0, 5_000) == 100 + GRACE + 10
    assert limit.deadline(100.0, 1_000_000) == 130
    assert BodyLimit(nothing, 1, 1, timeout=30.0, rate=0).deadline(100.0, 0) == 130


# -- heads -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("sent", [b"", b"GET /healthz HTT", b"GET /healthz HTTP/1.1\r\nHost: lo"])
def test_a_connection_on_which_no_request_comes_is_closed(
    url: str, http: httpx.Client, sent: bytes
) -> None:
    with connected(url) as connection:
        connection.sendall(sent)
        assert rest(connection) == b""
    assert refusals(http, "silent connection") >= 1


def is_closed_on(connection: socket.socket, drop: bytes) -> bool:
    """Whether the service closes a connection into which ``drop`` trickles again and again."""
    connection.settimeout(0.02)
    begun = time.monotonic()
    closed = False
    while not closed and time.monotonic() - begun < LONG:
        try:
            connection.sendall(drop)
            closed = connection.recv(4096) == b""
        except TimeoutError:
            continue
        except OSError:
            closed = True
    return closed


def test_a_head_that_trickles_is_no_request(url: str) -> None:
    with connected(url) as connection:
        connection.sendall(b"GET /healthz HTTP/1.1\r\nHost: localhost\r\n")
        assert is_closed_on(connection, b"X-Slow: 1\r\n")


def test_so_is_a_second_request_of_a_connection(url: str) -> None:
    with connected(url) as connection:
        connection.sendall(head("GET", "/healthz"))
        assert answer(connection)[0] == 200
        connection.sendall(b"GET /healthz HTTP/1.1\r\n")
        assert rest(connection) == b""


def test_a_body_that_nobody_wants_does_not_keep_its_connection(url: str) -> None:
    """Answered before it was there; what trickles in then is no sign of life."""
    with connected(url) as connection:
        connection.sendall(head("POST", "/nothing", "Content-Length: 1000000"))
        assert answer(connection)[0] == 404
        assert is_closed_on(connection, b" ")


def test_a_connection_in_use_stays(url: str) -> None:
    with connected(url) as connection:
        begun = time.monotonic()
        while time.monotonic() - begun < 4 * SOON:
            connection.sendall(head("GET", "/healthz"))
            assert answer(connection)[0] == 200


def test_an_event_stream_stays(url: str, http: httpx.Client, stream: str) -> None:
    with http.stream("GET", "/streams/s/events") as events:
        lines = events.iter_lines()
        assert next(lines)
        begun = time.monotonic()
        while time.monotonic() - begun < 4 * SOON:
            assert http.get("/healthz").status_code == 200
        assert http.post(stream, content=SAMPLE).status_code == 202
        assert any(line == "event: sample" for line in lines)


@pytest.mark.parametrize("begin", [b"GET /", b"GET /healthz HTTP/1.1\r\nX-Large: "])
def test_a_head_without_end_is_refused(url: str, http: httpx.Client, begin: bytes) -> None:
    """In one line, which the parser hands on only when it is there."""
    with connected(url) as connection:
        connection.sendall(begin)
        received = b""
        try:
            for _ in range(200):  # 12 MB, far more than is read before it is refused
                connection.sendall(b"x" * HEAD_LIMIT)
        except OSError:
            pass
        received = rest(connection)
        assert received == b"" or received.startswith(b"HTTP/1.1 431 ")
    assert refusals(http, "head too large") == 1


def test_so_is_one_that_comes_during_an_answer(url: str, http: httpx.Client, stream: str) -> None:
    with connected(url) as connection:
        connection.sendall(head("GET", "/streams/s/events"))
        assert connection.recv(16).startswith(b"HTTP/1.1 200")
        connection.sendall(b"GET /")
        assert flood(connection, b"x" * HEAD_LIMIT) < 20_000_000
    assert refusals(http, "head too large") == 1


def test_a_large_head_is_told_so(url: str, http: httpx.Client) -> None:
    with connected(url) as connection:
        connection.sendall(b"GET /healthz HTTP/1.1\r\nHost: localhost\r\nX-Large: ")
        for _ in range(9):  # in reads of their own
            connection.sendall(b"x" * (HEAD_LIMIT // 8))
            assert http.get("/healthz").status_code == 200
        status, problem, headers = answer(connection)
        assert (status, problem["title"]) == (431, "head too large")
        assert problem["instance"] == f"urn:dyknow:request:{headers['x-request-id']}"


def test_many_small_requests_are_no_large_head(url: str) -> None:
    with connected(url) as connection:
        for _ in range(50):
            connection.sendall(head("GET", "/healthz", "X-Padding: " + "x" * 4096))
            assert answer(connection)[0] == 200


def test_a_large_body_after_an_early_answer_is_no_large_head(url: str) -> None:
    with connected(url) as connection:
        connection.sendall(
            head("POST", "/nothing", f"Content-Length: {4 * HEAD_LIMIT}") + b" " * 4 * HEAD_LIMIT
        )
        assert answer(connection)[0] == 404
        connection.sendall(head("GET", "/healthz"))
        assert answer(connection)[0] == 200


# -- between and after the chunks ------------------------------------------------------------------

CHUNKED = "Transfer-Encoding: chunked"


def flood(connection: socket.socket, drop: bytes) -> int:
    """How many bytes of ``drop``, again and again, are taken before the connection is closed, at
    most 20 MB."""
    sent = 0
    try:
        while sent < 20_000_000:
            sent += connection.send(drop)
    except OSError:
        pass
    return sent


def told(connection: socket.socket) -> bool:
    """Whether the connection has ended, with the reason if it could be heard."""
    received = rest(connection)
    return received == b"" or received.startswith((b"HTTP/1.1 431 ", b"HTTP/1.1 404 "))


@pytest.mark.parametrize("path", ["/streams/s/samples", "/streams/s/samples/live", "/session"])
@pytest.mark.parametrize(
    ("begin", "drop"),
    [
        (b"0\r\n", b"X: a\r\n" * 10_000),
        (b"0\r\nX: ", b"a" * HEAD_LIMIT),
        (b"1;", b"a" * HEAD_LIMIT),
        (b"0\r\n" + b"X: a\r\n" * TRAILERS, b"X: a\r\n" * 10_000),
    ],
    ids=["many trailers", "a long trailer", "a long chunk extension", "some more trailers"],
)
def test_what_is_no_body_within_a_body_is_bounded(
    url: str, http: httpx.Client, stream: str, path: str, begin: bytes, drop: bytes
) -> None:
    """The service does not take 20 MB of it, as what is kept by sockets may be."""
    with connected(url) as connection:
        connection.sendall(head("POST", path, CHUNKED) + begin)
        assert flood(connection, drop) < 20_000_000
        assert told(connection)
    assert refusals(http, "framing too large") == 1
    assert http.get("/streams/s").json()["counters"]["accepted"] == 0


def test_trailers_after_an_answer_are_bounded(url: str, http: httpx.Client) -> None:
    """Nobody waits for the body of a route that there is not; its trailers came all the same."""
    with connected(url) as connection:
        connection.sendall(head("POST", "/nothing", CHUNKED))
        assert answer(connection)[0] == 404
        connection.sendall(b"0\r\n")
        assert flood(connection, b"X: a\r\n" * 10_000) < 20_000_000
        assert rest(connection) == b""
    assert refusals(http, "framing too large") == 1


@pytest.mark.parametrize("begin", [b"0\r\n", b"1;"])
def test_it_is_told(url: str, http: httpx.Client, stream: str, begin: bytes) -> None:
    """In reads of its own, so that all is read when the connection is closed."""
    lines = b"X: a\r\n" * (TRAILERS + 2) if begin == b"0\r\n" else b"x" * (HEAD_LIMIT // 8)
    with connected(url) as connection:
        connection.sendall(head("POST", f"{stream}/live", CHUNKED, "Expect: 100-continue"))
        assert connection.recv(4096).startswith(b"HTTP/1.1 100 ")
        connection.sendall(begin)
        for _ in range(9 if begin == b"1;" else 1):
            connection.sendall(lines)
            assert http.get("/healthz").status_code == 200
        status, problem, headers = answer(connection)
        assert (status, problem["title"]) == (431, "framing too large")
        assert problem["hint"]
        assert headers["x-request-id"] in problem["instance"]
        assert rest(connection) == b""


def test_trailers_are_no_headers(url: str, http: httpx.Client, stream: str) -> None:
    """What comes after the body cannot say whose it is, or what it is."""
    body = b"%x\r\n%s\r\n0\r\n" % (len(SAMPLE), SAMPLE)
    with connected(url) as connection:
        connection.sendall(head("POST", stream, CHUNKED))
        connection.sendall(body + b"Content-Type: text/html\r\nIdempotency-Key: 1\r\n\r\n")
        assert answer(connection)[:2] == (202, {"accepted": 1})
        # Were the trailer a header, this would be the same batch, and not be counted.
        connection.sendall(head("POST", stream, CHUNKED) + body + b"Idempotency-Key: 1\r\n\r\n")
        assert answer(connection)[0] == 202
    counters = http.get("/streams/s").json()["counters"]
    assert (counters["accepted"], counters["duplicate"]) == (2, 1)


def test_small_chunks_with_extensions_are_taken(url: str, http: httpx.Client, stream: str) -> None:
    """All together more than a head may have: what is bounded stands between two chunks."""
    lines = 40
    with connected(url) as connection:
        connection.sendall(head("POST", f"{stream}/live", CHUNKED))
        for _ in range(lines):
            extension = b"x" * (HEAD_LIMIT // 20)
            connection.sendall(b"%x;%s\r\n%s\r\n" % (len(SAMPLE), extension, SAMPLE))
        connection.sendall(b"0\r\nX: a\r\n\r\n")
        assert answer(connection)[:2] == (202, {"accepted": lines})


# -- how many --------------------------------------------------------------------------------------


def test_connections_of_one_address_are_bounded(url: str, http: httpx.Client) -> None:
    http.close()  # its connection would be one of them
    with ExitStack() as stack:
        # Event streams are held for good.
        held = [stack.enter_context(connected(url)) for _ in range(12)]
        for connection in held:
            connection.sendall(head("GET", "/status/events"))
            assert connection.recv(16).startswith(b"HTTP/1.1 200")
        with connected(url) as one_more:
            one_more.sendall(head("GET", "/healthz"))
            status, problem, headers = answer(one_more)
            assert status == 503
            assert problem["title"] == "too many connections"
            assert "12 connections from your address" in problem["detail"]
            assert headers["retry-after"]
            assert rest(one_more) == b""
        with connected(url) as silent:
            assert rest(silent) == b""
        held[0].close()
        until(lambda: is_heard(url))


def is_heard(url: str) -> bool:
    """Whether there is a place for a connection: that one is gone is heard of when it is."""
    return httpx.get(f"{url}/healthz", trust_env=False, timeout=60).status_code == 200


def test_a_flood_of_connections_is_let_go(
    engine: Engine, settings: Settings, clock: Clock, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Some receive an answer, the service closes the others at once: each holds a descriptor."""
    monkeypatch.setattr(connection_limits, "PATIENCE", 10 * LONG)
    patient = settings.model_copy(update={"head_timeout": 10 * LONG})
    with ExitStack() as stack:
        url = stack.enter_context(running(create_app(engine, patient, clock), patient))
        held = [stack.enter_context(connected(url)) for _ in range(12)]
        for connection in held:
            connection.sendall(head("GET", "/status/events"))
            assert connection.recv(16).startswith(b"HTTP/1.1 200")
        flood = [stack.enter_context(connected(url)) for _ in range(2 * REFUSED)]
        assert [rest(connection) for connection in flood[REFUSED:]] == [b""] * REFUSED
        flood[0].sendall(head("GET", "/healthz"))
        assert answer(flood[0])[0] == 503
        held[0].close()
        until(lambda: is_heard(url))


def test_a_client_that_leaves_ends_the_request_before_the_last_one(
    url: str, http: httpx.Client, stream: str
) -> None:
    """The event stream would wait for ever: uvicorn ends the last request of the pipeline only."""
    with connected(url) as connection:
        connection.sendall(head("GET", "/streams/s/events") + 2 * head("GET", "/healthz"))
        assert connection.recv(16).startswith(b"HTTP/1.1 200")
        until(lambda: "dyknow_event_stream_clients 1" in http.get("/metrics").text)
    until(lambda: "dyknow_event_stream_clients 0" in http.get("/metrics").text)


def test_what_is_no_http_is_told_in_a_problem(url: str, http: httpx.Client) -> None:
    with connected(url) as connection:
        connection.sendall(b"\x16\x03\x01\x02\x00\x01\x00\r\n\r\n")
        status, problem, headers = answer(connection)
        assert (status, problem["title"]) == (400, "bad request")
        assert headers["content-type"] == "application/problem+json"
        assert headers["x-content-type-options"] == "nosniff"
        assert problem["hint"]
        assert problem["instance"] == f"urn:dyknow:request:{headers['x-request-id']}"
    assert refusals(http, "bad request") == 1


def test_a_bound_that_is_reached_is_counted(url: str) -> None:
    with ExitStack() as stack:
        for _ in range(12):
            connection = stack.enter_context(connected(url))
            connection.sendall(head("GET", "/status/events"))
            assert connection.recv(16).startswith(b"HTTP/1.1 200")
        assert httpx.get(f"{url}/healthz", trust_env=False, timeout=60).status_code == 503
    until(lambda: is_heard(url))
    assert "too many connections" in httpx.get(f"{url}/metrics", trust_env=False, timeout=60).text


def test_bounds_count_what_is_there() -> None:
    settings = Settings(max_connections=3, max_connections_per_client=2)
    counted = ConnectionLimits(settings, lambda _: None)
    assert [counted.admit(address) is None for address in ("a", "a", "a", "b", "c")] == [
        True,
        True,
        False,
        True,
        False,
    ]
    counted.leave("a")
    assert counted.admit("c") is None
    assert "the service has 3" in str(counted.admit("d"))
    for address in ("a", "b", "c"):
        counted.leave(address)
    assert counted.count == 0


def test_a_stop_does_not_wait_for_silent_connections(
    engine: Engine, clock: Clock, settings: Settings
) -> None:
    with ExitStack() as stack:
        with running(create_app(engine, settings, clock), settings) as url:
            connection = stack.enter_context(connected(url))
            connection.sendall(b"GET /healthz HTT")
            assert httpx.get(f"{url}/healthz", trust_env=False, timeout=60).status_code == 200
        assert rest(connection) == b""
