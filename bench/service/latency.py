"""From a sample's arrival to the event at a client, through a running service.

    python bench/service/latency.py [--quick]

`dyknow serve` runs as a process of its own. 1,000 UAVs say how fast they are, 100,000 samples a
second together, published over one connection in batches, each when its last sample is due. A
batch is a request of its own, or all are one request whose samples are published as they come
(*live*). An event is asked for with [RANGE 1s STEP 10ms]: every window has ten events, those of
the UAVs that are fast. Samples bring their available times, so that the first one after a
window's end closes it; no clock does. *Latency* is from the moment when the batch with this
sample began to be sent to the arrival of the event; *since due* is from when that batch should
have been sent, so that a service that keeps the publisher waiting cannot hide it. Windows of the
first seconds are not counted: loops are loaded, the first window fills. Every event must come,
and none twice.
"""

from __future__ import annotations

import http.client
import os
import re
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np

from dyknow.rdf.namespaces import DYKNOW
from dyknow.service.cli import serving  # noqa: F401 - all loops of a service are known
from dyknow.service.client.client import Client
from dyknow.service.config.media_types import ARROW, NDJSON
from dyknow.streams.jit import compile_all
from dyknow.streams.time import parse_time

MS = 10**6
SECOND = 10**9
START = 1_633_633_973 * SECOND
RATE = 100_000
UAVS, FAST = 1_000, 10
STEP = 10 * MS
AIMS = {50: 2.0, 99: 20.0}
"""Milliseconds, by percentile."""
ROWS = (
    ("NDJSON", NDJSON, 1_000, False),
    ("NDJSON", NDJSON, 200, False),
    ("NDJSON", NDJSON, 100, False),
    ("Arrow", ARROW, 1_000, False),
    ("Arrow", ARROW, 200, False),
    ("live NDJSON", NDJSON, 1_000, True),
    ("live NDJSON", NDJSON, 200, True),
    ("live NDJSON", NDJSON, 100, True),
    ("live NDJSON", NDJSON, 50, True),
    ("live Arrow", ARROW, 200, True),
)
"""Format, samples a batch, and whether all batches go in one request."""
COMMAND = "from dyknow.service.cli import main; main()"
SSL = "stream flights contains speed(UAV) = speed for every UAV = id"
TEMPLATE = f"""REGISTER TEMPLATE dyknow:FastEvent(?o, ?type, ?threshold) COMPUTE EVERY 10ms AS
PREFIX dyknow: <{DYKNOW}>
CONSTRUCT {{?o dyknow:speed ?avgSpeed}}
WHERE {{ ?o a ?type . ?o dyknow:speed ?spd . }}
AGGREGATE {{(?avgSpeed, AVG, {{?spd}}) FILTER (?avgSpeed > ?threshold)}}
WINDOW [RANGE 1s STEP 10ms]
"""
DATA = re.compile(rb"event: sample\ndata: (.*)\n\n")
Event = tuple[int, int, str]
"""Its window's end, the moment when it came, its object."""


@dataclass(frozen=True)
class Samples:
    """Available (and valid) times, numbers of UAVs, speeds: each UAV in its turn."""

    time: np.ndarray
    uav: np.ndarray
    speed: np.ndarray

    @classmethod
    def make(cls, count: int) -> Samples:
        random = np.random.default_rng(5)
        uav = np.arange(count) % UAVS
        speed = random.uniform(50, 90, count) + np.where(uav < FAST, 60, 0)
        # A window holds what is after its begin, up to its end.
        at = START + (1 + np.arange(count)) * (SECOND // RATE)
        return cls(at, uav, speed.round(2))

    def ndjson(self, rows: slice) -> bytes:
        columns = (self.time[rows], self.uav[rows], self.speed[rows])
        parts = zip(*(column.tolist() for column in columns), strict=True)
        return b"".join(
            b'{"available":%d,"valid":%d,"id":"uav%d","speed":%.2f}\n' % (t, t, n, s)
            for t, n, s in parts
        )

    def arrow(self, rows: slice) -> bytes:
        import pyarrow as pa

        times = pa.array(self.time[rows]).cast(pa.timestamp("ns", "UTC"))
        names = [f"uav{n}" for n in self.uav[rows].tolist()]
        table = pa.table(
            {"available": times, "valid": times, "id": names, "speed": self.speed[rows]}
        )
        sink = pa.BufferOutputStream()
        with pa.ipc.new_stream(sink, table.schema) as writer:
            writer.write_table(table)
        found: bytes = sink.getvalue().to_pybytes()
        return found


@dataclass(frozen=True)
class Run:
    """What was noted of a run. Moments are of the monotonic clock (ns)."""

    closes: np.ndarray
    """By batch: the available time of its last sample."""
    due: np.ndarray
    sent: np.ndarray
    answered: np.ndarray
    events: list[Event]
    first: int
    """The batch from which on it counts."""
    cpu: float
    """Of the service from then on, in seconds a second."""


@contextmanager
def service() -> Iterator[tuple[str, int]]:
    """A service at a free port: its address and process id."""
    command = [sys.executable, "-c", COMMAND, "serve", "--port", "0", "--log-level", "warning"]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    try:
        assert process.stderr is not None
        found = re.search(r"http://\S+", process.stderr.readline())
        assert found is not None
        yield found[0], process.pid
    finally:
        process.terminate()
        process.wait(20)


def cpu_seconds(process: int) -> float:
    """What a process has used so far."""
    fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


class Listener(threading.Thread):
    """Follows a stream; notes each piece of the answer and when it came, and reads them later."""

    def __init__(self, address: str, stream: str) -> None:
        super().__init__(daemon=True)
        self._connection = http.client.HTTPConnection(address)
        self._connection.request("GET", f"/streams/{stream}/events")
        self._answer = self._connection.getresponse()
        self._pieces: list[tuple[int, bytes]] = []

    def run(self) -> None:
        while piece := self._answer.read1(1 << 16):
            self._pieces.append((time.monotonic_ns(), piece))

    def events(self) -> list[Event]:
        """What has come: an event is there when the last byte of its message is."""
        ends = np.cumsum([len(piece) for _, piece in self._pieces])
        found = []
        for message in DATA.finditer(b"".join(piece for _, piece in self._pieces)):
            at = int(np.searchsorted(ends, message.end()))
            data = msgspec.json.decode(message[1])
            found.append((parse_time(data["valid"]), self._pieces[at][0], data["values"]["id"]))
        return found


class Publisher:
    """Sends bodies over one connection, each when it is due, and notes the moments."""

    def __init__(self, address: str, kind: str, interval: int) -> None:
        self._connection = http.client.HTTPConnection(address)
        self._headers = {"Content-Type": kind}
        self._interval = interval
        self.moments: list[tuple[int, int, int]] = []
        """When each was due, begun, answered."""

    def send(self, bodies: list[bytes]) -> None:
        """The first one is due now."""
        begin = time.monotonic_ns()
        for number, body in enumerate(bodies):
            due = begin + number * self._interval
            wait = due - time.monotonic_ns()
            if wait > 0:
                time.sleep(wait / SECOND)
            sent = time.monotonic_ns()
            self._post(body)
            self.moments.append((due, sent, time.monotonic_ns()))

    def _post(self, body: bytes) -> None:
        self._connection.request("POST", "/streams/flights/samples", body, self._headers)
        self._read()

    def _read(self) -> None:
        answer = self._connection.getresponse()
        said = answer.read()
        if answer.status != 202:
            raise RuntimeError(f"{answer.status}: {said.decode()}")

    def finish(self) -> None:
        """Nothing more is sent."""


class LivePublisher(Publisher):
    """Sends all in one request, which ends with `finish`: nobody waits for an answer before."""

    def __init__(self, address: str, kind: str, interval: int) -> None:
        super().__init__(address, kind, interval)
        self._connection.putrequest("POST", "/streams/flights/samples/live")
        self._connection.putheader("Content-Type", kind)
        self._connection.putheader("Transfer-Encoding", "chunked")
        self._connection.endheaders()
        self._connection.sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def _post(self, body: bytes) -> None:
        self._connection.send(b"%x\r\n%s\r\n" % (len(body), body))

    def finish(self) -> None:
        self._connection.send(b"0\r\n\r\n")
        self._read()


def run(kind: str, batch: int, seconds: float, skipped: float, live: bool = False) -> Run:
    """So many ``seconds`` of load after ``skipped`` ones, in batches of ``batch`` samples, each a
    request, or all in one that is ``live``."""
    samples = Samples.make(int(RATE * (skipped + seconds)))
    encode = samples.arrow if kind == ARROW else samples.ndjson
    starts = range(0, len(samples.time), batch)
    bodies = [encode(slice(start, start + batch)) for start in starts]
    interval = batch * SECOND // RATE
    first = int(skipped * SECOND) // interval
    with service() as (url, process), Client(url) as client:
        client.put_stream("flights", {"id": "string", "speed": "float"})
        client.annotate(SSL)
        client.register_template(TEMPLATE)
        asked = client.request_event("dyknow:FastEvent", ["?o", "dyknow:UAV", "100"])
        address = url.removeprefix("http://")
        listener = Listener(address, asked["stream"])
        listener.start()
        publisher = (LivePublisher if live else Publisher)(address, kind, interval)
        publisher.send(bodies[:first])
        before = cpu_seconds(process)
        publisher.send(bodies[first:])
        used = cpu_seconds(process) - before
        publisher.finish()
        # The stream ends with the request, and so does the listener's answer.
        client.cancel_event(asked["id"])
        listener.join()
    closes = samples.time[np.minimum(np.array(starts) + batch, len(samples.time)) - 1]
    due, sent, answered = np.array(publisher.moments).T
    cpu = used / ((answered[-1] - sent[first]) / SECOND)
    return Run(closes, due, sent, answered, listener.events(), first, cpu)


def complete(run: Run) -> bool:
    """Whether each window that a sample has closed told each of its events once."""
    last = (int(run.closes[-1]) - 1) // STEP
    wanted = {
        (end * STEP, f"uav{n}") for end in range(START // STEP + 1, last + 1) for n in range(FAST)
    }
    return len(run.events) == len(wanted) and {(e, o) for e, _, o in run.events} == wanted


def latencies(run: Run) -> Mapping[str, np.ndarray]:
    """Milliseconds by event, from when the batch that closed its window was sent, and was due."""
    ends, arrived = np.array([event[:2] for event in run.events]).T
    closing = np.searchsorted(run.closes, ends, "right")
    arrived, closing = arrived[closing >= run.first], closing[closing >= run.first]
    return {
        "sent": (arrived - run.sent[closing]) / MS,
        "due": (arrived - run.due[closing]) / MS,
    }


def line(name: str, batch: int, run: Run) -> str:
    found, first = latencies(run), run.first
    seconds = (run.answered[-1] - run.due[first]) / SECOND
    rate = (len(run.sent) - first) * batch / seconds
    shown = [float(np.percentile(found["sent"], share)) for share in (50, 90, 99, 100)]
    post = float(np.median(run.answered[first:] - run.sent[first:])) / MS
    missed = [
        f"p{share}" for share, aim in AIMS.items() if np.percentile(found["sent"], share) >= aim
    ]
    text = f"{name:<12}{batch:>8,}{rate / 1e3:>9.1f}" + "".join(f"{v:>9.2f}" for v in shown)
    text += f"{np.percentile(found['due'], 99):>11.2f}{post:>9.2f}{run.cpu:>7.0%}"
    return text + (f"  (aim missed: {', '.join(missed)})" if missed else "")


def main(quick: bool = False) -> int:
    """Print the table."""
    seconds, skipped = (1.0, 1.5) if quick else (2.5, 1.5)
    # Kept on the disk for the services: the very first time would be all of a run.
    compile_all()
    print("milliseconds from sending the batch that closes a window to the event at the client")
    print(f"{'':<12}{'batch':>8}{'k/s':>9}{'p50':>9}{'p90':>9}{'p99':>9}{'max':>9}", end="")
    print(f"{'due p99':>11}{'answer':>9}{'CPU':>7}")
    agree = True
    for name, kind, batch, live in ROWS:
        done = run(kind, batch, seconds, skipped, live)
        agree &= complete(done)
        print(line(name, batch, done), flush=True)
    print(f"every event, once: {agree}")
    return 0 if agree else 1


if __name__ == "__main__":
    sys.exit(main("--quick" in sys.argv[1:]))
