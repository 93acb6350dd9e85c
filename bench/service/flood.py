"""How large a service becomes that is flooded, and whether there is a way back.

    python bench/service/flood.py [NAME …]

`dyknow serve` with a data directory and a limit of `LIMIT` for its memory is a process of its own.
Eight senders publish, as fast as they can, what stays, until everything is refused (503), and go on
for `AFTER` seconds. A row is a kind of samples. It tells how many bytes were taken until then,
how much larger than its limit the service became, what others waited meanwhile (others.py: median,
99th percentile, the longest, in ms) and, when its streams are removed, after how many seconds a
batch is taken again. The end's status is 1 when the service became larger than a fifth more than
its limit, takes nothing after all was removed, has given a wrong answer, or has ended.
"""

from __future__ import annotations

import http.client
import json
import os
import statistics
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import bombs
from others import others

LIMIT = 640 << 20
MOST = 1.2
SENDERS = 8
AFTER = 3.0
"""Seconds for which the senders go on when nothing is taken any more."""
PATIENCE = 120.0
"""Seconds in which the limit is reached."""
SIZE = 4 << 20
"""Bytes of a batch."""
LAST = "flooded"
NDJSON = "application/x-ndjson"
TEXTS = {"fields": {"id": "string", "text": "string"}}
MANY = {"samples": 100_000_000}
NUMBERS = {"fields": {f"v{i}": "float" for i in range(8)}, "retention": MANY}
COUNT = """REGISTER QUERY counted COMPUTE EVERY 1h AS
SELECT (COUNT(DISTINCT ?t) AS ?many)
FROM STREAM <http://www.ida.liu.se/dyknow/{name}.trdf> [RANGE 10h STEP 1h]
WHERE {{ ?o <http://www.ida.liu.se/dyknow/note> ?t }}"""
NOTES = """@prefix : <http://www.dyknow.eu/ontology#> .
@prefix owl: <http://www.w3.org/2002/07/owl#> .
@prefix dyknow: <http://www.ida.liu.se/dyknow/> .
dyknow:note a :Feature, owl:DatatypeProperty ."""
CONTAINS = "stream {name} contains note(UAV) = text for every UAV = id"


@dataclass(frozen=True)
class Flood:
    """What is sent: how its streams are declared, and a batch of samples by a number."""

    stream: dict[str, object]
    batch: Callable[[int], bytes]
    path: str = "/streams/{name}/samples"
    is_asked: bool = False
    """Whether a query has its samples in its window."""


def texts(length: int) -> Callable[[int], bytes]:
    """Batches of texts of so many characters, all of them new."""

    def batch(number: int) -> bytes:
        rows = SIZE // (length + 60)
        new = (os.urandom(length // 2).hex() for _ in range(rows))
        return "\n".join(
            json.dumps({"valid": number * rows + i, "id": f"u{i % 9}", "text": text})
            for i, text in enumerate(new)
        ).encode()

    return batch


def stamped(length: int) -> Callable[[int], bytes]:
    """The same, with available times of their own."""

    def batch(number: int) -> bytes:
        rows = SIZE // (length + 80)
        new = (os.urandom(length // 2).hex() for _ in range(rows))
        times = ((number * rows + i) * 1000 for i in range(rows))
        return "\n".join(
            json.dumps({"valid": at, "available": at, "id": f"u{at % 9}", "text": text})
            for at, text in zip(times, new, strict=True)
        ).encode()

    return batch


def numbers(number: int) -> bytes:
    """Numbers, of which a sample takes much more in JSON than in memory."""
    values = ", ".join(f'"v{i}": {i}' for i in range(8))
    rows = SIZE // (len(values) + 30)
    return "\n".join(f'{{"valid": {number * rows + i}, {values}}}' for i in range(rows)).encode()


FLOODS = {
    "long texts": Flood(TEXTS, texts(60_000)),
    "texts of 1,000 characters": Flood(TEXTS, texts(1_000)),
    "short texts, all kept": Flood({**TEXTS, "retention": MANY}, texts(20)),
    "numbers, all kept": Flood(NUMBERS, numbers),
    "live, long texts": Flood(TEXTS, texts(60_000), "/streams/{name}/samples/live"),
    "held back within the lateness": Flood({**TEXTS, "lateness": "1000d"}, stamped(1_000)),
    "in the window of a query": Flood(
        {**TEXTS, "retention": {"samples": 1}}, stamped(1_000), is_asked=True
    ),
}


class Sender:
    """One who floods a stream of its own."""

    def __init__(self, address: str, name: str, flood: Flood) -> None:
        self.name = name
        self.answers: Counter[str] = Counter()
        self.taken = 0
        self.is_refused = False
        self._flood = flood
        self._connection = http.client.HTTPConnection(address, timeout=PATIENCE)

    def declare(self) -> None:
        self._must("PUT", f"/streams/{self.name}", json.dumps(self._flood.stream).encode())
        if self._flood.is_asked:
            self._must("POST", "/ontologies?name=urn:notes", NOTES.encode(), "text/turtle")
            self._must(
                "POST", "/annotations", CONTAINS.format(name=self.name).encode(), "text/plain"
            )
            query = COUNT.format(name=self.name).replace("counted", f"counted{self.name}")
            self._must("POST", "/queries", query.encode(), "text/plain")

    def run(self, ended: threading.Event) -> None:
        number = 0
        while not ended.is_set():
            body = self._flood.batch(number)
            number += 1
            status = self.send(body)
            self.answers[status] += 1
            if status == "202":
                self.taken += len(body)
            elif status == "503":
                self.is_refused = True
                time.sleep(0.05)
            else:
                return

    def send(self, body: bytes) -> str:
        path = self._flood.path.format(name=self.name)
        status, said = self._asked("POST", path, body, NDJSON)
        return status if status != "503" or b"memory" in said else f"503 {said[:200]!r}"

    def remove(self) -> None:
        if self._flood.is_asked:
            self._asked("DELETE", f"/queries/counted{self.name}")
        self._must("DELETE", f"/streams/{self.name}")

    def _must(
        self, method: str, path: str, body: bytes = b"", kind: str = "application/json"
    ) -> None:
        status, said = self._asked(method, path, body, kind)
        if not status.startswith("2"):
            raise RuntimeError(f"{method} {path}: {status} {said.decode()}")

    def _asked(
        self, method: str, path: str, body: bytes = b"", kind: str = ""
    ) -> tuple[str, bytes]:
        connection = self._connection
        try:
            try:
                connection.request(method, path, body, {"Content-Type": kind} if kind else {})
                answer = connection.getresponse()
            except (BrokenPipeError, ConnectionResetError):
                # A live body is refused before its end; the answer is there.
                answer = http.client.HTTPResponse(connection.sock, method=method)
                answer.begin()
            said = answer.read()
        except (OSError, http.client.HTTPException) as error:
            connection.close()
            return type(error).__name__, b""
        if answer.will_close:
            connection.close()
        return str(answer.status), said


def largest(pid: int) -> int:
    """The most bytes of memory that the process had so far (Linux)."""
    for line in Path(f"/proc/{pid}/status").read_text().splitlines():
        if line.startswith("VmHWM:"):
            return int(line.split()[1]) * 1024
    raise RuntimeError("no VmHWM: this bench needs Linux")


def copies(pid: int, ended: threading.Event) -> Iterator[int]:
    """Bytes of memory that processes made by this one take together, now and then."""
    while not ended.is_set():
        found = 0
        for each in Path(f"/proc/{pid}/task").glob("*/children"):
            try:
                for child in each.read_text().split():
                    found += int(Path(f"/proc/{child}/statm").read_text().split()[1]) * 4096
            except OSError:
                continue
        yield found
        time.sleep(0.05)


def row(flood: Flood) -> tuple[str, bool]:
    """Flood a new service; what is told of it, and whether all is well."""
    with (
        tempfile.TemporaryDirectory() as folder,
        bombs.service(Path(folder)) as (address, process),
        others(address) as somebody,
    ):
        time.sleep(1)
        senders = [Sender(address, f"s{i}", flood) for i in range(SENDERS)]
        for sender in senders:
            sender.declare()
        ended = threading.Event()
        threads = [threading.Thread(target=each.run, args=(ended,)) for each in senders]
        begun = time.monotonic()
        for thread in threads:
            thread.start()
        most = 0
        reached: float | None = None
        for size in copies(process.pid, ended):
            most = max(most, size)
            now = time.monotonic()
            if reached is None and all(each.is_refused for each in senders):
                reached = now
            alive = any(thread.is_alive() for thread in threads)
            if not alive or now - (reached or begun + PATIENCE) > AFTER:
                ended.set()
        for thread in threads:
            thread.join()
        waits = sorted(each.seconds * 1000 for each in somebody.waits(begun))
        peak = largest(process.pid)
        removed = time.monotonic()
        for sender in senders:
            sender.remove()
        last = Sender(address, LAST, flood)
        back = None
        while back is None and time.monotonic() - removed < PATIENCE / 4:
            try:
                last.declare()
            except RuntimeError:
                time.sleep(0.1)
                continue
            if last.send(flood.batch(0)) == "202":
                back = time.monotonic() - removed
        is_alive = process.poll() is None
    answers = sum((each.answers for each in senders), Counter())
    taken = sum(each.taken for each in senders)
    is_well = (
        reached is not None
        and peak <= MOST * LIMIT
        and back is not None
        and is_alive
        and set(answers) <= {"202", "503"}
    )
    told = (
        f"{taken / 2**20:8.0f} {(peak - LIMIT) / 2**20:+6.0f} {most / 2**20:6.0f} "
        f"{statistics.median(waits):7.1f} {waits[int(0.99 * len(waits))]:7.1f} {waits[-1]:7.1f} "
        f"{'never' if back is None else f'{back:.1f}':>7}  {dict(answers)}"
    )
    return told, is_well


def main(names: list[str]) -> int:
    os.environ["DYKNOW_MEMORY_LIMIT"] = str(LIMIT)
    print(f"limit {LIMIT / 2**20:.0f} MiB; sizes in MiB, waits in ms, back in s")
    print(
        f"{'':32s} {'taken':>8} {'beyond':>6} {'copies':>6} "
        f"{'median':>7} {'p99':>7} {'longest':>7} {'back':>7}"
    )
    good = True
    for name, flood in FLOODS.items():
        if not names or any(each in name for each in names):
            told, is_well = row(flood)
            good &= is_well
            print(f"{name:32s} {told}{'' if is_well else '  MISSED'}", flush=True)
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
