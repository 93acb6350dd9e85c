"""The list of streams: some members, those that have changed, and how long each is silent."""

from __future__ import annotations

import asyncio
from typing import Any

import httpx
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dyknow.engine.engine import Engine
from dyknow.engine.model.views import StreamDeclaration
from dyknow.service.client.client import Client
from dyknow.service.models import StreamModel
from dyknow.service.runtime.stream_versions import StreamVersions
from dyknow.streams.sample import Field, FieldType
from dyknow.streams.time import SECOND

FIELDS = {"id": "string", "v": "float"}
ROW = {"valid": 1, "available": 1, "id": "a", "v": 1.0}


def test_only_some_members(client: Client, http: httpx.Client) -> None:
    client.put_stream("s", FIELDS)
    listed = client.streams(fields=["name", "rate"])
    assert {"name": "s", "rate": 0.0} in listed
    assert all(stream.keys() == {"name", "rate"} for stream in listed)
    assert http.get("/streams?fields=name,rate").json() == listed
    refused = http.get("/streams?fields=lagg").json()
    assert (refused["status"], refused["title"]) == (400, "unknown field")
    assert "did you mean lag?" in refused["hint"]


def test_silence_is_by_the_clock_of_the_service(client: Client, clock: Any) -> None:
    client.put_stream("s", FIELDS)
    assert client.stream("s")["silent_for"] is None
    client.publish("s", [{**ROW, "available": clock.now}])
    clock.now += 5 * SECOND
    assert client.stream("s")["silent_for"] == "5s"
    assert {each["name"]: each["silent_for"] for each in client.streams()}["s"] == "5s"
    client.publish("s", [{**ROW, "available": clock.now + SECOND}])  # ahead of the clock
    assert client.stream("s")["silent_for"] == "0ns"


def test_a_page_that_polls_gets_what_has_changed(client: Client, clock: Any) -> None:
    client.put_stream("s", FIELDS)
    client.put_stream("t", FIELDS)
    every, position = client.changed_streams()
    assert {each["name"] for each in every} == {"s", "t", "status"}

    def changed() -> set[str]:
        nonlocal position
        found, position = client.changed_streams(position)
        return {each["name"] for each in found}

    assert changed() == set()
    client.publish("s", [ROW])
    assert changed() == {"s"}
    clock.now += 60 * SECOND
    assert changed() == set()
    client.annotate("stream t contains speed(UAV) = v for every UAV = id")
    assert changed() == {"t", "status"}
    client.end("s")
    assert "s" in changed()
    client.remove_stream("t")
    assert "t" not in changed()
    client.put_stream("t", FIELDS)
    assert "t" in changed()
    for lost in ("start", "e0-3", "e1-999", "nonsense"):
        found, _ = client.changed_streams(lost, fields=["name"])
        assert {"name": "t"} in found
        assert {"name": "s"} in found
    assert len(position) < 200


@pytest.mark.parametrize("query", ["", "?fields=name"])
def test_a_list_that_nobody_polls_has_no_position(http: httpx.Client, query: str) -> None:
    assert "dyknow-position" not in http.get(f"/streams{query}").headers


@settings(deadline=None)
@given(
    st.lists(
        st.tuples(st.just("change"), st.integers(0, 2))
        | st.tuples(st.just("poll"), st.integers(0, 1)),
        max_size=20,
    )
)
def test_each_page_gets_each_change_once(steps: list[tuple[str, int]]) -> None:
    """Law of `StreamVersions`: of pages that poll at other times, each gets exactly the streams
    that have changed since its last answer."""
    engine = Engine(epoch="e1")
    versions = StreamVersions("e1")
    names = ["a", "b", "c"]
    for name in names:
        engine.declare(StreamDeclaration(name, (Field("v", FieldType.FLOAT),)))
    positions, expected = ["start", "start"], [{*names}, {*names}]

    async def poll(page: int, now: int) -> set[str]:
        async with versions.lock:
            after = versions.after(positions[page])
            models = [StreamModel.of(engine.stream(name), now) for name in names]
            found = {model.name for model in models if versions.note(model) > after}
            positions[page] = versions.position
        return found

    for now, (kind, which) in enumerate(steps):
        if kind == "change":
            name = names[which]
            engine.declare(StreamDeclaration(name, (Field("v", FieldType.FLOAT),), now + 1))
            for each in expected:
                each.add(name)
        else:
            assert asyncio.run(poll(which, now)) == expected[which]
            expected[which] = set()
