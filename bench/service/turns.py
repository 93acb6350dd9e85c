"""How long others wait while a query does its worst: bombs go off in a service one after the other.

    python bench/service/turns.py [NAME …]

A client asks ``/healthz`` and for another stream, and publishes to that one, which a small query
reads, over and over; first with nothing else going on, then while samples come to a stream that a
bomb reads. A row tells the median and the 99th percentile of its waits in ms, and the longest;
``posts`` is how long the batches took of who publishes to the bomb's own stream, together.
"""

from __future__ import annotations

import json
import statistics
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial

import httpx
from latency import service

PREFIX = "PREFIX dyknow: <http://www.ida.liu.se/dyknow/> "
NDJSON, TEXT = {"Content-Type": "application/x-ndjson"}, {"Content-Type": "text/plain"}
PAIRS = "?a dyknow:speed ?b . ?c dyknow:speed ?d . ?e dyknow:speed ?f . ?g dyknow:speed ?h"
BOMBS = {
    "product": (f"SELECT ?a ?e WHERE {{ {PAIRS} }}", "[RANGE 1s STEP 1s]"),
    "filtered product": (
        f"SELECT ?a WHERE {{ {PAIRS} FILTER (?b + ?d + ?f + ?h < 0) }}",
        "[RANGE 1s STEP 1s]",
    ),
    "pairs within the limits": (
        "SELECT (COUNT(*) AS ?n) WHERE { ?a dyknow:speed ?b . ?c dyknow:speed ?d "
        "FILTER (?b < ?d) }",
        "[RANGE 1s STEP 100ms]",
    ),
    "paths": (
        "SELECT ?a ?x ?z WHERE { ?x (!<urn:x>)* ?y . ?y (!<urn:y>)* ?z }",
        "[RANGE 1s STEP 1s]",
    ),
    "Oxigraph": (
        "SELECT ?a ?z WHERE { ?a dyknow:speed ?b BIND (STR(?a) AS ?x0) "
        + " ".join(f"BIND (CONCAT(?x{i}, ?x{i}, ?x{i}) AS ?x{i + 1})" for i in range(12))
        + " BIND (SHA512(?x12) AS ?z) }",
        "[RANGE 1s STEP 1s]",
    ),
    "texts put together": (
        "SELECT (GROUP_CONCAT(STR(?b)) AS ?all) WHERE { ?a dyknow:speed ?b . ?c dyknow:speed ?d }",
        "[RANGE 1s STEP 1s]",
    ),
    "a million windows": (
        "SELECT (COUNT(*) AS ?n) WHERE { ?a dyknow:speed ?b }",
        "[RANGE 1h STEP 5us]",
    ),
}
OBJECTS, SECONDS = 400, 8


def batch(second: float, objects: int) -> str:
    rows = []
    for number in range(objects):
        at = int(second * 1_000_000_000) + number
        rows.append({"valid": at, "available": at, "id": f"u{number}", "spd": float(number)})
    return "\n".join(map(json.dumps, rows))


def declare(http: httpx.Client, stream: str) -> None:
    http.put(f"/streams/{stream}", json={"fields": {"id": "string", "spd": "float"}})
    ssl = f"stream {stream} contains speed(UAV) = spd for every UAV = id"
    http.post("/annotations", content=ssl, headers=TEXT).raise_for_status()


def register(http: httpx.Client, name: str, stream: str, text: str, window: str) -> None:
    source = f"FROM STREAM <http://www.ida.liu.se/dyknow/{stream}.trdf> {window} WHERE"
    text = f"REGISTER QUERY {name} AS {PREFIX}{text.replace('WHERE', source, 1)}"
    http.post("/queries", content=text, headers=TEXT).raise_for_status()


def publish(http: httpx.Client, stream: str, body: str) -> None:
    """Publish, and wait where the readers of the stream hold it back."""
    path = f"/streams/{stream}/samples"
    while (answer := http.post(path, content=body, headers=NDJSON)).status_code == 429:
        time.sleep(0.05)
    answer.raise_for_status()


@contextmanager
def looking(url: str, stream: str) -> Iterator[list[float]]:
    """What somebody else has to wait for, each time."""
    waits: list[float] = []
    stop = threading.Event()

    def look() -> None:
        second = 0
        with httpx.Client(base_url=url, trust_env=False, timeout=120) as http:
            while not stop.is_set():
                second += 1
                for ask in (
                    lambda: http.get("/healthz").raise_for_status(),
                    lambda: http.get(f"/streams/{stream}").raise_for_status(),
                    partial(publish, http, stream, batch(second, 3)),
                ):
                    begin = time.perf_counter()
                    ask()
                    waits.append(time.perf_counter() - begin)
                stop.wait(0.005)

    thread = threading.Thread(target=look)
    thread.start()
    try:
        yield waits
    finally:
        stop.set()
        thread.join()


def told(waits: list[float]) -> str:
    ordered = sorted(1000 * wait for wait in waits)
    last = ordered[int(0.99 * len(ordered))]
    return f"{statistics.median(ordered):8.1f} {last:8.1f} {ordered[-1]:8.1f}"


def main() -> None:
    names = sys.argv[1:] or list(BOMBS)
    with service() as (url, _), httpx.Client(base_url=url, trust_env=False, timeout=120) as http:
        print(f"{'others wait, ms':26} {'p50':>8} {'p99':>8} {'worst':>8} {'posts':>8}")
        declare(http, "quiet")
        register(
            http,
            "count_quiet",
            "quiet",
            "SELECT (COUNT(*) AS ?n) WHERE { ?o dyknow:speed ?v }",
            "[RANGE 5s STEP 1s]",
        )
        time.sleep(5)  # what is compiled beside the start
        with looking(url, "quiet") as waits:
            time.sleep(SECONDS / 2)
        print(f"{'nothing else':26} {told(waits)}", flush=True)
        for number, name in enumerate(names):
            other, stream = f"other{number}", f"bomb{number}"
            text, window = BOMBS[name]
            declare(http, stream)
            declare(http, other)
            register(
                http,
                f"count_{other}",
                other,
                "SELECT (COUNT(*) AS ?n) WHERE { ?o dyknow:speed ?v }",
                "[RANGE 5s STEP 1s]",
            )
            register(http, f"q{number}", stream, text, window)
            with looking(url, other) as waits:
                begin = time.perf_counter()
                for second in range(1, SECONDS):
                    publish(http, stream, batch(second, OBJECTS))
                took = time.perf_counter() - begin
                time.sleep(1)
            found = http.get(f"/queries/q{number}").json()
            http.delete(f"/queries/q{number}")
            state = (found["failure"] or found["state"])[:60]
            print(f"{name:26} {told(waits)} {1000 * took:8.0f}  {state}", flush=True)


if __name__ == "__main__":
    main()
