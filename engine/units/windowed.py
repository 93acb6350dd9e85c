"""Units that evaluate windows, a little at a time (docs/explanation/design/0010-turns.md).

What makes windows due does not close them, and a large batch is taken in parts. A unit that has
windows to close or parts to take is *behind*: it puts by what its inputs say until it has caught
up, so that its stream says what it would have said at once, only later.
"""

from __future__ import annotations

from abc import abstractmethod
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final, TypeVar

from ...continuous.columns.budget import Quarantined
from ...continuous.estimation.input_rates import Flow
from ...continuous.evaluation.evaluator import ContinuousEvaluator
from ...continuous.sharing.shared_windows import SharedWindows
from ...converters.to_triples import SampleConverter, node_names
from ...languages.ssl.annotation import Content
from ...streams.generator import StreamGenerator
from ...streams.instants import Places
from ...streams.sample import SampleBatch
from ...streams.time import format_time
from ..model.beginning import Beginning
from ..model.stream_statistics import flow_of
from ..model.views import Since
from .backlog import Overwhelmed, Task, Turns, Went
from .base import ComputationalUnit

T = TypeVar("T")

_PART: Final = 4096
"""Samples that are taken at once, of a batch of more than twice as many: some milliseconds, where
all of their objects are new."""
_TAKE: Final = "take"


class WindowUnit(ComputationalUnit):
    """A unit that evaluates windows: the samples of its inputs, converted to timed triples, go to
    ``evaluator``; those that are too late for every window are left out before. Texts become terms
    on the way."""

    def __init__(
        self,
        *args: Any,
        evaluator: ContinuousEvaluator | SharedWindows,
        converters: Mapping[str, Sequence[SampleConverter]],
    ) -> None:
        super().__init__(*args)
        self.evaluator = evaluator
        self._converters = converters
        self.samples = 0
        """How many samples it has read."""
        self.triples = 0
        """How many triples these stood for."""
        self._places: dict[StreamGenerator, Places] = {}
        """Of the inputs whose samples are nodes in RDF."""
        self._put_by: deque[tuple[str, tuple[Any, ...]]] = deque()
        """What inputs have said since the unit is behind."""
        self._task: Task | None = None
        self._error: Exception | None = None
        self._is_behind = False
        self._spent = 0.0
        """Seconds that its windows took since it fell behind."""
        self._telling = 0.0
        """Seconds that the results of a window took to be told, the last time."""
        self._told = 0
        """Of so many windows the results are told."""
        self._has_to_end = False
        self._has_to_be_idle: bool | None = None
        """What is to be told when it has caught up."""

    @property
    def is_quarantined(self) -> bool:
        return bool(self.evaluator.quarantine)

    @property
    def reads(self) -> Sequence[StreamGenerator]:
        """The streams whose samples are in the windows."""
        return self.inputs

    @property
    def contents(self) -> tuple[Content, ...]:
        """What the inputs contain, as their samples are converted."""
        several = (each for converters in self._converters.values() for each in converters)
        return tuple(content for each in several for content in each.annotation.contents)

    def flows(self) -> dict[str, Flow]:
        """What may be expected of the inputs, by name."""
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
        self.evaluator.defers = self.behind.turns is not None
        super().start(since, after, until)

    def receive(self, source: StreamGenerator, batch: SampleBatch) -> None:
        if len(batch) > 2 * _PART and self.behind.turns is not None:
            for start in range(0, len(batch), _PART):
                part = batch.take(slice(start, start + _PART))
                self._put_by.append((_TAKE, (source, part)))
            self.behind.fell(self)
        elif not self._puts_by("receive", source, batch):
            super().receive(source, batch)

    def advance(self, source: StreamGenerator, watermark: int) -> None:
        if not self._puts_by("advance", source, watermark):
            super().advance(source, watermark)

    def ended(self, source: StreamGenerator) -> None:
        if not self._puts_by("ended", source):
            super().ended(source)

    def resumed(self, source: StreamGenerator) -> None:
        if not self._puts_by("resumed", source):
            super().resumed(source)

    def idleness_changed(self, source: StreamGenerator) -> None:
        if not self._puts_by("idleness_changed", source):
            super().idleness_changed(source)

    def process(self, source: StreamGenerator, batch: SampleBatch) -> None:
        limit = self.evaluator.limit(source.name)
        if limit is not None:
            batch = self.in_time(source, batch, limit)
        if not len(batch):
            return
        self.samples += len(batch)
        converters, names = self._converters[source.name], None
        if any(converter.makes_nodes for converter in converters):
            places = self._places.setdefault(source, Places())
            names = node_names(batch.available, places.of(batch.available))
        for converter in converters:
            converted = converter.convert(batch, names)
            self.triples += len(converted)
            self.evaluator.push(source.name, converted)

    def progress(self, source: StreamGenerator, watermark: int) -> None:
        self.emit(self.evaluator.advance(source.name, watermark))
        self._tell_time()

    def finish(self, source: StreamGenerator) -> None:
        self._has_to_end = True
        self.emit(self.evaluator.end(source.name))
        self._tell_time()

    def resume(self, source: StreamGenerator) -> None:
        super().resume(source)
        self.evaluator.resume(source.name)

    @abstractmethod
    def emit(self, results: Sequence[Any]) -> None:
        """Tell the results of windows, in their order."""

    def advance_output(self, watermark: int) -> None:
        """Promise that nothing comes before ``watermark`` any more."""
        self.output.advance(watermark)

    def tell_idle(self, is_idle: bool) -> None:
        if self._is_behind:
            self._has_to_be_idle = is_idle
        else:
            super().tell_idle(is_idle)

    def _tell_time(self) -> None:
        """Say how far the output is, unless windows have to close before."""
        self.judge()
        if self.evaluator.is_due:
            self._is_behind = True
            self.behind.fell(self)
            return
        self._is_behind = False
        least = self.least_watermark
        if least is not None:
            # A window that is still open ends at ``least`` or later; its results come after it.
            self.advance_output(least + 1)
        if self._has_to_end:
            self._has_to_end = False
            self.end_output()
        if self._has_to_be_idle is not None:
            is_idle, self._has_to_be_idle = self._has_to_be_idle, None
            self.tell_idle(is_idle)

    def judge(self) -> None:
        """Tell of windows that needed more than they may. Raises `Quarantined` for too many of
        them: then no more are evaluated, and the unit is cut off."""
        overruns, self.evaluator.overruns = self.evaluator.overruns, []
        self.overruns += len(overruns)
        for overrun in overruns:
            text = f"the window that ends {format_time(overrun.end)} has no result"
            self.counters.note(f"{text}: {overrun.reason}", overrun.end)
            self._on_failure(self)
        if self.evaluator.quarantine:
            raise Quarantined(self.evaluator.quarantine)

    # -- behind ------------------------------------------------------------------------------

    @property
    def is_within(self) -> bool:
        """Whether a window is half done, or what it gave is not told."""
        return (
            self._task is not None
            or self.evaluator.closed > self._told
            or (self._error is not None and self.failure is None)
        )

    @property
    def is_ready(self) -> bool:
        """Whether it can go on now."""
        return self._task is None or self._task.is_ready

    def go_on(self, turns: Turns, *, begins: bool = True) -> list[Went]:
        """Close windows for as long as ``turns`` has time, tell their results, and take what was
        put by; gives what was done. Not ``begins``: none but the one that is half done."""
        done: list[Went] = []
        self._guarded(lambda: self._go_on(turns, done, begins=begins))
        self._catch_up()
        parts = 0
        while begins and self.is_taking and not turns.is_over:
            self._take_part()
            parts += 1
        if parts:
            done.append(Went(self.name, 0, parts=parts))
        return done

    def again(self, turn: Sequence[Went]) -> None:
        """Do what `go_on` did. Raises ``ValueError`` where there is no such thing to do."""
        self._guarded(lambda: self._again(turn))
        self._catch_up()
        for _ in range(turn[-1].parts):
            if not self.is_taking:
                raise ValueError(f"{self.name} has no part of a batch to take")
            self._take_part()

    @property
    def spent(self) -> float:
        """Seconds of work since it fell behind."""
        return self._spent

    @property
    def is_taking(self) -> bool:
        """Whether part of a batch comes next, and no window before it."""
        has_part = bool(self._put_by) and self._put_by[0][0] == _TAKE
        return has_part and not self.is_within and not self.evaluator.is_due

    def _take_part(self) -> None:
        _, given = self._put_by.popleft()
        super().receive(*given)
        self._catch_up()

    def between_windows(self, change: Callable[[], T]) -> T:
        """Do what changes the evaluator from without: not in the middle of a window."""
        self.finish_window()
        return change()

    def finish_window(self) -> None:
        """Close the window that is half done, however long that takes; what it gives is told in the
        unit's next turn, and what it raises, too."""
        if self._task is None:
            return
        task, self._task = self._task, None
        before = task.spent
        try:
            task.go_on(to_end=True)
        except Exception as error:  # noqa: BLE001  raised in its turn
            self._error = error
        self._spent += task.spent - before

    def _go_on(self, turns: Turns, done: list[Went], *, begins: bool) -> None:
        task, is_done = self._task, True
        if task is None and begins and self.evaluator.is_due:
            task = turns.begin(self.evaluator.close_next, self._telling)
        if task is not None and (not begins or self._spent > turns.most):
            task.end()
        before = 0.0 if task is None else task.spent
        try:
            if self._error is not None:
                raise self._error
            if task is not None:
                is_done = task.go_on()
        finally:
            # Those before one that fails have closed nevertheless.
            self._task = None if is_done else task
            self._spent += 0.0 if task is None else task.spent - before
            went = self._went()
            done += went
            took = turns.timed(lambda: self.emit(self.evaluator.taken()))
            if count := sum(each.windows for each in went):
                self._telling = took / count
        self.judge()
        # What waits for it may be one window now, and one with each message that was put by.
        if is_done and self._spent > turns.most and (self.evaluator.is_due or self._put_by):
            text = f"its windows took {self._spent:.0f} s, and more of them wait"
            done.append(Went(self.name, 0, text))
            raise Overwhelmed(text)

    def _went(self) -> list[Went]:
        """The windows that have closed since this was asked last; one that was stopped is the last
        of its kind."""
        found, closed = [], self.evaluator.closed
        for overrun in self.evaluator.overruns:
            if overrun.is_stopped:
                found.append(Went(self.name, overrun.number + 1 - self._told, overrun.reason))
                self._told = overrun.number + 1
        if closed > self._told:
            found.append(Went(self.name, closed - self._told))
            self._told = closed
        return found

    def _again(self, turn: Sequence[Went]) -> None:
        try:
            for went in turn:
                self._told += went.windows
                # One that was half done at a checkpoint has closed before it, and is told now.
                while self.evaluator.closed < self._told:
                    is_last = self.evaluator.closed == self._told - 1
                    if not self.evaluator.close_next(went.stopped if is_last else ""):
                        raise ValueError(f"{self.name} has no window to close")
            if self._error is not None:
                raise self._error
        finally:
            self.emit(self.evaluator.taken())
        self.judge()
        if turn[-1].stopped and not turn[-1].windows:
            raise Overwhelmed(turn[-1].stopped)

    def _puts_by(self, what: str, *given: Any) -> bool:
        """Whether this is for later: windows have to close before, or parts are to be taken."""
        if not self._is_behind and not self._put_by:
            return False
        self._put_by.append((what, given))
        return True

    def _catch_up(self) -> None:
        """Say and take what had to wait for windows that have closed."""
        while self.failure is None and not self.is_within and not self.evaluator.is_due:
            self._guarded(self._tell_time)
            if not self._put_by or self._put_by[0][0] == _TAKE:
                break
            what, given = self._put_by.popleft()
            getattr(super(), what)(*given)
        if not self._is_behind and not self._put_by:
            self._spent = 0.0
            self.behind.left(self)

    def _leave_inputs(self) -> None:
        # Else its thread would wait for ever.
        self.finish_window()
        self._put_by.clear()
        self._is_behind = False
        self.behind.left(self)
        super()._leave_inputs()
