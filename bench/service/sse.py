"""Many clients of one stream's server-sent events: latency, what a client costs, who is cut off.

    python bench/service/sse.py [--quick]

`dyknow serve` runs as a process of its own; this one is all its clients and the publisher, so that
each has a core where there are two. A *delivery* is a sample at a client; its latency is from the
moment when the publisher began to send it to the moment when the client has all of its message.
*Stalled* clients read nothing; *cut* ones close their connection after a random number of bytes
and resume after the last message that they had whole. Every client that reads must get every
sample once and in order.
"""

from __future__ import annotations

import http.client
import json
import random
import re
import resource
import select
import socket
import sys
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from latency import cpu_seconds, service

from dyknow.service.client.client import Client
from dyknow.streams.jit import compile_all

MS = 10**6
SECOND = 10**9
MESSAGE = re.compile(rb'id: ([^\n]+)-(\d+)\nevent: sample\ndata: [^\n]*"sent":(\d+)[^\n]*\n\n')
PADDING = "x" * 100
"""A field of each sample, so that a message has about 300 bytes."""
AIM = 1.0
"""Seconds, p99 of 25,000 deliveries a second."""
RATIO = 1.2
"""At most so many times the p99 without stalled and cut ones."""


@dataclass(slots=True)
class Listener:
    """One client: what of its answer is not a whole message yet, and how far it has got."""

    connection: socket.socket
    cuts: bool = False
    rest: bytes = b""
    last: int = 0
    """The number of the last sample; 0 while it does not matter which one is the first."""
    epoch: bytes = b""
    budget: int = 0
    """Bytes after which it cuts the connection."""


@dataclass(slots=True)
class Load:
    """All clients, read in one loop."""

    address: tuple[str, int]
    path: str
    listeners: dict[int, Listener] = field(default_factory=dict)
    idle: list[socket.socket] = field(default_factory=list)
    """The connections of stalled clients."""
    latencies: list[int] = field(default_factory=list)
    """Of the clients that neither stall nor cut."""
    faults: int = 0
    """Samples that were missed, or came twice."""
    resumed: int = 0
    _epoll: select.epoll = field(default_factory=select.epoll)
    _random: random.Random = field(default_factory=lambda: random.Random(5))

    def connect(self, count: int, *, cuts: bool = False) -> None:
        for _ in range(count):
            self._add(Listener(self._open(b""), cuts, budget=self._random.randrange(300, 6000)))

    def stall(self, count: int) -> None:
        for _ in range(count):
            connection = self._open(b"", receive=4096)
            self.idle.append(connection)

    def read(self, until: float) -> None:
        """Take what comes until the moment ``until`` (of the monotonic clock)."""
        while (left := until - time.monotonic()) > 0:
            for number, _ in self._epoll.poll(min(left, 0.1)):
                self._receive(self.listeners[number])

    def leave(self, count: int) -> None:
        """So many of the clients that came last leave."""
        for number, listener in list(self.listeners.items())[len(self.listeners) - count :]:
            self._epoll.unregister(number)
            listener.connection.close()
            del self.listeners[number]

    def close(self) -> None:
        self.leave(len(self.listeners))
        for connection in self.idle:
            connection.close()
        self.idle.clear()

    def _open(self, after: bytes, receive: int | None = None) -> socket.socket:
        connection = socket.socket()
        if receive:
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, receive)
        connection.connect(self.address)
        resume = b"Last-Event-ID: %b\r\n" % after if after else b""
        connection.sendall(
            b"GET %b HTTP/1.1\r\nHost: localhost\r\n%b\r\n" % (self.path.encode(), resume)
        )
        return connection

    def _add(self, listener: Listener) -> None:
        number = listener.connection.fileno()
        self.listeners[number] = listener
        self._epoll.register(number, select.EPOLLIN)

    def _receive(self, listener: Listener) -> None:
        data = listener.connection.recv(1 << 16)
        if not data:
            raise RuntimeError("the service let a client go that reads")
        now = time.monotonic_ns()
        if listener.cuts:
            data = data[: listener.budget]
            listener.budget -= len(data)
        data = listener.rest + data
        end = 0
        for message in MESSAGE.finditer(data):
            number = int(message[2])
            self.faults += listener.last not in (0, number - 1)
            listener.last, listener.epoch = number, message[1]
            if not listener.cuts:
                self.latencies.append(now - int(message[3]))
            end = message.end()
        listener.rest = data[end:]
        if listener.cuts and listener.budget <= 0:
            self._resume(listener)

    def _resume(self, listener: Listener) -> None:
        number = listener.connection.fileno()
        self._epoll.unregister(number)
        del self.listeners[number]
        listener.connection.close()
        after = b"%b-%d" % (listener.epoch, listener.last) if listener.last else b""
        listener.connection = self._open(after)
        listener.rest, listener.budget = b"", self._random.randrange(300, 6000)
        self.resumed += 1
        self._add(listener)


class Publisher(threading.Thread):
    """Publishes batches of ``size`` samples, ``rate`` of them a second, until it is stopped."""

    def __init__(self, address: tuple[str, int], rate: float, size: int = 1) -> None:
        super().__init__(daemon=True)
        self._connection = http.client.HTTPConnection(*address)
        self._rate, self._size = rate, size
        self._stopping = threading.Event()
        self.published = 0
        self.answers: list[int] = []
        """Nanoseconds from request to answer."""

    def run(self) -> None:
        begin = time.monotonic()
        number = 0
        while not self._stopping.wait(max(0.0, begin + number / self._rate - time.monotonic())):
            sent = time.monotonic_ns()
            line = json.dumps({"valid": sent, "sent": sent, "padding": PADDING}) + "\n"
            headers = {"Content-Type": "application/x-ndjson"}
            self._connection.request("POST", "/streams/load/samples", line * self._size, headers)
            answer = self._connection.getresponse()
            if answer.status != 202:
                raise RuntimeError(f"{answer.status}: {answer.read().decode()}")
            answer.read()
            self.answers.append(time.monotonic_ns() - sent)
            self.published += self._size
            number += 1

    def finish(self) -> None:
        self._stopping.set()
        self.join()


@dataclass(frozen=True, slots=True)
class Row:
    """One line of the table."""

    name: str
    clients: int
    rate: float
    size: int = 1


ROWS = (
    Row("one client", 1, 20),
    Row("1,000 clients", 1_000, 5),
    Row("5,000 clients", 5_000, 5),
    Row("5,000 clients, batches of 10", 5_000, 2, size=10),
)


def memory(process: int) -> int:
    """The bytes of a process that are in memory."""
    pages = int(Path(f"/proc/{process}/statm").read_text().split()[1])
    return pages * resource.getpagesize()


def kernel_memory() -> int:
    """The bytes that all TCP sockets of the machine hold in buffers."""
    found = re.search(r"^TCP:.* mem (\d+)", Path("/proc/net/sockstat").read_text(), re.MULTILINE)
    assert found is not None
    return int(found[1]) * resource.getpagesize()


def run(row: Row, seconds: float) -> tuple[str, float, bool]:
    """The line, the p99 (ms), and whether each reader got each sample once."""
    with service() as (url, process), Client(url) as client:
        host, _, port = url.removeprefix("http://").rpartition(":")
        address = (host, int(port))
        client.put_stream("load", {"sent": "integer", "padding": "string"})
        load = Load(address, "/streams/load/events")
        warm = Publisher(address, 20)
        warm.start()
        time.sleep(1.5)  # the loops of the service are loaded
        warm.finish()
        before = memory(process)
        load.connect(row.clients)
        while client.status()["clients"] < row.clients:
            load.read(time.monotonic() + 0.1)
        load.read(time.monotonic() + 0.5)
        each = (memory(process) - before) / row.clients
        publisher = Publisher(address, row.rate, row.size)
        load.latencies.clear()
        publisher.start()
        cpu, begin = cpu_seconds(process), time.monotonic()
        load.read(begin + seconds)
        cpu = (cpu_seconds(process) - cpu) / (time.monotonic() - begin)
        delivered = len(load.latencies) / seconds
        publisher.finish()
        load.read(time.monotonic() + 1)
        newest = client.stream("load")["last"]
        complete = not load.faults and all(one.last == newest for one in load.listeners.values())
        found = np.array(load.latencies) / MS
        p50, p99, most = (float(np.percentile(found, share)) for share in (50, 99, 100))
        answer = float(np.percentile(publisher.answers, 99)) / MS
        load.close()
    line = f"{row.name:<42}{delivered:>9,.0f}{p50:>9.1f}{p99:>9.1f}{most:>9.1f}"
    line += f"{answer:>9.1f}{cpu:>7.0%}{each / 1024:>9.1f}"
    return line + ("" if complete else f"  NOT COMPLETE ({load.faults})"), p99, complete


def disturbed(turns: int, seconds: float) -> tuple[float, float, int, bool]:
    """The p99 (ms, median of turns) of 1,000 clients, and of the healthy 800 when of the others
    100 are stalled and 100 are cut and resume, again and again; how often they did; whether each
    that reads got each sample once. In one service, in turns: what else the machine does is the
    same for both."""
    found: tuple[list[float], list[float]] = ([], [])
    with service() as (url, _), Client(url) as client:
        host, _, port = url.removeprefix("http://").rpartition(":")
        client.put_stream("load", {"sent": "integer", "padding": "string"})
        load = Load((host, int(port)), "/streams/load/events")
        load.connect(800)
        publisher = Publisher((host, int(port)), 5)
        publisher.start()
        load.read(time.monotonic() + 4)  # the loops of the service are loaded
        for _ in range(turns):
            for p99s, cuts, stalled in zip(found, (0, 100), (0, 100), strict=True):
                others = 200 - stalled
                load.connect(others, cuts=bool(cuts))
                load.stall(stalled)
                load.read(time.monotonic() + 1.5)
                load.latencies.clear()
                load.read(time.monotonic() + seconds)
                p99s.append(float(np.percentile(load.latencies, 99)) / MS)
                load.leave(others)
                for connection in load.idle:
                    connection.close()
                load.idle.clear()
        publisher.finish()
        load.read(time.monotonic() + 1)
        newest = client.stream("load")["last"]
        complete = not load.faults and all(one.last == newest for one in load.listeners.values())
        load.close()
    p99, other = (float(np.median(each)) for each in found)
    return p99, other, load.resumed, complete


def stalled(count: int, megabytes: int) -> str:
    """What clients cost that take nothing, while so much is published that they never had."""
    with service() as (url, process), Client(url) as client:
        host, _, port = url.removeprefix("http://").rpartition(":")
        client.put_stream("load", {"sent": "integer", "padding": "string"})
        body = json.dumps({"valid": 1, "sent": 1, "padding": PADDING * 10}) + "\n"
        client.publish("load", body.encode() * 100)
        load = Load((host, int(port)), "/streams/load/events?since=start")
        load.connect(1)
        for _ in range(megabytes):
            client.publish("load", body.encode() * 900)
        load.read(time.monotonic() + 1)
        before, kernel = memory(process), kernel_memory()
        load.stall(count)
        load.read(time.monotonic() + 2)
        own = (memory(process) - before) / count / 1024
        buffers = (kernel_memory() - kernel) / count / 1024
        load.close()
    return (
        f"each of {count} stalled clients, {megabytes} MB behind: {own:.0f} KiB of the service, "
        f"{buffers:.0f} KiB of the kernel for both ends"
    )


def main(quick: bool = False) -> int:
    """Print the table."""
    most = resource.getrlimit(resource.RLIMIT_NOFILE)[1]
    resource.setrlimit(resource.RLIMIT_NOFILE, (most, most))
    # The publisher's thread is not to wait for the readers' longer than it must.
    sys.setswitchinterval(0.0005)
    compile_all()
    seconds = 3.0 if quick else 8.0
    print("milliseconds from publishing to the client; answer: of the publisher; KiB: a client")
    print(f"{'':<42}{'/s':>9}{'p50':>9}{'p99':>9}{'max':>9}{'answer':>9}{'CPU':>7}{'KiB':>9}")
    p99s: dict[str, list[float]] = {row.name: [] for row in ROWS}
    agree = True
    for row in ROWS if quick else (*ROWS, *ROWS[1:3], *ROWS[1:3]):
        line, p99, complete = run(row, seconds)
        p99s[row.name].append(p99)
        agree &= complete
        print(line, flush=True)
    print(stalled(100, 20))
    p99, other, resumed, complete = disturbed(1 if quick else 3, seconds / 2)
    agree &= complete
    print(
        f"1,000 clients: p99 {p99:.1f} ms; of 800 beside 100 stalled and 100 that were cut and ",
        end="",
    )
    print(f"resumed {resumed:,} times: {other:.1f} ms, {other / p99:.2f} times (aim: {RATIO})")
    median = float(np.median(p99s[ROWS[2].name]))
    print(f"5,000 clients: p99 {median:.0f} ms (aim: {AIM * 1000:.0f})")
    print(f"every sample at every client, once: {agree}")
    return 0 if agree else 1


if __name__ == "__main__":
    sys.exit(main("--quick" in sys.argv[1:]))
