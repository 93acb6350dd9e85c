"""Live samples: published while the body of their request comes, whoever sends it and however."""

from __future__ import annotations

import http.client
import itertools
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from typing import Any
from urllib.parse import urlsplit

import httpx
import msgspec
import pyarrow as pa
import pytest
from starlette.types import Receive, Scope, Send
from waiting import until

from dyknow.converters.arrow.stream import encode_arrow
from dyknow.converters.ndjson import decode_ndjson
from dyknow.engine.engine import Engine
from dyknow.service.app import create_app
from dyknow.service.client.client import Client, RoundedNumbers, ServiceError
from dyknow.service.config.media_types import ARROW, NDJSON
from dyknow.service.config.settings import Settings
from dyknow.service.http.body_limit import Body, BodyLimit
from dyknow.service.http.problems import Problem
from dyknow.service.server import running
from dyknow.streams.sample import Field, FieldType, Schema
from dyknow.streams.time import Clock

FIELDS = {"id": "string", "speed": "float"}
SCHEMA = Schema((Field("id", FieldType.STRING), Field("speed", FieldType.FLOAT)))


def line(i: int) -> bytes:
    return b'{"valid":%d,"available":%d,"id":"uav1","speed":%d.5}\n' % (i, i, i)


class Sender:
    """A live body that is sent piece by piece."""

    def __init__(self, url: str, stream: str, kind: str = NDJSON) -> None:
        self.connection = http.client.HTTPConnection(urlsplit(url).netloc, timeout=120)
        self.connection.putrequest("POST", f"/streams/{stream}/samples/live")
        self.connection.putheader("Content-Type", kind)
        self.connection.putheader("Transfer-Encoding", "chunked")
        self.connection.endheaders()

    def send(self, data: bytes) -> None:
        self.connection.send(b"%x\r\n%s\r\n" % (len(data), data))

    def answer(self) -> tuple[int, dict[str, Any]]:
        answer = self.connection.getresponse()
        self.connected = answer.headers["connection"]
        return answer.status, msgspec.json.decode(answer.read())

    def end(self) -> tuple[int, dict[str, Any]]:
        self.connection.send(b"0\r\n\r\n")
        return self.answer()


@contextmanager
def sending(url: str, stream: str, kind: str = NDJSON) -> Iterator[Sender]:
    sender = Sender(url, stream, kind)
    try:
        yield sender
    finally:
        sender.connection.close()


def accepted(client: Client, stream: str) -> int:
    return int(client.stream(stream)["counters"]["accepted"])


@pytest.fixture
def stream(client: Client) -> str:
    client.put_stream("s5", FIELDS)
    return "s5"


def test_samples_are_there_before_the_body_ends(client: Client, url: str, stream: str) -> None:
    with sending(url, stream) as sender:
        sender.send(line(1) + line(2)[:20])
        until(lambda: accepted(client, stream) >= 1)
        sender.send(line(2)[20:] + line(3) + line(4).rstrip(b"\n"))
        until(lambda: accepted(client, stream) >= 3)
        assert [row["speed"] for row in client.history(stream)] == [1.5, 2.5, 3.5]
        assert sender.end() == (202, {"accepted": 4})
    assert accepted(client, stream) == 4


def test_events_come_while_the_body_does(client: Client, url: str, stream: str) -> None:
    with sending(url, stream) as sender:
        sender.send(line(1))
        until(lambda: accepted(client, stream) >= 1)
        events = client.events(stream, since="start")
        assert next(events).values["speed"] == 1.5
        sender.send(line(2))
        assert next(events).values["speed"] == 2.5
        events.close()  # type: ignore[attr-defined]
        assert sender.end()[0] == 202


def test_a_bad_line_ends_it_and_says_how_far_it_came(client: Client, url: str, stream: str) -> None:
    with sending(url, stream) as sender:
        sender.send(line(1) + line(2))
        until(lambda: accepted(client, stream) >= 2)
        sender.send(b"\n" + line(3) + b'{"valid": 4}\n' + line(5))
        status, problem = sender.answer()
        assert status == 400
        assert problem["title"] == "bad samples"
        assert problem["line"] == 5
        assert problem["accepted"] == 3
        assert sender.connected == "close"
    assert accepted(client, stream) == 3


def test_the_first_line_may_be_the_bad_one(client: Client, url: str, stream: str) -> None:
    with sending(url, stream) as sender:
        sender.send(b"{\n")
        assert sender.answer()[1]["accepted"] == 0


def test_an_empty_body_is_no_error(client: Client, url: str, stream: str) -> None:
    with sending(url, stream) as sender:
        sender.send(b"\n")
        assert sender.end() == (202, {"accepted": 0})


def test_a_client_that_disappears_leaves_what_was_complete(
    client: Client, url: str, stream: str
) -> None:
    with sending(url, stream) as sender:
        sender.send(line(1) + line(2) + line(3)[:-1])
        until(lambda: accepted(client, stream) >= 2)
    # The connection is gone; another body is taken, and nothing of the first one is left over.
    assert client.publish_live(stream, [line(4)]) == 1
    assert [row["speed"] for row in client.history(stream)] == [1.5, 2.5, 4.5]


def test_silence_is_ended(engine: Engine, clock: Clock) -> None:
    settings = Settings(port=0, live_timeout=0.1)
    with running(create_app(engine, settings, clock), settings) as url, Client(url) as client:
        client.put_stream("s5", FIELDS)
        with sending(url, "s5") as sender:
            sender.send(line(1) + line(2)[:9])
            status, problem = sender.answer()
        assert status == 408
        assert problem["accepted"] == 1
        assert problem["hint"]


def test_the_stop_of_the_service_is_told(engine: Engine, settings: Settings, clock: Clock) -> None:
    with ExitStack() as senders:
        with running(create_app(engine, settings, clock), settings) as url, Client(url) as client:
            client.put_stream("s5", FIELDS)
            sender = senders.enter_context(sending(url, "s5"))
            sender.send(line(1))
            until(lambda: accepted(client, "s5") >= 1)
        status, problem = sender.answer()
    assert status == 503
    assert problem["accepted"] == 1


def test_a_body_may_be_longer_than_the_limit_a_line_may_not(
    client: Client, url: str, stream: str, settings: Settings
) -> None:
    many = settings.body_limit // len(line(10_000)) + 1_000
    with sending(url, stream) as sender:
        sender.send(b"".join(line(i) for i in range(1, many)))
        assert sender.end() == (202, {"accepted": many - 1})
    with sending(url, stream) as sender:
        sender.send(line(many))
        sender.send(b" " * (settings.body_limit // 2))
        with suppress(OSError):  # it may be closed before all is sent
            sender.send(b" " * settings.body_limit)
        status, problem = sender.answer()
        assert (status, problem["accepted"]) == (413, 1)


def test_a_body_with_its_length_is_taken_too(
    client: Client, http: httpx.Client, stream: str, settings: Settings
) -> None:
    many = settings.body_limit // len(line(10_000)) + 1_000
    body = b"".join(line(i) for i in range(1, many))
    answer = http.post(f"/streams/{stream}/samples/live", content=body)
    assert (answer.status_code, answer.json()) == (202, {"accepted": many - 1})


def test_what_is_published_is_not_held(engine: Engine, clock: Clock) -> None:
    """Far more than all bodies together may hold goes through one."""
    settings = Settings(port=0, body_limit=1 << 17, bodies_limit=1 << 19)
    with running(create_app(engine, settings, clock), settings) as url, Client(url) as client:
        client.put_stream("s5", FIELDS)
        part = b"".join(line(i) for i in range(1, 1_001))
        assert client.publish_live("s5", itertools.repeat(part, 40)) == 40_000
        assert client.publish("s5", part) == 1_000


def test_only_what_waits_counts_among_all_bodies() -> None:
    async def nothing(scope: Scope, receive: Receive, send: Send) -> None:
        """Never called."""

    limit = BodyLimit(nothing, limit=100, total=150)
    Body(limit, live=False).add(100)
    body = Body(limit, live=True)
    body.add(1_000)
    body.keep(50)
    for kept, status in ((51, 429), (101, 413)):
        with pytest.raises(Problem) as caught:
            body.keep(kept)
        assert caught.value.status_code == status
    body.keep(0)
    assert limit.under_way.bytes == 100


def test_several_at_once(url: str, client: Client) -> None:
    names = [f"s{i}" for i in range(4)]
    for name in [*names, "all"]:
        client.put_stream(name, FIELDS, lateness=10_000)
    taken: dict[int, int] = {}

    def publish(number: int, name: str) -> None:
        mine = (line(i * len(names) + number + 1) for i in range(200))
        with Client(url) as own:
            taken[number] = own.publish_live(name, mine)

    for targets in (names, ["all"] * len(names)):  # each its own stream, then one together
        threads = [
            threading.Thread(target=publish, args=(number, name))
            for number, name in enumerate(targets)
        ]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert taken == dict.fromkeys(range(4), 200)
        taken.clear()
    assert [accepted(client, name) for name in names] == [200] * 4
    assert (
        len(client.history("all", limit=1_000)) + client.stream("all")["counters"]["pending"] == 800
    )


def test_arrow_comes_record_batch_by_record_batch(client: Client, url: str, stream: str) -> None:
    pools: dict[str, Any] = {}
    parts = [
        encode_arrow(decode_ndjson(line(i) + line(i + 1), SCHEMA, pools).batch) for i in (1, 3)
    ]
    with sending(url, stream, ARROW) as sender:
        sender.send(parts[0] + parts[1][:50])
        until(lambda: accepted(client, stream) >= 2)
        sender.send(parts[1][50:])
        assert sender.end() == (202, {"accepted": 4})
    with sending(url, stream, ARROW) as sender:
        sender.send(encode_arrow(decode_ndjson(line(9), SCHEMA, pools).batch))
        sender.send(b"\xff" * 4 + b"\x08\0\0\0" + b"\0" * 8)  # a message without a kind
        status, problem = sender.answer()
        assert (status, problem["accepted"]) == (400, 1)


def test_a_record_batch_is_small_enough_to_be_decoded_at_once(
    client: Client, url: str, stream: str
) -> None:
    """Some kilobytes of compressed values held up everybody for seconds."""
    rows = 40_000  # a body has at most a megabyte here
    columns = {"valid": [1] * rows, "id": ["u"] * rows, "speed": [1.0] * rows}
    table = pa.table({name: pa.array(values) for name, values in columns.items()})
    sink = pa.BufferOutputStream()
    options = pa.ipc.IpcWriteOptions(compression="zstd")
    with pa.ipc.new_stream(sink, table.schema, options=options) as writer:
        writer.write_table(table, max_chunksize=rows // 2)
        writer.write_table(table, max_chunksize=3 * rows)
    with sending(url, stream, ARROW) as sender:
        sender.send(sink.getvalue().to_pybytes())
        assert sender.end() == (202, {"accepted": 2 * rows})
    much = pa.concat_tables([table, table]).combine_chunks()
    sink = pa.BufferOutputStream()
    with pa.ipc.new_stream(sink, table.schema, options=options) as writer:
        writer.write_table(much)
    with sending(url, stream, ARROW) as sender:
        sender.send(sink.getvalue().to_pybytes())
        status, problem = sender.answer()
    assert (status, problem["accepted"]) == (400, 0)
    assert "at most 1048576 bytes once it is decompressed" in problem["detail"]


@pytest.mark.parametrize(
    ("path", "headers", "status"),
    [
        ("/streams/nowhere/samples/live", {}, 404),
        ("/streams/status/samples/live", {}, 403),
        ("/streams/s5/samples/live", {"Content-Type": "text/csv"}, 415),
        ("/streams/s5/samples/live", {"Idempotency-Key": "1"}, 400),
    ],
)
def test_refusals_before_anything_is_read(
    http: httpx.Client, stream: str, path: str, headers: dict[str, str], status: int
) -> None:
    answer = http.post(path, content=line(1), headers=headers)
    assert answer.status_code == status
    assert answer.json()["hint"]


def test_a_stream_that_is_removed_meanwhile(client: Client, url: str, stream: str) -> None:
    with sending(url, stream) as sender:
        sender.send(line(1))
        until(lambda: accepted(client, stream) >= 1)
        client.remove_stream(stream)
        sender.send(line(2))
        status, problem = sender.answer()
        assert (status, problem["accepted"]) == (404, 1)


def test_samples_without_times_where_others_brought_them(
    client: Client, url: str, stream: str
) -> None:
    client.publish(stream, line(1))
    with pytest.raises(ServiceError) as caught:
        client.publish_live(stream, [[{"valid": 2, "id": "uav1", "speed": 1.0}]])
    assert caught.value.status == 409


def test_the_client_warns_of_numbers_that_are_rounded(client: Client, stream: str) -> None:
    rows = [{"valid": n, "id": "uav1", "speed": 2**53 + n} for n in (1, 2, 3)]
    message = f"{stream}: the service rounded 2 numbers .* the first in line 1, field 'speed'"
    with pytest.warns(RoundedNumbers, match=message) as caught:
        assert client.publish(stream, rows) == 3
    assert caught[0].filename == __file__
    with pytest.warns(RoundedNumbers, match=message):
        assert client.publish_live(stream, [rows[:2], rows[2:]]) == 3


def test_the_client_takes_rows_batches_and_lines(client: Client, stream: str) -> None:
    rows = [{"valid": 1, "available": 1, "id": "uav1", "speed": 1.0}]
    batch = decode_ndjson(line(2), SCHEMA, {}).batch
    assert client.publish_live(stream, iter([rows, [], batch, line(3), b""])) == 3
    client.put_stream("stamped", FIELDS)
    assert client.publish_live("stamped", [batch, batch], stamp=True) == 2
    assert len(client.history("stamped")) == 2


def test_an_endless_iterator_learns_of_the_error(client: Client, stream: str) -> None:
    def lines() -> Iterator[bytes]:
        for i in itertools.count(1):
            yield line(i) if i != 50 else b"{}\n"

    with pytest.raises(ServiceError) as caught:
        client.publish_live(stream, lines())
    assert caught.value.status == 400
    assert caught.value.line == 50
    assert caught.value.problem["accepted"] == 49


def test_a_failure_within_is_a_failure(
    monkeypatch: pytest.MonkeyPatch, engine: Engine, client: Client, stream: str
) -> None:
    def fails(*arguments: object) -> int:
        raise RuntimeError("secret")

    monkeypatch.setattr(engine, "publish", fails)
    with pytest.raises(ServiceError) as caught:
        client.publish_live(stream, [line(1)])
    assert caught.value.status == 500
    assert "secret" not in str(caught.value)
