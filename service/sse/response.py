"""The answer that is server-sent events: sse-starlette's, with less machinery a client.

The library's own response runs four tasks a client in a task group and a timer a send, and writes
a traceback for each client that is cut off; with thousands of clients that is most of the work
(bench/sse.py). Here one task sends, one waits for the client to leave, and all share the timer of
`EventClients`. Headers and status are the library's.
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
"""Bytes that the kernel holds of what a client does not take (it reckons with twice that)."""
OPENING = b": dyknow\n"
"""Sent at once, so that a client knows that it is connected."""
HEARTBEAT = b": ping\n"
"""A comment without an empty line: a reader that dispatches empty messages stays quiet."""
DROPPED = 1.0
"""Seconds in which a connection that was closed is known to be."""


class Messages(Protocol):
    """What a client is to get: a stream's messages, or those of several."""

    @property
    def over(self) -> str | None:
        """Why nothing comes any more; None while something may."""

    def take(self) -> bytes | None:
        """What comes next; None while there is nothing."""

    def join(self, client: EventClient) -> None:
        """``client`` is to be woken when there is something."""

    def leave(self, client: EventClient) -> None:
        """It is not there any more."""


class _Body:
    """The bytes of an answer, with heartbeats, until there are no more, or the service stops."""

    def __init__(self, clients: EventClients, client: EventClient, messages: Messages) -> None:
        self._clients = clients
        self._client = client
        self._messages = messages
        self._goes_on = False
        self._begun = False

    def __aiter__(self) -> AsyncIterator[bytes]:
        return self

    async def __anext__(self) -> bytes:
        if not self._begun:
            self._begun = self._goes_on = True
            return OPENING + (self._messages.take() or b"")
        while True:
            data = self._messages.take()
            if data is not None:
                if self._goes_on:
                    # A fast client must not keep the loop from everybody else.
                    await asyncio.sleep(0)
                self._goes_on = True
                self._clients.sent += len(data)
                return data
            # When the service stops, everybody gets what there is.
            if self._messages.over is not None or self._clients.is_closing:
                break
            self._goes_on = False
            if not await self._client.wait():
                return HEARTBEAT
        raise StopAsyncIteration


class EventStream(EventSourceResponse):
    """Sends ``messages`` to an admitted ``client`` until they are over, it leaves or is cut off.

    A client that takes nothing costs at most `SEND_BUFFER` of the kernel's memory and two pieces
    (`message_cache.PIECE_BYTES`): one that the transport has, one that waits for it.
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
        state[EVENTS] = True
        transport: asyncio.Transport | None = state.get(TRANSPORT)
        _bound(transport)
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
            reason = self._messages.over or "shutdown"
            _unbound(transport)
        except TimeoutError:
            if client.reason is None:
                raise
            reason = client.reason
            if transport is not None:
                drop(transport)
                # The server, too, is to know that nobody waits for the end of the answer.
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


def _bound(transport: asyncio.Transport | None) -> None:
    """Of what the client does not take hold little: nothing is added until all is gone."""
    if transport is not None and not transport.is_closing():
        transport.set_write_buffer_limits(high=0)
        peer: socket.socket | None = transport.get_extra_info("socket")
        if peer is not None:
            peer.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER)


def _unbound(transport: asyncio.Transport | None) -> None:
    """The connection's next answer may be of another kind."""
    if transport is not None and not transport.is_closing():
        transport.set_write_buffer_limits()
