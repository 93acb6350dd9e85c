"""Runs the application with uvicorn: in this process for `serve`, in a thread for tests."""

from __future__ import annotations

import asyncio
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from types import FrameType

import uvicorn
from fastapi import FastAPI

from .config.settings import Settings
from .http.connection_limits import ConnectionLimits, LimitedProtocol
from .runtime.context import Service

GRACE = 5
"""Seconds that open requests have to end when the service stops (uvicorn's limit)."""
REVIEW = 5
"""Ticks of the server, 0.1 s apart, between two reviews of its connections."""
HEADERS = [
    ("X-Content-Type-Options", "nosniff"),
    ("Cross-Origin-Resource-Policy", "same-origin"),
]
"""Headers of every response, also of uvicorn's own: pages of other origins must not show or run its
content."""
FINISH = 1.5
"""Seconds of `GRACE` for requests that end by themselves; event streams end only then, so that
their clients get the last samples."""
ABORT = 4.5
"""Seconds of `GRACE` after which all remaining connections are aborted."""
_POLL = 0.02


class Server(uvicorn.Server):
    """Stops in bounded time, and keeps all that it has acknowledged.

    After the first signal the service is not ready, but works for ``drain`` seconds: a load
    balancer sends new requests elsewhere. Then it accepts no connections, closes idle ones, and
    lets requests end; live bodies get the number of accepted samples. At last event streams get
    their remaining messages and end. A second signal ends all this at once.
    """

    def __init__(
        self, config: uvicorn.Config, service: Service, drain: float, limits: ConnectionLimits
    ) -> None:
        super().__init__(config)
        self._service = service
        self._drain = drain
        self._limits = limits

    async def on_tick(self, counter: int) -> bool:
        if counter % REVIEW == 0:
            self._limits.review(tuple(self.server_state.connections), time.monotonic())
        return await super().on_tick(counter)

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        self._service.stop()
        await self._until(lambda: False, self._drain)
        ending = asyncio.create_task(self._end_requests())
        try:
            await super().shutdown(sockets)
            if self.force_exit:
                # uvicorn skips the lifespan then, but it must close the data directory.
                await self.lifespan.shutdown()
        finally:
            ending.cancel()

    def handle_exit(self, sig: int, frame: FrameType | None) -> None:
        """Note a signal. Unlike uvicorn, do not raise it again at the end: an orderly stop is no
        failure."""
        self.force_exit = self.should_exit
        self.should_exit = True

    async def _end_requests(self) -> None:
        """End requests without an end of their own, while uvicorn waits for its connections."""
        self._service.bodies.close()
        clients = self._service.feeds.all
        await self._until(lambda: len(self.server_state.tasks) <= len(clients), FINISH)
        self._service.leave()
        await self._until(lambda: not self.server_state.connections, ABORT - FINISH)
        for connection in list(self.server_state.connections):
            if connection.transport is not None:
                connection.transport.abort()

    async def _until(self, done: Callable[[], bool], seconds: float) -> None:
        """Wait until ``done``, or a second signal, for at most ``seconds``."""
        limit = time.monotonic() + seconds
        while not (done() or self.force_exit) and time.monotonic() < limit:
            await asyncio.sleep(_POLL)


def make_server(app: FastAPI) -> Server:
    """Return a server for an application of `create_app`, not yet running."""
    service: Service = app.state.service
    limits = ConnectionLimits(service.settings, service.metrics.refused)
    config = uvicorn.Config(
        app,
        log_config=None,
        access_log=False,
        lifespan="on",
        timeout_graceful_shutdown=GRACE,
        server_header=False,
        http=partial(LimitedProtocol, limits),  # type: ignore[arg-type]  # called like a class
        ws="none",
        headers=HEADERS,
    )
    return Server(config, service, service.settings.drain, limits)


def bind(settings: Settings) -> socket.socket:
    """Return a listening socket at the settings' host and port (0: any free one).

    Raises ``OSError`` if the address is taken. Clients may connect at once, and get their responses
    when the server runs.
    """
    family = socket.AF_INET6 if ":" in settings.host else socket.AF_INET
    # Not protocol 0: asyncio disables Nagle's algorithm, which costs 40 ms for each response, only
    # for sockets with a named protocol.
    listener = socket.socket(family, socket.SOCK_STREAM, socket.IPPROTO_TCP)
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind((settings.host, settings.port))
        listener.listen(2048)
    except OSError:
        listener.close()
        raise
    return listener


def url_of(listener: socket.socket) -> str:
    """Return the URL of the service for clients on this machine."""
    host, port = listener.getsockname()[:2]
    if host in ("0.0.0.0", "::"):
        host = "127.0.0.1"
    return f"http://[{host}]:{port}" if ":" in host else f"http://{host}:{port}"


def run(app: FastAPI, listener: socket.socket) -> bool:
    """Serve until a signal; returns whether a second one cut the stop short."""
    server = make_server(app)
    try:
        server.run(sockets=[listener])
    finally:
        listener.close()
    return server.force_exit


@contextmanager
def running(app: FastAPI, settings: Settings) -> Iterator[str]:
    """Serve in a thread, and yield the URL. Meanwhile only that thread may use the engine."""
    listener = bind(settings)
    server = make_server(app)
    thread = threading.Thread(
        target=server.run, kwargs={"sockets": [listener]}, name="dyknow-service", daemon=True
    )
    thread.start()
    try:
        yield url_of(listener)
    finally:
        server.should_exit = True
        thread.join()
        listener.close()
