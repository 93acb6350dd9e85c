"""What an earlier run has accepted and this one cannot start is listed with its reason, and can be
given up for good (docs/reference/data-directory.md)."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx
import pytest
from asking import asking
from places import ROOT
from typer.testing import CliRunner

from dyknow.engine.durability.commands import (
    Annotate,
    RegisterQuery,
    RegisterTemplate,
    RequestEvent,
    Subscribe,
    SubscribeToFeature,
)
from dyknow.engine.durability.durable_engine import RecordedEngine
from dyknow.engine.engine import Engine
from dyknow.engine.model.errors import Conflict
from dyknow.engine.requests.continuous_queries import RegisteredQueries
from dyknow.engine.requests.event_requests import EventRequests
from dyknow.journal.durability import Durability
from dyknow.service.app import create_app
from dyknow.service.cli import app
from dyknow.service.config.settings import Settings
from dyknow.service.server import running
from dyknow.streams.time import Clock

PROGRAM = "dyknow.engine.durability.durable_engine.program"

SSL = "stream s5 contains speed(UAV) = spd [m.s-1] for every UAV = id"
EVENT = "dyknow:HighSpeedEvent(?o, dyknow:UAV, 1)"
QUERY = (
    "SELECT ?o ?v FROM STREAM <http://www.ida.liu.se/dyknow/s5.trdf> "
    "[RANGE 5s STEP 1s] WHERE { ?o dyknow:speed ?v }"
)
REASON = "this version takes none of it"


@pytest.fixture
def data(tmp_path: Path) -> Path:
    """A directory with two of each kind; its queries have no name."""
    path = tmp_path / "data"
    recorded = RecordedEngine(path, now=0, durability=Durability.WRITE)
    for command in (
        Annotate(SSL),
        RegisterTemplate((ROOT / "templates/library/high_speed.rq").read_text()),
        RequestEvent(EVENT),
        RequestEvent(None, "dyknow:HighSpeedEvent", ("?o", "dyknow:UAV", "2"), "quality"),
        Subscribe("s5", "sample every 1s"),
        SubscribeToFeature("dyknow:speed", sort="dyknow:UAV"),
        RegisterQuery(QUERY),
        RegisterQuery(QUERY.replace("5s STEP", "3s STEP")),
    ):
        recorded.do(command)
    recorded.close(checkpoint=False)
    return path


@contextmanager
def served(path: Path, settings: Settings, clock: Clock) -> Iterator[httpx.Client]:
    recorded = RecordedEngine(path, now=0, durability=Durability.WRITE)
    with (
        running(create_app(recorded, settings, clock), settings) as url,
        asking(url) as http,
    ):
        yield http


@pytest.fixture
def refusing(monkeypatch: pytest.MonkeyPatch) -> Iterator[pytest.MonkeyPatch]:
    """Another version of the program, which takes none of these."""

    def refuse(*_: Any, **__: Any) -> None:
        raise Conflict(REASON)

    monkeypatch.setattr(PROGRAM, lambda *_: "another version")
    with monkeypatch.context() as patched:
        patched.setattr(EventRequests, "start", refuse)
        patched.setattr(RegisteredQueries, "start", refuse)
        patched.setattr(Engine, "subscribe", refuse)
        patched.setattr(Engine, "subscribe_to_feature", refuse)
        yield patched


def listed(http: httpx.Client, key: str, path: str) -> dict[str, tuple[str, str | None]]:
    found = http.get(path).json()
    return {each[key]: (each["state"], each["failure"]) for each in found}


def everything(http: httpx.Client) -> dict[str, dict[str, tuple[str, str | None]]]:
    kinds = (("id", "/events"), ("id", "/subscriptions"), ("name", "/queries"))
    return {path: listed(http, key, path) for key, path in kinds}


def test_what_waits_is_listed_and_given_up_for_good(
    data: Path, settings: Settings, clock: Clock, refusing: pytest.MonkeyPatch
) -> None:
    with served(data, settings, clock) as http:
        there = everything(http)
        assert list(there["/events"]) == ["event1", "event2"]
        assert list(there["/subscriptions"]) == ["subscription1", "subscription2"]
        first, second = there["/queries"]
        assert all(
            state == ("waiting", REASON) for found in there.values() for state in found.values()
        )
        event = http.get("/events/event2").json()
        assert (event["event"], event["arguments"]) == (
            "dyknow:HighSpeedEvent",
            ["?o", "dyknow:UAV", "2"],
        )
        assert (event["strategy"], event["stream"], event["plan"]) == ("quality", None, None)
        assert http.get("/events/event1").json()["event"] == EVENT
        subscription = http.get("/subscriptions/subscription1").json()
        assert (subscription["source"], subscription["policy"]) == ("s5", "sample every 1s")
        assert http.get("/subscriptions/subscription2").json()["source"] == "dyknow:speed"
        query = http.get(f"/queries/{first}").json()
        assert (query["source"], query["form"], query["users"]) == (QUERY, "SELECT", 1)
        assert (query["state"], query["stream"]) == ("waiting", None)
        told = http.get(f"/queries/{first}", headers={"Accept": "text/plain"})
        assert told.text.strip() == QUERY
        table = CliRunner().invoke(app, ["events", "--url", str(http.base_url)])
        assert table.exit_code == 0, table.output
        assert "waiting" in table.output
        gone = ("/events/event1", "/subscriptions/subscription1", f"/queries/{first}")
        for path in gone:
            assert http.delete(path).status_code == 204
            assert http.get(path).status_code == http.delete(path).status_code == 404
    left = {
        "/events": ["event2"],
        "/subscriptions": ["subscription2"],
        "/queries": [second],
    }
    with served(data, settings, clock) as http:  # it was written down
        assert {path: list(found) for path, found in everything(http).items()} == left
    refusing.undo()
    refusing.setattr(PROGRAM, lambda *_: "a third version")
    with served(data, settings, clock) as http:
        there = everything(http)
        assert {path: list(found) for path, found in there.items()} == left
        assert {state for found in there.values() for state in found.values()} == {
            ("running", None)
        }


def test_other_kinds_stand_in_the_status(
    data: Path, settings: Settings, clock: Clock, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: Any, **__: Any) -> None:
        raise Conflict(REASON)

    with served(data, settings, clock) as http:
        assert http.get("/status").json()["waiting"] == []
        assert http.delete("/events/event1").status_code == 204
        assert http.delete("/events/event2").status_code == 204
    (data / "checkpoints").rename(data / "set aside")
    (data / "checkpoints").mkdir()
    monkeypatch.setattr(PROGRAM, lambda *_: "another version")
    monkeypatch.setattr(Engine, "register_template", refuse)
    with served(data, settings, clock) as http:
        (waiting,) = http.get("/status").json()["waiting"]
        assert waiting["kind"] == "template"
        assert waiting["name"].endswith("HighSpeedEvent")
        assert waiting["reason"] == REASON
        assert http.delete("/templates/HighSpeedEvent").status_code == 204
        assert http.get("/status").json()["waiting"] == []
