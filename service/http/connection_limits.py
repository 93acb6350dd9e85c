"""What connections may take of the service: how many of them there are, of one address and
together, how long the head of a request may take, and how long an answer may wait to be taken.

uvicorn bounds none of these: a connection that sends nothing, or its head byte by byte, stays for
good, as does one whose body still comes after the answer, and one on which nobody reads. So its
protocols are made with bounds (service/http/uvicorn_protocols), and connections are looked at twice
a second (`Bounds.review`).
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

from ..config.file_limits import places
from ..config.logs import log
from ..config.settings import Settings
from .problems import Problem

EVENTS: Final = "dyknow.events"
"""In the ``state`` of a request's scope: the answer is an event stream, whose client `EventClients`
lets go."""
_FORGET = struct.pack("ii", 1, 0)
"""To linger for no time: what was not taken is forgotten when the connection closes."""

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
        self._head_timeout = settings.head_timeout
        self._answer_timeout = settings.answer_timeout
        self._answer_rate = settings.answer_rate
        self._of: Counter[str] = Counter()
        self._idle: dict[Any, _Idle] = {}
        self._life = secrets.token_hex(4)
        self._numbers = count(1)

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

    def answer(self, problem: Problem) -> bytes:
        """``problem`` as an answer on the wire to what has not become a request, counted and with
        an id of its own. The connection is closed after it."""
        id = f"{self._life}-{next(self._numbers)}"
        self.refused(problem.title)
        log().debug("refused", status=problem.status_code, title=problem.title, request=id)
        return encoded(problem, id)

    def review(self, connections: Iterable[Any], now: float) -> None:
        """Close connections on which nothing has come of anything for too long: no request, or only
        a part of its head; a body that is not wanted any more; an answer that nobody takes.

        ``connections`` are uvicorn's protocols, ``now`` is in seconds. Cost: O(connections).
        """
        before, self._idle = self._idle, {}
        for connection in connections:
            cycle, transport = connection.cycle, connection.transport
            is_answered = cycle is None or cycle.response_complete
            # An answer under way waits for its client while the server takes no more of it: until
            # then what is left can only become less. Event streams have a patience of their own.
            if not is_answered and (
                not connection.flow.write_paused or cycle.scope["state"].get(EVENTS)
            ):
                continue
            left = transport.get_write_buffer_size()
            phase = (cycle, is_answered, connection.resumed)
            idle = before.get(connection)
            if idle is None or idle.phase != phase:
                idle = _Idle(phase, left, now, left, now)
            elif left < idle.left:
                idle = replace(idle, left=left, since=now)
            elif left == 0 and now - idle.since > self._head_timeout:
                self.refused("silent connection")
                if transport.is_closing():
                    transport.abort()
                else:
                    transport.close()
            if left and self._is_slow(idle, now):
                self.refused("slow reader")
                if transport.is_closing():
                    transport.abort()
                else:
                    drop(transport)
            self._idle[connection] = idle

    def _is_slow(self, idle: _Idle, now: float) -> bool:
        """Whether the client of an answer takes nothing of it, or too little."""
        allowed = self._answer_timeout
        if now - idle.since > allowed:
            return True
        if not self._answer_rate:
            return False
        return now - idle.begun > allowed + (idle.first - idle.left) / self._answer_rate


@dataclass(frozen=True, slots=True)
class _Idle:
    """A connection that waits for its client: in which phase of its life, what was not sent yet
    when it began to, and when; what is not sent yet, and since when."""

    phase: tuple[Any, bool, int]
    first: int
    begun: float
    left: int
    since: float


def encoded(problem: Problem, id: str) -> bytes:
    """A problem as an answer on the wire to the request ``id``, after which the connection is
    closed."""
    response = problem.response(id)
    status = HTTPStatus(problem.status_code)
    head = [b"HTTP/1.1 %d %s" % (status, status.phrase.encode()), b"connection: close"]
    head += [name + b": " + value for name, value in response.raw_headers]
    head.append(b"x-request-id: " + id.encode())
    return b"\r\n".join([*head, b"", bytes(response.body)])


def drop(transport: asyncio.Transport) -> None:
    """Close a connection whose client does not take what it was sent, and forget that. Closed in
    the usual way it would stay for as long as the client likes."""
    if not transport.is_closing():
        peer: socket.socket | None = transport.get_extra_info("socket")
        if peer is not None:
            peer.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _FORGET)
        transport.abort()
