"""Samples stamped further ahead of the clock than their stream allows (SPEC §5)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import httpx
import pyarrow as pa
import pytest

from dyknow.converters.arrow.stream import bytes_of_table
from dyknow.engine.durability.commands import DeclareStream, Publish
from dyknow.engine.durability.durable_engine import RecordedEngine
from dyknow.engine.model.views import StreamDeclaration
from dyknow.service.client.client import Client
from dyknow.service.config.media_types import ARROW, NDJSON
from dyknow.streams.sample import Field, FieldType
from dyknow.streams.time import HOUR, MINUTE, SECOND, TIME_MAX, format_time

LINES = {"Content-Type": NDJSON}
FIELDS = {"v": "float"}


@pytest.fixture
def stream(client: Client) -> str:
    client.put_stream("s", FIELDS)
    return "s"


def line(available: int, valid: int = 0, v: float = 1.0) -> str:
    return f'{{"available": {available}, "valid": {valid}, "v": {v}}}\n'


def post(
    http: httpx.Client, body: str | bytes, kind: str = NDJSON, way: str = ""
) -> httpx.Response:
    return http.post(f"/streams/s/samples{way}", content=body, headers={"Content-Type": kind})


def counters(http: httpx.Client) -> dict[str, Any]:
    return dict(http.get("/streams/s").json()["counters"])


def test_one_wild_stamp_does_not_end_the_stream(
    http: httpx.Client, clock: Any, stream: str
) -> None:
    now = clock.now
    assert post(http, line(now)).status_code == 202
    answer = post(http, line(now + 1) + "\n" + line(TIME_MAX) + line(now + 2))
    assert answer.status_code == 400
    problem = answer.json()
    assert problem["type"] == "urn:dyknow:problem:ahead-of-the-clock"
    assert (problem["line"], problem["field"]) == (3, "available")
    assert problem["latest"] == format_time(now + HOUR)
    assert "2262" in problem["detail"]
    assert '"ahead": "oo"' in problem["hint"]
    # Nothing of it is taken, and the honest samples after it are in time.
    assert post(http, line(now + 3)).status_code == 202
    found = counters(http)
    assert (found["accepted"], found["used"], found["late"], found["ahead"]) == (2, 2, 0, 1)
    metrics = http.get("/metrics").text
    assert 'dyknow_batches_ahead_total{stream="s"} 1.0' in metrics


def test_the_bound_itself_is_taken_and_moves_with_the_clock(
    http: httpx.Client, clock: Any, stream: str
) -> None:
    edge = clock.now + HOUR
    assert post(http, line(edge)).status_code == 202
    assert post(http, line(edge + 1)).status_code == 400
    clock.now += 1
    assert post(http, line(edge + 1)).status_code == 202


def test_valid_times_are_no_matter(http: httpx.Client, clock: Any, stream: str) -> None:
    assert post(http, line(clock.now, valid=TIME_MAX)).status_code == 202
    http.put("/streams/stamped", json={"fields": FIELDS})
    body = f'{{"valid": {TIME_MAX}, "v": 1}}\n'
    assert http.post("/streams/stamped/samples", content=body, headers=LINES).status_code == 202


def test_the_setting_of_a_stream(http: httpx.Client, client: Client, clock: Any) -> None:
    def put(**more: Any) -> dict[str, Any]:
        answer = http.put("/streams/s", json={"fields": FIELDS, **more})
        assert answer.status_code in (200, 201), answer.text
        return dict(answer.json())

    assert put()["ahead"] == "1h"
    assert put(ahead="10m")["ahead"] == "10m"
    assert post(http, line(clock.now + 11 * MINUTE)).status_code == 400
    # It is changed while the stream is in use.
    assert post(http, line(clock.now)).status_code == 202
    assert put(ahead="oo")["ahead"] == "oo"
    assert http.get("/streams/s").json()["ahead"] == "oo"
    assert post(http, line(TIME_MAX - 1)).status_code == 202
    assert client.put_stream("t", FIELDS, ahead="oo")["ahead"] == "oo"
    text = "stream u contains speed(UAV) = v for every UAV = id"
    http.post("/annotations", content=text, headers={"Content-Type": "text/plain"})
    assert http.get("/streams/u").json()["ahead"] == "1h"
    assert http.put("/streams/s", json={"fields": FIELDS, "ahead": "soon"}).status_code == 422


def test_a_batch_that_was_taken_may_be_repeated_under_its_key(
    http: httpx.Client, clock: Any, stream: str
) -> None:
    key, body = {"Idempotency-Key": "1", **LINES}, line(clock.now + HOUR)
    assert http.post("/streams/s/samples", content=body, headers=key).status_code == 202
    clock.now -= SECOND  # a clock that is set back
    again = http.post("/streams/s/samples", content=body, headers=key)
    assert (again.status_code, again.json()) == (202, {"accepted": 1})
    assert counters(http)["ahead"] == 0


def test_live_samples_end_at_the_wild_one(http: httpx.Client, clock: Any, stream: str) -> None:
    now = clock.now
    answer = post(http, line(now) + line(TIME_MAX) + line(now + 1) + line(TIME_MAX), way="/live")
    assert answer.status_code == 400
    problem = answer.json()
    assert (problem["line"], problem["accepted"], problem["title"]) == (2, 1, "ahead of the clock")
    assert post(http, line(now + 1), way="/live").status_code == 202
    assert (counters(http)["accepted"], counters(http)["ahead"]) == (2, 1)


@pytest.mark.parametrize("way", ["", "/live"])
def test_arrow_names_the_row(http: httpx.Client, clock: Any, stream: str, way: str) -> None:
    def table(*available: int) -> bytes:
        columns = {"available": available, "valid": available, "v": [1.0] * len(available)}
        return bytes_of_table(pa.table(columns))

    now = clock.now
    answer = post(http, table(now, now + 1, TIME_MAX), ARROW, way)
    assert (answer.status_code, answer.json()["line"]) == (400, 3)
    assert post(http, table(now, now + 1), ARROW, way).status_code == 202
    assert (counters(http)["accepted"], counters(http)["ahead"]) == (2, 1)


def test_a_large_batch_is_judged_too(http: httpx.Client, clock: Any, stream: str) -> None:
    lines = [line(clock.now + i) for i in range(5_000)]
    lines[4_321] = line(TIME_MAX)
    answer = post(http, "".join(lines))
    assert (answer.status_code, answer.json()["line"]) == (400, 4_322)


def test_what_was_taken_is_not_judged_again(tmp_path: Path) -> None:
    """Neither by a later start, at whatever time, nor by one that knows no bound."""
    declaration = StreamDeclaration("s", (Field("v", FieldType.FLOAT),), ahead=0)
    body = line(TIME_MAX - 1).encode()
    recorded = RecordedEngine(tmp_path / "data", now=0)
    recorded.do(DeclareStream(declaration))
    recorded.do(Publish("s", "ndjson", body, 0))
    recorded.close(checkpoint=False)
    for checkpoint in (True, False):
        again = RecordedEngine(tmp_path / "data", now=0)
        assert again.engine.generator("s").ahead == 0
        assert again.engine.stream("s").counters.used == 1
        again.close(checkpoint=checkpoint)
