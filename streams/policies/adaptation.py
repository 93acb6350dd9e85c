"""Adapt a stream to a policy, online ([DyKnow10 §5.3.4, Def. 5.35-5.37], SPEC §1).

The output is a maximal substream of ``extend(f, p)`` that satisfies p: samples are dropped or
delayed, and invented only by ``use most recent``. Each sample of the input is used at most once.
`satisfaction` is the definition; tests/laws compares the two.

Four ways to adapt, by what a policy asks for:
- `Filtering`: every sample is decided when it arrives;
- `Reordering` (reordering.py): monotone or strict order with a finite delay holds samples back;
- `Chain` (sample_chain.py): ``sample every`` passes on the samples of one grid, in order;
- `Approximating` (approximation.py): ``use most recent`` makes the samples of a grid.

When a decision falls: after a batch whose last available time is T all is *known* up to T - 1,
since more samples of that instant may come; after a watermark w up to w - 1; after the end all.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..sample import FieldType, Mask, SampleBatch, Times, concatenate
from ..stream_rules import Rules
from ..time import TIME_MAX, TIME_MIN
from ..time_arithmetic import earlier
from .constraints import differs
from .policy import AnyChange, ChangeBy, Constraint, Order, Policy, PolicyCounters

REASONS: tuple[Constraint, ...] = tuple(Constraint)
"""A reason's code is its position here."""
CODES = {constraint: code for code, constraint in enumerate(REASONS)}
KEPT = -1
"""The code of a sample that no constraint has dropped."""
Reasons = NDArray[np.int8]


@dataclass(frozen=True, slots=True, eq=False)
class Dropped:
    """Samples that were not passed on: why (codes of `REASONS`) and when that was decided (ns),
    each shape ``(n,)``; by the moment of the decision, then by available time."""

    batch: SampleBatch
    reasons: Reasons
    at: Times


OnDrop = Callable[[Dropped], None]


class Adaptation(ABC):
    """Adapts one stream to one policy.

    Contract: batches come in order of available time, watermarks and the end between them.

    Law: what is sent and dropped does not depend on how the input was cut into batches; it is
    maximal among what satisfies the policy. The available times of sent samples do not decrease,
    and after a watermark w none is sent with an available time < w.
    """

    def __init__(
        self, policy: Policy, on_drop: OnDrop | None = None, rules: Rules | None = None
    ) -> None:
        self.policy = policy
        self._rules = Rules() if rules is None else rules
        self.counters = PolicyCounters()
        self._on_drop = on_drop

    @abstractmethod
    def push(self, batch: SampleBatch) -> list[SampleBatch]:
        """Take samples; returns those that can be sent now."""

    @abstractmethod
    def advance(self, watermark: int) -> list[SampleBatch]:
        """Promise that later samples have available time ≥ ``watermark``; returns those to send."""

    @abstractmethod
    def end(self) -> list[SampleBatch]:
        """End the stream (a later `push` continues it); returns the rest."""

    def _inadmissible(self, batch: SampleBatch) -> Reasons:
        """`KEPT`, or why a sample can never be part of the output: duration, then delay."""
        reasons = np.full(len(batch), KEPT, np.int8)
        duration, delay = self.policy.duration, self.policy.max_delay
        if delay is not None:
            too_late = earlier(batch.available, delay) > batch.valid
            reasons[too_late] = CODES[Constraint.DELAY]
        # The duration is written last, since it is the reason where a sample breaks both.
        if duration.first > TIME_MIN:
            reasons[batch.valid < duration.first] = CODES[Constraint.DURATION]
        if duration.last < TIME_MAX:
            reasons[batch.valid > duration.last] = CODES[Constraint.DURATION]
        return reasons

    def _drop(self, batch: SampleBatch, reasons: Reasons, at: Times) -> None:
        """Count and tell the rows of ``batch`` whose reason is not `KEPT`."""
        dropped = np.flatnonzero(reasons != KEPT)
        if not len(dropped):
            return
        counts = np.bincount(reasons[dropped], minlength=len(REASONS))
        for constraint, count in zip(REASONS, counts.tolist(), strict=True):
            self.counters.drop(constraint, count)
        if self._on_drop is not None:
            order = dropped[np.lexsort((batch.available[dropped], at[dropped]))]
            self._on_drop(Dropped(batch.take(order), reasons[order], at[order]))

    def _sent(self, batch: SampleBatch, delayed: int = 0) -> list[SampleBatch]:
        self.counters.sent += len(batch)
        self.counters.delayed += delayed
        return [batch] if len(batch) else []


class Filtering(Adaptation):
    """Decides each sample when it arrives: any order, an order without a bound on delay, or
    ``change by d``.

    To wait for ever would keep nothing, so an order with ``max delay oo`` never waits. With
    ``change by d`` nothing waits: what is news depends on what was sent before.
    Cost: O(n) numpy; ``change by d`` O(n) Python. Memory: the last sample sent.
    """

    def __init__(
        self, policy: Policy, on_drop: OnDrop | None = None, rules: Rules | None = None
    ) -> None:
        super().__init__(policy, on_drop, rules)
        self._passes_all = policy.is_default
        self.kept: Times | None = None
        """Which rows of the last batch were sent; None: all."""
        self._greatest: int | None = None
        self._last: SampleBatch | None = None
        self._numbers: dict[str, Any] | None = None

    def push(self, batch: SampleBatch) -> list[SampleBatch]:
        self.counters.received += len(batch)
        if not len(batch):
            return []
        if not self._passes_all:
            batch = self._kept(batch)
        self.counters.kept += len(batch)
        return self._sent(batch)

    def advance(self, watermark: int) -> list[SampleBatch]:
        return []

    def end(self) -> list[SampleBatch]:
        return []

    def _kept(self, batch: SampleBatch) -> SampleBatch:
        reasons = self._inadmissible(batch)
        # `change by` decides on order, too, as both depend on the last sample that was sent.
        if isinstance(self.policy.change, ChangeBy):
            self._drop_without_news(batch, reasons, self.policy.change.difference)
        elif self.policy.order is not Order.ANY:
            self._drop_out_of_order(batch, reasons)
        if isinstance(self.policy.change, AnyChange):
            self._drop_unchanged(batch, reasons)
        kept = np.flatnonzero(reasons == KEPT)
        self.kept = None if len(kept) == len(batch) else kept
        if len(kept) == len(batch):
            return batch
        self._drop(batch, reasons, batch.available)
        return batch.take(kept)

    def _drop_out_of_order(self, batch: SampleBatch, reasons: Reasons) -> None:
        """A sample is in order if no admissible one before it is valid later (or as late)."""
        rows = np.flatnonzero(reasons == KEPT)
        if not len(rows):
            return
        valid = batch.valid if len(rows) == len(batch) else batch.valid[rows]
        monotone = self.policy.order is Order.MONOTONE
        rises = valid[1:] >= valid[:-1] if monotone else valid[1:] > valid[:-1]
        begin, least = int(valid[0]), self._greatest
        if (least is None or begin > least or (monotone and begin == least)) and rises.all():
            self._greatest = int(valid[-1])
            return
        # What is dropped is below what was sent, so the greatest so far is the last sent.
        greatest = np.maximum.accumulate(valid)
        before = np.concatenate((valid[:1], greatest[:-1]))
        first = self._greatest is None
        if self._greatest is not None:
            np.maximum(before, self._greatest, out=before)
            before[0] = self._greatest
        wrong = valid < before if monotone else valid <= before
        # No sample was sent before the first one, so it breaks no order.
        if first:
            wrong[0] = False
        reasons[rows[wrong]] = CODES[Constraint.ORDER]
        last = int(greatest[-1])
        self._greatest = last if self._greatest is None else max(last, self._greatest)

    def _drop_without_news(self, batch: SampleBatch, reasons: Reasons, difference: float) -> None:
        """One by one: order and difference are both judged by the last sample that was sent."""
        rows = np.flatnonzero(reasons == KEPT)
        kinds = (FieldType.INTEGER, FieldType.FLOAT)
        fields = {n: c.take(rows).tolist() for n, c in batch.columns.items() if c.type in kinds}
        order, greatest = self.policy.order, self._greatest
        last: list[Any] | None = None
        if self._numbers is not None:
            last = [self._numbers.get(name) for name in fields]
        for at, (row, valid) in enumerate(
            zip(rows.tolist(), batch.valid[rows].tolist(), strict=True)
        ):
            numbers = [values[at] for values in fields.values()]
            if greatest is not None and (
                (order is not Order.ANY and valid < greatest)
                or (order is Order.STRICT and valid == greatest)
            ):
                reasons[row] = CODES[Constraint.ORDER]
            elif last is not None and not any(
                differs(before, then, difference)
                for before, then in zip(last, numbers, strict=True)
            ):
                reasons[row] = CODES[Constraint.CHANGE_BY]
            else:
                greatest, last = valid, numbers
        self._greatest = greatest
        if last is not None:
            self._numbers = dict(zip(fields, last, strict=True))

    def _drop_unchanged(self, batch: SampleBatch, reasons: Reasons) -> None:
        rows = np.flatnonzero(reasons == KEPT)
        if not len(rows):
            return
        candidates = batch if len(rows) == len(batch) else batch.take(rows)
        # One that is dropped equals the last sent, so each is compared with the one before it.
        unchanged = repeats(candidates, self._last)
        reasons[rows[unchanged]] = CODES[Constraint.CHANGE]
        # If the last one was dropped, it equals the last one sent, so either will do.
        self._last = batch.take(rows[-1:])


def repeats(batch: SampleBatch, last: SampleBatch | None) -> Mask:
    """Which samples equal the one before them in valid time and all values (no_value equals
    no_value); the first is compared with ``last``, a batch of one."""
    same = np.zeros(len(batch), np.bool_)
    if last is not None and len(batch) and batch.valid[0] == last.valid[0]:
        same[0] = repeats(concatenate([last, batch.take(slice(0, 1))]), None)[1]
    if len(batch) < 2:
        return same
    after = same[1:]
    np.equal(batch.valid[1:], batch.valid[:-1], out=after)
    for column in batch.columns.values():
        if not bool(after.any()):
            break
        equal = column.values[1:] == column.values[:-1]
        if column.null is not None:
            both = column.null[1:] & column.null[:-1]
            equal = both | (equal & ~column.null[1:] & ~column.null[:-1])
        after &= equal
    return same


def own(batch: SampleBatch) -> SampleBatch:
    """A copy of a few rows: a view would keep the whole batch they were cut from in memory."""
    return batch.take(np.arange(len(batch)))


def joined(parts: Sequence[SampleBatch]) -> SampleBatch:
    """`concatenate` without the empty ones; at least one part is given."""
    filled = [part for part in parts if len(part)]
    return concatenate(filled) if filled else parts[0]
