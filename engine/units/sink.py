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
    """A running sink, a receiver of one stream or several.

    It calls the code with each sample of an input in order. With several inputs, the number of the
    input is a second argument, and their samples come in the order of arrival. A batch form gets
    the batches as the streams cut them. A sink that its rule stops leaves its inputs; ``failure``
    is the reason. A failed sample is not repeated. With a log, failures are counted and reported
    when they are in the log (`apply_outcome`).

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
        """A batch form may keep parts of batches, so the streams must not free their texts."""
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
            self._defer_outcome,
        )

    def start(self, since: Since = Since.NOW) -> None:
        """Subscribe to the inputs; first read their retained samples if ``since`` is start."""
        for source in dict.fromkeys(self.inputs):
            if since is Since.START:
                for segment in source.stream.since(0):
                    self.receive(source, segment.batch)
            if self.failure is None:
                self._subscribed.append(source)
                source.subscribe(self)

    def stop(self) -> None:
        """Unsubscribe from the inputs."""
        while self._subscribed:
            self._subscribed.pop().unsubscribe(self)

    def receive(self, source: StreamGenerator, batch: SampleBatch) -> None:
        """Call the code with samples of an input."""
        for number, input in enumerate(self.inputs):
            if input is source and self.failure is None:
                self._call(number, batch)

    def advance(self, source: StreamGenerator, watermark: int) -> None:
        """Do nothing, since a sink does not wait for time."""

    def ended(self, source: StreamGenerator) -> None:
        """Do nothing, since the stream may go on."""

    def resumed(self, source: StreamGenerator) -> None:
        """Do nothing, since the sink has stayed subscribed."""

    def idleness_changed(self, source: StreamGenerator) -> None:
        """Do nothing, since a sink does not wait for time."""

    def apply_outcome(self, outcome: Outcome) -> None:
        """Count and report the failures of earlier calls, which are in the log now."""
        self._supervisor.apply_failures(outcome.failed, outcome.in_a_row)

    def _defer_outcome(self, failed: Sequence[Failed], in_a_row: int) -> bool:
        """Leave failures to the log if there is one; return whether."""
        tape = self._runner.tape
        if tape is None:
            return False
        tape.outcomes.append(Outcome(self.name, tuple(failed), in_a_row))
        return True

    def _stop_by_rule(self, reason: str) -> None:
        self.failure = reason
        self.stop()

    def _call(self, number: int, batch: SampleBatch) -> None:
        tape = self._runner.tape
        if tape is not None and tape.is_replaying:
            return  # the code got these samples when the command was executed first
        more = () if len(self.inputs) == 1 else (number,)
        items: list[tuple[int, Any]]
        if self.implementation.batch:
            items = [(int(batch.available[0]), batch)]
        else:
            items = list(zip(batch.available.tolist(), samples_of(batch), strict=True))

        def step(_: int, item: Any) -> None:
            self._instance.get()(item, *more)

        self._supervisor.run(items, step, lambda _: None)
