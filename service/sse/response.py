"""The HTTP response that sends server-sent events, a lighter version of sse-starlette's.

The library's response runs a task group of four tasks for each client and a timer for each send,
and logs a traceback for each client that is cut off. With thousands of clients that is most of the
work (bench/service/sse.py). Here one task sends, one waits for a disconnect, and all clients share
the timer of `EventClients`. Headers and status are the library's.
"""

from __future__ import annotations

import asyncio
import socket
from collections.abc import AsyncIterator, Mapping
from typing import Protocol

from sse_starlette import EventSourceResponse
from starlette.types import Receive, Scope, Send

from ..http.connection_limits import EVENTS, TRANSPORT, drop
from .clients import EventClient, EventClients

SEND_BUFFER = 64 * 1024
"""Bytes of unread data that the kernel buffers for a client (Linux allocates twice that)."""
OPENING = b": dyknow\n"
"""A comment that is sent at once, so that a client knows that it is connected."""
HEARTBEAT = b": ping\n"
"""A comment without an empty line, since some readers dispatch an empty message at one."""
DROPPED = 1.0
"""Seconds within which the server notices a closed connection."""


class Messages(Protocol):
    """The messages for a client, of one stream (`Cursor`) or several (`MultiCursor`)."""

    @property
    def end_reason(self) -> str | None:
        """The reason why no messages follow; None while some may follow."""

    @property
    def delay(self) -> float | None:
        """The seconds until the next messages when `take` has returned None: the client then needs
        no wake-up for them. None: only a wake-up brings some."""

    def take(self) -> bytes | None:
        """Return the next messages; None while there are none."""

    def join(self, client: EventClient) -> None:
        """Wake ``client`` when there are new messages."""

    def leave(self, client: EventClient) -> None:
        """Wake ``client`` no more."""


class _Body:
    """The body of a response: messages and heartbeats, until the end or the service's stop."""

    def __init__(self, clients: EventClients, client: EventClient, messages: Messages) -> None:
        self._clients = clients
        self._client = client
        self._messages = messages
        self._is_sending = False
        self._has_begun = False

    def __aiter__(self) -> AsyncIterator[bytes]:
        return self

    async def __anext__(self) -> bytes:
        if not self._has_begun:
            self._has_begun = self._is_sending = True
            return OPENING + (self._messages.take() or b"")
        while True:
            data = self._messages.take()
            if data is not None:
                if self._is_sending:
                    # Yield: a fast client must not starve the other tasks of the event loop.
                    await asyncio.sleep(0)
                self._is_sending = True
                self._clients.sent += len(data)
                return data
            # A stop ends the response only here, after all pending messages.
            if self._messages.end_reason is not None or self._clients.is_closing:
                break
            self._is_sending = False
            if not await self._client.wait(self._messages.delay):
                return HEARTBEAT
        raise StopAsyncIteration


class EventStream(EventSourceResponse):
    """Sends ``messages`` to an admitted ``client`` until their end, a disconnect or a cut.

    A stalled client costs at most `SEND_BUFFER` of the kernel's memory and two pieces
    (`message_cache.PIECE_BYTES`): one in the transport, one that waits for it.
    """

    def __init__(
        self,
        clients: EventClients,
        client: EventClient,
        messages: Messages,
        headers: Mapping[str, str],
    ) -> None:
        super().__init__(_Body(clients, client, messages), headers=headers, ping=0)
        self._clients = clients
        self._client = client
        self._messages = messages

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        client, reason = self._client, "failed"
        state = scope.get("state", {})
        # `EventClients` limits how long this client may stall, so `ConnectionLimits` does not.
        state[EVENTS] = True
        transport: asyncio.Transport | None = state.get(TRANSPORT)
        _limit_buffer(transport)
        self._clients.join(client)
        leaving = asyncio.create_task(_cut_when_gone(client, receive))
        try:
            self._messages.join(client)
            async with client.begin():
                self._clients.check(client)
                start = {"status": self.status_code, "headers": self.raw_headers}
                await client.send(send, {"type": "http.response.start", **start})
                body = "http.response.body"
                async for data in self.body_iterator:
                    await client.send(send, {"type": body, "body": data, "more_body": True})
                await client.send(send, {"type": body, "body": b"", "more_body": False})
            reason = self._messages.end_reason or "shutdown"
            _restore_buffer(transport)
        except TimeoutError:
            if client.reason is None:
                raise
            reason = client.reason
            if transport is not None:
                drop(transport)
                # uvicorn must see the disconnect, or it logs a response without an end.
                await asyncio.wait([leaving], timeout=DROPPED)
        except asyncio.CancelledError:
            reason = "shutdown"
            raise
        finally:
            leaving.cancel()
            self._messages.leave(client)
            self._clients.leave(client, reason)


async def _cut_when_gone(client: EventClient, receive: Receive) -> None:
    while (await receive())["type"] != "http.disconnect":
        pass
    client.cut("left")


def _limit_buffer(transport: asyncio.Transport | None) -> None:
    """Limit the unsent bytes: accept the next piece only when the transport's buffer is empty."""
    if transport is not None and not transport.is_closing():
        transport.set_write_buffer_limits(high=0)
        peer: socket.socket | None = transport.get_extra_info("socket")
        if peer is not None:
            peer.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER)


def _restore_buffer(transport: asyncio.Transport | None) -> None:
    """Restore the default for the connection's next response."""
    if transport is not None and not transport.is_closing():
        transport.set_write_buffer_limits()
