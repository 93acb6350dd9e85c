"""A service that is used without end: does it need more and more?

    python bench/service/soak.py [SECONDS]      600 unless you say; `make soak` runs it

A service with a data directory, in a process of its own. Round after round a template is
registered, requested, followed over SSE and fed, subscriptions and queries come and go, samples are
sent again, some of objects that nobody names again, clients break off, refused texts are sent; then
all of it is given up. A query and subscriptions stay all the time. Exit status 1 when the memory of
the service or that of its workers grows after the first third, or `WARM` rounds if these are more,
by more than `MOST` (least squares, less twice the error), when there are more descriptors, threads
or streams in the second half of that, when a checkpoint or a worker has failed, or when the service
does not stop.
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from itertools import count
from pathlib import Path

import httpx
import numpy as np

STREAM = {
    "fields": {"id": "string", "v": "float"},
    "lateness": "1s",
    "retention": {"samples": 20_000},
}
TEMPLATE = """REGISTER TEMPLATE dyknow:Soak%dEvent(?o, ?type, ?limit) COMPUTE EVERY 1s AS
PREFIX dyknow: <http://www.ida.liu.se/dyknow/>
CONSTRUCT {?o dyknow:speed ?average}
WHERE { ?o a ?type . ?o dyknow:speed ?v . }
AGGREGATE {(?average, AVG, {?v}) FILTER (?average > ?limit)}
WINDOW [RANGE 5s STEP 1s]"""
QUERY = """REGISTER STREAM soak%d COMPUTE EVERY 1s AS
SELECT ?o (MAX(?v) AS ?most) FROM STREAM <http://www.ida.liu.se/dyknow/s.trdf> [RANGE 3s STEP 1s]
WHERE { ?o dyknow:speed ?v } GROUP BY ?o"""
NDJSON = {"Content-Type": "application/x-ndjson"}
STANDING = """REGISTER QUERY standing COMPUTE EVERY 1s AS
SELECT ?o (AVG(?v) AS ?mean) FROM STREAM <http://www.ida.liu.se/dyknow/s.trdf> [RANGE 5s STEP 1s]
WHERE { ?o dyknow:speed ?v } GROUP BY ?o"""
POLICIES = ("any change", "sample every 1s, max delay 2s", "monotone order, max delay 1s")
MOST = 0.01
"""MiB a round by which memory may grow."""
WARM = 1_500
"""Rounds until what is remembered of what was is full: 10,000 names of removed streams, of which a
round has seven."""
FAILURES = ("dyknow_checkpoint_failures_total", "dyknow_worker_ends_total")


class Soaked:
    """The service, and one client that does all there is to do."""

    def __init__(self, folder: Path) -> None:
        command = [str(Path(sys.executable).parent / "dyknow"), "serve", "--port", "0"]
        command += ["--data", str(folder), "--log-level", "error"]
        variables = {**os.environ, "DYKNOW_CHECKPOINT_INTERVAL": "20"}
        self._process = subprocess.Popen(command, env=variables, stderr=subprocess.PIPE, text=True)
        assert self._process.stderr is not None
        url = next(
            line.split("serves at ")[1].split(" ")[0]
            for line in self._process.stderr
            if "serves at" in line
        )
        self._http = httpx.Client(base_url=url, trust_env=False, timeout=60)
        self._time = 0
        self._send("PUT", "/streams/s", json=STREAM)
        self._send(
            "POST", "/annotations", content="stream s contains speed(UAV) = v for every UAV = id"
        )
        self._send("POST", "/queries", content=STANDING)
        for policy in POLICIES:
            self._send("POST", "/subscriptions", json={"stream": "s", "policy": policy})

    def round(self, number: int) -> None:
        """What comes and goes."""
        name = f"Soak{number}Event"
        self._send("POST", "/templates", content=TEMPLATE % number)
        asked = [
            self._send("POST", "/events", content=f"dyknow:{name}(?o, dyknow:UAV, {limit})")
            for limit in (10, 20, 30, 40, 50)
        ]
        self._send("POST", "/queries", content=QUERY % number)
        wanted = {"stream": "s", "policy": "sample every 1s, max delay 2s"}
        subscribed = self._send("POST", "/subscriptions", json=wanted)
        self._send("POST", "/templates", content="REGISTER TEMPLATE nothing", status=400)
        self._send("GET", "/sparql", params={"query": "SELECT ?s WHERE { ?s a ?t } LIMIT 5"})
        events = asked[0]["events"]
        with self._http.stream("GET", events) as answer:
            for batch in range(10):
                self._publish(number * 10 + batch)
            for line in answer.iter_lines():
                if line.startswith("data:"):
                    break  # and off: the connection is closed in the middle of the answer
        for each in asked:
            self._send("DELETE", f"/events/{each['id']}")
        self._send("DELETE", f"/subscriptions/{subscribed['id']}")
        self._send("DELETE", f"/queries/soak{number}")
        self._send("DELETE", f"/templates/{name}")

    def _publish(self, number: int) -> None:
        rows = []
        for i in range(200):
            self._time += 5_000_000
            # Terms are forgotten when some ten thousand have come: every seventy rounds.
            name = f"uav{i % 50}" if i % 4 else f"seen{self._time}"
            row = {"id": name, "v": float((i * 7 + number) % 100)}
            rows.append(json.dumps({"valid": self._time, "available": self._time, **row}))
        key = {**NDJSON, "Idempotency-Key": str(number)}
        for _ in range(2):
            self._send("POST", "/streams/s/samples", content="\n".join(rows), headers=key)

    def _send(self, method: str, path: str, status: int = 0, **given: object) -> dict[str, str]:
        answer = self._http.request(method, path, **given)
        right = answer.status_code == status if status else answer.is_success
        assert right, f"{method} {path}: {answer.status_code} {answer.text}"
        found: dict[str, str] = answer.json() if answer.content else {}
        return found

    def sizes(self) -> tuple[float, float, int, int, int]:
        """Resident memory of the service and of its workers (MiB), descriptors, threads,
        streams."""
        pid = self._process.pid
        # A copy of the service that writes a checkpoint is no worker, and may be gone by now.
        servers = [
            child
            for child in children(pid)
            if b"workers.worker_main" in _read(Path(f"/proc/{child}/cmdline"))
        ]
        workers = [status(worker) for server in servers for worker in children(server)]
        own = status(pid)
        streams = len(self._http.get("/streams").json())
        files = len(list(Path(f"/proc/{pid}/fd").iterdir()))
        return memory(own), sum(map(memory, workers)), files, int(own["Threads"]), streams

    def failures(self) -> float:
        """How many checkpoints and workers have failed."""
        lines = self._http.get("/metrics").text.splitlines()
        return sum(float(line.split()[-1]) for line in lines if line.startswith(FAILURES))

    def end(self) -> int:
        """Stop it; its exit status."""
        self._http.close()
        self._process.send_signal(signal.SIGTERM)
        assert self._process.stderr is not None
        self._process.stderr.close()
        return self._process.wait()


def children(pid: int) -> list[int]:
    """The processes whose parent it is."""
    threads = Path(f"/proc/{pid}/task").glob("*/children")
    return [int(child) for each in threads for child in _read(each).split()]


def _read(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except FileNotFoundError:
        return b""


def status(pid: int) -> dict[str, str]:
    """What the system says of a process."""
    text = _read(Path(f"/proc/{pid}/status")).decode()
    return dict(line.split(":", 1) for line in text.splitlines())


def memory(status: dict[str, str]) -> float:
    """Resident memory (MiB)."""
    return int(status.get("VmRSS", "0").split()[0]) / 1024


def slope(memory: np.ndarray) -> tuple[float, float]:
    """MiB a round, and the error of that."""
    (rate, _), covariance = np.polyfit(np.arange(len(memory)), memory, 1, cov=True)
    return float(rate), float(np.sqrt(covariance[0, 0]))


def main(seconds: float) -> int:
    """Print a line now and then; 1 when something grows."""
    folder = Path(tempfile.mkdtemp(prefix="dyknow-soak-"))
    soaked = Soaked(folder)
    begun = time.monotonic()
    found: list[tuple[float, ...]] = []
    try:
        print(
            f"{'seconds':>8}{'rounds':>8}{'MiB':>9}{'workers':>9}{'files':>7}{'threads':>9}"
            f"{'streams':>9}"
        )
        told = 0.0
        for number in count(1):
            soaked.round(number)
            now = time.monotonic() - begun
            found.append((now, *soaked.sizes()))
            if now >= told or now >= seconds:
                told = now + seconds / 12
                _, own, workers, files, threads, streams = found[-1]
                print(
                    f"{now:8.0f}{number:8}{own:9.1f}{workers:9.1f}{files:7}{threads:9}{streams:9}",
                    flush=True,
                )
            if now >= seconds:
                break
        failures = soaked.failures()
        status = soaked.end()
    finally:
        shutil.rmtree(folder)
    warm = max(sum(row[0] < seconds / 3 for row in found), min(WARM, 3 * len(found) // 4))
    later = np.array(found[warm:])
    grows = False
    print(f"after {warm} rounds:")
    for place, name in ((1, "the service"), (2, "its workers")):
        rate, error = slope(later[:, place])
        grows |= rate - 2 * error > MOST
        print(f"memory of {name} grows by {rate:.4f} MiB a round, give or take {2 * error:.4f}")
    half = len(later) // 2
    more = later[half:, 3:].max(axis=0) - later[:half, 3:].max(axis=0)
    print(f"more files, threads, streams in the second half: {more.astype(int).tolist()}")
    print(f"checkpoints and workers that failed: {failures:.0f}")
    print(f"exit status of the service: {status}")
    return int(grows or bool((more > 0).any()) or failures > 0 or status != 0)


if __name__ == "__main__":
    sys.exit(main(float(sys.argv[1]) if len(sys.argv) > 1 else 600.0))
