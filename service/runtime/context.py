"""The context of every route: the engine, the clock, and the parts of the service."""

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
from ..config.recent_log import RecentLog
from ..config.recent_requests import RecentRequests
from ..config.settings import Settings
from ..durability.command_queue import CommandQueue
from ..http.client_address import address_of
from ..sse.clients import ClientKey
from ..sse.feeds import Feeds
from ..turns.batch_decoding import BatchDecoder
from ..workers.services import Isolation
from .gc_policy import CollectionSchedule
from .live_ingest import LiveBodies
from .metrics import Metrics
from .stream_versions import StreamVersions
from .trials import Trials
from .warm_up import WarmUp

LATE = 5.0
"""Seconds without a tick after which the service is not ready: its event loop is blocked."""
NO_TICK = "starting: the engine has had no tick yet"
BEGUN = 8
"""Histories that are looked up at a time."""


@dataclass(slots=True)
class Service:
    """One running service. Only the event loop's thread calls the engine."""

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
    commands: CommandQueue
    memory: Memory
    troubles: dict[str, str]
    """The reasons why the service is not ready, by the part that adds and removes them
    (`reasons`)."""
    ticked: float | None = None
    """The end of the last tick, by the monotonic clock (s); None before the first."""
    loop_lag: float = 0.0
    """Seconds by which the event loop was late, when the tick last waited for it."""
    token_file: TokenFile | None = None
    """Reads the tokens again when they change."""
    recent_log: RecentLog = field(default_factory=RecentLog)
    """The newest lines of the log."""
    recent_requests: RecentRequests = field(default_factory=RecentRequests)
    """The newest HTTP requests."""
    warming: WarmUp | None = None
    """The warm-up after the start; the service is not ready before its end."""
    collector: CollectionSchedule | None = None
    """The schedule of the garbage collector; None: as Python does it."""
    client_key: ClientKey = address_of
    """The key under which the event streams of a client count (`Settings.sse_clients_each`)."""
    histories: asyncio.Semaphore = field(default_factory=lambda: asyncio.Semaphore(BEGUN))
    """Held while a history is looked up and its first pieces are encoded."""

    stream_versions: StreamVersions = field(init=False)
    """The versions of streams, for pages that poll."""
    trials: Trials = field(init=False)
    """The back tests."""

    def __post_init__(self) -> None:
        self.stream_versions = StreamVersions(self.engine.epoch)
        self.trials = Trials(self.settings)

    def reasons(self) -> list[str]:
        """The reasons why the service is not ready; none if it is."""
        # The start first: a task that fails is listed as failed before it leaves the start's tasks.
        return self.starting() + self.failing()

    def failing(self) -> list[str]:
        """The reasons that do not pass with the start."""
        # A copy: other threads add and remove some.
        found = [f"{who}: {what}" for who, what in tuple(self.troubles.items())]
        found += self.memory.reasons()
        found += self.isolation.reasons()
        if self.warming is not None:
            found += self.warming.failed()
        late = 0.0 if self.ticked is None else time.monotonic() - self.ticked
        if late > max(LATE, 10 * self.settings.tick):
            found.append(f"the engine's tick is late: the last one was {late:.1f} s ago")
        return found

    def starting(self) -> list[str]:
        """The reasons that the start brings, and its end takes away."""
        unfinished = [] if self.warming is None else self.warming.unfinished()
        return unfinished + ([NO_TICK] if self.ticked is None else [])

    def failed(self) -> list[str]:
        """The number of failed units, by the kind of failure. Without names, since /readyz needs no
        token."""
        found = Counter(each.failure.partition(":")[0] for each in self.engine.failed())
        return [
            f"{count} computational unit{'s have' if count > 1 else ' has'} failed: {kind}"
            for kind, count in sorted(found.items())
        ]

    def revoke(self) -> int:
        """End the event streams and live bodies of removed tokens; return their number."""
        return self.feeds.all.revoke() + self.bodies.revoke()

    def stop(self) -> None:
        """Report that the service stops, and is not ready any more."""
        self.troubles["stopping"] = "the service stops"

    def leave(self) -> None:
        """End the requests that have no end of their own: live bodies and event streams."""
        self.bodies.close()
        self.feeds.close()

    async def do(self, command: Command, known: ParsedBody | None = None) -> Any:
        """Execute ``command``, and return its result when the log has kept it. After a batch, wait
        a limited time for the units that read the stream (back-pressure)."""
        if not isinstance(command, ANYTIME):
            await self.commands.windows_closed()
        found = self.commands.do(command, known)
        await self.commands.wait_durable()
        if isinstance(command, Publish | EndStream):
            await self.commands.caught_up(command.stream)
        return found

    def tick(self) -> None:
        """Tick the engine, end event streams of removed streams, review memory and collector."""
        self.commands.do(Tick(self.clock()))
        self.feeds.review()
        self.memory.review()
        if self.collector is not None:
            self.collector.review()


async def _service(request: Request) -> Service:
    service: Service = request.app.state.service
    return service


Context = Annotated[Service, Depends(_service)]
"""The type of a route's parameter for the service."""
