"""What a data directory costs: publishing over HTTP with and without it, commits, and the restart.

    python bench/service/journal.py

A service in a process of its own, one client, one connection; in turns. Restart: until `/readyz`
says that all is well, of a service that was killed with a million samples in its log and no
checkpoint, all of which its one query reads again; to import the modules is a part of it.
"""

from __future__ import annotations

import os
import shutil
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import httpx

from dyknow.engine.durability.commands import (
    DeclareStream,
    Publish,
    RegisterQuery,
)
from dyknow.engine.durability.durable_engine import RecordedEngine
from dyknow.engine.model.views import StreamDeclaration
from dyknow.service.durability.fork_snapshot import Snapshots
from dyknow.streams.sample import Field, FieldType

SAMPLES = 300_000
LOGGED = 1_000_000
SIZES = (1_000, 100, 10)
RUNS = 3
WAYS = ("none", "write", "fsync")
QUERY = """REGISTER STREAM fast COMPUTE EVERY 1s AS
CONSTRUCT { ?o dyknow:speed ?average }
FROM STREAM <http://www.ida.liu.se/dyknow/s.trdf> [RANGE 5s STEP 1s]
WHERE { ?o dyknow:speed ?v }
AGGREGATE {(?average, AVG, {?v}) FILTER (?average > 45)}"""
WIDE = """REGISTER STREAM wide%d COMPUTE EVERY 1s AS
SELECT ?o (MAX(?v) AS ?most)
FROM STREAM <http://www.ida.liu.se/dyknow/s.trdf> [RANGE %ds STEP 1s]
WHERE { ?o dyknow:speed ?v } GROUP BY ?o"""


class Served:
    """A service in a process of its own; ``folder`` None keeps nothing."""

    def __init__(self, folder: Path | None, durability: str = "fsync") -> None:
        command = [str(Path(sys.executable).parent / "dyknow"), "serve", "--port", "0"]
        if folder is not None:
            command += ["--data", str(folder), "--durability", durability]
        variables = {**os.environ, "DYKNOW_CHECKPOINT_INTERVAL": "1e9"}
        variables["DYKNOW_CHECKPOINT_BYTES"] = str(1 << 40)
        variables["DYKNOW_CHECKPOINT_WORK"] = "1e9"
        self.begun = time.perf_counter()
        self._process = subprocess.Popen(command, env=variables, stderr=subprocess.PIPE, text=True)
        assert self._process.stderr is not None
        for line in self._process.stderr:
            if "serves at" in line:
                url = line.split("serves at ")[1].split(" ")[0]
                break
        self.client = httpx.Client(base_url=url, trust_env=False, timeout=60)
        while self.client.get("/readyz").status_code != 200:
            time.sleep(0.01)
        self.seconds = time.perf_counter() - self.begun

    @property
    def process(self) -> int:
        """Its id."""
        return self._process.pid

    def prepare(self) -> None:
        fields = {"id": "string", "v": "float"}
        self.client.put("/streams/s", json={"fields": fields}).raise_for_status()
        said = "stream s contains speed(UAV) = v for every UAV = id"
        self.client.post("/annotations", content=said).raise_for_status()
        self.client.post("/queries", content=QUERY).raise_for_status()

    def publish(self, bodies: list[bytes]) -> float:
        kind = {"Content-Type": "application/x-ndjson"}
        begin = time.perf_counter()
        for body in bodies:
            answer = self.client.post("/streams/s/samples", content=body, headers=kind)
            assert answer.status_code == 202, answer.text
        return time.perf_counter() - begin

    def end(self, how: signal.Signals = signal.SIGKILL) -> None:
        self.client.close()
        self._process.send_signal(how)
        self._process.wait()
        assert self._process.stderr is not None
        self._process.stderr.close()


def bodies(samples: int, size: int) -> list[bytes]:
    """NDJSON of 100 objects, a thousand samples a second of stream time."""
    lines = [
        b'{"valid":%d,"available":%d,"id":"uav%d","v":%d.5}'
        % (i * 10**6, i * 10**6, i % 100, i % 50)
        for i in range(samples)
    ]
    return [b"\n".join(lines[i : i + size]) for i in range(0, samples, size)]


def main() -> None:
    """Print the tables."""
    root = Path(tempfile.mkdtemp(prefix="dyknow-bench-"))
    try:
        print("thousand samples a second over HTTP, one connection, one query; in turns, median")
        print(f"{'batch':>6}" + "".join(f"{way:>10}" for way in WAYS) + "  fsync against none")
        for size in SIZES:
            sent = bodies(SAMPLES if size > 10 else SAMPLES // 10, size)
            count = size * len(sent)
            rates: dict[str, list[float]] = {way: [] for way in WAYS}
            for run in range(RUNS):
                for way in WAYS:
                    folder = None if way == "none" else root / f"{size}-{way}-{run}"
                    served = Served(folder, way if folder else "fsync")
                    served.prepare()
                    rates[way].append(count / served.publish(sent) / 1000)
                    served.end()
            median = {way: statistics.median(found) for way, found in rates.items()}
            told = "".join(f"{median[way]:10,.0f}" for way in WAYS)
            print(f"{size:6,}{told}{median['fsync'] / median['none']:12.2f}")
        restart(root / "restart")
    finally:
        shutil.rmtree(root)


def restart(folder: Path) -> None:
    """Of a service that was killed, with a log and with a checkpoint."""
    empty = Served(None)
    empty.end()
    served = Served(folder)
    served.prepare()
    served.publish(bodies(LOGGED, 1_000))
    served.end()
    size = sum(path.stat().st_size for path in (folder / "journal").iterdir())
    logged = Served(folder)
    logged.end(signal.SIGTERM)
    after = Served(folder)
    after.end()
    print(f"\nstart with nothing kept                                {empty.seconds:6.2f} s")
    print(
        f"start with {LOGGED:,} samples in the log, {size / 2**20:.0f} MiB        "
        f"{logged.seconds:6.2f} s"
    )
    print(f"start from the checkpoint of a clean stop              {after.seconds:6.2f} s")
    checkpoint(folder)


def checkpoint(folder: Path) -> None:
    """How long a service stands still while its state is taken, and one with sixty queries."""
    recorded = RecordedEngine(folder, now=0)
    recorded.do(DeclareStream(StreamDeclaration("more", (Field("v", FieldType.FLOAT),))))
    taken(recorded)
    for number in range(60):
        recorded.do(RegisterQuery(WIDE % (number, 30 + number)))
    for i, body in enumerate(bodies(LOGGED + 100_000, 1_000)[LOGGED // 1_000 :]):
        recorded.do(Publish("s", "ndjson", body, i))
        recorded.log.commit()
    taken(recorded)
    recorded.close(checkpoint=False)


def taken(recorded: RecordedEngine) -> None:
    """How long it takes to take a checkpoint, in both ways."""
    for how, aside in (("by a copy of the process", Snapshots().take), ("at once", None)):
        begin = time.perf_counter()
        unwritten = recorded.checkpoint(aside)
        seconds = time.perf_counter() - begin
        unwritten.write()
        kept = recorded.disk_use().checkpoint
        assert kept is not None
        size = f"{kept.size / 2**20:.1f} MiB"
        print(f"a checkpoint of {size:9} {how:26} {seconds * 1000:12.1f} ms")


if __name__ == "__main__":
    main()
