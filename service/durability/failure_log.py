"""Logs repeated failures once, and the recovery once it has lasted.

A full disk accepts a small write now and then, so one success does not prove a recovery.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field

from ..config.logs import log

QUIET_PERIOD = 10.0
"""Seconds without a failure that prove a recovery."""
MOST_REASONS = 16
"""The greatest number of logged reasons of one failure: each may name another object."""


@dataclass(slots=True)
class _Failure:
    """``last``: the moment of the last failure, s; ``reasons``: the logged ones."""

    last: float
    works: bool = False
    reasons: set[str] = field(default_factory=set)


class FailureLog:
    """The failures of the last `QUIET_PERIOD` seconds of ``clock``."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._failures: dict[str, _Failure] = {}

    def report(self, part: str, reason: str) -> None:
        """Log that ``part`` failed: each of the first `MOST_REASONS` reasons once."""
        failure = self._failures.setdefault(part, _Failure(0.0))
        failure.last, failure.works = self._clock(), False
        if reason not in failure.reasons and len(failure.reasons) < MOST_REASONS:
            failure.reasons.add(reason)
            log().error(f"{part} failed", reason=reason)

    def report_success(self, part: str) -> None:
        """Note a success of ``part``; `review` logs the recovery if no failure follows."""
        failure = self._failures.get(part)
        if failure is not None:
            failure.works = True

    def review(self) -> None:
        """Log recoveries. `CommandQueue.maintain` calls this."""
        if not self._failures:
            return
        now = self._clock()
        for part, failure in list(self._failures.items()):
            if failure.works and now - failure.last >= QUIET_PERIOD:
                del self._failures[part]
                log().warning(f"{part} works again")
