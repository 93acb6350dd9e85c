"""``sample every s`` without approximation: consecutive valid times differ by exactly s
([DyKnow10 Def. 5.22, 5.37])."""

from __future__ import annotations

import numpy as np

from ..sample import Mask, SampleBatch, Times
from ..stream_rules import Rules
from ..time import TIME_MAX, TIME_MIN
from ..time_arithmetic import later, leaving, since
from .adaptation import CODES, KEPT, Adaptation, OnDrop, Reasons, joined, own
from .policy import Constraint, Policy

_PERIOD = CODES[Constraint.PERIOD]
_ORDER = CODES[Constraint.ORDER]
_NOTHING: Times = np.empty(0, np.int64)


class Chain(Adaptation):
    """Passes on the samples valid at v, v + s, v + 2s … where v is the first admissible one.

    Each is sent as soon as it is there and its turn has come; several whose turn comes at once are
    one instant (by `UNIQUE_TIMES` they leave 1 ns apart). One that is ahead of its turn is held,
    the first of each valid time; when the expected one cannot come any more within its delay, the
    chain is at its end for good: the definition admits no sample after a gap (the policy `use most
    recent` bridges gaps). With ``max delay oo`` the expected one is awaited for ever.

    Cost: O(n) numpy for samples in turn, O(n log n) for others, n those that are held or come.
    Memory: what is held, one sample a valid time; with a finite delay what came within it.
    """

    def __init__(
        self, policy: Policy, on_drop: OnDrop | None = None, rules: Rules | None = None
    ) -> None:
        super().__init__(policy, on_drop, rules)
        assert policy.period is not None
        self._period = policy.period
        self._delay = policy.max_delay
        self._known = self._newest = TIME_MIN
        self._last: tuple[int, int] | None = None
        """Available and valid time of the last sample sent."""
        self._held: SampleBatch | None = None
        self._due: SampleBatch | None = None
        """Decided, and already with the available times they will have, which are not known yet."""
        self._broken = False

    def push(self, batch: SampleBatch) -> list[SampleBatch]:
        self.counters.received += len(batch)
        if not len(batch):
            return []
        reasons = self._inadmissible(batch)
        everything = batch if self._held is None else joined([self._held, batch])
        held = len(everything) - len(batch)
        why = np.concatenate((np.full(held, KEPT, np.int8), reasons)) if held else reasons
        at = everything.available.copy()
        rows, times = self._turns(everything, held, why, at)
        last = self._newest = int(batch.available[-1])
        self._known = max(self._known, last - 1)
        self._end_of_chain(everything, why, at, rows, self._known)
        return self._send(everything, why, at, rows, times, last)

    def advance(self, watermark: int) -> list[SampleBatch]:
        if watermark - 1 <= self._known:
            return []
        self._known = watermark - 1
        return self._settle()

    def end(self) -> list[SampleBatch]:
        # No more samples of the last instant come.
        self._known = max(self._known, self._newest)
        return self._settle(ended=True)

    def _settle(self, ended: bool = False) -> list[SampleBatch]:
        """Time has passed and nothing has come; or nothing will."""
        known = TIME_MAX if ended else self._known
        if self._held is None:
            self._break_if_due(self._known)
            return [] if self._due is None else self._give(self._due.take(slice(0)), 0, known)
        held = self._held
        why = np.full(len(held), KEPT, np.int8)
        at = held.available.copy()
        self._end_of_chain(held, why, at, _NOTHING, self._known, ended)
        return self._send(held, why, at, _NOTHING, _NOTHING, known)

    def _turns(self, batch: SampleBatch, held: int, why: Reasons, at: Times) -> tuple[Times, Times]:
        """The rows to send, in order, and when; reasons for those that will not be."""
        fresh = np.flatnonzero(why[held:] == KEPT) + held
        first = fresh[:0]
        if self._last is None and len(fresh) and not self._broken:
            first, fresh = fresh[:1], fresh[1:]
            self._last = int(batch.available[first[0]]), int(batch.valid[first[0]])
        if self._last is None or self._broken:
            why[fresh] = _PERIOD
            return _NOTHING, _NOTHING
        # `a - b` of int64s always fits in uint64; what is behind the chain is told apart first.
        valid = batch.valid[fresh]
        behind = valid <= self._last[1]
        distance = since(valid, self._last[1])
        distance = np.where(behind, -distance, distance)
        turn = distance // np.uint64(self._period)
        off = turn * np.uint64(self._period) != distance
        why[fresh[off]] = _PERIOD
        on_grid = np.flatnonzero(~off)
        fresh, behind, turn = fresh[on_grid], behind[on_grid], turn[on_grid]
        wanted = np.arange(1, len(fresh) + 1, dtype=np.uint64)
        # The last may have been sent later than it came, after others that came with it.
        crowded = len(fresh) > 0 and (
            int(batch.available[fresh[0]]) < self._last[0] + self._rules.gap
        )
        # Samples leave as they come only if each one is just the next.
        if held or crowded or bool((behind | (turn != wanted)).any()):
            rows, times = self._out_of_turn(batch, held, fresh, behind, why, at)
        else:
            rows, times = fresh, batch.available[fresh]
            if len(rows):
                self._last = int(times[-1]), int(batch.valid[rows[-1]])
        if len(first):
            rows = np.concatenate((first, rows))
            times = np.concatenate((batch.available[first], times))
        return rows, times

    def _out_of_turn(
        self, batch: SampleBatch, held: int, fresh: Times, behind: Mask, why: Reasons, at: Times
    ) -> tuple[Times, Times]:
        """The same for samples on the grid that are not simply the next ones."""
        assert self._last is not None
        sent_at, last = self._last
        rows = np.concatenate((np.arange(held), fresh[~behind]))
        turn = since(batch.valid[rows], last) // np.uint64(self._period)
        # Of each turn the first that came; they can be sent up to the first turn that lacks.
        turns, came_first = np.unique(turn, return_index=True)
        lacks = np.flatnonzero(turns != np.arange(1, len(turns) + 1, dtype=np.uint64))
        ready = rows[came_first[: lacks[0] if len(lacks) else None]]
        if self._delay is not None:
            over = np.flatnonzero(batch.available[ready] > later(batch.valid[ready], self._delay))
            ready = ready[: over[0] if len(over) else None]
        # Each has a moment left: the one before kept its deadline, which is a period earlier.
        moments = leaving(batch.available[ready], sent_at, self._rules.gap)
        ready = ready[: len(moments)]
        if len(ready):
            self._last = int(moments[-1]), int(batch.valid[ready[-1]])
        repeated = np.ones(len(rows), np.bool_)
        repeated[came_first] = False
        why[rows[repeated]] = _ORDER
        why[fresh[behind]] = _ORDER
        if self._delay is not None:
            # A sample from after the deadline shows that the expected one cannot come any more.
            after = fresh[batch.available[fresh] > self._deadline()]
            why[after] = _PERIOD
            self._broken = len(after) > 0
        return ready, moments

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
        rows: Times,
        known: int,
        ended: bool = False,
    ) -> None:
        """Where the chain has broken, or the stream ended, what is held will never be sent."""
        if not self._break_if_due(known) and not ended:
            return
        left = why == KEPT
        left[rows] = False
        why[left] = _PERIOD
        # The chain decides when it breaks; a sample that comes later is decided on arrival.
        moment = known if self._delay is None else self._deadline()
        at[left] = np.maximum(batch.available[left], moment)

    def _send(
        self,
        batch: SampleBatch,
        why: Reasons,
        at: Times,
        rows: Times,
        moments: Times,
        known: int,
    ) -> list[SampleBatch]:
        rest = why == KEPT
        rest[rows] = False
        self._held = batch.take(rest) if bool(rest.any()) else None
        self._drop(batch, why, at)
        if not len(rows) and self._due is None:
            self.counters.pending = 0 if self._held is None else len(self._held)
            return []
        sent = batch.take(rows)
        delayed = int(np.count_nonzero(moments > sent.available))
        return self._give(sent.with_available(moments), delayed, known)

    def _give(self, fresh: SampleBatch, delayed: int, known: int) -> list[SampleBatch]:
        """Of what is decided all that is available by ``known``. The rest waits for its time: the
        output must not be ahead of what its readers may take as known."""
        waits = 0
        if self._due is not None:
            delayed += len(self._due)
            fresh = joined([self._due, fresh])
            self._due = None
        if len(fresh) and fresh.available[-1] > known:
            count = int(np.searchsorted(fresh.available, known, "right"))
            waits = len(fresh) - count
            self._due = own(fresh.take(slice(count, None)))
            fresh = fresh.take(slice(0, count))
        self.counters.pending = waits + (0 if self._held is None else len(self._held))
        self.counters.kept += len(fresh)
        # What waits is sent after what came last, so all of it is delayed.
        return self._sent(fresh, delayed - waits)
