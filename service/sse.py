"""Streams as server-sent events: one ring a stream, a cursor a client (docs/api.md, DESIGN §3).

The ring is the stream's own history; a client is the number of the next sample it wants. Samples
are encoded when somebody listens, once for all clients, and kept in a bounded cache. A client
that comes back after a gap in the history is told the gap. Of an adaptive subscription the switches
stand between the samples (`marks`): what is sent in one go ends there.

Cost: a publish wakes the waiting clients (O(clients), nothing a sample); encoding is per sample,
once. Memory: the cache's limit, and one piece a client. There is no queue a client.
"""

from __future__ import annotations

import asyncio
from collections import OrderedDict
from collections.abc import AsyncIterator, Iterator, Sequence
from dataclasses import dataclass
from itertools import count
from typing import Any

import msgspec
from fastapi import Request
from fastapi.responses import Response
from sse_starlette import EventSourceResponse

from ..engine.adaptive import Rematch
from ..engine.engine import Engine
from ..engine.errors import UnknownStream
from ..streams.generator import StreamGenerator
from ..streams.sample import SampleBatch
from ..streams.time import format_time
from .marks import Marks
from .models import RematchModel
from .negotiation import EVENT_STREAM, accepted
from .observe import HEAD
from .problems import Problem

PIECE = 256
"""At most so many samples are encoded and sent in one go: nobody waits long for another's."""
READ = 4096
"""At most so many samples are taken from the history at once."""
POSITION = "Dyknow-Position"
"""The header of an answer that says after which id it begins."""


@dataclass(frozen=True, slots=True)
class Piece:
    """Encoded messages of the samples ``first`` … : ``bounds[i]`` is where the i-th begins."""

    first: int
    data: bytes
    bounds: tuple[int, ...]

    def since(self, number: int) -> bytes:
        """The messages from sample ``number`` on."""
        return self.data if number == self.first else self.data[self.bounds[number - self.first] :]

    def part(self, number: int, last: int) -> bytes:
        """The messages from sample ``number`` to sample ``last``, both included."""
        begin, end = number - self.first, last + 1 - self.first
        stop = self.bounds[end] if end < len(self.bounds) else len(self.data)
        return self.data[self.bounds[begin] : stop]


class PieceCache:
    """Pieces by feed and last sample's number; the least recently sent go when it is full."""

    def __init__(self, limit: int) -> None:
        self._limit = limit
        self._size = 0
        self._pieces: OrderedDict[tuple[int, int], Piece] = OrderedDict()

    def get(self, feed: int, last: int, number: int) -> Piece | None:
        """The piece that ends with sample ``last``, if it reaches back to ``number``."""
        piece = self._pieces.get((feed, last))
        if piece is None or piece.first > number:
            return None
        self._pieces.move_to_end((feed, last))
        return piece

    def put(self, feed: int, last: int, piece: Piece) -> None:
        """Keep ``piece``, in place of one that reached back less far."""
        old = self._pieces.pop((feed, last), None)
        self._size += len(piece.data) - (len(old.data) if old else 0)
        self._pieces[(feed, last)] = piece
        while self._size > self._limit and self._pieces:
            _, gone = self._pieces.popitem(last=False)
            self._size -= len(gone.data)

    def forget(self, feed: int) -> None:
        """Drop the pieces of a feed that nobody listens to."""
        for key in [key for key in self._pieces if key[0] == feed]:
            self._size -= len(self._pieces.pop(key).data)


class Feed:
    """A stream that somebody listens to: wakes the cursors when its generator has more."""

    def __init__(
        self, serial: int, engine: Engine, generator: StreamGenerator, cache: PieceCache
    ) -> None:
        self.serial = serial
        self.generator = generator
        self.name = generator.name
        self.clients = 0
        self.removed = False
        self.changed = asyncio.Event()
        self.switches: Sequence[Rematch] = ()
        """Those of the subscription whose stream this is."""
        self._newest: Rematch | None = None
        self._engine = engine
        self._cache = cache
        self._encoder = msgspec.json.Encoder()

    def receive(self, source: StreamGenerator, batch: SampleBatch) -> None:
        self.wake()

    def ended(self, source: StreamGenerator) -> None:
        self.wake()

    def wake(self) -> None:
        """Let every waiting cursor look again. Several wakes before they run are one."""
        self.changed.set()
        self.changed = asyncio.Event()

    def look(self) -> None:
        """Wake the cursors where there is a switch that they may not have heard of: it need not
        come with a sample."""
        if self.switches and self.switches[-1] is not self._newest:
            self._newest = self.switches[-1]
            self.wake()

    def messages(self, number: int, until: int | None = None) -> Iterator[tuple[int, bytes]]:
        """The kept samples from ``number`` on, up to ``until`` (included), in pieces: last sample's
        number and messages."""
        for segment in self.generator.stream.since(number, READ):
            first = segment.first
            while first <= segment.last:
                # Pieces end at multiples of PIECE, so that clients at different places share them.
                last = min(segment.last, (first // PIECE + 1) * PIECE - 1)
                piece = self._cache.get(self.serial, last, first)
                if piece is None:
                    rows = slice(first - segment.first, last + 1 - segment.first)
                    piece = self._encode(first, segment.batch.take(rows))
                    self._cache.put(self.serial, last, piece)
                if until is not None and until <= last:
                    yield until, piece.part(first, until)
                    return
                yield last, piece.since(first)
                first = last + 1

    def _encode(self, first: int, batch: SampleBatch) -> Piece:
        epoch = self._engine.epoch
        parts: list[bytes] = []
        bounds: list[int] = []
        size = 0
        rdf = self._rdf(batch)
        for i, (available, valid, values) in enumerate(batch.rows()):
            sample = {
                "stream": self.name,
                "sequence": first + i,
                "available": format_time(available),
                "valid": format_time(valid),
                "values": values,
                "rdf": rdf[i],
            }
            data = self._encoder.encode(sample)
            message = b"id: %s-%d\nevent: sample\ndata: %s\n\n" % (epoch.encode(), first + i, data)
            bounds.append(size)
            size += len(message)
            parts.append(message)
        return Piece(first, b"".join(parts), tuple(bounds))

    def _rdf(self, batch: SampleBatch) -> list[str]:
        try:
            return self._engine.rdf_of(self.name, batch)
        except UnknownStream:
            # The stream is gone, its last samples still go out; what they meant is gone with it.
            return [""] * len(batch)


@dataclass(slots=True)
class Start:
    """Where a cursor begins: the next sample's number, and what to say first about a loss."""

    number: int
    opening: bytes = b""


class Feeds:
    """All streams that clients listen to."""

    def __init__(self, engine: Engine, cache_limit: int) -> None:
        self._engine = engine
        self._cache = PieceCache(cache_limit)
        self._feeds: dict[str, Feed] = {}
        self._serials = count()
        self._closing = False

    @property
    def epoch(self) -> str:
        """The life of the service that ids speak of."""
        return self._engine.epoch

    @property
    def clients(self) -> int:
        """How many clients listen."""
        return sum(feed.clients for feed in self._feeds.values())

    def start(self, name: str, since: str | None) -> Start:
        """Where a client begins: now, at the ``start`` of what is kept, or after an id.

        Raises `UnknownStream`, or a 400 `Problem` for an id that is none.
        """
        stream = self._engine.generator(name).stream
        if since is None:
            return Start(stream.last_number + 1)
        if since == "start":
            return Start(stream.first_number)
        epoch, _, digits = since.rpartition("-")
        if not epoch or not digits.isascii() or not digits.isdigit() or len(digits) > 18:
            raise Problem(
                400,
                "bad event id",
                f"{since!r} is no id of a sample",
                hint="send the id of the last message, or since=start",
            )
        number = int(digits) + 1
        if epoch == self._engine.epoch and number <= stream.last_number + 1:
            return Start(number)
        if epoch != self._engine.epoch:
            reason = "the service has begun anew since: numbers count from 1 again"
        else:
            reason = "the stream has begun anew since: numbers count from 1 again"
        lost = {"stream": name, "from": number, "to": None, "epoch": epoch, "reason": reason}
        return Start(1, _message("gap", lost))

    async def listen(
        self, name: str, start: Start, switches: Sequence[Rematch] | None = None
    ) -> AsyncIterator[bytes]:
        """The messages for one client, from ``start`` until the stream's end, with the
        ``switches`` that stand after the sample before it, or later."""
        feed = self._join(name)
        number = start.number
        marks = Marks(() if switches is None else switches, number - 1)
        if switches is not None:
            feed.switches = switches
        try:
            yield b": dyknow\n" + start.opening
            while not self._leaving():
                # Taken before looking, so that a wake in between is not lost.
                changed = feed.changed
                stream = feed.generator.stream
                for switch in marks.before(number):
                    yield _message("rematched", RematchModel.of(switch).model_dump())
                if number < stream.first_number:
                    yield _gap(name, number, stream.first_number - 1)
                    number = stream.first_number
                    continue
                for last, data in feed.messages(number, marks.next):
                    yield data
                    number = last + 1
                    # A fast client must not keep the loop from everybody else.
                    await asyncio.sleep(0)
                    if self._leaving():
                        return
                waiting = marks.next
                if number <= stream.last_number or (waiting is not None and waiting < number):
                    continue
                if feed.removed or feed.generator.is_ended:
                    reason = "removed" if feed.removed else "ended"
                    end = {"stream": name, "sequence": number - 1, "reason": reason}
                    yield _message("end", end)
                    return
                await changed.wait()
        finally:
            self._leave(feed)

    def review(self) -> None:
        """Tell the clients of streams that are no longer there, and of switches. Called at each
        tick."""
        for name, feed in list(self._feeds.items()):
            try:
                gone = self._engine.generator(name) is not feed.generator
            except UnknownStream:
                gone = True
            if gone:
                del self._feeds[name]
                feed.removed = True
                feed.wake()
            else:
                feed.look()

    def close(self) -> None:
        """Let all clients go: the service stops. They resume when it is back."""
        self._closing = True
        for feed in self._feeds.values():
            feed.wake()

    def _leaving(self) -> bool:
        return self._closing

    def _join(self, name: str) -> Feed:
        generator = self._engine.generator(name)
        feed = self._feeds.get(name)
        if feed is None or feed.generator is not generator:
            feed = Feed(next(self._serials), self._engine, generator, self._cache)
            generator.listen(feed)
            self._feeds[name] = feed
        feed.clients += 1
        return feed

    def _leave(self, feed: Feed) -> None:
        feed.clients -= 1
        if feed.clients:
            return
        feed.generator.leave(feed)
        self._cache.forget(feed.serial)
        if self._feeds.get(feed.name) is feed:
            del self._feeds[feed.name]


def event_stream(
    feeds: Feeds,
    request: Request,
    name: str,
    since: str | None,
    *,
    switches: Sequence[Rematch] | None = None,
    ping: float,
    timeout: float,
) -> Response:
    """The response that is a stream's events, with ``switches`` between them if it is an adaptive
    subscription's; ``Last-Event-ID`` goes before ``since``."""
    accepted(request, [EVENT_STREAM])
    start = feeds.start(name, request.headers.get("last-event-id") or since)
    headers = {POSITION: f"{feeds.epoch}-{start.number - 1}"}
    if request.scope.get(HEAD):
        return Response(headers=headers, media_type=EVENT_STREAM)
    return EventSourceResponse(
        feeds.listen(name, start, switches),
        headers=headers,
        ping=ping,
        # A comment without an empty line: a reader that dispatches empty messages stays quiet.
        ping_message_factory=_ping,
        send_timeout=timeout,
    )


def _ping() -> Any:
    return b": ping\n"


def _gap(name: str, first: int, last: int) -> bytes:
    reason = "these samples are no longer kept"
    return _message("gap", {"stream": name, "from": first, "to": last, "reason": reason})


def _message(event: str, data: dict[str, object]) -> bytes:
    return b"event: %s\ndata: %s\n\n" % (event.encode(), msgspec.json.encode(data))
