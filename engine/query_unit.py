"""Continuous queries at work: the C-SPARQL computational unit ([Events14 §V.B, Fig. 2])."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from ..continuous.evaluator import ContinuousEvaluator
from ..continuous.results import WindowResult
from ..converters.to_samples import ResultConverter
from ..converters.to_triples import SampleConverter
from ..streams.generator import StreamGenerator
from ..streams.time import TIME_MIN
from .window_unit import WindowUnit


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
