"""What every route works with: the engine, the clock and what the service adds to them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from fastapi import Depends, Request

from ..engine.engine import Engine
from ..streams.time import Clock
from .isolation.services import Isolation
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
    isolation: Isolation
    started: int
    failure: str | None = None
    """Why the engine's last tick failed; None while all is well."""

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
