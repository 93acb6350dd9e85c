"""What the log tells of things that fail again and again: once that they fail, and once that they
work again, when they have for a while. A disk that is full takes little writes now and then."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field

from ..config.logs import log

CALM = 10.0
"""Seconds without a failure after which something works again."""
MOST_REASONS = 16
"""So many reasons of one failure are told: they may name what is never the same."""


@dataclass(slots=True)
class _Failure:
    """``last``: when it failed last, s; ``reasons``: those that are told."""

    last: float
    works: bool = False
    reasons: set[str] = field(default_factory=set)


class Failures:
    """What fails at present, or has within the last `CALM` seconds of ``clock``."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._failures: dict[str, _Failure] = {}

    def failed(self, what: str, reason: str) -> None:
        """``what`` has failed: each reason is told once, the first `MOST_REASONS`."""
        found = self._failures.setdefault(what, _Failure(0.0))
        found.last, found.works = self._clock(), False
        if reason not in found.reasons and len(found.reasons) < MOST_REASONS:
            found.reasons.add(reason)
            log().error(f"{what} failed", reason=reason)

    def worked(self, what: str) -> None:
        """``what`` has worked: if it goes on, `review` tells it."""
        found = self._failures.get(what)
        if found is not None:
            found.works = True

    def review(self) -> None:
        """Tell what works again. Called now and then."""
        if not self._failures:
            return
        now = self._clock()
        for what, found in list(self._failures.items()):
            if found.works and now - found.last >= CALM:
                del self._failures[what]
                log().warning(f"{what} works again")
