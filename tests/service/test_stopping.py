"""The service as a process that is told to stop: in bounded time, status 0, and nothing that it
acknowledged is lost on who listens."""

from __future__ import annotations

import http.client
import os
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

import httpx
import pytest
from sse_clients import Reader, connect, read_all
from waiting import PATIENCE

COMMAND = "from dyknow.service.cli import main; main()"
LINE = {"Content-Type": "application/x-ndjson"}


@dataclass
class Process:
    """`dyknow serve`, and what it writes to standard error."""

    process: subprocess.Popen[str]
    url: str = ""
    lines: list[str] = field(default_factory=list)

    @property
    def address(self) -> str:
        return self.url.removeprefix("http://")

    def read(self) -> None:
        assert self.process.stderr is not None
        for line in self.process.stderr:
            self.lines.append(line)

    def log(self) -> str:
        return "".join(self.lines)


@contextmanager
def serving(*arguments: str, **environment: str) -> Iterator[Process]:
    command = [sys.executable, "-c", COMMAND, "serve", "--port", "0", *arguments]
    variables = {**os.environ, **environment}
    popen = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, env=variables)
    assert popen.stderr is not None
    found = Process(popen)
    try:
        first = popen.stderr.readline()
        url = re.search(r"http://\S+", first)
        assert url is not None, first + popen.stderr.read()
        found.url = url[0]
        reader = threading.Thread(target=found.read)
        reader.start()
        with httpx.Client(base_url=found.url, trust_env=False, timeout=60) as client:
            while client.get("/readyz").status_code != 200:
                time.sleep(0.02)
            client.put("/streams/s", json={"fields": {"n": "integer"}})
        yield found
    finally:
        popen.kill()
        popen.wait()
        reader.join()
        popen.stderr.close()


class Publisher(threading.Thread):
    """Posts batch after batch until it is not answered any more."""

    def __init__(self, address: str, number: int) -> None:
        super().__init__()
        self.taken: list[int] = []
        """The numbers of the batches that were acknowledged."""
        self.others: list[int] = []
        self._connection = http.client.HTTPConnection(address, timeout=120)
        self._number = number

    def run(self) -> None:
        batch = self._number * 1_000_000
        try:
            while True:
                batch += 1
                body = f'{{"valid": {batch}, "n": {batch}}}\n'.encode() * 3
                self._connection.request("POST", "/streams/s/samples", body, LINE)
                status = self._connection.getresponse()
                status.read()
                (self.taken if status.status == 202 else self.others).append(batch)
        except (OSError, http.client.HTTPException):
            self._connection.close()


def wait_until_refused(address: str) -> None:
    while True:
        try:
            socket.create_connection(address.split(":"), timeout=60).close()
        except ConnectionRefusedError:
            return
        time.sleep(0.01)


def test_under_load_all_that_was_acknowledged_is_delivered_and_the_status_is_0() -> None:
    with serving() as service:
        readers = [Reader(service.url, "/streams/s/events") for _ in range(3)]
        live = socket.create_connection(service.address.split(":"), timeout=120)
        head = "POST /streams/s/samples/live HTTP/1.1\r\nHost: localhost\r\n"
        head += "Content-Type: application/x-ndjson\r\nTransfer-Encoding: chunked\r\n\r\n"
        line = b'{"valid": 1, "n": 7}\n'
        live.sendall(head.encode() + b"%x\r\n%b\r\n" % (len(line), line))
        # A body that never comes to its end, and a client that takes nothing.
        stuck = socket.create_connection(service.address.split(":"), timeout=120)
        stuck.sendall(
            b"POST /streams/s/samples HTTP/1.1\r\nHost: localhost\r\nContent-Length: 50\r\n\r\n{"
        )
        half = socket.create_connection(service.address.split(":"), timeout=120)
        half.sendall(
            b"POST /streams/s/samples HTTP/1.1\r\nHost: localhost\r\nContent-Length: 20\r\n\r\n{"
        )
        stalled = connect(service.url, "/streams/s/events", receive=2048)
        publishers = [Publisher(service.address, number) for number in range(1, 4)]
        for one in publishers:
            one.start()
        while min(len(one.taken) for one in publishers) < 20:
            time.sleep(0.01)
        service.process.send_signal(signal.SIGTERM)
        wait_until_refused(service.address)
        half.sendall(b'"valid": 9, "n": 9}')
        assert b" 202 " in half.recv(4096).split(b"\r\n")[0]
        read_all(readers)
        for one in publishers:
            one.join(120)
        # It would wait for ever if it waited for the bodies, or for who takes nothing.
        assert service.process.wait(PATIENCE) == 0
        answer = live.recv(65536)
        assert b" 503 " in answer.split(b"\r\n")[0]
        assert b'"accepted":1' in answer
        # Of each batch that was acknowledged three samples came, at every client.
        taken = 3 * sum(len(one.taken) for one in publishers) + 2
        for reader in readers:
            ids = [int(id.rpartition(b"-")[2]) for id in reader.samples]
            assert ids == list(range(1, len(ids) + 1))
            assert len(ids) >= taken
            # Of others at most those whose answer the end cut off.
            assert len(ids) <= taken + 3 * len(publishers)
        assert [one.others for one in publishers] == [[]] * 3
        for one in (live, stuck, half, stalled):
            one.close()
    assert "Traceback" not in service.log()
    assert "serving" in service.log()
    assert "stopped" in service.log()


@pytest.mark.parametrize("second", [signal.SIGTERM, signal.SIGINT])
def test_a_second_signal_ends_it_at_once(second: signal.Signals) -> None:
    with serving(DYKNOW_DRAIN="3600") as service:
        reader = Reader(service.url, "/streams/s/events")
        service.process.send_signal(signal.SIGINT)
        with httpx.Client(base_url=service.url, trust_env=False, timeout=60) as client:
            while client.get("/readyz").status_code == 200:
                time.sleep(0.01)
        service.process.send_signal(second)
        assert service.process.wait(PATIENCE) == 1  # and not after an hour
        read_all([reader])
    assert "Traceback" not in service.log()


def test_it_drains_first_not_ready_and_still_taking_requests() -> None:
    with serving(DYKNOW_DRAIN="8") as service:
        with httpx.Client(base_url=service.url, trust_env=False, timeout=60) as client:
            service.process.send_signal(signal.SIGTERM)
            while (answer := client.get("/readyz")).status_code == 200:
                time.sleep(0.01)
            assert answer.json()["reasons"] == ["stopping: the service stops"]
            batch = client.post("/streams/s/samples", content='{"valid": 1, "n": 1}', headers=LINE)
            assert batch.status_code == 202
            assert client.get("/healthz").status_code == 200
        assert service.process.wait(PATIENCE) == 0
