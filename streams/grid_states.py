"""When and of what the states of ``sample every s`` are made (SPEC §1 "State synchronization")."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from .inputs import NOTHING_KNOWN
from .policy import Approximation, Constraint, PolicyError, SynchronizationPolicy
from .recent import most_recent_rows
from .sample import Mask, SampleBatch, Times
from .saturating import later, since
from .time import TIME_MAX, TIME_MIN
from .tuples import Rows

CHUNK = 65_536
Made = tuple[Times, Times, tuple[Rows, ...], Mask]
"""Available times, valid times, a row of each input's table, and whether every input was in."""
LateRows = tuple[int, Rows, Constraint]


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
        if self._first is None:
            new = [
                (int(table.available[row]), int(table.valid[row]))
                for table, row in zip(tables, fresh, strict=True)
                if row < len(table)
            ]
            if new:
                start = min(new)[1]
                self._begin(start + -start % self._period)
        reach = [
            max(self._reach[i], int(table.valid[row:].max()) if row < len(table) else NOTHING_KNOWN)
            for i, (table, row) in enumerate(zip(tables, fresh, strict=True))
        ]
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
        made = self._make(tables, until, excused, bound)
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
        made = self._make(tables, TIME_MAX, excused, possible)
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
            moment, complete = self._completion(valid, tables, order, excused)
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
                rows = tuple(self._values(table, valid, leaves) for table in tables)
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
        order: Sequence[Rows | None],
        excused: Sequence[int | None],
    ) -> tuple[Times, Mask]:
        """The moment each state is complete, and whether it ever is as far as is known."""
        moment = np.full(len(valid), TIME_MIN)
        complete = np.ones(len(valid), np.bool_)
        for i, table in enumerate(tables):
            by_valid = order[i]
            if by_valid is None:
                values, available = table.valid, table.available
            else:
                values, available = table.valid[by_valid], table.available[by_valid]
            own = np.full(len(valid), TIME_MIN)
            has = np.zeros(len(valid), np.bool_)
            if len(values):
                at = np.searchsorted(values, valid, "left")
                has = at < len(values)
                at = np.minimum(at, len(values) - 1)
                own = available[at]
                if by_valid is not None:
                    has &= values[at] == valid
            if by_valid is None and self._reach[i] >= TIME_MIN:
                # A sample known before is enough, even one that is kept no more.
                known = valid <= self._reach[i]
                own, has = np.where(known, TIME_MIN, own), has | known
            excuse = excused[i]
            if excuse is not None and excuse <= TIME_MAX:
                own = np.where(has, own, excuse)
            elif not has.all():
                complete &= has
            moment = np.maximum(moment, own)
        return moment, complete

    def _values(self, table: SampleBatch, valid: Times, leaves: Times) -> Rows:
        rows = most_recent_rows(table.available, table.valid, valid, leaves)
        if self._exact and len(table):
            rows = np.where((rows >= 0) & (table.valid[rows] == valid), rows, -1)
        return rows

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
        for i, table in enumerate(tables):
            rows = np.arange(fresh[i], len(table))
            rows = rows[table.valid[rows] <= self._time(self._next - 1)]
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


def leaving(due: Times, previous: int) -> Times:
    """L_k = max(due_k, L_{k-1} + 1), after one that left at ``previous``; cut where time ends."""
    count = len(due)
    if not count or previous >= TIME_MAX:
        return due[:0]
    if previous >= TIME_MIN:
        due = np.maximum(due, previous + 1)
    if int(due.min()) > TIME_MIN + count and max(int(due.max()), previous) < TIME_MAX - count:
        steps = np.arange(count)
        result: Times = np.maximum.accumulate(due - steps) + steps
        return result
    exact = []
    for moment in due.tolist():
        previous = max(moment, previous + 1)
        if previous > TIME_MAX:
            break
        exact.append(previous)
    return np.array(exact, np.int64)
