"""Computational units: instances of transformations, with input streams and one output
([Introspection15 §3.1], [DyKnow10 Def. 5.10]).

A unit receives batches in order of available time and offers batches to its output's generator.
This class handles watermarks, ends, idle inputs, late samples and errors; a subclass's `process`
computes.
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
from ..model.errors import DyknowError
from ..model.status_changes import Role
from ..model.views import Since
from ..processes.supervision import ErrorCounters
from .backlog import Backlog
from .work_time import BusyTime


class ComputationalUnit(ABC):
    """A running unit. ``users`` counts the readers of its output; the engine stops a unit without
    users.

    A unit that raises an error leaves its inputs, with the reason in ``failure``. Other units and
    the publisher go on.
    """

    role = Role.UNIT
    waits_for_all: ClassVar[bool] = True
    """Whether its output waits for all inputs, so that a sample of one may be late."""
    knows_codes = False
    """Whether it keeps codes of its inputs' texts beyond a call, other than in batches, which have
    the pools with them. The streams never free texts of such a reader."""

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
        """The inputs, each stream once: ``inputs`` may have a stream twice."""
        self.output = output
        self.parameters = dict(parameters)
        self.synchronization: ComputationalUnit | None = None
        """The unit that was inserted to synchronize its inputs."""
        self.users = 0
        self.failure: str | None = None
        self.counters = ErrorCounters()
        self.last_processed = TIME_MIN
        """The greatest available time (ns) of the samples that it has processed."""
        self.late = 0
        """Dropped samples that were late for the output."""
        self.busy = 0
        """The measured time (ns) of its own work, without that of its readers; 0 unmeasured."""
        self.busy_time: BusyTime | None = None
        self.backlog = Backlog()
        """The engine's backlog; only a `WindowUnit` enters it."""
        self.windows = 0
        """The number of evaluated windows."""
        self.overruns = 0
        """The number of windows without result that exceeded their budget."""
        self.late_streams: dict[StreamGenerator, StreamGenerator] = {}
        """The requested streams of late samples, by input."""
        self._after: int | None = None
        self._until: int | None = None
        self._on_failure = on_failure
        self._watermarks: dict[StreamGenerator, int] = {}
        self._ended: set[StreamGenerator] = set()
        self._idle: list[StreamGenerator] = []
        """Idle inputs, for which the others do not wait."""
        self._processed_before = TIME_MIN
        """`last_processed` before the batch that is being processed."""
        self._subscribed: list[StreamGenerator] = []

    def start(
        self, since: Beginning = Since.NOW, after: int | None = None, until: int | None = None
    ) -> None:
        """Subscribe to the inputs, and first read their retained samples from ``since`` on.

        The past of all inputs comes before any watermark. A unit with several inputs therefore
        computes the same as if it had existed when the samples came. The unit ignores samples,
        old and new, that are available at ``after`` (ns) or before, or later than ``until``.
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
        """Return the retained samples of an input that are for this unit; see `start`."""
        batch = source.stream.all()
        after = TIME_MIN if self._after is None else self._after
        rows = (batch.available > after) | (self._after is None)
        if self._until is not None:
            rows &= batch.available <= self._until
        return batch.take(rows)

    def connect(self, source: StreamGenerator) -> None:
        """Subscribe to an input; handle its end if it has ended already."""
        # If the unit failed on the history, `_leave_inputs` has run and will not run again.
        if self.failure is not None:
            return
        self._subscribed.append(source)
        source.subscribe(self)
        if source.is_ended:
            self.ended(source)

    def stop(self) -> None:
        """Unsubscribe from the inputs, and end the output."""
        self._leave_inputs()
        self.output.end()
        self.output.close()

    def end_after(self, until: int) -> None:
        """Ignore samples that are available later than ``until`` (ns), so that all inputs end
        there.

        The output ends when all inputs have reached it. Contract: `last_processed` is not later.
        """
        self._until = self.output.ends_at = until
        for source in self.sources:
            if source not in self._ended and self._watermarks.get(source, TIME_MIN) > until:
                self._end_here(source, until)

    def receive(self, source: StreamGenerator, batch: SampleBatch) -> None:
        """Process samples of an input."""
        # A batch is in order of available time, so its first and last rows decide.
        if self._after is not None and batch.available[0] <= self._after:
            batch = batch.take(batch.available > self._after)
        if self._until is not None and len(batch) and batch.available[-1] > self._until:
            batch = batch.take(batch.available <= self._until)
        if not len(batch):
            return
        self._ended.discard(source)
        self._processed_before = self.last_processed
        decided = self.decided(source) if self.waits_for_all else None
        if decided is not None:
            # The unit did not wait for the input, or the input had ended.
            batch = self.in_time(source, batch, decided)
            if not len(batch):
                return
        self.last_processed = max(self.last_processed, int(batch.available[-1]))
        self._guarded(lambda: self.process(source, batch))

    def advance(self, source: StreamGenerator, watermark: int) -> None:
        """Handle an input's promise of no further samples before ``watermark``."""
        if self._until is not None and watermark > self._until:
            if source not in self._ended:
                self._end_here(source, self._until)
            return
        self._raise_watermark(source, watermark)
        if self._idle:
            self._advance_idle()

    def idleness_changed(self, source: StreamGenerator) -> None:
        """Handle that an input has fallen idle or is no longer idle."""
        self._advance_idle()

    def _advance_idle(self) -> None:
        """Raise the watermarks of idle inputs, so that the others do not wait for them: to the
        least of the others, or to the greatest of all if every running input is idle. The output is
        idle if every running input is."""
        running = [source for source in self.sources if source not in self._ended]
        self._idle = [source for source in running if source.is_idle]
        others = [source for source in running if not source.is_idle]
        if self._idle and self.waits_for_all:
            watermark = _past_idle(self._watermarks, others)
            if watermark is not None:
                if self._until is not None:
                    watermark = min(watermark, self._until)
                for source in self._idle:
                    self._raise_watermark(source, watermark)
        self.set_output_idle(bool(self._idle) and not others)

    def set_output_idle(self, is_idle: bool) -> None:
        """Let the output fall idle, or wake it."""
        if is_idle:
            self.output.fall_idle()
        else:
            self.output.wake()

    def _raise_watermark(self, source: StreamGenerator, watermark: int) -> None:
        """Raise the watermark of an input; without effect if it is not greater."""
        before = self._watermarks.get(source)
        if before is not None and watermark <= before:
            return
        self._watermarks[source] = watermark
        for late in self.late_streams_of(source):
            late.advance(watermark)
        self._guarded(lambda: self.progress(source, watermark))

    def _end_here(self, source: StreamGenerator, until: int) -> None:
        """End an input at ``until``. The watermark is the same whether the input or `end_after`
        came first, so the output is too."""
        self._watermarks[source] = until + 1
        self._guarded(lambda: self.progress(source, until + 1))
        self.ended(source)

    def ended(self, source: StreamGenerator) -> None:
        """Handle the end of an input. The output ends with the last one."""
        self._ended.add(source)
        self._guarded(lambda: self.finish(source))
        for late in self.late_streams_of(source):
            late.end()
        # The unit goes past its idle inputs as far as the others, and one of these has gone.
        if self._idle:
            self._advance_idle()

    def resumed(self, source: StreamGenerator) -> None:
        """Handle an input that goes on after its end: the output goes on too, and its readers wait
        for it again."""
        if self._until is not None:
            return
        self._guarded(lambda: self.resume(source))
        for late in self.late_streams_of(source):
            late.resume()
        if self.failure is None:
            self.output.resume()
        if self._idle:
            self._advance_idle()

    def resume(self, source: StreamGenerator) -> None:
        """Wait again for an input that had ended."""
        self._ended.discard(source)

    @property
    def is_quarantined(self) -> bool:
        """Whether it failed because too many windows exceeded their budget."""
        return False

    @property
    def lag(self) -> int | None:
        """How far (ns) the output's watermark is behind the newest sample of the inputs: samples
        after it are in no result yet. None before the first watermark or sample."""
        times = [one.stream.last_available for one in self.sources]
        newest = max((time for time in times if time is not None), default=None)
        if newest is None or self.output.watermark is None:
            return None
        return max(0, newest - self.output.watermark)

    @property
    def least_watermark(self) -> int | None:
        """The least watermark of the inputs that have not ended; None if there is none, or while
        one of them has no watermark yet."""
        least = None
        for source in self.sources:
            if source in self._ended:
                continue
            known = self._watermarks.get(source)
            if known is not None:
                least = known if least is None else min(least, known)
            elif not source.is_idle:
                return None
        return least

    def watermarks_if_new(self) -> dict[StreamGenerator, int]:
        """Return the watermarks that a unit which starts now has of the inputs."""
        known = {each: time for each in self.sources if (time := each.watermark) is not None}
        others = [each for each in self.sources if not each.is_ended and not each.is_idle]
        passed = _past_idle(known, others)
        if passed is None:
            return known
        idle = (each for each in self.sources if each.is_idle)
        return known | {each: max(passed, known.get(each, passed)) for each in idle}

    @property
    def waits_for(self) -> tuple[StreamGenerator, ...]:
        """Inputs without a watermark that have not ended and are not idle. The unit decides nothing
        about the other inputs before."""
        known = self._watermarks.keys() | self._ended
        return tuple(one for one in self.sources if one not in known and not one.is_idle)

    @property
    def all_ended(self) -> bool:
        return len(self._ended) == len(self.sources)

    @abstractmethod
    def process(self, source: StreamGenerator, batch: SampleBatch) -> None:
        """Compute samples from ``batch``, and offer them to the output."""

    def progress(self, source: StreamGenerator, watermark: int) -> None:
        """Advance the output. By default to the least watermark, since most units keep available
        times."""
        least = self.least_watermark
        if least is not None:
            self.output.advance(least)

    def finish(self, source: StreamGenerator) -> None:
        """Handle the end of an input. By default the output ends with the last one."""
        self.end_output()

    def end_output(self) -> None:
        """End the output if all inputs have ended. Its watermark is then the greatest of theirs,
        whichever of them ended first."""
        if self.all_ended:
            if self._watermarks:
                self.output.advance(max(self._after_newest, *self._watermarks.values()))
            self.output.end()

    @property
    def _after_newest(self) -> int:
        """The available time (ns) after the newest samples of the inputs, also of those that were
        there before this unit: it then ends where an older unit does."""
        times = [one.stream.last_available for one in self.sources]
        newest = max((time for time in times if time is not None), default=TIME_MIN)
        return min(newest, TIME_MAX - 1 if self._until is None else self._until) + 1

    def _guarded(self, work: Callable[[], None]) -> None:
        if self.failure is not None:
            return
        try:
            if self.busy_time is None:
                work()
            else:
                self.busy_time.run(self, work)
        except Exception as error:  # noqa: BLE001  isolation: only this unit fails
            # An error of the system has a text for users. Other texts say little without a type.
            kind = "" if isinstance(error, DyknowError) else f"{type(error).__name__}: "
            self.failure = f"{kind}{error}"
            self.counters.note(self.failure, None)
            self._leave_inputs()
            self._on_failure(self)

    @property
    def late_inputs(self) -> Sequence[StreamGenerator]:
        """The input streams whose samples may be late for the output."""
        return self.sources if self.waits_for_all else ()

    def late_streams_of(self, source: StreamGenerator) -> Sequence[StreamGenerator]:
        """Return the streams of late samples of an input."""
        late = self.late_streams.get(source)
        return () if late is None else (late,)

    def drop_late(self, source: StreamGenerator) -> None:
        """Only count the late samples of ``source`` from now on."""
        del self.late_streams[source]

    def pass_late_to(self, source: StreamGenerator, side: StreamGenerator) -> None:
        """Emit the late samples of ``source`` to ``side``, which has its fields, from now on."""
        self.late_streams[source] = side
        self.start_late(source, side)

    def start_late(self, source: StreamGenerator, side: StreamGenerator) -> None:
        """Give ``side``, a new stream of late samples, the watermark of ``source`` and its end."""
        watermark = self._watermarks.get(source)
        if watermark is not None:
            side.advance(watermark)
        if source in self._ended:
            side.end()

    def decided(self, source: StreamGenerator) -> int | None:
        """Return the time up to which samples of an input are late; None: none are."""
        known = self._watermarks.get(source)
        return None if known is None else known - 1

    def in_time(self, source: StreamGenerator, batch: SampleBatch, decided: int) -> SampleBatch:
        """Return the samples available after ``decided``; count the others as late.

        The stream of late samples, if requested, gets each of them at its arrival in the unit's
        time. That is the greatest available time the unit had processed before, or right after
        ``decided`` if that is later.
        """
        if batch.available[0] > decided:
            return batch
        is_in_time = batch.available > decided
        late = batch.take(~is_in_time)
        self.late += len(late)
        for side in self.late_streams_of(source):
            self.emit_late(side, late, decided)
        return batch.take(is_in_time)

    def emit_late(self, side: StreamGenerator, late: SampleBatch, decided: int) -> None:
        """Emit samples that are late, since ``decided`` was before, to a stream of late samples."""
        if len(late):
            arrival = max(self._processed_before, min(decided, TIME_MAX - 1) + 1)
            times = np.full(len(late), arrival, np.int64)
            side.emit(late.with_available(side.stamps_at(times)))

    def cut_off(self, reason: str) -> None:
        """Leave the inputs for good, since the rule of user-written code says so; this is not an
        error of the system."""
        self.failure = reason
        self._leave_inputs()

    def _leave_inputs(self) -> None:
        # A unit may fail on the past, before it has subscribed to anything.
        while self._subscribed:
            self._subscribed.pop().unsubscribe(self)


def _past_idle(
    watermarks: Mapping[StreamGenerator, int], others: Sequence[StreamGenerator]
) -> int | None:
    """How far a unit goes past its idle inputs: to the least watermark of the ``others`` that run,
    to the greatest of all if none does; None while one of them has no watermark yet."""
    if not others:
        return max(watermarks.values(), default=None)
    known = [watermarks[one] for one in others if one in watermarks]
    return min(known) if len(known) == len(others) else None
