"""When and of what states are made at the inputs' valid times, where inputs may be in any order and
``max delay oo`` waits for ever (SPEC §1 "State synchronization").

No order is declared, so an incomplete state holds back no complete one. When a state leaves depends
on its own samples alone; all that a batch completes is computed at once. `ChangeStates` is for a
finite delay, `MonotoneStates` for inputs whose valid times do not decrease.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from ..inputs import NOTHING_KNOWN
from ..joins.join import distinct
from ..policies.policy import Approximation, Constraint, SynchronizationPolicy
from ..sample import Mask, SampleBatch, Times
from ..saturating_time import leaving
from ..time import TIME_MAX, TIME_MIN
from ..tuples import Rows
from .grid_states import CHUNK, LateRows, Made, note_reached, rows_in_order

_NONE: Final[Times] = np.empty(0, np.int64)


class CompleteStates:
    """A state at every distinct valid time, once it is complete; see `Synchronization`.

    The state for t is complete at c_t. States leave in order of (c_t, t), each after the one
    before. A sample whose state has left is late.

    Cost: O((n + m) log n) numpy for n kept and new samples and m states that wait. Memory: 16 bytes
    a state that waits, 8 bytes a state that has left: a sample may come for any time.
    """

    def __init__(self, policy: SynchronizationPolicy, monotone: Sequence[bool]) -> None:
        assert policy.max_delay is None
        self._duration = policy.duration
        self._exact = policy.approximation is Approximation.NONE
        self._monotone = list(monotone)
        self._waiting: Times = _NONE
        """The times of incomplete states, which increase."""
        self._ready: tuple[Times, Times] = (_NONE, _NONE)
        """c_t and t of complete states that have not left, in the order in which they will."""
        self._gone = _Times()
        self._left = self._done = NOTHING_KNOWN
        self._reach = [NOTHING_KNOWN] * len(self._monotone)

    @property
    def pending(self) -> int:
        """States that wait."""
        return len(self._waiting) + len(self._ready[0])

    def of_use(self, table: SampleBatch) -> Mask:
        """Which samples a state to come may use."""
        if not self._exact:
            return table.valid <= self._duration.last
        times = np.sort(np.concatenate([self._waiting, self._ready[1]]))
        return _is_in(table.valid, times)

    def run(
        self,
        tables: Sequence[SampleBatch],
        fresh: Sequence[int],
        until: int,
        excused: Sequence[int | None],
    ) -> tuple[list[Made], list[LateRows]]:
        """All states that leave by ``until``; rows of table i from ``fresh[i]`` are new."""
        news = [table.valid[row:] for table, row in zip(tables, fresh, strict=True)]
        begun = distinct(np.concatenate([valid[self._within(valid)] for valid in news]))
        known = self._gone.contain(begun) | _is_in(begun, np.sort(self._ready[1]))
        self._waiting = distinct(np.concatenate([self._waiting, begun[~known]]))
        self._complete(tables, fresh, until, excused)
        made = self._leave(tables, until)
        late = self._late(tables, fresh, made)
        for leaving_times in made:
            self._gone.add(leaving_times[1])
        for i, valid in enumerate(news):
            if len(valid):
                self._reach[i] = max(self._reach[i], int(valid.max()))
        self._done = max(self._done, until)
        return made, late

    def finish(
        self,
        tables: Sequence[SampleBatch],
        excused: Sequence[int | None],
        news: tuple[int, int] | None,
    ) -> tuple[list[Made], int]:
        """The states that leave after the end, and how many never leave."""
        made = self._leave(tables, TIME_MAX)
        never = self.pending
        self._waiting, self._ready = _NONE, (_NONE, _NONE)
        return made, never

    def _within(self, valid: Times) -> Mask:
        return (valid >= self._duration.first) & (valid <= self._duration.last)

    def _complete(
        self,
        tables: Sequence[SampleBatch],
        fresh: Sequence[int],
        until: int,
        excused: Sequence[int | None],
    ) -> None:
        """Move the states that are complete by ``until`` to those that are ready."""
        times = self._waiting
        moment = np.full(len(times), TIME_MIN)
        complete = np.ones(len(times), np.bool_)
        for i, (table, row, excuse) in enumerate(zip(tables, fresh, excused, strict=True)):
            excuse = None if excuse is None or excuse > until else excuse
            own, has = self._satisfied(i, times, table, row)
            if excuse is not None:
                own = np.where(has, np.minimum(own, excuse), excuse)
                has = np.ones_like(has)
            np.maximum(moment, own, out=moment, where=has)
            complete &= has
        moment, ready = moment[complete], times[complete]
        order = np.lexsort((ready, moment))
        self._ready = (
            np.concatenate([self._ready[0], moment[order]]),
            np.concatenate([self._ready[1], ready[order]]),
        )
        self._waiting = times[~complete]

    def _satisfied(self, i: int, times: Times, table: SampleBatch, row: int) -> tuple[Times, Mask]:
        """When input ``i`` has what the state for each of ``times`` asks of it (`TIME_MIN`: before
        the new samples, from ``row`` on), and whether it has."""
        available, valid = table.available[row:], table.valid[row:]
        moment = np.full(len(times), TIME_MIN)
        if self._monotone[i]:
            count = note_reached(moment, times, self._reach[i], (available, valid), None)
            return moment, np.arange(len(times)) < count
        before = _is_in(times, np.sort(table.valid[:row]))
        if not len(valid):
            return moment, before
        order = np.argsort(valid, kind="stable")
        place = np.minimum(np.searchsorted(valid[order], times, "left"), len(valid) - 1)
        first = order[place]
        has = before | (valid[first] == times)
        return np.where(before, TIME_MIN, available[first]), has

    def _leave(self, tables: Sequence[SampleBatch], until: int) -> list[Made]:
        """The states that leave by ``until``."""
        due, times = self._ready
        leaves = leaving(due, self._left)
        going = int(leaves.searchsorted(until, "right"))
        made: list[Made] = []
        for start in range(0, going, CHUNK):
            rows = slice(start, min(start + CHUNK, going))
            at, valid = leaves[rows], times[rows]
            chosen = tuple(self._rows(i, table, valid, at) for i, table in enumerate(tables))
            made.append((at, valid, chosen, np.ones(len(at), np.bool_)))
        if going:
            self._left = int(leaves[going - 1])
            self._ready = due[going:].copy(), times[going:].copy()
        return made

    def _rows(self, i: int, table: SampleBatch, times: Times, leaves: Times) -> Rows:
        """The most recent row of input ``i`` at each of ``times`` by ``leaves``, -1 for none."""
        if self._monotone[i]:
            return rows_in_order(table, times, leaves, self._exact)
        order = np.lexsort((table.available, table.valid))
        valid, available = table.valid[order], table.available[order]
        place = np.searchsorted(valid, times, "right") - 1
        # The few that came after the state had left are passed over one by one.
        while True:
            early = np.flatnonzero(place >= 0)
            early = early[available[place[early]] > leaves[early]]
            if not len(early):
                break
            place[early] -= 1
        found = place >= 0
        if self._exact:
            found[found] = valid[place[found]] == times[found]
        rows = np.full(len(times), -1, np.int64)
        rows[found] = order[place[found]]
        return rows

    def _late(
        self, tables: Sequence[SampleBatch], fresh: Sequence[int], made: Sequence[Made]
    ) -> list[LateRows]:
        """The new samples that came after their state had left, by input."""
        times = np.concatenate([_NONE, *(valid for _, valid, _, _ in made)])
        leaves = np.concatenate([_NONE, *(at for at, _, _, _ in made)])
        order = np.argsort(times)
        times, leaves = times[order], leaves[order]
        late: list[LateRows] = []
        for i, (table, row) in enumerate(zip(tables, fresh, strict=True)):
            available, valid = table.available[row:], table.valid[row:]
            after = self._gone.contain(valid)
            if len(times):
                place = np.minimum(np.searchsorted(times, valid), len(times) - 1)
                after |= (times[place] == valid) & (available > leaves[place])
            if bool(after.any()):
                late.append((i, np.flatnonzero(after) + row, Constraint.AVAILABLE))
        return late


class _Times:
    """A growing set of times. Memory: 8 bytes a time; added at an amortized O(log n) each."""

    def __init__(self) -> None:
        self._parts: list[Times] = []
        """Each increases, and is longer than those after it together."""

    def add(self, times: Times) -> None:
        """Add times that are not in it."""
        new = np.sort(times)
        while self._parts and len(self._parts[-1]) <= 2 * len(new):
            new = np.sort(np.concatenate([self._parts.pop(), new]))
        self._parts.append(new)

    def contain(self, times: Times) -> Mask:
        """Which of ``times`` are in it."""
        found = np.zeros(len(times), np.bool_)
        for part in self._parts:
            found |= _is_in(times, part)
        return found


def _is_in(times: Times, known: Times) -> Mask:
    """Which of ``times`` are among ``known``, which do not decrease."""
    if not len(known):
        return np.zeros(len(times), np.bool_)
    place = np.minimum(np.searchsorted(known, times), len(known) - 1)
    found: Mask = known[place] == times
    return found
