"""Connections to the service: they run the flows of verbs, and follow event streams."""

from __future__ import annotations

import asyncio
import os
import ssl
import time
from collections.abc import AsyncGenerator, AsyncIterator, Awaitable, Callable, Generator, Iterator
from contextlib import contextmanager
from types import TracebackType
from typing import Any, Self

import httpx
import httpx_sse

from ..config.defaults import ADDRESS, TOKEN, URL
from .errors import ServiceError
from .event_streams import AsyncEvents, Event, Events, EventSource, Following
from .flows import Flow, Request, T

__all__ = ["AsyncConnection", "Connection", "Event", "ServiceError"]


class Connection:
    """One HTTP connection pool to a service. Not thread-safe.

    ``url`` is its address: by default the environment variable ``DYKNOW_URL``, else
    http://127.0.0.1:8000. ``token`` authenticates the caller; its default is the environment
    variable ``DYKNOW_TOKEN``. ``transport`` and ``sleep`` are for tests. Every method
    raises `ServiceError` for an error response and ``httpx.TransportError`` if no service responds
    at ``url``.
    """

    def __init__(
        self,
        url: str | None = None,
        *,
        token: str | None = None,
        timeout: float = 30.0,
        transport: httpx.BaseTransport | None = None,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self.url = _address(url)
        self._sleep = sleep
        self._timeout = timeout
        self._http = httpx.Client(**_options(self.url, token, timeout), transport=transport)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the connections."""
        self._http.close()

    def _run(self, flow: Flow[T]) -> T:
        """Send the requests of a flow, and return its result."""
        try:
            request = next(flow)
            while True:
                try:
                    response = self._perform(request)
                except httpx.TransportError as error:
                    request = flow.throw(error)
                else:
                    request = flow.send(response)
        except StopIteration as end:
            result: T = end.value
            return result

    def _follow_source(self, source: EventSource) -> Events:
        """Return the events of a source, which begins with the first one asked for."""
        return Events(source, self._follow(Following(source, self._timeout)))

    def _perform(self, request: Request) -> httpx.Response:
        if request.after:
            self._sleep(request.after)
        with _named(self.url):
            return self._http.request(request.method, request.path, **request.arguments)

    def _follow(self, following: Following) -> Generator[Event]:
        while True:
            try:
                with _named(self.url), self._http.stream(**following.request()) as response:
                    if not response.is_success:
                        response.read()
                    following.begin(response)
                    for message in httpx_sse.EventSource(response).iter_sse():
                        event = following.take(message)
                        if event is not None:
                            yield event
                            if following.is_over:
                                return
                if not following.resumes:
                    return
            except httpx.TransportError:
                if not following.survives:
                    raise
            self._sleep(following.next_wait())


class AsyncConnection:
    """The same for ``asyncio``: one connection pool for one event loop."""

    def __init__(
        self,
        url: str | None = None,
        *,
        token: str | None = None,
        timeout: float = 30.0,
        transport: httpx.AsyncBaseTransport | None = None,
        sleep: Callable[[float], Awaitable[None]] = asyncio.sleep,
    ) -> None:
        self.url = _address(url)
        self._sleep = sleep
        self._timeout = timeout
        self._http = httpx.AsyncClient(**_options(self.url, token, timeout), transport=transport)

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        await self.close()

    async def close(self) -> None:
        """Close the connections."""
        await self._http.aclose()

    async def _run(self, flow: Flow[T]) -> T:
        """Send the requests of a flow, and return its result."""
        try:
            request = next(flow)
            while True:
                try:
                    response = await self._perform(request)
                except httpx.TransportError as error:
                    request = flow.throw(error)
                else:
                    request = flow.send(response)
        except StopIteration as end:
            result: T = end.value
            return result

    def _follow_source(self, source: EventSource) -> AsyncEvents:
        """Return the events of a source, which begins with the first one asked for."""
        return AsyncEvents(source, self._follow(Following(source, self._timeout)))

    async def _perform(self, request: Request) -> httpx.Response:
        if request.after:
            await self._sleep(request.after)
        arguments = request.arguments
        if isinstance(content := arguments.get("content"), Iterator):
            # A generator of bodies: httpx reads an asynchronous one only.
            arguments = {**arguments, "content": _asynchronous(content)}
        with _named(self.url):
            return await self._http.request(request.method, request.path, **arguments)

    async def _follow(self, following: Following) -> AsyncGenerator[Event]:
        while True:
            try:
                with _named(self.url):
                    async with self._http.stream(**following.request()) as response:
                        if not response.is_success:
                            await response.aread()
                        following.begin(response)
                        async for message in httpx_sse.EventSource(response).aiter_sse():
                            event = following.take(message)
                            if event is not None:
                                yield event
                                if following.is_over:
                                    return
                if not following.resumes:
                    return
            except httpx.TransportError:
                if not following.survives:
                    raise
            await self._sleep(following.next_wait())


def _address(url: str | None) -> str:
    return (os.environ.get(ADDRESS, URL) if url is None else url).rstrip("/")


@contextmanager
def _named(url: str) -> Iterator[None]:
    """Let the error for a refused connection name the address, and say what to do."""
    try:
        yield
    except httpx.ConnectError as error:
        raise httpx.ConnectError(
            f"no service answers at {url} ({error}): start one with `dyknow serve`, or name "
            f"another address",
            request=error.request,
        ) from None


def _options(url: str, token: str | None, timeout: float) -> dict[str, Any]:
    """Return the arguments that both kinds of pools have."""
    token = os.environ.get(TOKEN, "") if token is None else token
    options = {
        "base_url": url,
        "headers": {"Authorization": f"Bearer {token.strip()}"} if token else {},
        "timeout": timeout,
        # A proxy from the environment cannot reach an address on this machine.
        "trust_env": False,
    }
    if url.startswith("http:"):
        # No certificates: to read those of the authorities takes longer than most requests.
        options["verify"] = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    return options


async def _asynchronous(bodies: Iterator[bytes]) -> AsyncIterator[bytes]:
    for body in bodies:
        yield body
