"""What sources read from the world outside, so that it can be given again.

All else that an engine does follows from its commands; what a user-written source says does not. So
it is written down with the tick that asked for it, and a tick that is done again asks the tape.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence

import msgspec

from .reports import Report


class Reading(msgspec.Struct, frozen=True, omit_defaults=True):
    """What ``source`` said at ``time`` (ns): a sample ``(available, valid, values)`` or none, and
    what it reported of its stream; or the text of its ``error``."""

    source: str
    time: int
    sample: tuple[int, int, dict[str, float | int | bool | str | None]] | None = None
    quality: float | None = None
    contains: str | None = None
    error: str | None = None

    @property
    def report(self) -> Report | None:
        """What it reported."""
        if self.quality is None and self.contains is None:
            return None
        return Report(None, self.quality, self.contains)


class Tape:
    """Records readings, or gives them again: `is_playing`."""

    def __init__(self) -> None:
        self._made: list[Reading] = []
        self._kept: deque[Reading] = deque()
        self._turn = 0
        self.is_playing = False

    def record(self) -> None:
        """From now on sources are read."""
        self._turn += 1
        self._made = []

    def taken(self) -> tuple[Reading, ...]:
        """What was read since `record`. What comes later, of a source that was given up, is not
        for this tape."""
        self._turn += 1
        return tuple(self._made)

    def play(self, readings: Sequence[Reading]) -> None:
        """What sources will say."""
        self._kept = deque(readings)

    def ask(self, source: str, time: int, read: Callable[[], Reading]) -> Reading:
        """What ``source`` says at ``time``: what `read` gives, or what that was."""
        if not self.is_playing:
            turn = self._turn
            reading = read()
            if turn == self._turn:
                self._made.append(reading)
            return reading
        if self._kept and (self._kept[0].source, self._kept[0].time) == (source, time):
            return self._kept.popleft()
        return Reading(source, time, error="UnitBlocked: it did not come back in time")
