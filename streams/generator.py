"""Stream generators: one per process output, serving any number of subscriptions
([DyKnow10 Def. 4.8], SPEC §1).

A generator turns what a process offers into a fluent stream: it stamps or checks available
times, holds back what may still be overtaken within the declared lateness, counts every sample
exactly once, keeps history, and hands the stream on to its subscribers together with a
*watermark*.

Contract of a watermark ``w``: every sample that comes later has available time ≥ ``w``. So after a
sample available at T more samples of that instant may come until the watermark is greater than T.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from .history import FluentStream, Retention
from .instants import repeated
from .rules import Rules
from .sample import (
    Content,
    Field,
    Mask,
    SampleBatch,
    SampleError,
    Schema,
    Times,
    concatenate,
    contents,
    empty_batch,
    widened,
)
from .string_pool import StringPool
from .time import HOUR, TIME_MAX, TIME_MIN


class Receiver(Protocol):
    """Whoever subscribes: gets the stream's samples in order of available time."""

    @property
    def knows_codes(self) -> bool:
        """Whether it keeps codes of the stream's texts beyond a call, so that they have to stay."""

    def receive(self, source: StreamGenerator, batch: SampleBatch) -> None:
        """Samples continue the stream; none of the batch has been seen before."""

    def advance(self, source: StreamGenerator, watermark: int) -> None:
        """Every later sample of ``source`` has available time ≥ ``watermark``."""

    def ended(self, source: StreamGenerator) -> None:
        """``source`` has come to its end (it may be taken up again by a later sample)."""

    def resumed(self, source: StreamGenerator) -> None:
        """``source`` had ended and goes on; told to everybody before its samples are."""

    def idleness_changed(self, source: StreamGenerator) -> None:
        """``source`` has fallen idle, or speaks again (told before its samples): its `is_idle`."""


class Listener(Protocol):
    """Whoever looks on from outside: what is made does not depend on it, and a copy of a generator
    has none."""

    def receive(self, source: StreamGenerator, batch: SampleBatch) -> None:
        """Samples continue the stream."""

    def ended(self, source: StreamGenerator) -> None:
        """``source`` has come to its end (it may be taken up again by a later sample)."""


@dataclass(slots=True)
class Counters:
    """Where accepted samples went. Law: accepted = used + late + duplicate + expired + pending.

    ``ahead`` counts batches that were refused because of `StreamGenerator.ahead`: none of their
    samples is among the accepted ones.
    """

    accepted: int = 0
    used: int = 0
    late: int = 0
    duplicate: int = 0
    expired: int = 0
    pending: int = 0
    ahead: int = 0


class StreamGenerator:
    """The one owner of a stream: order, counters, history, subscriptions.

    ``lateness`` (ns): how far behind the greatest available time a sample may still arrive.
    Samples stamped on arrival are never late. ``idle`` (ns): after how long without samples the
    stream is not waited for, by the clock of whoever calls `fall_idle`; None: it always is.
    ``ahead`` (ns): how far ahead of the clock a sample may be stamped that comes from outside;
    the service judges it (`engine/configuration/ingest`), the generator takes what it is offered.
    ``rules`` are those of all streams of an engine.

    Law (tests/laws): the stream, its counters and its watermark do not depend on how the offered
    samples were cut into batches; they equal the sample-by-sample definition.

    Cost: O(n) numpy a batch in strict order, O(n log n) one with equal times or out of order; where
    the last instant goes on in another batch, Python for each row of it. Memory: the history's
    retention, what is pending within the lateness, and the rows of an instant that goes on.
    """

    def __init__(
        self,
        name: str,
        schema: Schema,
        *,
        lateness: int = 0,
        idle: int | None = None,
        ahead: int = HOUR,
        retention: Retention | None = None,
        pools: dict[str, StringPool] | None = None,
        first: int = 1,
        rules: Rules | None = None,
    ) -> None:
        self.name = name
        self.rules = Rules() if rules is None else rules
        self.stream = FluentStream(schema, retention, pools, first)
        self.lateness = lateness
        self.idle = idle
        self.ahead = ahead
        self.counters = Counters()
        self.stamped: bool | None = None
        """Whether the samples are stamped on arrival; None before the first one."""
        self.watermark: int | None = None
        """None until the stream has begun: a stream that never spoke holds nobody back."""
        self.is_ended = False
        self.is_idle = False
        """Whether others wait for it no longer, until it speaks again."""
        self.late_stream: StreamGenerator | None = None
        """Takes the late samples, if somebody asked for them."""
        self.ends_at: int | None = None
        """What is available later (ns) is not for those who follow the object that it is of."""
        self.is_void = False
        """Whether another stream takes its place and says all of it anew."""
        self._greatest: int | None = None
        self._pending: SampleBatch | None = None
        self._taken: set[Content] | None = None
        """The rows of the last instant, if that has gone on in another batch."""
        self.on_followed: Callable[[bool], None] | None = None
        """Told before the first subscription (True), and when the last has ended (False)."""
        self._receivers: list[Receiver] = []
        self._known_fields: dict[Receiver, tuple[str, ...]] = {}
        """The fields of receivers that subscribed before the stream got further ones."""
        self._listeners: list[Listener] = []

    def __getstate__(self) -> dict[str, object]:
        return {**self.__dict__, "_listeners": []}

    @property
    def schema(self) -> Schema:
        return self.stream.schema

    @property
    def is_open(self) -> bool:
        """Whether nobody has said yet which fields the stream has: its first samples will."""
        return not self.stream.schema.fields

    def adopt(self, schema: Schema, pools: Mapping[str, StringPool]) -> None:
        """Give an open stream its fields, and the pools of its text fields.

        Raises `SampleError` when the stream has other fields already.
        """
        if self.is_open:
            self.stream.schema = schema
            self.stream.pools.update(pools)
            if self.late_stream is not None:
                self.late_stream.adopt(schema, pools)
        elif schema != self.schema:
            raise SampleError(
                f"stream {self.name!r} has the fields {_fields(self.schema)}, not {_fields(schema)}"
            )

    def widen(self, schema: Schema) -> None:
        """Add fields to a stream in use. Kept and pending samples have no_value in them; receivers
        that subscribed earlier go on with the fields that they know.

        Contract: ``schema`` has every field of the stream, which is not open.
        """
        for receiver in self._receivers:
            self._known_fields.setdefault(receiver, self.schema.names)
        self.stream.widen(schema)
        self._taken = None
        if self._pending is not None:
            self._pending = widened(self._pending, schema, self.stream.pools)
        if self.late_stream is not None:
            self.late_stream.widen(schema)

    def is_narrow_for(self, receiver: Receiver) -> bool:
        """Whether the stream has fields that ``receiver``, which came earlier, does not get."""
        return receiver in self._known_fields

    @property
    def subscribers(self) -> int:
        """How many subscriptions the generator serves."""
        return len(self._receivers)

    @property
    def listeners(self) -> int:
        """How many listen from outside."""
        return len(self._listeners)

    def listen(self, listener: Listener) -> None:
        """Tell ``listener`` of what comes from now on."""
        self._listeners.append(listener)

    def leave(self, listener: Listener) -> None:
        """Tell ``listener`` no longer."""
        self._listeners.remove(listener)

    def subscribe(self, receiver: Receiver) -> None:
        """Serve ``receiver`` from now on; it is told the watermark that holds already, and whether
        the stream is idle."""
        if self.on_followed is not None and not self._receivers:
            self.on_followed(True)
        self._receivers.append(receiver)
        if self.watermark is not None:
            receiver.advance(self, self.watermark)
        if self.is_idle:
            receiver.idleness_changed(self)

    def unsubscribe(self, receiver: Receiver) -> None:
        """Serve ``receiver`` no longer."""
        self._receivers.remove(receiver)
        self._known_fields.pop(receiver, None)
        if self.on_followed is not None and not self._receivers:
            self.on_followed(False)

    @property
    def pending(self) -> SampleBatch:
        """What is held back within the lateness."""
        if self._pending is None:
            return empty_batch(self.schema, self.stream.pools)
        return self._pending

    def go_on(
        self,
        batch: SampleBatch,
        first: int,
        pending: int,
        counters: Counters,
        *,
        stamped: bool | None,
        watermark: int | None,
        is_ended: bool,
        complete_since: int | None,
    ) -> None:
        """Be what another was that kept ``batch``, whose first sample has number ``first`` and of
        which the last ``pending`` ones were held back. Contract: nobody has used this one yet."""
        count = len(batch) - pending
        self.stream.go_on(batch.take(slice(0, count)), first, complete_since)
        self.counters, self.stamped = counters, stamped
        self.watermark, self.is_ended = watermark, is_ended
        self._greatest = self.stream.last_available
        if pending:
            self._pending = batch.take(slice(count, None))
            self._greatest = int(self._pending.available[-1])

    def offer(self, batch: SampleBatch, now: int | None = None) -> int:
        """Take a sender's samples; returns how many were accepted (all of them).

        With ``now`` (ns) the samples are stamped with it on arrival, all with one instant, which is
        later than that of every earlier batch. Otherwise they bring their own available times, in
        any order within the lateness; what comes later than that, or before a watermark, is counted
        as late and not used; `late_stream` gets it. A row equal to one already taken is counted as
        a duplicate and not used, as long as its available time is not late. Raises `SampleError`,
        taking nothing, when stamping would pass the end of 64-bit time.
        """
        return self._offer(batch, now, distinct=True)

    def emit(self, batch: SampleBatch) -> None:
        """Take what a unit has made, with the available times that it gives. Two equal samples are
        two samples (SPEC §4: bag, not set)."""
        self._offer(batch, None, distinct=self.rules.gap > 0)

    def _offer(self, batch: SampleBatch, now: int | None, *, distinct: bool) -> int:
        if not len(batch):
            return 0
        stamps = None if now is None else self._stamps(len(batch), now)
        if self.is_open:
            self._adopt_from(batch)
        batch = self.stream.encoded(batch)
        self.stamped = stamps is not None
        self.resume()
        self.wake()
        self.counters.accepted += len(batch)
        if stamps is not None:
            self._release(batch.with_available(stamps))
            if not self.rules.gap:
                self._announce(min(int(stamps[-1]), TIME_MAX - 1) + 1)
            return len(batch)
        kept = self._admit(batch, distinct=distinct)
        if len(kept):
            self._pending = kept if self._pending is None else concatenate([self._pending, kept])
            self._pending = _in_order(self._pending)
        self._flush_until(self._due())
        return len(batch)

    def promise_after(self, batch: SampleBatch) -> int:
        """The watermark that ``batch``, the last one, implies by itself."""
        return int(batch.available[-1]) + self.rules.gap

    def advance(self, watermark: int) -> None:
        """Promise that every later sample has available time ≥ ``watermark``.

        The clock does so for an idle stream that is stamped on arrival, a unit for its output.
        A promise that says less than an earlier one changes nothing. What is pending below the
        watermark is released first: nothing can overtake it any more.
        """
        watermark = min(watermark, TIME_MAX)  # whoever knows all up to it says one more
        if self.watermark is not None and watermark <= self.watermark:
            return
        if self._pending is not None:
            self._release_first(int(np.searchsorted(self._pending.available, watermark, "left")))
        self._announce(watermark)

    def end(self) -> None:
        """The stream has come to its end: what is pending is released, subscribers are told."""
        self._flush_until(TIME_MAX)
        self.is_ended, self.is_idle = True, False
        for receiver in tuple(self._receivers):
            receiver.ended(self)
        for listener in tuple(self._listeners):
            listener.ended(self)
        if self.late_stream is not None:
            self.late_stream.end()

    def resume(self) -> None:
        """The stream goes on after its end: whoever reads it waits for it again."""
        if self.is_ended:
            self.is_ended = False
            for receiver in tuple(self._receivers):
                receiver.resumed(self)
            if self.late_stream is not None:
                self.late_stream.resume()

    def fall_idle(self) -> None:
        """The stream says nothing: whoever reads others too does not wait for it any more.

        What is pending is released first, so that it still comes in time; what is available before
        that is late from now on.
        """
        if self._greatest is not None:
            self._flush_until(self._greatest)
        self._set_idle(True)

    def wake(self) -> None:
        """The stream speaks again, and is waited for."""
        self._set_idle(False)

    def stamps_at(self, moments: Times) -> Times:
        """Available times for samples that come to be at ``moments`` (ns, in order): each its own,
        but none before the watermark or the sample before it."""
        last, gap = self.stream.last_available, self.rules.gap
        least = TIME_MIN if last is None else min(last, TIME_MAX - gap) + gap
        if self.watermark is not None:
            least = max(least, self.watermark)
        if not gap:
            return np.maximum(moments, least)
        if moments[0] >= least and _increases(moments):
            return moments
        count = len(moments)
        steps = np.arange(count, dtype=np.int64)
        # As far from the ends of 64-bit time as the steps may lead.
        room = np.clip(np.maximum(moments, least), TIME_MIN + count, TIME_MAX - count)
        return np.maximum.accumulate(room - steps) + steps

    def close(self) -> None:
        """The stream is removed: what is still pending is counted as expired."""
        self.counters.expired += self.counters.pending
        self.counters.pending = 0
        self._pending = None

    def pass_late_to(self, side: StreamGenerator) -> None:
        """From now on ``side``, which has the same fields, gets the samples that are late."""
        self.late_stream = side
        if self.watermark is not None:
            side.advance(self.watermark)
        if self.is_ended:
            side.end()

    def _set_idle(self, is_idle: bool) -> None:
        if self.is_idle != is_idle:
            self.is_idle = is_idle
            for receiver in tuple(self._receivers):
                receiver.idleness_changed(self)

    def _adopt_from(self, batch: SampleBatch) -> None:
        fields = tuple(Field(name, column.type) for name, column in batch.columns.items())
        pools = {n: column.pool for n, column in batch.columns.items() if column.pool is not None}
        self.adopt(Schema(fields), pools)

    def _stamps(self, count: int, now: int) -> Times:
        """The available times of ``count`` samples that come ``now``, after every earlier one."""
        last = self.stream.last_available
        start = now if last is None else max(now, last + 1)
        if self._pending is not None:
            start = max(start, int(self._pending.available[-1]) + 1)
        if self.watermark is not None:  # a clock that is set back breaks no promise
            start = max(start, self.watermark)
        gap = self.rules.gap
        if start > TIME_MAX - max(1, count * gap):
            raise SampleError("the stream's available times have reached the end of 64-bit time")
        return start + gap * np.arange(count, dtype=np.int64)

    def _due(self) -> int:
        """Pending samples up to this available time can no longer be overtaken."""
        greatest = TIME_MIN if self._greatest is None else self._greatest
        return max(TIME_MIN, greatest - self.lateness)

    def _admit(self, batch: SampleBatch, *, distinct: bool) -> SampleBatch:
        """Drop and count what is late or a duplicate, each judged by all samples before it."""
        available = batch.available
        before = TIME_MIN if self._greatest is None else self._greatest
        first = int(available[0])
        in_order = _increases if distinct else _never_falls
        if (
            (self._greatest is None or first > before)
            and (self.watermark is None or first >= self.watermark)
            and in_order(available)
        ):  # the common case: nothing is late, nothing can be there already
            self._greatest = int(available[-1])
            return batch
        greatest = np.maximum.accumulate(np.concatenate(([before], available)))
        self._greatest = int(greatest[-1])
        # Compare without subtracting from the smallest int64, which would wrap around.
        limit = np.where(
            greatest[:-1] < TIME_MIN + self.lateness, TIME_MIN, greatest[:-1] - self.lateness
        )
        late = available < limit
        if self.watermark is not None:
            late |= available < self.watermark
        if bool(late.any()):
            self.counters.late += int(late.sum())
            if self.late_stream is not None:
                self._pass_late(self.late_stream, batch.take(late), greatest[:-1][late])
            batch = batch.take(~late)
        if not distinct or not len(batch):
            return batch
        again = self._has_taken_time(batch) if self.rules.gap else self._is_duplicate(batch)
        count = int(np.count_nonzero(again))
        self.counters.duplicate += count
        return batch.take(~again) if count else batch

    def _is_duplicate(self, batch: SampleBatch) -> Mask:
        """Which rows equal one of the last instant, of what is pending, or before them."""
        last = self.stream.last_available
        if last is None or not bool((goes_on := batch.available == last).any()):
            return repeated(self.pending, batch)
        if self._taken is None:
            self._taken = set(contents(self.stream.between(last, last)))
        found = np.zeros(len(batch), np.bool_)
        rows = np.flatnonzero(goes_on)
        for row, content in zip(rows.tolist(), contents(batch.take(rows)), strict=True):
            found[row] = content in self._taken
            self._taken.add(content)
        if len(rows) < len(batch):
            found[~goes_on] = repeated(self.pending, batch.take(~goes_on))
        return found

    def _has_taken_time(self, batch: SampleBatch) -> Mask:
        """Which rows have the available time of another, by `UNIQUE_TIMES`."""
        taken = np.ones(len(batch), np.bool_)
        _, earliest = np.unique(batch.available, return_index=True)
        taken[earliest] = False
        known = [] if self._pending is None else [self._pending.available]
        if self.stream.last_available is not None:
            known.append(np.array([self.stream.last_available], np.int64))
        if known:
            taken |= np.isin(batch.available, np.concatenate(known))
        return taken

    def _pass_late(self, side: StreamGenerator, batch: SampleBatch, reached: Times) -> None:
        """Late samples go on with their valid times and values. Each is available when it came, in
        the time of the stream: that is the greatest available time ``reached`` before it, or the
        watermark where that is further (`stamps_at`)."""
        if self.watermark is not None:
            reached = np.maximum(reached, self.watermark)
        side.emit(batch.with_available(side.stamps_at(reached)))

    def _flush_until(self, due: int) -> None:
        """Release the pending samples with available time ≤ ``due``, then say so."""
        if self._pending is not None:
            self._release_first(int(np.searchsorted(self._pending.available, due, "right")))
        if due != TIME_MAX:
            self._announce(due)

    def _release_first(self, count: int) -> None:
        """Release the first ``count`` pending samples."""
        pending = self._pending
        assert pending is not None
        self._pending = pending.take(slice(count, None)) if count < len(pending) else None
        self.counters.pending = len(pending) - count
        if count:
            self._release(pending.take(slice(0, count)))

    def _release(self, batch: SampleBatch) -> None:
        if batch.available[-1] != self.stream.last_available:
            self._taken = None
        self.stream.append(batch)
        self.counters.used += len(batch)
        self._greatest = (
            int(batch.available[-1])
            if self._greatest is None
            else max(self._greatest, int(batch.available[-1]))
        )
        for receiver in tuple(self._receivers):
            names = self._known_fields.get(receiver)
            receiver.receive(self, batch if names is None else batch.select(names))
        for listener in tuple(self._listeners):
            listener.receive(self, batch)
        self.forget_texts()
        self._announce(int(batch.available[-1]))

    def forget_texts(self) -> None:
        """Forget texts that nothing kept or held back has, where most are of that kind and no
        receiver knows codes. Cost: O(receivers), and what `FluentStream.forget_texts` costs."""
        if any(receiver.knows_codes for receiver in self._receivers):
            return
        held = 0 if self._pending is None else len(self._pending)
        if self.stream.forget_texts(held) and self._pending is not None:
            self._pending = self.stream.encoded(self._pending)

    def _announce(self, watermark: int) -> None:
        """Tell the subscribers of a watermark that says more than the last one."""
        if self.watermark is None or watermark > self.watermark:
            self.watermark = watermark
            for receiver in tuple(self._receivers):
                receiver.advance(self, watermark)
            if self.late_stream is not None:
                # What is late from now on comes when the stream has got so far.
                self.late_stream.advance(watermark)


def _fields(schema: Schema) -> str:
    return ", ".join(f"{field.name}: {field.type}" for field in schema.fields) or "none"


def _increases(available: Times) -> bool:
    return len(available) < 2 or bool((available[1:] > available[:-1]).all())


def _never_falls(available: Times) -> bool:
    return bool((available[1:] >= available[:-1]).all())


def _in_order(batch: SampleBatch) -> SampleBatch:
    """``batch`` by available time."""
    if _never_falls(batch.available):
        return batch
    return batch.take(np.argsort(batch.available, kind="stable"))
