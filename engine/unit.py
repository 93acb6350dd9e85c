"""Computational units: instances of transformations, with input streams and one output
([Introspection15 §3.1], [DyKnow10 Def. 5.10]).

A unit receives batches in order of available time and offers batches to its output's generator.
What it makes of a batch is the subclass's `process`; order, isolation and ends are decided here.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, TypeVar

import numpy as np

from ..continuous.budget import Quarantined
from ..continuous.evaluator import ContinuousEvaluator
from ..continuous.flows import Flow
from ..continuous.results import WindowResult
from ..continuous.shared_windows import SharedWindows
from ..converters.objects import ObjectTable
from ..converters.to_samples import ResultConverter
from ..converters.to_triples import SampleConverter
from ..ontology.units import Conversion
from ..streams.generator import StreamGenerator
from ..streams.sample import Column, FieldType, Mask, SampleBatch, Times
from ..streams.time import TIME_MAX, TIME_MIN, format_time
from .behind import Behind, Overwhelmed, Task, Turns, Went
from .busy import BusyTime
from .changes import Role
from .stream_view import flow_of
from .supervision import ErrorCounters
from .views import Since

T = TypeVar("T")
UnitFunction = Callable[..., tuple[np.ndarray[Any, Any], Mask]]
"""An implementation: ``f(objects, valid, *inputs) -> (values, present)``, all shape ``(n,)``.

``objects`` are integer keys of the samples' objects, ``valid`` times in ns, one float array per
input of the transformation. It keeps its own state between calls.
"""


class ComputationalUnit(ABC):
    """A unit at work. ``users`` counts who needs its output; the engine stops it with the last.

    A unit that raises is cut off from its inputs, with the reason in ``failure``; other units
    and whoever published go on.
    """

    role = Role.UNIT
    waits_for_all: ClassVar[bool] = True
    """Whether what it makes waits for all inputs, so that a sample may come after that."""
    knows_codes = True
    """Whether it keeps codes of its inputs' texts beyond a call."""

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
        self.behind = Behind()
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
        self, since: Since = Since.NOW, after: int | None = None, until: int | None = None
    ) -> None:
        """Subscribe to the inputs; from the start of what they keep, if asked.

        The past of all inputs comes first, then how far each of them is: a unit of several inputs
        sees the same as if it had been there when their samples came. With ``after`` (ns) it sees
        nothing that was available by then, whether that has come already or not; with ``until``
        nothing that is available later.
        """
        self._after = after
        self._until = self.output.ends_at = until
        if since is Since.START or after is not None:
            for source in self.sources:
                for segment in source.stream.since(0):
                    self.receive(source, segment.batch)
        for source in self.sources:
            self.connect(source)

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
        known = self._watermarks.get(source)
        if known is not None and batch.available[0] < known and self.waits_for_all:
            # It was not waited for, and what it says now was due before.
            batch = self.in_time(source, batch, known - 1)
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
            side.offer(late.with_available(side.stamps_at(moments)))
        return batch.take(kept)

    def cut_off(self, reason: str) -> None:
        """It stops for good without an error of the system: its own rule says so."""
        self.failure = reason
        self._leave_inputs()

    def _leave_inputs(self) -> None:
        # A unit may fail on the past, before it has subscribed to anything.
        while self._subscribed:
            self._subscribed.pop().unsubscribe(self)


class SelectionUnit(ComputationalUnit):
    """Selects one object's samples out of a stream of many ([Events14 §V.C]).

    Cost: a table look-up per sample; the table grows with the distinct ids of the stream.
    """

    knows_codes = False

    def __init__(self, *args: Any, id_field: str, object_id: int, objects: ObjectTable) -> None:
        super().__init__(*args)
        self._id_field = id_field
        self._object_id = object_id
        self._objects = objects

    def process(self, source: StreamGenerator, batch: SampleBatch) -> None:
        ids, present = self._objects.ids(batch.columns[self._id_field])
        chosen = (ids == self._object_id) & present
        if bool(chosen.any()):
            self.output.offer(batch.take(chosen))


@dataclass(frozen=True, slots=True)
class InputPort:
    """Which field feeds an input of the implementation, with the conversion into its unit."""

    field: str
    conversion: Conversion


class FunctionUnit(ComputationalUnit):
    """Applies an implementation to the samples of one stream, sample by sample, object by object.

    ``id_fields`` tell the objects of the input apart; ``carried`` are pairs of an id field of the
    input and the field of the output that takes it over. The output carries these and the value;
    times are kept. A sample that lacks a value or an object gives nothing.
    """

    def __init__(
        self,
        *args: Any,
        function: UnitFunction,
        ports: Sequence[InputPort],
        id_fields: Sequence[str],
        carried: Sequence[tuple[str, str]],
        output_field: str,
    ) -> None:
        super().__init__(*args)
        self._function = function
        self._ports = tuple(ports)
        self._id_fields = tuple(id_fields)
        self._carried = tuple(carried)
        self._output_field = output_field
        self._keys: dict[tuple[int, ...], int] = {}

    def process(self, source: StreamGenerator, batch: SampleBatch) -> None:
        needed = [batch.columns[port.field] for port in self._ports]
        needed += [batch.columns[field] for field in self._id_fields]
        complete = np.logical_and.reduce([column.present for column in needed])
        if not bool(complete.all()):
            batch = batch.take(complete)
        if not len(batch):
            return
        inputs = [
            port.conversion.apply(batch.columns[port.field].values.astype(np.float64))
            for port in self._ports
        ]
        values, present = self._function(self._objects(batch), batch.valid, *inputs)
        present = present & np.isfinite(values)
        columns = {self._output_field: Column(FieldType.FLOAT, values[present])}
        for field, output in self._carried:
            columns[output] = batch.columns[field].take(present)
        result = SampleBatch(batch.available[present], batch.valid[present], columns)
        self.output.offer(result)

    def _objects(self, batch: SampleBatch) -> Times:
        """A number for each sample's object, or tuple of objects of an n-ary feature."""
        columns = [batch.columns[f].values.astype(np.int64) for f in self._id_fields]
        if not columns:
            return np.zeros(len(batch), np.int64)
        if len(columns) == 1:
            return columns[0]
        tuples = zip(*(column.tolist() for column in columns), strict=True)
        return np.array([self._keys.setdefault(key, len(self._keys)) for key in tuples], np.int64)


class WindowUnit(ComputationalUnit):
    """A unit that evaluates windows: the samples of its inputs, converted to timed triples, go to
    ``evaluator``; those that are too late for every window are left out before. Texts become terms
    on the way."""

    knows_codes = False

    def __init__(
        self,
        *args: Any,
        evaluator: ContinuousEvaluator | SharedWindows,
        converters: Mapping[str, Sequence[SampleConverter]],
    ) -> None:
        super().__init__(*args)
        self.evaluator = evaluator
        self._converters = converters
        self._put_by: deque[tuple[str, tuple[Any, ...]]] = deque()
        """What inputs have said since the unit is behind."""
        self._task: Task | None = None
        self._error: Exception | None = None
        self._is_behind = False
        self._spent = 0.0
        """Seconds that its windows took since it fell behind."""
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
        self, since: Since = Since.NOW, after: int | None = None, until: int | None = None
    ) -> None:
        self.evaluator.defers = self.behind.turns is not None
        super().start(since, after, until)

    def receive(self, source: StreamGenerator, batch: SampleBatch) -> None:
        if not self._puts_by("receive", source, batch):
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
        for converter in self._converters[source.name]:
            self.evaluator.push(source.name, converter.convert(batch))

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
        return done

    def again(self, turn: Sequence[Went]) -> None:
        """Do what `go_on` did."""
        self._guarded(lambda: self._again(turn))
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
        if task is None and begins:
            task = turns.begin(self.evaluator.close_next)
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
            done += self._went()
            self.emit(self.evaluator.taken())
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
        if not turn[-1].windows:
            raise Overwhelmed(turn[-1].stopped)

    def _puts_by(self, what: str, *given: Any) -> bool:
        """Whether this is for later: windows have to close before."""
        if not self._is_behind and not self._put_by:
            return False
        self._put_by.append((what, given))
        return True

    def _catch_up(self) -> None:
        """Say and take what had to wait for windows that have closed."""
        while self.failure is None and not self.is_within and not self.evaluator.is_due:
            self._guarded(self._tell_time)
            if not self._put_by:
                break
            what, given = self._put_by.popleft()
            getattr(super(), what)(*given)
        if not self._is_behind:
            self._spent = 0.0
            self.behind.left(self)

    def _leave_inputs(self) -> None:
        # Else its thread would wait for ever.
        self.finish_window()
        self._put_by.clear()
        self._is_behind = False
        self.behind.left(self)
        super()._leave_inputs()


class Answer:
    """The results of a query as samples of ``output``.

    A result becomes available right after its window's end, which is its valid time; after the
    results before it, where windows end closer together than they have solutions: available times
    are unique. ``hear`` is told the result of each window as the query gave it.
    """

    def __init__(
        self,
        output: StreamGenerator,
        results: ResultConverter,
        hear: Callable[[WindowResult], None] | None = None,
    ) -> None:
        self.output = output
        self.results = results
        self.hear = hear
        self._sent = TIME_MIN
        """The available time (ns) of the last sample."""

    def give(self, result: WindowResult) -> None:
        """The result of a window; windows come in order."""
        if self.hear is not None:
            self.hear(result)
        batch = self.results.convert(result, max(result.end, self._sent) + 1)
        if len(batch):
            self._sent = int(batch.available[-1])
            self.output.offer(batch)


class QueryUnit(WindowUnit):
    """The C-SPARQL computational unit ([Events14 §V.B, Fig. 2]): samples in, converted to timed
    triples, evaluated in windows, results converted back to samples (`Answer`, which tells
    ``hear``).
    """

    def __init__(
        self,
        *args: Any,
        evaluator: ContinuousEvaluator,
        converters: Mapping[str, Sequence[SampleConverter]],
        results: ResultConverter,
        hear: Callable[[WindowResult], None] | None = None,
    ) -> None:
        super().__init__(*args, evaluator=evaluator, converters=converters)
        self.evaluator: ContinuousEvaluator = evaluator
        self._answer = Answer(self.output, results, hear)

    def explain(self) -> str:
        """How the query is evaluated; its costs are estimated from the rates of its streams."""
        return self.evaluator.explain(self.flows())

    def emit(self, results: Sequence[WindowResult]) -> None:
        self.windows += len(results)
        for result in results:
            self._answer.give(result)
