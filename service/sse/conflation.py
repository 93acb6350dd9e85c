"""Conflation: of each object the newest sample, at most once in an interval."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import inf
from typing import Final

import numpy as np

from ...engine.requests.adaptive_subscription import Rematch
from ...streams.time import SECOND
from .cursor import Cursor, Joining, Start
from .delivery import Projection
from .feed import Feed

PIECE_MESSAGES: Final = 64
"""The greatest number of messages in a piece. Those beyond `message_cache.PIECE_BYTES` are encoded
again for the next one."""


class ConflatedCursor(Cursor):
    """Sends of each object the newest sample at most once in ``every`` ns: *conflation*.

    A *round* takes all samples since the last round. It sends the newest one of each object, in the
    order of their numbers, with the ``count`` of the object's samples in the round. A round begins
    as soon as there are samples, and ``every`` after the last round began. A switch between the
    samples of a round cuts it in two.

    Law (tests/laws): the messages are those of the definition. Cut anywhere and resumed after the
    last complete message, the client gets no sample twice, and of each object the newest or a
    ``gap``: all messages of a round before the cut have lower numbers than those after it. The
    counts then begin after that message. Cost: O(samples) numpy for a round, and the encoding of
    its messages, for each client. Memory: two numbers for each object of an unsent round.

    ``clock`` returns seconds.
    """

    def __init__(
        self,
        feeds: Joining,
        name: str,
        start: Start,
        switches: Sequence[Rematch] | None,
        projection: Projection,
        every: int,
        clock: Callable[[], float],
    ) -> None:
        super().__init__(feeds, name, start, switches, projection)
        self._every = every / SECOND
        self._clock = clock
        self._next_round = -inf
        """When the next round may begin."""
        self._round_end = 0
        """The number of the last sample of the round."""
        self._part_end = 0
        """The number of the last sample of the part of the round whose newest samples are known."""
        self._numbers = self._counts = np.empty(0, np.int64)
        """Those of them that are not sent yet."""

    def until(self, newest: int) -> int:
        """See `Cursor.until`."""
        if self.number > self._round_end:
            now = self._clock()
            if now < self._next_round:
                self.delay = self._next_round - now
                return self.number - 1
            self._round_end = newest
            self._next_round = now + self._every
        return self._round_end

    def piece(self, feed: Feed, number: int, until: int) -> tuple[int, bytes]:
        """The messages of the round's next samples, at most a piece."""
        if self._part_end != until:
            self._part_end = until
            self._numbers, self._counts = feed.newest_of_each(number, until)
        # Retention may have evicted some since the round began: a gap has said so.
        first = int(self._numbers.searchsorted(number))
        part = slice(first, first + PIECE_MESSAGES)
        sent = feed.conflated(self._numbers[part], self._counts[part], self._projection)
        rest = first + len(sent)
        last = int(self._numbers[rest - 1])
        self._numbers, self._counts = self._numbers[rest:], self._counts[rest:]
        return last, b"".join(sent)
