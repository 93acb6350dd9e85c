"""Limits of connections: how many there are, of one address and together, how long a client may
be silent or take nothing, and how many bytes may arrive that are no body.

uvicorn limits none of these. Its ``limit_concurrency`` counts idle connections like working ones
and answers in plain text; ``timeout_keep_alive`` begins after an answer. A connection that sends
nothing, or its head byte by byte, would stay for good, as would one whose body still arrives after
the answer, and one whose client does not read. httptools keeps a head of any size, and uvicorn
keeps trailers as headers. So the server makes its connections from `LimitedProtocol`, and calls
`ConnectionLimits.review` twice a second. A request costs nothing in the review.
"""

from __future__ import annotations

import asyncio
import secrets
import socket
import struct
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from http import HTTPStatus
from itertools import count
from typing import Any, Final

from starlette.responses import Response
from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol

from ..config.file_limits import places
from ..config.logs import log
from ..config.settings import Settings
from .client_address import network_of
from .problems import Problem

EVENTS: Final = "dyknow.events"
"""In the ``state`` of a request's scope: the answer is an event stream, and `EventClients` limits
how long its client may take nothing."""
TRANSPORT: Final = "dyknow.transport"
"""In the ``state`` of a request's scope: the transport of its connection."""
HEAD_LIMIT = 64 * 1024
"""Bytes of a request's head, beyond those that arrive in one read. The same limit holds for the
trailers of a body, and for the bytes between two of its chunks."""
TRAILERS = 100
"""Lines of trailers of a body. The service reads none of them."""
PATIENCE = 1.0
"""Seconds in which a connection too many may send a request, to receive the reason."""
REFUSED = 32
"""Connections too many that may do so at once; the service closes further ones immediately."""
SPARE = 128
"""File descriptors beside the connections: for refused connections, and for files."""
_FORGET = struct.pack("ii", 1, 0)
"""SO_LINGER of zero seconds: closing discards the bytes that the client has not taken."""


class ConnectionLimits:
    """Counts the connections of a server, and closes those that are silent or do not read.

    ``refused`` counts refusals by their title.
    """

    def __init__(self, settings: Settings, refused: Callable[[str], None]) -> None:
        self.refused = refused
        self.count = 0
        self.refusing = 0
        """Connections too many that wait for the reason."""
        self._most = places(settings.max_connections, SPARE)
        self._most_of_one = settings.max_connections_per_client
        self._head_timeout = settings.head_timeout
        self._answer_timeout = settings.answer_timeout
        self._answer_rate = settings.answer_rate
        self._of: Counter[str] = Counter()
        self._life = secrets.token_hex(4)
        self._numbers = count(1)

    def admit(self, address: str) -> str | None:
        """Count a connection of ``address``, or return the reason why it is one too many."""
        if self.count >= self._most:
            return f"the service has {self._most} connections, the most it accepts"
        if self._of[address] >= self._most_of_one:
            return f"there are {self._most_of_one} connections from your address"
        self.count += 1
        self._of[address] += 1
        return None

    def leave(self, address: str) -> None:
        """Forget an admitted connection that has closed."""
        self.count -= 1
        self._of[address] -= 1
        if not self._of[address]:
            del self._of[address]

    def refusal(self, problem: Problem) -> Response:
        """Count ``problem``, and make the last answer of a connection of it, with an id of its own:
        it answers no request that the application has seen."""
        id = f"{self._life}-{next(self._numbers)}"
        self.refused(problem.title)
        log().debug("refused", status=problem.status_code, title=problem.title, request=id)
        response = problem.response(id)
        response.headers.update({"connection": "close", "x-request-id": id})
        return response

    def review(self, connections: Iterable[Any], now: float) -> None:
        """Close the connections on which neither side makes progress for too long: no request, or
        only a part of its head; a body after its answer; an answer that the client does not take.
        Wake the requests that wait for their body.

        ``connections`` are `LimitedProtocol`s, ``now`` is in seconds. Cost: O(connections).
        """
        for connection in connections:
            cycle = connection.cycle
            if cycle is not None and cycle.more_body and not cycle.response_complete:
                cycle.message_event.set()  # `BodyLimit` checks the deadline of the body
            if not connection.waits_for_client:
                connection.idle = None
                continue
            transport = connection.transport
            left = transport.get_write_buffer_size()
            # A change of any of these is progress, so the wait begins anew.
            phase = (connection.cycle, connection.is_answered, connection.resumed)
            idle = connection.idle
            if idle is None or idle.phase != phase:
                idle = _Idle(phase, left, now, left, now)
            elif left < idle.left:
                idle = replace(idle, left=left, since=now)
            connection.idle = idle
            if left and self._is_slow(idle, now):
                self.refused("slow reader")
                drop(transport)
            elif not left and now - idle.since > self._head_timeout:
                self.refused("silent connection")
                if transport.is_closing():
                    transport.abort()
                else:
                    transport.close()

    def _is_slow(self, idle: _Idle, now: float) -> bool:
        """Whether the client takes nothing of its answer, or too little of it."""
        allowed = self._answer_timeout
        if now - idle.since > allowed:
            return True
        if not self._answer_rate:
            return False
        return now - idle.begun > allowed + (idle.first - idle.left) / self._answer_rate


@dataclass(frozen=True, slots=True)
class _Idle:
    """The wait of a connection for its client: in which phase; the unsent bytes and the time at its
    beginning (``first``, ``begun``) and at the last progress (``left``, ``since``)."""

    phase: tuple[Any, bool, int]
    first: int
    begun: float
    left: int
    since: float


class LimitedProtocol(HttpToolsProtocol):
    """uvicorn's protocol within ``limits``: a connection too many receives a 503 problem, one with
    too large a head, or too many bytes between and after the chunks of a body, a 431 problem."""

    def __init__(self, limits: ConnectionLimits, **arguments: Any) -> None:
        super().__init__(**arguments)
        self.idle: _Idle | None = None
        """The wait for the client, at the last review."""
        self.resumed = 0
        """How often the client has taken the bytes that waited, so that more were sent."""
        self._limits = limits
        self._address: str | None = None
        self._is_refused = False
        self._cycles: list[Any] = []
        """The requests whose answers are not complete, the first one is being answered. uvicorn
        keeps the last one."""
        self._in_body = False
        self._trailers = 0
        self._no_body = 0
        """Bytes since the last complete head or the last bytes of a body."""

    @property
    def is_answered(self) -> bool:
        """Whether no request is being answered."""
        return self.cycle is None or self.cycle.response_complete

    @property
    def waits_for_client(self) -> bool:
        """Whether the client has to act: to send a request, or to take an answer, unless that is an
        event stream. While uvicorn accepts more of an answer, the application has to act."""
        if self.is_answered:
            return True
        return self.flow.write_paused and not self.cycle.scope["state"].get(EVENTS)

    def connection_made(self, transport: Any) -> None:
        """Admit the connection, or let it send a request and answer with the reason. An answer
        before the request would be lost: the client's own bytes would reset the connection."""
        peer = transport.get_extra_info("peername")
        address = network_of(str(peer[0])) if isinstance(peer, tuple) else ""
        reason = self._limits.admit(address)
        self.app_state = {**self.app_state, TRANSPORT: transport}
        super().connection_made(transport)
        if reason is None:
            self._address = address
            return
        self.app = self._limits.refusal(
            Problem(
                503,
                "too many connections",
                reason,
                hint="close some, or try again after the seconds in Retry-After",
                headers={"Retry-After": "5"},
            )
        )
        if self._limits.refusing >= REFUSED:
            transport.abort()
            return
        self._is_refused = True
        self._limits.refusing += 1
        # uvicorn cancels it when something arrives.
        self.timeout_keep_alive_task = self.loop.call_later(
            PATIENCE, self.timeout_keep_alive_handler
        )

    def connection_lost(self, exc: Exception | None) -> None:
        """Free the connection's place, and end its requests. uvicorn ends the last one only: the
        one before it in the pipeline would write on to the closed transport."""
        if self._address is not None:
            self._limits.leave(self._address)
            self._address = None
        if self._is_refused:
            self._limits.refusing -= 1
            self._is_refused = False
        for cycle in self._cycles:
            if not cycle.response_complete:
                cycle.disconnected = True
                cycle.message_event.set()
        super().connection_lost(exc)

    def resume_writing(self) -> None:
        """Note that the client has taken what it was sent."""
        self.resumed += 1
        super().resume_writing()

    def on_header(self, name: bytes, value: bytes) -> None:
        """Take a line of the head, and drop a trailer. An error here ends the parsing."""
        if not self._in_body:
            super().on_header(name, value)
            return
        self._trailers += 1
        if self._trailers > TRAILERS:
            raise ValueError("too many trailers")

    def on_headers_complete(self) -> None:
        """Begin a request."""
        self._in_body = True
        self._trailers = self._no_body = 0
        if not self.url.startswith((b"/", b"*")):
            # `GET http://host/path`: this host precedes the one of the header (RFC 9112, section
            # 3.2.2), and the application checks the header only.
            host = self.url.partition(b"://")[2].partition(b"/")[0]
            others = [header for header in self.headers if header[0] != b"host"]
            self.headers[:] = [*others, (b"host", host)]
        super().on_headers_complete()
        # A connection may live long, so its complete requests must not pile up.
        self._cycles = [cycle for cycle in self._cycles if not cycle.response_complete]
        self._cycles.append(self.cycle)

    def on_body(self, body: bytes) -> None:
        """Take some of a body."""
        self._no_body = 0
        super().on_body(body)

    def on_message_complete(self) -> None:
        """End a body."""
        self._in_body = False
        self._no_body = 0
        super().on_message_complete()

    def data_received(self, data: bytes) -> None:
        """Parse, and refuse too many bytes that are neither a complete head nor a body."""
        # Bytes that arrive together with a head or a body are not counted.
        self._no_body += len(data)
        super().data_received(data)
        if self._no_body > HEAD_LIMIT:
            self._refuse(_framing() if self._in_body else _large_head())

    def send_400_response(self, msg: str) -> None:
        """Answer to bytes that httptools cannot parse, or will not (`on_header`)."""
        if self._trailers > TRAILERS:
            self._refuse(_framing())
            return
        self._refuse(
            Problem(
                400,
                "bad request",
                "the service cannot parse this as HTTP/1.1",
                hint="speak HTTP/1.1 without TLS, as curl does; docs/reference/limits.md has the "
                "limits",
            )
        )

    def _refuse(self, problem: Problem) -> None:
        """Close the connection, and send ``problem`` before where an answer may stand: not within
        the answer to an earlier request."""
        if self.transport.is_closing():
            return
        begun = self.cycle is not None and self.cycle.response_started
        if not self.pipeline and (not begun if self._in_body else self.is_answered):
            response = self._limits.refusal(problem)
            self.transport.write(_encoded(response, self.server_state.default_headers))
        else:
            self._limits.refused(problem.title)
        self.transport.close()


def _framing() -> Problem:
    return Problem(
        431,
        "framing too large",
        f"between two chunks of a body, and after the last one, come at most {HEAD_LIMIT} bytes "
        f"and {TRAILERS} trailers",
        hint="send neither chunk extensions nor trailers: the service reads none",
    )


def _large_head() -> Problem:
    return Problem(
        431,
        "head too large",
        f"the head of a request has at most {HEAD_LIMIT} bytes",
        hint="long queries are sent in the body of POST /sparql",
    )


def _encoded(response: Response, headers: Iterable[tuple[bytes, bytes]]) -> bytes:
    """The bytes of ``response`` with further ``headers``, as uvicorn would send them."""
    status = HTTPStatus(response.status_code)
    head = [b"HTTP/1.1 %d %s" % (status, status.phrase.encode())]
    head += [name + b": " + value for name, value in (*headers, *response.raw_headers)]
    return b"\r\n".join([*head, b"", bytes(response.body)])


def drop(transport: asyncio.Transport) -> None:
    """Close the connection of a client that does not take what it was sent, and discard that. An
    ordinary close would wait for the client without limit."""
    if not transport.is_closing():
        peer: socket.socket | None = transport.get_extra_info("socket")
        if peer is not None:
            peer.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _FORGET)
    transport.abort()
