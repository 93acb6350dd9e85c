"""The unit of a continuous query: the C-SPARQL computational unit ([Events14 §V.B, Fig. 2])."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from ...continuous.evaluation.evaluator import ContinuousEvaluator
from ...continuous.evaluation.explain import Explanation
from ...continuous.operators.results import ResultBatch, WindowResult
from ...converters.errors import ConversionError
from ...converters.results_to_samples import ResultConverter
from ...converters.to_triples import ToTriples
from ...streams.generator import StreamGenerator
from ...streams.sample import SampleBatch, Times
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

    def emit(self, results: WindowResult | ResultBatch) -> None:
        """Emit the result of the next window, or of the next windows at once."""
        if self.on_result is not None:
            for result in results.windows():
                self.on_result(result)
        if isinstance(results, WindowResult):
            self._emit_window(results)
            return
        batch = self.results.convert_batch(results)
        if self.lost:
            # A report is of one window.
            self.lost.clear()
            for result in results.windows():
                self._emit_window(result)
        elif len(batch):
            self._emit(batch.with_available(self._available(batch.valid)))

    def _emit_window(self, result: WindowResult) -> None:
        if result.is_empty:
            return
        available = max(result.end, self._last_available) + 1
        batch = self.results.convert(result, available)
        for error in self.lost:
            text = f"the window that ends {format_time(result.end)} has no value"
            self.counters.note(f"{text} in field {error.field!r}: {error.message}", result.end)
        self.lost.clear()
        if len(batch):
            if self.output.rules.gap:
                steps = np.arange(len(batch), dtype=np.int64)
                batch = batch.with_available(batch.available + steps)
            self._emit(batch)

    def _emit(self, batch: SampleBatch) -> None:
        self._last_available = int(batch.available[-1])
        self.output.emit(batch)

    def _available(self, ends: Times) -> Times:
        """Return the available times of samples of windows with these ends, in order."""
        first = np.flatnonzero(np.append(True, ends[1:] != ends[:-1]))
        counts = np.diff(np.append(first, len(ends)))
        has_gap = self.output.rules.gap > 0
        # How much later than the first window a window is, in ns, if no time lies between them.
        later = first if has_gap else np.arange(len(first))
        times = ends[first] + 1
        times[0] = max(int(times[0]), self._last_available + 1)
        available = np.repeat(np.maximum.accumulate(times - later) + later, counts)
        if has_gap:
            available += np.arange(len(ends)) - np.repeat(first, counts)
        return available


class QueryUnit(WindowUnit):
    """The C-SPARQL computational unit ([Events14 §V.B, Fig. 2]): it converts samples to timed
    triples, evaluates them in windows, and converts the results to samples (`ResultEmitter`).
    """

    def __init__(
        self,
        *args: Any,
        evaluator: ContinuousEvaluator,
        converters: Mapping[str, Sequence[ToTriples]],
        results: ResultConverter,
        on_result: Callable[[WindowResult], None] | None = None,
    ) -> None:
        super().__init__(*args, evaluator=evaluator, converters=converters)
        self.evaluator: ContinuousEvaluator = evaluator
        evaluator.splits = False
        self._emitter = ResultEmitter(self.output, results, self.counters, on_result)

    def explain(self) -> str:
        """Print the evaluation of the query, with costs estimated from the rates of its streams."""
        return str(self.explanation())

    def explanation(self) -> Explanation:
        """The evaluation of the query, with costs estimated from the rates of its streams."""
        return self.evaluator.explanation(self.flows())

    def emit(self, results: Sequence[WindowResult | ResultBatch]) -> None:
        for result in results:
            self.windows += len(result.ends)
            self._emitter.emit(result)
