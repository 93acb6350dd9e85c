"""When samples arrive, by the clock of the engine, and when a stream is silent (SPEC §7).

A stream is *silent* if nothing has arrived for five times the usual gap between arrivals, and for
at least a second. A subscription may declare a staleness instead, for example for a stream of
bursts with normal pauses between them.
"""

from __future__ import annotations

from ...streams.time import SECOND

MIN_GAPS = 5
"""The number of gaps from which the usual gap is known well enough."""
PATIENCE = 5.0
"""A stream is silent after this multiple of its usual gap."""
MIN_SILENCE = SECOND
"""The shortest silence (ns)."""
_WEIGHT = 0.2
"""The weight of the newest gap in the exponentially weighted mean."""


class Arrivals:
    """The arrivals of one stream. An arrival is a batch. Cost: O(1) an arrival. Memory: four
    numbers.

    ``last`` is the time (ns) of the latest arrival; before the first, the time of the start.
    ``gap`` is the usual time between two arrivals, from ``count`` gaps.
    """

    __slots__ = ("count", "gap", "has_arrived", "last")

    def __init__(self, now: int) -> None:
        self.last = now
        self.has_arrived = False
        self.count = 0
        self.gap = 0.0

    def add(self, now: int) -> None:
        """Add an arrival. Arrivals at the same time count as one."""
        gap = now - self.last
        if not self.has_arrived:
            # The time until the first arrival is not a gap between two.
            self.has_arrived = True
            self.last = max(self.last, now)
        elif gap > 0:
            self.count += 1
            self.gap = float(gap) if self.count == 1 else self.gap + _WEIGHT * (gap - self.gap)
            self.last = now

    @property
    def patience(self) -> int | None:
        """The time (ns) without arrivals after which the stream is silent; None: not known yet."""
        if self.count < MIN_GAPS:
            return None
        return max(MIN_SILENCE, int(PATIENCE * self.gap))

    def silent_at(self, declared: int | None = None) -> int | None:
        """Return the time (ns) from which the stream is silent if nothing arrives; None: not known.

        ``declared``: the time (ns) after which it is silent, instead of the usual gaps.
        """
        patience = self.patience if declared is None else declared
        return None if patience is None else self.last + patience
