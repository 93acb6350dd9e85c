"""`GET /requests`: the recent HTTP requests, and `GET /journal`: what the data directory holds."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest
from waiting import until

from dyknow.engine.durability.durable_engine import RecordedEngine
from dyknow.engine.engine import Engine
from dyknow.journal.durability import Durability
from dyknow.service.admission.tokens import new_token
from dyknow.service.app import create_app
from dyknow.service.client.client import Client
from dyknow.service.config.recent_requests import KEPT, LONGEST
from dyknow.service.config.settings import Settings
from dyknow.service.server import running


def found(http: httpx.Client, **parameters: Any) -> list[dict[str, Any]]:
    answer = http.get("/requests", params=parameters)
    assert answer.status_code == 200, answer.text
    return list(answer.json())


def test_requests_are_newest_first_with_status_size_and_route(http: httpx.Client) -> None:
    http.put("/streams/s", json={"fields": {"x": "float"}}, headers={"X-Request-Id": "mine"})
    plain = http.get("/vocabulary", headers={"Accept-Encoding": "identity"})
    packed = http.get("/vocabulary", headers={"Accept-Encoding": "gzip"})
    (first, second, third) = found(http, limit=3)
    assert (third["method"], third["path"], third["status"]) == ("PUT", "/streams/s", 201)
    assert (third["route"], third["id"], third["problem"]) == ("/streams/{name}", "mine", None)
    assert second["size"] == len(plain.content)
    assert 0 < first["size"] < second["size"]
    assert first["size"] == packed.num_bytes_downloaded
    assert first["milliseconds"] > 0
    assert third["time"] <= second["time"] <= first["time"]


def test_refused_requests_have_the_type_of_their_problem(http: httpx.Client) -> None:
    refused = [
        ("GET", "/streams/none", {}, 404, "unknown-stream"),
        ("GET", "/nowhere", {}, 404, "no-such-route"),
        ("DELETE", "/status", {}, 405, "method-not-allowed"),
        ("POST", "/match", {"content": b"{"}, 400, "bad-json"),
        ("POST", "/match", {"json": {}}, 422, "values-do-not-fit"),
        ("GET", "/status", {"headers": {"Origin": "http://evil.org"}}, 403, None),
        ("POST", "/match", {"content": b" " * (2 << 20)}, 413, "body-too-large"),
    ]
    for method, path, more, status, _ in refused:
        assert http.request(method, path, **more).status_code == status, path
    http.get("/healthz")
    listed = found(http, status=400)
    assert len(listed) == len(refused)
    for each, (method, path, _, status, problem) in zip(reversed(listed), refused, strict=True):
        assert (each["method"], each["path"], each["status"]) == (method, path, status)
        assert each["problem"].startswith("urn:dyknow:problem:")
        assert problem is None or each["problem"].endswith(f":{problem}")
    assert [each["route"] for each in listed][-2:] == [None, "/streams/{name}"]
    assert found(http, status=500) == []


def test_no_query_no_token_and_no_long_path_is_shown(http: httpx.Client) -> None:
    token = new_token()
    http.get("/streams", params={"token": token})
    http.get(f"/streams/{token}")
    http.get("/" + "x" * 2 * LONGEST)
    text = http.get("/requests").text
    assert token not in text
    assert "/streams/dyk_***" in text
    assert "token" not in text
    assert max(len(each["path"]) for each in found(http)) == LONGEST


def test_the_number_of_requests_is_bounded(http: httpx.Client, engine: Engine) -> None:
    for _ in range(KEPT + 5):
        http.get("/healthz")
    assert len(found(http, limit=KEPT)) == KEPT
    assert http.get("/requests", params={"limit": KEPT + 1}).status_code == 422
    assert http.get("/requests", params={"status": 99}).status_code == 422


def test_a_follower_is_listed_when_it_has_left(http: httpx.Client, client: Client) -> None:
    client.put_stream("s", {"x": "float"})

    def is_listed() -> bool:
        return "/streams/s/events" in [each["path"] for each in client.http_requests()]

    with http.stream("GET", "/streams/s/events") as answer:
        lines = answer.iter_lines()  # the connection ends with it
        assert next(lines)
        assert not is_listed()
    until(is_listed)


def test_head_sends_no_bytes(http: httpx.Client) -> None:
    http.head("/vocabulary")
    (head,) = found(http, limit=1)
    assert (head["method"], head["size"], head["status"]) == ("HEAD", 0, 200)


def test_without_a_data_directory_the_journal_says_so(
    client: Client, recorded: RecordedEngine | None
) -> None:
    if recorded is None:
        nothing = {"log": None, "checkpoint": None, "free": None, "failing": []}
        assert client.journal() == {"recording": False, **nothing}


@pytest.fixture
def kept(tmp_path: Path, settings: Settings, clock: Any) -> Iterator[tuple[Client, RecordedEngine]]:
    """A service with a data directory, where only the end of the service makes checkpoints."""
    recorded = RecordedEngine(tmp_path / "kept", now=0, durability=Durability.WRITE)
    with (
        running(create_app(recorded, settings, clock), settings) as url,
        Client(url, timeout=120) as client,
    ):
        yield client, recorded


def test_the_journal_tells_the_log(kept: tuple[Client, RecordedEngine], tmp_path: Path) -> None:
    client, _ = kept
    client.put_stream("s", {"x": "float"})
    before = client.journal()
    client.publish("s", [{"valid": 1, "x": 1.0}])
    after = client.journal()
    assert after["recording"]
    assert after["checkpoint"] is None
    assert after["failing"] == []
    log = after["log"]
    assert (log["first"], log["segments"]) == (1, 1)
    assert log["last"] > before["log"]["last"] >= 1
    assert log["replayed"] == log["last"]
    files = list((tmp_path / "kept" / "journal").glob("*.log"))
    assert log["bytes"] == sum(file.stat().st_size for file in files)
    assert after["free"] > 0


def test_the_journal_tells_the_checkpoint(tmp_path: Path, settings: Settings, clock: Any) -> None:
    for number in range(2):
        recorded = RecordedEngine(tmp_path / "kept", now=0, durability=Durability.WRITE)
        app = create_app(recorded, settings, clock)
        with running(app, settings) as url, Client(url, timeout=120) as client:
            client.put_stream(f"s{number}", {"x": "float"})
            found = client.journal()
    checkpoint, log = found["checkpoint"], found["log"]
    assert checkpoint["bytes"] > 0
    assert 1 <= checkpoint["position"] < log["last"]
    assert log["replayed"] == log["last"] - checkpoint["position"]
    # The clock of the test stands in 2021, before the file was written.
    assert checkpoint["age"] == 0


def test_a_disk_that_does_not_answer_is_a_problem(
    kept: tuple[Client, RecordedEngine], monkeypatch: pytest.MonkeyPatch
) -> None:
    client, recorded = kept

    def broken() -> None:
        raise OSError("input/output error")

    monkeypatch.setattr(recorded, "disk_use", broken)
    answer = httpx.get(f"{client.url}/journal", trust_env=False, timeout=60)
    assert answer.status_code == 503
    assert "input/output error" in answer.json()["detail"]
