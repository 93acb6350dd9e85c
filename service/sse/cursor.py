"""The position of one client in one stream, and its messages from there on. Called by `feeds` and
`multi_stream`, whose clients they are."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Protocol

import msgspec

from ...engine.requests.adaptive_subscription import Rematch
from ..models import RematchModel
from .clients import EventClient
from .delivery import WHOLE, Projection
from .feed import Feed
from .switch_markers import SwitchMarkers


@dataclass(slots=True)
class Start:
    """The start of a cursor: the next sample's number, and an ``opening`` message about a loss.

    ``last`` is the number of the newest sample at that time. The route awaits a commit after it
    finds the start, so clients may see samples up to ``last``.
    """

    number: int
    opening: bytes = b""
    last: int = 0


class Joining(Protocol):
    """Where clients join and leave feeds (`Feeds`)."""

    def join(self, name: str, last: int, client: EventClient, projection: Projection) -> Feed: ...
    def leave(self, feed: Feed, client: EventClient) -> None: ...


def _is_visible(feed: Feed, switch: Rematch) -> bool:
    visible = feed.visible
    return visible is None or (visible.switched is not None and switch.time <= visible.switched)


class Cursor:
    """The position of one client in one stream, and its `Messages` from there on.

    Law (tests/laws): cut the messages of a cursor anywhere, and resume after the last complete
    sample. The client gets every sample once and in order, and a ``gap`` for evicted samples.
    """

    def __init__(
        self,
        feeds: Joining,
        name: str,
        start: Start,
        switches: Sequence[Rematch] | None = None,
        projection: Projection = WHOLE,
    ) -> None:
        self.name = name
        self.number = start.number
        """The next sample's number."""
        self.end_reason: str | None = None
        self.delay: float | None = None
        """See `Messages.delay`."""
        self._projection = projection
        self._feeds = feeds
        self._feed: Feed | None = None
        self._opening = start.opening
        self._last = start.last
        self._switches = switches
        self._markers = SwitchMarkers((), 0)
        self._start = start.number

    def join(self, client: EventClient) -> None:
        """Wake ``client`` when there are new messages. Raises `UnknownStream`."""
        feed = self._feed = self._feeds.join(self.name, self._last, client, self._projection)
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
        return feed.messages(number, until, self._projection)

    def until(self, newest: int) -> int:
        """Return the number of the last sample that may be sent now; ``newest`` is the newest one.
        Before the next one, it sets `delay`."""
        return newest

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
        self.delay = None
        if number <= newest:
            until = self.until(newest)
            if until < number:
                return None
            # A piece ends at the next switch, which is a message between two samples.
            mark = self._markers.next
            until = until if mark is None else min(until, mark)
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


def message(event: str, data: dict[str, object]) -> bytes:
    """Return a message that is no sample. It has no id, so clients resume after samples only."""
    return b"event: %s\ndata: %s\n\n" % (event.encode(), msgspec.json.encode(data))


def _gap(name: str, first: int, last: int) -> bytes:
    reason = "these samples are no longer kept"
    return message("gap", {"stream": name, "from": first, "to": last, "reason": reason})
