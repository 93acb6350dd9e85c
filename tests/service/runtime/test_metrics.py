"""What /metrics tells: a valid exposition, with bounded labels, of what has really happened."""

from __future__ import annotations

import errno
import json
import os
import re
import signal
import socket
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import anyio
import httpx
import pytest
from hosting import hosting
from prometheus_client.parser import text_string_to_metric_families
from simulated_disk import SimulatedDisk
from waiting import until

from dyknow.continuous.columns.budget import OVERRUNS, Budget
from dyknow.engine.durability.durable_engine import RecordedEngine
from dyknow.engine.engine import Engine
from dyknow.service.app import create_app
from dyknow.service.config.settings import Settings
from dyknow.service.runtime.context import Service
from dyknow.service.runtime.stream_metrics import SLICE, _Lines
from dyknow.service.workers.messages import Job, Query
from dyknow.service.workers.pool import Pool
from dyknow.service.workers.worker import End, WorkerError
from dyknow.streams.time import SECOND, Clock

LINES = {"Content-Type": "application/x-ndjson"}
PAIRS = """REGISTER QUERY pairs AS SELECT ?a ?b
    FROM STREAM <http://www.ida.liu.se/dyknow/s5.trdf> [RANGE 1s STEP 1s]
    WHERE { ?a <http://www.ida.liu.se/dyknow/speed> ?v .
            ?b <http://www.ida.liu.se/dyknow/speed> ?w }"""
ENDLESS = "ASK { " + " ".join(f"VALUES ?v{i} {{ 1 2 3 4 5 6 7 8 9 0 }}" for i in range(12))
ENDLESS += " FILTER(?v0 + ?v5 + ?v11 < 0) }"
HUNGRY = "ASK { BIND('aaaaaaaa' AS ?c0) "
HUNGRY += " ".join(f"BIND(CONCAT(?c{i}, ?c{i}, ?c{i}) AS ?c{i + 1})" for i in range(30))
HUNGRY += " FILTER(STRLEN(?c30) > 0) }"
Values = dict[str, dict[str, float]]


def job(text: str, seconds: float = 20) -> Job:
    return Job(Query(text, "application/json", 1000, 1 << 20), seconds)


def parsed(text: str) -> Values:
    """Values by metric and labels, as Prometheus reads them; asserts that there is one of each."""
    found: Values = {}
    for family in text_string_to_metric_families(text):
        for sample in family.samples:
            labels = ",".join(f"{key}={sample.labels[key]}" for key in sorted(sample.labels))
            values = found.setdefault(sample.name, {})
            assert labels not in values, (sample.name, labels)
            values[labels] = sample.value
    return found


def scraped(http: httpx.Client) -> Values:
    return parsed(http.get("/metrics").text)


@pytest.fixture
def disk() -> SimulatedDisk:
    return SimulatedDisk()


@pytest.fixture
def kept(
    tmp_path: Path, disk: SimulatedDisk, settings: Settings, clock: Clock
) -> Iterator[tuple[Service, httpx.Client]]:
    """A service with a data directory."""
    recorded = RecordedEngine(tmp_path / "data", now=0, disk=disk)
    often = settings.model_copy(update={"checkpoint_interval": 0.3})
    with hosting(recorded, often, clock) as found:
        yield found


def samples(count: int, last: int, fields: Callable[[int], dict[str, object]]) -> str:
    return "\n".join(
        json.dumps({"available": last - (count - i) * SECOND, "valid": 0, **fields(i)})
        for i in range(count)
    )


# -- the format ------------------------------------------------------------------------------


def check_exposition(text: str) -> None:
    """What Prometheus and its linter ask of it."""
    assert text.endswith("\n")
    names = re.findall(r"^# TYPE (\S+) ", text, re.MULTILINE)
    assert len(names) == len(set(names))
    assert names == re.findall(r"^# HELP (\S+) ", text, re.MULTILINE)
    for name, kind in re.findall(r"^# TYPE (\S+) (\S+)", text, re.MULTILINE):
        if name.endswith("_created"):  # the client library's own, of counters and histograms
            continue
        assert re.fullmatch(r"[a-z][a-z0-9_]*", name), name
        assert (kind == "counter") == name.endswith("_total"), name
        assert not re.search(r"_(ms|millis|milliseconds|minutes|mb|kb|percent)(_|$)", name), name
        if "second" in name:
            assert re.search(r"_seconds(_total)?$", name), name
        if kind == "histogram" and not name.endswith(("_seconds", "_bytes")):
            assert name == "dyknow_journal_commit_records"
    for family in text_string_to_metric_families(text):
        if family.type == "histogram":
            _check_histogram(family)


def _check_histogram(family: object) -> None:
    buckets: dict[tuple[tuple[str, str], ...], list[tuple[float, float]]] = {}
    counts = {}
    for sample in family.samples:  # type: ignore[attr-defined]
        labels = dict(sample.labels)
        bound = labels.pop("le", None)
        key = tuple(sorted(labels.items()))
        if bound is not None:
            buckets.setdefault(key, []).append((float(bound), sample.value))
        elif sample.name.endswith("_count"):
            counts[key] = sample.value
    assert buckets.keys() == counts.keys()
    for key, found in buckets.items():
        assert found == sorted(found)
        assert [value for _, value in found] == sorted(value for _, value in found)
        assert found[-1] == (float("inf"), counts[key])


def test_the_exposition_is_valid_with_everything_in_it(
    kept: tuple[Service, httpx.Client], clock: Clock
) -> None:
    service, http = kept
    http.put("/streams/s5", json={"fields": {"id": "string", "v": "float"}}).raise_for_status()
    http.put("/streams/t", json={"fields": {"x": "float"}}).raise_for_status()
    http.post("/annotations", content="stream s5 contains speed(UAV) = v for every UAV = id")
    http.post("/queries", content=PAIRS).raise_for_status()
    body = samples(5, clock(), lambda i: {"id": "a", "v": 1.0})
    http.post("/streams/s5/samples", content=body, headers=LINES).raise_for_status()
    http.get("/sparql", params={"query": "ASK {}"}).raise_for_status()
    http.get("/streams/none")
    http.get("/streams/s5/events", headers={"Last-Event-ID": "no"})
    until(lambda: scraped(http).get("dyknow_checkpoint_seconds_count", {}).get("step=disk", 0) >= 1)
    text = http.get("/metrics").text
    check_exposition(text)
    found = parsed(text)
    for name, values in found.items():
        if name.startswith(("dyknow_journal_", "dyknow_checkpoint_", "dyknow_data_")):
            assert values, name
    assert found["dyknow_unit_lag_seconds"].keys() == found["dyknow_unit_windows_total"].keys()
    assert service.settings.metrics_streams == 1000


def test_labels_of_requests_are_bounded(service: Service) -> None:
    for i in range(50):
        service.metrics.request(f"NONE{i}", "(none)", 400, 0.1)
    text = anyio.run(service.metrics.text).decode()
    found = parsed(text)["dyknow_http_requests_total"]
    assert [labels for labels in found if "NONE" in labels] == []
    assert found["method=other,route=(none),status=400"] == 50


@pytest.fixture
def service(engine: Engine, settings: Settings, clock: Clock) -> Service:
    """One that does not run."""
    found: Service = create_app(engine, settings, clock).state.service
    return found


# -- streams beyond the bound ------------------------------------------------------------------


def test_further_streams_are_told_together(
    engine: Engine, settings: Settings, clock: Clock
) -> None:
    bounded = settings.model_copy(update={"metrics_streams": 3})  # of which one is `status`
    with hosting(engine, bounded, clock) as (_, http):
        names = [f"s{i}" for i in range(6)]
        for i, name in enumerate(names):
            http.put(f"/streams/{name}", json={"fields": {"n": "integer"}}).raise_for_status()
            body = samples(i + 1, clock() - i * SECOND, lambda n: {"n": n})
            http.post(f"/streams/{name}/samples", content=body, headers=LINES).raise_for_status()

        def accepted() -> dict[str, float]:
            found = scraped(http)["dyknow_samples_total"]
            return {
                labels.partition("stream=")[2]: value
                for labels, value in found.items()
                if labels.startswith("fate=accepted")
            }

        found = accepted()
        assert (found["s0"], found["s1"]) == (1, 2)
        assert found[""] == 3 + 4 + 5 + 6
        assert found.keys() == {"status", "s0", "s1", ""}
        lags = scraped(http)["dyknow_stream_lag_seconds"]
        assert lags["stream="] == 6  # the greatest: s5's last sample
        # One that is counted with others goes: their sum does not fall, and goes on from there.
        http.delete("/streams/s5").raise_for_status()
        assert accepted()[""] == 18
        body = samples(7, clock(), lambda n: {"n": n})
        http.post("/streams/s4/samples", content=body, headers=LINES).raise_for_status()
        assert accepted()[""] == 18 + 7
        # One that has its own line goes: the next one gets it, with all that it has counted.
        http.delete("/streams/s0").raise_for_status()
        assert accepted() == {"status": accepted()["status"], "s1": 2, "s2": 3, "": 25}
        check_exposition(http.get("/metrics").text)


def test_scrapes_that_overlap_count_an_increase_once() -> None:
    told = _Lines((("c_total", "counter", "Things", ("",)),), 0)
    counted = 10.0

    async def scrape(silent: int = 0) -> float:
        """With so many that say nothing behind the one that counts."""
        things = (("x", (None if i else counted,)) for i in range(silent + 1))
        return float((await told.text(things, 'stream=""')).split()[-1])

    async def overlapping() -> None:
        nonlocal counted
        assert await scrape() == 10
        async with anyio.create_task_group() as group:
            # It has read what was counted before the other begins, and would end after it.
            group.start_soon(scrape, 9 * SLICE)
            await anyio.lowlevel.checkpoint()
            counted = 15.0
            group.start_soon(scrape)
        assert await scrape() == 15

    anyio.run(overlapping)


# -- continuous queries --------------------------------------------------------------------------


def test_overruns_and_quarantines_are_told_by_query(settings: Settings, clock: Clock) -> None:
    engine = Engine(epoch="e1", budget=Budget(rows=20))
    with hosting(engine, settings, clock) as (_, http):
        http.put("/streams/s5", json={"fields": {"id": "string", "v": "float"}})
        http.post("/annotations", content="stream s5 contains speed(UAV) = v for every UAV = id")
        http.post("/queries", content=PAIRS).raise_for_status()
        ((labels, before),) = scraped(http)["dyknow_unit_overruns_total"].items()
        assert (before, "stream=pairs" in labels) == (0, True)
        assert "dyknow_unit_failed" not in scraped(http)
        begin = clock() - 60 * SECOND
        rows = [
            {"available": begin + second * SECOND + i, "valid": 0, "id": f"o{i}", "v": 1.0}
            for second in range(OVERRUNS + 2)
            for i in range(30)
        ]
        body = "\n".join(json.dumps(row) for row in rows)
        http.post("/streams/s5/samples", content=body, headers=LINES).raise_for_status()
        found = scraped(http)
        assert found["dyknow_unit_overruns_total"][labels] == OVERRUNS
        assert found["dyknow_unit_errors_total"][labels] >= OVERRUNS
        assert list(found["dyknow_unit_failed"].values()) == [1]
        assert "reason=quarantined" in next(iter(found["dyknow_unit_failed"]))


def test_a_unit_is_behind_what_was_published_to_it(
    engine: Engine, settings: Settings, clock: Clock
) -> None:
    with hosting(engine, settings, clock) as (_, http):
        http.put("/streams/s5", json={"fields": {"id": "string", "v": "float"}, "lateness": "20s"})
        http.post("/annotations", content="stream s5 contains speed(UAV) = v for every UAV = id")
        http.post("/queries", content=PAIRS).raise_for_status()
        assert "dyknow_unit_lag_seconds" not in scraped(http)
        body = samples(50, clock(), lambda i: {"id": "a", "v": 1.0})
        http.post("/streams/s5/samples", content=body, headers=LINES).raise_for_status()
        (lag,) = scraped(http)["dyknow_unit_lag_seconds"].values()
        assert 0 <= lag <= 1


# -- the data directory --------------------------------------------------------------------------


def test_commits_and_the_log_are_told(
    kept: tuple[Service, httpx.Client], disk: SimulatedDisk
) -> None:
    service, http = kept
    http.put("/streams/s5", json={"fields": {"n": "integer"}}).raise_for_status()
    before = scraped(http)
    for n in range(3):
        body = json.dumps({"valid": 0, "n": n})
        http.post("/streams/s5/samples", content=body, headers=LINES).raise_for_status()
    until(lambda: service.commands.uncommitted[0] == 0)
    after = scraped(http)

    def grown(name: str) -> float:
        return after[name][""] - before[name][""]

    commits = grown("dyknow_journal_commit_seconds_count")
    assert commits >= 3
    assert grown("dyknow_journal_commit_records_count") == commits
    # Ticks are commands, too; the start has committed one by itself.
    assert 3 <= grown("dyknow_journal_commit_records_sum") <= service.commands.position
    assert grown("dyknow_journal_written_bytes_total") > 3 * len('{"n": 1}')
    assert after["dyknow_journal_segments"][""] == 1
    assert after["dyknow_journal_size_bytes"][""] >= after["dyknow_journal_written_bytes_total"][""]
    assert after["dyknow_data_free_bytes"][""] > 0
    disk.room = 12345
    assert scraped(http)["dyknow_data_free_bytes"][""] == 12345


def test_a_sync_that_fails_and_what_waits_are_told(
    kept: tuple[Service, httpx.Client], disk: SimulatedDisk
) -> None:
    _, http = kept
    http.put("/streams/s5", json={"fields": {"n": "integer"}}).raise_for_status()
    disk.full_writes = True
    answer = http.post("/streams/s5/samples", content='{"valid": 0, "n": 1}', headers=LINES)
    assert answer.status_code == 507
    found = scraped(http)
    assert found["dyknow_journal_commit_failures_total"][""] >= 1
    assert found["dyknow_journal_waiting_records"][""] >= 1
    assert found["dyknow_journal_waiting_bytes"][""] > 0
    assert found["dyknow_ready"][""] == 0
    disk.full_writes = False
    # A checkpoint that began while the disk was full may still fail in between.
    until(lambda: http.get("/readyz").status_code == 200 and scraped(http)["dyknow_ready"][""] == 1)


def test_checkpoints_are_told(kept: tuple[Service, httpx.Client], disk: SimulatedDisk) -> None:
    service, http = kept
    http.put("/streams/s5", json={"fields": {"n": "integer"}}).raise_for_status()
    until(lambda: "dyknow_checkpoint_size_bytes" in scraped(http))
    found = scraped(http)
    assert found["dyknow_checkpoint_size_bytes"][""] > 100
    assert abs(found["dyknow_checkpoint_timestamp_seconds"][""] - time.time()) < 60
    assert found["dyknow_checkpoint_seconds_count"]["step=state"] >= 1
    assert 0 <= found["dyknow_checkpoint_behind_records"][""] <= service.commands.position
    disk.broken = {"open"}
    until(lambda: scraped(http)["dyknow_checkpoint_failures_total"][""] >= 1)
    disk.broken = set()


def test_a_disk_that_does_not_say_how_full_it_is(
    kept: tuple[Service, httpx.Client], disk: SimulatedDisk, monkeypatch: pytest.MonkeyPatch
) -> None:
    _, http = kept

    def fail(path: Path) -> int:
        raise OSError(errno.EIO, "input/output error")

    monkeypatch.setattr(disk, "free", fail)
    found = scraped(http)
    assert "dyknow_data_free_bytes" not in found
    assert "dyknow_journal_waiting_records" in found


# -- workers -------------------------------------------------------------------------------------


def test_why_workers_end_is_told(settings: Settings) -> None:
    pool = Pool(1, 64 << 20)
    try:
        for text, seconds, end in ((ENDLESS, 0.3, End.DEADLINE), (HUNGRY, 20, End.MEMORY)):
            with pytest.raises(WorkerError):
                pool.call(lambda worker: worker.call(job(text, seconds), 1000))  # noqa: B023
            assert pool.ends[end] == 1

        def killed(worker: object) -> object:
            os.kill(worker.pid, signal.SIGKILL)  # type: ignore[attr-defined]
            return worker.call(job("ASK {}"), 1000)  # type: ignore[attr-defined]

        with pytest.raises(WorkerError):
            pool.call(killed)  # type: ignore[arg-type]
        assert pool.ends[End.CRASH] == 1

        async def leave() -> None:
            with anyio.move_on_after(0.5):
                await pool.run(lambda worker: worker.call(job(ENDLESS, 60), 1000), 5)

        anyio.run(leave)
        until(lambda: pool.ends[End.LEFT] == 1)
        assert pool.ended == 4
        pool.call(lambda worker: worker.call(job("ASK {}"), 1000))
        counts = {
            (sample.labels["kind"], sample.labels["outcome"]): sample.value
            for family in pool.jobs.collect()
            for sample in family.samples
            if sample.name.endswith("_count")
        }
        outcomes = ("deadline", "memory", "crash", "left", "written")
        assert counts == {("query", outcome): 1 for outcome in outcomes}
    finally:
        pool.close()


def test_workers_and_jobs_are_told(engine: Engine, settings: Settings, clock: Clock) -> None:
    few = settings.model_copy(
        update={"sparql_workers": 1, "sparql_waiting": 5, "sparql_deadline": 20}
    )
    with hosting(engine, few, clock) as (_, http):
        http.get("/sparql", params={"query": "ASK {}"}).raise_for_status()
        http.get("/sparql", params={"query": "ASK { FILTER(1/0) }"})
        found = scraped(http)
        assert found["dyknow_workers"]["pool=sparql,state=idle"] == 1
        assert found["dyknow_workers"]["pool=documents,state=idle"] == 0
        assert found["dyknow_worker_job_seconds_count"]["kind=query,outcome=written"] == 2
        assert found["dyknow_worker_job_seconds_count"]["kind=follow,outcome=truth"] >= 1
        host, port = str(http.base_url).removeprefix("http://").rstrip("/").split(":")
        query = httpx.QueryParams({"query": ENDLESS})
        request = f"GET /sparql?{query} HTTP/1.1\r\nHost: localhost\r\n\r\n".encode()
        with (
            socket.create_connection((host, int(port))) as first,
            socket.create_connection((host, int(port))) as second,
        ):
            first.sendall(request)
            second.sendall(request)
            until(lambda: scraped(http)["dyknow_workers_waiting"]["pool=sparql"] == 1)
            # The first has its place before its worker has the job.
            until(lambda: scraped(http)["dyknow_workers"]["pool=sparql,state=busy"] == 1)
        until(lambda: scraped(http)["dyknow_worker_ends_total"]["pool=sparql,reason=left"] >= 1)
        http.post("/ontologies?name=x", content="<urn:a> <urn:b> <urn:c> .")
        read = scraped(http)["dyknow_worker_job_seconds_count"]
        assert read["kind=read,outcome=table"] == 1
        check_exposition(http.get("/metrics").text)
