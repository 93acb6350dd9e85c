"""States at the times of a grid, ``sample every s`` (SPEC §1)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..input_queues import NOTHING_KNOWN
from ..policies.policy import Constraint, PolicyError, SynchronizationPolicy
from ..time import TIME_MAX
from ..time_arithmetic import later, since
from .states import CHUNK, NONE, InputSamples, LateRows, Made, OrderedStates, up_to


class GridStates(OrderedStates):
    """States at ``first + k * period``; see `Synchronization`. Memory: a few integers."""

    def __init__(self, policy: SynchronizationPolicy, limit: int) -> None:
        super().__init__(policy)
        assert policy.period is not None
        self._period, self._limit = policy.period, limit
        self._next = 0
        self._first: int | None = None
        self._total = 0
        self._news: dict[int, tuple[int, int]] = {}
        """Of each input the valid and the available time of the most recent sample."""
        if policy.duration.start is not None:
            self._begin(policy.duration.start)

    @property
    def floor(self) -> int:
        if self._first is None:
            return NOTHING_KNOWN
        return self._time(self._next) if self._next < self._total else TIME_MAX

    @property
    def pending(self) -> int:
        """Grid points up to the latest valid time seen that have not left."""
        newest = max((valid for valid, _ in self._news.values()), default=NOTHING_KNOWN)
        return max(0, self._index(newest) - self._next)

    def run(self, inputs: Sequence[InputSamples], until: int) -> tuple[list[Made], list[LateRows]]:
        before, delay = self._next, self._delay
        self._hear(inputs)
        bound = sure = 0 if delay is None else self._index(until - delay)
        bound = max(bound, self._reached(inputs))
        # Only a deadline is sure to pass: an input in any order may lack the state's own sample.
        if all(one.is_monotone for one in inputs):
            sure = bound
        if until >= TIME_MAX and delay is not None:
            # Sums of times stop there, so one more state is due.
            bound = min(self._total, max(bound, self._next) + 1)
        # States leave at least 1 ns apart, so no more than these can leave by ``until``.
        room = max(0, until - max(self._left, self._done))
        self._guard(min(sure - self._next, room))
        made = self._make(bound, inputs, until)
        self._done = max(self._done, until)
        return made, self._late(inputs, before, made)

    def finish(self, inputs: Sequence[InputSamples]) -> tuple[list[Made], int]:
        if self._duration.end is not None:
            bound = self._total
        elif self._first is None or not self._news:
            bound = 0
        else:
            valid = max(valid for valid, _ in self._news.values())
            available = max(available for _, available in self._news.values())
            # The newest sample is in the first state at or after its valid time, hence rounding up.
            bound = self._index(valid + self._period - 1)
            # The grid goes on until a state has left that could use the newest sample
            # of each input.
            seen = self._next and self._last >= valid and self._left >= available
            bound = self._next if seen else max(bound, self._next + 1, 1)
        bound = min(bound, self._total)
        possible = bound
        if self._delay is None:
            # What was complete before the end may still wait for a free available time.
            possible = min(bound, self._reached(inputs))
        if self._delay is not None or all(one.is_monotone for one in inputs):
            self._guard(possible - self._next)
        made = self._make(possible, inputs, TIME_MAX)
        return made, max(0, bound - self._next)

    def _hear(self, inputs: Sequence[InputSamples]) -> None:
        """Note the most recent new samples, and begin the grid with the first to arrive: of an
        instant with the least valid time."""
        firsts = []
        for i, one in enumerate(inputs):
            available, valid = one.available, one.valid
            if len(valid):
                instant = valid[: np.searchsorted(available, available[0], "right")]
                firsts.append((int(available[0]), int(instant.min())))
                row = -1 if one.is_monotone else np.flatnonzero(valid == valid.max())[-1]
                news = int(valid[row]), int(available[row])
                self._news[i] = max(news, self._news.get(i, news))
        if self._first is None and firsts:
            at, start = min(firsts)
            if self._delay is not None:
                # A state for an earlier time would be late before anything was there.
                start = max(start, at - self._delay)
            # Without `from` the grid has the multiples of the period.
            self._begin(start + -start % self._period)

    def _reached(self, inputs: Sequence[InputSamples]) -> int:
        """How many grid points all inputs have reached that are waited for."""
        return min((self._index(one.newest) for one in inputs if one.ended is None), default=0)

    def _begin(self, first: int) -> None:
        self._first = first
        self._total = max(0, (self._duration.last - first) // self._period + 1)

    def _index(self, time: int) -> int:
        """How many grid points are at or before ``time``."""
        if self._first is None:
            return 0
        return min(self._total, max(0, (time - self._first) // self._period + 1))

    def _time(self, index: int) -> int:
        assert self._first is not None
        return self._first + index * self._period

    def _guard(self, count: int) -> None:
        if count > self._limit:
            raise PolicyError(
                f"{count} states would be made at once, more than {self._limit}",
                "let `from` be near the samples, sample less often, or raise the limit",
            )

    def _make(self, bound: int, inputs: Sequence[InputSamples], until: int) -> list[Made]:
        """The states before the grid point ``bound`` that leave by ``until``."""
        made: list[Made] = []
        while self._next < bound:
            count = min(CHUNK, bound - self._next)
            # The steps together may not fit signed 64 bits, so they are unsigned; each time fits.
            first = np.uint64(self._time(self._next) % 2**64)
            steps = np.arange(count, dtype=np.uint64)
            times = (first + steps * np.uint64(self._period)).view(np.int64)
            before = self._next
            gone, _ = self._leave(times, inputs, until)
            made += gone
            self._next += sum(len(part[0]) for part in gone)
            # A state that waits holds back all later ones.
            if self._next < before + count:
                break
        return made

    def _late(
        self, inputs: Sequence[InputSamples], before: int, made: Sequence[Made]
    ) -> list[LateRows]:
        """The new samples that came after the first state that could have used them had left.
        ``made`` are the states from the grid point ``before`` on."""
        late: list[LateRows] = []
        if self._first is None or not self._next:
            return late
        leaves = np.concatenate([NONE, *(part[0] for part in made)])
        period = np.uint64(self._period)
        for i, one in enumerate(inputs):
            if one.is_monotone:
                rows = np.arange(up_to(one.valid, self._last))
            else:
                rows = np.flatnonzero(one.valid <= self._last)
            if self._exact:
                # Without approximation a sample serves the state of its own time only,
                # and there is none before the grid.
                rows = rows[one.valid[rows] >= self._first]
            if not len(rows):
                continue
            past = since(np.maximum(one.valid[rows], self._first), self._first)
            index: NDArray[np.uint64] = past // period
            off = index * period != past
            if self._exact:
                rows, index = rows[~off], index[~off]
            else:
                # With approximation the first state at or after its valid time could have used it.
                index += off
            gone = index < np.uint64(before)
            if len(leaves):
                place = np.where(gone, np.uint64(0), index - np.uint64(before)).astype(np.int64)
                gone |= leaves[place] < one.available[rows]
            if not gone.any():
                continue
            rows, index = rows[gone], index[gone]
            over = np.zeros(len(rows), np.bool_)
            if self._delay is not None:
                base = np.uint64(self._first % 2**64)
                deadline = later((base + index * period).view(np.int64), self._delay)
                over = one.available[rows] > deadline
            rows += one.first_new
            late.append((i, rows[over], Constraint.DELAY))
            late.append((i, rows[~over], Constraint.AVAILABLE))
        return late
