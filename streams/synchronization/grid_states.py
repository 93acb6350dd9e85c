"""When and of what the states of ``sample every s`` are made (SPEC §1 "State synchronization")."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..inputs import NOTHING_KNOWN
from ..policies.policy import (
    Approximation,
    Constraint,
    PolicyError,
    SynchronizationPolicy,
)
from ..recent import most_recent_rows
from ..sample import Mask, SampleBatch, Times
from ..saturating_time import later, leaving, since
from ..time import TIME_MAX, TIME_MIN
from ..tuples import Rows

CHUNK = 65_536
Made = tuple[Times, Times, tuple[Rows, ...], Mask]
"""Available times, valid times, a row of each input's table, and whether every input was in."""
News = tuple[Times, Times]
"""Available and valid times of an input's new samples."""
LateRows = tuple[int, Rows, Constraint]
"""An input, rows of its table, and what they are late for."""


class GridStates:
    """States at ``first + k * period``; see `Synchronization` for the rules.

    Cost: O(m log n) numpy for m states over n kept samples; where an input's valid times are in
    no order also O(n log n). Memory: none beyond a few integers.
    """

    def __init__(self, policy: SynchronizationPolicy, monotone: Sequence[bool], limit: int) -> None:
        assert policy.period is not None
        self._policy, self._period, self._monotone = policy, policy.period, list(monotone)
        self._limit = limit
        self._exact = policy.approximation is Approximation.NONE
        self._next = 0
        self._first: int | None = None
        self._total = 0
        self._left = self._done = NOTHING_KNOWN
        self._reach = [NOTHING_KNOWN] * len(self._monotone)
        if policy.duration.start is not None:
            self._begin(policy.duration.start)

    @property
    def floor(self) -> int:
        """No state to come is for an earlier time."""
        if self._first is None:
            return NOTHING_KNOWN
        return self._time(self._next) if self._next < self._total else TIME_MAX

    @property
    def pending(self) -> int:
        """Grid points up to the latest valid time seen that have not left."""
        return max(0, self._index(max(self._reach)) - self._next)

    def run(
        self,
        tables: Sequence[SampleBatch],
        fresh: Sequence[int],
        until: int,
        excused: Sequence[int | None],
    ) -> tuple[list[Made], list[LateRows]]:
        """All states that leave by ``until``; rows of table i from ``fresh[i]`` are new."""
        news = [
            (table.available[row:], table.valid[row:])
            for table, row in zip(tables, fresh, strict=True)
        ]
        reach = [
            max(before, int(valid[-1] if monotone else valid.max())) if len(valid) else before
            for before, monotone, (_, valid) in zip(self._reach, self._monotone, news, strict=True)
        ]
        if self._first is None:
            first = [(int(at[0]), int(valid[0])) for at, valid in news if len(valid)]
            if first:
                at, start = min(first)
                if self._policy.max_delay is not None:
                    # A state for an earlier time would be late before anything was there.
                    start = max(start, at - self._policy.max_delay)
                self._begin(start + -start % self._period)
        needed = [value for value, excuse in zip(reach, excused, strict=True) if excuse is None]
        bound = 0
        delay = self._policy.max_delay
        if delay is not None:
            bound = self._index(until - delay)
        sure = bound
        if needed:
            bound = max(bound, self._index(min(needed)))
            sure = bound if all(self._monotone) else sure
        if until >= TIME_MAX and delay is not None:
            # Sums of times stop there, so one more state is due.
            bound = min(self._total, max(bound, self._next) + 1)
        room = max(0, until - max(self._left, self._done))
        self._guard(min(sure - self._next, room))
        before = self._next
        made = self._make(tables, news, until, excused, bound)
        late = self._late(tables, fresh, before, made)
        self._reach, self._done = reach, max(self._done, until)
        return made, late

    def finish(
        self,
        tables: Sequence[SampleBatch],
        excused: Sequence[int | None],
        news: tuple[int, int] | None,
    ) -> tuple[list[Made], int]:
        """The states that leave after the end, and how many never leave.

        ``news`` are the greatest valid and available time of the last most recent samples.
        """
        if self._policy.duration.end is not None:
            bound = self._total
        elif news is None or self._first is None:
            bound = 0
        else:
            valid, available = news
            bound = self._index(valid + self._period - 1)
            seen = self._next and self._time(self._next - 1) >= valid and self._left >= available
            bound = self._next if seen else max(bound, self._next + 1, 1)
        bound = min(bound, self._total)
        possible = bound
        if self._policy.max_delay is None:
            # What was complete before the end may still wait for a free available time.
            needed = [at for at, excuse in zip(self._reach, excused, strict=True) if excuse is None]
            possible = min(bound, self._index(min(needed)))
        if self._policy.max_delay is not None or all(self._monotone):
            self._guard(possible - self._next)
        nothing = [(table.available[:0], table.valid[:0]) for table in tables]
        made = self._make(tables, nothing, TIME_MAX, excused, possible)
        return made, max(0, bound - self._next)

    def _begin(self, first: int) -> None:
        self._first = first
        last = self._policy.duration.last
        self._total = max(0, (last - first) // self._period + 1)

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

    def _make(
        self,
        tables: Sequence[SampleBatch],
        news: Sequence[News],
        until: int,
        excused: Sequence[int | None],
        bound: int,
    ) -> list[Made]:
        made: list[Made] = []
        if self._next >= bound:
            return made
        first = np.uint64(self._time(self._next) % 2**64)
        start = self._next
        order = [
            None if monotone else np.lexsort((table.available, table.valid))
            for monotone, table in zip(self._monotone, tables, strict=True)
        ]
        while self._next < bound:
            count = min(CHUNK, bound - self._next)
            steps = np.arange(self._next - start, self._next - start + count, dtype=np.uint64)
            valid = (first + steps * np.uint64(self._period)).view(np.int64)
            moment, complete = self._completion(valid, tables, news, order, excused)
            delay = self._policy.max_delay
            if delay is None:
                if not complete.all():
                    stop = int(np.argmin(complete))
                    valid, moment, complete = valid[:stop], moment[:stop], complete[:stop]
                due = moment
            else:
                deadline = later(valid, delay)
                due = np.where(complete, np.minimum(moment, deadline), deadline)
            leaves = leaving(due, self._left)
            going = int(np.searchsorted(leaves, until, "right"))
            if going:
                leaves, valid = leaves[:going], valid[:going]
                complete = complete[:going] & (moment[:going] <= leaves)
                rows = tuple(
                    self._values(i, table, valid, leaves) for i, table in enumerate(tables)
                )
                made.append((leaves, valid, rows, complete))
                self._left = int(leaves[-1])
                self._next += going
            if going < count:
                break
        return made

    def _completion(
        self,
        valid: Times,
        tables: Sequence[SampleBatch],
        news: Sequence[News],
        order: Sequence[Rows | None],
        excused: Sequence[int | None],
    ) -> tuple[Times, Mask]:
        """The moment each state is complete, and whether it ever is as far as is known."""
        moment = np.full(len(valid), TIME_MIN)
        complete = np.ones(len(valid), np.bool_)
        for i, (table, by_valid, excuse) in enumerate(zip(tables, order, excused, strict=True)):
            excuse = None if excuse is None or excuse > TIME_MAX else excuse
            if by_valid is None:
                reached = note_reached(moment, valid, self._reach[i], news[i], excuse)
                if excuse is None:
                    complete[reached:] = False
                continue
            own = np.full(len(valid), TIME_MIN)
            has = np.zeros(len(valid), np.bool_)
            if len(table):
                values, available = table.valid[by_valid], table.available[by_valid]
                at = np.searchsorted(values, valid, "left")
                has = at < len(values)
                at = np.minimum(at, len(values) - 1)
                own = available[at]
                has &= values[at] == valid
            if excuse is not None:
                own = np.where(has, own, excuse)
            else:
                complete &= has
            moment = np.maximum(moment, own)
        return moment, complete

    def _values(self, input: int, table: SampleBatch, valid: Times, leaves: Times) -> Rows:
        if self._monotone[input]:
            return rows_in_order(table, valid, leaves, self._exact)
        rows = most_recent_rows(table.available, table.valid, valid, leaves)
        return _exact(table, rows, valid) if self._exact else rows

    def _late(
        self,
        tables: Sequence[SampleBatch],
        fresh: Sequence[int],
        before: int,
        made: Sequence[Made],
    ) -> list[LateRows]:
        """New samples that came after the first state that could have used them had left."""
        late: list[LateRows] = []
        if self._first is None or not self._next:
            return late
        leaves = np.concatenate([part[0] for part in made]) if made else np.empty(0, np.int64)
        period = np.uint64(self._period)
        latest = self._time(self._next - 1)
        for i, table in enumerate(tables):
            if self._monotone[i]:
                rows = np.arange(fresh[i], max(fresh[i], up_to(table.valid, latest)))
            else:
                rows = np.flatnonzero(table.valid[fresh[i] :] <= latest) + fresh[i]
            if self._exact:
                rows = rows[table.valid[rows] >= self._first]
            if not len(rows):
                continue
            past = since(np.maximum(table.valid[rows], self._first), self._first)
            index: NDArray[np.uint64] = past // period
            off = past % period != 0
            if self._exact:
                rows, index = rows[~off], index[~off]
            else:
                index = index + off.astype(np.uint64)
            available = table.available[rows]
            gone = index < np.uint64(before)
            if len(leaves):
                place = np.where(gone, np.uint64(0), index - np.uint64(before)).astype(np.int64)
                gone |= leaves[place] < available
            rows, index, available = rows[gone], index[gone], available[gone]
            delay = self._policy.max_delay
            over = np.zeros(len(rows), np.bool_)
            if delay is not None:
                base = np.uint64(self._first % 2**64)
                over = available > later((base + index * period).view(np.int64), delay)
            late.append((i, rows[over], Constraint.DELAY))
            late.append((i, rows[~over], Constraint.AVAILABLE))
        return late


def note_reached(moment: Times, valid: Times, reach: int, news: News, excuse: int | None) -> int:
    """How many of ``valid``, which increase, a monotone input has reached, whose samples before
    ``news`` reached ``reach``. Into ``moment`` goes when, if that is later; for the others the
    moment of its end, ``excuse``. Cost: O(m log n)."""
    known = up_to(valid, reach)
    reached = known
    available, times = news
    if len(times):
        reached = max(known, up_to(valid, int(times[-1])))
        own = available[np.searchsorted(times, valid[known:reached], "left")]
        np.maximum(moment[known:reached], own, out=moment[known:reached])
    if excuse is not None:
        np.maximum(moment[reached:], excuse, out=moment[reached:])
    return reached


def up_to(times: Times, time: int) -> int:
    """How many of ``times``, which do not decrease, are at or before ``time``."""
    return int(times.searchsorted(time, "right")) if time >= TIME_MIN else 0


def rows_in_order(table: SampleBatch, valid: Times, leaves: Times, exact: bool) -> Rows:
    """The most recent row at each of ``valid`` by ``leaves``, -1 for none, where the valid times of
    ``table`` do not decrease; with ``exact`` only if it is valid then. Cost: O(m log n)."""
    by_then = np.searchsorted(table.available, leaves, "right")
    rows = np.minimum(by_then, np.searchsorted(table.valid, valid, "right")) - 1
    return _exact(table, rows, valid) if exact else rows


def _exact(table: SampleBatch, rows: Rows, valid: Times) -> Rows:
    if not len(table):
        return rows
    return np.where((rows >= 0) & (table.valid[rows] == valid), rows, -1)
