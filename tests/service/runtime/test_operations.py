"""What operators see: metrics that add up and are documented, logs, request ids, readiness."""

from __future__ import annotations

import json
import logging
import re
import socket
import threading
import time
from collections.abc import Iterator

import httpx
import pytest
from asking import asking
from hosting import hosting
from places import ROOT
from prometheus_client.parser import text_string_to_metric_families
from structlog.stdlib import ProcessorFormatter

from dyknow.engine.engine import Engine
from dyknow.service.app import TICK, create_app
from dyknow.service.client.client import Client
from dyknow.service.config.logs import LOG_NAME, configure, log
from dyknow.service.config.settings import Settings
from dyknow.service.durability.command_queue import (
    CHECKPOINT,
    ENGINE,
    JOURNAL,
    SOURCES,
    CommandQueue,
)
from dyknow.service.runtime.context import LATE, Service
from dyknow.service.runtime.stream_metrics import escaped
from dyknow.service.runtime.warm_up import WarmUp
from dyknow.service.server import running
from dyknow.streams.time import SECOND, Clock

PAGE = ROOT / "docs" / "reference" / "metrics.md"
LINES = {"Content-Type": "application/x-ndjson"}


@pytest.fixture
def service_url(
    engine: Engine, settings: Settings, clock: Clock
) -> Iterator[tuple[Service, httpx.Client]]:
    with hosting(engine, settings, clock) as found:
        yield found


@pytest.fixture
def records(caplog: pytest.LogCaptureFixture) -> Iterator[pytest.LogCaptureFixture]:
    with caplog.at_level(logging.DEBUG, LOG_NAME):
        yield caplog


def told(records: pytest.LogCaptureFixture, event: str) -> list[dict[str, object]]:
    """What the service's own lines say, those of one event."""
    found = [record.msg for record in records.records if record.name == LOG_NAME]
    return [line for line in found if isinstance(line, dict) and line.get("event") == event]


def families(http: httpx.Client) -> dict[str, dict[str, float]]:
    """Values by metric and labels, as Prometheus reads them."""
    answer = http.get("/metrics")
    assert answer.headers["content-type"] == "text/plain; version=0.0.4; charset=utf-8"
    found: dict[str, dict[str, float]] = {}
    for family in text_string_to_metric_families(answer.text):
        for sample in family.samples:
            labels = ",".join(f"{key}={sample.labels[key]}" for key in sorted(sample.labels))
            values = found.setdefault(sample.name, {})
            assert labels not in values, (sample.name, labels)
            values[labels] = sample.value
    return found


def test_every_metric_is_on_the_page_and_the_other_way_round(
    service_url: tuple[Service, httpx.Client],
) -> None:
    _, http = service_url
    text = http.get("/metrics").text
    there = set(re.findall(r"^# TYPE (\w+) ", text, re.MULTILINE))
    # When a counter began is said by the client library, for histograms and counters alike.
    there = {name for name in there if not name.endswith("_created")}
    written = set(re.findall(r"^\| `((?:dyknow|process)_\w+)` \|", PAGE.read_text(), re.MULTILINE))
    assert written == there


def test_units_streams_and_lag_are_told(
    service_url: tuple[Service, httpx.Client], clock: Clock
) -> None:
    _, http = service_url
    http.put("/streams/s5", json={"fields": {"id": "string", "spd": "float"}})
    http.post("/annotations", content="stream s5 contains speed(UAV) = spd for every UAV = id")
    query = """REGISTER QUERY speeds AS SELECT ?o ?v
        FROM STREAM <http://www.ida.liu.se/dyknow/s5.trdf> [RANGE 1s STEP 1s]
        WHERE { ?o <http://www.ida.liu.se/dyknow/speed> ?v }"""
    assert http.post("/queries", content=query).status_code == 201
    last = clock() - 7 * SECOND
    rows = [{"available": last - i * SECOND, "valid": 0, "id": "a", "spd": 1.0} for i in range(5)]
    body = "\n".join(json.dumps(row) for row in reversed(rows))
    assert http.post("/streams/s5/samples", content=body, headers=LINES).status_code == 202
    found = families(http)
    assert found["dyknow_stream_lag_seconds"]["stream=s5"] == 7
    assert found["dyknow_stream_watermark_lag_seconds"]["stream=s5"] == 7
    ((labels, windows),) = found["dyknow_unit_windows_total"].items()
    assert "stream=speeds" in labels
    assert windows >= 3
    assert found["dyknow_unit_busy_seconds_total"].keys() == {labels}
    http.post("/streams/s5/end")
    assert "stream=s5" not in families(http)["dyknow_stream_lag_seconds"]


def test_bodies_under_way_are_counted(service_url: tuple[Service, httpx.Client]) -> None:
    _, http = service_url
    http.put("/streams/s5", json={"fields": {"n": "integer"}})
    seen: list[dict[str, dict[str, float]]] = []

    def body() -> Iterator[bytes]:
        yield b'{"valid": 1, '
        with asking(http.base_url) as other:
            limit = time.monotonic() + 120
            while not seen or not seen[-1]["dyknow_bodies_bytes"][""]:
                seen.append(families(other))
                assert time.monotonic() < limit
        yield b'"n": 2}'

    assert http.post("/streams/s5/samples", content=body(), headers=LINES).status_code == 202
    assert seen[-1]["dyknow_bodies_bytes"][""] == 13
    assert seen[-1]["dyknow_bodies"][""] == 2  # this one, and the question
    after = families(http)
    assert (after["dyknow_bodies_bytes"][""], after["dyknow_bodies"][""]) == (0, 1)


def test_the_loop_and_its_ticks_are_measured(service_url: tuple[Service, httpx.Client]) -> None:
    _, http = service_url
    limit = time.monotonic() + 120
    while families(http)["dyknow_event_loop_lag_seconds_count"][""] < 3:
        assert time.monotonic() < limit
    found = families(http)
    assert found["dyknow_tick_seconds_count"][""] >= 3
    assert found["process_resident_memory_bytes"][""] > 1e6
    assert list(found["dyknow_build_info"].values()) == [1]


def test_labels_are_escaped() -> None:
    name = 'pos["a\\b\nc"]'
    line = f'x{{stream="{escaped(name)}"}} 1.0\n'
    (family,) = text_string_to_metric_families(line)
    assert family.samples[0].labels == {"stream": name}


def test_a_request_has_one_id_everywhere(
    client: Client, http: httpx.Client, records: pytest.LogCaptureFixture
) -> None:
    given = http.get("/streams/nowhere", headers={"X-Request-Id": "me-1/x:2"})
    assert given.headers["x-request-id"] == "me-1/x:2"
    assert given.json()["instance"] == "urn:dyknow:request:me-1%2Fx%3A2"
    (refused,) = told(records, "refused")
    assert (refused["request"], refused["status"]) == ("me-1/x:2", 404)
    limit = time.monotonic() + 120
    while not told(records, "request"):  # it is written when the answer has been sent
        assert time.monotonic() < limit
    assert [line["request"] for line in told(records, "request")] == ["me-1/x:2"]
    made = [http.get("/healthz").headers["x-request-id"] for _ in range(2)]
    assert len(set(made)) == 2
    # What would be another line of the log, or of the head, is none.
    bad = http.get("/healthz", headers={"X-Request-Id": "x y"}).headers["x-request-id"]
    assert bad != "x y"
    long = http.get("/healthz", headers={"X-Request-Id": "x" * 101}).headers["x-request-id"]
    assert len(long) < 101
    # Also of what is refused before any route.
    body = b"x" * ((1 << 20) + 1)
    large = http.post("/kpl", content=body, headers={"X-Request-Id": "large"})
    assert (large.status_code, large.json()["instance"]) == (413, "urn:dyknow:request:large")


def test_a_failure_is_logged_with_its_trace_and_the_id(
    engine: Engine,
    http: httpx.Client,
    records: pytest.LogCaptureFixture,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def fail() -> None:
        raise RuntimeError("secret")

    monkeypatch.setattr(engine, "templates", fail)
    answer = http.get("/templates", headers={"X-Request-Id": "broken"})
    assert (answer.status_code, answer.json()["instance"]) == (500, "urn:dyknow:request:broken")
    assert "secret" not in answer.text
    (line,) = told(records, "request failed")
    assert line["request"] == "broken"
    assert line["exc_info"]


def test_slow_requests_are_warned_of(
    engine: Engine, settings: Settings, clock: Clock, records: pytest.LogCaptureFixture
) -> None:
    strict = settings.model_copy(update={"slow_request": 1e-9})
    with (
        running(create_app(engine, strict, clock), strict) as url,
        asking(url) as http,
    ):
        http.get("/status")
    (line,) = told(records, "slow request")
    assert (line["level"], line["path"], line["status"]) == ("warning", "/status", 200)


def test_json_lines_are_json(capsys: pytest.CaptureFixture[str], logger: logging.Logger) -> None:
    configure("info", as_json=True)
    assert isinstance(logger.handlers[0].formatter, ProcessorFormatter)
    log().info("serving", url="http://x", settings={"port": 1})
    try:
        raise ValueError("why")
    except ValueError:
        log().exception("request failed", request="r1")
    log().debug("not told")
    first, second = (json.loads(line) for line in capsys.readouterr().err.splitlines())
    assert (first["event"], first["level"], first["settings"]) == ("serving", "info", {"port": 1})
    assert re.fullmatch(r"\d{4}-\d\d-\d\dT[\d:.]+Z", first["timestamp"])
    assert (second["event"], second["request"]) == ("request failed", "r1")
    assert second["exception"].endswith("ValueError: why")


def test_not_ready_for_every_reason_there_is(service_url: tuple[Service, httpx.Client]) -> None:
    service, http = service_url
    limit = time.monotonic() + 120
    while http.get("/readyz").status_code == 503:  # it has just been started
        assert time.monotonic() < limit
    assert http.get("/readyz").json()["reasons"] == []
    service.troubles["journal"] = "the disk is full"
    answer = http.get("/readyz")
    assert answer.status_code == 503
    assert answer.json() == {
        "status": "failing",
        "reason": "journal: the disk is full",
        "reasons": ["journal: the disk is full"],
    }
    service.stop()
    assert len(http.get("/readyz").json()["reasons"]) == 2
    service.troubles.clear()
    assert http.get("/readyz").status_code == 200


def test_every_reason_is_on_the_page(engine: Engine, settings: Settings, clock: Clock) -> None:
    table = PAGE.read_text().partition("## Readiness")[2].partition("##")[0]
    rows = re.findall(r"^\| (`.+?`) \|", table, re.MULTILINE)
    written = {name for row in rows for name in re.findall(r"`(.+?)`", row)}
    app = create_app(engine, settings, clock)
    service: Service = app.state.service
    warming = service.warming = WarmUp()
    never = threading.Event()
    with pytest.MonkeyPatch.context() as still:
        still.setattr(WarmUp, "_run", lambda *arguments: never.wait(20))
        warming.loops()
        warming.application(app)
        for name in ("sparql", "windows"):
            warming.workers(name, service.isolation.pools["sparql"])
    service.isolation.pools["sparql"].failure = "no memory"
    service.memory.limit = 1
    service.stop()
    service.troubles |= dict.fromkeys((TICK, JOURNAL, CHECKPOINT, ENGINE, SOURCES), "why")
    found = service.reasons()
    service.ticked = time.monotonic() - LATE - 1
    found += [reason for reason in service.reasons() if "late" in reason]
    never.set()
    assert written == {reason.partition(":")[0] for reason in found}


def test_starting_and_a_late_tick_are_reasons(
    engine: Engine, settings: Settings, clock: Clock
) -> None:
    service: Service = create_app(engine, settings, clock).state.service
    assert [reason.partition(":")[0] for reason in service.reasons()] == ["starting"]
    service.ticked = time.monotonic()
    assert service.reasons() == []
    service.ticked -= LATE + 1
    (reason,) = service.reasons()
    assert "late" in reason
    service.troubles["tick"] = "ValueError: x"
    assert len(service.reasons()) == 2


def test_a_client_that_leaves_within_its_body_is_no_failure(
    url: str, http: httpx.Client, client: Client, records: pytest.LogCaptureFixture
) -> None:
    client.put_stream("s5", {"n": "integer"})
    host, _, port = url.removeprefix("http://").rpartition(":")
    with socket.create_connection((host, int(port))) as gone:
        gone.sendall(
            b"POST /streams/s5/samples HTTP/1.1\r\nHost: localhost\r\nContent-Length: 99\r\n\r\n{"
        )
    limit = time.monotonic() + 120
    while not told(records, "client left"):
        assert time.monotonic() < limit
        http.get("/healthz")
    assert told(records, "request failed") == []


def test_a_disk_that_does_not_answer_is_told_once(
    service_url: tuple[Service, httpx.Client],
    records: pytest.LogCaptureFixture,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    _, http = service_url

    async def silent(commands: CommandQueue) -> None:
        raise TimeoutError

    for _ in range(2):
        with monkeypatch.context() as patched:
            patched.setattr(CommandQueue, "disk_use", silent)
            for _ in range(3):
                assert http.get("/metrics").status_code == 200
        assert http.get("/metrics").status_code == 200
    found = told(records, "the disk does not say how full it is")
    assert [each["reason"] for each in found] == ["it did not answer in time"] * 2
