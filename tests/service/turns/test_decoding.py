"""Threads decode large batches, while the event loop answers other requests."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Awaitable, Callable, Iterator
from itertools import pairwise
from typing import Any

import httpx
import pyarrow as pa
import pytest
from starlette.requests import Request

from dyknow.converters.errors import WireError
from dyknow.converters.wire import BatchLimits
from dyknow.engine.durability.commands import DeclareStream, Publish, RemoveStream
from dyknow.engine.durability.durable_engine import RecordedEngine
from dyknow.engine.engine import Engine
from dyknow.engine.model.errors import UnknownStream
from dyknow.engine.model.views import StreamDeclaration
from dyknow.service.app import create_app
from dyknow.service.config.media_types import NDJSON
from dyknow.service.config.settings import Settings
from dyknow.service.durability.command_queue import CommandQueue
from dyknow.service.http.body_limit import BODY, Body, BodyLimit
from dyknow.service.runtime.live_ingest import LiveBodies, LiveLines
from dyknow.service.turns.batch_decoding import AT_ONCE, THREADS, BatchDecoder
from dyknow.streams.sample import Field, FieldType, Schema
from dyknow.streams.time import SECOND

FIELDS = (Field("id", FieldType.STRING), Field("n", FieldType.INTEGER))
OTHERS = (Field("id", FieldType.STRING), Field("n", FieldType.FLOAT))
START = 1_633_633_973 * SECOND
"""The service's clock stands there."""
LIMITS = BatchLimits(1_000_000, 1 << 16, 1 << 26)


def body(size: int = 4 * AT_ONCE, first: int = 0) -> bytes:
    """Lines with escapes, which take the longest."""
    line = b'{"valid":%d,"id":"\\u0061%d","n":%d}\n'
    count = size // len(line % (10**6, 10**6, 10**6)) + 1
    return b"".join(line % (i, i, i) for i in range(first, first + count))


def declare(engine: Engine, fields: tuple[Field, ...] = FIELDS, name: str = "s") -> None:
    DeclareStream(StreamDeclaration(name, fields)).apply(engine)


@pytest.fixture
def decoder(engine: Engine) -> Iterator[BatchDecoder]:
    declare(engine)
    decoder = BatchDecoder(engine, LIMITS)
    yield decoder
    decoder.close()


class Gate:
    """Holds decoders up before they return, until it opens."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.begun: list[int] = []
        """The times of the batches whose decoding has begun, in order."""
        self.together = self.most = 0
        self.threads: set[str] = set()
        self._open = threading.Event()
        self._lock = threading.Lock()
        decode = Publish.decode_beside

        def gated(batch: Publish, *given: Any) -> Any:
            with self._lock:
                self.begun.append(batch.now)
                self.together += 1
                self.most = max(self.most, self.together)
                self.threads.add(threading.current_thread().name)
            try:
                found = decode(batch, *given)
                assert self._open.wait(60)
                return found
            finally:
                with self._lock:
                    self.together -= 1

        monkeypatch.setattr(Publish, "decode_beside", gated)

    def open(self) -> None:
        self._open.set()

    async def has_begun(self, count: int) -> None:
        """Return when so many were begun."""
        while len(self.begun) < count:
            await asyncio.sleep(0.001)


@pytest.fixture
def gate(monkeypatch: pytest.MonkeyPatch) -> Gate:
    return Gate(monkeypatch)


def batch(data: bytes, name: str = "s") -> Publish:
    return Publish(name, "ndjson", data, START)


def run(work: Callable[[], Awaitable[Any]]) -> Any:
    async def patiently() -> Any:
        async with asyncio.timeout(60):
            return await work()

    return asyncio.run(patiently())


def test_others_are_answered_meanwhile(
    engine: Engine, recorded: RecordedEngine | None, settings: Settings, clock: Any, gate: Gate
) -> None:
    declare(engine)
    declare(engine, name="other")
    app = create_app(recorded or engine, settings, clock)
    kind = {"Content-Type": NDJSON}

    async def work() -> tuple[int, int]:
        transport = httpx.ASGITransport(app)
        async with httpx.AsyncClient(transport=transport, base_url="http://127.0.0.1") as http:
            data = body()
            large = asyncio.create_task(http.post("/streams/s/samples", content=data, headers=kind))
            await gate.has_begun(1)
            for answered in range(8):
                (await http.get("/healthz")).raise_for_status()
                small = b'{"valid":1,"id":"a","n":%d}' % answered
                posted = await http.post("/streams/other/samples", content=small, headers=kind)
                assert posted.status_code == 202
            assert not large.done()
            gate.open()
            answer = await large
            assert answer.status_code == 202, answer.text
            return answer.json()["accepted"], data.count(b"\n")

    accepted, count = run(work)
    assert accepted == count
    assert engine.generator("s").counters.used == count
    assert engine.generator("other").counters.used == 8


def test_a_small_batch_takes_no_thread(engine: Engine, decoder: BatchDecoder, gate: Gate) -> None:
    small = body(AT_ONCE - 100)
    assert len(small) <= AT_ONCE
    found = run(lambda: decoder.decode(batch(small)))
    assert len(found.batch) == small.count(b"\n")
    assert not gate.begun
    # Its texts are the stream's already.
    assert found.batch.columns["id"].pool is engine.generator("s").stream.pools["id"]


def test_a_small_body_that_stands_for_a_large_batch_takes_a_thread(
    engine: Engine, decoder: BatchDecoder, gate: Gate
) -> None:
    """Some kilobytes of compressed Arrow held up all others for more than a second."""
    count = 4 * AT_ONCE
    ids = pa.DictionaryArray.from_arrays(pa.array([0] * count, pa.int8()), pa.array(["a"]))
    numbers = pa.array([0] * count, pa.int8())
    table = pa.table({"valid": pa.array([0] * count, pa.int64()), "id": ids, "n": numbers})
    sink = pa.BufferOutputStream()
    with pa.ipc.new_stream(
        sink, table.schema, options=pa.ipc.IpcWriteOptions(compression="zstd")
    ) as writer:
        writer.write_table(table)
    data = sink.getvalue().to_pybytes()
    assert len(data) < AT_ONCE / 4
    gate.open()
    found = run(lambda: decoder.decode(Publish("s", "arrow", data, START)))
    assert gate.begun == [START]
    at_once = Publish("s", "arrow", data, START).decode(engine, LIMITS)
    assert found.batch.columns["id"].tolist() == at_once.batch.columns["id"].tolist()


def test_a_small_arrow_batch_and_what_is_none_take_no_thread(
    engine: Engine, decoder: BatchDecoder, gate: Gate
) -> None:
    table = pa.table({"valid": pa.array([1, 2]), "id": ["a", "b"], "n": [1, 2]})
    sink = pa.BufferOutputStream()
    with pa.ipc.new_stream(sink, table.schema) as writer:
        writer.write_table(table)
    data = sink.getvalue().to_pybytes()
    found = run(lambda: decoder.decode(Publish("s", "arrow", data, START)))
    assert len(found.batch) == 2
    for broken in (b"ARROW1", data[:-100]):
        with pytest.raises(WireError):
            run(lambda broken=broken: decoder.decode(Publish("s", "arrow", broken, START)))
    assert not gate.begun


def test_it_is_what_is_decoded_at_once(engine: Engine, decoder: BatchDecoder) -> None:
    data = body()
    found = run(lambda: decoder.decode(batch(data)))
    at_once = batch(data).decode(engine, LIMITS)
    assert list(found.batch.rows()) == list(at_once.batch.rows())


def test_a_bad_line_is_told_and_threads_are_used_again(decoder: BatchDecoder, gate: Gate) -> None:
    data = body()
    bad = data + b'{"valid":1,"id":"a","n":true}\n'
    gate.open()
    for _ in range(3):
        with pytest.raises(WireError, match="'n' is an integer, got true") as told:
            run(lambda: decoder.decode(batch(bad)))
        assert told.value.line == data.count(b"\n") + 1
    assert len(gate.threads) <= THREADS


def test_a_stream_that_is_removed_meanwhile_takes_nothing(
    engine: Engine, decoder: BatchDecoder, gate: Gate
) -> None:
    async def work() -> None:
        large = asyncio.create_task(decoder.decode(batch(body())))
        await gate.has_begun(1)
        RemoveStream("s").apply(engine)
        gate.open()
        await large

    with pytest.raises(UnknownStream):
        run(work)


def test_a_stream_with_other_fields_decodes_it_again(
    engine: Engine, decoder: BatchDecoder, gate: Gate
) -> None:
    async def work() -> Any:
        large = asyncio.create_task(decoder.decode(batch(body())))
        await gate.has_begun(1)
        RemoveStream("s").apply(engine)
        declare(engine, OTHERS)
        gate.open()
        return await large

    found = run(work)
    assert found.batch.columns["n"].type is FieldType.FLOAT
    assert len(found.batch) == body().count(b"\n")


def test_an_open_stream_gets_its_fields_meanwhile(
    engine: Engine, decoder: BatchDecoder, gate: Gate
) -> None:
    engine.add_kpl("source pos o")

    async def work() -> Any:
        large = asyncio.create_task(decoder.decode(batch(body(), "o")))
        await gate.has_begun(1)
        batch(b'{"valid":1,"id":"a","n":0.5}', "o").apply(engine)
        gate.open()
        return await large

    found = run(work)
    # The same numbers are floats now, as they would be had they come later.
    assert engine.generator("o").schema == Schema(OTHERS)
    assert found.batch.columns["n"].type is FieldType.FLOAT


def test_who_gives_up_leaves_nothing_behind(
    engine: Engine, decoder: BatchDecoder, gate: Gate
) -> None:
    async def work() -> Any:
        large = [asyncio.create_task(decoder.decode(batch(body()))) for _ in range(2 * THREADS)]
        await gate.has_begun(THREADS)
        for each in large:
            each.cancel()
        assert all(
            isinstance(each, asyncio.CancelledError)
            for each in await asyncio.gather(*large, return_exceptions=True)
        )
        gate.open()
        return await decoder.decode(batch(body()))

    assert len(run(work).batch) == body().count(b"\n")
    # Batches that had not begun are not decoded for clients that have gone.
    assert len(gate.begun) == THREADS + 1
    assert engine.generator("s").stream.pools["id"].strings() == []


def test_some_are_decoded_at_once_and_others_after_them_in_order(
    decoder: BatchDecoder, gate: Gate
) -> None:
    async def work() -> None:
        data, numbers = body(), range(2 * THREADS)
        large = [
            asyncio.create_task(decoder.decode(Publish("s", "ndjson", data, number)))
            for number in numbers
        ]
        await gate.has_begun(THREADS)
        gate.open()
        await asyncio.gather(*large)

    run(work)
    assert sorted(gate.begun[:THREADS]) == [*range(THREADS)]
    assert sorted(gate.begun) == [*range(2 * THREADS)]
    assert gate.most == THREADS


def test_a_key_has_one_effect_however_often_it_is_under_way(
    engine: Engine, recorded: RecordedEngine | None, settings: Settings, clock: Any
) -> None:
    declare(engine)
    app = create_app(recorded or engine, settings, clock)

    async def work() -> list[httpx.Response]:
        transport = httpx.ASGITransport(app)
        async with httpx.AsyncClient(transport=transport, base_url="http://127.0.0.1") as http:
            headers = {"Content-Type": NDJSON, "Idempotency-Key": "k"}
            first, second = body(), body(first=1)
            return await asyncio.gather(
                *(
                    http.post("/streams/s/samples", content=each, headers=headers)
                    for each in (first, first, second)
                )
            )

    assert [answer.status_code for answer in run(work)] == [202, 202, 409]
    assert engine.generator("s").counters.accepted == body().count(b"\n")


def test_what_was_done_meanwhile_is_not_later_than_it(
    engine: Engine, recorded: RecordedEngine | None, settings: Settings, clock: Any, gate: Gate
) -> None:
    """Samples without available times are stamped when their batch is taken."""
    declare(engine)
    app = create_app(recorded or engine, settings, clock)

    async def work() -> None:
        transport = httpx.ASGITransport(app)
        async with httpx.AsyncClient(transport=transport, base_url="http://127.0.0.1") as http:
            kind = {"Content-Type": NDJSON}
            large = asyncio.create_task(
                http.post("/streams/s/samples", content=body(), headers=kind)
            )
            await gate.has_begun(1)
            clock.now += SECOND
            small = b'{"valid":1,"id":"a","n":1}'
            await http.post("/streams/s/samples", content=small, headers=kind)
            clock.now += SECOND
            gate.open()
            await large

    run(work)
    available = engine.generator("s").stream.availtimes()
    assert available[:2].tolist() == [START + SECOND, START + 2 * SECOND]


def test_of_a_live_body_so_much_is_worked_off_at_once(engine: Engine) -> None:
    """What has come together is not published together where it is much."""
    declare(engine)
    data = body()
    messages = [
        {"type": "http.request", "body": data, "more_body": True},
        {"type": "http.request", "body": b"", "more_body": False},
    ]

    async def receive() -> Any:
        return messages.pop(0)

    async def work() -> list[int]:
        request = Request({"type": "http"}, receive)
        request.scope[BODY] = Body(BodyLimit(receive, 1 << 30, 1 << 30), live=True)
        live = LiveLines(engine, CommandQueue(engine, None, {}), "s", lambda: START, LIMITS)
        publishing = asyncio.create_task(LiveBodies().publish(request, live, 20))
        seen = []
        while not publishing.done():
            await asyncio.sleep(0)
            seen.append(live.accepted)
        await publishing
        return sorted(set(seen))

    seen = run(work)
    assert seen[-1] == data.count(b"\n")
    assert max(after - before for before, after in pairwise(seen)) < 1 << 11
