"""What every route works with: the engine, the clock and what the service adds to them."""

from __future__ import annotations

import asyncio
import time
from collections import Counter
from dataclasses import dataclass, field
from typing import Annotated, Any

from fastapi import Depends, Request

from ...engine.durability.commands import (
    ANYTIME,
    Command,
    EndStream,
    ParsedBody,
    Publish,
    Tick,
)
from ...engine.engine import Engine
from ...streams.time import Clock
from ..admission.gate import Gate
from ..admission.memory_limit import Memory
from ..admission.token_file import TokenFile
from ..config.settings import Settings
from ..durability.command_queue import Keeper
from ..http.client_address import address_of
from ..sse.clients import ClientKey
from ..sse.feeds import Feeds
from ..turns.batch_decoding import BatchDecoder
from ..workers.services import Isolation
from .gc_policy import Garbage
from .live_ingest import LiveBodies
from .metrics import Metrics
from .warm_up import Warming

LATE = 5.0
"""Seconds without a tick after which the service is not ready: something holds its loop up."""
BEGUN = 8
"""So many histories are begun at a time."""


@dataclass(slots=True)
class Service:
    """One running service. The engine is called from the event loop's thread only."""

    engine: Engine
    settings: Settings
    clock: Clock
    feeds: Feeds
    bodies: LiveBodies
    decoder: BatchDecoder
    metrics: Metrics
    isolation: Isolation
    started: int
    gate: Gate
    keeper: Keeper
    memory: Memory
    troubles: dict[str, str]
    """What keeps the service from being ready, by whom: each puts its own here, and takes it away
    when it is over (`reasons`)."""
    ticked: float | None = None
    """When the last tick ended, by the monotonic clock (s); None before the first."""
    token_file: TokenFile | None = None
    """Reads the tokens again when they change."""
    warming: Warming | None = None
    """What goes on beside the start; the service is not ready before it is over."""
    garbage: Garbage | None = None
    """How the process looks for garbage; None: as Python does."""
    client_key: ClientKey = address_of
    """Whose event streams are counted together (`Settings.sse_clients_each`)."""
    histories: asyncio.Semaphore = field(default_factory=lambda: asyncio.Semaphore(BEGUN))
    """Had while a history is looked up and its first pieces are encoded."""

    def reasons(self) -> list[str]:
        """Why the service is not ready: nothing if it is."""
        # A copy: some are put there and taken away by other threads.
        found = [f"{who}: {what}" for who, what in tuple(self.troubles.items())]
        found += self.memory.reasons()
        found += self.isolation.reasons()
        if self.warming is not None:
            found += self.warming.reasons()
        if self.ticked is None:
            found.append("starting: the engine has not been told the time yet")
        else:
            late = time.monotonic() - self.ticked
            if late > max(LATE, 10 * self.settings.tick):
                found.append(f"the engine's tick is late: the last one was {late:.1f} s ago")
        return found

    def failed(self) -> list[str]:
        """Which kinds of failures have cut units off, and how many. It names none of them:
        /readyz needs no token."""
        found = Counter(each.failure.partition(":")[0] for each in self.engine.failed())
        return [
            f"{count} computational unit{'s have' if count > 1 else ' has'} failed: {kind}"
            for kind, count in sorted(found.items())
        ]

    def revoke(self) -> int:
        """Let those go whose tokens are not accepted any more; how many."""
        return self.feeds.all.revoke() + self.bodies.revoke()

    def stop(self) -> None:
        """The service is told to stop: it is not ready any more."""
        self.troubles["stopping"] = "the service stops"

    def leave(self) -> None:
        """Let those go whose requests have no end of their own."""
        self.bodies.close()
        self.feeds.close()

    async def do(self, command: Command, known: ParsedBody | None = None) -> Any:
        """Do ``command``; return what it gives when it is kept. Who publishes waits a moment for
        those who read the stream."""
        if not isinstance(command, ANYTIME):
            await self.keeper.windows_closed()
        found = self.keeper.do(command, known)
        await self.keeper.kept()
        if isinstance(command, Publish | EndStream):
            await self.keeper.caught_up(command.stream)
        return found

    def tick(self) -> None:
        """Tell the engine the time, and event stream clients which streams are gone."""
        self.keeper.do(Tick(self.clock()))
        self.feeds.review()
        self.memory.review()
        if self.garbage is not None:
            self.garbage.review()


async def _service(request: Request) -> Service:
    service: Service = request.app.state.service
    return service


Context = Annotated[Service, Depends(_service)]
"""The parameter of a route that gives it the service."""
