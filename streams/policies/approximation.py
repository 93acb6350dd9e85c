"""``use most recent``: the samples of a grid, made from the most recent ones ([DyKnow10 Def. 5.35],
the function *extend*)."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from ..most_recent import rows_in_use
from ..sample import SampleBatch
from ..time import TIME_MAX, TIME_MIN
from ..time_arithmetic import earlier, since
from .adaptation import CODES, KEPT, Adaptation, OnDrop, joined
from .policy import GRID_LIMIT, Constraint, Policy, PolicyError

CHUNK: Final = 65_536
"""The greatest number of grid samples made at a time."""


class Approximating(Adaptation):
    """Makes a sample at b, b + s, b + 2s … e, each available d after its valid time, with the
    values of ``most_recent_at(f, v, v + d)``.

    The grid begins where there is a most recent sample (no_sample is never part of a stream). At
    the end of the input it goes on to e, or with ``to oo`` until it has used the last sample.

    Each sample may be the most recent one, so none is dropped but those that could come into use
    only after the last of the grid (duration; available time where that is the end of time).
    ``kept`` counts those in use by now or passed by, ``pending`` those that are not in use yet.

    Cost: O(n + grid) numpy where valid times do not decrease, else O(n log n + grid). Memory: the
    most recent sample and those not in use yet. Raises `PolicyError` for more than ``limit``
    samples at once.
    """

    def __init__(
        self, policy: Policy, on_drop: OnDrop | None = None, *, limit: int = GRID_LIMIT
    ) -> None:
        super().__init__(policy, on_drop)
        assert policy.period is not None
        assert policy.max_delay is not None
        assert policy.duration.start is not None
        self._start = policy.duration.start
        self._period = policy.period
        self._delay = policy.max_delay
        self._limit = limit
        # No sample of the grid can be available after the end of 64-bit time.
        end = min(policy.duration.last, TIME_MAX - self._delay)
        self._final = (end - self._start) // self._period
        self._last = self._start + self._final * self._period
        self._next = 0
        self._goes_to_the_end = not policy.duration.to_oo
        self._best: SampleBatch | None = None
        self._waiting: SampleBatch | None = None

    def push(self, batch: SampleBatch) -> list[SampleBatch]:
        self.counters.received += len(batch)
        if not len(batch):
            return []
        last = int(batch.available[-1])
        batch = self._usable(batch, last)
        return self._make_until(self._last_decided(last - 1), batch)

    def advance(self, watermark: int) -> list[SampleBatch]:
        if watermark == TIME_MIN:
            return []
        return self._make_until(self._last_decided(watermark - 1))

    def end(self) -> list[SampleBatch]:
        if self._goes_to_the_end:
            return self._make_until(self._final)
        if self._waiting is None:
            return []
        return self._make_until(min(int(self._begins(self._waiting).max()), self._final))

    def _usable(self, batch: SampleBatch, known: int) -> SampleBatch:
        """The samples that a grid sample may use: the others come into use after the grid's end."""
        last = self._last
        if self._final < 0:
            usable = np.zeros(len(batch), np.bool_)
        elif known <= last + self._delay and np.maximum.reduce(batch.valid) <= last:
            return batch
        else:
            usable = (batch.available <= last + self._delay) & (batch.valid <= last)
        # A sample that is too new for the grid shows that the grid is needed up to its end.
        self._goes_to_the_end = True
        why = Constraint.AVAILABLE if self.policy.duration.to_oo else Constraint.DURATION
        reasons = np.where(usable, KEPT, CODES[why]).astype(np.int8)
        self._drop(batch, reasons, batch.available)
        return batch.take(usable)

    def _last_decided(self, known: int) -> int:
        """The number of the last sample of the grid that is available by ``known``."""
        return min((known - self._delay - self._start) // self._period, self._final)

    def _begins(self, batch: SampleBatch) -> NDArray[np.uint64]:
        """The number of the first grid sample that may use each sample: by then it is valid and
        available."""
        time = np.maximum(batch.valid, earlier(batch.available, self._delay))
        distance = since(np.maximum(time, self._start), self._start)
        period = np.uint64(self._period)
        # numpy divides by one number fast, but has no fast remainder.
        begins: NDArray[np.uint64] = distance // period
        begins += begins * period != distance
        return begins

    def _make_until(self, last: int, new: SampleBatch | None = None) -> list[SampleBatch]:
        """Make the samples of the grid up to number ``last``; ``new`` has come."""
        waiting = [part for part in (self._waiting, new) if part is not None and len(part)]
        if last < self._next:
            self._waiting = joined(waiting) if waiting else None
            self.counters.pending = 0 if self._waiting is None else len(self._waiting)
            return []
        parts = waiting if self._best is None else [self._best, *waiting]
        first, self._next = self._next, last + 1
        if not parts:
            return []
        known = joined(parts)
        # The best sample may have come after one that still waits for its time.
        if len(known) > 1 and known.available[0] > known.available[1]:
            known = known.take(np.argsort(known.available, kind="stable"))
        begins = self._begins(known)
        if self._best is None:
            first = max(first, int(begins.min()))
        made: list[SampleBatch] = []
        if first <= last:
            if last - first >= self._limit:
                # The error loses no samples: they wait as before.
                self._next = first
                self._waiting = joined(waiting) if waiting else None
                raise PolicyError(
                    f"`sample every` would make {last - first + 1} samples at once",
                    "choose a longer period, or a `from` and `to` nearer to the data",
                )
            made = list(self._chunks(known, begins, first, last))
        still = np.flatnonzero(begins > np.uint64(last))
        self._waiting = known.take(still) if len(still) else None
        counters = self.counters
        counters.pending = len(still)
        counters.kept = counters.received - sum(counters.dropped.values()) - counters.pending
        return made

    def _chunks(
        self, known: SampleBatch, begins: NDArray[Any], first: int, last: int
    ) -> Iterator[SampleBatch]:
        for low in range(first, last + 1, CHUNK):
            high = min(low + CHUNK - 1, last)
            numbers = np.arange(high - low + 1, dtype=np.uint64) + np.uint64(low)
            rows = rows_in_use(known.available, known.valid, begins, numbers)
            steps = np.arange(high - low + 1) * self._period
            valid = steps + (self._start + low * self._period)
            self._best = known.take(rows[-1:])
            chosen = known.take(rows)
            exact = chosen.valid == valid
            self.counters.approximated += int(np.count_nonzero(~exact))
            available = valid + self._delay
            delayed = int(np.count_nonzero(exact & (available > chosen.available)))
            yield from self._sent(SampleBatch(available, valid, chosen.columns), delayed)
