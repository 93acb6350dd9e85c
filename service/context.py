"""What every route works with: the engine, the clock and what the service adds to them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import anyio
from fastapi import Depends, Request

from ..engine.engine import Engine
from ..streams.time import Clock
from .event_clients import ClientKey, address_of
from .live import LiveBodies
from .metrics import Metrics
from .settings import Settings
from .sse import Feeds


@dataclass(slots=True)
class Service:
    """One running service. The engine is called from the event loop's thread only."""

    engine: Engine
    settings: Settings
    clock: Clock
    feeds: Feeds
    bodies: LiveBodies
    metrics: Metrics
    sparql_slots: anyio.CapacityLimiter
    started: int
    failure: str | None = None
    """Why the engine's last tick failed; None while all is well."""
    ticked: float | None = None
    """When the last tick ended, by the monotonic clock (s); None before the first."""
    client_key: ClientKey = address_of
    """Whose event streams are counted together (`Settings.sse_clients_each`)."""

    def leave(self) -> None:
        """The service stops: let those go whose requests have no end of their own."""
        self.feeds.close()
        self.bodies.close()

    def tick(self) -> None:
        """Tell the engine the time, and event stream clients which streams are gone."""
        self.engine.tick(self.clock())
        self.feeds.review()


async def _service(request: Request) -> Service:
    service: Service = request.app.state.service
    return service


Context = Annotated[Service, Depends(_service)]
"""The parameter of a route that gives it the service."""
