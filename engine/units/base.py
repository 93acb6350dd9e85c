"""Computational units: instances of transformations, with input streams and one output
([Introspection15 §3.1], [DyKnow10 Def. 5.10]).

A unit receives batches in order of available time and offers batches to its output's generator.
What it makes of a batch is the subclass's `process`; order, isolation and ends are decided here.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from typing import ClassVar

import numpy as np

from ...streams.generator import StreamGenerator
from ...streams.past_queries import Moment
from ...streams.sample import SampleBatch
from ...streams.time import TIME_MAX, TIME_MIN
from ..model.beginning import Beginning, last_before
from ..model.status_changes import Role
from ..model.views import Since
from ..processes.supervision import ErrorCounters
from .backlog import Backlog
from .work_time import BusyTime


class ComputationalUnit(ABC):
    """A unit at work. ``users`` counts who needs its output; the engine stops it with the last.

    A unit that raises is cut off from its inputs, with the reason in ``failure``; other units
    and whoever published go on.
    """

    role = Role.UNIT
    waits_for_all: ClassVar[bool] = True
    """Whether what it makes waits for all inputs, so that a sample may come after that."""
    knows_codes = False
    """Whether it keeps codes of its inputs' texts beyond a call (but in batches, which know what
    they mean): then these are never forgotten."""

    def __init__(
        self,
        name: str,
        transformation: str,
        inputs: Sequence[StreamGenerator],
        output: StreamGenerator,
        parameters: Mapping[str, str],
        on_failure: Callable[[ComputationalUnit], None],
    ) -> None:
        self.name = name
        self.transformation = transformation
        self.inputs = tuple(inputs)
        self.sources = tuple(dict.fromkeys(inputs))
        """The inputs, each stream once: the same one may be given twice."""
        self.output = output
        self.parameters = dict(parameters)
        self.synchronization: ComputationalUnit | None = None
        """The unit that was inserted to bring its inputs together."""
        self.users = 0
        self.failure: str | None = None
        self.counters = ErrorCounters()
        self.seen = TIME_MIN
        """The available time (ns) of the latest sample that it has processed."""
        self.late = 0
        """Samples that came after what they belong to was decided, and were left out."""
        self.busy = 0
        """How long it has worked (ns), if somebody measures it: without those it sets to work."""
        self.busy_time: BusyTime | None = None
        self.backlog = Backlog()
        """Who closes its windows, if it has any."""
        self.windows = 0
        """How many windows it has evaluated."""
        self.overruns = 0
        """How many windows have no result because they needed more than they may."""
        self.late_streams: dict[StreamGenerator, StreamGenerator] = {}
        """Those that take the late samples of inputs, as far as somebody asked for them."""
        self._after: int | None = None
        self._until: int | None = None
        self._on_failure = on_failure
        self._watermarks: dict[StreamGenerator, int] = {}
        self._ended: set[StreamGenerator] = set()
        self._idle: list[StreamGenerator] = []
        """Inputs that have fallen idle, and hold no other back."""
        self._before = TIME_MIN
        """As `seen`, before the samples that are being processed."""
        self._subscribed: list[StreamGenerator] = []

    def start(
        self, since: Beginning = Since.NOW, after: int | None = None, until: int | None = None
    ) -> None:
        """Subscribe to the inputs; from the start of what they keep or from a moment of it, if
        asked.

        The past of all inputs comes first, then how far each of them is: a unit of several inputs
        sees the same as if it had been there when their samples came. With ``after`` (ns) it sees
        nothing that was available by then, whether that has come already or not; with ``until``
        nothing that is available later.
        """
        if isinstance(since, Moment):
            after = last_before(since)
        self._after = after
        self._until = self.output.ends_at = until
        if since is Since.START or after is not None:
            for source in self.sources:
                for segment in source.stream.since(0):
                    self.receive(source, segment.batch)
        for source in self.sources:
            self.connect(source)

    def past_of(self, source: StreamGenerator) -> SampleBatch:
        """All kept samples of an input that this unit was to see; see `start`."""
        batch = source.stream.all()
        after = TIME_MIN if self._after is None else self._after
        rows = (batch.available > after) | (self._after is None)
        if self._until is not None:
            rows &= batch.available <= self._until
        return batch.take(rows)

    def connect(self, source: StreamGenerator) -> None:
        """Subscribe to an input, and hear of its end if that was earlier."""
        if self.failure is not None:
            return
        self._subscribed.append(source)
        source.subscribe(self)
        if source.is_ended:
            self.ended(source)

    def stop(self) -> None:
        """Leave the inputs; the output ends."""
        self._leave_inputs()
        self.output.end()
        self.output.close()

    def end_after(self, until: int) -> None:
        """What is available later than ``until`` (ns) is not for this unit: its inputs end there.

        The output ends when all inputs have got so far. Contract: `seen` is not later.
        """
        self._until = self.output.ends_at = until
        for source in self.sources:
            if source not in self._ended and self._watermarks.get(source, TIME_MIN) > until:
                self._end_here(source, until)

    def receive(self, source: StreamGenerator, batch: SampleBatch) -> None:
        """Samples of an input."""
        if self._after is not None and batch.available[0] <= self._after:
            batch = batch.take(batch.available > self._after)
        if self._until is not None and len(batch) and batch.available[-1] > self._until:
            batch = batch.take(batch.available <= self._until)
        if not len(batch):
            return
        self._ended.discard(source)
        self._before = self.seen
        decided = self.decided(source) if self.waits_for_all else None
        if decided is not None:
            # The unit did not wait for the input, or the input had ended.
            batch = self.in_time(source, batch, decided)
            if not len(batch):
                return
        self.seen = max(self.seen, int(batch.available[-1]))
        self._guarded(lambda: self.process(source, batch))

    def advance(self, source: StreamGenerator, watermark: int) -> None:
        """An input promises to send nothing before ``watermark`` any more."""
        if self._until is not None and watermark > self._until:
            if source not in self._ended:
                self._end_here(source, self._until)
            return
        self._reach(source, watermark)
        if self._idle:
            self._leave_idle_behind()

    def idleness_changed(self, source: StreamGenerator) -> None:
        """An input has fallen idle, or speaks again. The output is idle with all that go on."""
        self._leave_idle_behind()

    def _leave_idle_behind(self) -> None:
        """Inputs that are idle do not hold the others back: each is taken to be as far as the least
        of those is, and as far as the furthest of all where none of them goes on."""
        running = [source for source in self.sources if source not in self._ended]
        self._idle = [source for source in running if source.is_idle]
        others = [source for source in running if not source.is_idle]
        if self._idle and self.waits_for_all:
            reached = [self._watermarks.get(source) for source in others]
            known = [watermark for watermark in reached if watermark is not None]
            if not others:
                known = list(self._watermarks.values())
            if known and len(known) >= len(others):
                place = min(known) if others else max(known)
                for source in self._idle:
                    self._reach(source, place if self._until is None else min(place, self._until))
        self.tell_idle(bool(self._idle) and not others)

    def tell_idle(self, is_idle: bool) -> None:
        """The output says nothing for now, or may."""
        if is_idle:
            self.output.fall_idle()
        else:
            self.output.wake()

    def _reach(self, source: StreamGenerator, watermark: int) -> None:
        """An input is known up to ``watermark``, if that is news."""
        known = self._watermarks.get(source)
        if known is not None and watermark <= known:
            return
        self._watermarks[source] = watermark
        for late in self.late_streams_of(source):
            late.advance(watermark)
        self._guarded(lambda: self.progress(source, watermark))

    def _end_here(self, source: StreamGenerator, until: int) -> None:
        """An input ends with the life, up to the end of which it has told everything: whether the
        end of the life or the samples came first."""
        self._watermarks[source] = until + 1
        self._guarded(lambda: self.progress(source, until + 1))
        self.ended(source)

    def ended(self, source: StreamGenerator) -> None:
        """An input has come to its end; with the last one so does the output."""
        self._ended.add(source)
        self._guarded(lambda: self.finish(source))
        for late in self.late_streams_of(source):
            late.end()
        if self._idle:
            self._leave_idle_behind()

    def resumed(self, source: StreamGenerator) -> None:
        """An input goes on after its end, and so does the output: whoever reads it waits again."""
        if self._until is not None:
            return
        self._guarded(lambda: self.resume(source))
        for late in self.late_streams_of(source):
            late.resume()
        if self.failure is None:
            self.output.resume()
        if self._idle:
            self._leave_idle_behind()

    def resume(self, source: StreamGenerator) -> None:
        """Wait for an input again that had ended."""
        self._ended.discard(source)

    @property
    def is_quarantined(self) -> bool:
        """Whether it was cut off because windows needed more than they may."""
        return False

    @property
    def lag(self) -> int | None:
        """How far (ns) what it promises is behind what its inputs have said: so much of that is in
        no result yet. None while it has promised nothing, or its inputs have said nothing."""
        said = [one.stream.last_available for one in self.sources]
        known = [available for available in said if available is not None]
        if not known or self.output.watermark is None:
            return None
        return max(0, max(known) - self.output.watermark)

    @property
    def least_watermark(self) -> int | None:
        """The watermark that holds for all inputs that have not ended; None if there is none,
        or while one of them has not begun."""
        if self.waits_for:
            return None
        running = [w for source, w in self._watermarks.items() if source not in self._ended]
        return min(running) if running else None

    @property
    def waits_for(self) -> tuple[StreamGenerator, ...]:
        """Inputs that have neither begun nor ended, and are not idle: what others say is not
        decided before."""
        decided = self._watermarks.keys() | self._ended
        return tuple(one for one in self.sources if one not in decided and not one.is_idle)

    @property
    def all_ended(self) -> bool:
        return len(self._ended) == len(self.sources)

    @abstractmethod
    def process(self, source: StreamGenerator, batch: SampleBatch) -> None:
        """Make of the samples what the unit is for, and offer it to the output."""

    def progress(self, source: StreamGenerator, watermark: int) -> None:
        """Pass the promise on: a unit that answers at once keeps available times."""
        least = self.least_watermark
        if least is not None:
            self.output.advance(least)

    def finish(self, source: StreamGenerator) -> None:
        """An input ended; by default the output ends with the last of them."""
        self.end_output()

    def end_output(self) -> None:
        """End the output if all inputs have, at the moment up to which one of them was known:
        whichever was told first."""
        if self.all_ended:
            if self._watermarks:
                self.output.advance(max(self.seen + 1, *self._watermarks.values()))
            self.output.end()

    def _guarded(self, work: Callable[[], None]) -> None:
        if self.failure is not None:
            return
        try:
            if self.busy_time is None:
                work()
            else:
                self.busy_time.run(self, work)
        except Exception as error:  # noqa: BLE001  the unit is cut off and says why; others go on
            self.failure = f"{type(error).__name__}: {error}"
            self.counters.note(self.failure, None)
            self._leave_inputs()
            self._on_failure(self)

    @property
    def late_inputs(self) -> Sequence[StreamGenerator]:
        """The streams whose samples may come too late for what the unit makes."""
        return self.sources if self.waits_for_all else ()

    def late_streams_of(self, source: StreamGenerator) -> Sequence[StreamGenerator]:
        """Those that take the late samples of an input."""
        late = self.late_streams.get(source)
        return () if late is None else (late,)

    def forget_late(self, source: StreamGenerator) -> None:
        """The late samples of ``source`` are only counted again."""
        del self.late_streams[source]

    def pass_late_to(self, source: StreamGenerator, side: StreamGenerator) -> None:
        """From now on ``side``, which has the fields of ``source``, gets its late samples."""
        self.late_streams[source] = side
        self.tell_late(source, side)

    def tell_late(self, source: StreamGenerator, side: StreamGenerator) -> None:
        """Tell ``side``, which begins to take late samples, how far ``source`` is."""
        known = self._watermarks.get(source)
        if known is not None:
            side.advance(known)
        if source in self._ended:
            side.end()

    def decided(self, source: StreamGenerator) -> int | None:
        """The time up to which samples of an input come too late; None: none does."""
        known = self._watermarks.get(source)
        return None if known is None else known - 1

    def in_time(self, source: StreamGenerator, batch: SampleBatch, decided: int) -> SampleBatch:
        """The samples available after ``decided``; the others are late, and counted.

        Who asked for the late samples of ``source`` gets them, each available when it came, in the
        time of the unit: that is what was available last of all it had processed before, or right
        after ``decided`` where that is further.
        """
        if batch.available[0] > decided:
            return batch
        kept = batch.available > decided
        late = batch.take(~kept)
        self.late += len(late)
        for side in self.late_streams_of(source):
            came = max(self._before, min(decided, TIME_MAX - 1) + 1)
            moments = np.full(len(late), came, np.int64)
            side.emit(late.with_available(side.stamps_at(moments)))
        return batch.take(kept)

    def cut_off(self, reason: str) -> None:
        """It stops for good without an error of the system: its own rule says so."""
        self.failure = reason
        self._leave_inputs()

    def _leave_inputs(self) -> None:
        # A unit may fail on the past, before it has subscribed to anything.
        while self._subscribed:
            self._subscribed.pop().unsubscribe(self)
