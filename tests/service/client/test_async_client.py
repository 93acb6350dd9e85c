"""`AsyncClient` has the verbs of `Client`, and does what it does."""

from __future__ import annotations

import asyncio
import inspect
import warnings
from collections.abc import AsyncIterator, Callable, Coroutine
from contextlib import aclosing
from typing import Any

import httpx
import pytest

import dyknow
from dyknow.service.client.client import AsyncClient, Client, RoundedNumbers, ServiceError
from dyknow.service.client.routes import Routes

SECOND = 1_000_000_000


def rows(*seconds: int) -> list[dict[str, Any]]:
    times = [second * SECOND for second in seconds]
    return [{"valid": t, "available": t, "id": "u", "v": float(t // SECOND)} for t in times]


def run(url: str, work: Callable[[AsyncClient], Coroutine[Any, Any, None]]) -> None:
    async def main() -> None:
        async with AsyncClient(url, timeout=120) as client:
            await work(client)

    asyncio.run(main())


def verbs(kind: type) -> dict[str, Any]:
    return {name: getattr(kind, name) for name in dir(kind) if not name.startswith("_")}


def test_both_clients_have_the_same_verbs_and_arguments() -> None:
    assert dyknow.AsyncClient is AsyncClient
    assert verbs(Client).keys() == verbs(AsyncClient).keys()
    for name, method in verbs(Routes).items():
        assert inspect.getdoc(method), name
        with Client() as client:
            assert inspect.signature(getattr(client, name)) == inspect.signature(method), name


def test_from_a_declaration_to_events(url: str, client: Client) -> None:
    async def work(one: AsyncClient) -> None:
        await one.put_stream("s", {"id": "string", "v": "float"})
        text = "stream {} contains speed(UAV) = v for every UAV = id"
        assert len(await one.annotate(text.format("s"))) == 1
        assert await one.publish("s", rows(1, 2)) == 2
        assert (await one.stream("s"))["last"] == 2
        assert [each["name"] for each in await one.streams()][-1] == "s"
        assert len(await one.history("s", limit=1)) == 1
        assert "dyknow/speed" in await one.rdf("s")
        found = await one.sparql("ASK { dyknow:UAV a owl:Class }")
        assert isinstance(found, dict)
        assert found["boolean"] is True
        await one.end("s")
        seen = [
            (event.kind, event.data.get("sequence"))
            async for event in one.events("s", since="start")
        ]
        assert seen == [("sample", 1), ("sample", 2), ("end", 2)]
        both = [event.kind async for event in one.follow(["s"], since="start")]
        assert both == ["sample", "sample", "end"]

    run(url, work)
    assert client.stream("s")["last"] == 2


def test_a_refusal_is_the_same_error(url: str) -> None:
    async def work(one: AsyncClient) -> None:
        with pytest.raises(ServiceError) as refused:
            await one.stream("nowhere")
        assert (refused.value.status, refused.value.title) == (404, "unknown stream")
        with pytest.raises(ServiceError) as refused:
            _ = [event async for event in one.events("nowhere")]
        assert refused.value.status == 404
        lines = [f"stream s{i} contains speed(UAV) = v for every UAV = id" for i in range(200)]
        lines[180] = lines[180].replace("speed", "velocity")
        with pytest.raises(ServiceError, match="part 2 of 2, 1 before it took effect"):
            await one.annotate("\n".join(lines))

    run(url, work)


def test_batches_come_from_either_kind_of_iterator(url: str) -> None:
    async def later() -> AsyncIterator[list[dict[str, Any]]]:
        for second in (3, 4):
            await asyncio.sleep(0)
            yield rows(second)

    async def work(one: AsyncClient) -> None:
        await one.put_stream("s", {"id": "string", "v": "float"})
        assert await one.publish_live("s", (rows(second) for second in (1, 2))) == 2
        assert await one.publish_live("s", [rows(5)]) == 1
        assert await one.publish_live("s", later(), stamp=False) == 2

    run(url, work)


def test_two_verbs_run_at_once_while_events_are_followed(url: str) -> None:
    async def work(one: AsyncClient) -> None:
        await one.put_stream("s", {"id": "string", "v": "float"})
        await one.put_stream("t", {"id": "string", "v": "float"})
        async with aclosing(one.events("s", since="start")) as events:
            await asyncio.gather(one.publish("s", rows(1)), one.publish("t", rows(1)))
            assert (await anext(events)).values["v"] == 1.0
        with pytest.raises(StopAsyncIteration):
            await anext(events)

    run(url, work)


def test_events_as_a_data_frame(url: str) -> None:
    pytest.importorskip("pandas")

    async def work(one: AsyncClient) -> None:
        await one.put_stream("s", {"id": "string", "v": "float"})
        await one.publish("s", rows(1, 2, 3))
        events = one.events("s", since="start")
        assert (await events.to_pandas(limit=1))["v"].tolist() == [1.0]
        await one.end("s")
        assert (await events.to_pandas())["v"].tolist() == [2.0, 3.0]

    run(url, work)


def test_a_full_service_and_a_broken_connection_are_tried_again() -> None:
    """Under the same key, after the time that the service names; a second break is an error."""
    answers: list[Any] = [
        httpx.Response(429, json={"title": "full"}, headers={"Retry-After": "3"}),
        httpx.ReadError("it broke"),
        httpx.Response(202, json={"accepted": 1}),
        httpx.ReadError("it broke"),
        httpx.ReadError("it broke again"),
    ]
    keys, waits = [], []

    def answer(request: httpx.Request) -> httpx.Response:
        keys.append(request.headers["idempotency-key"])
        found = answers.pop(0)
        if isinstance(found, Exception):
            raise found
        assert isinstance(found, httpx.Response)
        return found

    async def sleep(seconds: float) -> None:
        waits.append(seconds)

    async def main() -> None:
        transport = httpx.MockTransport(answer)
        async with AsyncClient(transport=transport, sleep=sleep) as one:
            assert await one.publish("s", rows(1)) == 1
            with pytest.raises(httpx.ReadError, match="again"):
                await one.publish("s", rows(1))

    asyncio.run(main())
    assert waits == [3.0]
    assert len(set(keys[:3])) == 1
    assert len(set(keys)) == 2


def test_events_resume_after_a_broken_connection() -> None:
    def sample(number: int) -> bytes:
        return f'id: e1-{number}\nevent: sample\ndata: {{"stream": "s"}}\n\n'.encode()

    end = b'event: end\ndata: {"stream": "s"}\n\n'
    asked, waits = [], []

    def answer(request: httpx.Request) -> httpx.Response:
        asked.append((request.headers.get("last-event-id"), request.url.params.get("since")))
        if len(asked) == 2:
            raise httpx.ConnectError("not yet")
        if len(asked) == 3:
            return httpx.Response(503, json={"title": "not ready"})
        content = sample(1) if len(asked) == 1 else sample(2) + end
        return httpx.Response(200, content=content, headers={"content-type": "text/event-stream"})

    async def sleep(seconds: float) -> None:
        waits.append(seconds)

    async def main() -> None:
        transport = httpx.MockTransport(answer)
        async with AsyncClient(transport=transport, sleep=sleep) as one:
            found = [event.id async for event in one.events("s", since="start")]
        assert found == ["e1-1", "e1-2", "e1-2"]

    asyncio.run(main())
    assert asked == [(None, "start"), *[("e1-1", None)] * 3]
    assert waits == [0.2, 0.4, 0.8]


@pytest.mark.parametrize("kind", ["blocking", "asynchronous"])
def test_rounded_numbers_are_warned_of(kind: str) -> None:
    told = {"accepted": 1, "rounded": {"count": 1, "line": 1, "field": "v"}}
    transport = httpx.MockTransport(lambda request: httpx.Response(202, json=told))

    async def work() -> None:
        async with AsyncClient(transport=transport) as one:
            await one.publish("s", rows(1))

    with warnings.catch_warnings(record=True) as seen:
        warnings.simplefilter("always")
        if kind == "blocking":
            with Client(transport=transport) as client:
                client.publish("s", rows(1))
            # It names the line of the caller.
            assert seen[0].filename == __file__
        else:
            asyncio.run(work())
    assert [each.category for each in seen] == [RoundedNumbers]
