"""Running the application with uvicorn: in this process for `serve`, in a thread for tests."""

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
"""Seconds that open requests have to end when the service stops."""
REVIEW = 5
"""Connections are looked at once in so many of the server's ticks, which are 0.1 s apart."""
HEADERS = [
    ("X-Content-Type-Options", "nosniff"),
    ("Cross-Origin-Resource-Policy", "same-origin"),
]
"""Of every answer, also those that never come to the application: no page elsewhere may show or run
what is answered here."""
FINISH = 1.5
"""Of these seconds so many are for requests that end by themselves; then nothing more comes that
clients of event streams would have to hear of."""
ABORT = 4.5
"""After so many of them the connections are closed of those who still send or do not take."""
_LOOK = 0.02


class Server(uvicorn.Server):
    """Stops in bounded time, and without losing what it has acknowledged.

    Told to stop, the service is not ready any more, and goes on for ``drain`` seconds. Then nobody
    can connect, idle connections close, and requests under way end; senders of live samples are
    told what was taken. When all that is done, clients of event streams get what there is, and the
    end of their answers. A second signal ends all this at once.
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
        going = asyncio.create_task(self._let_go())
        try:
            await super().shutdown(sockets)
            if self.force_exit:
                # uvicorn leaves it out then, and the application would be torn off.
                await self.lifespan.shutdown()
        finally:
            going.cancel()

    def handle_exit(self, sig: int, frame: FrameType | None) -> None:
        """A signal. Not raised again at the end, as uvicorn would: who stops as told has not
        failed."""
        self.force_exit = self.should_exit
        self.should_exit = True

    async def _let_go(self) -> None:
        """While the server waits for its connections to close: see to it that they can."""
        self._service.bodies.close()
        clients = self._service.feeds.all
        await self._until(lambda: len(self.server_state.tasks) <= len(clients), FINISH)
        self._service.leave()
        await self._until(lambda: not self.server_state.connections, ABORT - FINISH)
        for connection in list(self.server_state.connections):
            if connection.transport is not None:
                connection.transport.abort()

    async def _until(self, done: Callable[[], bool], seconds: float) -> None:
        """Wait at most so long."""
        limit = time.monotonic() + seconds
        while not (done() or self.force_exit) and time.monotonic() < limit:
            await asyncio.sleep(_LOOK)


def make_server(app: FastAPI) -> Server:
    """A server for an application of `create_app`, not yet running."""
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
    """A listening socket at the settings' host and port (0: any free one).

    Raises ``OSError`` when the address is taken. Clients may connect from now on; they are
    answered once the server runs.
    """
    family = socket.AF_INET6 if ":" in settings.host else socket.AF_INET
    # The protocol is named, not 0: only then does asyncio switch Nagle's algorithm off, which
    # costs 40 ms an answer.
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
    """The address of the service behind ``listener``, for clients on this machine."""
    host, port = listener.getsockname()[:2]
    if host in ("0.0.0.0", "::"):
        host = "127.0.0.1"
    return f"http://[{host}]:{port}" if ":" in host else f"http://{host}:{port}"


def run(app: FastAPI, listener: socket.socket) -> bool:
    """Serve until a signal stops it. Whether a second one came and cut that short."""
    server = make_server(app)
    try:
        server.run(sockets=[listener])
    finally:
        listener.close()
    return server.force_exit


@contextmanager
def running(app: FastAPI, settings: Settings) -> Iterator[str]:
    """Serve in a thread; gives the URL. The engine belongs to that thread meanwhile."""
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
