"""uvicorn's protocols with bounds: who is one too many is refused, and so are heads that are too
large, and too much of what stands between and after the chunks of a body.

uvicorn has none of these bounds, and keeps trailers as if they were headers, without end. Made by
service/server.
"""

from __future__ import annotations

import asyncio
from typing import Any

from uvicorn.protocols.http.auto import AutoHTTPProtocol
from uvicorn.protocols.http.h11_impl import H11Protocol

from .client_address import network_of
from .connection_limits import Bounds
from .problems import Problem

HEAD_LIMIT = 64 * 1024
"""Bytes of a request's head, beyond what comes in one read. The trailers of a body have as many,
and so has what stands between two of its chunks."""
TRAILERS = 100
"""Lines of trailers of a body. Nobody reads them."""
PATIENCE = 1.0
"""Seconds in which a connection that is refused may say what it wants: then it hears why."""
REFUSED = 32
"""So many that are refused are heard at once; further ones are closed unheard."""


class Bounded(AutoHTTPProtocol):  # type: ignore[misc, valid-type]
    """uvicorn's protocol, admitted by ``bounds`` or refused with a 503 problem."""

    def __init__(self, bounds: Bounds, **arguments: Any) -> None:
        super().__init__(**arguments)
        self._bounds = bounds
        self._address: str | None = None
        self._head = 0
        self._in_body = False
        self.resumed = 0
        """How often a client has taken what was waiting for it, so that more was sent."""

    def resume_writing(self) -> None:
        """The client has taken what it was sent."""
        self.resumed += 1
        super().resume_writing()

    def connection_made(self, transport: Any) -> None:
        """Admit the connection, or say why not."""
        peer = transport.get_extra_info("peername")
        address = network_of(str(peer[0])) if isinstance(peer, tuple) else ""
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
        answer = self._bounds.answer(problem)
        if self._bounds.refusing < REFUSED:
            transport.set_protocol(Refused(self._bounds, transport, answer))
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
        self.refuse(
            Problem(
                400,
                "bad request",
                "this is no HTTP that the service understands",
                hint="speak HTTP/1.1 without TLS, as curl does; "
                "docs/reference/access.md has what is bounded",
            )
        )

    def refuse(self, problem: Problem) -> None:
        """Say ``problem`` in place of the answer that would come next, and close."""
        self.transport.write(self._bounds.answer(problem))
        self.transport.close()


class BoundedHttptools(Bounded):
    """With bounds on the head and on what stands between and after the chunks of a body: httptools
    has none, h11 has its own."""

    def __init__(self, bounds: Bounds, **arguments: Any) -> None:
        super().__init__(bounds, **arguments)
        self._trailers = 0
        self._between = 0
        """Bytes since the last ones of the body."""
        self._too_much = False
        self._answering: Any = None
        """The cycle whose answer is under way; uvicorn knows the last one that was asked for."""

    def connection_lost(self, exc: Exception | None) -> None:
        """Who answers the request of now hears of it, also where others wait in the pipeline:
        uvicorn tells only the last one, and this one would write on to what is closed."""
        super().connection_lost(exc)
        cycle = self._answering
        if cycle is not None and not cycle.response_complete:
            cycle.disconnected = True
            cycle.message_event.set()

    def _start_asgi_task(self, cycle: Any, app: Any) -> None:
        """Begin an answer."""
        self._answering = cycle
        super()._start_asgi_task(cycle, app)

    def on_message_begin(self) -> None:
        """A head begins."""
        self._in_body = False
        super().on_message_begin()

    def on_header(self, name: bytes, value: bytes) -> None:
        """A line of the head. One after the body is no header of the request, as which uvicorn
        keeps it: it is dropped. Raises `_TooMuch`, which ends the parsing."""
        if not self._in_body:
            super().on_header(name, value)
            return
        self._trailers += 1
        if self._trailers > TRAILERS:
            self._too_much = True
            raise _TooMuch

    def on_headers_complete(self) -> None:
        """A head is there."""
        self._head, self._in_body = 0, True
        self._trailers = self._between = 0
        if not self.url.startswith((b"/", b"*")):
            # `GET http://host/path`: the host of the address goes before that of the header
            # (RFC 9112, section 3.2.2), of which nothing else here would know.
            place = self.url.partition(b"://")[2].partition(b"/")[0]
            others = [header for header in self.headers if header[0] != b"host"]
            self.headers[:] = [*others, (b"host", place)]
        super().on_headers_complete()

    def on_body(self, body: bytes) -> None:
        """Some of a body is there."""
        self._between = 0
        super().on_body(body)

    def on_message_complete(self) -> None:
        """A body is there."""
        self._in_body = False
        super().on_message_complete()

    def data_received(self, data: bytes) -> None:
        """Parse, unless the head has become too large, or what is no body within a body."""
        was_in_body = self._in_body
        # Where some of the body comes with it, what is counted begins anew: a read too late.
        self._between += len(data)
        super().data_received(data)
        if self._in_body:
            if self._between > HEAD_LIMIT:
                self.refuse(_framing())
            return
        cycle = self.cycle
        if was_in_body or not (cycle is None or cycle.response_complete):
            return
        self._head += len(data)
        if self._head > HEAD_LIMIT:
            self.refuse(
                Problem(
                    431,
                    "head too large",
                    f"the head of a request has at most {HEAD_LIMIT} bytes",
                    hint="long queries are sent in the body of POST /sparql",
                )
            )

    def send_400_response(self, msg: str) -> None:
        """The parsing has ended: this is no HTTP, or too much of it."""
        if self._too_much:
            self.refuse(_framing())
        else:
            super().send_400_response(msg)

    def refuse(self, problem: Problem) -> None:
        """Say so where an answer can stand, which is not within that to a request before it."""
        if self.transport.is_closing():
            return
        cycle = self.cycle
        begun = cycle is not None and cycle.response_started
        ended = cycle is None or cycle.response_complete
        if not self.pipeline and (not begun if self._in_body else ended):
            super().refuse(problem)
        else:
            self._bounds.refused(problem.title)
            self.transport.close()


class _TooMuch(Exception):
    """Ends the parsing of a body with too many trailers."""


def _framing() -> Problem:
    return Problem(
        431,
        "framing too large",
        f"between two chunks of a body, and after the last one, come at most {HEAD_LIMIT} bytes "
        f"and {TRAILERS} trailers",
        hint="send neither chunk extensions nor trailers: nobody reads them here",
    )


class Refused(asyncio.Protocol):
    """A connection too many: it is told so when it asks for something, and closed.

    Answered before anything of it is read, it would be reset and hear nothing.
    """

    def __init__(self, bounds: Bounds, transport: asyncio.Transport, answer: bytes) -> None:
        bounds.refusing += 1
        self._bounds = bounds
        self._transport = transport
        self._answer = answer
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
