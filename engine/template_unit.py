"""The query of a template, evaluated once for many requests ([Events14 §V.B], DESIGN §3 "Sharing").

A `TemplateUnit` reads the streams and keeps the windows. Each request that it serves has an
`InstanceUnit`, which makes the request's stream out of its part of the results.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from pyoxigraph import Variable

from ..continuous.instance_results import InstanceResults
from ..continuous.instances import TemplateEvaluator
from ..continuous.results import WindowResult
from ..converters.to_samples import ResultConverter
from ..converters.to_triples import SampleConverter
from ..rdf.dictionary import Term
from ..streams.generator import StreamGenerator
from ..streams.sample import Column, Field, FieldType, SampleBatch, Schema
from ..streams.time import TIME_MIN
from .unit import Answer, ComputationalUnit, WindowUnit

TALLY = Schema(
    (Field("instances", FieldType.INTEGER), Field("answered", FieldType.INTEGER)),
)
"""What the stream of a template's unit says of each window: how many instances there were, and how
many of them had a result."""


class TemplateUnit(WindowUnit):
    """The instances of one template over the same streams, as one query (`TemplateEvaluator`).

    Law (tests/laws/test_shared_requests.py): the stream of a request says what it would say had the
    request a unit of its own, from the first window on that begins after the request; of the
    windows that were open then it knows the samples before it as well.

    Cost: a window as `TemplateEvaluator` says, then some 0.2 ms for each instance that has a result
    in it; a promise of time only reaches the streams that somebody follows.
    """

    def __init__(
        self,
        *args: Any,
        evaluator: TemplateEvaluator,
        converters: Mapping[str, Sequence[SampleConverter]],
    ) -> None:
        super().__init__(*args, evaluator=evaluator, converters=converters)
        self.evaluator: TemplateEvaluator = evaluator
        self._instances: dict[int, InstanceUnit] = {}
        self._followed: set[InstanceUnit] = set()
        self._sent = TIME_MIN

    def add(self, instance: InstanceUnit, arguments: Mapping[Variable, Term]) -> int:
        """A new instance, by its number; it has results from the next window on."""
        number = self.evaluator.add(arguments)
        self._instances[number] = instance
        return number

    def remove(self, number: int) -> None:
        """The instance with this number is no more."""
        self._followed.discard(self._instances.pop(number))
        self.evaluator.remove(number)

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

    def progress(self, source: StreamGenerator, watermark: int) -> None:
        self._emit(self.evaluator.advance(source.name, watermark))
        least = self.least_watermark
        if least is not None:
            self.output.advance(least + 1)
            for instance in tuple(self._followed):
                instance.output.advance(least + 1)

    def finish(self, source: StreamGenerator) -> None:
        self._emit(self.evaluator.end(source.name))
        super().finish(source)
        if self.all_ended:
            for instance in tuple(self._instances.values()):
                if self.output.watermark is not None:
                    instance.output.advance(self.output.watermark)
                instance.output.end()

    def _leave_idle_behind(self) -> None:
        was_idle = self.output.is_idle
        super()._leave_idle_behind()
        if self.output.is_idle != was_idle:
            for instance in tuple(self._instances.values()):
                instance.idleness_changed(self.output)

    def resume(self, source: StreamGenerator) -> None:
        super().resume(source)
        for instance in tuple(self._instances.values()):
            instance.output.resume()

    def _emit(self, windows: Sequence[InstanceResults]) -> None:
        for window in windows:
            answered = window.answered.tolist()
            for number in answered:
                instance = self._instances.get(number)
                result = window.of(number)
                if instance is not None and result is not None:
                    instance.tell(result)
            self._tally(window.end, len(answered))

    def _tally(self, end: int, answered: int) -> None:
        self._sent = max(end, self._sent) + 1
        columns = {
            name: Column(FieldType.INTEGER, np.array([count], np.int64))
            for name, count in (("instances", len(self._instances)), ("answered", answered))
        }
        times = np.array([self._sent], np.int64)
        self.output.offer(SampleBatch(times, np.array([end], np.int64), columns))


class InstanceUnit(ComputationalUnit):
    """The part of a request in the results of its template, as samples.

    Its template tells it what it has to know: it does not subscribe to that one's stream, which
    says other things.
    """

    waits_for_all = False

    def __init__(
        self,
        *args: Any,
        template: TemplateUnit,
        arguments: Mapping[Variable, Term],
        results: ResultConverter,
    ) -> None:
        super().__init__(*args)
        self._template = template
        self._arguments = dict(arguments)
        self._answer = Answer(self.output, results)
        self._number: int | None = None

    def connect(self, source: StreamGenerator) -> None:
        self._number = self._template.add(self, self._arguments)
        self.output.on_followed = lambda followed: self._template.follow(self, followed)
        if source.is_ended:
            self.output.end()
        elif source.is_idle:
            self.output.fall_idle()

    def explain(self) -> str:
        """The query with its arguments, and how it is evaluated together with others."""
        return f"{self.parameters['query'].rstrip()}\n\n{self._template.evaluator.explain()}"

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
