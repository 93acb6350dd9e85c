"""Tokens that change while the service runs: taken without a restart, or refused and told."""

from __future__ import annotations

import json
import logging
import os
import signal
import socket
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest
from asking import asking
from launching import SERVICE
from prometheus_client.parser import text_string_to_metric_families
from serving import Serving
from waiting import until

from dyknow.engine.engine import Engine
from dyknow.service.admission import token_file
from dyknow.service.admission.tokens import Scope, Tokens, read_tokens
from dyknow.service.app import create_app
from dyknow.service.config.logs import LOG_NAME
from dyknow.service.config.settings import Settings
from dyknow.service.runtime.context import Service
from dyknow.service.server import running
from dyknow.service.sse.clients import EventClient, EventClients
from dyknow.streams.time import Clock

ADMIN, READ, OTHER = (f"{name}-0123456789-0123456789" for name in ("admin", "read", "other"))
OWN = {"Sec-Fetch-Site": "same-origin"}


def bearer(token: str) -> dict[str, str]:
    return {"Authorization": f"Bearer {token}"}


def write(path: Path, *lines: str) -> None:
    """As an editor does that keeps the file whole."""
    new = path.with_suffix(".new")
    new.write_text("\n".join(lines))
    new.chmod(0o600)
    new.replace(path)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    found = tmp_path / "tokens.txt"
    write(found, f"admin me {ADMIN}", f"read dash {READ}")
    return found


@pytest.fixture
def settings(path: Path) -> Settings:
    return Settings(port=0, tick=0.02, sse_ping=0, tokens_file=path)


@pytest.fixture
def service(
    engine: Engine, settings: Settings, clock: Clock, monkeypatch: pytest.MonkeyPatch
) -> Iterator[tuple[Service, httpx.Client]]:
    monkeypatch.setattr(token_file, "EVERY", 0.05)
    app = create_app(engine, settings, clock)
    with (
        running(app, settings) as url,
        asking(url) as http,
    ):
        yield app.state.service, http


def may(http: httpx.Client, token: str) -> int:
    return http.get("/streams", headers=bearer(token)).status_code


def reloads(http: httpx.Client, outcome: str) -> float:
    text = http.get("/metrics", headers=bearer(ADMIN)).text
    return next(
        sample.value
        for family in text_string_to_metric_families(text)
        for sample in family.samples
        if sample.name == "dyknow_tokens_reloads_total" and sample.labels["outcome"] == outcome
    )


def test_a_file_that_changes_is_taken(service: tuple[Service, httpx.Client], path: Path) -> None:
    _, http = service
    assert (may(http, READ), may(http, OTHER)) == (200, 401)
    write(path, f"admin me {ADMIN}", f"read other {OTHER}")
    until(lambda: may(http, OTHER) == 200)
    assert may(http, READ) == 401
    assert reloads(http, "taken") == 1


@pytest.mark.parametrize("broken", ["", "read", f"root me {ADMIN}", None])
def test_a_file_that_cannot_be_used_changes_nothing(
    service: tuple[Service, httpx.Client],
    path: Path,
    caplog: pytest.LogCaptureFixture,
    broken: str | None,
) -> None:
    _, http = service
    with caplog.at_level(logging.INFO, LOG_NAME):
        if broken is None:
            path.unlink()
        else:
            write(path, broken)
        until(lambda: reloads(http, "refused") == 1)
        assert (may(http, ADMIN), may(http, READ), may(http, OTHER)) == (200, 200, 401)
        # It is told once, not at each look, and nothing of a line is.
        time.sleep(0.3)
        assert reloads(http, "refused") == 1
        (line,) = (record for record in caplog.records if "not taken" in str(record.msg))
        assert (line.levelname, ADMIN in str(line.msg)) == ("ERROR", False)
        write(path, f"admin me {ADMIN}", f"read other {OTHER}")
        until(lambda: may(http, OTHER) == 200)


def test_a_file_that_others_could_read_is_taken_once_they_cannot(
    service: tuple[Service, httpx.Client], path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    _, http = service
    with caplog.at_level(logging.INFO, LOG_NAME):
        new = path.with_suffix(".new")
        new.write_text(f"admin me {ADMIN}\nread other {OTHER}")
        new.chmod(0o644)
        new.replace(path)
        until(lambda: reloads(http, "refused") == 1)
        (line,) = (record for record in caplog.records if "not taken" in str(record.msg))
        assert "chmod 600" in str(line.msg)
        path.chmod(0o600)
        until(lambda: may(http, OTHER) == 200)


def test_a_file_that_is_being_written_is_waited_for(
    service: tuple[Service, httpx.Client], path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is read when two looks have found the same."""
    _, http = service
    looks = iter(range(10**6))

    def looked(path: Path) -> object:
        return next(looks)

    with monkeypatch.context() as changing:
        changing.setattr(token_file, "_stamp_of", looked)
        write(path, f"admin me {ADMIN}")
        until(lambda: next(looks) > 10)
        assert may(http, READ) == 200
    until(lambda: may(http, READ) == 401)


def test_streams_and_sessions_of_a_revoked_token_end(
    service: tuple[Service, httpx.Client], path: Path
) -> None:
    running_service, http = service
    http.put("/streams/s", json={"fields": {"n": "integer"}}, headers=bearer(ADMIN))
    answer = http.post("/session", json={"token": READ}, headers=OWN)
    cookie = {"Cookie": answer.headers["set-cookie"].partition(";")[0], **OWN}
    http.cookies.clear()
    assert http.get("/streams", headers=cookie).status_code == 200
    ends: dict[str, str] = {}

    def follow(name: str, headers: dict[str, str]) -> None:
        try:
            with asking(http.base_url) as client:
                client.get("/streams/s/events", headers=headers)
            ends[name] = "whole"
        except httpx.TransportError as error:
            ends[name] = type(error).__name__

    readers = {"read": bearer(READ), "session": cookie, "admin": bearer(ADMIN)}
    threads = [threading.Thread(target=follow, args=each) for each in readers.items()]
    for thread in threads:
        thread.start()
    until(lambda: running_service.feeds.clients == 3)
    # A token of the same name takes the place of the old one: it is not the same token.
    write(path, f"admin me {ADMIN}", f"read dash {OTHER}")
    until(lambda: len(ends) == 2)
    assert ends.keys() == {"read", "session"}
    assert "whole" not in ends.values()
    assert running_service.feeds.clients == 1
    assert running_service.feeds.all.ends["revoked"] == 2
    assert http.get("/streams", headers=cookie).status_code == 401
    http.delete("/streams/s", headers=bearer(ADMIN))
    for thread in threads:
        thread.join(120)
    assert ends["admin"] == "whole"


def test_a_token_that_loses_the_scope_loses_its_streams_and_sessions(
    service: tuple[Service, httpx.Client], path: Path
) -> None:
    running_service, http = service
    http.put("/streams/s", json={"fields": {"n": "integer"}}, headers=bearer(ADMIN))
    answer = http.post("/session", json={"token": READ}, headers=OWN)
    cookie = {"Cookie": answer.headers["set-cookie"].partition(";")[0], **OWN}
    http.cookies.clear()
    with http.stream("GET", "/streams/s/events", headers=bearer(READ)) as events:
        until(lambda: running_service.feeds.clients == 1)
        write(path, f"admin me {ADMIN}", f"publish dash {READ}")
        with pytest.raises(httpx.TransportError):
            events.read()
    assert http.get("/streams", headers=cookie).status_code == 403


def test_a_live_body_of_a_revoked_token_ends_with_what_was_accepted(
    service: tuple[Service, httpx.Client], path: Path
) -> None:
    running_service, http = service
    write(path, f"admin me {ADMIN}", f"publish gw {OTHER}")
    until(lambda: may(http, OTHER) == 403)
    http.put("/streams/s", json={"fields": {"n": "integer"}}, headers=bearer(ADMIN))
    host, port = str(http.base_url).removeprefix("http://").rstrip("/").split(":")
    with socket.create_connection((host, int(port)), timeout=120) as sender:
        head = (
            "POST /streams/s/samples/live HTTP/1.1\r\nHost: localhost\r\n"
            f"Authorization: Bearer {OTHER}\r\nContent-Type: application/x-ndjson\r\n"
            "Transfer-Encoding: chunked\r\n\r\n"
        )
        line = b'{"valid": 0, "n": 1}\n'
        sender.sendall(head.encode() + b"%x\r\n%s\r\n" % (len(line), line))
        until(lambda: running_service.engine.generator("s").counters.accepted == 1)
        write(path, f"admin me {ADMIN}")
        answer = b""
        while part := sender.recv(4096):
            answer += part
    status, _, body = answer.partition(b"\r\n\r\n")
    assert status.startswith(b"HTTP/1.1 401 ")
    problem = json.loads(body)
    assert (problem["title"], problem["accepted"]) == ("not authenticated", 1)


def test_an_answer_that_begins_after_its_token_has_gone_is_cut_off(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    cuts: list[str] = []
    monkeypatch.setattr(EventClient, "cut", lambda client, reason: cuts.append(reason))
    tokens = Tokens(read_tokens(f"read dash {READ}", "f").items())
    clients = EventClients(10, 10, 0, 30, tokens)
    caller = tokens.caller(READ.encode())
    client = clients.admit("x", caller)
    clients.check(client)
    assert cuts == []
    tokens.replace(Tokens(read_tokens(f"read dash {OTHER}", "f").items()))
    clients.check(client)
    assert cuts == ["revoked"]


def test_tokens_of_this_process_stay() -> None:
    tokens = Tokens(read_tokens(f"read dash {READ}", "f").items())
    own = tokens.issue("flights", Scope.ADMIN)
    tokens.replace(Tokens(read_tokens(f"read dash {OTHER}", "f").items()))
    assert tokens.caller(own.encode()) is not None
    assert tokens.caller(READ.encode()) is None


def test_a_pipe_is_read_once(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe, 0o600)
    writer = threading.Thread(target=lambda: pipe.write_text(f"read dash {READ}"))
    writer.start()
    tokens = Tokens.of(Settings(tokens_file=pipe))
    writer.join()
    assert tokens.stamp is None
    assert tokens.caller(READ.encode()) is not None


def test_sighup_takes_them_at_once(path: Path) -> None:
    # Only who asks gets it within the second that two looks are apart.
    rarely = "from dyknow.service.admission import token_file; token_file.EVERY = 3600\n"
    with Serving(None, "--tokens", str(path), program=rarely + SERVICE) as serving:
        http = serving.http
        assert (may(http, READ), may(http, OTHER)) == (200, 401)
        write(path, f"admin me {ADMIN}", f"read other {OTHER}")
        serving.process.send_signal(signal.SIGHUP)
        until(lambda: may(http, OTHER) == 200)
        assert may(http, READ) == 401
        assert serving.stop() == 0
    assert "tokens taken" in serving.log
