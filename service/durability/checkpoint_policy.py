"""When a checkpoint is written: after some time, some bytes of the log, or some work."""

from __future__ import annotations

from typing import Final

from ..config.settings import Settings

_SHARE: Final = 20
"""A checkpoint for so many times the time that it takes, of this process or of a copy."""
_AGAIN: Final = 10.0
"""Seconds after a checkpoint that failed until the next one is tried: each try costs as much as
one that succeeds."""


class CheckpointTimes:
    """Of one log. Moments (s) are of the event loop's clock; ``written`` is the log's bytes."""

    def __init__(self) -> None:
        self.worked = 0.0
        """Seconds of work since the last checkpoint: about as long a start would take."""
        self._written = 0
        """Bytes of the log that the last one has."""
        self._taken = 0
        """And those of one that is on its way."""
        self._spared = 0.0
        """Seconds of work that it spares a start."""
        self._cost = 0.0
        """Seconds that the last one took."""
        self._begun: float | None = None
        self._not_before = float("-inf")

    def is_due(self, now: float, written: int, settings: Settings) -> bool:
        """Whether one is to be written now; the next one is not before it is time again."""
        if self._begun is None:
            self._begun = now
        new = written - self._written
        is_due = (
            (now - self._begun >= settings.checkpoint_interval and new > 0)
            or new >= settings.checkpoint_bytes
            or self.worked >= max(settings.checkpoint_work, _SHARE * self._cost)
        )
        if is_due and now >= self._not_before:
            self._begun = now
            return True
        return False

    def taken(self, written: int) -> None:
        """What there is was taken, of a log that has ``written`` bytes, and will be kept: work
        counts from here."""
        self._taken = written
        self.worked, self._spared = 0.0, self.worked

    def kept(self, cost: float) -> None:
        """It is kept, and took ``cost`` s. What came meanwhile is not in it."""
        self._written, self._spared, self._cost = self._taken, 0.0, cost

    def failed(self, now: float) -> None:
        """It could not be made, or not be kept: a start has all of the work to do."""
        self.worked += self._spared
        self._spared = 0.0
        self._not_before = now + _AGAIN
