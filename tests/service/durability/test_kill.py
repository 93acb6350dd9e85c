"""kill -9 at any moment: nothing acknowledged is lost, nothing told twice or otherwise (P1-P3, P6).

A client publishes, asks for an event, and follows two streams, through any number of deaths of the
service. Beside it an engine that nobody kills gets the same batches: what the client was told has
to be what that one made, ids included.
"""

from __future__ import annotations

import json
import os
import random
import threading
import time
from pathlib import Path

import httpx
import pytest
from asking import asking
from commanding import FAST
from dying import OPERATIONS
from launching import Forked
from serving import launch

from dyknow.engine.durability.commands import (
    Publish,
    RegisterTemplate,
    RequestEvent,
)
from dyknow.engine.engine import Engine

DYING = "import sys; from dying import main; main(*sys.argv[1:])"
ROUNDS = int(os.environ.get("DYKNOW_KILLS", "25"))
STREAM = {
    "fields": {"id": "string", "v": "float"},
    "lateness": "1s",
    "retention": {"samples": 1_000_000},
}
ANNOTATION = "stream s contains speed(UAV) = v for every UAV = id"
EVENT = "dyknow:FastEvent(?o, dyknow:UAV, 40)"
NDJSON = {"Content-Type": "application/x-ndjson"}


class Mortal:
    """A service that is killed, or dies by itself, and starts again."""

    def __init__(self, data: Path) -> None:
        self._data = data
        self._process: Forked | None = None

    def start(self, die: tuple[str, int, float] | None) -> str:
        reading, writing = os.pipe()
        arguments = (str(self._data), json.dumps(die))
        with (self._data.parent / "stderr").open("ab") as log:
            self._process = launch(*arguments, program=DYING, stdout=writing, stderr=log.fileno())
        os.close(writing)
        with open(reading) as told:
            port = int(told.readline())
        return f"http://127.0.0.1:{port}"

    @property
    def is_alive(self) -> bool:
        return self._process is not None and self._process.poll() is None

    def kill(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.wait()


class Follower:
    """Follows one stream, and is told each sample once, in order, whatever happens."""

    def __init__(self, path: str) -> None:
        self.path = path
        self.messages: dict[str, str] = {}
        self.last = ""
        self.wrong: list[str] = []

    def follow(self, url: str) -> threading.Thread:
        thread = threading.Thread(target=self._follow, args=(url,), daemon=True)
        thread.start()
        return thread

    def _follow(self, url: str) -> None:
        headers = {"Last-Event-ID": self.last} if self.last else {}
        since = {} if self.last else {"since": "start"}
        try:
            with httpx.stream(
                "GET", url + self.path, headers=headers, params=since, timeout=120, trust_env=False
            ) as answer:
                answer.raise_for_status()
                fields: dict[str, str] = {}
                for line in answer.iter_lines():
                    if line:
                        name, _, value = line.partition(": ")
                        fields[name] = value
                    elif fields:
                        self._take(fields)
                        fields = {}
        except httpx.TransportError:
            return  # it was killed

    def _take(self, fields: dict[str, str]) -> None:
        if "event" not in fields:
            return
        if fields["event"] != "sample":
            self.wrong.append(str(fields))
            return
        number = int(fields["id"].rpartition("-")[2])
        if number != len(self.messages) + 1 or fields["id"] in self.messages:
            self.wrong.append(f"{fields['id']} after {self.last or 'nothing'}")
        self.messages[fields["id"]] = fields["data"]
        self.last = fields["id"]


class Publisher:
    """Sends batches until each is acknowledged, a killed one again under its key."""

    def __init__(self, pick: random.Random) -> None:
        self.sent: list[bytes] = []
        self.unsure: bytes | None = None
        self._pick = pick
        self._time = 0

    def publish(self, client: httpx.Client) -> None:
        body = self.unsure or self._batch()
        self.unsure = body
        key = {"Idempotency-Key": str(len(self.sent))}
        answer = client.post("/streams/s/samples", content=body, headers={**NDJSON, **key})
        assert answer.status_code == 202, answer.text
        assert answer.json() == {"accepted": body.count(b"\n") + 1}
        self.sent.append(body)
        self.unsure = None

    def _batch(self) -> bytes:
        rows = []
        for _ in range(self._pick.randrange(1, 40)):
            self._time += self._pick.choice((10**6, 10**7, 10**8))
            late = self._pick.choice((0, 0, 0, 10**8, 2 * 10**9))
            row = {"id": f"uav{self._pick.randrange(5)}", "v": self._pick.randrange(100) / 1.0}
            rows.append(json.dumps({"valid": self._time, "available": self._time - late, **row}))
        return "\n".join(rows).encode()


def wait_for(client: httpx.Client, service: Mortal) -> None:
    deadline = time.monotonic() + 120
    while True:
        try:
            if client.get("/readyz").status_code == 200:
                return
        except httpx.TransportError:
            if not service.is_alive:
                raise
        assert time.monotonic() < deadline, "the service does not come back"
        time.sleep(0.005)


def point(pick: random.Random) -> tuple[str, int, float] | None:
    """Where it dies by itself; None: it is killed at some moment."""
    if pick.random() < 0.3:
        return None
    operation = pick.choice((*OPERATIONS, "write", "write", "sync", "sync"))
    return operation, pick.randrange(1, 9), pick.choice((0, 0.3, 0.99, 1))


@pytest.mark.long
def test_kill_9_at_any_moment(tmp_path: Path) -> None:
    pick = random.Random(1)
    service = Mortal(tmp_path / "data")
    publisher, said = Publisher(pick), Follower("/streams/s/events")
    events: Follower | None = None
    epoch, id, killed, restarts = "", "", 0, []
    try:
        for round in range(ROUNDS):
            url = service.start(point(pick) if round else None)
            with asking(url) as client:
                threads = []
                try:
                    begun = time.monotonic()
                    wait_for(client, service)
                    restarts.append(time.monotonic() - begun)
                    if not round:
                        client.put("/streams/s", json=STREAM).raise_for_status()
                        client.post("/annotations", content=ANNOTATION).raise_for_status()
                        client.post("/templates", content=FAST).raise_for_status()
                        asked = client.post("/events", json={"event": EVENT} | _parts()).json()
                        id, events = asked["id"], Follower(asked["events"])
                        epoch = client.get("/status").json()["epoch"]
                    assert client.get("/status").json()["epoch"] == epoch
                    assert client.get(f"/events/{id}").status_code == 200
                    assert events is not None
                    threads = [said.follow(url), events.follow(url)]
                    for _ in range(pick.randrange(1, 10)):
                        publisher.publish(client)
                except (httpx.TransportError, AssertionError) as error:
                    # Only because it is dead.
                    if isinstance(error, AssertionError) and service.is_alive:
                        raise
                    killed += 1
                service.kill()
                for thread in threads:
                    thread.join(120)
        # Once more, to be told all there is.
        url = service.start(None)
        with asking(url) as client:
            wait_for(client, service)
            publisher.publish(client)
            threads = [said.follow(url), events.follow(url)]
            stream = client.get("/streams/s").json()
            answers = client.get(events.path.removesuffix("/events")).json()
            deadline = time.monotonic() + 120
            while len(said.messages) < stream["last"] or len(events.messages) < answers["last"]:
                assert time.monotonic() < deadline, (len(said.messages), stream["last"])
                time.sleep(0.01)
    finally:
        service.kill()
    assert said.wrong == [] == events.wrong
    whole, answer = uninterrupted(publisher.sent, epoch)
    counters = whole.stream("s").counters
    assert stream["counters"] == {name: getattr(counters, name) for name in stream["counters"]}
    assert told(said) == made(whole, "s")
    assert told(events) == made(whole, answer)
    assert len(events.messages) > 50
    assert killed > ROUNDS / 10
    usual = sorted(restarts)[len(restarts) // 2]
    print(f"{ROUNDS} rounds, {killed} died by themselves, {len(publisher.sent)} batches sent")
    print(f"back after {usual:.2f} s, {max(restarts):.2f} s at most")


def _parts() -> dict[str, object]:
    name, _, rest = EVENT.partition("(")
    return {"event": name, "arguments": rest.removesuffix(")").split(", ")}


def uninterrupted(batches: list[bytes], epoch: str) -> tuple[Engine, str]:
    """The engine that nobody killed, and the stream of its answer."""
    from dyknow.engine.model.views import StreamDeclaration
    from dyknow.streams.history import Retention
    from dyknow.streams.sample import Field, FieldType

    engine = Engine(epoch=epoch)
    fields = (Field("id", FieldType.STRING), Field("v", FieldType.FLOAT))
    engine.declare(StreamDeclaration("s", fields, 10**9, Retention(1_000_000)))
    engine.annotate(ANNOTATION)
    RegisterTemplate(FAST).apply(engine)
    view = RequestEvent(EVENT).apply(engine)
    for batch in batches:
        Publish("s", "ndjson", batch, 0).apply(engine)
    return engine, view.stream


def told(follower: Follower) -> list[tuple[str, dict[str, object]]]:
    return [(id, json.loads(data)) for id, data in follower.messages.items()]


def made(engine: Engine, name: str) -> list[tuple[str, dict[str, object]]]:
    """What `GET /streams/{name}/events` would have said of all samples."""
    from dyknow.streams.time import format_time

    batch = engine.generator(name).stream.all()
    rdf = engine.rdf_of(name, batch)
    return [
        (
            f"{engine.epoch}-{i + 1}",
            {
                "stream": name,
                "sequence": i + 1,
                "available": format_time(available),
                "valid": format_time(valid),
                "values": values,
                "rdf": rdf[i],
            },
        )
        for i, (available, valid, values) in enumerate(batch.rows())
    ]
