"""Sinks: user-written processes without output ([DyKnow10 §4.1], SPEC §1)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from ...streams.generator import StreamGenerator
from ...streams.sample import SampleBatch
from ..model.views import Since
from ..processes.call_adapter import samples_of
from ..processes.external_io import Failed, Outcome
from ..processes.registry import SinkImplementation
from ..processes.supervision import (
    DIRECT,
    ErrorCounters,
    Instance,
    ProcessEvent,
    Runner,
    Supervisor,
)


class Sink:
    """A sink at work: a receiver of one stream or several.

    It is called with each sample of an input in order; the samples of different inputs come as
    they come, with the number of the input. A batch form gets the batches as the streams cut
    them. A sink that stops by its rule leaves its inputs; ``failure`` says why. A sample that
    failed is not given again. Where commands are recorded, what went wrong counts and is told when
    it is written down (`hear`).

    Cost: Python per sample, one call a batch in the batch form. Memory: one batch as objects.
    """

    def __init__(
        self,
        implementation: SinkImplementation,
        inputs: Sequence[StreamGenerator],
        *,
        on_event: Callable[[Sink, ProcessEvent, str], None],
        runner: Runner = DIRECT,
        name: str | None = None,
    ) -> None:
        expected = len(implementation.inputs)
        if len(inputs) != expected:
            raise ValueError(f"{implementation.name} takes {expected} inputs, got {len(inputs)}")
        self.implementation = implementation
        self.inputs = tuple(inputs)
        self.knows_codes = implementation.batch
        """Batches are the user's, to keep what he likes."""
        self.name = name or implementation.name
        self.counters = ErrorCounters()
        self.failure: str | None = None
        self._runner = runner
        self._subscribed: list[StreamGenerator] = []
        self._instance: Instance[Callable[..., Any]] = Instance(implementation.make)
        self._supervisor = Supervisor(
            implementation.rule,
            runner,
            self.counters,
            self._instance.forget,
            self._stop_by_rule,
            lambda event, text: on_event(self, event, text),
            self._put_off,
        )

    def start(self, since: Since = Since.NOW) -> None:
        """Subscribe to the inputs; from the start of what they keep, if asked."""
        for source in dict.fromkeys(self.inputs):
            if since is Since.START:
                for segment in source.stream.since(0):
                    self.receive(source, segment.batch)
            if self.failure is None:
                self._subscribed.append(source)
                source.subscribe(self)

    def stop(self) -> None:
        """Leave the inputs."""
        while self._subscribed:
            self._subscribed.pop().unsubscribe(self)

    def receive(self, source: StreamGenerator, batch: SampleBatch) -> None:
        """Samples of an input."""
        for number, input in enumerate(self.inputs):
            if input is source and self.failure is None:
                self._give(number, batch)

    def advance(self, source: StreamGenerator, watermark: int) -> None:
        """A sink waits for nothing."""

    def ended(self, source: StreamGenerator) -> None:
        """The stream may be taken up again; the sink stays."""

    def resumed(self, source: StreamGenerator) -> None:
        """It is taken up again."""

    def idleness_changed(self, source: StreamGenerator) -> None:
        """A sink waits for nothing."""

    def hear(self, outcome: Outcome) -> None:
        """What came of its calls is written down: it is told now, and counts."""
        self._supervisor.hear(outcome.failed, outcome.in_a_row)

    def _put_off(self, failed: Sequence[Failed], in_a_row: int) -> bool:
        tape = self._runner.tape
        if tape is None:
            return False
        tape.outcomes.append(Outcome(self.name, tuple(failed), in_a_row))
        return True

    def _stop_by_rule(self, reason: str) -> None:
        self.failure = reason
        self.stop()

    def _give(self, number: int, batch: SampleBatch) -> None:
        tape = self._runner.tape
        if tape is not None and tape.is_playing:
            return  # it was told when this was done first
        more = () if len(self.inputs) == 1 else (number,)
        items: list[tuple[int, Any]]
        if self.implementation.batch:
            items = [(int(batch.available[0]), batch)]
        else:
            items = list(zip(batch.available.tolist(), samples_of(batch), strict=True))

        def step(_: int, given: Any) -> None:
            self._instance.get()(given, *more)

        self._supervisor.run(items, step, lambda _: None)
