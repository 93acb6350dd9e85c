"""What runs, what is wrong and what may be named: /units, /problems, /vocabulary, and the ports of
streams."""

from __future__ import annotations

import logging
from typing import Any

import httpx
import pytest
from pydantic import SecretStr

from dyknow.engine.engine import Engine
from dyknow.service.app import create_app
from dyknow.service.config.logs import log
from dyknow.service.config.recent_log import KEPT, RecentLog
from dyknow.service.config.settings import Settings
from dyknow.service.server import running
from dyknow.streams.time import SECOND

GPS = "stream gps contains latitude(Car) = lat [deg], longitude(Car) = lon for every Car = car"
FIELDS = {"fields": {"car": "string", "lat": "float", "lon": "float"}}
QUERY = """REGISTER QUERY highest COMPUTE EVERY 1s AS
SELECT ?o (MAX(?a) AS ?top) WHERE { ?o a dyknow:Car ; dyknow:latitude ?a } GROUP BY ?o
WINDOW [RANGE 2s STEP 1s]"""


def declare(http: httpx.Client) -> None:
    assert http.put("/streams/gps", json=FIELDS).status_code == 201
    text = {"Content-Type": "text/plain"}
    assert http.post("/annotations", content=GPS, headers=text).status_code < 300


def publish(http: httpx.Client, times: list[int]) -> None:
    """Publish samples that are valid and available at ``times``."""
    lines = "\n".join(
        f'{{"valid": {time}, "available": {time}, "car": "c1", "lat": 1.5, "lon": {i}}}'
        for i, time in enumerate(times)
    )
    answer = http.post(
        "/streams/gps/samples", content=lines, headers={"Content-Type": "application/x-ndjson"}
    )
    assert answer.status_code == 202, answer.text


def test_a_stream_tells_the_features_of_its_fields(http: httpx.Client) -> None:
    declare(http)
    ports = {port["field"]: port for port in http.get("/streams/gps").json()["ports"]}
    assert ports["lat"]["feature"] == "dyknow:latitude"
    assert ports["lat"]["unit"] == "deg"
    assert ports["lat"]["of"] == [{"name": "dyknow:Car", "as": None, "id": "car", "every": True}]
    assert http.get("/streams/status").json()["ports"] == []


def test_units_are_listed_with_what_they_read_and_do(http: httpx.Client, clock: Any) -> None:
    declare(http)
    assert http.get("/units").json() == []
    assert http.post("/queries", content=QUERY).status_code == 201
    publish(http, [clock.now + i * SECOND for i in range(5)])
    (unit,) = http.get("/units").json()
    assert unit["inputs"] == ["gps"]
    assert unit["output"] == "highest"
    assert unit["windows"] > 0
    assert unit["failure"] is None
    assert http.get(f"/units/{unit['name']}").json()["inputs"] == ["gps"]
    assert http.get("/units/none").status_code == 404


def problems(http: httpx.Client) -> list[dict[str, Any]]:
    answer = http.get("/problems")
    assert answer.status_code == 200
    found: list[dict[str, Any]] = answer.json()
    return found


def test_a_silent_stream_is_a_problem_only_while_others_read_it(
    http: httpx.Client, clock: Any
) -> None:
    declare(http)
    publish(http, [clock.now - SECOND, clock.now])
    clock.now += 60 * SECOND
    assert problems(http) == []  # no unit waits for it
    assert http.post("/queries", content=QUERY).status_code == 201
    (silent,) = problems(http)
    assert silent["what"] == "gps is silent"
    assert silent["level"] == "warn"
    assert silent["stream"] == silent["name"] == "gps"
    assert "1m" in silent["detail"]
    publish(http, [clock.now])
    assert problems(http) == []


def test_a_slow_stream_is_not_silent_between_its_samples(http: httpx.Client, clock: Any) -> None:
    declare(http)
    assert http.post("/queries", content=QUERY).status_code == 201
    publish(http, [clock.now - 120 * SECOND, clock.now - 60 * SECOND, clock.now])
    clock.now += 60 * SECOND
    assert problems(http) == []
    clock.now += 3_600 * SECOND
    assert [each["name"] for each in problems(http)] == ["gps"]


def test_late_and_duplicate_samples_are_problems_from_a_share_on(
    http: httpx.Client, clock: Any
) -> None:
    declare(http)
    start = clock.now - 1_000 * SECOND
    publish(http, [start + i * SECOND for i in range(200)])
    assert problems(http) == []
    publish(http, [start + i * SECOND for i in range(10)])
    (late,) = problems(http)
    assert late["hint"] == "Declare a larger lateness."
    assert late["what"] == "5 % of gps arrive late"


def test_matches_that_a_limit_leaves_out_are_a_problem(http: httpx.Client, clock: Any) -> None:
    declare(http)
    text = (
        "REGISTER STREAM s AS PATTERN SEQ(latitude+ a[], longitude b) WHERE [id] WITHIN 5s LIMIT 1"
    )
    assert http.post("/queries", content=text).status_code == 201
    publish(http, [clock.now - 3 * SECOND, clock.now - 2 * SECOND])
    assert problems(http) == []
    publish(http, [clock.now - SECOND, clock.now])
    (lossy,) = problems(http)
    assert lossy["what"] == "Pattern s leaves matches out"
    assert lossy["detail"] == "Left out: 1 rows that complete more matches than the limit."
    assert lossy["stream"] == "s"


def test_a_failed_unit_is_the_first_problem(http: httpx.Client, clock: Any, engine: Engine) -> None:
    declare(http)
    assert http.post("/queries", content=QUERY).status_code == 201
    publish(http, [clock.now])
    (unit,) = engine.units()
    unit.failure = "error: broken"
    clock.now += 60 * SECOND
    found = problems(http)
    assert [each["level"] for each in found] == sorted(each["level"] for each in found)
    assert found[0]["level"] == "bad"
    assert found[0]["stream"] == "highest"
    assert found[0]["detail"].startswith("error: broken")


def test_a_subscription_without_a_plan_is_a_problem(http: httpx.Client) -> None:
    want = {"feature": "dyknow:speed", "sort": "dyknow:Human"}
    assert http.post("/subscriptions", json=want).status_code == 201
    (waiting,) = problems(http)
    assert waiting["kind"] == "request"
    assert "dyknow:latitude" in waiting["detail"]


def test_the_vocabulary_has_sorts_as_a_tree_and_features_with_units(http: httpx.Client) -> None:
    found = http.get("/vocabulary").json()
    parents = {each["name"]: each["parents"] for each in found["sorts"]}
    assert parents["dyknow:RMAX"] == ["dyknow:UAV"]
    assert parents["dyknow:Vehicle"] == ["dyknow:Thing"]
    assert parents["dyknow:Thing"] == []
    assert all(set(above) <= parents.keys() for above in parents.values())
    features = {each["name"]: each for each in found["features"]}
    assert features["dyknow:speed"]["unit"] == "km.h-1"
    assert features["dyknow:altitude"]["doc"]
    assert found["events"] == []
    assert found["prefixes"]["dyknow"] == "http://www.ida.liu.se/dyknow/"


def test_numbers_of_requests_make_no_views(
    http: httpx.Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    # A view of a request may take 0.1 s, and a scraper asks every few seconds.
    monkeypatch.setattr(Engine, "events", None)
    monkeypatch.setattr(Engine, "event", None)
    assert http.get("/status").json()["requests"] == 0
    assert "\ndyknow_event_requests 0" in http.get("/metrics").text


def test_the_status_tells_the_load(http: httpx.Client) -> None:
    load = http.get("/status").json()["load"]
    assert load["memory"] > 10_000_000
    assert load["processor"] > 0
    assert load["units_behind"] == 0


def test_the_log_is_read_newest_first_without_tokens(http: httpx.Client) -> None:
    # The service keeps lines from its start on, and its port is open a moment earlier.
    http.get("/log").raise_for_status()
    log().info("only info")
    log().warning("first", reason="Authorization: Bearer 0123456789abcdefghij", count=3)
    try:
        raise ValueError("broken")
    except ValueError:
        log().exception("second")
    found = http.get("/log").json()
    assert [line["event"] for line in found[:2]] == ["second", "first"]
    second, first = found[:2]
    assert (second["level"], second["values"]["error"]) == ("error", "ValueError: broken")
    assert first["values"] == {"reason": "Authorization: Bearer ***", "count": "3"}
    assert [line["event"] for line in http.get("/log", params={"level": "error"}).json()] == [
        "second"
    ]
    assert len(http.get("/log", params={"limit": 1}).json()) == 1
    assert http.get("/log", params={"level": "loud"}).status_code == 422


def test_the_log_keeps_a_bounded_number_of_lines() -> None:
    recent = RecentLog()
    recent.open()
    for i in range(KEPT + 10):
        log().warning("line", i=i)
    recent.close()
    log().warning("after")
    lines = recent.lines(logging.WARNING, 2 * KEPT)
    assert len(lines) == KEPT
    assert lines[0].values == {"i": str(KEPT + 9)}


def test_settings_that_differ_come_first_and_secrets_are_hidden(http: httpx.Client) -> None:
    found = http.get("/settings").json()
    names = [each["name"] for each in found if not each["is_default"]]
    assert {"port", "tick", "sse_ping"} <= set(names)
    assert [each["is_default"] for each in found] == sorted(each["is_default"] for each in found)
    (tick,) = [each for each in found if each["name"] == "tick"]
    assert tick["value"] == "0.02"


def test_the_tokens_of_the_settings_are_not_told() -> None:
    tokens = SecretStr("admin a admin-0123456789-0123456789")
    settings = Settings(port=0, tokens=tokens)
    app = create_app(Engine(epoch="e1"), settings, lambda: 0)
    with running(app, settings) as url:
        headers = {"Authorization": "Bearer admin-0123456789-0123456789"}
        text = httpx.get(f"{url}/settings", headers=headers, trust_env=False, timeout=60).text
    assert "tokens" in text
    assert "0123456789" not in text
