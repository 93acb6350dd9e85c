"""Streams as server-sent events: one ring a stream, a cursor a client (docs/reference/streams.md,
DESIGN §3).

The ring is the stream's own history; a client is the number of the next sample it wants. Samples
are encoded when somebody listens, once for all clients, and kept in a bounded cache
(event_messages). A client that comes back after a gap in the history is told the gap. Of an
adaptive subscription the switches stand between the samples (`switch_markers`): what is sent in one
go ends there. Who is woken when, and how an answer is sent, is event_clients and event_response.

Cost: a publish O(1), then a look of each client; encoding is per sample, once. Memory: the cache's
limit, and what a client has not taken (`EventStream`). There is no queue a client.
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
from .switch_markers import Marks

LONGEST_EPOCH = 64
"""Characters of an epoch in an id that a client says; the service's own have eight."""


@dataclass(frozen=True, slots=True)
class Shown:
    """Of one stream: the number of the newest sample, whether it has ended, when (ns) the last
    switch of its subscription was, and why what feeds it has failed."""

    newest: int
    is_ended: bool
    switched: int | None
    failure: str | None = None


class Feed:
    """A stream that somebody listens to: wakes its clients when its generator has more.

    Of one that is recorded they see what is kept: up to `Shown`, which `Feeds` moves on.
    """

    def __init__(
        self,
        engine: Engine,
        generator: StreamGenerator,
        cache: MessageCache,
        clients: EventClients,
        unseen: dict[Feed, None] | None,
    ) -> None:
        self.generator = generator
        self.name = generator.name
        self.clients: dict[EventClient, None] = {}
        self.is_removed = False
        self.switches: Sequence[Rematch] = ()
        """Those of the subscription whose stream this is."""
        self.failure = engine.failure_of(generator)
        """Why what feeds the stream has failed, as of the last `look`."""
        self._told: Rematch | None = None
        self._engine = engine
        self._all = clients
        self._blocks = Blocks(cache)
        self._encoder = msgspec.json.Encoder()
        self._unseen = unseen
        self.shown: Shown | None = None
        """What clients may see; None: all there is."""

    @property
    def newest(self) -> int:
        """The number of the newest sample that clients may see: so far cursors may read."""
        last = self.generator.stream.last_number
        return last if self.shown is None else min(last, self.shown.newest)

    def look_now(self) -> Shown:
        """What there is to be seen, kept or not."""
        generator = self.generator
        latest = self.switches[-1].time if self.switches else None
        last = generator.stream.last_number
        return Shown(last, generator.is_ended, latest, self.failure)

    @property
    def oldest(self) -> int:
        """The number of the oldest sample that is kept."""
        return self.generator.stream.first_number

    @property
    def over(self) -> str | None:
        """Why nothing comes after `newest`; None while something may."""
        if self.is_removed:
            return "removed"
        if self.newest != self.generator.stream.last_number:
            return None
        shown = self.shown or self.look_now()
        if shown.failure is not None and self.failure is not None:
            return "failed"
        return "ended" if self.generator.is_ended and shown.is_ended else None

    def receive(self, source: StreamGenerator, batch: SampleBatch) -> None:
        self._news()

    def ended(self, source: StreamGenerator) -> None:
        self.failure = self._engine.failure_of(self.generator)
        self._news()

    def _news(self) -> None:
        if self._unseen is None:
            self.wake()
        else:
            self._unseen[self] = None

    def show(self, shown: Shown) -> None:
        """Clients may see so much from now on."""
        self.shown = shown
        self.wake()

    def wake(self) -> None:
        """Let every client look again. Several wakes before they do are one."""
        self._all.rounds.add(self)

    def look(self, *, failures: bool = True) -> None:
        """Wake the clients where there is a switch that they may not have heard of, or a failure of
        what feeds the stream (if there are new ``failures``): it need not come with a sample."""
        if failures and self.failure != (failure := self._engine.failure_of(self.generator)):
            self.failure = failure
            self._news()
        if self.switches and self.switches[-1] is not self._told:
            self._told = self.switches[-1]
            self._news()

    def messages(self, number: int, until: int) -> tuple[int, bytes]:
        """Messages from sample ``number`` on, as many as are sent in one go, none of a sample after
        ``until``: the last one's number, and the bytes. Contract: ``number`` is kept."""
        block = self._blocks.find(number) or self._encoded(number)
        return block.part(number, until)

    def close(self) -> None:
        """The last client has left."""
        self.generator.leave(self)
        self._blocks.clear()

    def _encoded(self, number: int) -> Block:
        """The block that has sample ``number`` from now on, and some that follow it."""
        block, room = self._blocks.place(number)
        room = min(room, self.newest + 1 - number)
        batch = self.generator.stream.since(number, room)[0].batch
        self._blocks.extend(block, self._encode(number, batch.take(slice(0, room))))
        return block

    def _encode(self, first: int, batch: SampleBatch) -> list[bytes]:
        """The messages of the samples ``first`` …, at least one, as many as are sent in one go."""
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
            # The stream is gone, its last samples still go out; what they meant is gone with it.
            return [""] * len(batch)


@dataclass(slots=True)
class Start:
    """Where a cursor begins: the next sample's number, and what to say first about a loss.

    ``seen`` is the number of the newest sample there was then: whoever sends it, waits until what
    was done by then is kept.
    """

    number: int
    opening: bytes = b""
    seen: int = 0


def _is_shown(feed: Feed, switch: Rematch) -> bool:
    shown = feed.shown
    return shown is None or (shown.switched is not None and switch.time <= shown.switched)


class Cursor:
    """How far one client has got in one stream; `Messages`, which it `take`s one after the other.

    Law (tests/laws): what is taken from a start on, cut anywhere and taken up again after the last
    whole sample, is every sample once and in order, and before what is not kept a ``gap``.
    """

    def __init__(
        self, feeds: Feeds, name: str, start: Start, switches: Sequence[Rematch] | None = None
    ) -> None:
        self.name = name
        self.number = start.number
        """The next sample's."""
        self.over: str | None = None
        self._feeds = feeds
        self._feed: Feed | None = None
        self._opening = start.opening
        self._seen = start.seen
        self._switches = switches
        self._marks = Marks((), 0)
        self._begins = start.number

    def join(self, client: EventClient) -> None:
        """``client`` is to be woken when there is something. Raises `UnknownStream`."""
        feed = self._feed = self._feeds.join(self.name, self._seen, client)
        if self._switches is not None:
            feed.switches = self._switches
            # Not a method of this: in a circle it would stay when its client has gone.
            self._marks = Marks(self._switches, self._begins - 1, partial(_is_shown, feed))

    def leave(self, client: EventClient) -> None:
        """It is not there any more."""
        if self._feed is not None:
            self._feeds.leave(self._feed, client)

    def take(self) -> bytes | None:
        """What comes next; None while there is nothing. Contract: after `join`."""
        feed, number = self._feed, self.number
        assert feed is not None
        if self._opening:
            opening, self._opening = self._opening, b""
            return opening
        switch = next(self._marks.before(number), None)
        if switch is not None:
            return message("rematched", RematchModel.of(switch).model_dump())
        oldest = feed.oldest
        if number < oldest:
            self.number = oldest
            return _gap(feed.name, number, oldest - 1)
        newest = feed.newest
        if number <= newest:
            mark = self._marks.next
            until = newest if mark is None else min(newest, mark)
            last, data = feed.messages(number, until)
            self.number = last + 1
            self.over = None  # it may have ended and gone on since
            return data
        if self.over is None and feed.over is not None:
            self.over = feed.over
            end = {"stream": feed.name, "sequence": number - 1, "reason": self.over}
            if self.over == "failed":
                end["failure"] = feed.failure
            return message("end", end)
        return None


class Feeds:
    """All streams that clients listen to."""

    def __init__(
        self,
        engine: Engine,
        cache_limit: int,
        clients: EventClients,
        is_kept: Callable[[], bool] | None = None,
    ) -> None:
        """``is_kept`` says whether all that was done is kept, of an engine that is recorded."""
        self.all = clients
        """All clients, whatever they listen to."""
        self._engine = engine
        self._cache = MessageCache(cache_limit)
        self._feeds: dict[str, Feed] = {}
        self._is_kept = is_kept
        self._failures = 0
        """So many failures the feeds have looked for."""
        self._unseen: dict[Feed, None] | None = None if is_kept is None else {}

    @property
    def epoch(self) -> str:
        """The life of the service that ids speak of."""
        return self._engine.epoch

    @property
    def clients(self) -> int:
        """How many clients listen."""
        return len(self.all)

    def start(self, name: str, since: str | None) -> Start:
        """Where a client begins: now, at the ``start`` of what is kept, at a time or a duration
        before the newest sample (`Moment`), or after an id.

        Raises `UnknownStream`, `Forgotten`, or a 400 `Problem` for a text that is none of these.
        """
        stream = self._engine.generator(name).stream
        if since is None:
            return Start(self._newest(name) + 1, seen=stream.last_number)
        if since == "start":
            return Start(stream.first_number, seen=stream.last_number)
        moment = Moment.parse(since)
        if moment is not None:
            return Start(past_queries.number_since(stream, moment), seen=stream.last_number)
        epoch, _, digits = since.rpartition("-")
        if not 0 < len(epoch) <= LONGEST_EPOCH or not is_number(digits):
            raise bad_id(since)
        return self.after(name, epoch, int(digits))

    def after(self, name: str, epoch: str, number: int) -> Start:
        """Where a client begins that has had sample ``number`` of the life ``epoch``.

        Raises `UnknownStream`.
        """
        number += 1
        # Not what is shown: a client may have seen more than one that has just come.
        last = self._engine.generator(name).stream.last_number
        if epoch == self._engine.epoch and number <= last + 1:
            return Start(number, seen=last)
        if epoch != self._engine.epoch:
            reason = "the service has begun anew since: numbers count from 1 again"
        else:
            reason = "the stream has begun anew since: numbers count from 1 again"
        lost = {"stream": name, "from": number, "to": None, "epoch": epoch, "reason": reason}
        return Start(1, message("gap", lost), seen=last)

    def join(self, name: str, seen: int, client: EventClient) -> Feed:
        """``client`` listens to a stream, of which all up to sample ``seen`` is kept. Raises
        `UnknownStream`."""
        generator = self._engine.generator(name)
        # A stream may have several names; all who follow it are woken together.
        feed = self._feeds.get(generator.name)
        if feed is None or feed.generator is not generator:
            feed = Feed(self._engine, generator, self._cache, self.all, self._unseen)
            if self._is_kept is not None and self._unseen is not None:
                feed.shown = feed.look_now()
                if not self._is_kept():
                    # The next mark shows what has come since the client looked where to begin.
                    feed.shown = Shown(seen, False, None)
                    self._unseen[feed] = None
            generator.listen(feed)
            self._feeds[generator.name] = feed
        feed.clients[client] = None
        return feed

    def leave(self, feed: Feed, client: EventClient) -> None:
        """It does so no longer."""
        del feed.clients[client]
        if feed.clients:
            return
        feed.close()
        if self._feeds.get(feed.name) is feed:
            del self._feeds[feed.name]

    def review(self) -> None:
        """Wake the clients of streams that were removed, have failed or switched. Called at each
        tick."""
        failures, self._failures = self._failures, self._engine.failures
        for feed in tuple(self._feeds.values()):
            if not self._is_removed(feed):
                feed.look(failures=self._failures != failures)
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
        """Let all clients go: the service stops. They resume when it is back."""
        self.all.close()

    # -- what is kept (`Audience`) -----------------------------------------------------------

    @property
    def has_news(self) -> bool:
        """Whether there is more to be seen than is shown."""
        return bool(self._unseen)

    def mark(self) -> Sequence[tuple[Feed, Shown]]:
        """What there is to be seen of what has changed since the last mark."""
        assert self._unseen is not None
        marked = [(feed, feed.look_now()) for feed in self._unseen]
        self._unseen.clear()
        return marked

    def show(self, mark: Sequence[tuple[Feed, Shown]]) -> None:
        """Let clients see it: it is kept."""
        for feed, shown in mark:
            # A stream that is removed ends before: its clients are told the one reason.
            feed.is_removed = feed.is_removed or self._is_removed(feed)
            feed.show(shown)

    def keep_unseen(self, mark: Sequence[tuple[Feed, Shown]]) -> None:
        """It is not kept yet: it is for the next mark."""
        assert self._unseen is not None
        self._unseen.update((feed, None) for feed, _ in mark)

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
    """The response that is a stream's events, with ``switches`` between them if it is an adaptive
    subscription's; ``Last-Event-ID`` goes before ``since``. Clients of one ``key`` are counted
    together (`EventClients.admit`)."""
    accepted(request, [EVENT_STREAM])
    start = feeds.start(name, request.headers.get("last-event-id") or since)
    position = f"{feeds.epoch}-{start.number - 1}"
    return respond(feeds, request, key, Cursor(feeds, name, start, switches), position)


def respond(
    feeds: Feeds, request: Request, key: str, messages: Messages, position: str
) -> Response:
    """The response that sends ``messages`` after the id ``position``. Raises `Problem` 429 and 503
    when there is no place."""
    headers = {POSITION: position}
    if request.scope.get(HEAD):
        return Response(headers=headers, media_type=EVENT_STREAM)
    client = feeds.all.admit(key, request.scope.get(CALLER))
    return EventStream(feeds.all, client, messages, headers)


def message(event: str, data: dict[str, object]) -> bytes:
    """A message that is no sample: it has no id, a client that resumes does so after a sample."""
    return b"event: %s\ndata: %s\n\n" % (event.encode(), msgspec.json.encode(data))


def is_number(digits: str) -> bool:
    """Whether it is the number of a sample, or 0."""
    return digits.isascii() and digits.isdigit() and len(digits) <= 18


def bad_id(since: str) -> Problem:
    """The refusal of what is no id."""
    return Problem(
        400,
        "bad event id",
        f"{since!r} is no id of a sample",
        hint="send the id of the last message, or since=start, a time or a duration such as 30s",
    )


def _gap(name: str, first: int, last: int) -> bytes:
    reason = "these samples are no longer kept"
    return message("gap", {"stream": name, "from": first, "to": last, "reason": reason})
