"""Streams as server-sent events: a feed for each stream, a cursor for each client
(docs/reference/streams.md, DESIGN §3).

A feed sends from the stream's own history, so no client needs a queue. A cursor is the number of
the next sample for its client. A feed encodes samples when a client needs them, once for all
clients that want the same members, into a bounded cache (`message_cache`). A client that resumes
after evicted samples gets a ``gap``. A client may have only the newest sample of each object now
and then (`conflation`). The switches of an adaptive subscription are messages between its samples
(`switch_markers`). `clients` decides when to wake which client, and `response` sends.

Cost: a publish O(1), then O(1) for each client; encoding is per sample and `Projection`, once.
Memory: the cache's limit, and the unsent part of each response (`EventStream`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from time import monotonic

from fastapi import Request
from fastapi.responses import Response

from ...engine.engine import Engine
from ...engine.model.errors import UnknownStream
from ...engine.requests.adaptive_subscription import Rematch
from ...streams import past_queries
from ...streams.past_queries import Moment
from ..admission.gate import CALLER
from ..config.media_types import EVENT_STREAM, POSITION
from ..http.access_log import HEAD
from ..http.negotiation import accepted
from ..http.problems import Problem
from .clients import EventClient, EventClients
from .conflation import ConflatedCursor
from .cursor import Cursor, Start, message
from .delivery import Delivery, Projection
from .feed import Feed, Visible
from .message_cache import MessageCache
from .response import EventStream, Messages

LONGEST_EPOCH = 64
"""The greatest length of an epoch in a client's id; the service's own have eight characters."""


class Feeds:
    """All feeds, and the gate that shows clients durable output only (`GatedOutput`)."""

    def __init__(
        self,
        engine: Engine,
        cache_limit: int,
        clients: EventClients,
        is_durable: Callable[[], bool] | None = None,
    ) -> None:
        """``is_durable`` returns whether the log has all commands on disk; None: there is none."""
        self.all = clients
        """The clients of all feeds."""
        self._engine = engine
        self._cache = MessageCache(cache_limit)
        self._feeds: dict[str, Feed] = {}
        self._is_durable = is_durable
        self._failures = 0
        """The engine's count of failures at the last `review`."""
        self._pending: dict[Feed, None] | None = None if is_durable is None else {}

    @property
    def epoch(self) -> str:
        """The epoch of the service, the first part of an event's id."""
        return self._engine.epoch

    @property
    def clients(self) -> int:
        """The number of clients."""
        return len(self.all)

    def start_of_last(self, name: str, count: int) -> Start:
        """Return the start of a client that begins with so many of the newest samples, or with all
        that are kept. Raises `UnknownStream`."""
        stream = self._engine.generator(name).stream
        number = max(stream.first_number, self._newest(name) + 1 - count)
        return Start(number, last=stream.last_number)

    def start(self, name: str, since: str | None) -> Start:
        """Return the start of a client: now, at the ``start`` of the history, at a time or a
        duration before the newest sample (`Moment`), or after an id.

        Raises `UnknownStream`, `Forgotten`, or a 400 `Problem` for any other text.
        """
        stream = self._engine.generator(name).stream
        if since is None:
            return Start(self._newest(name) + 1, last=stream.last_number)
        if since == "start":
            return Start(stream.first_number, last=stream.last_number)
        moment = Moment.parse(since)
        if moment is not None:
            return Start(past_queries.number_since(stream, moment), last=stream.last_number)
        epoch, _, digits = since.rpartition("-")
        if not 0 < len(epoch) <= LONGEST_EPOCH or not is_number(digits):
            raise bad_id(since)
        return self.after(name, epoch, int(digits))

    def after(self, name: str, epoch: str, number: int) -> Start:
        """Return the start of a client that has had sample ``number`` of ``epoch``. Raises
        `UnknownStream`."""
        number += 1
        # Not the newest visible sample: other clients of the feed may have seen more.
        last = self._engine.generator(name).stream.last_number
        if epoch == self._engine.epoch and number <= last + 1:
            return Start(number, last=last)
        if epoch != self._engine.epoch:
            reason = "the service has begun anew since: numbers count from 1 again"
        else:
            reason = "the stream has begun anew since: numbers count from 1 again"
        lost = {"stream": name, "from": number, "to": None, "epoch": epoch, "reason": reason}
        # The number means no sample of this stream, so the client begins with the oldest kept one.
        return Start(1, message("gap", lost), last=last)

    def join(self, name: str, last: int, client: EventClient, projection: Projection) -> Feed:
        """Add ``client`` to the feed of a stream that is durable up to sample ``last``. Raises
        `UnknownStream`."""
        generator = self._engine.generator(name)
        # A stream may have several names, and has one feed.
        feed = self._feeds.get(generator.name)
        if feed is None or feed.generator is not generator:
            feed = Feed(self._engine, generator, self._cache, self.all, self._pending)
            if self._is_durable is not None and self._pending is not None:
                feed.visible = feed.state()
                if not self._is_durable():
                    # The next commit releases the samples since the client's start was found.
                    feed.visible = Visible(last, False, None)
                    self._pending[feed] = None
            generator.listen(feed)
            self._feeds[generator.name] = feed
        feed.clients[client] = projection
        return feed

    def leave(self, feed: Feed, client: EventClient) -> None:
        """Remove ``client`` from ``feed``, and close a feed without clients."""
        feed.forget(client)
        if feed.clients:
            return
        feed.close()
        if self._feeds.get(feed.name) is feed:
            del self._feeds[feed.name]

    def review(self) -> None:
        """Wake the clients of streams that were removed, have failed or switched. Each tick calls
        this."""
        failures, self._failures = self._failures, self._engine.failures
        for feed in tuple(self._feeds.values()):
            if not self._is_removed(feed):
                feed.check(failures=self._failures != failures)
            elif not feed.is_removed:
                del self._feeds[feed.name]
                feed.is_removed = True
                feed.wake()

    def _is_removed(self, feed: Feed) -> bool:
        try:
            return self._engine.generator(feed.name) is not feed.generator
        except UnknownStream:
            return True

    def close(self) -> None:
        """End all responses: the service stops. Clients resume at its next start."""
        self.all.close()

    # -- `GatedOutput` ---------------------------------------------------------------------------

    @property
    def has_pending(self) -> bool:
        """Whether there is output that clients do not see yet."""
        return bool(self._pending)

    def take_pending(self) -> Sequence[tuple[Feed, Visible]]:
        """Return the state of each feed that has changed since the last call."""
        assert self._pending is not None
        pending = [(feed, feed.state()) for feed in self._pending]
        self._pending.clear()
        return pending

    def release(self, pending: Sequence[tuple[Feed, Visible]]) -> None:
        """Let clients see the feeds up to these states: the log has them on disk."""
        for feed, visible in pending:
            # A removed stream has ended, too: "removed" must be the reason that clients get.
            feed.is_removed = feed.is_removed or self._is_removed(feed)
            feed.show(visible)

    def requeue(self, pending: Sequence[tuple[Feed, Visible]]) -> None:
        """Return these feeds with the next `take_pending`: the commit failed."""
        assert self._pending is not None
        self._pending.update((feed, None) for feed, _ in pending)

    def _newest(self, name: str) -> int:
        generator = self._engine.generator(name)
        feed = self._feeds.get(generator.name)
        return generator.stream.last_number if feed is None else feed.newest


def cursor_of(
    feeds: Feeds,
    name: str,
    start: Start,
    delivery: Delivery,
    switches: Sequence[Rematch] | None = None,
) -> Cursor:
    """Return the cursor of a client from ``start`` on."""
    projection = delivery.projection
    if delivery.every is None:
        return Cursor(feeds, name, start, switches, projection)
    return ConflatedCursor(feeds, name, start, switches, projection, delivery.every, monotonic)


def event_stream(
    feeds: Feeds,
    request: Request,
    key: str,
    name: str,
    delivery: Delivery,
    switches: Sequence[Rematch] | None = None,
) -> Response:
    """Return the response that sends a stream's events, with ``switches`` between them for an
    adaptive subscription. ``Last-Event-ID`` goes before ``delivery``: a browser that reconnects
    repeats the URL. Clients of one ``key`` count together (`EventClients.admit`)."""

    def opened(start: Start) -> Cursor:
        return cursor_of(feeds, name, start, delivery, switches)

    return stream_of(feeds, request, key, name, delivery, opened)


def stream_of(
    feeds: Feeds,
    request: Request,
    key: str,
    name: str,
    delivery: Delivery,
    opened: Callable[[Start], Messages],
) -> Response:
    """Return the response that sends the messages of a cursor, ``opened`` at its start; the other
    arguments are those of `event_stream`."""
    accepted(request, [EVENT_STREAM])
    id = request.headers.get("last-event-id")
    if id or delivery.last is None:
        start = feeds.start(name, id or delivery.since)
    else:
        start = feeds.start_of_last(name, delivery.last)
    return respond(feeds, request, key, opened(start), f"{feeds.epoch}-{start.number - 1}")


def respond(
    feeds: Feeds, request: Request, key: str, messages: Messages, position: str
) -> Response:
    """Return the response that sends ``messages`` after the id ``position``. Raises `Problem` 429
    and 503 if there are too many clients."""
    headers = {POSITION: position}
    # A HEAD request sends no events, so it takes no place of a client.
    if request.scope.get(HEAD):
        return Response(headers=headers, media_type=EVENT_STREAM)
    client = feeds.all.admit(key, request.scope.get(CALLER))
    return EventStream(feeds.all, client, messages, headers)


def is_number(digits: str) -> bool:
    """Whether ``digits`` is the number of a sample, or 0."""
    return digits.isascii() and digits.isdigit() and len(digits) <= 18


def bad_id(since: str) -> Problem:
    """Return the error for a text that is no id."""
    return Problem(
        400,
        "bad event id",
        f"{since!r} is no id of a sample",
        hint="send the id of the last message, or since=start, a time or a duration such as 30s",
    )
