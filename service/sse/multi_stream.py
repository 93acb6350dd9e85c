"""Several streams on one connection, resumed by one id (docs/reference/streams.md).

Each stream has a cursor of its own; a sample's message gets an id that says how far the client has
got in all of them: ``<epoch>-<names>-<position>.<position>…``, the positions in the order of the
names, ``<names>`` a digest of these. To clients it is opaque.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field

from fastapi import Request
from fastapi.responses import Response

from ...engine.model.errors import UnknownStream
from ...streams.past_queries import Moment
from ..config.media_types import EVENT_STREAM
from ..http.negotiation import accepted
from ..http.problems import Problem
from .clients import EventClient
from .feeds import Cursor, Feeds, bad_id, is_number, message, respond

MOST_STREAMS = 50
"""On one connection: an id has at most 19 bytes a stream, and each message has one."""
_END = b"\n\n"


@dataclass(frozen=True, slots=True)
class Position:
    """How far a client has got: the number of the last sample it had, by stream."""

    epoch: str
    numbers: dict[str, int] = field(default_factory=dict)

    def __str__(self) -> str:
        names = sorted(self.numbers)
        numbers = ".".join(str(self.numbers[name]) for name in names)
        return f"{self.epoch}-{_digest(names)}-{numbers}"

    @classmethod
    def parse(cls, text: str, names: Sequence[str]) -> Position:
        """The position in the streams ``names``. Raises a 400 `Problem` for an id that is none, or
        one of other streams."""
        parts = text.rsplit("-", 2)
        digits = parts[-1].split(".")
        if len(parts) != 3 or not parts[0] or not all(is_number(each) for each in digits):
            raise bad_id(text)
        names = sorted(names)
        if parts[1] != _digest(names) or len(digits) != len(names):
            raise Problem(
                400,
                "bad event id",
                f"{text!r} is an id of other streams than {', '.join(names)}",
                hint="resume with the streams that the id is of, or begin anew without an id",
            )
        return cls(parts[0], dict(zip(names, map(int, digits), strict=True)))


class Followed:
    """The messages of several streams for one client, each stream's in order; they alternate.

    A stream that has ended leaves the others, and goes on when it does. All is over when all have
    ended or were removed. ``gone`` tells how far the client had got in streams that were removed
    since it had the id that it resumes with.

    Law (tests/laws): of each stream it is what a `Cursor` gives; after any id all go on where they
    were. Cost: O(streams) a look, and O(streams) bytes a message.
    """

    def __init__(self, epoch: str, cursors: Sequence[Cursor], gone: dict[str, int]) -> None:
        self._epoch = epoch
        self._numbers = gone | {cursor.name: cursor.number - 1 for cursor in cursors}
        self._cursors = list(cursors)
        self._turn = 0
        self._opening = b"".join(
            message("end", {"stream": name, "sequence": number, "reason": "removed"})
            for name, number in gone.items()
        )

    @property
    def position(self) -> Position:
        """How far the client has got with what was taken."""
        return Position(self._epoch, dict(self._numbers))

    @property
    def over(self) -> str | None:
        """Why nothing comes any more, of the streams that went last; None while something may."""
        reasons = [cursor.over for cursor in self._cursors]
        if None in reasons:
            return None
        return next(one for one in ("failed", "ended", "removed") if one in reasons)

    def join(self, client: EventClient) -> None:
        """``client`` is to be woken when there is something."""
        for cursor in self._cursors:
            cursor.join(client)

    def leave(self, client: EventClient) -> None:
        """It is not there any more."""
        for cursor in self._cursors:
            cursor.leave(client)

    def take(self) -> bytes | None:
        """What comes next: some messages of the stream whose turn it is."""
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
        """Each sample with an id of all streams: what came before it the client has, too."""
        messages = []
        for text in data.split(_END)[:-1]:
            if text.startswith(b"id: "):
                own, _, rest = text.partition(b"\n")
                self._numbers[cursor.name] = int(own.rpartition(b"-")[2])
                text = b"id: %b\n%b" % (str(self.position).encode(), rest)
            messages.append(text)
        self._numbers[cursor.name] = cursor.number - 1
        return _END.join(messages) + _END


def follow_many(
    feeds: Feeds, request: Request, key: str, names: Sequence[str], since: str | None
) -> Response:
    """The response that is the events of all streams ``names``; as `event_stream` for one.

    Raises `UnknownStream` where the client has not had it before.
    """
    accepted(request, [EVENT_STREAM])
    followed = begin(feeds, names, request.headers.get("last-event-id") or since)
    return respond(feeds, request, key, followed, str(followed.position))


def begin(feeds: Feeds, names: Sequence[str], since: str | None) -> Followed:
    """What a client gets of the streams ``names``: from now on, from the ``start`` of what is kept,
    from a `Moment`, or after an id. Raises `UnknownStream`, `Forgotten`, and a 400 `Problem` for an
    id that is none of theirs."""
    names = sorted(set(names))
    if since is None or since == "start" or Moment.parse(since) is not None:
        starts = {name: feeds.start(name, since) for name in names}
        cursors = [Cursor(feeds, name, start) for name, start in starts.items()]
        return Followed(feeds.epoch, cursors, {})
    had = Position.parse(since, names)
    cursors, gone = [], {}
    for name, number in had.numbers.items():
        try:
            cursors.append(Cursor(feeds, name, feeds.after(name, had.epoch, number)))
        except UnknownStream:
            if had.epoch != feeds.epoch:
                raise  # nobody knows whether it was removed, or is not there yet
            gone[name] = number
    return Followed(feeds.epoch, cursors, gone)


def _digest(names: Sequence[str]) -> str:
    return hashlib.blake2b("\n".join(names).encode(), digest_size=4).hexdigest()
