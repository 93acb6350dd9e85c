"""When and of what states are made at the inputs' valid times, where no input's times decrease
(SPEC §1 "State synchronization").

Then nothing that makes a state can come after a later state has left: a state leaves when every
input has reached its time, or at its deadline, and what is valid earlier was there before. So all
that a batch decides can be computed at once. `ChangeStates` is the same for inputs in any order,
event by event.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..inputs import NOTHING_KNOWN
from ..joins.join import distinct
from ..policies.policy import Approximation, Constraint, SynchronizationPolicy
from ..sample import Mask, SampleBatch, Times
from ..saturating_time import later, leaving
from ..time import TIME_MAX, TIME_MIN
from .grid_states import (
    CHUNK,
    LateRows,
    Made,
    News,
    note_reached,
    rows_in_order,
    up_to,
)


class MonotoneStates:
    """States at every distinct valid time of monotone inputs; see `Synchronization` for the rules.

    Cost: O((n + m) log n) numpy for n kept and new samples and m states that wait or leave.
    Memory: the times of the states that wait.
    """

    def __init__(self, policy: SynchronizationPolicy, arity: int) -> None:
        self._delay, self._duration = policy.max_delay, policy.duration
        self._exact = policy.approximation is Approximation.NONE
        self._waiting: Times = np.empty(0, np.int64)
        self._left = self._last = self._now = self._done = NOTHING_KNOWN
        self._reach = [NOTHING_KNOWN] * arity

    @property
    def floor(self) -> int:
        """No state to come is for an earlier time."""
        if self._delay is None:
            return max(self._last, self._duration.first)
        least = int(self._waiting[0]) if len(self._waiting) else TIME_MAX
        return max(self._last, self._duration.first, min(least, self._done + 1 - self._delay))

    @property
    def pending(self) -> int:
        """States that wait."""
        return len(self._waiting)

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
        over = [self._over(*new) if len(new[0]) else None for new in news]
        begun = [
            times
            for (_, valid), late in zip(news, over, strict=True)
            if len(valid) and len(times := self._begun(valid, late))
        ]
        if begun:
            self._waiting = distinct(np.concatenate([self._waiting, *begun]))
        last = self._last
        made = self._leave(tables, news, until, excused)
        late: list[LateRows] = []
        for i, (available, valid) in enumerate(news):
            if not len(valid):
                continue
            out, after = over[i], self._after(available, valid, last, made)
            if out is not None:
                late.append((i, np.flatnonzero(out) + fresh[i], Constraint.DELAY))
            if after is not None:
                after = after if out is None else after & ~out
                late.append((i, np.flatnonzero(after) + fresh[i], Constraint.AVAILABLE))
            self._now = max(self._now, int(available[-1]))
            self._reach[i] = max(self._reach[i], int(valid[-1]))
        for excuse in excused:
            if excuse is not None and excuse <= until:
                self._now = max(self._now, excuse)
        self._done = max(self._done, until)
        return made, late

    def finish(
        self,
        tables: Sequence[SampleBatch],
        excused: Sequence[int | None],
        news: tuple[int, int] | None,
    ) -> tuple[list[Made], int]:
        """The states that leave after the end, and how many never leave."""
        nothing = np.empty(0, np.int64)
        made = self._leave(tables, [(nothing, nothing)] * len(tables), TIME_MAX, excused)
        never = len(self._waiting)
        self._waiting = nothing
        return made, never

    def _within(self, valid: Times) -> slice:
        """Which of ``valid``, which do not decrease, are in the duration."""
        low = int(np.searchsorted(valid, self._duration.first, "left"))
        return slice(low, max(low, int(np.searchsorted(valid, self._duration.last, "right"))))

    def _over(self, available: Times, valid: Times) -> Mask | None:
        """Which new samples in the duration exceed the delay; None for none."""
        if self._delay is None:
            return None
        over: Mask = available > later(valid, self._delay)
        if not bool(over.any()):
            return None
        within = self._within(valid)
        over[: within.start] = over[within.stop :] = False
        return over if bool(over.any()) else None

    def _begun(self, valid: Times, over: Mask | None) -> Times:
        """The times of states that new samples begin."""
        within = self._within(valid)
        start = max(within.start, up_to(valid, self._last))
        times = valid[start : within.stop]
        return times if over is None else times[~over[start : within.stop]]

    def _leave(
        self,
        tables: Sequence[SampleBatch],
        news: Sequence[News],
        until: int,
        excused: Sequence[int | None],
    ) -> list[Made]:
        """The waiting states that leave by ``until``."""
        valid = self._waiting[: self._due(news, until, excused)]
        if not len(valid):
            return []
        moment, count = self._completion(valid, news, excused)
        if self._delay is None:
            due = moment = moment[:count]
        else:
            due = np.minimum(moment, later(valid, self._delay))
        leaves = leaving(due, self._left)
        going = int(leaves.searchsorted(until, "right"))
        made: list[Made] = []
        for start in range(0, going, CHUNK):
            rows = slice(start, min(start + CHUNK, going))
            at, times = leaves[rows], valid[rows]
            complete = moment[rows] <= at
            complete[max(0, count - start) :] = False
            chosen = tuple(rows_in_order(table, times, at, self._exact) for table in tables)
            made.append((at, times, chosen, complete))
        if going:
            self._left, self._last = int(leaves[going - 1]), int(valid[going - 1])
            self._waiting = self._waiting[going:].copy()
        return made

    def _due(self, news: Sequence[News], until: int, excused: Sequence[int | None]) -> int:
        """How many of the waiting states may leave by ``until``: not one whose deadline is later
        and whose time an input has not reached."""
        least = TIME_MAX
        for reach, (_, times), excuse in zip(self._reach, news, excused, strict=True):
            if excuse is None:
                least = min(least, max(reach, int(times[-1])) if len(times) else reach)
        if self._delay is not None:
            # Sums of times stop at the end of 64 bits.
            least = TIME_MAX if until >= TIME_MAX else max(least, until - self._delay)
        return up_to(self._waiting, least)

    def _completion(
        self, valid: Times, news: Sequence[News], excused: Sequence[int | None]
    ) -> tuple[Times, int]:
        """When all inputs have reached each of ``valid`` or ended, as far as is known: of the
        first so many; `TIME_MAX` for the others."""
        moment = np.full(len(valid), max(self._now, TIME_MIN))
        count = len(valid)
        for reach, new, excuse in zip(self._reach, news, excused, strict=True):
            excuse = None if excuse is None or excuse > TIME_MAX else excuse
            reached = note_reached(moment, valid, reach, new, excuse)
            if excuse is None:
                count = min(count, reached)
        moment[count:] = TIME_MAX
        return moment, count

    def _after(
        self, available: Times, valid: Times, last: int, made: Sequence[Made]
    ) -> Mask | None:
        """Which new samples came after a state for their time or a later one had left; None for
        none. Before this batch the last was for ``last``."""
        if valid[0] > self._last:
            return None
        after: Mask = valid <= last if last >= TIME_MIN else np.zeros(len(valid), np.bool_)
        for leaves, times, _, _ in made:
            gone = np.searchsorted(leaves, available, "left")
            some = gone > 0
            after[some] |= valid[some] <= times[gone[some] - 1]
        if self._exact:
            within = self._within(valid)
            after[: within.start] = after[within.stop :] = False
        return after
