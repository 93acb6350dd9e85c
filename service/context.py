"""What every route works with: the engine, the clock and what the service adds to them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

import anyio
from fastapi import Depends, Request

from ..converters.wire import Incoming
from ..engine.commands import Command, Tick
from ..engine.engine import Engine
from ..journal.errors import JournalError
from ..streams.time import Clock
from .access import Gate
from .event_clients import ClientKey, address_of
from .keeper import Keeper
from .live import LiveBodies
from .logs import log
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
    gate: Gate
    keeper: Keeper
    troubles: dict[str, str]
    """Why the service is not ready, for people, by what fails; empty while all is well."""
    client_key: ClientKey = address_of
    """Whose event streams are counted together (`Settings.sse_clients_each`)."""

    def leave(self) -> None:
        """The service stops: let those go whose requests have no end of their own."""
        self.feeds.close()
        self.bodies.close()

    async def do(self, command: Command, incoming: Incoming | None = None) -> Any:
        """Do ``command`` at once; return what it gives when it is kept."""
        found = self.keeper.do(command, incoming)
        await self.keeper.kept()
        return found

    async def settled(self) -> None:
        """Return when what was done before is kept, or cannot be at present."""
        try:
            await self.keeper.kept()
        except JournalError as error:
            # In `troubles`. What there is goes on being shown: up to what was kept before.
            log().debug("not kept yet", reason=str(error))

    def tick(self) -> None:
        """Tell the engine the time, and event stream clients which streams are gone."""
        self.keeper.do(Tick(self.clock()))
        self.feeds.review()


async def _service(request: Request) -> Service:
    service: Service = request.app.state.service
    return service


Context = Annotated[Service, Depends(_service)]
"""The parameter of a route that gives it the service."""
