"""Clients of event streams of a service with a data directory: they see what is kept, all of it,
and whoever comes back finds it as it was."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest
from asking import asking

from dyknow.engine.durability.durable_engine import RecordedEngine
from dyknow.journal.disk import Disk
from dyknow.journal.durability import Durability
from dyknow.service.app import create_app
from dyknow.service.config.settings import Settings
from dyknow.service.server import running

FIELDS = {"fields": {"v": "float"}}


class Slow(Disk):
    """Writes when it may."""

    def __init__(self) -> None:
        self.may = threading.Event()
        self.may.set()

    def write(self, file: int, data: bytes, start: int) -> None:
        assert self.may.wait(120)
        super().write(file, data, start)


@pytest.fixture
def disk() -> Slow:
    return Slow()


@pytest.fixture
def url(tmp_path: Path, disk: Slow, settings: Settings) -> Iterator[str]:
    recorded = RecordedEngine(tmp_path, now=0, durability=Durability.WRITE, disk=disk)
    with running(create_app(recorded, settings, lambda: 10**18), settings) as address:
        yield address
        disk.may.set()


def publish(http: httpx.Client, first: int, last: int) -> httpx.Response:
    rows = [json.dumps({"valid": k, "available": k, "v": k}) for k in range(first, last)]
    return http.post(
        "/streams/s/samples",
        content="\n".join(rows),
        headers={"Content-Type": "application/x-ndjson"},
    )


def read(url: str, count: int, **headers: str) -> list[tuple[str, int]]:
    """Kind and number of the next messages."""
    found: list[tuple[str, int]] = []
    with httpx.stream(
        "GET",
        f"{url}/streams/s/events",
        params={} if headers else {"since": "start"},
        headers=headers,
        timeout=120,
        trust_env=False,
    ) as answer:
        kind = ""
        for line in answer.iter_lines():
            if line.startswith("event: "):
                kind = line.removeprefix("event: ")
            if line.startswith("data: "):
                data = json.loads(line.removeprefix("data: "))
                found.append((kind, data.get("sequence", 0)))
                if len(found) == count:
                    break
    return found


def test_all_who_come_back_together_go_on_where_they_were(url: str, http: httpx.Client) -> None:
    http.put("/streams/s", json=FIELDS)
    publish(http, 1, 21)
    epoch = http.get("/status").json()["epoch"]
    had = (5, 12, 18, 19, 7, 15)
    told: dict[int, list[tuple[str, int]]] = {}
    go = threading.Barrier(len(had))

    def follow(last: int) -> None:
        go.wait()
        told[last] = read(url, 20 - last, **{"Last-Event-ID": f"{epoch}-{last}"})

    threads = [threading.Thread(target=follow, args=(last,)) for last in had]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(120)
    assert told == {last: [("sample", k) for k in range(last + 1, 21)] for last in had}


def test_what_is_not_kept_yet_is_shown_to_nobody(url: str, http: httpx.Client, disk: Slow) -> None:
    http.put("/streams/s", json=FIELDS)
    publish(http, 1, 4)
    disk.may.clear()
    publisher = threading.Thread(target=publish, args=(http, 4, 6))
    publisher.start()
    with asking(url) as other:
        while other.get("/streams/s").json()["last"] < 5:
            assert publisher.is_alive()
    told: list[list[tuple[str, int]]] = []
    follower = threading.Thread(target=lambda: told.append(read(url, 5)))
    follower.start()
    follower.join(0.5)
    assert told == []
    disk.may.set()
    publisher.join(120)
    follower.join(120)
    assert told == [[("sample", k) for k in range(1, 6)]]
