"""The service as a process that is told to stop: in bounded time, status 0, and nothing that it
acknowledged is lost on who listens."""

from __future__ import annotations

import http.client
import signal
import socket
import threading
import time

import pytest
from asking import asking
from serving import Serving
from sse_clients import Reader, connect, read_all
from waiting import PATIENCE

LINE = {"Content-Type": "application/x-ndjson"}


def ready(**environment: str) -> Serving:
    """A service that is ready, with a stream `s`."""
    service = Serving(None, **environment)
    try:
        service.until(lambda: service.http.get("/readyz").status_code == 200)
        service.http.put("/streams/s", json={"fields": {"n": "integer"}}).raise_for_status()
    except BaseException:
        service.kill()
        raise
    return service


def address(service: Serving) -> str:
    return service.url.removeprefix("http://")


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
        except ConnectionResetError:
            pass  # The socket was closed while it was in its queue.
        time.sleep(0.01)


def test_under_load_all_that_was_acknowledged_is_delivered_and_the_status_is_0() -> None:
    with ready() as service:
        readers = [Reader(service.url, "/streams/s/events") for _ in range(3)]
        live = socket.create_connection(address(service).split(":"), timeout=120)
        head = "POST /streams/s/samples/live HTTP/1.1\r\nHost: localhost\r\n"
        head += "Content-Type: application/x-ndjson\r\nTransfer-Encoding: chunked\r\n\r\n"
        line = b'{"valid": 1, "n": 7}\n'
        live.sendall(head.encode() + b"%x\r\n%b\r\n" % (len(line), line))
        # A body that never comes to its end, and a client that takes nothing.
        stuck = socket.create_connection(address(service).split(":"), timeout=120)
        stuck.sendall(
            b"POST /streams/s/samples HTTP/1.1\r\nHost: localhost\r\nContent-Length: 50\r\n\r\n{"
        )
        half = socket.create_connection(address(service).split(":"), timeout=120)
        half.sendall(
            b"POST /streams/s/samples HTTP/1.1\r\nHost: localhost\r\nContent-Length: 20\r\n\r\n{"
        )
        stalled = connect(service.url, "/streams/s/events", receive=2048)
        publishers = [Publisher(address(service), number) for number in range(1, 4)]
        for one in publishers:
            one.start()
        while min(len(one.taken) for one in publishers) < 20:
            time.sleep(0.01)
        service.process.send_signal(signal.SIGTERM)
        wait_until_refused(address(service))
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
    assert "Traceback" not in service.log
    assert "serving" in service.log
    assert "stopped" in service.log


@pytest.mark.parametrize("second", [signal.SIGTERM, signal.SIGINT])
def test_a_second_signal_ends_it_at_once(second: signal.Signals) -> None:
    with ready(DYKNOW_DRAIN="3600") as service:
        reader = Reader(service.url, "/streams/s/events")
        service.process.send_signal(signal.SIGINT)
        with asking(service.url) as client:
            while client.get("/readyz").status_code == 200:
                time.sleep(0.01)
        service.process.send_signal(second)
        assert service.process.wait(PATIENCE) == 1  # and not after an hour
        read_all([reader])
    assert "Traceback" not in service.log


def test_it_drains_first_not_ready_and_still_taking_requests() -> None:
    with ready(DYKNOW_DRAIN="8") as service:
        with asking(service.url) as client:
            service.process.send_signal(signal.SIGTERM)
            while (answer := client.get("/readyz")).status_code == 200:
                time.sleep(0.01)
            assert answer.json()["reasons"] == ["stopping: the service stops"]
            batch = client.post("/streams/s/samples", content='{"valid": 1, "n": 1}', headers=LINE)
            assert batch.status_code == 202
            assert client.get("/healthz").status_code == 200
        assert service.process.wait(PATIENCE) == 0
