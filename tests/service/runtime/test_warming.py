"""The service is not ready before the first requests are as quick as later ones."""

from __future__ import annotations

import gc
import os
import re
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator

import pytest
from asking import asking
from prometheus_client.parser import text_string_to_metric_families
from waiting import until

from dyknow.engine.engine import Engine
from dyknow.service.app import create_app
from dyknow.service.config.settings import Settings
from dyknow.service.runtime.context import Service
from dyknow.service.runtime.warm_up import WarmUp
from dyknow.service.server import running
from dyknow.service.workers import services
from dyknow.service.workers.fork_server import FORK_SERVER
from dyknow.streams.time import Clock


@pytest.fixture
def gate() -> Iterator[threading.Event]:
    found = threading.Event()
    yield found
    found.set()


def reasons(warming: WarmUp) -> list[str]:
    """All that /readyz tells of a warm-up."""
    return warming.unfinished() + warming.failed()


def test_what_goes_on_is_a_reason_until_it_is_over(
    engine: Engine, settings: Settings, clock: Clock, gate: threading.Event
) -> None:
    app = create_app(engine, settings, clock)
    service: Service = app.state.service
    service.warming = WarmUp()
    service.warming.begin("loops", "being compiled", lambda: gate.wait(30) and None)
    with (
        running(app, settings) as url,
        asking(url) as http,
    ):
        until(lambda: http.get("/readyz").json()["reasons"] == ["loops: being compiled"])
        answer = http.get("/readyz")
        assert (answer.status_code, answer.json()["status"]) == (503, "starting")
        assert http.get("/status").json()["starting"] == ["loops: being compiled"]
        assert http.get("/problems").json() == []
        gate.set()
        until(lambda: http.get("/readyz").status_code == 200)


def test_the_loops_tell_how_far_they_are(
    monkeypatch: pytest.MonkeyPatch, gate: threading.Event
) -> None:
    def compile_all(tell: Callable[[int, int], None]) -> None:
        tell(1, 3)
        gate.wait(30)

    monkeypatch.setattr("dyknow.service.runtime.warm_up.compile_all", compile_all)
    warming = WarmUp()
    warming.loops()
    until(lambda: reasons(warming) == ["loops: being compiled, 1 of 3 are done"])
    gate.set()
    until(lambda: reasons(warming) == [])


def test_who_stops_waits_for_the_loop_at_hand_and_no_further_one(
    monkeypatch: pytest.MonkeyPatch, gate: threading.Event
) -> None:
    compiled = []

    def compile_all(tell: Callable[[int, int], None]) -> None:
        for done in (1, 2, 3):
            gate.wait(30)
            compiled.append(done)
            tell(done, 3)

    monkeypatch.setattr("dyknow.service.runtime.warm_up.compile_all", compile_all)
    warming = WarmUp()
    warming.loops()
    ending = threading.Thread(target=warming.end)
    ending.start()
    ending.join(0.1)
    assert ending.is_alive(), "the interpreter must not end while the compiler works"
    gate.set()
    ending.join(30)
    assert not ending.is_alive()
    assert compiled == [1]


def test_a_warm_up_that_fails_stays_a_reason() -> None:
    def fail() -> None:
        raise RuntimeError("no compiler")

    warming = WarmUp()
    warming.begin("loops", "being compiled", fail).join()
    assert reasons(warming) == ["loops: failed: no compiler"]


def test_a_task_that_fails_while_the_reasons_are_read_is_one_of_them(
    engine: Engine,
    settings: Settings,
    clock: Clock,
    gate: threading.Event,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def fail() -> None:
        gate.wait(30)
        raise RuntimeError("no compiler")

    service: Service = create_app(engine, settings, clock).state.service
    service.ticked = time.monotonic()
    service.warming = warming = WarmUp()
    thread, failed = warming.begin("loops", "being compiled", fail), warming.failed

    def failed_before() -> list[str]:
        found = failed()
        gate.set()
        thread.join()
        return found

    monkeypatch.setattr(warming, "failed", failed_before)
    assert service.reasons() == ["loops: being compiled"]


def test_what_is_there_at_the_start_is_not_collected_again(
    engine: Engine, settings: Settings, clock: Clock, gate: threading.Event
) -> None:
    app = create_app(engine, settings, clock)
    before = gc.get_freeze_count()
    warming = WarmUp()
    warming.begin("loops", "being compiled", lambda: gate.wait(30) and None)
    warming.application(app)
    try:
        until(lambda: app.openapi_schema is not None)
        # Not before all is done: what comes later would be looked at each time.
        assert gc.get_freeze_count() <= before
        gate.set()
        until(lambda: not reasons(warming))
        assert gc.get_freeze_count() > before
    finally:
        gc.unfreeze()


def test_workers_that_cannot_be_started_are_tried_again(
    engine: Engine, settings: Settings, clock: Clock, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(services, "_RETRY_INTERVAL", 0.05)
    app = create_app(engine, settings, clock)
    service: Service = app.state.service
    service.warming = WarmUp()
    with (
        running(app, settings) as url,
        asking(url) as http,
    ):
        with monkeypatch.context() as broken:
            broken.setattr(sys, "executable", "/nowhere/python")
            FORK_SERVER.stop()
            service.warming.workers("sparql", service.isolation.pools["sparql"])
            until(lambda: http.get("/readyz").status_code == 503)
            until(lambda: service.warming is not None and not reasons(service.warming))
            (reason,) = http.get("/readyz").json()["reasons"]
            assert re.match("workers: none for sparql: a worker does not start", reason)
            answer = http.get("/sparql", params={"query": "ASK {}"})
            assert (answer.status_code, answer.json()["title"]) == (503, "no worker")
        # Nobody asks, since the service is not ready; it mends itself.
        until(lambda: http.get("/readyz").status_code == 200)
        assert http.get("/sparql", params={"query": "ASK {}"}).status_code == 200


def test_serve_is_ready_when_its_workers_are() -> None:
    command = [sys.executable, "-c", "from dyknow.service.cli import main; main()", "serve"]
    variables = {**os.environ, "DYKNOW_PORT": "0", "DYKNOW_SPARQL_WORKERS": "3"}
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, env=variables)
    assert process.stderr is not None
    try:
        url = re.search(r"http://\S+", process.stderr.readline())
        assert url is not None
        with asking(url[0]) as http:
            # The very first start of all compiles the loops.
            until(lambda: http.get("/readyz").status_code == 200, 300)
            workers = {
                tuple(sample.labels.values()): sample.value
                for family in text_string_to_metric_families(http.get("/metrics").text)
                for sample in family.samples
                if sample.name == "dyknow_workers"
            }
        assert workers["sparql", "idle"] == 3
        assert workers["windows", "idle"] == services.WORKERS
    finally:
        process.terminate()
        process.communicate(timeout=120)
