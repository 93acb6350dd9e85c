"""The unit of a continuous query: the C-SPARQL computational unit ([Events14 §V.B, Fig. 2])."""

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


class ResultEmitter:
    """Emits the results of a query as samples of ``output``.

    The samples of a result are one instant. They are valid at their window's end, and available
    right after it. Under the rules `UNIQUE_TIMES` they are 1 ns apart, and after those of the
    window before. ``on_result`` is called with the result of each window, as terms. ``counters``
    note the first value of each field and window that its field cannot hold.
    """

    def __init__(
        self,
        output: StreamGenerator,
        results: ResultConverter,
        counters: ErrorCounters,
        on_result: Callable[[WindowResult], None] | None = None,
    ) -> None:
        self.output = output
        self.results = results
        self.lost: list[ConversionError] = []
        results.lost = self.lost
        self.counters = counters
        self.on_result = on_result
        self._last_available = TIME_MIN
        """The available time (ns) of the last sample."""

    def emit(self, result: WindowResult) -> None:
        """Emit the result of the next window."""
        if self.on_result is not None:
            self.on_result(result)
        batch = self.results.convert(result, max(result.end, self._last_available) + 1)
        for error in self.lost:
            text = f"the window that ends {format_time(result.end)} has no value"
            self.counters.note(f"{text} in field {error.field!r}: {error.message}", result.end)
        self.lost.clear()
        if len(batch):
            if self.output.rules.gap:
                steps = np.arange(len(batch), dtype=np.int64)
                batch = batch.with_available(batch.available + steps)
            self._last_available = int(batch.available[-1])
            self.output.emit(batch)


class QueryUnit(WindowUnit):
    """The C-SPARQL computational unit ([Events14 §V.B, Fig. 2]): it converts samples to timed
    triples, evaluates them in windows, and converts the results to samples (`ResultEmitter`).
    """

    def __init__(
        self,
        *args: Any,
        evaluator: ContinuousEvaluator,
        converters: Mapping[str, Sequence[SampleConverter]],
        results: ResultConverter,
        on_result: Callable[[WindowResult], None] | None = None,
    ) -> None:
        super().__init__(*args, evaluator=evaluator, converters=converters)
        self.evaluator: ContinuousEvaluator = evaluator
        self._emitter = ResultEmitter(self.output, results, self.counters, on_result)

    def explain(self) -> str:
        """Print the evaluation of the query, with costs estimated from the rates of its streams."""
        return self.evaluator.explain(self.flows())

    def emit(self, results: Sequence[WindowResult]) -> None:
        self.windows += len(results)
        for result in results:
            self._emitter.emit(result)
