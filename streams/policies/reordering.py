"""Monotone or strict order with a finite delay: samples wait for those that are valid earlier
([DyKnow10 Def. 5.36-5.37]: samples may be delayed to satisfy an order).

A sample that is valid at v may leave until v + d. If each leaves as late as it may, none that keeps
the delay itself comes too late for the order, so nothing is lost but what cannot be sent at all.
"""

from __future__ import annotations

from bisect import insort

import numpy as np

from ..sample import SampleBatch, Times
from ..stream_rules import Rules
from ..time import TIME_MAX, TIME_MIN
from ..time_arithmetic import later
from .adaptation import (
    CODES,
    KEPT,
    Adaptation,
    OnDrop,
    Reasons,
    joined,
    own,
    repeats,
)
from .policy import AnyChange, Constraint, Order, Policy

_ORDER = CODES[Constraint.ORDER]
_CHANGE = CODES[Constraint.CHANGE]
_AVAILABLE = CODES[Constraint.AVAILABLE]


class Reordering(Adaptation):
    """Sends samples in order of (valid, available) time, each at its latest moment.

    The latest moment of a sample is ``L_i = v_i + d`` (by `UNIQUE_TIMES` ``min(v_i + d, L_{i+1} -
    1)``, and one for which no moment is left is dropped). It is sent at L_i once all is known up to
    L_i. One that belongs before the last sent is dropped. In strict order the newest sample of a
    valid time replaces the others, equal ones too: what repeats (``any change``) is judged among
    those that are sent, one after the other.

    Cost: O(n log n) numpy a batch; where latest moments meet (equal valid times that come up to
    the last moment, or the end of 64 bits) O(held) a sample. Memory: what came within the delay.
    """

    def __init__(
        self, policy: Policy, on_drop: OnDrop | None = None, rules: Rules | None = None
    ) -> None:
        super().__init__(policy, on_drop, rules)
        assert policy.max_delay is not None
        self._delay = policy.max_delay
        self._strict = policy.order is Order.STRICT
        # In strict order valid times differ, so no two samples that are sent are equal.
        self._drops_repeated = isinstance(policy.change, AnyChange) and not self._strict
        self._known = TIME_MIN
        self._held: SampleBatch | None = None
        self._last: SampleBatch | None = None

    def push(self, batch: SampleBatch) -> list[SampleBatch]:
        self.counters.received += len(batch)
        if not len(batch):
            return []
        # More samples of the last instant may come.
        self._known = max(self._known, int(batch.available[-1]) - 1)
        reasons = self._inadmissible(batch)
        admitted = batch if bool((reasons == KEPT).all()) else batch.take(reasons == KEPT)
        everything = admitted if self._held is None else joined([self._held, admitted])
        why = np.full(len(everything), KEPT, np.int8)
        at = everything.available.copy()
        order = self._order(everything, why, at)
        moments = self._moments(everything, order)
        if self._are_certain(everything, order, moments):
            sent = int(np.searchsorted(moments, self._known, "right"))
        else:
            # The simulation decides anew, so the reasons noted so far do not hold.
            why[:], at[:] = KEPT, everything.available
            order, moments, sent = self._simulate(everything, why, at)
        refused = reasons != KEPT
        # A report is in order of the moments of decision, so both go into one.
        if bool(refused.any()):
            self._drop(
                joined([batch.take(refused), everything]),
                np.concatenate((reasons[refused], why)),
                np.concatenate((batch.available[refused], at)),
            )
        else:
            self._drop(everything, why, at)
        return self._send(everything, order, moments, sent)

    def advance(self, watermark: int) -> list[SampleBatch]:
        return self._flush(watermark - 1) if watermark - 1 > self._known else []

    def end(self) -> list[SampleBatch]:
        sent = self._flush(TIME_MAX)
        self._known = TIME_MIN  # the stream may be taken up again
        return sent

    def _flush(self, known: int) -> list[SampleBatch]:
        """Send what leaves by ``known``; nothing has come."""
        self._known = known
        if self._held is None:
            return []
        order = np.arange(len(self._held))
        moments = self._moments(self._held, order)
        return self._send(self._held, order, moments, int(np.searchsorted(moments, known, "right")))

    def _order(self, batch: SampleBatch, why: Reasons, at: Times) -> Times:
        """The rows in sending order. Of equal valid times the newest is sent (strict order), or
        all but repetitions (any change); what is dropped for that is noted in ``why``."""
        valid = batch.valid
        if bool(np.all(valid[1:] > valid[:-1])):
            order = np.arange(len(batch))
        else:
            order = np.lexsort((batch.available, valid))
        ordered = valid[order]
        tied = np.zeros(len(order), np.bool_)
        tied[1:] = ordered[1:] == ordered[:-1]
        if self._strict and bool(tied.any()):
            replaced = np.flatnonzero(tied) - 1
            why[order[replaced]] = _ORDER
            # The decision fell when the newer sample of that valid time arrived.
            at[order[replaced]] = batch.available[order[replaced + 1]]
            order = np.delete(order, replaced)
        elif self._drops_repeated and len(order):
            # Samples repeat each other in the order in which they are sent, not in which they came.
            same = repeats(batch.take(order), self._last)
            why[order[same]] = _CHANGE
            order = order[~same]
        return order

    def _moments(self, batch: SampleBatch, order: Times) -> Times:
        """L_i of the rows in ``order``: min over j ≥ i of (v_j + d - (j - i) * gap)."""
        deadlines = later(batch.valid[order], self._delay)
        if not len(order) or not self._rules.gap or bool(np.all(deadlines[1:] > deadlines[:-1])):
            return deadlines
        if int(deadlines[0]) < TIME_MIN + len(order):  # no room to count down in 64 bits
            least, moments = TIME_MAX + 1, []
            for deadline in reversed(deadlines.tolist()):
                least = min(deadline, least - 1)
                moments.append(max(least, TIME_MIN))
            return np.array(moments[::-1], np.int64)
        place = np.arange(len(order))
        return np.minimum.accumulate((deadlines - place)[::-1])[::-1] + place

    def _are_certain(self, batch: SampleBatch, order: Times, moments: Times) -> bool:
        """Whether the decision over all samples equals the decisions made as each one came.

        Samples that want the same times delay each other. The decisions are equal if all samples of
        such a run had arrived when its first one had to leave.
        """
        if not len(order):
            return True
        last = self._last
        if last is not None:
            first, last_valid = int(batch.valid[order[0]]), int(last.valid[0])
            if first < last_valid or (self._strict and first == last_valid):
                return False
            if int(moments[0]) < int(last.available[0]) + self._rules.gap:
                return False
        if not self._rules.gap:
            return True
        begins = np.ones(len(moments), np.bool_)
        begins[1:] = moments[1:] != moments[:-1] + 1
        starts = np.flatnonzero(begins)
        newest = np.maximum.reduceat(batch.available[order], starts)
        return bool(np.all(newest <= moments[starts]))

    def _simulate(self, batch: SampleBatch, why: Reasons, at: Times) -> tuple[Times, Times, int]:
        """The same sample by sample: rows in sending order, their moments, how many are sent."""
        valid, available = batch.valid.tolist(), batch.available.tolist()
        deadlines: list[int] = later(batch.valid, self._delay).tolist()
        held, gap = 0 if self._held is None else len(self._held), self._rules.gap
        queue = [(valid[row], available[row], row) for row in range(held)]
        sent: list[int] = []
        times: list[int] = []
        last_valid = None if self._last is None else int(self._last.valid[0])

        def first_moment() -> int:
            return min(deadlines[row] - place * gap for place, (_, _, row) in enumerate(queue))

        def send_until(known: int) -> None:
            nonlocal last_valid
            while queue and (moment := first_moment()) <= known:
                last_valid, _, row = queue.pop(0)
                sent.append(row)
                times.append(moment)

        def is_repeated(row: int) -> bool:
            """Whether the sample that would leave before ``row`` says the same."""
            own = (valid[row], available[row], row)
            before = [other for v, a, other in queue if (v, a, other) < own]
            before = before or sent
            if before:
                return bool(repeats(batch.take(np.array([before[-1], row])), None)[1])
            return bool(repeats(batch.take(np.array([row])), self._last)[0])

        for row in range(held, len(batch)):
            now = available[row]
            # Samples that leave at ``now`` may still be preceded by one that comes then.
            send_until(now - 1)
            if last_valid is not None and (
                valid[row] < last_valid or (self._strict and valid[row] == last_valid)
            ):
                why[row] = _ORDER
                continue
            if self._drops_repeated and is_repeated(row):
                why[row] = _CHANGE
                continue
            if self._strict:
                for entry in [entry for entry in queue if entry[0] == valid[row]]:
                    queue.remove(entry)
                    why[entry[2]], at[entry[2]] = _ORDER, now
            insort(queue, (valid[row], now, row))
            # With this sample one of the queue would have to leave in the past.
            if first_moment() < now:
                queue.remove((valid[row], now, row))
                why[row] = _AVAILABLE
        send_until(self._known)
        rest = np.array([row for _, _, row in queue], np.int64)
        rows = np.concatenate((np.array(sent, np.int64), rest))
        moments = np.concatenate((np.array(times, np.int64), self._moments(batch, rest)))
        return rows, moments, len(sent)

    def _send(
        self, batch: SampleBatch, order: Times, moments: Times, count: int
    ) -> list[SampleBatch]:
        """Send the first ``count`` rows in ``order`` at their moments; hold the others."""
        rest = order[count:]
        self._held = batch.take(rest) if len(rest) else None
        self.counters.pending = len(rest)
        self.counters.kept += count
        if not count:
            return []
        rows = order[:count]
        sent = batch.take(rows).with_available(moments[:count])
        self._last = own(sent.take(slice(count - 1, None)))
        return self._sent(sent, int(np.count_nonzero(moments[:count] > batch.available[rows])))
