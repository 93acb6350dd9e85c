"""Units that evaluate windows (docs/explanation/design/0010-turns.md).

A command that makes windows due does not close them, and a large batch is taken in parts. While a
unit has windows to close or parts to take it is in the engine's backlog and defers what its inputs
bring. Its output stream is the same as if it had closed the windows at once, only later.
"""

from __future__ import annotations

from abc import abstractmethod
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, Final, TypeVar

from ...continuous.columns.budget import Quarantined
from ...continuous.estimation.input_rates import Flow
from ...continuous.evaluation.evaluator import ContinuousEvaluator
from ...continuous.sharing.shared_windows import SharedWindows
from ...converters.to_triples import ToTriples, node_names
from ...languages.ssl.annotation import Content
from ...streams.generator import StreamGenerator
from ...streams.instants import Places
from ...streams.sample import SampleBatch
from ...streams.time import format_time
from ..model.beginning import Beginning
from ..model.stream_statistics import flow_of
from ..model.views import Since
from .backlog import Overwhelmed, Task, TurnRecord, Turns
from .base import ComputationalUnit

T = TypeVar("T")

_PART: Final = 4096
"""Samples of one part. A batch of more than twice as many is taken in parts, each of which takes
some milliseconds where all of its objects are new."""
AT_ONCE: Final = 128
"""The number of windows that a turn closes in one pass at most: some milliseconds."""
_TAKE: Final = "take"


class WindowUnit(ComputationalUnit):
    """A unit that evaluates windows: it converts the samples of its inputs to timed triples and
    pushes them to ``evaluator``. It drops samples that are too late for every window before it
    makes terms of their texts."""

    def __init__(
        self,
        *args: Any,
        evaluator: ContinuousEvaluator | SharedWindows,
        converters: Mapping[str, Sequence[ToTriples]],
    ) -> None:
        super().__init__(*args)
        self.evaluator = evaluator
        self._converters = converters
        self.samples = 0
        """Samples read by now."""
        self.triples = 0
        """Triples made of them."""
        self._places: dict[StreamGenerator, Places] = {}
        """By input whose samples are nodes in RDF."""
        self._deferred: deque[tuple[str, tuple[Any, ...]]] = deque()
        """Calls of the inputs that wait until the windows before them have closed."""
        self._task: Task | None = None
        self._error: Exception | None = None
        """Raised by the last window, and to be raised in the unit's next turn."""
        self._has_due_windows = False
        self._spent = 0.0
        """Seconds of work since the unit entered the backlog."""
        self._emitting = 0.0
        """Seconds to emit the results of one window, by the last turn."""
        self._emitted = 0
        """Windows whose results were emitted."""
        self._pending_end = False
        self._pending_idle: bool | None = None
        """What the output is to hear once the unit has caught up."""

    @property
    def is_quarantined(self) -> bool:
        return bool(self.evaluator.quarantine)

    @property
    def reads(self) -> Sequence[StreamGenerator]:
        """The streams whose samples the windows hold."""
        return self.inputs

    @property
    def contents(self) -> tuple[Content, ...]:
        """The contents that the conversion of the inputs yields."""
        several = (each for converters in self._converters.values() for each in converters)
        return tuple(content for each in several for content in each.annotation.contents)

    def flows(self) -> dict[str, Flow]:
        """The rates to expect of the inputs, by name."""
        flows = {}
        for source in self.sources:
            read = (converter.annotation for converter in self._converters[source.name])
            flow = flow_of(source, read)
            if flow is not None:
                flows[source.name] = flow
        return flows

    def start(
        self, since: Beginning = Since.NOW, after: int | None = None, until: int | None = None
    ) -> None:
        # The history and the first watermarks may make windows due, so this comes before them.
        self.evaluator.defers = self.backlog.turns is not None
        super().start(since, after, until)

    def receive(self, source: StreamGenerator, batch: SampleBatch) -> None:
        # Without turns there are no calls of `Backlog.work`, so no part would ever be taken.
        if len(batch) > 2 * _PART and self.backlog.turns is not None:
            for start in range(0, len(batch), _PART):
                part = batch.take(slice(start, start + _PART))
                # The parts wait behind earlier deferred calls, so the input stays in order.
                self._deferred.append((_TAKE, (source, part)))
            self.backlog.add(self)
        elif not self._defers("receive", source, batch):
            super().receive(source, batch)

    def advance(self, source: StreamGenerator, watermark: int) -> None:
        if not self._defers("advance", source, watermark):
            super().advance(source, watermark)

    def ended(self, source: StreamGenerator) -> None:
        if not self._defers("ended", source):
            super().ended(source)

    def resumed(self, source: StreamGenerator) -> None:
        if not self._defers("resumed", source):
            super().resumed(source)

    def idleness_changed(self, source: StreamGenerator) -> None:
        if not self._defers("idleness_changed", source):
            super().idleness_changed(source)

    def process(self, source: StreamGenerator, batch: SampleBatch) -> None:
        self.samples += len(batch)
        converters, names = self._converters[source.name], None
        if any(converter.makes_nodes for converter in converters):
            places = self._places.setdefault(source, Places())
            names = node_names(batch.available, places.of(batch.available))
        for converter in converters:
            converted = converter.convert(batch, names)
            self.triples += len(converted)
            self.evaluator.push(source.name, converted)

    def decided(self, source: StreamGenerator) -> int | None:
        return self.evaluator.limit(source.name)

    def progress(self, source: StreamGenerator, watermark: int) -> None:
        self.emit(self.evaluator.advance(source.name, watermark))
        self._advance_output()

    def finish(self, source: StreamGenerator) -> None:
        # The end makes the last windows due. The output ends after them (`_advance_output`).
        self._pending_end = True
        self.emit(self.evaluator.end(source.name))
        self._advance_output()

    def resume(self, source: StreamGenerator) -> None:
        super().resume(source)
        self.evaluator.resume(source.name)

    @abstractmethod
    def emit(self, results: Sequence[Any]) -> None:
        """Emit the results of windows, in their order."""

    def advance_output(self, watermark: int) -> None:
        """Promise that the output brings nothing before ``watermark`` any more."""
        self.output.advance(watermark)

    def set_output_idle(self, is_idle: bool) -> None:
        # Readers do not wait for an idle stream, so results of due windows would be late for them.
        if self._has_due_windows:
            self._pending_idle = is_idle
        else:
            super().set_output_idle(is_idle)

    def _advance_output(self) -> None:
        """Advance the output to the inputs' watermark, unless windows have to close before."""
        self.report_overruns()
        if self.evaluator.is_due:
            self._has_due_windows = True
            self.backlog.add(self)
            return
        self._has_due_windows = False
        least = self.least_watermark
        if least is not None:
            # A window that is still open ends at ``least`` or later; its results come after it.
            self.advance_output(least + 1)
        if self._pending_end:
            self._pending_end = False
            self.end_output()
        if self._pending_idle is not None:
            is_idle, self._pending_idle = self._pending_idle, None
            self.set_output_idle(is_idle)

    def report_overruns(self) -> None:
        """Report windows that exceeded their budget. Raises `Quarantined` for too many in a row:
        the evaluator evaluates no more, and the unit is cut off."""
        overruns, self.evaluator.overruns = self.evaluator.overruns, []
        self.overruns += len(overruns)
        for overrun in overruns:
            text = f"the window that ends {format_time(overrun.end)} has no result"
            self.counters.note(f"{text}: {overrun.reason}", overrun.end)
            self._on_failure(self)
        if self.evaluator.quarantine:
            raise Quarantined(self.evaluator.quarantine)

    # -- backlog -----------------------------------------------------------------------------

    @property
    def is_mid_window(self) -> bool:
        """See `Backlogged`."""
        return (
            self._task is not None
            or self.evaluator.closed > self._emitted
            or (self._error is not None and self.failure is None)
        )

    @property
    def is_ready(self) -> bool:
        """See `Backlogged`."""
        return self._task is None or self._task.is_ready

    def work(self, turns: Turns, *, begins: bool = True) -> list[TurnRecord]:
        """Close windows while ``turns`` has time, emit their results, and take what was deferred;
        return what was done. Not ``begins``: only the window that is half done."""
        done: list[TurnRecord] = []
        self._guarded(lambda: self._close_windows(turns, done, begins=begins))
        self._catch_up()
        parts = 0
        while begins and self.is_taking_parts and not turns.is_over:
            self._take_part()
            parts += 1
        if parts:
            done.append(TurnRecord(self.name, 0, parts=parts))
        return done

    def replay(self, turn: Sequence[TurnRecord]) -> None:
        """Do what `work` did. Raises ``ValueError`` where there is no such part of a batch to take;
        without such a window the unit fails."""
        self._guarded(lambda: self._replay_windows(turn))
        self._catch_up()
        for _ in range(turn[-1].parts):
            if not self.is_taking_parts:
                raise ValueError(f"{self.name} has no part of a batch to take")
            self._take_part()

    @property
    def spent(self) -> float:
        """Seconds of work since the unit entered the backlog."""
        return self._spent

    @property
    def is_taking_parts(self) -> bool:
        """Whether a part of a batch comes next, and no window before it."""
        has_part = bool(self._deferred) and self._deferred[0][0] == _TAKE
        return has_part and not self.is_mid_window and not self.evaluator.is_due

    def _take_part(self) -> None:
        _, given = self._deferred.popleft()
        super().receive(*given)
        self._catch_up()

    def between_windows(self, change: Callable[[], T]) -> T:
        """Do ``change``, which changes the evaluator, after the window that is half done."""
        self.finish_window()
        return change()

    def finish_window(self) -> None:
        """Close the window that is half done, however long that takes. The unit emits its results,
        or raises its error, in its next turn."""
        if self._task is None:
            return
        task, self._task = self._task, None
        before = task.spent
        try:
            task.run(to_end=True)
        except Exception as error:  # noqa: BLE001  raised in its next turn
            self._error = error
        self._spent += task.spent - before

    def _close_windows(self, turns: Turns, done: list[TurnRecord], *, begins: bool) -> None:
        task, is_done = self._task, True
        if task is None and begins and self.evaluator.is_due:
            task = turns.start(partial(self.evaluator.close_next, most=AT_ONCE), self._emitting)
        if task is not None and (not begins or self._spent > turns.limit):
            # Beyond the limit only the half-done window closes. Then the unit is cut off.
            task.stop_early()
        before = 0.0 if task is None else task.spent
        try:
            if self._error is not None:
                raise self._error
            if task is not None:
                is_done = task.run()
        finally:
            # The windows before one that fails have closed: emit their results all the same.
            self._task = None if is_done else task
            self._spent += 0.0 if task is None else task.spent - before
            closed = self._newly_closed()
            done += closed
            took = turns.time(lambda: self.emit(self.evaluator.take_results()))
            if count := sum(each.windows for each in closed):
                # The next task leaves as much of its turn for the results of each window.
                self._emitting = took / count
        self.report_overruns()
        # A deferred call may make further windows due, so an empty schedule alone does not say
        # that the unit has caught up.
        if is_done and self._spent > turns.limit and (self.evaluator.is_due or self._deferred):
            text = f"its windows took {self._spent:.0f} s, and more of them wait"
            done.append(TurnRecord(self.name, 0, text))
            raise Overwhelmed(text)

    def _newly_closed(self) -> list[TurnRecord]:
        """Records of the windows that have closed since the last call; a record ends with a window
        that was stopped."""
        found, closed = [], self.evaluator.closed
        for overrun in self.evaluator.overruns:
            if overrun.is_stopped:
                found.append(
                    TurnRecord(self.name, overrun.number + 1 - self._emitted, overrun.reason)
                )
                self._emitted = overrun.number + 1
        if closed > self._emitted:
            found.append(TurnRecord(self.name, closed - self._emitted))
            self._emitted = closed
        return found

    def _replay_windows(self, turn: Sequence[TurnRecord]) -> None:
        try:
            for closed in turn:
                self._emitted += closed.windows
                # A window that was half done at a checkpoint closed before it: only emit it now.
                while self.evaluator.closed < self._emitted:
                    left = self._emitted - self.evaluator.closed
                    stopped = closed.stopped if left == 1 else ""
                    # The pass must not close the window that was stopped.
                    most = left - 1 if closed.stopped else left
                    if not self.evaluator.close_next(stopped, max(1, most)):
                        raise ValueError(f"{self.name} has no window to close")
            if self._error is not None:
                raise self._error
        finally:
            self.emit(self.evaluator.take_results())
        self.report_overruns()
        if turn[-1].stopped and not turn[-1].windows:
            raise Overwhelmed(turn[-1].stopped)

    def _defers(self, what: str, *given: Any) -> bool:
        """Defer the call ``what`` if windows have to close or parts to be taken before it; return
        whether."""
        if not self._has_due_windows and not self._deferred:
            return False
        self._deferred.append((what, given))
        return True

    def _catch_up(self) -> None:
        """Do the deferred calls whose windows have closed."""
        while self.failure is None and not self.is_mid_window and not self.evaluator.is_due:
            self._guarded(self._advance_output)
            # A part takes some milliseconds, so it waits for a turn (`work`).
            if not self._deferred or self._deferred[0][0] == _TAKE:
                break
            what, given = self._deferred.popleft()
            getattr(super(), what)(*given)
        if not self._has_due_windows and not self._deferred:
            self._spent = 0.0
            self.backlog.discard(self)

    def _leave_inputs(self) -> None:
        # The task's thread would wait for its turn for ever.
        self.finish_window()
        self._deferred.clear()
        self._has_due_windows = False
        self.backlog.discard(self)
        super()._leave_inputs()
