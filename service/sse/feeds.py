"""Streams as server-sent events: a feed for each stream, a cursor for each client
(docs/reference/streams.md, DESIGN §3).

A feed sends from the stream's own history, so no client needs a queue. A cursor is the number of
the next sample for its client. A feed encodes samples when a client needs them, once for all
clients, into a bounded cache (`message_cache`). A client that resumes after evicted samples gets a
``gap``. The switches of an adaptive subscription are messages between its samples
(`switch_markers`). `clients` decides when to wake which client, and `response` sends.

Cost: a publish O(1), then O(1) for each client; encoding is per sample, once. Memory: the cache's
limit, and the unsent part of each response (`EventStream`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import msgspec
from fastapi import Request
from fastapi.responses import Response

from ...engine.engine import Engine
from ...engine.model.errors import UnknownStream
from ...engine.requests.adaptive_subscription import Rematch
from ...streams import past_queries
from ...streams.generator import StreamGenerator
from ...streams.past_queries import Moment
from ...streams.sample import SampleBatch
from ...streams.time import format_time
from ..admission.gate import CALLER
from ..config.media_types import EVENT_STREAM, POSITION
from ..http.access_log import HEAD
from ..http.negotiation import accepted
from ..http.problems import Problem
from ..models import RematchModel
from .clients import EventClient, EventClients
from .message_cache import PIECE_BYTES, Block, Blocks, MessageCache
from .response import EventStream, Messages
from .switch_markers import SwitchMarkers

LONGEST_EPOCH = 64
"""The greatest length of an epoch in a client's id; the service's own have eight characters."""


@dataclass(frozen=True, slots=True)
class Visible:
    """The part of a stream that clients may see: the number of the newest sample, whether the
    stream has ended, the time (ns) of the last switch, and the failure of its source."""

    newest: int
    is_ended: bool
    switched: int | None
    failure: str | None = None


class Feed:
    """A stream with clients, which it wakes when its generator publishes.

    With a data directory, clients see the durable part only: `Feeds.release` advances it.
    """

    def __init__(
        self,
        engine: Engine,
        generator: StreamGenerator,
        cache: MessageCache,
        clients: EventClients,
        pending: dict[Feed, None] | None,
    ) -> None:
        self.generator = generator
        self.name = generator.name
        self.clients: dict[EventClient, None] = {}
        self.is_removed = False
        self.switches: Sequence[Rematch] = ()
        """The switches of the adaptive subscription that publishes the stream."""
        self.failure = engine.failure_of(generator)
        """The failure of the stream's source, as of the last `check`."""
        self._last_switch: Rematch | None = None
        self._engine = engine
        self._all = clients
        self._blocks = Blocks(cache)
        self._encoder = msgspec.json.Encoder()
        self._pending = pending
        self.visible: Visible | None = None
        """The part that clients may see; None: all."""

    @property
    def newest(self) -> int:
        """The number of the newest sample that clients may see."""
        last = self.generator.stream.last_number
        return last if self.visible is None else min(last, self.visible.newest)

    def state(self) -> Visible:
        """Return the stream's present state, durable or not."""
        generator = self.generator
        latest = self.switches[-1].time if self.switches else None
        last = generator.stream.last_number
        return Visible(last, generator.is_ended, latest, self.failure)

    @property
    def oldest(self) -> int:
        """The number of the oldest sample in the history."""
        return self.generator.stream.first_number

    @property
    def end_reason(self) -> str | None:
        """The reason why no sample follows `newest`; None while one may follow."""
        if self.is_removed:
            return "removed"
        if self.newest != self.generator.stream.last_number:
            return None
        visible = self.visible or self.state()
        if visible.failure is not None and self.failure is not None:
            return "failed"
        return "ended" if self.generator.is_ended and visible.is_ended else None

    def receive(self, source: StreamGenerator, batch: SampleBatch) -> None:
        self._mark_changed()

    def ended(self, source: StreamGenerator) -> None:
        self.failure = self._engine.failure_of(self.generator)
        self._mark_changed()

    def _mark_changed(self) -> None:
        if self._pending is None:
            self.wake()
        else:
            self._pending[self] = None

    def show(self, visible: Visible) -> None:
        """Let clients see the stream up to ``visible``."""
        self.visible = visible
        self.wake()

    def wake(self) -> None:
        """Let every client check for messages. Several wakes before it does so count as one."""
        self._all.rounds.add(self)

    def check(self, *, failures: bool = True) -> None:
        """Wake the clients for a new switch, or for a new failure of the source (looked up if
        ``failures``). These need not come with a sample."""
        if failures and self.failure != (failure := self._engine.failure_of(self.generator)):
            self.failure = failure
            self._mark_changed()
        if self.switches and self.switches[-1] is not self._last_switch:
            self._last_switch = self.switches[-1]
            self._mark_changed()

    def messages(self, number: int, until: int) -> tuple[int, bytes]:
        """Return the messages of one piece, from sample ``number`` to at most ``until``: the last
        sample's number, and the bytes. Contract: the history has ``number``."""
        block = self._blocks.find(number) or self._fill_block(number)
        return block.part(number, until)

    def close(self) -> None:
        """Stop listening to the generator: the last client has left."""
        self.generator.leave(self)
        self._blocks.clear()

    def _fill_block(self, number: int) -> Block:
        """Encode sample ``number`` and some that follow it into a block, and return the block."""
        block, room = self._blocks.place(number)
        room = min(room, self.newest + 1 - number)
        batch = self.generator.stream.since(number, room)[0].batch
        self._blocks.extend(block, self._encode(number, batch.take(slice(0, room))))
        return block

    def _encode(self, first: int, batch: SampleBatch) -> list[bytes]:
        """Return the messages of at least one sample from ``first`` on, and of at most a piece."""
        rows: list[tuple[int, int, msgspec.Raw]] = []
        size = 0
        for available, valid, values in batch.rows():
            encoded = self._encoder.encode(values)
            rows.append((available, valid, msgspec.Raw(encoded)))
            size += len(encoded)
            if size > PIECE_BYTES:
                break
        rdf = self._rdf(batch.take(slice(0, len(rows))))
        epoch = self._engine.epoch.encode()
        messages = []
        for i, (available, valid, raw) in enumerate(rows):
            sample = {
                "stream": self.name,
                "sequence": first + i,
                "available": format_time(available),
                "valid": format_time(valid),
                "values": raw,
                "rdf": rdf[i],
            }
            data = self._encoder.encode(sample)
            messages.append(b"id: %s-%d\nevent: sample\ndata: %s\n\n" % (epoch, first + i, data))
        return messages

    def _rdf(self, batch: SampleBatch) -> list[str]:
        try:
            return self._engine.rdf_of(self.name, batch)
        except UnknownStream:
            # The stream was removed, and its annotation with it; its last samples still go out.
            return [""] * len(batch)


@dataclass(slots=True)
class Start:
    """The start of a cursor: the next sample's number, and an ``opening`` message about a loss.

    ``last`` is the number of the newest sample at that time. The route awaits a commit after it
    finds the start, so clients may see samples up to ``last``.
    """

    number: int
    opening: bytes = b""
    last: int = 0


def _is_visible(feed: Feed, switch: Rematch) -> bool:
    visible = feed.visible
    return visible is None or (visible.switched is not None and switch.time <= visible.switched)


class Cursor:
    """The position of one client in one stream, and its `Messages` from there on.

    Law (tests/laws): cut the messages of a cursor anywhere, and resume after the last complete
    sample. The client gets every sample once and in order, and a ``gap`` for evicted samples.
    """

    def __init__(
        self, feeds: Feeds, name: str, start: Start, switches: Sequence[Rematch] | None = None
    ) -> None:
        self.name = name
        self.number = start.number
        """The next sample's number."""
        self.end_reason: str | None = None
        self._feeds = feeds
        self._feed: Feed | None = None
        self._opening = start.opening
        self._last = start.last
        self._switches = switches
        self._markers = SwitchMarkers((), 0)
        self._start = start.number

    def join(self, client: EventClient) -> None:
        """Wake ``client`` when there are new messages. Raises `UnknownStream`."""
        feed = self._feed = self._feeds.join(self.name, self._last, client)
        if self._switches is not None:
            feed.switches = self._switches
            # Not a bound method: a reference cycle would outlive the client until a collection.
            self._markers = SwitchMarkers(
                self._switches, self._start - 1, partial(_is_visible, feed)
            )

    def leave(self, client: EventClient) -> None:
        """Wake ``client`` no more."""
        if self._feed is not None:
            self._feeds.leave(self._feed, client)

    def piece(self, feed: Feed, number: int, until: int) -> tuple[int, bytes]:
        """Return the messages of one piece of samples: see `Feed.messages`."""
        return feed.messages(number, until)

    def take(self) -> bytes | None:
        """Return the next messages; None while there are none. Contract: after `join`."""
        feed, number = self._feed, self.number
        assert feed is not None
        if self._opening:
            opening, self._opening = self._opening, b""
            return opening
        switch = next(self._markers.before(number), None)
        if switch is not None:
            return message("rematched", RematchModel.of(switch).model_dump())
        oldest = feed.oldest
        if number < oldest:
            self.number = oldest
            return _gap(feed.name, number, oldest - 1)
        newest = feed.newest
        if number <= newest:
            mark = self._markers.next
            until = newest if mark is None else min(newest, mark)
            last, data = self.piece(feed, number, until)
            self.number = last + 1
            self.end_reason = None  # a stream that ended may have gone on
            return data
        if self.end_reason is None and feed.end_reason is not None:
            self.end_reason = feed.end_reason
            end = {"stream": feed.name, "sequence": number - 1, "reason": self.end_reason}
            if self.end_reason == "failed":
                end["failure"] = feed.failure
            return message("end", end)
        return None


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
        return Start(1, message("gap", lost), last=last)

    def join(self, name: str, last: int, client: EventClient) -> Feed:
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
        feed.clients[client] = None
        return feed

    def leave(self, feed: Feed, client: EventClient) -> None:
        """Remove ``client`` from ``feed``, and close a feed without clients."""
        del feed.clients[client]
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


def event_stream(
    feeds: Feeds,
    request: Request,
    key: str,
    name: str,
    since: str | None,
    switches: Sequence[Rematch] | None = None,
) -> Response:
    """Return the response that sends a stream's events, with ``switches`` between them for an
    adaptive subscription. ``Last-Event-ID`` goes before ``since``: a browser that reconnects
    repeats the URL. Clients of one ``key`` count together (`EventClients.admit`)."""
    return stream_of(
        feeds, request, key, name, since, lambda start: Cursor(feeds, name, start, switches)
    )


def stream_of(
    feeds: Feeds,
    request: Request,
    key: str,
    name: str,
    since: str | None,
    cursor: Callable[[Start], Messages],
) -> Response:
    """Return the response that sends the messages of a ``cursor`` from its start on; the other
    arguments are those of `event_stream`."""
    accepted(request, [EVENT_STREAM])
    start = feeds.start(name, request.headers.get("last-event-id") or since)
    return respond(feeds, request, key, cursor(start), f"{feeds.epoch}-{start.number - 1}")


def respond(
    feeds: Feeds, request: Request, key: str, messages: Messages, position: str
) -> Response:
    """Return the response that sends ``messages`` after the id ``position``. Raises `Problem` 429
    and 503 if there are too many clients."""
    headers = {POSITION: position}
    if request.scope.get(HEAD):
        return Response(headers=headers, media_type=EVENT_STREAM)
    client = feeds.all.admit(key, request.scope.get(CALLER))
    return EventStream(feeds.all, client, messages, headers)


def message(event: str, data: dict[str, object]) -> bytes:
    """Return a message that is no sample. It has no id, so clients resume after samples only."""
    return b"event: %s\ndata: %s\n\n" % (event.encode(), msgspec.json.encode(data))


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


def _gap(name: str, first: int, last: int) -> bytes:
    reason = "these samples are no longer kept"
    return message("gap", {"stream": name, "from": first, "to": last, "reason": reason})
