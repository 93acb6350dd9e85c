"""Queries that cannot keep up: publishers are held back, and a query that is cut off all the same
shows as failed everywhere."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx
import pytest
from asking import asking
from typer.testing import CliRunner
from waiting import until

from dyknow.engine.durability.durable_engine import RecordedEngine
from dyknow.engine.engine import Engine
from dyknow.engine.units.windowed import WindowUnit
from dyknow.journal.durability import Durability
from dyknow.service.app import create_app
from dyknow.service.cli import app
from dyknow.service.client.client import Client
from dyknow.service.config.settings import Settings
from dyknow.service.server import running
from dyknow.service.turns import backlog_task
from dyknow.service.turns.window_turns import WindowTurns
from dyknow.streams.time import SECOND

LINES = {"Content-Type": "application/x-ndjson"}
TEXT = {"Content-Type": "text/plain"}
SSL = "stream s contains speed(UAV) = spd for every UAV = id"
COUNT = """REGISTER QUERY jump AS PREFIX dyknow: <http://www.ida.liu.se/dyknow/>
SELECT (COUNT(*) AS ?n) FROM STREAM <http://www.ida.liu.se/dyknow/s.trdf> [RANGE 1s STEP 1s]
WHERE { ?o dyknow:speed ?v }"""
ENDLESS = COUNT.replace("STEP 1s", "STEP 1ns")
TEMPLATE = """REGISTER TEMPLATE dyknow:Fast(?o) COMPUTE EVERY 1ns AS
PREFIX dyknow: <http://www.ida.liu.se/dyknow/>
CONSTRUCT {?o dyknow:speed ?v} WHERE { ?o dyknow:speed ?v } WINDOW [RANGE 1s STEP 1ns]"""


@contextmanager
def serving(most: float, data: Path | None = None) -> Iterator[str]:
    """A service that cuts a unit off after ``most`` seconds of work."""
    turns = WindowTurns(5, most)
    engine: Engine | RecordedEngine
    if data is None:
        engine = Engine(epoch="e1", turns=turns)
    else:
        engine = RecordedEngine(data, now=0, durability=Durability.WRITE, turns=turns)
    settings = Settings(port=0, tick=0.02, sse_ping=0, slow_request=60)
    with running(create_app(engine, settings, lambda: 10**18), settings) as url:
        with asking(url) as http:
            fields = {"id": "string", "spd": "float"}
            http.put("/streams/s", json={"fields": fields}).raise_for_status()
            http.post("/annotations", content=SSL, headers=TEXT).raise_for_status()
        yield url


def line(seconds: float) -> str:
    at = int(seconds * SECOND)
    return json.dumps({"valid": at, "available": at, "id": "u1", "spd": 1.0}) + "\n"


def post(http: httpx.Client, text: str, where: str = "/queries") -> dict[str, Any]:
    answer = http.post(where, content=text, headers=TEXT)
    assert answer.status_code == 201, answer.text
    return dict(answer.json())


def publish(http: httpx.Client, body: str) -> None:
    answer = http.post("/streams/s/samples", content=body, headers=LINES)
    assert answer.status_code == 202, answer.text


@pytest.fixture
def hard(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each turn of a unit counts as a tenth of a second of work, and publishers wait for one
    hundredth, on any machine."""
    work = WindowUnit.work

    def slow(unit: WindowUnit, *given: Any, **more: Any) -> Any:
        unit._spent += 0.1
        return work(unit, *given, **more)

    monkeypatch.setattr(WindowUnit, "work", slow)
    monkeypatch.setattr(backlog_task, "FIRST", 0)
    monkeypatch.setattr(backlog_task, "FURTHER", 0)
    monkeypatch.setattr(backlog_task, "_PATIENCE", 0.01)


@pytest.mark.usefixtures("hard")
def test_a_live_body_is_not_read_faster_than_it_is_evaluated() -> None:
    """A window a turn: the backlog of four batches of ten windows would be too much."""
    with serving(2.5) as url, Client(url, timeout=60) as client, asking(url) as http:
        post(http, COUNT)

        def bodies() -> Iterator[bytes]:
            for done in range(0, 120, 10):
                yield b"".join(line(done + i).encode() for i in range(10))
                # What comes together is taken together.
                until(lambda: accepted(http) == done + 10)  # noqa: B023  called at once

        client.publish_live("s", bodies())
        until(lambda: not _behind(client))
        found = http.get("/queries/jump").json()
        assert (found["state"], found["failure"]) == ("running", None)


def accepted(http: httpx.Client) -> int:
    return int(http.get("/streams/s").json()["counters"]["accepted"])


def _behind(client: Client) -> bool:
    found = client.evaluation("s")
    return bool(found["evaluated"] < found["last"])


@pytest.mark.usefixtures("hard")
def test_a_refused_publisher_learns_when_to_send_again() -> None:
    with serving(10**6) as url, asking(url) as http:
        post(http, ENDLESS)
        publish(http, line(1) + line(2))

        def refused() -> bool:
            return (
                http.post("/streams/s/samples", content=line(3), headers=LINES).status_code == 429
            )

        until(refused)
        answer = http.post("/streams/s/samples", content=line(3), headers=LINES)
        assert answer.headers["retry-after"] == "1"
        assert answer.json()["title"] == "queries are behind"
        # Other streams are not held back.
        http.put("/streams/t", json={"fields": {"v": "float"}})
        body = json.dumps({"valid": 1, "available": 1, "v": 1.0})
        assert http.post("/streams/t/samples", content=body, headers=LINES).status_code == 202
        assert http.get("/streams/s").json()["counters"]["accepted"] == 2


def cut_off(http: httpx.Client) -> None:
    """Publish samples that make too many windows due."""
    publish(http, line(1) + line(100) + line(101))


@pytest.mark.usefixtures("hard")
@pytest.mark.parametrize("recorded", [False, True])
def test_a_cut_off_request_is_shown_everywhere(tmp_path: Path, recorded: bool) -> None:
    with serving(0.5, tmp_path / "data" if recorded else None) as url, asking(url) as http:
        post(http, TEMPLATE, "/templates")
        event = post(http, "dyknow:Fast(?o)", "/events")
        stream = event["stream"]
        assert (event["state"], event["failure"]) == ("running", None)
        of_stream = http.post("/subscriptions", json={"stream": stream}).json()
        policy = {"stream": stream, "policy": "any change"}
        adapted = http.post("/subscriptions", json=policy).json()
        assert http.get("/readyz").json() == {"status": "ok", "reason": None, "reasons": []}
        followed = (
            f"/streams/{stream}/events",
            of_stream["events"],
            adapted["events"],
            f"/follow?stream={stream}",
        )
        ends: list[dict[str, Any]] = []

        def follow(path: str, begun: Callable[[], object]) -> None:
            with httpx.stream("GET", url + path, timeout=60, trust_env=False) as answer:
                lines = answer.iter_lines()
                next(lines)
                begun()
                while next(lines) != "event: end":
                    continue
                ends.append(json.loads(next(lines).removeprefix("data: ")))

        begun = threading.Barrier(len(followed) + 1)
        threads = [threading.Thread(target=follow, args=(path, begun.wait)) for path in followed]
        for thread in threads:
            thread.start()
        begun.wait(60)
        cut_off(http)
        until(lambda: http.get(f"/events/{event['id']}").json()["state"] == "failed")
        for thread in threads:
            thread.join(60)
        failure = http.get("/events").json()[0]["failure"]
        assert "Overwhelmed: its windows took" in failure
        assert len(ends) == len(followed)
        assert all((end["reason"], end["failure"]) == ("failed", failure) for end in ends)
        for view in http.get("/subscriptions").json():
            assert (view["state"], view["failure"]) == ("failed", failure)
        # A later client gets the same end at once.
        follow(followed[0], lambda: None)
        assert ends[-1]["reason"] == "failed"
        # The service works for others; /readyz needs no token, so it names nothing.
        ready = http.get("/readyz")
        assert (ready.status_code, ready.json()["status"]) == (200, "degraded")
        assert ready.json()["reasons"] == ["1 computational unit has failed: Overwhelmed"]
        http.delete(f"/events/{event['id']}")
        for view in (of_stream, adapted):
            http.delete(f"/subscriptions/{view['id']}")
        assert http.get("/readyz").json()["status"] == "ok"


@pytest.mark.usefixtures("hard")
def test_the_command_line_tells_and_fails() -> None:
    def run(*words: str) -> Any:
        return CliRunner().invoke(app, list(words), env={"DYKNOW_URL": url})

    with serving(0.5) as url, asking(url) as http:
        post(http, TEMPLATE, "/templates")

        def cut_off_when_followed() -> None:
            with asking(url) as other:
                until(lambda: other.get("/status").json()["clients"] == 1)
                cut_off(other)

        thread = threading.Thread(target=cut_off_when_followed)
        thread.start()
        found = run("events", "dyknow:Fast(?o)", "--keep")
        thread.join(60)
        assert found.exit_code == 1
        assert "end: the stream has failed: dyknow_cu1: Overwhelmed" in found.stderr
        listed = run("events")
        assert "failed" in listed.stdout
        assert "event1 failed: dyknow_cu1: Overwhelmed" in listed.stdout


def recording(path: Path, rows: int) -> str:
    path.write_text("valid,id,spd\n" + "".join(f"{10**9 * i},u1,1\n" for i in range(1, rows)))
    return str(path)


@pytest.mark.usefixtures("hard")
@pytest.mark.parametrize("text", [COUNT, ENDLESS])
def test_replay_waits_until_all_is_evaluated(tmp_path: Path, text: str) -> None:
    """And ends with another status than 0 where something failed meanwhile, for the first time."""

    def replay(*words: str) -> Any:
        path = recording(tmp_path / "s.csv", 30)
        every = ("replay", path, "--stream", "s", "--time-unit", "ns", "--speed", "max", *words)
        return CliRunner().invoke(app, list(every), env={"DYKNOW_URL": url})

    with serving(0.5 if text is ENDLESS else 10**6) as url, asking(url) as http:
        post(http, text)
        done = replay("--json")
        told = json.loads(done.stdout)
        assert (told["accepted"], told["evaluated"]) == (29, 29), done.output
        if text is ENDLESS:
            assert done.exit_code == 1
            assert "failed: query jump: Overwhelmed" in done.stderr
        else:
            assert done.exit_code == 0, done.output
            assert http.get("/queries/jump").json()["last_window"] == "1970-01-01T00:00:29Z"
        again = replay()
        assert again.exit_code == 0, again.output
        assert "evaluated in" in again.stdout
