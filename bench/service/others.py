"""Somebody else, in a process of its own: asks a service for small things all the time, and notes
how long each takes. Used by bombs.py, flood.py.

One after the other, without a pause that matters: ``GET /healthz``, ``GET /streams/quiet``, a batch
of three samples, and the last of these as a server-sent event. Connections are kept. A batch may be
refused for want of memory: then there is no event.
"""

from __future__ import annotations

import http.client
import json
import multiprocessing
import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing.connection import Connection

STREAM = "quiet"
PAUSE = 0.002
"""Seconds between two rounds: it is not to be the load."""
PATIENCE = 100.0
"""Seconds for one answer."""
KINDS = ("healthz", "stream", "publish", "event")


@dataclass(frozen=True)
class Wait:
    """When somebody began to wait (monotonic clock, s), for what, and how long (s)."""

    begun: float
    kind: str
    seconds: float


class Others:
    """The process, seen from the one that throws bombs."""

    def __init__(self, pipe: Connection) -> None:
        self._pipe = pipe

    def waits(self, since: float) -> list[Wait]:
        """Of those that waited after the moment ``since``. EOFError, OSError: it was not answered,
        or otherwise than it must be."""
        self._pipe.send("waits")
        if not self._pipe.poll(PATIENCE):
            raise OSError("others were not answered")
        found: list[Wait] = self._pipe.recv()
        return [wait for wait in found if wait.begun + wait.seconds >= since]


@contextmanager
def others(address: str) -> Iterator[Others]:
    """Somebody who uses the service at ``host:port``."""
    spawning = multiprocessing.get_context("spawn")
    here, there = spawning.Pipe()
    process = spawning.Process(target=_ask, args=(address, there), daemon=True)
    process.start()
    there.close()
    try:
        yield Others(here)
    finally:
        here.close()
        process.join(PATIENCE)


class _Events:
    """A client of the stream's events: tells when that of a sample has come."""

    def __init__(self, address: str) -> None:
        host, _, port = address.rpartition(":")
        self._socket = socket.create_connection((host, int(port)), PATIENCE)
        self._socket.sendall(
            f"GET /streams/{STREAM}/events HTTP/1.1\r\nHost: {address}\r\n\r\n".encode()
        )
        self._rest = b""
        self._until(b"\r\n\r\n")

    def wait_for(self, number: int) -> None:
        self._until(b'"v":%d}' % number)

    def _until(self, text: bytes) -> None:
        while text not in self._rest:
            piece = self._socket.recv(1 << 16)
            if not piece:
                raise OSError("the event stream has ended")
            self._rest += piece
        self._rest = self._rest.partition(text)[2]


def _ask(address: str, pipe: Connection) -> None:
    waits: list[Wait] = []
    connection = http.client.HTTPConnection(address, timeout=PATIENCE)

    def ask(method: str, path: str, body: bytes | None = None, kind: str = "") -> bool:
        headers = {"Content-Type": kind} if kind else {}
        connection.request(method, path, body, headers)
        answer = connection.getresponse()
        said = answer.read()
        if answer.status == 503 and b"memory" in said:
            return False
        if answer.status >= 300:
            raise OSError(f"{path}: {answer.status} {said.decode()}")
        return True

    fields = json.dumps({"fields": {"v": "integer"}}).encode()
    ask("PUT", f"/streams/{STREAM}", fields, "application/json")
    events = _Events(address)
    number = 0
    while True:
        begun = time.monotonic()
        ask("GET", "/healthz")
        asked = time.monotonic()
        ask("GET", f"/streams/{STREAM}")
        told = time.monotonic()
        lines = (json.dumps({"valid": number + each, "v": number + each}) for each in range(3))
        path = f"/streams/{STREAM}/samples"
        is_taken = ask("POST", path, "\n".join(lines).encode(), "application/x-ndjson")
        taken = time.monotonic()
        if is_taken:
            number += 3
            events.wait_for(number - 1)
        moments = (begun, asked, told, told, time.monotonic())
        ends = (asked, told, taken, moments[-1])
        waits += (
            Wait(begin, kind, end - begin)
            for kind, begin, end in zip(KINDS, moments, ends, strict=False)
        )
        try:
            if pipe.poll(PAUSE):
                pipe.recv()
                pipe.send(waits)
                waits = []
        except (EOFError, OSError):
            return
