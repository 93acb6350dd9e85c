"""When samples come, by the clock of the engine: which streams have fallen silent (SPEC §7).

A stream is *silent* that has not spoken for much longer than usual: five times the usual gap
between what comes, at least a second. Whoever knows better declares it, as of a stream whose
bursts come one by one and whose pauses between them are no news.
"""

from __future__ import annotations

from ...streams.time import SECOND

LEARNED_FROM = 5
"""So many gaps must have been seen before anything is said of a stream."""
PATIENCE = 5.0
"""A stream is silent after so many times its usual gap."""
LEAST = SECOND
"""And never before so long (ns)."""
_WEIGHT = 0.2
"""Of the newest gap in the usual one: an exponentially weighted mean."""


class Arrivals:
    """The arrivals of one stream. Cost: O(1) an arrival, which is a batch. Memory: four numbers.

    ``last`` is the time (ns) of the latest one, of the beginning before there is any; ``gap`` the
    usual time between two, of which ``count`` have been seen.
    """

    __slots__ = ("count", "gap", "has_spoken", "last")

    def __init__(self, now: int) -> None:
        self.last = now
        self.has_spoken = False
        self.count = 0
        self.gap = 0.0

    def came(self, now: int) -> None:
        """Something has come. What comes at the same moment is one arrival."""
        gap = now - self.last
        if not self.has_spoken:
            # How long the first one was waited for says nothing of how often they come.
            self.has_spoken = True
            self.last = max(self.last, now)
        elif gap > 0:
            self.count += 1
            self.gap = float(gap) if self.count == 1 else self.gap + _WEIGHT * (gap - self.gap)
            self.last = now

    @property
    def patience(self) -> int | None:
        """After how long (ns) without a sample the stream is silent; None: nobody knows yet."""
        if self.count < LEARNED_FROM:
            return None
        return max(LEAST, int(PATIENCE * self.gap))

    def silent_at(self, declared: int | None = None) -> int | None:
        """From when on (ns) the stream is silent if nothing comes; None: nobody knows.

        ``declared`` is how long (ns) it may be silent at most, whatever it did before.
        """
        patience = self.patience if declared is None else declared
        return None if patience is None else self.last + patience
