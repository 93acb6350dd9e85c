"""An application that is served, with its service to look into and a client of it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import httpx
from asking import asking

from dyknow.engine.durability.durable_engine import RecordedEngine
from dyknow.engine.engine import Engine
from dyknow.service.app import create_app
from dyknow.service.config.settings import Settings
from dyknow.service.runtime.context import Service
from dyknow.service.server import running
from dyknow.streams.time import Clock


@contextmanager
def hosting(
    engine: Engine | RecordedEngine, settings: Settings, clock: Clock
) -> Iterator[tuple[Service, httpx.Client]]:
    """The service itself, beside a client."""
    app = create_app(engine, settings, clock)
    with (
        running(app, settings) as url,
        asking(url) as http,
    ):
        yield app.state.service, http
