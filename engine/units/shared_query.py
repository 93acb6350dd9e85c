"""A query that is evaluated once for many ([Events14 §V.B], DESIGN §3 "Sharing"): that of a
template for its requests, or what registered queries have in common.

A `TemplateUnit` reads the streams and keeps the windows. Each request or query that it serves has
an `InstanceUnit`, which makes its stream out of its part of the results.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from ...continuous.operators.results import WindowResult
from ...continuous.sharing.instance_results import InstanceResults
from ...continuous.sharing.shared_windows import SharedWindows
from ...converters.to_samples import ResultConverter
from ...converters.to_triples import SampleConverter
from ...streams.generator import StreamGenerator
from ...streams.sample import Column, Field, FieldType, SampleBatch, Schema
from ...streams.time import TIME_MIN
from .base import ComputationalUnit
from .query import Answer
from .windowed import WindowUnit

TALLY = Schema(
    (Field("instances", FieldType.INTEGER), Field("answered", FieldType.INTEGER)),
)
"""What the stream of a template's unit says of each window: how many instances there were, and how
many of them had a result."""


class TemplateUnit(WindowUnit):
    """The instances of one template (`TemplateEvaluator`), or queries that differ in constants
    (`SimilarQueriesEvaluator`), over the same streams, as one query.

    Law (tests/laws/engine/test_shared_requests.py, test_shared_queries.py): the stream of a request
    or query says what it would say had it a unit of its own, from the first window on that begins
    after it came; of the windows that were open then it knows the samples before it as well. So do
    the results that are kept of a registered query.

    Cost: a window as the evaluator says, then some 0.2 ms for each instance that has a result in
    it, and a microsecond for any other whose results are kept; a promise of time only reaches the
    streams that somebody follows.
    """

    def __init__(
        self,
        *args: Any,
        evaluator: SharedWindows,
        converters: Mapping[str, Sequence[SampleConverter]],
    ) -> None:
        super().__init__(*args, evaluator=evaluator, converters=converters)
        self.evaluator: SharedWindows = evaluator
        self._instances: dict[int, InstanceUnit] = {}
        self._followed: set[InstanceUnit] = set()
        self._heard: dict[int, Callable[[WindowResult], None]] = {}
        """Who hears of all results of an instance, of those without solutions as well."""
        self._late_of_instances: dict[StreamGenerator, dict[InstanceUnit, StreamGenerator]] = {}
        self._sent = TIME_MIN

    def add(self, instance: InstanceUnit, number: int) -> None:
        """A new instance, with its number in the evaluator; it has results from the next window
        on."""
        self._instances[number] = instance
        if instance.hear is not None:
            self._heard[number] = instance.hear

    def remove(self, number: int) -> None:
        """The instance with this number is no more."""
        instance = self._instances.pop(number)
        self._followed.discard(instance)
        self._heard.pop(number, None)
        for sides in self._late_of_instances.values():
            sides.pop(instance, None)
        self.between_windows(lambda: self.evaluator.remove(number))

    def pass_late_of(
        self, instance: InstanceUnit, source: StreamGenerator, side: StreamGenerator
    ) -> None:
        """From now on ``side`` gets the samples of ``source`` that are late for ``instance``."""
        self._late_of_instances.setdefault(source, {})[instance] = side
        self.tell_late(source, side)

    def keep_late_of(self, instance: InstanceUnit, source: StreamGenerator) -> None:
        """Those of ``instance`` are only counted again."""
        self._late_of_instances[source].pop(instance, None)

    def late_streams_of(self, source: StreamGenerator) -> Sequence[StreamGenerator]:
        own = super().late_streams_of(source)
        return (*own, *self._late_of_instances.get(source, {}).values())

    @property
    def waits_as_its_inputs_do(self) -> bool:
        """Whether samples that are in time for the inputs are in time for the windows: not so when
        an input has ended, and with it all windows, and may go on."""
        for source in self.sources:
            limit = self.evaluator.limit(source.name)
            known = source.watermark
            if limit is not None and not source.is_idle and (known is None or limit >= known):
                return False
        return True

    def follow(self, instance: InstanceUnit, followed: bool) -> None:
        """Somebody reads an instance's stream and has to hear of time, or nobody any more."""
        if not followed:
            self._followed.discard(instance)
            return
        self._followed.add(instance)
        if self.output.watermark is not None:
            instance.output.advance(self.output.watermark)

    def in_time(self, source: StreamGenerator, batch: SampleBatch, decided: int) -> SampleBatch:
        late = self.late
        kept = super().in_time(source, batch, decided)
        if self.late > late:
            for instance in self._instances.values():
                instance.late += self.late - late
        return kept

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

    def tell_idle(self, is_idle: bool) -> None:
        was_idle = self.output.is_idle
        super().tell_idle(is_idle)
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
                    instance.tell(result)
            if self._heard:
                for numbers, nothing in window.silent():
                    for number in numbers.tolist():
                        hear = self._heard.get(number)
                        if hear is not None:
                            hear(nothing)
            self._tally(window.end, len(answered))

    def _tally(self, end: int, answered: int) -> None:
        self._sent = max(end, self._sent) + 1
        columns = {
            name: Column(FieldType.INTEGER, np.array([count], np.int64))
            for name, count in (("instances", len(self._instances)), ("answered", answered))
        }
        times = np.array([self._sent], np.int64)
        self.output.emit(SampleBatch(times, np.array([end], np.int64), columns))


class InstanceUnit(ComputationalUnit):
    """The part of a request or query in the results of those that share one, as samples.

    Its template tells it what it has to know: it does not subscribe to that one's stream, which
    says other things. ``enter`` gives it a number in the template's evaluator, ``evaluation``
    explains that for people; ``hear`` is told the result of each window as the query gave it.
    """

    waits_for_all = False

    def __init__(
        self,
        *args: Any,
        template: TemplateUnit,
        enter: Callable[[], int],
        evaluation: Callable[[], str],
        results: ResultConverter,
        hear: Callable[[WindowResult], None] | None = None,
    ) -> None:
        super().__init__(*args)
        self.hear = hear
        self._template = template
        self._enter = enter
        self._evaluation = evaluation
        self._answer = Answer(self.output, results, hear)
        self._number: int | None = None

    def connect(self, source: StreamGenerator) -> None:
        self._number = self._template.between_windows(self._enter)
        self._template.add(self, self._number)
        self.output.on_followed = lambda followed: self._template.follow(self, followed)
        if source.is_ended:
            self.output.end()
        elif source.is_idle:
            self.output.fall_idle()

    @property
    def template(self) -> TemplateUnit:
        """The unit that evaluates for it and others."""
        return self._template

    @property
    def reads(self) -> Sequence[StreamGenerator]:
        """The streams whose samples are in the windows."""
        return self._template.reads

    @property
    def lag(self) -> int | None:
        # What it promises itself is told only where somebody follows it.
        return self._template.lag

    @property
    def least_watermark(self) -> int | None:
        return self._template.least_watermark

    @property
    def late_inputs(self) -> Sequence[StreamGenerator]:
        return self._template.late_inputs

    def pass_late_to(self, source: StreamGenerator, side: StreamGenerator) -> None:
        self._template.pass_late_of(self, source, side)

    def forget_late(self, source: StreamGenerator) -> None:
        self._template.keep_late_of(self, source)

    def explain(self) -> str:
        """The query with its arguments, and how it is evaluated together with others."""
        return f"{self.parameters['query'].rstrip()}\n\n{self._evaluation()}"

    def tell(self, result: WindowResult) -> None:
        """Its result of a window."""
        self._guarded(lambda: self._answer.give(result))

    def process(self, source: StreamGenerator, batch: SampleBatch) -> None:
        raise NotImplementedError("the template's unit tells it its results")

    def _leave_inputs(self) -> None:
        if self._number is not None:
            self._template.remove(self._number)
            self._number = None
            self.output.on_followed = None
