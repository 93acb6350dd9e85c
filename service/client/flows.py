"""What a route does, without a connection: each verb is written once, for both clients.

A *flow* is a generator that yields requests and is sent their responses, as httpx writes its
authentication. `connection.Connection` runs it with blocking calls, `AsyncConnection` with awaited
ones. So a verb has one text, one docstring and one type for its arguments.
"""

from __future__ import annotations

from collections.abc import Callable, Coroutine, Generator
from dataclasses import dataclass, field
from functools import wraps
from typing import Any, Concatenate, Generic, ParamSpec, Protocol, TypeVar, overload

import httpx

from ..config.media_types import JSON
from .errors import ServiceError, check
from .event_streams import AsyncEvents, Events, EventSource

P = ParamSpec("P")
T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Request:
    """A request to send ``after`` some seconds; ``arguments`` are those of ``httpx.request``."""

    method: str
    path: str
    arguments: dict[str, Any] = field(default_factory=dict)
    after: float = 0.0


Flow = Generator[Request, httpx.Response, T]
"""The requests of a verb; it returns the verb's result. ``httpx.TransportError`` is thrown into
it."""


class Blocking(Protocol):
    """What runs flows with blocking calls (`Connection`)."""

    def _run(self, flow: Flow[T]) -> T: ...
    def _follow_source(self, source: EventSource) -> Events: ...


class Awaited(Protocol):
    """What runs flows with awaited calls (`AsyncConnection`)."""

    def _run(self, flow: Flow[T]) -> Coroutine[Any, Any, T]: ...
    def _follow_source(self, source: EventSource) -> AsyncEvents: ...


class verb(Generic[P, T]):  # noqa: N801  a decorator
    """Makes a method that returns a flow the verb of both clients: it returns the flow's result in
    `Client`, and a coroutine of it in `AsyncClient`."""

    def __init__(self, flow: Callable[Concatenate[Any, P], Flow[T]]) -> None:
        self._flow = flow

    @overload
    def __get__(self, client: None, owner: type) -> Callable[Concatenate[Any, P], Flow[T]]: ...

    @overload
    def __get__(self, client: Blocking, owner: type) -> Callable[P, T]: ...

    @overload
    def __get__(self, client: Awaited, owner: type) -> Callable[P, Coroutine[Any, Any, T]]: ...

    def __get__(self, client: Any, owner: type) -> Any:
        if client is None:
            return self._flow  # for help()

        @wraps(self._flow)
        def call(*args: P.args, **kwargs: P.kwargs) -> Any:
            return client._run(self._flow(client, *args, **kwargs))

        return call


class feed(Generic[P]):  # noqa: N801  a decorator
    """Makes a method that returns an `EventSource` the verb of both clients: `Events` in `Client`,
    `AsyncEvents` in `AsyncClient`."""

    def __init__(self, source: Callable[Concatenate[Any, P], EventSource]) -> None:
        self._source = source

    @overload
    def __get__(self, client: None, owner: type) -> Callable[Concatenate[Any, P], EventSource]: ...

    @overload
    def __get__(self, client: Blocking, owner: type) -> Callable[P, Events]: ...

    @overload
    def __get__(self, client: Awaited, owner: type) -> Callable[P, AsyncEvents]: ...

    def __get__(self, client: Any, owner: type) -> Any:
        if client is None:
            return self._source

        @wraps(self._source)
        def call(*args: P.args, **kwargs: P.kwargs) -> Any:
            return client._follow_source(self._source(client, *args, **kwargs))

        return call


def send(method: str, path: str, **arguments: Any) -> Flow[httpx.Response]:
    """Send a request. Raises `ServiceError` for an error response."""
    response = yield Request(method, path, arguments)
    check(response)
    return response


def send_until_room(method: str, path: str, **arguments: Any) -> Flow[httpx.Response]:
    """Send, and repeat while the service is full (429), and once after a broken connection."""
    is_broken, after = False, 0.0
    while True:
        try:
            response = yield Request(method, path, arguments, after)
            check(response)
            return response
        except ServiceError as error:
            if error.status != 429:
                raise
            after = float(error.problem.get("retry_after", 1))
        except (httpx.ReadError, httpx.RemoteProtocolError):
            if is_broken:
                raise
            is_broken, after = True, 0.0


def read_object(method: str, path: str, **arguments: Any) -> Flow[dict[str, Any]]:
    """Send, and return the object of the response."""
    value: dict[str, Any] = (yield from send(method, path, **arguments)).json()
    return value


def read_list(method: str, path: str, **arguments: Any) -> Flow[list[dict[str, Any]]]:
    """Send, and return the list of the response."""
    headers = {"Accept": JSON, **arguments.pop("headers", {})}
    response = yield from send(method, path, headers=headers, **arguments)
    items: list[dict[str, Any]] = response.json()
    return items


def read_text(method: str, path: str, **arguments: Any) -> Flow[str]:
    """Send, and return the text of the response."""
    return (yield from send(method, path, **arguments)).text
