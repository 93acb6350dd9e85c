"""Which service a client talks to, and what it says when none answers there."""

from __future__ import annotations

import asyncio
import socket

import httpx
import pytest

import dyknow


def free_address() -> str:
    """An address where nothing listens."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"http://127.0.0.1:{probe.getsockname()[1]}"


def test_the_address_may_come_from_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DYKNOW_URL", "http://127.0.0.1:8123/")
    assert dyknow.Client().url == dyknow.AsyncClient().url == "http://127.0.0.1:8123"
    assert dyknow.Client("http://127.0.0.1:9").url == "http://127.0.0.1:9"
    monkeypatch.delenv("DYKNOW_URL")
    assert dyknow.Client().url == "http://127.0.0.1:8000"


def test_the_error_names_the_address_where_no_service_answers() -> None:
    address = free_address()

    async def ask() -> None:
        async with dyknow.AsyncClient(address) as client:
            await client.streams()

    wanted = f"no service answers at {address}.*: start one with `dyknow serve`"
    with dyknow.Client(address) as client:
        with pytest.raises(httpx.ConnectError, match=wanted):
            client.streams()
        with pytest.raises(httpx.ConnectError, match=wanted):
            next(iter(client.events("s")))
    with pytest.raises(httpx.ConnectError, match=wanted):
        asyncio.run(ask())
