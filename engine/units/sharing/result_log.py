"""Samples that wait until their streams are read."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from ....continuous.columns.pane_runs import equal_runs
from ....continuous.sharing.instance_results import Numbers
from ....streams.sample import SampleBatch, concatenate

_BATCHES: Final = 64
"""The most batches that wait."""
_ROWS: Final = 1 << 16
"""The number of waiting samples from which on they wait no longer."""


class ResultLog:
    """Samples of many instances, by window. The samples of one instance are together, and in its
    order.

    Cost: `add` O(1); `take` numpy per column, and a view per instance. Memory: `_ROWS` samples, and
    those of one window.
    """

    def __init__(self) -> None:
        self._waiting: list[tuple[Numbers, SampleBatch]] = []
        self._rows = 0

    def __bool__(self) -> bool:
        return bool(self._waiting)

    @property
    def is_full(self) -> bool:
        """Whether no more samples should wait."""
        return len(self._waiting) >= _BATCHES or self._rows >= _ROWS

    def add(self, numbers: Numbers, batch: SampleBatch) -> None:
        """Add samples that are later than those before; ``numbers`` are their instances."""
        self._waiting.append((numbers, batch))
        self._rows += len(batch)

    def take(self) -> Sequence[tuple[int, SampleBatch]]:
        """Remove and return the samples of each instance, by ascending number."""
        waiting, self._waiting, self._rows = self._waiting, [], 0
        if not waiting:
            return ()
        numbers = np.concatenate([own for own, _ in waiting])
        batch = concatenate([samples for _, samples in waiting])
        if len(waiting) > 1:
            order = np.argsort(numbers, kind="stable")
            numbers, batch = numbers[order], batch.take(order)
        return [(int(numbers[run.start]), batch.take(run)) for run in equal_runs(numbers)]
