"""Stream generators: one per process output, serving any number of subscriptions
([DyKnow10 Def. 4.8], SPEC §1).

A generator turns what a process offers into a fluent stream: it stamps or checks available
times, holds back what may still be overtaken within the declared lateness, counts every sample
exactly once, keeps history, and hands the stream on to its subscribers together with a
*watermark*.

Contract of a watermark ``w``: every sample that comes later has available time ≥ ``w``. So after a
sample available at T more samples of that instant may come until the watermark is greater than T.

The class is long, since each batch changes order, counters, history and promise at once.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from .duplicates import Duplicates
from .history import FluentStream, Retention
from .sample import (
    Field,
    SampleBatch,
    SampleError,
    Schema,
    Times,
    concatenate,
    empty_batch,
    widened,
)
from .stream_rules import Rules
from .string_pool import StringPool
from .time import HOUR, TIME_MAX, TIME_MIN


class Receiver(Protocol):
    """A subscription: it receives the stream's samples in order of available time."""

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
        """``source`` had ended and goes on; called before its new samples come."""

    def idleness_changed(self, source: StreamGenerator) -> None:
        """``source`` has become idle, or active again (before its samples come): see `is_idle`."""


class Listener(Protocol):
    """An observer from outside. No result depends on it, and a copy of a generator has none."""

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
    Samples stamped on arrival are never late. ``idle`` (ns): after this time without samples others
    stop to wait for the stream, by the clock of the caller of `fall_idle`; None: never.
    ``ahead`` (ns): how far ahead of the clock an outside sample may be stamped.
    `engine/configuration/ingest` checks this limit, the generator does not.
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
        self._stream = FluentStream(schema, retention, pools, first)
        self.lateness = lateness
        self.idle = idle
        self.ahead = ahead
        self._counters = Counters()
        self.stamped: bool | None = None
        """Whether the samples are stamped on arrival; None before the first one."""
        self._watermark: int | None = None
        self.is_ended = False
        self.is_idle = False
        """Whether others stopped to wait for it, until its next sample."""
        self.late_stream: StreamGenerator | None = None
        """Receives the late samples; None: no subscription asks for them."""
        self.ends_at: int | None = None
        """Samples available later (ns) do not belong to the object's life that others follow."""
        self.is_void = False
        """Whether another stream replaces it and repeats all its samples."""
        self._greatest: int | None = None
        self._pending: SampleBatch | None = None
        self._duplicates = Duplicates(self.rules)
        self.on_followed: Callable[[bool], None] | None = None
        """Called before the first subscription (True) and after the last one has ended (False)."""
        self.on_read: Callable[[bool], None] | None = None
        """Called before the first subscription or listener (True), after the last one (False)."""
        self.catch_up: Callable[[], None] | None = None
        """Called before the samples, the counters or the watermark are looked at: a unit may wait
        so long to emit the samples of a stream that has no readers."""
        self._receivers: list[Receiver] = []
        self._known_fields: dict[Receiver, tuple[str, ...]] = {}
        """The fields of receivers that subscribed before the stream got further ones."""
        self._listeners: list[Listener] = []

    def __getstate__(self) -> dict[str, object]:
        return {**self.__dict__, "_listeners": []}

    @property
    def stream(self) -> FluentStream:
        """The samples."""
        self._before_look()
        return self._stream

    @property
    def counters(self) -> Counters:
        """Where the samples went."""
        self._before_look()
        return self._counters

    @property
    def watermark(self) -> int | None:
        """None until the stream has begun: a stream without samples holds no other one back."""
        self._before_look()
        return self._watermark

    def _before_look(self) -> None:
        if self.catch_up is not None:
            self.catch_up()

    @property
    def is_constant(self) -> bool:
        """Whether it ended with a single sample ([Introspection15 §3.1])."""
        return self.is_ended and self._counters.used == 1

    @property
    def schema(self) -> Schema:
        return self._stream.schema

    @property
    def is_open(self) -> bool:
        """Whether the stream has no fields yet: its first samples define them."""
        return not self._stream.schema.fields

    def adopt(self, schema: Schema, pools: Mapping[str, StringPool]) -> None:
        """Give an open stream its fields, and the pools of its text fields.

        Raises `SampleError` when the stream has other fields already.
        """
        if self.is_open:
            self._stream.schema = schema
            self._stream.pools.update(pools)
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
            # A receiver keeps the fields of its subscription, also if the stream widens again.
            self._known_fields.setdefault(receiver, self.schema.names)
        self._stream.widen(schema)
        self._duplicates.forget()
        if self._pending is not None:
            self._pending = widened(self._pending, schema, self._stream.pools)
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
        """How many listeners there are."""
        return len(self._listeners)

    def listen(self, listener: Listener) -> None:
        """Pass what comes from now on to ``listener``, too."""
        self._begin_reading()
        self._listeners.append(listener)

    def leave(self, listener: Listener) -> None:
        """Remove ``listener``."""
        self._listeners.remove(listener)
        self._end_reading()

    def subscribe(self, receiver: Receiver) -> None:
        """Serve ``receiver`` from now on. It receives the current watermark at once, and learns if
        the stream is idle."""
        self._begin_reading()
        if self.on_followed is not None and not self._receivers:
            self.on_followed(True)
        self._receivers.append(receiver)
        if self._watermark is not None:
            receiver.advance(self, self._watermark)
        if self.is_idle:
            receiver.idleness_changed(self)

    def unsubscribe(self, receiver: Receiver) -> None:
        """Serve ``receiver`` no longer."""
        self._receivers.remove(receiver)
        self._known_fields.pop(receiver, None)
        if self.on_followed is not None and not self._receivers:
            self.on_followed(False)
        self._end_reading()

    def _begin_reading(self) -> None:
        if self.on_read is not None and not self._receivers and not self._listeners:
            self.on_read(True)

    def _end_reading(self) -> None:
        if self.on_read is not None and not self._receivers and not self._listeners:
            self.on_read(False)

    @property
    def pending(self) -> SampleBatch:
        """What is held back within the lateness."""
        if self._pending is None:
            return empty_batch(self.schema, self._stream.pools)
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
        """Take over the state of another generator. It kept ``batch``, whose first sample has
        number ``first``, and held back the last ``pending`` ones. Contract: this one is unused."""
        count = len(batch) - pending
        self._stream.go_on(batch.take(slice(0, count)), first, complete_since)
        self._counters, self.stamped = counters, stamped
        self._watermark, self.is_ended = watermark, is_ended
        self._greatest = self._stream.last_available
        if pending:
            self._pending = batch.take(slice(count, None))
            self._greatest = int(self._pending.available[-1])

    def offer(
        self, batch: SampleBatch, now: int | None = None, *, stamps_valid: bool = False
    ) -> int:
        """Take a sender's samples; returns how many were accepted (all of them).

        With ``now`` (ns) the samples are stamped with it on arrival, all with one instant, which is
        later than that of every earlier batch; with ``stamps_valid`` it is their valid time, too.
        Otherwise they bring their own available times, in any order within the lateness; what comes
        later than that, or before a watermark, is counted as late and not used; `late_stream` gets
        it. A row equal to one already taken is counted as a duplicate and not used, as long as its
        available time is not late. Raises `SampleError`, taking nothing, when stamping would pass
        the end of 64-bit time.
        """
        return self._offer(batch, now, distinct=True, stamps_valid=stamps_valid)

    def emit(self, batch: SampleBatch) -> None:
        """Take what a unit has made, with the available times that it gives. Two equal samples are
        two samples (SPEC §4: bag, not set)."""
        self._offer(batch, None, distinct=self.rules.gap > 0)

    def _offer(
        self, batch: SampleBatch, now: int | None, *, distinct: bool, stamps_valid: bool = False
    ) -> int:
        if not len(batch):
            return 0
        stamps = None if now is None else self._stamps(len(batch), now)
        if self.is_open:
            self._adopt_from(batch)
        batch = self._stream.encoded(batch)
        self.stamped = stamps is not None
        # Late samples and duplicates, too, show that the sender is not silent.
        self.wake()
        self._counters.accepted += len(batch)
        if stamps is not None:
            self.resume()
            valid = stamps if stamps_valid else batch.valid
            self._release(SampleBatch(stamps, valid, batch.columns))
            # A batch that is stamped on arrival is a whole instant, so the promise goes past it.
            if not self.rules.gap:
                self._announce(min(int(stamps[-1]), TIME_MAX - 1) + 1)
            return len(batch)
        kept, due = self._admit(batch, distinct=distinct), self._due()
        if len(kept):
            # Only a sample that is used continues an ended stream; late ones and duplicates do not.
            self.resume()
            if self._pending is None and kept.available[-1] <= due:
                self._release(kept)
            elif self._pending is None:
                self._pending = kept
            else:
                self._pending = _in_order(concatenate([self._pending, kept]))
        self._flush_until(due)
        return len(batch)

    def promise_after(self, batch: SampleBatch) -> int:
        """The watermark that ``batch``, the last one, implies by itself."""
        return int(batch.available[-1]) + self.rules.gap

    def advance(self, watermark: int) -> None:
        """Promise that every later sample has available time ≥ ``watermark``.

        The clock does so for an idle stream that is stamped on arrival, a unit for its output.
        A smaller watermark than an earlier one changes nothing. Pending samples below the watermark
        are released first: no later sample can overtake them.
        """
        watermark = min(watermark, TIME_MAX)  # "known up to t" is watermark t + 1
        if self._watermark is not None and watermark <= self._watermark:
            return
        if self._pending is not None:
            self._release_first(int(np.searchsorted(self._pending.available, watermark, "left")))
        self._announce(watermark)

    def end(self) -> None:
        """End the stream: release what is pending, then notify the subscribers."""
        self._flush_until(TIME_MAX)
        self.is_ended, self.is_idle = True, False
        for receiver in tuple(self._receivers):
            receiver.ended(self)
        for listener in tuple(self._listeners):
            listener.ended(self)
        if self.late_stream is not None:
            self.late_stream.end()

    def resume(self) -> None:
        """Continue the stream after its end: its readers wait for it again."""
        if self.is_ended:
            self.is_ended = False
            for receiver in tuple(self._receivers):
                receiver.resumed(self)
            if self.late_stream is not None:
                self.late_stream.resume()

    def fall_idle(self) -> None:
        """Make the stream idle: readers of several streams stop to wait for it.

        Pending samples are released first, so that they are not late; samples available before
        these are late from now on.
        """
        if self._greatest is not None:
            self._flush_until(self._greatest)
        self._set_idle(True)

    def wake(self) -> None:
        """The stream is active again: its readers wait for it."""
        self._set_idle(False)

    def stamps_at(self, moments: Times) -> Times:
        """Available times for samples that come to be at ``moments`` (ns, in order): each its own,
        but none before the watermark or the sample before it."""
        last, gap = self._stream.last_available, self.rules.gap
        least = TIME_MIN if last is None else min(last, TIME_MAX - gap) + gap
        if self._watermark is not None:
            least = max(least, self._watermark)
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
        """Remove the stream: count pending samples as expired."""
        self._counters.expired += self._counters.pending
        self._counters.pending = 0
        self._pending = None

    def pass_late_to(self, side: StreamGenerator) -> None:
        """Pass late samples to ``side``, which has the same fields, from now on."""
        self.late_stream = side
        if self._watermark is not None:
            side.advance(self._watermark)
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
        last = self._stream.last_available
        # The next batch is a later instant, even if the clock stands still or is set back.
        start = now if last is None else max(now, last + 1)
        if self._pending is not None:
            start = max(start, int(self._pending.available[-1]) + 1)
        if self._watermark is not None:  # a clock that is set back breaks no promise
            start = max(start, self._watermark)
        gap = self.rules.gap
        if start > TIME_MAX - max(1, count * gap):
            raise SampleError("the stream's available times have reached the end of 64-bit time")
        return start + gap * np.arange(count, dtype=np.int64)

    def _due(self) -> int:
        """Pending samples up to this available time can no longer be overtaken."""
        greatest = TIME_MIN if self._greatest is None else self._greatest
        return max(TIME_MIN, greatest - self.lateness)

    def _admit(self, batch: SampleBatch, *, distinct: bool) -> SampleBatch:
        """Drop and count what is late or a duplicate, each judged by all samples before it; return
        the rest by available time."""
        available = batch.available
        before = TIME_MIN if self._greatest is None else self._greatest
        first = int(available[0])
        # Rows with equal times may be duplicates; only the rows of senders are searched for these.
        in_order = _increases if distinct else _never_falls
        if (
            (self._greatest is None or first > before)
            and (self._watermark is None or first >= self._watermark)
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
        if self._watermark is not None:
            late |= available < self._watermark
        if bool(late.any()):
            self._counters.late += int(late.sum())
            if self.late_stream is not None:
                self._pass_late(self.late_stream, batch.take(late), greatest[:-1][late])
            batch = batch.take(~late)
        if not distinct or not len(batch):
            return _in_order(batch)
        again = self._duplicates.among(batch, self._stream, self.pending)
        count = int(np.count_nonzero(again))
        self._counters.duplicate += count
        return _in_order(batch.take(~again) if count else batch)

    def _pass_late(self, side: StreamGenerator, batch: SampleBatch, reached: Times) -> None:
        """Late samples go on with their valid times and values. Each is available when it came, in
        the time of the stream: that is the greatest available time ``reached`` before it, or the
        watermark where that is further (`stamps_at`)."""
        if self._watermark is not None:
            reached = np.maximum(reached, self._watermark)
        side.emit(batch.with_available(side.stamps_at(reached)))
        # A new sample resumes the late stream, which ends with this one: so it ends again.
        if self.is_ended:
            side.end()

    def _flush_until(self, due: int) -> None:
        """Release the pending samples with available time ≤ ``due``, then announce ``due``."""
        if self._pending is not None:
            self._release_first(int(np.searchsorted(self._pending.available, due, "right")))
        # An end is no promise: a later sample may continue the stream.
        if due != TIME_MAX:
            self._announce(due)

    def _release_first(self, count: int) -> None:
        """Release the first ``count`` pending samples."""
        pending = self._pending
        assert pending is not None
        self._pending = pending.take(slice(count, None)) if count < len(pending) else None
        self._counters.pending = len(pending) - count
        if count:
            self._release(pending.take(slice(0, count)))

    def _release(self, batch: SampleBatch) -> None:
        # Rows that equal one of an earlier instant are late by now, so only the last is remembered.
        if batch.available[-1] != self._stream.last_available:
            self._duplicates.forget()
        self._stream.append(batch)
        self._counters.used += len(batch)
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
        # Between two batches no call holds codes of this stream, so its pools may be replaced.
        self.forget_texts()
        self._announce(int(batch.available[-1]))

    def forget_texts(self) -> None:
        """Forget texts that no kept or pending sample has, if most are of that kind and no receiver
        keeps codes. Cost: O(receivers), and what `FluentStream.forget_texts` costs."""
        if any(receiver.knows_codes for receiver in self._receivers):
            return
        self._pending = self._stream.forget_texts(self._pending)

    def _announce(self, watermark: int) -> None:
        """Send the subscribers a watermark that is greater than the last one."""
        if self._watermark is None or watermark > self._watermark:
            self._watermark = watermark
            for receiver in tuple(self._receivers):
                receiver.advance(self, watermark)
            if self.late_stream is not None:
                # A sample that is late from now on is available at this watermark or later.
                self.late_stream.advance(watermark)


def _fields(schema: Schema) -> str:
    return ", ".join(f"{field.name}: {field.type}" for field in schema.fields) or "none"


def _increases(available: Times) -> bool:
    return len(available) < 2 or not np.count_nonzero(available[1:] <= available[:-1])


def _never_falls(available: Times) -> bool:
    return len(available) < 2 or not np.count_nonzero(available[1:] < available[:-1])


def _in_order(batch: SampleBatch) -> SampleBatch:
    """``batch`` by available time."""
    if _never_falls(batch.available):
        return batch
    return batch.take(np.argsort(batch.available, kind="stable"))
