"""How long others wait while a service is attacked: bombs through each input path.

    python bench/service/bombs.py [--quick] [--each] [NAME …]

`dyknow serve` with a data directory is a process of its own, and so is somebody who asks it for
small things all the time (others.py). A row is some bombs of a kind, thrown one after the other:
those of tests/support/worlds/bombs.py, the heavy requests of heavy.py, slow bodies, and the queries
of turns.py. It tells what was answered (status × times), how long the slowest took, and how long
the others waited meanwhile: median, 99th percentile and the longest, in ms. ``--each`` tells of
each bomb; a NAME chooses the rows in whose names it is.

The aim is that nobody waits 100 ms longer than the longest wait without bombs. What misses it is
thrown again, twice at most, as other programs may have had the processor; the best of these counts.
The end's status is 1 when a row missed it, an answer was wrong, or the service has ended.
"""

from __future__ import annotations

import http.client
import os
import re
import statistics
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import heavy
import httpx
import turns
from heavy import Shot
from others import Others, Wait, others
from slow import slow_bodies

from dyknow.tests.support.worlds import bombs as tests

COMMAND = "from dyknow.service.cli import main; main()"
AIM = 100.0
"""Milliseconds beyond the longest wait without bombs."""
AFTER = 0.3
"""Seconds in which a bomb has its effect when it is answered."""
TRIES = 3
STREAMS, POLICIES = 2_000, 512
"""So many there are for who looks at all."""
LIMITS = {
    "DYKNOW_SPARQL_DEADLINE": "1",
    "DYKNOW_QUERY_DEADLINE": "0.5",
    "DYKNOW_BODY_TIMEOUT": "5",
    "DYKNOW_LIVE_TIMEOUT": "5",
}
"""Shorter than usual, that the bench may end."""
ENDLESS = {"owl:sameAs", "a transitive chain"}
"""Ontologies that take all of their time, as does another one."""
RIGHT = {"200", "201", "202", "204", "400", "404", "408", "413", "422", "429", "503", "left"}
"""What may be answered; `left`: it was not waited for."""
Thrown = Callable[[], Counter[str]]
Row = Callable[[int], list[tuple[str, Thrown]]]


@dataclass
class Seen:
    """What came of bombs of a kind: answers, the slowest one (s), and others' waits."""

    answers: Counter[str]
    slowest: float
    waits: list[Wait]
    worst: str = ""
    """The bomb during which somebody waited longest."""
    each: list[tuple[str, float, float]] = field(default_factory=list)

    @property
    def longest(self) -> float:
        return max((wait.seconds for wait in self.waits), default=0.0) * 1000


@contextmanager
def service(data: Path) -> Iterator[tuple[str, subprocess.Popen[bytes]]]:
    """A service that keeps its data there, at a free port: ``host:port`` and its process."""
    command = [sys.executable, "-c", COMMAND, "serve", "--port", "0", "--data", str(data / "data")]
    log = data / "log"
    with log.open("wb") as to:
        process = subprocess.Popen(command, stderr=to, env={**os.environ, **LIMITS})
    try:
        while (found := re.search(r"http://(\S+:\d+)", log.read_text())) is None:
            if process.poll() is not None:
                raise RuntimeError(log.read_text())
            time.sleep(0.05)
        yield found[1], process
    finally:
        process.terminate()
        process.wait(60)


def throw(address: str, shot: Shot) -> str:
    """The status of the answer; or what went wrong, such as that it was sent no further."""
    connection = http.client.HTTPConnection(address, timeout=100)
    try:
        headers = {"Content-Type": shot.kind} if shot.kind else {}
        connection.request(shot.method, shot.path, shot.body, headers)
        answer = connection.getresponse()
        while answer.read(1 << 20):
            pass
        return str(answer.status)
    except (OSError, http.client.HTTPException) as error:
        return type(error).__name__
    finally:
        connection.close()


def watched(address: str, somebody: Others, named: Sequence[tuple[str, Thrown]]) -> Seen:
    """Throw, and see what others wait for."""
    seen = Seen(Counter(), 0.0, [])
    for name, thrown in named:
        begun = time.monotonic()
        seen.answers += thrown()
        took = time.monotonic() - begun
        time.sleep(AFTER if took > AFTER else AFTER / 10)
        waits = somebody.waits(begun)
        longest = max((wait.seconds for wait in waits), default=0.0)
        if longest * 1000 >= seen.longest:
            seen.worst = name
        seen.each.append((name, took, longest))
        seen.slowest = max(seen.slowest, took)
        seen.waits += waits
    return seen


def shots_of(address: str, shots: Sequence[tuple[str, Shot]]) -> list[tuple[str, Thrown]]:
    def of(shot: Shot) -> Thrown:
        return lambda: Counter([throw(address, shot)])

    return [(name, of(shot)) for name, shot in shots]


def small(address: str) -> dict[str, Row]:
    """Rows of the bombs that the tests know, by kind."""
    kinds: dict[str, list[tuple[str, Shot]]] = {}
    for bomb in (*tests.texts(), *tests.documents(), *tests.evaluations()):
        kind, _, name = bomb.name.partition(": ")
        if name in ENDLESS:
            continue
        shot = Shot(bomb.method, bomb.path, bomb.kind, bomb.body.encode())
        kinds.setdefault(kind, []).append((name, shot))
    return {kind: partial(_again, address, shots) for kind, shots in kinds.items()}


def _again(address: str, shots: Sequence[tuple[str, Shot]], _: int) -> list[tuple[str, Thrown]]:
    return shots_of(address, shots)


def at_once(address: str) -> list[tuple[str, Thrown]]:
    """Eight texts that hide operators behind a less-than, by as many senders."""
    bombs = [bomb for bomb in tests.texts() if "sums after <" in bomb.name]
    shots = [Shot(b.method, b.path, b.kind, b.body.encode()) for b in (bombs * 8)[:8]]

    def thrown() -> Counter[str]:
        with ThreadPoolExecutor(len(shots)) as senders:
            return Counter(senders.map(partial(throw, address), shots))

    return [("eight texts", thrown)]


def large(address: str, client: httpx.Client) -> dict[str, Row]:
    """The rows of heavy.py."""

    def row(make: heavy.Row) -> Row:
        def made(round: int) -> list[tuple[str, Thrown]]:
            shots = make(client, round)
            return shots_of(
                address, [(f"{i + 1}. {s.method} {s.path[:40]}", s) for i, s in enumerate(shots)]
            )

        return made

    return {name: row(make) for name, make in heavy.ROWS.items()}


def window(client: httpx.Client, name: str, round: int) -> list[tuple[str, Thrown]]:
    """One of the queries of turns.py, and samples for it."""
    stream, query = f"{name.replace(' ', '_')}{round}", f"q_{name.replace(' ', '_')}{round}"
    turns.declare(client, stream)
    turns.register(client, query, stream, *turns.BOMBS[name])

    def thrown() -> Counter[str]:
        for second in range(1, 4):
            turns.publish(client, stream, turns.batch(second, turns.OBJECTS))
        client.delete(f"/queries/{query}").raise_for_status()
        return Counter({"202": 3})

    return [(name, thrown)]


def line(name: str, seen: Seen) -> str:
    waits = sorted(1000 * wait.seconds for wait in seen.waits)
    answers = " ".join(
        f"{status}×{times}" if times > 1 else status
        for status, times in sorted(seen.answers.items())
    )
    last = waits[int(0.99 * len(waits))]
    text = f"{name:35} {answers:24} {seen.slowest * 1000:8.0f}"
    return text + f" {statistics.median(waits):7.1f} {last:7.1f} {waits[-1]:7.1f}"


def rows_of(address: str, client: httpx.Client, quick: bool) -> dict[str, Row]:
    """All rows: each gives, by round, what is to be thrown."""
    rows = small(address) | large(address, client)
    if quick:
        del rows["closure"]  # which takes as long as it may
    rows["eight texts at once"] = lambda _: at_once(address)
    rows["slow bodies and heads"] = lambda _: slow_bodies(address)
    for name in turns.BOMBS:
        rows[f"windows: {name}"] = partial(window, client, name)

    def look(_: int) -> list[tuple[str, Thrown]]:
        if "m0" not in client.get("/streams").text:
            heavy.much(client, STREAMS, POLICIES)
            time.sleep(1)
        shots = heavy.looks(client, 0)
        return shots_of(address, [(f"{s.method} {s.path[:40]}", s) for s in shots])

    rows[f"looks at {STREAMS:,} streams"] = look
    return rows


def best_of(rounds: int, most: float, address: str, somebody: Others, make: Row) -> Seen:
    """What is thrown so often until nobody waits longer than ``most`` ms."""
    found: list[Seen] = []
    for round in range(rounds):
        found.append(watched(address, somebody, make(round)))
        if found[-1].longest <= most:
            break
    return min(found, key=lambda seen: seen.longest)


def main(arguments: Sequence[str]) -> int:
    """Print the table."""
    quick, each = "--quick" in arguments, "--each" in arguments
    names = [argument for argument in arguments if not argument.startswith("--")]
    begun = time.monotonic()
    missed: list[str] = []
    with (
        tempfile.TemporaryDirectory(prefix="dyknow-bombs") as folder,
        service(Path(folder)) as (address, process),
        httpx.Client(base_url=f"http://{address}", trust_env=False, timeout=100) as client,
        others(address) as somebody,
    ):
        turns.declare(client, "s5")
        while client.get("/readyz").status_code != 200:  # what is compiled beside the start
            time.sleep(0.1)
        time.sleep(1)
        print(f"{'':35} {'answers':24} {'slowest':>8} {'p50':>7} {'p99':>7} {'longest':>7} ms")
        start = time.monotonic()
        time.sleep(3 if quick else 6)
        normal = Seen(Counter(), 0.0, somebody.waits(start))
        print(line("nothing else", normal), flush=True)
        most = normal.longest + AIM
        for name, make in rows_of(address, client, quick).items():
            if names and not any(each in name for each in names):
                continue
            try:
                best = best_of(1 if quick else TRIES, most, address, somebody, make)
            except (OSError, EOFError, httpx.HTTPError) as error:
                print(f"{name:35} {error!r}; the service has ended with {process.poll()}")
                return 1
            text = line(name, best)
            if best.longest > most:
                text += f"  aim missed: {best.worst}"
            if wrong := [answer for answer in best.answers if answer not in RIGHT]:
                text += f"  wrong: {' '.join(wrong)}"
            if wrong or best.longest > most:
                missed.append(name)
            print(text, flush=True)
            for bomb, took, longest in best.each if each else ():
                print(f"    {bomb:50} {took * 1000:8.0f} {longest * 1000:8.1f}")
        if process.poll() is not None:
            print(f"the service has ended with {process.returncode}")
            return 1
        print(f"{time.monotonic() - begun:.0f} s; {AIM:.0f} ms beyond nothing else: ", end="")
        print(f"missed by {', '.join(missed)}" if missed else "met by all")
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
