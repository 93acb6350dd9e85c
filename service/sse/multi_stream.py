"""Several streams on one connection, with one id to resume all (docs/reference/streams.md).

Each stream has its own cursor. The id of a sample's message has the client's position in each
stream: ``<epoch>-<name>:<position>.<name>:<position>…``, with a digest of each name. So a client
resumes with more streams, or with fewer. The id is opaque to clients.

Ids of earlier versions are still accepted: ``<epoch>-<names>-<position>.<position>…``, with one
digest of all names, and the positions in their order.
"""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache

from fastapi import Request
from fastapi.responses import Response

from ...engine.model.errors import UnknownStream
from ...streams.past_queries import Moment
from ..config.media_types import EVENT_STREAM
from ..http.negotiation import accepted
from ..http.problems import Problem
from .clients import EventClient
from .cursor import Cursor, message
from .delivery import Delivery
from .feeds import Feeds, bad_id, cursor_of, is_number, respond

MOST_STREAMS = 50
"""On one connection: each message has an id, which takes up to 27 bytes for each stream."""
_END = b"\n\n"


@dataclass(frozen=True, slots=True)
class Position:
    """A client's position in each stream: the number of its last sample."""

    epoch: str
    numbers: dict[str, int] = field(default_factory=dict)

    def __str__(self) -> str:
        numbers = ".".join(f"{_tag(name)}:{n}" for name, n in sorted(self.numbers.items()))
        return f"{self.epoch}-{numbers}"

    @classmethod
    def parse(cls, text: str, names: Sequence[str]) -> Position:
        """Parse an id, and keep the positions in those of the streams ``names`` that it has. Raises
        a 400 `Problem` for a malformed id, or if it has none of these streams."""
        epoch, _, rest = text.rpartition("-")
        pairs = [pair.partition(":") for pair in rest.split(".")]
        if not all(is_number(number) for *_, number in pairs):
            return cls._parse_earlier(text, names)
        numbers = {tag: int(number) for tag, _, number in pairs}
        found = {name: numbers[tag] for name in names if (tag := _tag(name)) in numbers}
        if not epoch:
            raise bad_id(text)
        if not found:
            raise _of_others(text, names)
        return cls(epoch, found)

    @classmethod
    def _parse_earlier(cls, text: str, names: Sequence[str]) -> Position:
        """Parse an id of an earlier version, which is of the streams ``names`` and no others."""
        parts = text.rsplit("-", 2)
        digits = parts[-1].split(".")
        if len(parts) != 3 or not parts[0] or not all(is_number(each) for each in digits):
            raise bad_id(text)
        names = sorted(names)
        if parts[1] != _digest(names) or len(digits) != len(names):
            raise _of_others(text, names)
        return cls(parts[0], dict(zip(names, map(int, digits), strict=True)))


class MultiCursor:
    """The messages of several streams for one client: pieces of the streams in turn.

    The others go on when a stream ends; the response ends when all have ended or were removed.
    ``removed`` has the client's positions in streams that were removed since it got its id.

    Law (tests/laws): each stream's messages are those of a `Cursor`; after any id, all streams
    resume at their positions. Cost: O(streams) for each `take`, and O(streams) bytes per message.
    """

    def __init__(self, epoch: str, cursors: Sequence[Cursor], removed: dict[str, int]) -> None:
        self._epoch = epoch
        self._numbers = removed | {cursor.name: cursor.number - 1 for cursor in cursors}
        self._cursors = list(cursors)
        self._turn = 0
        self._opening = b"".join(
            message("end", {"stream": name, "sequence": number, "reason": "removed"})
            for name, number in removed.items()
        )

    @property
    def position(self) -> Position:
        """The client's position after the messages that `take` has returned."""
        return Position(self._epoch, dict(self._numbers))

    @property
    def end_reason(self) -> str | None:
        """The reason why no messages follow; None while some may follow."""
        reasons = [cursor.end_reason for cursor in self._cursors]
        if None in reasons:
            return None
        return next(one for one in ("failed", "ended", "removed") if one in reasons)

    @property
    def delay(self) -> float | None:
        """See `Messages.delay`."""
        delays = [cursor.delay for cursor in self._cursors if cursor.delay is not None]
        return min(delays, default=None)

    def join(self, client: EventClient) -> None:
        """Wake ``client`` when there are new messages."""
        for cursor in self._cursors:
            cursor.join(client)

    def leave(self, client: EventClient) -> None:
        """Wake ``client`` no more."""
        for cursor in self._cursors:
            cursor.leave(client)

    def take(self) -> bytes | None:
        """Return the next messages, of the stream whose turn it is; None while there are none."""
        if self._opening:
            opening, self._opening = self._opening, b""
            return opening
        for _ in self._cursors:
            cursor = self._cursors[self._turn]
            self._turn = (self._turn + 1) % len(self._cursors)
            data = cursor.take()
            if data is not None:
                return self._with_ids(cursor, data)
        return None

    def _with_ids(self, cursor: Cursor, data: bytes) -> bytes:
        """Replace the id of each sample by the position in all streams up to this sample."""
        messages = []
        for text in data.split(_END)[:-1]:
            if text.startswith(b"id: "):
                own, _, rest = text.partition(b"\n")
                self._numbers[cursor.name] = int(own.rpartition(b"-")[2])
                text = b"id: %b\n%b" % (str(self.position).encode(), rest)
            messages.append(text)
        # A gap moves the position, too, and brings no sample.
        self._numbers[cursor.name] = cursor.number - 1
        return _END.join(messages) + _END


def follow_many(
    feeds: Feeds, request: Request, key: str, names: Sequence[str], delivery: Delivery
) -> Response:
    """Return the response that sends the events of all streams ``names`` (cf. `event_stream`).

    Raises `UnknownStream`, unless the client had the stream and it was removed since.
    """
    accepted(request, [EVENT_STREAM])
    id = request.headers.get("last-event-id")
    if id:
        delivery = replace(delivery, since=id, last=None)
    opened = open_cursor(feeds, names, delivery)
    return respond(feeds, request, key, opened, str(opened.position))


def open_cursor(feeds: Feeds, names: Sequence[str], delivery: Delivery) -> MultiCursor:
    """Return the cursor of a client in the streams ``names``: from now on, from the ``start`` of
    the histories, from a `Moment`, after an id, or with the newest samples of each. Streams that
    the id does not have begin now. Raises
    `UnknownStream`, `Forgotten`, and a 400 `Problem` for a malformed id or one of other streams."""
    names = sorted(set(names))
    since = delivery.since
    if delivery.last is not None:
        starts = {name: feeds.start_of_last(name, delivery.last) for name in names}
    elif since is None or since == "start" or Moment.parse(since) is not None:
        starts = {name: feeds.start(name, since) for name in names}
    else:
        return _after(feeds, Position.parse(since, names), names, delivery)
    cursors = [cursor_of(feeds, name, start, delivery) for name, start in starts.items()]
    return MultiCursor(feeds.epoch, cursors, {})


def _after(
    feeds: Feeds, position: Position, names: Sequence[str], delivery: Delivery
) -> MultiCursor:
    cursors, removed = [], {}
    for name in names:
        number = position.numbers.get(name)
        try:
            if number is None:
                start = feeds.start(name, None)
            else:
                start = feeds.after(name, position.epoch, number)
            cursors.append(cursor_of(feeds, name, start, delivery))
        except UnknownStream:
            if number is None or position.epoch != feeds.epoch:
                raise  # in this epoch the stream may not exist yet, so it may not have been removed
            removed[name] = number
    return MultiCursor(feeds.epoch, cursors, removed)


def _of_others(text: str, names: Sequence[str]) -> Problem:
    return Problem(
        400,
        "bad event id",
        f"{text!r} is an id of other streams than {', '.join(names)}",
        hint="resume with a stream of the id, or begin anew without an id",
    )


@lru_cache(maxsize=1000)
def _tag(name: str) -> str:
    """Return the digest of a name: two of fifty have the same one in a billion cases."""
    digest = hashlib.blake2b(name.encode(), digest_size=5).digest()
    return base64.b64encode(digest, altchars=b"_~").decode().rstrip("=")


def _digest(names: Sequence[str]) -> str:
    return hashlib.blake2b("\n".join(names).encode(), digest_size=4).hexdigest()
