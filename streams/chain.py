"""``sample every s`` without approximation: consecutive valid times differ by exactly s
([DyKnow10 Def. 5.22, 5.37])."""

from __future__ import annotations

import numpy as np

from .adaptation import CODES, KEPT, Adaptation, OnDrop, Reasons, joined
from .policy import Constraint, Policy
from .sample import SampleBatch, Times
from .saturating import since
from .time import TIME_MAX, TIME_MIN

_PERIOD = CODES[Constraint.PERIOD]
_ORDER = CODES[Constraint.ORDER]
_DELAY = CODES[Constraint.DELAY]


class Chain(Adaptation):
    """Passes on the samples valid at v, v + s, v + 2s … where v is the first admissible one.

    Each is sent as soon as it is there and its turn has come. One that is ahead of its turn is
    held, the first of each valid time; when the expected one cannot come any more within its
    delay, the chain is at its end for good: the definition admits no sample after a gap (the
    policy `use most recent` bridges gaps). With ``max delay oo`` the expected one is awaited for
    ever.

    Cost: O(n) numpy for samples in turn, O(1) Python for each on the grid that is out of turn.
    Memory: what is held, one sample a valid time; with a finite delay what came within it.
    """

    def __init__(self, policy: Policy, on_drop: OnDrop | None = None) -> None:
        super().__init__(policy, on_drop)
        assert policy.period is not None
        self._period = policy.period
        self._delay = policy.max_delay
        self._known = TIME_MIN
        self._last: tuple[int, int] | None = None
        """Available and valid time of the last sample sent."""
        self._held: SampleBatch | None = None
        self._broken = False

    def push(self, batch: SampleBatch) -> list[SampleBatch]:
        self.counters.received += len(batch)
        if not len(batch):
            return []
        reasons = self._inadmissible(batch)
        everything = batch if self._held is None else joined([self._held, batch])
        held = len(everything) - len(batch)
        why = np.concatenate((np.full(held, KEPT, np.int8), reasons))
        at = everything.available.copy()
        rows, times = self._turns(everything, held, why, at)
        self._known = int(batch.available[-1])
        self._end_of_chain(everything, why, at, rows, self._known)
        return self._send(everything, why, at, rows, times)

    def advance(self, watermark: int) -> list[SampleBatch]:
        self._known = max(self._known, watermark - 1 if watermark > TIME_MIN else TIME_MIN)
        return self._settle()

    def end(self) -> list[SampleBatch]:
        return self._settle(ended=True)

    def _settle(self, ended: bool = False) -> list[SampleBatch]:
        """Time has passed and nothing has come; or nothing will."""
        if self._held is None:
            self._break_if_due(self._known)
            return []
        held = self._held
        why = np.full(len(held), KEPT, np.int8)
        at = held.available.copy()
        self._end_of_chain(held, why, at, [], self._known, ended)
        return self._send(held, why, at, [], [])

    def _turns(
        self, batch: SampleBatch, held: int, why: Reasons, at: Times
    ) -> tuple[list[int], list[int]]:
        """The rows to send, in order, and when; reasons for those that will not be."""
        rows: list[int] = []
        times: list[int] = []
        fresh = np.flatnonzero(why[held:] == KEPT) + held
        if self._last is None and len(fresh) and not self._broken:
            first = int(fresh[0])
            rows.append(first)
            times.append(int(batch.available[first]))
            self._last = (times[0], int(batch.valid[first]))
            fresh = fresh[1:]
        if self._last is None or self._broken:
            why[fresh] = _PERIOD
            return rows, times
        # `a - b` of int64s always fits in uint64; what is behind the chain is told apart first.
        behind = batch.valid[fresh] <= self._last[1]
        distance = since(batch.valid[fresh], self._last[1])
        off = np.where(behind, -distance, distance) % np.uint64(self._period) != 0
        why[fresh[off]] = _PERIOD
        turn = distance // np.uint64(self._period)
        on_grid = fresh[~off]
        behind, turn = behind[~off], turn[~off]
        in_turn = 0
        if not held:
            wanted = np.arange(1, len(on_grid) + 1, dtype=np.uint64)
            differs = np.flatnonzero(behind | (turn != wanted))
            in_turn = int(differs[0]) if len(differs) else len(on_grid)
        if in_turn:
            chosen = on_grid[:in_turn]
            rows += chosen.tolist()
            times += batch.available[chosen].tolist()
            self._last = (times[-1], int(batch.valid[chosen[-1]]))
        self._out_of_turn(batch, held, on_grid[in_turn:].tolist(), why, at, rows, times)
        return rows, times

    def _out_of_turn(
        self,
        batch: SampleBatch,
        held: int,
        candidates: list[int],
        why: Reasons,
        at: Times,
        rows: list[int],
        times: list[int],
    ) -> None:
        """What is not simply the next one, sample by sample."""
        assert self._last is not None
        valid, available = batch.valid, batch.available
        ahead = {int(valid[row]): row for row in range(held)}
        sent_at, last = self._last
        for row in candidates:
            now, time = int(available[row]), int(valid[row])
            if self._break_if_due(now - 1) or self._broken:
                why[row] = _PERIOD
                continue
            if time <= last or time in ahead:
                why[row] = _ORDER
                continue
            ahead[time] = row
            while (next_row := ahead.pop(last + self._period, None)) is not None:
                moment = max(now, sent_at + 1)
                due = last + self._period
                if self._delay is not None and moment > due + self._delay:
                    why[next_row], at[next_row] = _DELAY, now
                    break
                rows.append(next_row)
                times.append(moment)
                sent_at, last = moment, due
                self._last = (sent_at, last)

    def _break_if_due(self, known: int) -> bool:
        """Whether the expected sample cannot come any more: all is known up to its deadline."""
        if self._last is None or self._delay is None or self._broken:
            return self._broken
        self._broken = known >= self._deadline()
        return self._broken

    def _deadline(self) -> int:
        assert self._last is not None
        assert self._delay is not None
        return min(self._last[1] + self._period + self._delay, TIME_MAX)

    def _end_of_chain(
        self,
        batch: SampleBatch,
        why: Reasons,
        at: Times,
        rows: list[int],
        known: int,
        ended: bool = False,
    ) -> None:
        """Where the chain has broken, or the stream ended, what is held will never be sent."""
        if not self._break_if_due(known) and not ended:
            return
        left = why == KEPT
        left[rows] = False
        why[left] = _PERIOD
        moment = known if self._delay is None else self._deadline()
        at[left] = np.maximum(batch.available[left], moment)

    def _send(
        self, batch: SampleBatch, why: Reasons, at: Times, rows: list[int], times: list[int]
    ) -> list[SampleBatch]:
        rest = why == KEPT
        rest[rows] = False
        self._held = batch.take(rest) if bool(rest.any()) else None
        self.counters.pending = 0 if self._held is None else len(self._held)
        self.counters.kept += len(rows)
        self._drop(batch, why, at)
        if not rows:
            return []
        moments = np.array(times, np.int64)
        chosen = np.array(rows, np.int64)
        delayed = int(np.count_nonzero(moments > batch.available[chosen]))
        return self._sent(batch.take(chosen).with_available(moments), delayed)
