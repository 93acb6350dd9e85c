"""One evaluation for several queries ([Events14 §V.B], DESIGN §3 "Sharing"): for the requests of a
template, or for registered queries that differ in constants.

A `TemplateUnit` reads the streams and has the windows. Each request or query that it serves has an
`InstanceUnit`, which emits its part of the results.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from ...continuous.operators.results import WindowResult
from ...continuous.sharing.instance_results import InstanceResults
from ...continuous.sharing.shared_windows import SharedWindows
from ...converters.to_samples import ResultConverter
from ...converters.to_triples import ToTriples
from ...streams.generator import StreamGenerator
from ...streams.sample import Column, Field, FieldType, SampleBatch, Schema
from ...streams.time import TIME_MIN
from .base import ComputationalUnit
from .query import ResultEmitter
from .windowed import WindowUnit

TALLY = Schema(
    (Field("instances", FieldType.INTEGER), Field("answered", FieldType.INTEGER)),
)
"""The output of a template's unit: for each window the number of instances, and of those with a
result."""


class TemplateUnit(WindowUnit):
    """Evaluates the instances of one template (`TemplateEvaluator`), or queries that differ in
    constants (`SimilarQueriesEvaluator`), over the same streams as one query.

    Law (tests/laws/engine/test_shared_requests.py, test_shared_queries.py): from the first window
    that begins after its start, an instance's stream equals that of a unit of its own. In windows
    that are open at its start, the instance also sees the earlier samples. The same holds for the
    kept results of a registered query.

    Cost: that of the evaluator for a window, some 0.2 ms for each instance with a result in it, and
    a microsecond for each other one whose results are kept. Only instances with followers get
    watermarks.
    """

    def __init__(
        self,
        *args: Any,
        evaluator: SharedWindows,
        converters: Mapping[str, Sequence[ToTriples]],
    ) -> None:
        super().__init__(*args, evaluator=evaluator, converters=converters)
        self.evaluator: SharedWindows = evaluator
        self._instances: dict[int, InstanceUnit] = {}
        self._followed: set[InstanceUnit] = set()
        self._on_result: dict[int, Callable[[WindowResult], None]] = {}
        """Callbacks for all results of an instance, by its number, the empty ones included."""
        self._late_of_instances: dict[StreamGenerator, dict[InstanceUnit, StreamGenerator]] = {}
        self._last_available = TIME_MIN
        """The available time (ns) of the last sample."""

    def add(self, instance: InstanceUnit, number: int) -> None:
        """Add an instance by its number in the evaluator, which evaluates it from now on."""
        self._instances[number] = instance
        if instance.on_result is not None:
            self._on_result[number] = instance.on_result

    def remove(self, number: int) -> None:
        """Remove the instance with this number."""
        instance = self._instances.pop(number)
        self._followed.discard(instance)
        self._on_result.pop(number, None)
        for sides in self._late_of_instances.values():
            sides.pop(instance, None)
        self.between_windows(lambda: self.evaluator.remove(number))

    def pass_late_of(
        self, instance: InstanceUnit, source: StreamGenerator, side: StreamGenerator
    ) -> None:
        """Emit the samples of ``source`` that are late for ``instance`` to ``side`` from now on."""
        self._late_of_instances.setdefault(source, {})[instance] = side
        self.start_late(source, side)

    def drop_late_of(self, instance: InstanceUnit, source: StreamGenerator) -> None:
        """Only count the samples that are late for ``instance`` from now on."""
        self._late_of_instances[source].pop(instance, None)

    def late_streams_of(self, source: StreamGenerator) -> Sequence[StreamGenerator]:
        own = super().late_streams_of(source)
        return (*own, *self._late_of_instances.get(source, {}).values())

    @property
    def accepts_timely_samples(self) -> bool:
        """Whether every sample in time for its input is in time for the windows. It is not if an
        input has ended, which closed all windows, and goes on."""
        for source in self.sources:
            limit, watermark = self.evaluator.limit(source.name), source.watermark
            is_late = limit is not None and (watermark is None or limit >= watermark)
            if is_late and not source.is_idle:
                return False
        return True

    def follow(self, instance: InstanceUnit, is_followed: bool) -> None:
        """Send watermarks to the stream of an instance while it has readers, which need them."""
        if not is_followed:
            self._followed.discard(instance)
            return
        self._followed.add(instance)
        if self.output.watermark is not None:
            instance.output.advance(self.output.watermark)

    def in_time(self, source: StreamGenerator, batch: SampleBatch, decided: int) -> SampleBatch:
        late = self.late
        timely = super().in_time(source, batch, decided)
        if self.late > late:
            for instance in self._instances.values():
                instance.late += self.late - late
        return timely

    def advance_output(self, watermark: int) -> None:
        super().advance_output(watermark)
        for instance in tuple(self._followed):
            instance.output.advance(watermark)

    def end_output(self) -> None:
        super().end_output()
        if self.all_ended:
            for instance in tuple(self._instances.values()):
                if self.output.watermark is not None:
                    instance.output.advance(self.output.watermark)
                instance.output.end()

    def set_output_idle(self, is_idle: bool) -> None:
        was_idle = self.output.is_idle
        super().set_output_idle(is_idle)
        if self.output.is_idle != was_idle:
            for instance in tuple(self._instances.values()):
                instance.idleness_changed(self.output)

    def resume(self, source: StreamGenerator) -> None:
        super().resume(source)
        for instance in tuple(self._instances.values()):
            instance.output.resume()

    def emit(self, results: Sequence[InstanceResults]) -> None:
        self.windows += len(results)
        for window in results:
            answered = window.answered.tolist()
            for number in answered:
                instance = self._instances.get(number)
                result = window.of(number)
                if instance is not None and result is not None:
                    instance.emit(result)
            if self._on_result:
                for numbers, empty in window.silent():
                    for number in numbers.tolist():
                        on_result = self._on_result.get(number)
                        if on_result is not None:
                            on_result(empty)
            self._emit_tally(window.end, len(answered))

    def _emit_tally(self, end: int, answered: int) -> None:
        self._last_available = max(end, self._last_available) + 1
        columns = {
            name: Column(FieldType.INTEGER, np.array([count], np.int64))
            for name, count in (("instances", len(self._instances)), ("answered", answered))
        }
        times = np.array([self._last_available], np.int64)
        self.output.emit(SampleBatch(times, np.array([end], np.int64), columns))


class InstanceUnit(ComputationalUnit):
    """Emits the results of one request or query of a shared evaluation.

    The template's unit calls it directly. It does not subscribe to the template's output, which has
    only the tally. ``enter`` adds it to the template's evaluator and returns its number;
    ``evaluation`` prints the evaluation. ``on_result`` is called with the result of each window, as
    terms.
    """

    waits_for_all = False

    def __init__(
        self,
        *args: Any,
        template: TemplateUnit,
        enter: Callable[[], int],
        evaluation: Callable[[], str],
        results: ResultConverter,
        on_result: Callable[[WindowResult], None] | None = None,
    ) -> None:
        super().__init__(*args)
        self.on_result = on_result
        self._template = template
        self._enter = enter
        self._evaluation = evaluation
        self._emitter = ResultEmitter(self.output, results, self.counters, on_result)
        self._number: int | None = None

    def connect(self, source: StreamGenerator) -> None:
        self._number = self._template.between_windows(self._enter)
        self._template.add(self, self._number)
        self.output.on_followed = lambda is_followed: self._template.follow(self, is_followed)
        if source.is_ended:
            self.output.end()
        elif source.is_idle:
            self.output.fall_idle()

    @property
    def template(self) -> TemplateUnit:
        """The unit that evaluates this query together with others."""
        return self._template

    @property
    def reads(self) -> Sequence[StreamGenerator]:
        """The streams whose samples are in the windows."""
        return self._template.reads

    @property
    def lag(self) -> int | None:
        # Its own output has watermarks only while it is followed.
        return self._template.lag

    @property
    def least_watermark(self) -> int | None:
        return self._template.least_watermark

    @property
    def late_inputs(self) -> Sequence[StreamGenerator]:
        return self._template.late_inputs

    def pass_late_to(self, source: StreamGenerator, side: StreamGenerator) -> None:
        self._template.pass_late_of(self, source, side)

    def drop_late(self, source: StreamGenerator) -> None:
        self._template.drop_late_of(self, source)

    def explain(self) -> str:
        """Print the query with its arguments, and the shared evaluation."""
        return f"{self.parameters['query'].rstrip()}\n\n{self._evaluation()}"

    def emit(self, result: WindowResult) -> None:
        """Emit the result of its next window."""
        self._guarded(lambda: self._emitter.emit(result))

    def process(self, source: StreamGenerator, batch: SampleBatch) -> None:
        raise NotImplementedError("the template's unit calls `emit`")

    def _leave_inputs(self) -> None:
        if self._number is not None:
            self._template.remove(self._number)
            self._number = None
            self.output.on_followed = None
