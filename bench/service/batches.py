"""How long others wait for a large batch: one of 8 MiB, the most there may be, of each kind.

    python bench/service/batches.py [--data] [--read] [NAME …]

A client asks for ``/healthz`` every 5 ms over one connection while another publishes a batch, four
times for each kind. A row tells its longest waits and how long the batches took, in ms. With
``--data`` there is a data directory; with ``--read`` a query reads the stream, of kinds with
objects. How long a wait is depends on what else the machine does: on
two cores that are not busy the longest is about that of one turn.
"""

from __future__ import annotations

import http.client
import json
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from dyknow.service.config.media_types import ARROW, NDJSON
from journal import Served

SIZE = 8 << 20
RUNS = 4
FIELDS = {"id": "string", "x": "float", "n": "integer"}
TEXTS = dict.fromkeys("abcd", "string")
WIDE = {f"f{i}": "float" for i in range(100)}
QUERY = """REGISTER QUERY reader COMPUTE EVERY 1s AS SELECT ?o (MAX(?v) AS ?most)
FROM STREAM <http://www.ida.liu.se/dyknow/%s.trdf> [RANGE 3s STEP 1s]
WHERE { ?o dyknow:altitude ?v } GROUP BY ?o"""
Kind = tuple[dict[str, str] | None, str, Callable[[], bytes]]
"""The fields that are declared, the content type, the body."""


def lines(form: str, *more: Callable[[int], object]) -> Callable[[], bytes]:
    """Lines of ``form``, with the number of each and ``more`` of it; as many as fit."""

    def make() -> bytes:
        found, size = [], 0
        while size < SIZE - 1000:
            number = len(found)
            found.append((form % (number, *(each(number) for each in more))).encode() + b"\n")
            size += len(found[-1])
        return b"".join(found)

    return make


def with_last(make: Callable[[], bytes], last: bytes) -> Callable[[], bytes]:
    return lambda: make() + last


def table(*, is_fresh: bool = False, is_dictionary: bool = False) -> Callable[[], bytes]:
    def make() -> bytes:
        import pyarrow as pa

        count = 220_000
        names = pa.array([f"uav{i if is_fresh else i % 100}" for i in range(count)])
        columns = {
            "valid": np.arange(count),
            "id": names.dictionary_encode() if is_dictionary else names,
            "x": np.arange(count) / 4,
            "n": np.arange(count),
        }
        given, sink = pa.table(columns), pa.BufferOutputStream()
        with pa.ipc.new_stream(sink, given.schema) as writer:
            writer.write_table(given)
        found: bytes = sink.getvalue().to_pybytes()
        return found

    return make


REGULAR = lines('{"valid":%d,"id":"uav%d","x":%d.25,"n":7}', lambda i: i % 100, lambda i: i)
ESCAPES = lines('{"valid":%d,"id":"\\u0075av%d","x":%d.25,"n":7}', lambda i: i % 100, lambda i: i)
FRESH = lines(
    '{"valid":%d,"a":"%x","b":"%x","c":"%x","d":"%x"}', *[lambda i, k=k: i + k for k in range(4)]
)
BAD = b'{"valid":1,"id":"a","x":true,"n":1}\n'
KINDS: dict[str, Kind] = {
    "regular": (FIELDS, NDJSON, REGULAR),
    "escapes": (FIELDS, NDJSON, ESCAPES),
    "fresh texts": (TEXTS, NDJSON, FRESH),
    "open stream, regular": (None, NDJSON, REGULAR),
    "open stream, escapes": (None, NDJSON, ESCAPES),
    "100 columns": (
        WIDE,
        NDJSON,
        lines(f'{{"valid":%d,{",".join(f"{json.dumps(name)}:1.5" for name in WIDE)}}}'),
    ),
    "bad last line": (FIELDS, NDJSON, with_last(REGULAR, BAD)),
    "bad last line, escapes": (FIELDS, NDJSON, with_last(ESCAPES, BAD)),
    "line feeds": (FIELDS, NDJSON, lambda: b"\n" * (SIZE - 100) + BAD.replace(b"true", b"1")),
    "one line": (FIELDS, NDJSON, lambda: b'{"valid":1,"x":[' + b"{}," * (SIZE // 3 - 100) + b"1]}"),
    "Arrow": (FIELDS, ARROW, table()),
    "Arrow, dictionary": (FIELDS, ARROW, table(is_dictionary=True)),
    "Arrow, fresh texts": (FIELDS, ARROW, table(is_fresh=True)),
}


def longest_wait(served: Served, work: Callable[[], Any]) -> float:
    """Of who asks for /healthz every 5 ms, in seconds."""
    stop, waits = threading.Event(), []
    address = served.client.base_url.netloc.decode()

    def look() -> None:
        connection = http.client.HTTPConnection(address, timeout=60)
        while not stop.is_set():
            begin = time.perf_counter()
            connection.request("GET", "/healthz")
            connection.getresponse().read()
            waits.append(time.perf_counter() - begin)
            stop.wait(0.005)
        connection.close()

    thread = threading.Thread(target=look)
    thread.start()
    try:
        time.sleep(0.05)
        waits.clear()
        work()
    finally:
        stop.set()
        thread.join()
    return max(waits)


def measure(served: Served, kind: Kind, stream: str, is_read: bool) -> tuple[int, float, float]:
    """The answer's status, and seconds: the longest wait of somebody else, and until the answer."""
    fields, content_type, make = kind
    http_ = served.client
    if fields is None:
        http_.post("/kpl", content=f"source pos {stream}").raise_for_status()
    else:
        http_.put(f"/streams/{stream}", json={"fields": fields}).raise_for_status()
    if is_read:
        contains = f"stream {stream} contains altitude(UAV) = x for every UAV = id"
        http_.post("/annotations", content=contains).raise_for_status()
        http_.post("/queries", content=QUERY % stream).raise_for_status()
    body, said = make(), []

    def post() -> None:
        begin = time.perf_counter()
        headers = {"Content-Type": content_type}
        answer = http_.post(f"/streams/{stream}/samples", content=body, headers=headers)
        said.append((answer.status_code, time.perf_counter() - begin))

    waited = longest_wait(served, post)
    if is_read:
        http_.delete("/queries/reader").raise_for_status()
    if fields is not None:
        http_.delete(f"/streams/{stream}")
    return said[0][0], waited, said[0][1]


def main(*arguments: str) -> None:
    """Print the table."""
    is_read = "--read" in arguments
    names = [name for name in arguments if name not in ("--data", "--read")]
    names = names or [name for name in KINDS if KINDS[name][0] is FIELDS or not is_read]
    with tempfile.TemporaryDirectory(prefix="dyknow-bench-") as folder:
        served = Served(Path(folder) / "data" if "--data" in arguments else None)
        try:
            time.sleep(5)  # what is compiled beside the start
            print(f"{'':24}{'':>5}{'others wait at most, ms':>32}{'the answer takes, ms':>32}")
            for name in names:
                found = [
                    measure(served, KINDS[name], f"s{list(KINDS).index(name)}_{run}", is_read)
                    for run in range(RUNS)
                ]
                waits = "".join(f"{1000 * wait:8.1f}" for _, wait, _ in found)
                took = "".join(f"{1000 * took:8.0f}" for _, _, took in found)
                print(f"{name:24}{found[0][0]:5}{waits}{took}", flush=True)
        finally:
            served.end()


if __name__ == "__main__":
    main(*sys.argv[1:])
