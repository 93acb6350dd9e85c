"""The Python clients, with a method for each HTTP route (docs/reference/http.md).

    client = dyknow.Client("http://127.0.0.1:8000")
    request = client.request_event("dyknow:HighSpeedEvent(?o, dyknow:UAV, 100)")
    for event in client.events(request["stream"], since=request["position"]):
        print(event.values, event.rdf)

Methods return the JSON of the routes as dicts. A refusal raises `ServiceError`. The command line
uses `Client`; `AsyncClient` has the same methods as coroutines. `routes` has them all.
"""

from __future__ import annotations

from ..config.defaults import URL
from .connection import AsyncConnection, Connection
from .errors import ServiceError
from .event_streams import AsyncEvents, Event, Events
from .routes import RoundedNumbers, Routes
from .samples import BadTime
from .tables import History, SparqlResult

__all__ = [
    "URL",
    "AsyncClient",
    "AsyncEvents",
    "BadTime",
    "Client",
    "Event",
    "Events",
    "History",
    "RoundedNumbers",
    "ServiceError",
    "SparqlResult",
]


class Client(Routes, Connection):
    """The service's routes over one HTTP connection pool. Not thread-safe."""


class AsyncClient(Routes, AsyncConnection):
    """The same routes for ``asyncio``: await the methods, iterate events with ``async for``."""
