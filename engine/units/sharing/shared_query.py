"""Continuous queries evaluated as one: the requests of a template, or registered queries that
differ in constants (DESIGN §3 "Sharing")."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from ....continuous.operators.results import WindowResult
from ....continuous.sharing.instance_results import InstanceResults
from ....continuous.sharing.shared_windows import SharedWindows
from ....converters.to_samples import ResultConverter
from ....converters.to_triples import ToTriples
from ....streams.generator import StreamGenerator
from ....streams.sample import SampleBatch
from ....streams.time import TIME_MIN
from ..query import ResultEmitter
from ..windowed import WindowUnit
from .instances import InstanceUnit, SharingUnit


class TemplateUnit(SharingUnit["QueryInstance"], WindowUnit):
    """Evaluates the instances of one template (`TemplateEvaluator`), or queries that differ in
    constants (`SimilarQueriesEvaluator`), over the same streams as one query.

    Law (tests/laws/engine/test_shared_requests.py, test_shared_queries.py): from the first window
    that begins after its start, an instance's stream equals that of a unit of its own. In windows
    that are open at its start, the instance also sees the earlier samples. The same holds for the
    kept results of a registered query.

    Cost: that of the evaluator for a window, some 0.2 ms for each instance with a result in it, and
    a microsecond for each other one whose results are kept.
    """

    def __init__(
        self,
        *args: Any,
        evaluator: SharedWindows,
        converters: Mapping[str, Sequence[ToTriples]],
    ) -> None:
        super().__init__(*args, evaluator=evaluator, converters=converters)
        self.evaluator: SharedWindows = evaluator
        self._on_result: dict[int, Callable[[WindowResult], None]] = {}
        """Callbacks for all results of an instance, by its number, the empty ones included."""
        self._last_available = TIME_MIN
        """The available time (ns) of the last sample."""

    def add(self, instance: QueryInstance, number: int) -> None:
        super().add(instance, number)
        if instance.on_result is not None:
            self._on_result[number] = instance.on_result

    def remove(self, number: int) -> None:
        self._on_result.pop(number, None)
        super().remove(number)

    def forget(self, number: int) -> None:
        self.evaluator.remove(number)

    def between_steps(self, change: Callable[[], Any]) -> Any:
        return self.between_windows(change)

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
            self._last_available = max(window.end, self._last_available) + 1
            self.emit_tally(self._last_available, window.end, len(answered))


class QueryInstance(InstanceUnit):
    """Emits the results of one query of a shared evaluation. ``on_result`` is called with the
    result of each window, as terms."""

    def __init__(
        self,
        *args: Any,
        results: ResultConverter,
        on_result: Callable[[WindowResult], None] | None = None,
        **options: Any,
    ) -> None:
        super().__init__(*args, **options)
        self.on_result = on_result
        self._emitter = ResultEmitter(self.output, results, self.counters, on_result)

    @property
    def template(self) -> TemplateUnit:
        """The unit that evaluates this query together with others."""
        assert isinstance(self._template, TemplateUnit)
        return self._template

    def emit(self, result: WindowResult) -> None:
        """Emit the result of its next window."""
        self._guarded(lambda: self._emitter.emit(result))
