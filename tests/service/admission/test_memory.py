"""The limit of memory: what would grow is refused while it is reached, everything else goes on."""

from __future__ import annotations

import itertools
import json
import os
from collections.abc import Iterator
from pathlib import Path

import httpx
import pyarrow as pa
import pytest
from asking import asking
from waiting import until

from dyknow.converters.arrow.stream import bytes_of_table
from dyknow.engine.durability.durable_engine import RecordedEngine
from dyknow.engine.engine import Engine
from dyknow.service.admission.memory_limit import (
    CAN,
    GROWS,
    Memory,
    available_memory,
    default_limit,
    resident,
)
from dyknow.service.admission.scopes import NEEDED
from dyknow.service.admission.tokens import Scope
from dyknow.service.app import create_app
from dyknow.service.client.client import Client, ServiceError
from dyknow.service.config.media_types import ARROW
from dyknow.service.config.settings import MEBIBYTE, Settings
from dyknow.service.http.problems import Problem
from dyknow.service.runtime.context import Service
from dyknow.service.server import running
from dyknow.streams.jit import compile_all
from dyknow.streams.time import Clock

GIBIBYTE = 1024 * MEBIBYTE
FIELDS = {"id": "string", "speed": "float"}
NDJSON = {"Content-Type": "application/x-ndjson"}
ARROWS = {"Content-Type": ARROW}


class Machine:
    """A process of a certain size, on a machine with a clock."""

    def __init__(self) -> None:
        self.now = 100.0
        self.size = 0
        self.looks = 0
        self.given_back = 0
        self.takes = 0.0

    def used(self) -> int:
        self.looks += 1
        return self.size

    def give_back(self) -> None:
        self.given_back += 1
        self.now += self.takes

    def memory(self, limit: int) -> Memory:
        return Memory(limit, self.used, self.give_back, lambda: self.now)


def test_what_reaches_the_limit_is_refused_and_counted() -> None:
    machine = Machine()
    memory = machine.memory(1000 * MEBIBYTE)
    machine.size = 999 * MEBIBYTE
    memory.check()
    assert memory.reasons() == []
    machine.size, machine.now = 1000 * MEBIBYTE, machine.now + 1
    with pytest.raises(Problem) as caught:
        memory.check()
    assert caught.value.status_code == 503
    assert caught.value.detail == "the service takes 1,000 MiB of memory; it may have 1,000"
    assert (caught.value.headers or {})["Retry-After"] == "5"
    assert memory.reasons() == [f"memory: {caught.value.detail}"]
    assert memory.refused == 1


def test_one_look_holds_for_a_moment() -> None:
    machine = Machine()
    memory = machine.memory(1000)
    for _ in range(1000):
        machine.now += 0.001
        memory.check()
    assert 40 <= machine.looks <= 60


def test_without_a_limit_nobody_looks() -> None:
    machine = Machine()
    machine.size = 1 << 60
    memory = machine.memory(0)
    memory.check()
    memory.check_route("POST /events")
    memory.review()
    assert (memory.used, memory.reasons(), machine.looks, machine.given_back) == (0, [], 0, 0)


def test_what_is_free_is_given_back_near_the_limit_and_seldom_where_that_takes_long() -> None:
    machine = Machine()
    memory = machine.memory(1000)
    machine.size = 899
    for _ in range(100):
        machine.now += 1
        memory.review()
    assert machine.given_back == 0
    machine.size, machine.takes = 900, 0.5
    for _ in range(1000):
        machine.now += 0.1
        memory.review()
    # Of 100 seconds at most a hundredth, after the first time.
    assert 2 <= machine.given_back <= 3


def test_after_giving_back_it_looks_anew() -> None:
    machine = Machine()
    memory = machine.memory(1000)
    machine.size = 1000
    assert memory.is_short
    machine.size = 10
    memory.review()
    assert not memory.is_short


def test_long_answers_take_no_more_than_a_part() -> None:
    machine = Machine()
    assert machine.memory(800).within(200, 8) == 100
    assert machine.memory(8000).within(200, 8) == 200
    assert machine.memory(0).within(200, 8) == 200


def test_where_nobody_tells_how_large_the_process_is_there_is_no_limit() -> None:
    """A jail without /proc."""

    def used() -> int:
        raise FileNotFoundError("/proc/self/statm")

    memory = Memory(1000, used)
    memory.check()
    memory.review()
    assert (memory.limit, memory.used, memory.reasons()) == (0, 0, [])


def test_where_nobody_tells_just_now_it_is_as_large_as_it_was() -> None:
    """All file descriptors are in use, say."""
    machine = Machine()
    told = machine.used

    def used() -> int:
        if machine.size < 0:
            raise OSError("too many open files")
        return told()

    memory = Memory(1000, used, machine.give_back, lambda: machine.now)
    machine.size = 1000
    assert memory.is_short
    machine.size, machine.now = -1, machine.now + 1
    assert memory.is_short
    machine.size, machine.now = 10, machine.now + 1
    assert not memory.is_short


@pytest.mark.parametrize(
    ("limit", "machine", "said"),
    [
        (None, 512 * MEBIBYTE, True),
        (None, 1 * GIBIBYTE, False),
        (192 * MEBIBYTE, 16 * GIBIBYTE, True),
        (0, 16 * GIBIBYTE, False),
        (512 * MEBIBYTE, 16 * GIBIBYTE, False),
    ],
)
def test_it_is_said_where_there_is_little(
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
    limit: int | None,
    machine: int,
    said: bool,
) -> None:
    monkeypatch.setattr("dyknow.service.admission.memory_limit.available_memory", lambda: machine)
    Memory.of(Settings(memory_limit=limit))
    assert ("there is little memory for a service" in caplog.text) is said


def test_each_route_that_makes_something_is_known() -> None:
    needing = {route for route, scope in NEEDED.items() if scope is Scope.ADMIN}
    # What may be long is asked when it is there; a stream may be told to keep less.
    others = {"POST /ontologies", "POST /specifications", "PUT /streams/{name}"}
    assert needing - {route for route in needing if route.startswith("DELETE ")} == GROWS | others


@pytest.mark.parametrize(
    ("machine", "limit"),
    [
        (0, 0),
        # An empty service takes no less, whatever there is.
        (256 * MEBIBYTE, 512 * MEBIBYTE),
        (1 * GIBIBYTE, 512 * MEBIBYTE),
        (16 * GIBIBYTE, 8 * GIBIBYTE),
    ],
)
def test_the_limit_by_itself(machine: int, limit: int) -> None:
    assert default_limit(machine) == limit


def _groups(folder: Path, lines: str, limits: dict[str, str]) -> tuple[Path, Path]:
    proc, groups = folder / "proc", folder / "groups"
    (proc / "self").mkdir(parents=True)
    (proc / "self" / "cgroup").write_text(lines)
    groups.mkdir()
    for path, text in limits.items():
        (groups / path).parent.mkdir(parents=True, exist_ok=True)
        (groups / path).write_text(text + "\n")
    return proc, groups


@pytest.mark.parametrize(
    ("lines", "limits", "found"),
    [
        ("0::/\n", {"memory.max": "1000"}, 1000),
        ("0::/\n", {"memory.max": "max"}, None),
        ("0::/a/b\n", {"a/memory.max": "1000", "a/b/memory.max": "max"}, 1000),
        ("0::/a/b\n", {"a/memory.max": "3000", "a/b/memory.max": "2000"}, 2000),
        # Those of the host, of which the container sees its own alone.
        ("0::/../../b\n", {"memory.max": "1000"}, 1000),
        ("1:cpu:/x\n5:memory:/a\n", {"memory/a/memory.limit_in_bytes": "1000"}, 1000),
        ("5:hugetlb,memory:/a\n", {"memory/memory.limit_in_bytes": "1000"}, 1000),
        ("5:memory:/a\n", {"memory/a/memory.limit_in_bytes": "9223372036854771712"}, None),
        ("", {}, None),
    ],
)
def test_the_limit_of_a_container(
    tmp_path: Path, lines: str, limits: dict[str, str], found: int | None
) -> None:
    machine = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    assert available_memory(*_groups(tmp_path, lines, limits)) == (
        machine if found is None else found
    )


def test_nothing_tells_of_groups(tmp_path: Path) -> None:
    assert available_memory(tmp_path, tmp_path) == os.sysconf("SC_PAGE_SIZE") * os.sysconf(
        "SC_PHYS_PAGES"
    )


@pytest.fixture
def service(
    engine: Engine, recorded: RecordedEngine | None, settings: Settings, clock: Clock
) -> Iterator[tuple[str, Service]]:
    app = create_app(recorded or engine, settings, clock)
    with running(app, settings) as url:
        yield url, app.state.service


def _shorten(service: Service) -> None:
    service.memory._used = lambda: 1000 * MEBIBYTE
    service.memory._looked = float("-inf")
    service.memory.limit = 900 * MEBIBYTE


def test_reading_and_removing_go_on(service: tuple[str, Service]) -> None:
    url, inside = service
    with (
        Client(url, timeout=120) as client,
        asking(url) as http,
    ):
        client.put_stream("s", FIELDS)
        client.publish("s", [{"valid": 1, "id": "u", "speed": 1.0}])
        _shorten(inside)
        for route in sorted(GROWS):
            method, _, path = route.partition(" ")
            answer = http.request(method, path.replace("{name}", "x").replace("{name:path}", "x"))
            assert (route, answer.status_code) == (route, 503)
            problem = answer.json()
            assert problem["title"] == "memory is short"
            assert problem["detail"] == "the service takes 1,000 MiB of memory; it may have 900"
            assert "DYKNOW_MEMORY_LIMIT" in problem["hint"]
            assert answer.headers["Retry-After"] == "5"
        body = b'{"valid": 2, "id": "u", "speed": 1.0}'
        assert http.post("/streams/s/samples", content=body, headers=NDJSON).status_code == 503
        turtle = {"Content-Type": "text/turtle"}
        text = "<urn:x> a <http://www.w3.org/2002/07/owl#Ontology> ."
        assert http.post("/ontologies", content=text, headers=turtle).status_code == 503
        assert len(client.history("s")) == 1
        ready = http.get("/readyz")
        assert ready.status_code == 503
        assert ready.json()["reasons"] == [
            "memory: the service takes 1,000 MiB of memory; it may have 900"
        ]
        metrics = http.get("/metrics").text
        assert "dyknow_memory_limit_bytes 9.437184e+08" in metrics
        assert f"dyknow_memory_refusals_total {len(GROWS) + 2:.1f}" in metrics
        assert http.post("/streams/s/end").is_success
        assert http.delete("/streams/s").status_code == 204
        inside.memory.limit = 0
        client.put_stream("s", FIELDS)
        assert http.get("/readyz").status_code == 200


def test_units_are_removed_and_not_inserted(service: tuple[str, Service]) -> None:
    url, inside = service

    def specification(insertions: str = "", removals: str = "") -> str:
        return (
            '<specification xmlns="http://www.dyknow.eu/ontology#Specification">'
            f"<insertions>{insertions}</insertions><removals>{removals}</removals></specification>"
        )

    def policy(name: str) -> str:
        return (
            f'<cu name="{name}" type="policy"><parameter name="policy" value="sample every 1s"/>'
            '<stream name="s"/></cu>'
        )

    with (
        Client(url, timeout=120) as client,
        httpx.Client(
            base_url=url, trust_env=False, headers={"Content-Type": "text/xml"}, timeout=60
        ) as http,
    ):
        client.put_stream("s", FIELDS)
        assert http.post("/specifications", content=specification(policy("slow"))).is_success
        _shorten(inside)
        answer = http.post("/specifications", content=specification(policy("other")))
        assert (answer.status_code, answer.json()["title"]) == (503, "memory is short")
        removal = specification(removals='<cu name="slow"/>')
        assert http.post("/specifications", content=removal).is_success
        assert http.delete("/streams/s").status_code == 204


def _lines(rows: list[dict[str, object]]) -> bytes:
    return "\n".join(map(json.dumps, rows)).encode()


@pytest.mark.parametrize("path", ["samples", "samples/live"])
@pytest.mark.parametrize("kind", [NDJSON, ARROWS], ids=["ndjson", "arrow"])
def test_nothing_is_left_of_what_is_refused(
    service: tuple[str, Service], path: str, kind: dict[str, str]
) -> None:
    url, inside = service
    with Client(url, timeout=120) as client:
        client.put_stream("s", FIELDS)
        client.publish("s", [{"valid": 1, "id": "u", "speed": 1.0}])
        texts = inside.engine.accepting("s").stream.pools["id"]
        _shorten(inside)
        rows: list[dict[str, object]] = [{"valid": 2, "id": "another", "speed": 1.0}]
        body = _lines(rows) if kind is NDJSON else bytes_of_table(pa.Table.from_pylist(rows))
        answer = httpx.post(f"{url}/streams/s/{path}", content=body, headers=kind, timeout=60)
        assert (answer.status_code, answer.json()["title"]) == (503, "memory is short")
        assert list(texts.strings()) == ["u"]


def test_a_live_body_ends_with_what_was_taken(service: tuple[str, Service]) -> None:
    url, inside = service
    with Client(url, timeout=120) as client:
        client.put_stream("s", FIELDS)

        def lines() -> Iterator[bytes]:
            yield b'{"valid": 1, "id": "u", "speed": 1}\n{"valid": 2, "id": "u", "speed": 1}\n'
            until(lambda: len(client.history("s")) == 2)
            _shorten(inside)
            yield b'{"valid": 3, "id": "u", "speed": 1}\n'

        answer = httpx.post(
            f"{url}/streams/s/samples/live", content=lines(), headers=NDJSON, timeout=60
        )
        problem = answer.json()
        assert (answer.status_code, problem["title"]) == (503, "memory is short")
        assert problem["accepted"] == 2
        assert len(client.history("s")) == 2


@pytest.mark.skipif(not CAN, reason="there is no limit but on Linux")
@pytest.mark.parametrize("way", ["remove", "keep less"])
def test_a_service_that_is_filled_has_a_way_back(engine: Engine, clock: Clock, way: str) -> None:
    """Nothing is made up here: the process grows, and shrinks when its stream is removed, or is to
    keep less."""
    # Loops that another test has not loaded would take some 60 MiB for good.
    compile_all()
    limit = resident() + 96 * MEBIBYTE
    settings = Settings(port=0, tick=0.02, memory_limit=limit)
    with (
        running(create_app(engine, settings, clock), settings) as url,
        asking(url) as http,
        Client(url, timeout=120) as client,
    ):
        client.put_stream("s", {"text": "string"})
        for number in itertools.count():
            # A process that has freed much in earlier tests takes more of it.
            assert number < 600, "what is sent is larger than what there is room for"
            rows = [{"valid": i, "text": os.urandom(10_000).hex()} for i in range(50)]
            body = "\n".join(map(json.dumps, rows))
            answer = http.post("/streams/s/samples", content=body, headers=NDJSON)
            if answer.status_code == 503:
                break
            assert answer.status_code == 202
        assert number > 10
        assert resident() < limit + 64 * MEBIBYTE
        client.put_stream("t", FIELDS)
        with pytest.raises(ServiceError) as caught:
            client.publish("t", [{"valid": 1, "id": "u", "speed": 1.0}])
        assert caught.value.title == "memory is short"
        if way == "remove":
            client.remove_stream("s")
        else:
            client.put_stream("s", {"text": "string"}, retention={"samples": 10})
            assert client.stream("s")["kept"] == 10
        until(lambda: http.get("/readyz").status_code == 200)
        assert client.publish("t", [{"valid": 1, "id": "u", "speed": 1.0}]) == 1
