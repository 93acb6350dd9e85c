"""What connections may take of the service before a request is there: how many of them, of one
address and together, how long and how large the head of a request may be.

uvicorn bounds none of these: a connection that sends nothing, or its head byte by byte, stays for
good, as does one whose body still comes after the answer. So its protocols are made here with
bounds, and connections without a request are looked at once a second (`Bounds.review`).
"""

from __future__ import annotations

import asyncio
import ipaddress
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from http import HTTPStatus
from typing import Any

from uvicorn.protocols.http.auto import AutoHTTPProtocol
from uvicorn.protocols.http.h11_impl import H11Protocol

from .descriptors import places
from .problems import Problem
from .settings import Settings

HEAD_LIMIT = 64 * 1024
"""Bytes of a request's head, beyond what comes in one read."""
PATIENCE = 1.0
"""Seconds in which a connection that is refused may say what it wants: then it hears why."""
REFUSED = 32
"""So many that are refused are heard at once; further ones are closed unheard."""
SPARE = 128
"""So many descriptors are left beside connections: for those that are refused, and for files."""


class Bounds:
    """Counts connections, and lets those go that come to nothing.

    ``refused`` counts refusals by their title.
    """

    def __init__(self, settings: Settings, refused: Callable[[str], None]) -> None:
        self.refused = refused
        self.count = 0
        self.refusing = 0
        """Connections that are about to be told that they are too many."""
        self._most = places(settings.max_connections, SPARE)
        self._most_of_one = settings.max_connections_per_client
        self._timeout = settings.head_timeout
        self._of: Counter[str] = Counter()
        self._idle: dict[Any, _Idle] = {}

    def admit(self, address: str) -> str | None:
        """Count one more connection of ``address``; what is said of it where it is one too many."""
        if self.count >= self._most:
            return f"the service has {self._most} connections, as many as it may have"
        if self._of[address] >= self._most_of_one:
            return f"there are {self._most_of_one} connections from your address"
        self.count += 1
        self._of[address] += 1
        return None

    def leave(self, address: str) -> None:
        """A connection that was admitted is gone."""
        self.count -= 1
        self._of[address] -= 1
        if not self._of[address]:
            del self._of[address]

    def review(self, connections: Iterable[Any], now: float) -> None:
        """Close connections on which nothing has come of anything for too long: no request, or only
        a part of its head; a body that is not wanted any more; an answer that nobody takes.

        ``connections`` are uvicorn's protocols, ``now`` is in seconds. Cost: O(connections).
        """
        before, self._idle = self._idle, {}
        for connection in connections:
            cycle, transport = connection.cycle, connection.transport
            if cycle is not None and not cycle.response_complete:
                continue
            left = transport.get_write_buffer_size()
            idle = before.get(connection)
            if idle is None or idle.cycle is not cycle or left < idle.left:
                idle = _Idle(cycle, now, left)
            elif now - idle.since > self._timeout:
                self.refused("silent connection")
                if transport.is_closing() or left:
                    transport.abort()
                else:
                    transport.close()
            self._idle[connection] = idle


@dataclass(frozen=True, slots=True, eq=False)
class _Idle:
    """A connection without a request: after which one, since when, what is not sent yet."""

    cycle: Any
    since: float
    left: int


class Bounded(AutoHTTPProtocol):  # type: ignore[misc, valid-type]
    """uvicorn's protocol, admitted by ``bounds`` or refused with a 503 problem."""

    def __init__(self, bounds: Bounds, **arguments: Any) -> None:
        super().__init__(**arguments)
        self._bounds = bounds
        self._address: str | None = None
        self._head = 0
        self._in_body = False

    def connection_made(self, transport: Any) -> None:
        """Admit the connection, or say why not."""
        address = address_of(transport.get_extra_info("peername"))
        reason = self._bounds.admit(address)
        if reason is None:
            self._address = address
            super().connection_made(transport)
            return
        problem = Problem(
            503,
            "too many connections",
            reason,
            hint="close some, or try again after the seconds in Retry-After",
            headers={"Retry-After": "5"},
        )
        self._bounds.refused(problem.title)
        if self._bounds.refusing < REFUSED:
            transport.set_protocol(Refused(self._bounds, transport, problem))
        else:
            transport.abort()

    def connection_lost(self, exc: Exception | None) -> None:
        """Make room for another one."""
        if self._address is not None:
            self._bounds.leave(self._address)
            self._address = None
            super().connection_lost(exc)

    def send_400_response(self, msg: str) -> None:
        """uvicorn's answer to what is no HTTP, as a problem."""
        problem = Problem(400, "bad request", "this is no HTTP that the service understands")
        self._bounds.refused(problem.title)
        self.transport.write(encoded(problem))
        self.transport.close()


class BoundedHttptools(Bounded):
    """With a bound on the head: httptools has none, h11 has its own."""

    def on_message_begin(self) -> None:
        """A head begins."""
        self._in_body = False
        super().on_message_begin()

    def on_headers_complete(self) -> None:
        """A head is there."""
        self._head, self._in_body = 0, True
        if not self.url.startswith((b"/", b"*")):
            # `GET http://host/path`: the host of the address goes before that of the header
            # (RFC 9112, section 3.2.2), of which nothing else here would know.
            place = self.url.partition(b"://")[2].partition(b"/")[0]
            others = [header for header in self.headers if header[0] != b"host"]
            self.headers[:] = [*others, (b"host", place)]
        super().on_headers_complete()

    def on_message_complete(self) -> None:
        """A body is there."""
        self._in_body = False
        super().on_message_complete()

    def data_received(self, data: bytes) -> None:
        """Parse, unless the head has become too large."""
        was_in_body = self._in_body
        super().data_received(data)
        cycle = self.cycle
        if was_in_body or self._in_body or not (cycle is None or cycle.response_complete):
            return
        self._head += len(data)
        if self._head > HEAD_LIMIT and not self.transport.is_closing():
            problem = Problem(
                431,
                "head too large",
                f"the head of a request has at most {HEAD_LIMIT} bytes",
                hint="long queries are sent in the body of POST /sparql",
            )
            self._bounds.refused(problem.title)
            self.transport.write(encoded(problem))
            self.transport.close()


class Refused(asyncio.Protocol):
    """A connection too many: it is told so when it asks for something, and closed.

    Answered before anything of it is read, it would be reset and hear nothing.
    """

    def __init__(self, bounds: Bounds, transport: asyncio.Transport, problem: Problem) -> None:
        bounds.refusing += 1
        self._bounds = bounds
        self._transport = transport
        self._answer = encoded(problem)
        self._patience = asyncio.get_running_loop().call_later(PATIENCE, transport.close)

    def data_received(self, data: bytes) -> None:
        """It asks: say why not."""
        if not self._transport.is_closing():
            self._transport.write(self._answer)
            self._transport.close()

    def connection_lost(self, exc: Exception | None) -> None:
        """It is gone."""
        self._bounds.refusing -= 1
        self._patience.cancel()


def protocol(bounds: Bounds) -> type[Bounded]:
    """The class of a server's connections; what `uvicorn.Config` takes as ``http``."""
    made = Bounded if issubclass(AutoHTTPProtocol, H11Protocol) else BoundedHttptools

    class Admitted(made):  # type: ignore[misc, valid-type]
        def __init__(self, **arguments: Any) -> None:
            super().__init__(bounds, **arguments)

    return Admitted


def address_of(peer: Any) -> str:
    """What counts as one client: an address, of IPv6 the network of 64 bits that one is given."""
    if not isinstance(peer, tuple):
        return ""
    address = ipaddress.ip_address(str(peer[0]).partition("%")[0])
    if isinstance(address, ipaddress.IPv6Address):
        if address.ipv4_mapped is None:
            return str(ipaddress.IPv6Network((address, 64), strict=False))
        address = address.ipv4_mapped
    return str(address)


def encoded(problem: Problem) -> bytes:
    """A problem as an answer on the wire, after which the connection is closed."""
    response = problem.response()
    status = HTTPStatus(problem.status_code)
    head = [b"HTTP/1.1 %d %s" % (status, status.phrase.encode()), b"connection: close"]
    head += [name + b": " + value for name, value in response.raw_headers]
    return b"\r\n".join([*head, b"", bytes(response.body)])
