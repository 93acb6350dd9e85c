"""Continuous queries evaluated as one: the requests of a template, or registered queries that
differ in constants (DESIGN §3 "Sharing")."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from ....continuous.operators.results import WindowResult
from ....continuous.sharing.instance_results import (
    InstancePart,
    InstanceResults,
    InstancesInBulk,
    JoinedResults,
    Numbers,
)
from ....continuous.sharing.shared_windows import SharedWindows
from ....converters.errors import ConversionError
from ....converters.results_to_samples import ResultConverter
from ....converters.to_triples import ToTriples
from ....streams.generator import StreamGenerator
from ....streams.sample import SampleBatch, Times
from ....streams.string_pool import StringPool
from ....streams.time import TIME_MIN
from ...model.result_schema import ResultForm
from ..query import ResultEmitter
from ..selection import SelectionUnit
from ..windowed import WindowUnit
from .instances import InstanceUnit, SharingUnit
from .result_log import ResultLog

_TEXTS: Final = 1 << 16
_CHARACTERS: Final = 4 << 20
"""The texts of a field, and their characters, from which on a pool is replaced by an empty one."""
_SHARE: Final = 4
"""The number of texts per sample of a result up to which it is not."""


class TemplateUnit(SharingUnit["QueryInstance"], WindowUnit):
    """Evaluates the instances of one template (`TemplateEvaluator`), or queries that differ in
    constants (`SimilarQueriesEvaluator`), over the same streams as one query.

    Law (tests/laws/engine/test_shared_requests.py, test_shared_queries.py): from the first window
    that begins after its start, an instance's stream equals that of a unit of its own. In windows
    that are open at its start, the instance also sees the earlier samples. The same holds for the
    kept results of a registered query.

    The results of a window become samples in one pass. Those of an instance whose stream has no
    readers wait in a `ResultLog` until the stream is looked at.

    Cost: that of the evaluator for a window, and numpy per column of the results. Beyond it some
    15 µs for each instance with results that has readers, and a microsecond for each other one; 0.2
    ms for one whose results are kept as terms.
    """

    def __init__(
        self,
        *args: Any,
        evaluator: SharedWindows,
        converters: Mapping[str, Sequence[ToTriples]],
        selections: Sequence[SelectionUnit] = (),
    ) -> None:
        super().__init__(*args, evaluator=evaluator, converters=converters)
        self.evaluator: SharedWindows = evaluator
        evaluator.splits = False
        self.selections = tuple(selections)
        """The units that select the objects of the instances, if these have objects of their
        own."""
        self._on_result: dict[int, Callable[[WindowResult], None]] = {}
        """Callbacks for all results of an instance, by its number, the empty ones included."""
        self._last_available = TIME_MIN
        """The available time (ns) of the last sample."""
        self._form: ResultForm | None = None
        """The form of the results that are converted in one pass: that of the first instance."""
        self._converter: ResultConverter | None = None
        self._pools: dict[str, StringPool] = {}
        self._lost: list[ConversionError] = []
        self._separate: set[int] = set()
        """The instances whose results are converted one by one."""
        self._read: dict[int, QueryInstance] = {}
        """The instances whose streams have readers."""
        self._log = ResultLog()

    def add(self, instance: QueryInstance, number: int) -> None:
        super().add(instance, number)
        if self._converter is None:
            self._form = instance.form
            self._converter = self._form.converter(self._pools)
            self._converter.lost = self._lost
        if instance.on_result is not None:
            self._on_result[number] = instance.on_result
        if instance.on_result is not None or instance.form != self._form:
            self._separate.add(number)

    def remove(self, number: int) -> None:
        # The results that wait name the instance by its number, which it loses now.
        self.deliver()
        self._on_result.pop(number, None)
        self._separate.discard(number)
        self._read.pop(number, None)
        super().remove(number)

    def forget(self, number: int) -> None:
        self.evaluator.remove(number)

    def set_read(self, number: int, instance: QueryInstance, is_read: bool) -> None:
        """Emit the results of an instance at once while its stream has readers."""
        # A stream with readers gets its results at once, and must first get those that wait.
        self.deliver()
        if is_read:
            self._read[number] = instance
        else:
            self._read.pop(number, None)

    def deliver(self) -> None:
        """Emit what waits for a reader."""
        for number, batch in self._log.take():
            instance = self._instances.get(number)
            # The log has the samples of all instances, and those with readers got theirs at once.
            if instance is not None and number not in self._read:
                instance.take(batch)

    def can_enter(self, objects: Sequence[str]) -> bool:
        """Whether an instance for these objects would be as a query of its own."""
        return self.accepts_timely_samples and can_enter(self.selections, objects)

    def between_steps(self, change: Callable[[], Any]) -> Any:
        return self.between_windows(change)

    @property
    def accepts_timely_samples(self) -> bool:
        """Whether every sample in time for its input is in time for the windows. It is not if an
        input has ended, which closed all windows, and goes on."""
        fresh = self.watermarks_if_new()
        limits = ((source, self.evaluator.limit(source.name)) for source in self.sources)
        return all(limit is None or limit < fresh.get(source, TIME_MIN) for source, limit in limits)

    def in_time(self, source: StreamGenerator, batch: SampleBatch, decided: int) -> SampleBatch:
        late = self.late
        timely = super().in_time(source, batch, decided)
        if self.late > late:
            for instance in self._instances.values():
                instance.late += self.late - late
        return timely

    def advance_output(self, watermark: int) -> None:
        super().advance_output(watermark)
        self.promise_to_followed()

    def end_output(self) -> None:
        # A sample after the end would let the stream of its instance go on.
        self.deliver()
        super().end_output()

    def set_output_idle(self, is_idle: bool) -> None:
        if self.output.is_idle != is_idle:
            # A later sample would wake the stream of its instance.
            self.deliver()
        super().set_output_idle(is_idle)

    def emit(self, results: Sequence[InstanceResults | InstancesInBulk]) -> None:
        for result in results:
            if isinstance(result, InstancesInBulk) and self._emit_windows(result):
                continue
            for window in result.windows():
                self._emit_window(window)

    def _emit_windows(self, results: InstancesInBulk) -> bool:
        """Emit the results of successive windows in one pass; return whether that is possible."""
        converted = None if self._separate else self._converted(results)
        if converted is None:
            return False
        ends = np.array([end for _, end in results.spans], np.int64)
        # In place of the valid time, `batch` puts instance and window into one number.
        numbers, windows = np.divmod(converted.valid, len(ends))
        self._emit_samples(numbers, _stamped(converted, ends[windows]))
        last = np.append(converted.valid[1:] != converted.valid[:-1], True)[: len(windows)]
        self.windows += len(ends)
        self._emit_tallies(ends, np.bincount(windows[last], minlength=len(ends)))
        return True

    def _emit_window(self, window: InstanceResults) -> None:
        self.windows += 1
        answered = 0
        for part in window.parts:
            numbers = part.answered
            answered += len(numbers)
            if len(numbers):
                self._emit_part(part, numbers, window.end)
        if self._on_result:
            for silent, empty in window.silent():
                for number in silent.tolist():
                    on_result = self._on_result.get(number)
                    if on_result is not None:
                        on_result(empty)
        self._emit_tallies(np.array([window.end]), np.array([answered]))

    def _emit_tallies(self, ends: Times, answered: NDArray[np.int64]) -> None:
        available = np.maximum(ends, self._last_available) + 1
        self._last_available = int(available[-1])
        self.emit_tallies(available, ends, answered)

    def _emit_part(self, part: InstancePart, answered: Numbers, end: int) -> None:
        """Emit the results of some instances of the window that ends at ``end`` (ns)."""
        converted = None
        if isinstance(part, JoinedResults) and len(self._separate) < len(self._instances):
            converted = self._converted(part)
        if converted is not None:
            numbers = converted.valid
            if self._separate:
                rows = ~np.isin(numbers, list(self._separate))
                numbers, converted = numbers[rows], converted.take(rows)
            self._emit_samples(numbers, _stamped(converted, np.full(len(numbers), end, np.int64)))
            answered = np.array([n for n in answered.tolist() if n in self._separate], np.int64)
        if not len(answered):
            return
        # These instances get their results at once, and must first get those that wait.
        self.deliver()
        for number in answered.tolist():
            instance = self._instances.get(number)
            result = part.of(number)
            if instance is not None and result is not None:
                instance.emit(result)

    def _converted(self, results: JoinedResults | InstancesInBulk) -> SampleBatch | None:
        """Convert the results of several instances in one pass, to samples in the order of
        `batch`. Return None where each result has to be converted by itself: to report which one
        has a value that no field holds, for instance."""
        # With a gap the samples of one result differ in time, as only `ResultEmitter` makes them.
        if self._converter is None or self.output.rules.gap:
            return None
        batch = results.batch()
        if batch is None:
            return None
        self._forget_texts(results.relation.rows)
        try:
            converted = self._converter.convert_batch(batch)
        except ConversionError:
            return None
        if self._lost:
            self._lost.clear()
            return None
        return converted

    def _forget_texts(self, rows: int) -> None:
        """Begin the pool of a field anew if most of its texts are not in results of ``rows``
        samples. Samples that have its codes keep it."""
        for name, pool in self._pools.items():
            is_large = len(pool) > _TEXTS or pool.characters > _CHARACTERS
            if is_large and len(pool) > _SHARE * rows:
                self._pools[name] = StringPool()

    def _emit_samples(self, numbers: Numbers, batch: SampleBatch) -> None:
        """Emit the samples of instances with readers, and let the others wait."""
        if self._read:
            read = sorted(self._read)
            starts = np.searchsorted(numbers, read).tolist()
            ends = np.searchsorted(numbers, read, "right").tolist()
            for number, start, until in zip(read, starts, ends, strict=True):
                instance = self._read.get(number)
                if start < until and instance is not None:
                    instance.take(batch.take(slice(start, until)))
        if len(self._read) < len(self._instances):
            self._log.add(numbers, batch)
            if self._log.is_full:
                self.deliver()


def _stamped(batch: SampleBatch, ends: Times) -> SampleBatch:
    """Return samples of windows with these ends; they are available right after it, as those of
    `ResultEmitter` are."""
    return SampleBatch(ends + 1, ends, batch.columns)


def can_enter(selections: Iterable[SelectionUnit | None], objects: Iterable[str]) -> bool:
    """Whether each selection, if there is one, can begin to select its object."""
    pairs = zip(selections, objects, strict=True)
    return all(one is None or one.can_enter(object) for one, object in pairs)


class QueryInstance(InstanceUnit):
    """Emits the results of one query of a shared evaluation, which have ``form``. ``on_result`` is
    called with the result of each window, as terms. ``objects`` (IRIs) are what the query needs
    from each of the ``selections`` of the evaluation."""

    def __init__(
        self,
        *args: Any,
        form: ResultForm,
        on_result: Callable[[WindowResult], None] | None = None,
        objects: Sequence[str] = (),
        **options: Any,
    ) -> None:
        super().__init__(*args, **options)
        self._objects = tuple(objects)
        self.form = form
        self.on_result = on_result
        results = form.converter(self.output.stream.pools)
        self._emitter = ResultEmitter(self.output, results, self.counters, on_result)

    @property
    def template(self) -> TemplateUnit:
        """The unit that evaluates this query together with others."""
        assert isinstance(self._template, TemplateUnit)
        return self._template

    def connect(self, source: StreamGenerator) -> None:
        super().connect(source)
        number = self.number
        if number is not None:
            for selection, object in zip(self.template.selections, self._objects, strict=True):
                selection.add(object)
            self.output.on_read = lambda is_read: self.template.set_read(number, self, is_read)
            self.output.catch_up = self.template.deliver

    def emit(self, result: WindowResult) -> None:
        """Emit the result of its next window."""
        self._guarded(lambda: self._emitter.emit(result))

    def take(self, batch: SampleBatch) -> None:
        """Emit samples that were made of its results."""
        self._guarded(lambda: self.output.emit(batch))

    def _leave_inputs(self) -> None:
        if self.number is not None:
            for selection, object in zip(self.template.selections, self._objects, strict=True):
                selection.remove(object)
        super()._leave_inputs()
        self.output.on_read = self.output.catch_up = None
