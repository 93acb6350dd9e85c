"""When and of what states are made at the inputs' own valid times (SPEC §1).

An exact simulation, event by event: what a late sample does depends on what has left. Many samples
at once are simulated by the compiled loop of `change_kernel`. Where no input's valid times decrease
`MonotoneStates` computes the same without a simulation.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right, insort
from collections.abc import Sequence
from typing import Final

import numpy as np

from ..inputs import NOTHING_KNOWN
from ..jit import JIT
from ..policies.policy import Approximation, Constraint, SynchronizationPolicy
from ..sample import SampleBatch
from ..time import TIME_MAX, TIME_MIN
from .change_kernel import (
    AFTER_STATE,
    HAS_LEFT,
    LAST,
    LEFT,
    NOW,
    OVER_DELAY,
    Events,
    clock_of,
    lay_out,
    simulate,
)
from .grid_states import CHUNK, LateRows, Made

COMPILED: Final = 512
"""From so many samples at once on the compiled loop is worth its preparation."""


class ChangeStates:
    """States at every distinct valid time, under a finite delay; see `Synchronization` for the
    rules. `CompleteStates` are those of ``max delay oo``.

    Cost: some microseconds of Python a sample and input; where `COMPILED` samples come at once and
    loops are compiled, O(n log n) numpy and a fraction of a microsecond. Memory: the pending times.
    """

    def __init__(self, policy: SynchronizationPolicy, monotone: Sequence[bool]) -> None:
        assert policy.max_delay is not None
        self._delay, self._duration = policy.max_delay, policy.duration
        self._exact = policy.approximation is Approximation.NONE
        self._monotone = list(monotone)
        self._waiting: list[int] = []
        self._left = self._last = self._now = self._done = NOTHING_KNOWN
        self._reach = [NOTHING_KNOWN] * len(self._monotone)
        self._valid: list[list[int]] = [[] for _ in monotone]
        self._rows: list[list[int]] = [[] for _ in monotone]
        self._excused: Sequence[int | None] = ()
        self._out: list[tuple[int, int, bool, list[int]]] = []

    @property
    def floor(self) -> int:
        """No state to come is for an earlier time."""
        least = self._waiting[0] if self._waiting else TIME_MAX
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
        self._excused = excused
        if JIT and sum(map(len, tables)) - sum(fresh) >= COMPILED:
            return self._run_compiled(tables, fresh, until)
        self._load(tables, fresh)
        events: list[tuple[int, int, int, int]] = []
        for i, (table, row) in enumerate(zip(tables, fresh, strict=True)):
            times = zip(table.available[row:].tolist(), table.valid[row:].tolist(), strict=True)
            events += [(at, i, row + k, valid) for k, (at, valid) in enumerate(times)]
        events += [(at, i, -1, 0) for at, i in self._excuses(until)]
        events.sort()
        late: dict[tuple[int, Constraint], list[int]] = {}
        for at, i, row, valid in events:
            if at > self._now:
                self._release(at - 1)
                self._now = at
            if row < 0:
                continue
            why = self._arrive(at, i, row, valid)
            if why is not None:
                late.setdefault((i, why), []).append(row)
        self._release(until)
        self._done = max(self._done, until)
        told = [(i, np.array(rows, np.int64), why) for (i, why), rows in late.items()]
        return self._made(), told

    def _run_compiled(
        self, tables: Sequence[SampleBatch], fresh: Sequence[int], until: int
    ) -> tuple[list[Made], list[LateRows]]:
        """The same by `change_kernel`."""
        arity = len(tables)
        events = self._events(tables, fresh, until)
        layout = lay_out(tables, fresh, events, self._duration, self._waiting)
        has_reached = np.array([reach >= TIME_MIN for reach in self._reach])
        reach = np.array([max(reach, TIME_MIN) for reach in self._reach], np.int64)
        # An excuse at the end of 64 bits or later begins never.
        excused = [None if e is None or e > TIME_MAX else e for e in self._excused]
        clock = clock_of(self._now, self._left, self._last)
        count = len(layout.times)
        leaves, state = np.empty(count, np.int64), np.empty(count, np.int64)
        complete = np.empty(count, np.bool_)
        picked = np.empty((count, arity), np.int64)
        why = np.zeros(len(layout.at), np.int64)
        made = simulate(
            *layout.arrays,
            *(np.array(self._monotone), reach, has_reached),
            np.array([0 if e is None else e for e in excused], np.int64),
            np.array([e is not None for e in excused]),
            *(until, self._delay, self._exact, clock),
            *(leaves, state, complete, picked, why),
        )
        self._waiting = layout.times[layout.waiting].tolist()
        self._reach = [
            int(r) if has else NOTHING_KNOWN for r, has in zip(reach, has_reached, strict=True)
        ]
        self._now = int(clock[NOW])
        if clock[HAS_LEFT]:
            self._left, self._last = int(clock[LEFT]), int(clock[LAST])
        self._done = max(self._done, until)
        parts: list[Made] = []
        for start in range(0, made, CHUNK):
            # Copies: a view would keep the arrays of all that wait in memory.
            part = slice(start, min(start + CHUNK, made))
            chosen = tuple(picked[part, i].copy() for i in range(arity))
            times = layout.times[state[part]]
            parts.append((leaves[part].copy(), times, chosen, complete[part].copy()))
        told: list[LateRows] = []
        for code, reason in ((OVER_DELAY, Constraint.DELAY), (AFTER_STATE, Constraint.AVAILABLE)):
            late = why == code
            if bool(late.any()):
                told += [
                    (i, layout.row_of[late & (layout.input_of == i)], reason) for i in range(arity)
                ]
        return parts, told

    def _events(self, tables: Sequence[SampleBatch], fresh: Sequence[int], until: int) -> Events:
        """When, of which input, which row (-1: its excuse begins) and valid at what time: in order
        of moment, input, row."""
        parts: list[Events] = []
        for i, (table, row) in enumerate(zip(tables, fresh, strict=True)):
            rows = np.arange(row, len(table))
            parts.append((table.available[row:], np.full(len(rows), i), rows, table.valid[row:]))
        for event in self._excuses(until):
            begins, of, none, zero = (np.array([x], np.int64) for x in (*event, -1, 0))
            parts.append((begins, of, none, zero))
        at, input_of, row_of, valid = (np.concatenate(each) for each in zip(*parts, strict=True))
        order = np.lexsort((row_of, input_of, at))
        return at[order], input_of[order], row_of[order], valid[order]

    def _excuses(self, until: int) -> list[tuple[int, int]]:
        """Which inputs end in what is run now, and when."""
        return [
            (at, i)
            for i, at in enumerate(self._excused)
            if at is not None and self._done < at <= until
        ]

    def finish(
        self,
        tables: Sequence[SampleBatch],
        excused: Sequence[int | None],
        news: tuple[int, int] | None,
    ) -> tuple[list[Made], int]:
        """The states that leave after the end, and how many never leave."""
        self._excused = excused
        self._load(tables, [len(table) for table in tables])
        self._release(TIME_MAX)
        never = len(self._waiting)
        self._waiting.clear()
        return self._made(), never

    def _load(self, tables: Sequence[SampleBatch], fresh: Sequence[int]) -> None:
        """What is kept, by valid time; of equal ones the last."""
        for i, (table, count) in enumerate(zip(tables, fresh, strict=True)):
            kept = dict(zip(table.valid[:count].tolist(), range(count), strict=True))
            self._valid[i] = sorted(kept)
            self._rows[i] = [kept[valid] for valid in self._valid[i]]

    def _arrive(self, at: int, i: int, row: int, valid: int) -> Constraint | None:
        """Take in a sample; why it is late, if it is."""
        self._reach[i] = max(self._reach[i], valid)
        values, rows = self._valid[i], self._rows[i]
        place = bisect_left(values, valid)
        if place < len(values) and values[place] == valid:
            rows[place] = row
        else:
            values.insert(place, valid)
            rows.insert(place, row)
        within = self._duration.first <= valid <= self._duration.last
        if within and at > valid + self._delay:
            return Constraint.DELAY
        if valid <= self._last and (within or not self._exact):
            return Constraint.AVAILABLE
        if within:
            place = bisect_left(self._waiting, valid)
            if place == len(self._waiting) or self._waiting[place] != valid:
                insort(self._waiting, valid)
        return None

    def _release(self, until: int) -> None:
        """Let states leave in order of their times, as far as they leave by ``until``."""
        gone = 0
        for valid in self._waiting:
            complete = self._is_complete(valid)
            due = min(valid + self._delay, TIME_MAX)
            if complete:
                due = min(due, self._now)
            leaves = max(due, self._left + 1)
            if leaves > until:
                break
            self._left, self._last = leaves, valid
            gone += 1
            self._out.append((leaves, valid, complete, self._pick(valid)))
        if gone:
            del self._waiting[:gone]

    def _is_complete(self, valid: int) -> bool:
        for i, monotone in enumerate(self._monotone):
            excuse = self._excused[i]
            if excuse is not None and excuse <= self._now:
                continue
            if monotone:
                if self._reach[i] < valid:
                    return False
                continue
            values = self._valid[i]
            place = bisect_left(values, valid)
            if place == len(values) or values[place] != valid:
                return False
        return True

    def _pick(self, valid: int) -> list[int]:
        picked = []
        for values, rows in zip(self._valid, self._rows, strict=True):
            place = bisect_right(values, valid) - 1
            none = place < 0 or (self._exact and values[place] != valid)
            picked.append(-1 if none else rows[place])
        return picked

    def _made(self) -> list[Made]:
        made: list[Made] = []
        for start in range(0, len(self._out), CHUNK):
            part = self._out[start : start + CHUNK]
            rows = np.array([row for *_, row in part], np.int64)
            made.append(
                (
                    np.array([row[0] for row in part], np.int64),
                    np.array([row[1] for row in part], np.int64),
                    tuple(rows[:, i] for i in range(rows.shape[1])),
                    np.array([row[2] for row in part], np.bool_),
                )
            )
        self._out.clear()
        return made
