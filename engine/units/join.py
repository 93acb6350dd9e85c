"""A computational unit that runs a user-written function over the join of its inputs
([DyKnow10 Def. 5.10, 5.11, 5.34]).

For each tuple of ``join(f1 … fn)``, in order, ``(s_j, i_j) = f(t_j, samples_j, i_{j-1})``, where
i_0 is no_value (None); of a single input for each sample. `FunctionUnit` in unit.py is another
thing: a vectorized function of the samples of one stream.
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
from ..model.process_reports import OnReport, unheard
from ..processes.call_adapter import Answers, Row, samples_of
from ..processes.registry import UnitImplementation
from ..processes.supervision import (
    DIRECT,
    Instance,
    ProcessError,
    ProcessEvent,
    Runner,
    Supervisor,
)
from .base import ComputationalUnit

Samples: TypeAlias = tuple[Sample | None, ...]

_SINGLE: Final = 512
"""So many tuples become objects at once: few enough to be cheap for Python's collector."""
_COLUMNS: Final = 65_536
"""So many tuples go to a batch form in one call, which has one deadline."""


class FunctionProcess(ComputationalUnit):
    """Runs ``implementation`` over the join of ``inputs``; the same stream may be given twice.

    The sample form is called for each tuple, the batch form for as many as are known. What it
    makes is offered in the order in which it was made; it may be available later than the tuple
    was, and then the output's lateness decides whether it comes in time. A unit that stops by its
    rule ends its output: nothing more will come, and nobody waits for it. ``on_event`` hears of
    failures, restarts and the stop, ``on_report`` of what the code says of its output.

    Law (tests/laws): output, counters and what is told do not depend on batch cuts; a batch form
    has to keep that by itself. Cost: Python per tuple in the sample form, one call a batch in the
    batch form. Memory: the join's, and 512 tuples as objects.
    """

    def __init__(
        self,
        *args: Any,
        implementation: UnitImplementation,
        on_event: Callable[[ComputationalUnit, ProcessEvent, str], None],
        on_report: OnReport = unheard,
        runner: Runner = DIRECT,
    ) -> None:
        super().__init__(*args)
        if len(self.inputs) != len(implementation.inputs):
            raise ValueError(
                f"{implementation.name} takes {len(implementation.inputs)} inputs, "
                f"got {len(self.inputs)}"
            )
        self.implementation = implementation
        # A stream that is given twice is joined once: last_avail is the same for both.
        self._index = {source: i for i, source in enumerate(self.sources)}
        self._place = tuple(self._index[source] for source in self.inputs)
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
                tuple(tuples.inputs[i] for i in self._place),
                tuple(tuples.rows[i] for i in self._place),
            )
            if self.implementation.batch:
                self._apply_batch(placed)
            else:
                self._apply_samples(placed)
        known = self._join.known
        if known is not None and not self.all_ended and self.failure is None:
            # A sample has the available time of its tuple or a later one.
            self.output.advance(known + 1)

    def _apply_samples(self, tuples: TupleBatch) -> None:
        def step(time: int, samples: Samples) -> Row | None:
            # Taken before the call: afterwards it is the user's.
            valid = max(sample.valid for sample in samples if sample is not None)
            made, state = self._call(time, samples)
            row = self._answers.row(made, time, valid)
            self._state = state  # kept once the sample is fit
            return row

        for part in _parts(tuples, _SINGLE):
            items = list(zip(part.available.tolist(), _objects(part), strict=True))
            self._supervisor.run(items, step, self._answers.offer)

    def _apply_batch(self, tuples: TupleBatch) -> None:
        def step(time: int, part: TupleBatch) -> SampleBatch | None:
            made, state = self._call(part)
            batch = self._answers.batch(made, time)
            self._state = state
            return batch

        items = [(int(part.available[0]), part) for part in _parts(tuples, _COLUMNS)]
        self._supervisor.run(items, step, self._answers.offer_batches)

    def _call(self, *arguments: Any) -> tuple[object, Any]:
        """The pair ``(sample, new state)``."""
        answer = self._instance.get()(*arguments, self._state)
        if not isinstance(answer, tuple) or len(answer) != 2:
            raise ProcessError(
                f"a unit gives a pair (sample, new state), got {type(answer).__name__}: "
                "`return None, state` gives no sample"
            )
        return answer

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
    """Each tuple's samples as objects of its own: what a user does to one is seen nowhere else."""
    columns = [_column(batch, rows) for batch, rows in zip(tuples.inputs, tuples.rows, strict=True)]
    return zip(*columns, strict=True)


def _column(batch: SampleBatch, rows: np.ndarray[Any, np.dtype[np.int64]]) -> Samples:
    used, place = np.unique(rows, return_inverse=True)
    first = int(used[0] < 0)  # -1 sorts first
    known: Sequence[Sample | None] = [None] * first
    if len(used) > first:
        known = [*known, *samples_of(batch.take(used[first:]))]
    return tuple(
        None if sample is None else Sample(sample.valid, dict(sample.values), sample.available)
        for sample in (known[i] for i in place.tolist())
    )
