"""A computational unit that runs a user-written function over the join of its inputs
([DyKnow10 Def. 5.10, 5.11, 5.34]).

For each tuple of ``join(f1 … fn)``, in order, ``(s_j, i_j) = f(t_j, samples_j, i_{j-1})``, where
i_0 is no_value (None). A single input has a tuple for each sample. `FunctionUnit` differs: it calls
a vectorized function with the samples of one stream.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any, Final, TypeAlias

import numpy as np

from ...streams.generator import StreamGenerator
from ...streams.joins.join import Join, OneByOne
from ...streams.sample import SampleBatch
from ...streams.single_sample import Sample
from ...streams.tuples import TupleBatch
from ..model.process_reports import OnReport, ignore_report
from ..processes.call_adapter import Answers, Row, check_pair, samples_of
from ..processes.registry import UnitImplementation
from ..processes.supervision import (
    DIRECT,
    Instance,
    ProcessEvent,
    Runner,
    Supervisor,
)
from .base import ComputationalUnit

Samples: TypeAlias = tuple[Sample | None, ...]

_MOST_OBJECTS: Final = 512
"""The number of tuples that are Python objects at once: few are cheap for Python's collector."""
_MOST_ROWS: Final = 65_536
"""The most tuples of one call of a batch form, since a call has one deadline."""


class FunctionProcess(ComputationalUnit):
    """Runs ``implementation`` over the join of ``inputs``, which may contain a stream twice.

    It calls the sample form for each tuple, and the batch form with all tuples that are decided. It
    offers the results in the order of the calls. A result may be available later than its tuple;
    then the output's lateness decides whether it is late. A unit that its rule stops ends its
    output, so that readers do not wait for it. ``on_event`` is called with failures, restarts and
    the stop, ``on_report`` with the code's reports about its output.

    Law (tests/laws): output, counters and reports do not depend on batch cuts. A batch form must
    obey this itself. Cost: Python per tuple in the sample form, one call a batch in the batch form.
    Memory: that of the join, and 512 tuples as objects.
    """

    def __init__(
        self,
        *args: Any,
        implementation: UnitImplementation,
        on_event: Callable[[ComputationalUnit, ProcessEvent, str], None],
        on_report: OnReport = ignore_report,
        runner: Runner = DIRECT,
    ) -> None:
        super().__init__(*args)
        if len(self.inputs) != len(implementation.inputs):
            raise ValueError(
                f"{implementation.name} takes {len(implementation.inputs)} inputs, "
                f"got {len(self.inputs)}"
            )
        self.implementation = implementation
        # The join has an input for each stream: two inputs from one stream have equal samples.
        self._index = {source: i for i, source in enumerate(self.sources)}
        self._places = tuple(self._index[source] for source in self.inputs)
        self._join = Join(len(self._index)) if len(self._index) > 1 else OneByOne()
        self._answers = Answers(self.output, on_report)
        self._state: Any = None
        self._instance: Instance[Callable[..., Any]] = Instance(implementation.make)
        self._supervisor = Supervisor(
            implementation.rule,
            runner,
            self.counters,
            self._restart,
            self._stop_by_rule,
            lambda event, text: on_event(self, event, text),
        )

    def process(self, source: StreamGenerator, batch: SampleBatch) -> None:
        input = self._index[source]
        self._apply(self._join.push(input, batch))
        self._apply(self._join.advance(input, source.promise_after(batch)))

    def decided(self, source: StreamGenerator) -> int:
        return self._join.decided(self._index[source])

    def resume(self, source: StreamGenerator) -> None:
        super().resume(source)
        self._join.resume(self._index[source])

    def progress(self, source: StreamGenerator, watermark: int) -> None:
        self._apply(self._join.advance(self._index[source], watermark))

    def finish(self, source: StreamGenerator) -> None:
        self._apply(self._join.end(self._index[source]))
        if self.failure is None:
            super().finish(source)

    def _apply(self, tuples: TupleBatch | None) -> None:
        if tuples is not None and len(tuples):
            placed = TupleBatch(
                tuples.available,
                tuples.valid,
                tuple(tuples.inputs[i] for i in self._places),
                tuple(tuples.rows[i] for i in self._places),
            )
            if self.implementation.batch:
                self._apply_batch(placed)
            else:
                self._apply_samples(placed)
        known = self._join.known
        if known is not None and not self.all_ended and self.failure is None:
            # A result is available with its tuple or later, so this promise holds.
            self.output.advance(known + 1)

    def _apply_samples(self, tuples: TupleBatch) -> None:
        def step(time: int, samples: Samples) -> Row | None:
            # Before the call, since user-written code may change the samples.
            valid = max(sample.valid for sample in samples if sample is not None)
            answer, state = self._call(time, samples)
            row = self._answers.row(answer, time, valid)
            self._state = state  # only after `row` has accepted the answer
            return row

        for part in _parts(tuples, _MOST_OBJECTS):
            items = list(zip(part.available.tolist(), _objects(part), strict=True))
            self._supervisor.run(items, step, self._answers.offer)

    def _apply_batch(self, tuples: TupleBatch) -> None:
        def step(time: int, part: TupleBatch) -> SampleBatch | None:
            answer, state = self._call(part)
            batch = self._answers.batch(answer, time)
            self._state = state
            return batch

        items = [(int(part.available[0]), part) for part in _parts(tuples, _MOST_ROWS)]
        self._supervisor.run(items, step, self._answers.offer_batches)

    def _call(self, *arguments: Any) -> tuple[object, Any]:
        return check_pair(self._instance.get()(*arguments, self._state))

    def _restart(self) -> None:
        self._state = None
        self._instance.forget()

    def _stop_by_rule(self, reason: str) -> None:
        self.cut_off(reason)
        self.output.end()


def _parts(tuples: TupleBatch, rows: int) -> Iterator[TupleBatch]:
    if len(tuples) <= rows:
        yield tuples
        return
    for start in range(0, len(tuples), rows):
        yield tuples.take(slice(start, start + rows))


def _objects(tuples: TupleBatch) -> Iterator[Samples]:
    """Return each tuple's samples as new objects, since user-written code may change them."""
    columns = [_column(batch, rows) for batch, rows in zip(tuples.inputs, tuples.rows, strict=True)]
    return zip(*columns, strict=True)


def _column(batch: SampleBatch, rows: np.ndarray[Any, np.dtype[np.int64]]) -> Samples:
    used, place = np.unique(rows, return_inverse=True)
    first = int(used[0] < 0)  # row -1, no sample, sorts first
    samples: Sequence[Sample | None] = [None] * first
    if len(used) > first:
        samples = [*samples, *samples_of(batch.take(used[first:]))]
    return tuple(
        None if sample is None else Sample(sample.valid, dict(sample.values), sample.available)
        for sample in (samples[i] for i in place.tolist())
    )
