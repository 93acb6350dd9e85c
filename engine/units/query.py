"""Continuous queries at work: the C-SPARQL computational unit ([Events14 §V.B, Fig. 2])."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from ...continuous.evaluation.evaluator import ContinuousEvaluator
from ...continuous.operators.results import WindowResult
from ...converters.errors import ConversionError
from ...converters.to_samples import ResultConverter
from ...converters.to_triples import SampleConverter
from ...streams.generator import StreamGenerator
from ...streams.time import TIME_MIN, format_time
from ..processes.supervision import ErrorCounters
from .windowed import WindowUnit


class Answer:
    """The results of a query as samples of ``output``.

    The samples of a result are one instant, right after its window's end, which is their valid time
    (by `UNIQUE_TIMES` they are 1 ns apart, and after those of the window before). ``hear`` is told
    the result of each window as the query gave it. Of values that their fields cannot hold,
    ``counters`` note the first of each field and window.
    """

    def __init__(
        self,
        output: StreamGenerator,
        results: ResultConverter,
        counters: ErrorCounters,
        hear: Callable[[WindowResult], None] | None = None,
    ) -> None:
        self.output = output
        self.results = results
        self.lost: list[ConversionError] = []
        results.lost = self.lost
        self.counters = counters
        self.hear = hear
        self._sent = TIME_MIN
        """The available time (ns) of the last sample."""

    def give(self, result: WindowResult) -> None:
        """The result of a window; windows come in order."""
        if self.hear is not None:
            self.hear(result)
        batch = self.results.convert(result, max(result.end, self._sent) + 1)
        for error in self.lost:
            text = f"the window that ends {format_time(result.end)} has no value"
            self.counters.note(f"{text} in field {error.field!r}: {error.message}", result.end)
        self.lost.clear()
        if len(batch):
            if self.output.rules.gap:
                steps = np.arange(len(batch), dtype=np.int64)
                batch = batch.with_available(batch.available + steps)
            self._sent = int(batch.available[-1])
            self.output.emit(batch)


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
        self._answer = Answer(self.output, results, self.counters, hear)

    def explain(self) -> str:
        """How the query is evaluated; its costs are estimated from the rates of its streams."""
        return self.evaluator.explain(self.flows())

    def emit(self, results: Sequence[WindowResult]) -> None:
        self.windows += len(results)
        for result in results:
            self._answer.give(result)
