"""Decides when a checkpoint is due: after some time, some bytes of the log, or some work."""

from __future__ import annotations

from typing import Final

from ..config.settings import Settings

_WORK_PER_COST: Final = 20
"""Work since the last checkpoint, as a multiple of that checkpoint's cost, before work alone makes
another one due. Checkpoints then take at most 5 % of the time."""
_RETRY_DELAY: Final = 10.0
"""Seconds from a failed checkpoint to the next try: a failed one costs as much as a good one."""


class CheckpointPolicy:
    """The policy for one log. Moments (s) are of the event loop's clock; ``written`` is the number
    of the log's bytes."""

    def __init__(self) -> None:
        self.work_seconds = 0.0
        """Seconds of work since the last snapshot. Replaying the log takes about as long."""
        self._checkpointed_bytes = 0
        """Bytes of the log that the last checkpoint covers."""
        self._snapshot_bytes = 0
        """Bytes of the log that the checkpoint under way covers."""
        self._snapshot_work = 0.0
        """Seconds of work that the checkpoint under way covers."""
        self._cost = 0.0
        """Seconds that the last checkpoint took."""
        self._last_due: float | None = None
        self._not_before = float("-inf")

    def is_due(self, now: float, written: int, settings: Settings) -> bool:
        """Whether to write a checkpoint now. True restarts the interval."""
        if self._last_due is None:
            self._last_due = now
        new = written - self._checkpointed_bytes
        is_due = (
            (now - self._last_due >= settings.checkpoint_interval and new > 0)
            or new >= settings.checkpoint_bytes
            or self.work_seconds >= max(settings.checkpoint_work, _WORK_PER_COST * self._cost)
        )
        if is_due and now >= self._not_before:
            self._last_due = now
            return True
        return False

    def snapshot_taken(self, written: int) -> None:
        """Count work from here: the checkpoint under way covers ``written`` bytes of the log."""
        self._snapshot_bytes = written
        self.work_seconds, self._snapshot_work = 0.0, self.work_seconds

    def checkpoint_written(self, cost: float) -> None:
        """The checkpoint under way is on disk, after ``cost`` s. It does not cover the commands
        since its snapshot."""
        self._checkpointed_bytes, self._snapshot_work = self._snapshot_bytes, 0.0
        self._cost = cost

    def checkpoint_failed(self, now: float) -> None:
        """Add the work of the failed checkpoint's snapshot back: a start must replay it."""
        self.work_seconds += self._snapshot_work
        self._snapshot_work = 0.0
        self._not_before = now + _RETRY_DELAY
