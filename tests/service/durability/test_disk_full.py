"""A disk without room, or one that fails: writes are refused, reading goes on, nothing is lost."""

import logging
import resource
import threading
import time
from contextlib import contextmanager
from pathlib import Path

import httpx
import pytest
from asking import asking
from httpx_sse import EventSource, connect_sse
from serving import Serving
from simulated_disk import SimulatedDisk
from waiting import until

from dyknow.engine.durability.durable_engine import RecordedEngine
from dyknow.service.app import create_app
from dyknow.service.durability import failure_log
from dyknow.service.durability.command_queue import JOURNAL, CommandQueue
from dyknow.service.routes import ontologies
from dyknow.service.runtime.openapi import ASKING
from dyknow.service.server import running
from dyknow.streams.time import SECOND

HIGH = "templates/library/high_speed.rq"
QUERY = """REGISTER QUERY highest COMPUTE EVERY 1s AS SELECT ?o (MAX(?a) AS ?top)
WHERE { ?o a dyknow:Aircraft ; dyknow:altitude ?a } GROUP BY ?o WINDOW [RANGE 10s STEP 1s]"""
TEXT = {"content-type": "text/plain"}
NDJSON = {"content-type": "application/x-ndjson"}
TURTLE = {"content-type": "text/turtle"}
SPECIFICATION = b"""<spec:specification xmlns:spec="http://www.dyknow.eu/ontology#Specification">
<spec:insertions><spec:cu name="u" type="none"/></spec:insertions></spec:specification>"""


@pytest.fixture
def disk():
    return SimulatedDisk()


@pytest.fixture
def recorded(disk, tmp_path, between):
    found = RecordedEngine(tmp_path / "data", now=0, disk=disk)
    entry = found.log.entry

    @contextmanager
    def alone(payload):
        with between, entry(payload) as begun:
            yield begun

    found.log.entry = alone
    return found


@pytest.fixture
def between():
    """Had while the log writes an entry down."""
    return threading.Lock()


@pytest.fixture
def engine(recorded):
    return recorded.engine


@pytest.fixture
def fill(disk, recorded, between):
    """Leaves no room, not even what the log has made before. It waits for the end of an entry that
    has begun: no disk takes back what it gave."""

    def run():
        with between:
            disk.room = 0
            for segment in recorded.log._open:
                segment._room = segment.end

    return run


def sample(n):
    return b'{"valid": %d, "available": %d, "n": %d}\n' % (n * SECOND, n * SECOND, n)


def post(http, n, key=None):
    headers = NDJSON | ({} if key is None else {"idempotency-key": key})
    return http.post("/streams/s5/samples", content=sample(n), headers=headers)


def kept(http):
    lines = http.get("/streams/s5/samples").text.splitlines()
    return [httpx.Response(200, content=line).json()["n"] for line in lines]


def declare(http):
    http.put("/streams/s5", json={"fields": {"n": "integer"}}).raise_for_status()


WRITES = {
    ("POST", "/streams/{name}/samples"): ("/streams/s5/samples", sample(9), NDJSON),
    ("POST", "/streams/{name}/samples/live"): ("/streams/s5/samples/live", sample(9), NDJSON),
    ("POST", "/templates"): ("/templates", "high", TEXT),
    ("PUT", "/templates/{name}"): ("/templates/HighSpeedEvent", "high", TEXT),
    ("DELETE", "/templates/{name}"): ("/templates/HighSpeedEvent", b"", {}),
    ("POST", "/events"): ("/events", "dyknow:HighSpeedEvent(?o, dyknow:UAV, 100)", TEXT),
    ("DELETE", "/events/{id}"): ("/events/event1", b"", {}),
    ("POST", "/queries"): ("/queries", QUERY, TEXT),
    ("DELETE", "/queries/{name}"): ("/queries/highest", b"", {}),
    ("PUT", "/streams/{name}"): ("/streams/new", '{"fields": {"n": "integer"}}', {}),
    ("DELETE", "/streams/{name}"): ("/streams/s5", b"", {}),
    ("PUT", "/streams/{name}/quality"): ("/streams/s5/quality", '{"quality": 0.5}', {}),
    ("POST", "/streams/{name}/end"): ("/streams/s5/end", b"", {}),
    ("POST", "/subscriptions"): ("/subscriptions", '{"stream": "s5"}', {}),
    ("DELETE", "/subscriptions/{id}"): ("/subscriptions/subscription1", b"", {}),
    ("POST", "/annotations"): ("/annotations", "stream s5 contains speed(UAV) = n", TEXT),
    ("POST", "/transformations"): ("/transformations", "transformation", {}),
    ("PUT", "/transformations/{name}"): ("/transformations/t", "transformation", {}),
    ("PATCH", "/transformations/{name}"): ("/transformations/t", '{"cost": 2}', {}),
    ("DELETE", "/transformations/{name}"): ("/transformations/t", b"", {}),
    ("POST", "/ontologies"): ("/ontologies?name=x", "<urn:a> <urn:b> <urn:c> .", TURTLE),
    ("DELETE", "/ontologies/{name}"): ("/ontologies/gone", b"", {}),
    ("POST", "/kpl"): ("/kpl", "source float pos", TEXT),
    ("DELETE", "/kpl/{name}"): ("/kpl/pos", b"", {}),
    ("POST", "/specifications"): (
        "/specifications",
        SPECIFICATION,
        {"content-type": "application/xml"},
    ),
}
"""A request for each route that changes something."""


def test_every_route_that_writes_is_refused_with_507_and_documents_it(http, fill):
    declare(http)
    http.post("/templates", content=_body("high"), headers=TEXT).raise_for_status()
    gone = http.post("/ontologies?name=gone", content="<urn:a> <urn:b> <urn:c> .", headers=TURTLE)
    gone.raise_for_status()
    schema = http.get("/openapi.json").json()
    writing = {
        (method.upper(), path)
        for path, methods in schema["paths"].items()
        for method in methods
        if method != "get" and path not in ASKING
    }
    assert writing == set(WRITES)
    fill()
    for (method, path), (target, body, headers) in WRITES.items():
        answer = http.request(method, target, content=_body(body), headers=headers)
        assert answer.status_code == 507, (method, path, answer.text)
        assert answer.headers["content-type"] == "application/problem+json"
        assert int(answer.headers["retry-after"]) > 0
        assert "room" in answer.json()["detail"]
        assert answer.json()["hint"]
        documented = schema["paths"][path][method.lower()]["responses"]
        assert {"503", "507"} <= set(documented)
    assert len(http.get("/templates").json()) == 1


def _body(body):
    if body == "high":
        return Path(HIGH).read_bytes()
    if body == "transformation":
        return b'{"annotation": "source t provides dyknow:altitude(self) [ft]"}'
    return body


def test_reading_goes_on_and_all_goes_on_when_there_is_room(http, disk, fill):
    declare(http)
    assert post(http, 1).status_code == 202
    with connect_sse(http, "GET", "/streams/s5/events?since=start") as source:
        events = source.iter_sse()
        assert next(events).json()["values"] == {"n": 1}
        fill()
        assert post(http, 2, "two").status_code == 507
        assert http.get("/healthz").status_code == 200
        # On a busy machine it may be not ready for another reason before.
        until(lambda: "no room" in (http.get("/readyz").json()["reason"] or ""))
        assert http.get("/readyz").status_code == 503
        assert kept(http) == [1]
        assert (
            http.post(
                "/sparql", content=b"ASK {}", headers={"content-type": "application/sparql-query"}
            ).status_code
            == 200
        )
        # A stream that comes into being by being asked for is no write to who asks.
        assert http.get("/streams/s5_late").status_code == 200
        assert post(http, 2, "two").status_code == 507
        with connect_sse(http, "GET", "/streams/s5/events?since=start") as again:
            assert next(again.iter_sse()).json()["values"] == {"n": 1}
        disk.room = None
        until(lambda: http.get("/readyz").status_code == 200)
        assert post(http, 2, "two").json() == {"accepted": 1}
        assert post(http, 2, "two").json() == {"accepted": 1}
        assert post(http, 3).status_code == 202
        assert [next(events).json()["values"]["n"] for _ in range(2)] == [2, 3]
    assert kept(http) == [1, 2, 3]


def test_a_commit_that_began_before_does_not_end_the_trouble(
    http, fill, recorded, settings, monkeypatch
):
    declare(http)
    began, goes_on, commit = threading.Event(), threading.Event(), recorded.log.commit

    def held():
        began.set()
        goes_on.wait(60)
        return commit()

    monkeypatch.setattr(recorded.log, "commit", held)
    began.wait(60)
    fill()
    # It is refused while the commit of what came before is under way.
    assert post(http, 1).status_code == 507
    assert "no room" in http.get("/readyz").json()["reason"]
    recovered, recover = [], CommandQueue._recover
    monkeypatch.setattr(
        CommandQueue, "_recover", lambda self, part: recovered.append(part) or recover(self, part)
    )
    goes_on.set()
    until(lambda: len(recovered) > 5)  # What else there is recovers with each tick.
    assert http.get("/readyz").status_code == 503
    assert JOURNAL not in recovered


def test_after_a_full_disk_and_a_kill_nothing_is_lost_and_nothing_doubled(
    recorded, settings, clock, disk, tmp_path
):
    """Also what was written only when there was room again; and late streams that somebody asked
    for meanwhile."""
    with (
        running(create_app(recorded, settings, clock), settings) as url,
        asking(url) as http,
    ):
        declare(http)
        acknowledged = []
        for n in range(1, 30):
            if n % 10 == 4:
                disk.full_writes = True  # what was taken cannot be written
            if n % 10 == 6:
                disk.full_writes = False
            answer = post(http, n, f"key {n}")
            if answer.status_code == 202:
                acknowledged.append(n)
                continue
            assert answer.status_code == 507
            if disk.full_writes:
                http.get("/streams/s5_late").raise_for_status()
                continue
            until(lambda: http.get("/readyz").status_code == 200)
            assert post(http, n, f"key {n}").status_code == 202
            acknowledged.append(n)
        seen = kept(http)
        status = http.get("/streams/status/samples").text
        # The process is gone, without a word; so is the power.
        disk.stop_after = 0
    disk.lose_power(lambda: False, lambda n: 0)
    again = RecordedEngine(tmp_path / "data", now=0)
    assert again.recovery.is_continued
    stream = again.engine.generator("s5").stream
    found = stream.all().columns["n"].values.tolist()
    assert set(acknowledged) <= set(found)
    assert len(found) == len(set(found))
    assert found == seen
    assert "s5_late" in status
    assert len(again.engine.generator("status").stream.all()) >= len(status.splitlines())
    again.close()


def test_a_full_disk_is_logged_once(http, disk, caplog, monkeypatch, fill):
    monkeypatch.setattr(failure_log, "QUIET_PERIOD", 0.1)
    declare(http)
    fill()
    until(lambda: http.get("/readyz").status_code == 503)
    counted = "dyknow_tick_failures_total"
    until(lambda: float(_metric(http, counted)) > 10)
    disk.room = None
    until(lambda: http.get("/readyz").status_code == 200)
    until(lambda: len(told(caplog)) > 1)
    assert [record.msg["event"] for record in told(caplog)] == [
        "journal failed",
        "journal works again",
    ]
    assert all(record.exc_info is None for record in told(caplog))


def told(caplog):
    return [record for record in caplog.records if record.levelno >= logging.WARNING]


def test_a_disk_that_takes_something_now_and_then_is_logged_once(http, disk, caplog, fill):
    """What is small finds room, what is large does not, again and again."""
    declare(http)
    for _ in range(3):
        fill()
        until(lambda: http.get("/readyz").status_code == 503)
        disk.room = None
        until(lambda: http.get("/readyz").status_code == 200)
        ticks = float(_metric(http, "dyknow_tick_seconds_count"))
        until(lambda before=ticks: float(_metric(http, "dyknow_tick_seconds_count")) > before + 2)
    assert [record.msg["event"] for record in told(caplog)] == ["journal failed"]


def test_no_room_is_told_before_an_ontology_is_worked_on(http, monkeypatch, fill):
    worked = []

    async def work(*arguments):
        worked.append(arguments)

    monkeypatch.setattr(ontologies, "while_connected", work)
    fill()
    text = "<x:o> a <http://www.w3.org/2002/07/owl#Ontology> ."
    answer = http.post("/ontologies", content=text, headers={"Content-Type": "text/turtle"})
    assert answer.status_code == 507
    assert answer.headers["retry-after"]
    assert worked == []


def _metric(http, name):
    lines = http.get("/metrics").text.splitlines()
    return next(line.split()[1] for line in lines if line.startswith(f"{name} "))


def test_a_checkpoint_that_finds_no_room_is_told_and_costs_nothing_acknowledged(
    recorded, settings, clock, disk, tmp_path
):
    small = settings.model_copy(update={"checkpoint_bytes": 1})
    with (
        running(create_app(recorded, small, clock), small) as url,
        asking(url) as http,
    ):
        declare(http)
        until(lambda: list((tmp_path / "data" / "checkpoints").iterdir()))
        disk.room = 4096
        until(lambda: "checkpoint" in http.get("/readyz").text)
        # The log has room that it made before.
        assert post(http, 1).status_code == 202
        disk.room = None
    again = RecordedEngine(tmp_path / "data", now=0)
    assert again.engine.generator("s5").stream.last_number == 1
    again.close()


def test_a_disk_that_fails_ends_writing_and_a_restart_recovers(
    recorded, settings, clock, disk, tmp_path
):
    with (
        running(create_app(recorded, settings, clock), settings) as url,
        asking(url) as http,
    ):
        declare(http)
        assert post(http, 1, "one").status_code == 202
        disk.broken = {"sync"}
        answer = post(http, 2, "two")
        assert answer.status_code == 503
        assert answer.json()["type"] == "urn:dyknow:problem:journal-broken"
        disk.broken.clear()
        # What the failed sync has kept nobody knows: nothing more is taken.
        assert post(http, 3, "three").status_code == 503
        assert http.put("/streams/more", json={"fields": {"n": "integer"}}).status_code == 503
        assert http.get("/healthz").status_code == 200
        assert "restart" in http.get("/readyz").json()["reason"]
        assert http.get("/readyz").status_code == 503
        assert kept(http)[0] == 1
    again = RecordedEngine(tmp_path / "data", now=0)
    with (
        running(create_app(again, settings, clock), settings) as url,
        asking(url) as http,
    ):
        until(lambda: http.get("/readyz").status_code == 200)
        for n, key in ((1, "one"), (2, "two"), (3, "three")):
            assert post(http, n, key).json() == {"accepted": 1}
        assert kept(http) == [1, 2, 3]


SOURCES = """
import random
from pathlib import Path

import dyknow


@dyknow.source(sort="Text", period="50ms")
def chatter(time):
    return str(random.random()) + "x" * int(Path({size!r}).read_text())


@dyknow.source(sort="float", period="50ms")
def dice(time):
    return random.random()
"""


def limit_files(process, size):
    """No file of ``process`` may get longer: a real disk that is full for it."""
    resource.prlimit(process.pid, resource.RLIMIT_FSIZE, (size, resource.RLIM_INFINITY))


def test_sources_that_say_more_than_a_full_disk_has_room_for_break_nothing(tmp_path):
    """On the real disk: sources are asked again when there is room, without a restart."""
    size = tmp_path / "size"
    size.write_text("10")
    units = tmp_path / "chattering.py"
    units.write_text(SOURCES.format(size=str(size)))
    arguments = (tmp_path / "data", "--processes", str(units))
    serving = Serving(*arguments)
    try:
        http = serving.http
        fields = {"n": "integer", "t": "string"}
        http.put("/streams/s5", json={"fields": fields}).raise_for_status()
        kpl = "sort Text = (value string)\nsource Text chatter\nsource float dice"
        http.post("/kpl", content=kpl, headers=TEXT).raise_for_status()
        serving.until(lambda: len(said(http, "chatter")) > 2)
        (log,) = (tmp_path / "data" / "journal").glob("*.log")
        limit_files(serving.process, log.stat().st_size)
        while (status := publish_text(http, 60_000)) == 202:
            pass
        assert status == 507
        assert publish_text(http, 10) == 202
        size.write_text("400000")
        serving.until(lambda: counters(http, "chatter")["without room"] > 5)
        assert "chatter" in http.get("/readyz").text
        before = len(said(http, "dice"))
        assert len(serving.until(lambda: said(http, "dice")[before + 3 :])) > 0
        assert publish_text(http, 10) == 202
        size.write_text("10")
        limit_files(serving.process, resource.RLIM_INFINITY)
        serving.until(lambda: http.get("/readyz").status_code == 200)
        before = len(said(http, "chatter"))
        serving.until(lambda: len(said(http, "chatter")) > before + 3)
        assert publish_text(http, 60_000) == 202
        with http.stream("GET", "/streams/chatter/events?since=start") as answer:
            events = EventSource(answer).iter_sse()
            shown = [next(events).json() for _ in range(before)]
    finally:
        serving.kill()
    again = Serving(*arguments)
    try:
        with again.http.stream("GET", "/streams/chatter/events?since=start") as answer:
            events = EventSource(answer).iter_sse()
            assert [next(events).json() for _ in range(before)] == shown
        assert counters(again.http, "chatter")["without room"] > 5
    finally:
        again.stop()


def said(http, name):
    return http.get(f"/streams/{name}/samples").text.splitlines()


def counters(http, name):
    return next(each["counters"] for each in http.get("/kpl").json() if each["name"] == name)


def publish_text(http, size):
    body = {"valid": time.time_ns(), "n": 1, "t": "x" * size}
    return http.post("/streams/s5/samples", json=body, headers=NDJSON).status_code
